"""The data from which the loop viewer of a page draws one chosen test."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import Predictive, measured_cycles

DRAWS, CYCLES = 16, 8


def rounded(x: Array, digits: int) -> list[float]:
    return [float(v) for v in np.round(x, digits)]


def places(amplitude_mm: float, friction_N: float) -> tuple[int, int]:
    """Decimal places of displacements and forces that a screen can show of a loop."""
    far, near = (int(n - np.floor(np.log10(max(x, 1e-9)))) for n, x in ((4, amplitude_mm), (3, friction_N)))
    return max(0, far), max(0, near)


def viewer_data(p: Predictive) -> dict[str, Any]:
    """What the viewer needs of each test, rounded to what a screen can show.

    Of the same form with "effects" (names) and in each test, in the place of model, draws and bands, "sets": the
    predicted force for each set of effects, set i holding effect k where bit k of i is 1.
    """
    tests = []
    for t, loop in enumerate(p.loops):
        far, near = places(loop.amplitude_mm, float(np.ptp(p.measured_N[t] - p.spring_N[t])))
        slope, zero = np.polyfit(p.displacement_mm[t], p.spring_N[t], 1)
        picked = np.linspace(0, len(p.force_N) - 1, min(DRAWS, len(p.force_N))).astype(int)
        low = np.quantile(p.force_N[:, t], [0.05, 0.25], axis=0)
        cycles = []
        for u, force in measured_cycles(loop, CYCLES):
            step = max(1, len(u) // 160)
            cycles.append([rounded(u[::step], far), rounded(force[::step] - p.zero_N[t], near)])
        tests.append(
            {
                "name": loop.record.units.said(test_name(loop)),
                "file": loop.file,
                "u": rounded(p.displacement_mm[t], far),
                "slope": float(slope),
                "zero": float(zero),
                "measured": rounded(p.measured_N[t], near),
                "model": [
                    rounded(q, near)
                    for q in (low[0], low[1], p.median_N[t], *np.quantile(p.force_N[:, t], [0.75, 0.95], axis=0))
                ],
                "cycle": [rounded(q, near) for q in np.quantile(p.cycle_N[:, t], [0.05, 0.25, 0.75, 0.95], axis=0)],
                "loop": [rounded(q, near) for q in np.quantile(p.loop_N[:, t], [0.05, 0.25, 0.75, 0.95], axis=0)],
                "draws": [rounded(x, near) for x in p.force_N[picked, t]],
                "cycles": cycles,
            }
        )
    units = p.loops[0].record.units
    return {"tests": tests, "displacement": units.displacement, "force": units.force}
