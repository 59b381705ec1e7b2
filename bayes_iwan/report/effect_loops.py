"""Loops of a diagnosed model with each named effect in it and without it, for the loop viewer."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.wording import title
from bayes_iwan.diagnosis.fits.data import predicted
from bayes_iwan.models.simulator import straight_part
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import measured_cycles
from bayes_iwan.report.identification.viewer import CYCLES, places, rounded

#: effects that can be switched: each doubles the loops that a page holds
MOST = 4
#: samples of a loop that a screen can show
SAMPLES = 128


def effect_sets(found: Diagnosis) -> tuple[tuple[str, ...], Array]:
    """Names of the switchable effects and the force (sets, tests, samples), N, of the fitted model with some of them.

    Set i holds effect k where bit k of i is one; nothing is fitted again when one is removed. Loops begin where the
    averaged loops do, their means are zero.
    """
    fit = found.fit
    every = fit.problem.effects
    samples = found.data.loops[0].displacement_mm[:: _step(found)].size
    switched, z = every[:MOST], dict(zip(fit.problem.names, fit.z))
    out = []
    for chosen in range(2 ** len(switched)):
        kept = [e for k, e in enumerate(every) if k >= len(switched) or chosen >> k & 1]
        problem = fit.problem.with_effects(kept)
        harmonics = predicted(found.data, problem, np.array([[z[n] for n in problem.names]]))[0][0].copy()
        harmonics[:, 0] = 0.0
        full = np.zeros((len(harmonics), samples // 2 + 1), dtype=complex)
        count = min(harmonics.shape[1], full.shape[1])
        full[:, :count] = harmonics[:, :count]
        full[:, 1:] /= 2.0
        out.append(np.fft.irfft(full, samples, axis=1, norm="forward"))
    return tuple(e.name for e in switched), np.array(out)


def _step(found: Diagnosis) -> int:
    return max(1, found.data.loops[0].displacement_mm.size // SAMPLES)


def effect_viewer_data(found: Diagnosis) -> dict[str, Any]:
    """What the viewer (:mod:`bayes_iwan.report.identification.viewer`) needs of a diagnosis."""
    names, sets = effect_sets(found)
    problem = found.fit.problem
    springs = problem.model.spring_N_mm(problem.parameter_values(found.fit.z[None]))
    spring = None if springs is None else float(springs[0])
    step, tests = _step(found), []
    for t, loop in enumerate(found.data.loops):
        u, force = loop.displacement_mm[::step], loop.force_N[::step]
        zero = float(force.mean())
        line = np.polyfit(u, straight_part(force - zero, u), 1) if spring is None else np.array([spring, 0.0])
        far, near = places(loop.amplitude_mm, float(np.ptp(force - np.polyval(line, u))))
        cycles = [
            [rounded(x[:: max(1, len(x) // 160)], far), rounded(f[:: max(1, len(x) // 160)] - zero, near)]
            for x, f in measured_cycles(loop, CYCLES)
        ]
        tests.append(
            {
                "name": loop.record.units.said(test_name(loop)),
                "u": rounded(u, far),
                "slope": float(line[0]),
                "zero": float(line[1]),
                "measured": rounded(force - zero, near),
                "sets": [rounded(x, near) for x in sets[:, t]],
                "cycles": cycles,
            }
        )
    units = found.campaign.units
    effects = [title(name) for name in names]
    return {"tests": tests, "effects": effects, "displacement": units.displacement, "force": units.force}
