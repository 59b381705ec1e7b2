"""Does the point estimate find the optimum from random starts?

Loops of Table 1's isolator (with a normal force that α's floor does not touch) at nine frequencies and amplitudes,
without noise; each seed gives the genetic algorithm, differential evolution and least squares other random starts.
Found is an objective (Eq. 8) below 0.1 % of what Eq. (8) makes of the friction force itself.

    python analyses/point_recovery.py [SEEDS]
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from bayes_iwan.campaign import Loop, Record, average
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import SearchSettings
from bayes_iwan.inference.solving.point import find_point
from bayes_iwan.physics import Model, Reference, sine_motion
from bayes_iwan.physics.laws.normal_force import from_paper_hunt_crossley
from bayes_iwan.physics.laws.stiffness import from_paper_stiffness

TESTS = [(f, a) for f in (10.0, 15.0, 20.0) for a in (0.3, 0.6, 1.0)]
REFERENCE = Reference(1.0, 0.12566)


def true_values() -> dict[str, np.ndarray]:
    """Table 1's spring, stiffness and slip forces, with k̃ₙ = 0.6, λ = 1.1 s/m, β = 0.6."""
    plain = {
        "kp_N_mm": 5.49,
        "force_zero_N": 0.0,
        "t1_N": 0.24,
        "eta1": 0.95,
        "g1": 0.41,
        "t2_N": 0.36,
        "eta2": 5.1,
        "g2": 0.53,
        "t3_N": 0.5,
        "eta3": 4.4,
        "g3": 0.06,
    }
    return (
        {k: np.array([v]) for k, v in plain.items()}
        | from_paper_stiffness(19.62, 30.37)
        | from_paper_hunt_crossley(0.6, 1.1, 0.6, REFERENCE)
    )


def known_loops(noise_N: float = 0.0, seed: int = 0, cycles: int = 8) -> tuple[Loop, ...]:
    """Averaged loops of TESTS, 128 samples a cycle, with white noise of noise_N on every sample."""
    motion = sine_motion(frequency_hz=[f for f, _ in TESTS], amplitude_mm=[a for _, a in TESTS])
    force = Model(REFERENCE).force(true_values(), motion)[0]
    loops = []
    for k, (f, a) in enumerate(TESTS):
        time_s = np.arange(128 * cycles) / (128 * f)
        noise = noise_N * np.random.default_rng([seed, k]).standard_normal(time_s.size)
        loops.append(
            average(
                Record(
                    f"f{f:g}_a{a:g}.csv",
                    f,
                    a,
                    "fit",
                    {},
                    time_s,
                    a * np.sin(2.0 * np.pi * f * time_s),
                    np.tile(force[k], cycles) + noise,
                )
            )
        )
    return tuple(loops)


def main(seeds: int) -> int:
    problem = make_problem(known_loops())
    settings = SearchSettings()
    shares = []
    for seed in range(seeds):
        began = time.perf_counter()
        point = find_point(problem, seed, settings, progress=False)
        shares.append(point.goal_share)
        second = np.nan if point.second is None else point.second.objective
        print(
            f"seed {seed:2d}: objective {100 * point.goal_share:.4f} % of the friction force; before least squares "
            f"genetic {point.search.objective:.3f}, differential evolution {second:.3f} N/mm; "
            f"{point.n_evaluations} evaluations, {time.perf_counter() - began:.1f} s",
            flush=True,
        )
    found = int(np.sum(np.array(shares) < 1e-3))
    print(f"found in {found} of {seeds} seeds")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", nargs="?", type=int, default=20)
    wanted = parser.parse_args().seeds
    sys.exit(0 if main(wanted) >= 0.95 * wanted else 1)
