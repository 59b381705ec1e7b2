"""The data from which the loop viewer of a page draws one chosen test."""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.wording import title
from bayes_iwan.diagnosis.fits.data import predicted
from bayes_iwan.models.simulator import straight_part
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import Predictive, measured_cycles

#: draws and measured cycles of one test, at most, and of all tests together, but for two of each
DRAWS, CYCLES, TOGETHER = 16, 8, 160
#: effects that can be switched: each doubles the loops that a page holds
MOST = 4
#: samples of a loop that a screen can show
SAMPLES = 128


def rounded(x: Array, digits: int) -> list[float]:
    return [float(v) for v in np.round(x, digits)]


def _places(amplitude_mm: float, friction_N: float) -> tuple[int, int]:
    """Decimal places of displacements and forces that a screen can show of a loop."""
    far, near = (int(n - np.floor(np.log10(max(x, 1e-9)))) for n, x in ((4, amplitude_mm), (3, friction_N)))
    return max(0, far), max(0, near)


def _of_each(most: int, tests: int) -> int:
    """How many draws or cycles of each test a page holds that `most` are shown of."""
    return max(2, min(most, TOGETHER // tests))


def _cycles(loop: Loop, tests: int, zero_N: float, places: tuple[int, int]) -> list[list[list[float]]]:
    cycles = []
    for u, force in measured_cycles(loop, _of_each(CYCLES, tests)):
        step = max(1, len(u) // 160)
        cycles.append([rounded(u[::step], places[0]), rounded(force[::step] - zero_N, places[1])])
    return cycles


def viewer_data(p: Predictive) -> dict[str, object]:
    """What the viewer needs of each test, rounded to what a screen can show."""
    tests = []
    for t, loop in enumerate(p.loops):
        far, near = _places(loop.amplitude_mm, float(np.ptp(p.measured_N[t] - p.spring_N[t])))
        slope, zero = np.polyfit(p.displacement_mm[t], p.spring_N[t], 1)
        picked = np.linspace(0, len(p.force_N) - 1, min(_of_each(DRAWS, len(p.loops)), len(p.force_N))).astype(int)
        low, high = (np.quantile(p.force_N[:, t], q, axis=0) for q in ([0.05, 0.25], [0.75, 0.95]))
        bands = [np.quantile(x[:, t], [0.05, 0.25, 0.75, 0.95], axis=0) for x in (p.cycle_N, p.loop_N)]
        found: dict[str, object] = {
            "name": loop.record.units.said(test_name(loop)),
            "file": loop.file,
            "u": rounded(p.displacement_mm[t], far),
            "slope": float(slope),
            "zero": float(zero),
            "measured": rounded(p.measured_N[t], near),
        }
        lines = {"model": (*low, p.median_N[t], *high), "cycle": bands[0], "loop": bands[1]}
        lines["draws"] = tuple(p.force_N[picked, t])
        found |= {n: [rounded(x, near) for x in some] for n, some in lines.items()}
        tests.append(found | {"cycles": _cycles(loop, len(p.loops), float(p.zero_N[t]), (far, near))})
    units = p.loops[0].record.units
    return {"tests": tests, "displacement": units.displacement, "force": units.force}


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


def effect_viewer_data(found: Diagnosis) -> dict[str, object]:
    """:func:`viewer_data` of a diagnosed model with each named effect in it and without it.

    "effects" : their names; in each test, in the place of model, draws and bands, "sets" : the predicted force for each
    set of effects, as :func:`effect_sets` numbers them.
    """
    names, sets = effect_sets(found)
    problem = found.fit.problem
    springs = problem.model.spring_N_mm(problem.parameter_values(found.fit.z[None]))
    step, tests = _step(found), []
    for t, loop in enumerate(found.data.loops):
        u, force = loop.displacement_mm[::step], loop.force_N[::step]
        zero = float(force.mean())
        line = np.polyfit(u, straight_part(force - zero, u), 1) if springs is None else np.array([springs[0], 0.0])
        places = _places(loop.amplitude_mm, float(np.ptp(force - np.polyval(line, u))))
        tests.append(
            {
                "name": loop.record.units.said(test_name(loop)),
                "u": rounded(u, places[0]),
                "slope": float(line[0]),
                "zero": float(line[1]),
                "measured": rounded(force - zero, places[1]),
                "sets": [rounded(x, places[1]) for x in sets[:, t]],
                "cycles": _cycles(loop, len(found.data.loops), zero, places),
            }
        )
    units = found.campaign.units
    effects = [title(name) for name in names]
    return {"tests": tests, "effects": effects, "displacement": units.displacement, "force": units.force}
