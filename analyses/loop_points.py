"""How far off a loop's force is for its number of points, by how often the motion reverses within a cycle.

    python analyses/loop_points.py [--draws 200]

RMS error of the friction force against 8192 points, over its RMS: median and 95 % quantile over prior draws, and Table
1 of the paper. bayes_iwan.campaign.loops.resolution chooses the number of points from it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bayes_iwan.campaign.loops.resolution import points_for, reversals
from bayes_iwan.models import Model, Motion, Scales
from bayes_iwan.models.paper_parameters import table_1

SCALES = Scales(1.0, 0.063, 10.0, 1.2, 6.0, 14.0)
FINE, POINTS = 8192, (64, 128, 256, 512, 1024)
#: order, amplitude and phase of the harmonics
MOTIONS = {
    "sine": [(1, 1.0, 0.0)],
    "third harmonic, 60 %": [(1, 1.0, 0.0), (3, 0.6, 1.0)],
    "7th harmonic, 15 %": [(1, 1.0, 0.2), (7, 0.15, 0.4)],
    "seven harmonics": [(k, 1.0, q) for k, q in zip((1, 2, 3, 5, 7, 9, 11), (4.0, 1.7, 0.3, 0.1, 5.1, 5.7, 3.8))],
    "triangle, rounded": [
        (k, np.exp(-((k / 20.0) ** 2)) / k**2, np.pi * (k % 4 == 3) + 0.01 * k) for k in range(1, 50, 2)
    ],
    "25th harmonic, 2 %": [(1, 1.0, 0.3), (25, 0.02, 0.5)],
}


def motion_with(parts: list[tuple[int, float, float]], samples: int, frequency_hz: float = 10.0) -> Motion:
    """One periodic motion of 1 mm with these harmonics."""
    phase, omega = 2.0 * np.pi * np.arange(samples) / samples, 2.0 * np.pi * frequency_hz
    orders, sizes, shifts = (np.array(x)[:, None] for x in zip(*parts))
    u, v, a = (
        np.sum(sizes * orders**d * np.real(1j**d * np.exp(1j * (orders * phase + shifts - np.pi / 2.0))), axis=0)
        for d in range(3)
    )
    u, v, a = (x / np.abs(u).max() for x in (u, v, a))
    return Motion(
        displacement_mm=u[None, None],
        velocity_m_s=(1e-3 * omega * v)[None, None],
        acceleration_m_s2=(1e-3 * omega**2 * a)[None, None],
        frequency_hz=np.array([frequency_hz]),
        amplitude_mm=np.ones(1),
        cycle=np.zeros(1),
        test=np.zeros(1, dtype=np.int64),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=200)
    model, parameters = Model(SCALES.reference), Model(SCALES.reference).parameters(SCALES)
    z = np.random.default_rng(1).standard_normal((parser.parse_args().draws, len(parameters)))
    drawn = model.parameter_values({p.name: p.value(z[:, i]) for i, p in enumerate(parameters)})
    values = {name: np.append(x, table_1(SCALES.reference).get(name, 0.0)) for name, x in drawn.items()}
    print("median, 95 % quantile, Table 1".ljust(52) + "".join(f"{n} points".ljust(27) for n in POINTS))
    for name, parts in MOTIONS.items():
        fine = motion_with(parts, FINE)
        exact, u = model.friction_force(values, fine)[:, 0], fine.displacement_mm[0, 0]
        shown = f"{name}, {reversals(u)} reversals: {points_for([u], [fine.velocity_m_s[0, 0]])} points".ljust(52)
        for n in POINTS:
            off = model.friction_force(values, motion_with(parts, n))[:, 0] - exact[:, :: FINE // n]
            error = np.sqrt(np.mean(off**2, axis=1) / np.mean(exact**2, axis=1))
            shown += f"{np.median(error[:-1]):.1e} {np.quantile(error[:-1], 0.95):.1e} {error[-1]:.1e}".ljust(27)
        print(shown)


if __name__ == "__main__":
    main()
