"""What these tests could have shown, and which test would show more: expected evidence from the fitted models."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.limits import RigLimits
from bayes_iwan.campaign.timing.groups import SAME
from bayes_iwan.diagnosis.assessment.calibration import calibration, coarsening
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.discrepancy_size import DiscrepancySize
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.held_out_tests import parted
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.diagnosis.search.base_fit import quick_gap_N
from bayes_iwan.diagnosis.search.candidates import extra_points
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import ordered
from bayes_iwan.inference.setup.loop_error import harmonics_of
from bayes_iwan.inference.setup.spectrum import discrepancy_spectrum
from bayes_iwan.models import sine_motion
from bayes_iwan.screen import on_screen

#: an effect of typical size must promise so many nats, or these tests could not have shown it
TESTABLE_NATS = 9.0
#: a further test is recommended if it promises so much, else the bench is
LEAST_NATS = 4.0
#: a rig whose amplitude is stated also runs amplitudes down to this share of the smallest one measured; where nothing
#: is and all tests are alike, frequencies down to this share of theirs, too
SMALLER = 0.5
#: the fitted force of a planned test may exceed the limit by the gap
FORCE_MARGIN = 1.02
#: what helps where no loop test that this rig can run does, and the effects name no action at the bench
BENCH = "a rig with more force, stroke or speed"
#: harmonics that a planned test is assessed by
PLANNED_HARMONICS = 9


def visible_nats(data: GapData, base: Fit, effects: Mapping[str, tuple[Effect, ...]]) -> dict[str, float]:
    """Expected ln evidence for each effect, were it present at its typical size: half the squared signature that is
    left, in units of noise and of a specimen's usual discrepancy, once the base has refitted itself."""
    size = DiscrepancySize(calibration().usual[0], 0.05, 0.0)
    linear = base.linear
    variance = linear.variance(size)
    j = linear.jacobian / np.sqrt(variance)[:, None]
    precision = j.T @ j + np.eye(len(base.z))
    out = {}
    for name, some in effects.items():
        best = 0.0
        for effect in some:
            problem = base.problem.with_effects(ordered((*base.effects, effect)))
            rows = Rows(data, problem, base.size.between)
            own = [problem.names.index(p.name) for p in effect.parameters if p.name in problem.names]
            at = [problem.names.index(n) for n in base.problem.names]
            single = effect.strength_name in problem.names
            on, off = [], []
            tried = [own[0], *(problem.names.index(n) for n in effect.scanned if n in problem.names)]
            for extra in extra_points(len(tried) - 1) if single else [()]:
                z = np.zeros(problem.ndim)
                z[at] = base.z
                z[tried if single else own] = (0.6 if effect.signed else 0.0, *extra) if single else 1.0 / np.sqrt(2.0)
                on.append(z)
                z = z.copy()
                z[own[0] if single else own] = 0.0 if effect.signed or not single else -8.0
                off.append(z)
            s = rows.residual(np.array(on)) - rows.residual(np.array(off))
            s = s / rows.sd(size)
            shared = s[:, : len(variance)]
            b = shared @ j
            left = np.sum(s * s, axis=1) - np.einsum("ni,ni->n", b, np.linalg.solve(precision, b.T).T)
            best = max(best, 0.5 * float(np.median(left)))
        out[name] = best
    return out


@dataclass(frozen=True)
@on_screen
class NextTest:
    """The loop test that would separate two explanations best, or what to do at the bench where none would.

    frequency_hz : None without a clock; expected_log_odds : ln of the factor by which it would change the odds of the
    two, as probabilities of effects are reckoned.
    """

    frequency_hz: float | None
    amplitude_mm: float
    cycles: int
    separates: tuple[str, str]
    expected_log_odds: float
    bench: str


def plans_of(data: GapData, fit: Fit, limits: RigLimits) -> list[tuple[float, float]]:
    """Frequencies (Hz) and amplitudes (mm) that the rig can run: within what it states, else within what was measured;
    smaller amplitudes than those measured only on a rig that states its own, or where all tests are alike: then smaller
    and slower ones, which any rig runs. A test whose force, as fitted, exceeds the limit is omitted; where all do, the
    gentlest test that was run is what remains."""
    f, u = [x.frequency_hz for x in data.loops], [x.amplitude_mm for x in data.loops]
    most = limits.of_tests(f, u, max(float(np.abs(x.force_N).max()) for x in data.loops))
    assert most.force_N is not None and most.amplitude_mm is not None and most.frequency_hz is not None
    alike = limits == RigLimits() and not parted(data)
    least = min(u) if limits.amplitude_mm is None and not alike else min(SMALLER * min(u), most.amplitude_mm)
    slowest, fastest = most.frequency_hz
    slowest *= SMALLER if alike and data.loops[0].record.clock else 1.0
    grid = list(product(np.geomspace(slowest, fastest, 8), np.geomspace(least, most.amplitude_mm, 5)))
    frequency, amplitude = np.array(grid).T
    motion = sine_motion(frequency_hz=frequency, amplitude_mm=amplitude, samples=96)
    force = fit.problem.force(fit.problem.parameter_values(fit.z[None]), motion)[0]
    within = np.abs(force).max(axis=-1) <= FORCE_MARGIN * most.force_N
    return [p for p, ok in zip(grid, within) if ok] or [min(zip(f, u), key=lambda p: p[1])]


def next_test(
    data: GapData, a: Fit, b: Fit, names: tuple[str, str], bench: Sequence[str], limits: RigLimits
) -> NextTest:
    """Search frequencies and amplitudes that the rig can run for the test where two fitted models differ most, as
    either knows its own parameters by now. Both may be wrong there by what the better one misses here. Where none is
    left that was not run, only the bench helps."""
    plans = plans_of(data, a, limits)
    new = not_run(plans, data)
    plan = new or plans
    frequency, amplitude = np.array(plan).T
    motion = sine_motion(frequency_hz=frequency, amplitude_mm=amplitude, samples=96)

    def harmonics(fit: Fit) -> tuple[Array, Array]:
        """Predicted (plans, 2 H) and its Jacobian (plans, 2 H, ndim)."""
        step = 1e-3
        z = np.concatenate([fit.z[None], fit.z + step * np.eye(len(fit.z))])
        c = harmonics_of(fit.problem.force(fit.problem.parameter_values(z), motion), PLANNED_HARMONICS)
        flat = np.concatenate([c.real, c.imag[..., 1:]], axis=-1)
        return flat[0], np.moveaxis((flat[1:] - flat[0]) / step, 0, -1)

    (ya, ja), (yb, jb) = harmonics(a), harmonics(b)
    level = float(np.median(data.level_N))
    typical = max(calibration().usual[0] * level, min(quick_gap_N(data, a), quick_gap_N(data, b)))
    noise = np.array(
        [
            np.median([x.noise_N[h] for x in data.loops if np.isfinite(x.noise_N[h])] or [0.01 * level])
            for h in range(PLANNED_HARMONICS)
        ]
    )
    spectrum = discrepancy_spectrum(np.array([1.0]), np.array([0.05]), PLANNED_HARMONICS)[0] * typical**2
    diagonal = noise**2 + spectrum
    diagonal[0] += (0.01 * level) ** 2
    diagonal = np.r_[diagonal, diagonal[1:]]
    d = ya - yb
    odds = np.zeros(len(plan))
    for i in range(len(plan)):
        cov = np.diag(diagonal) + ja[i] @ a.covariance @ ja[i].T + jb[i] @ b.covariance @ jb[i].T
        if np.isfinite(cov).all() and np.isfinite(d[i]).all():  # else one of both has no force there
            odds[i] = 0.5 * d[i] @ np.linalg.solve(cov, d[i])
    best = int(np.argmax(odds))
    cycles = max(int(np.median([x.n_cycles for x in data.loops])), 20)
    promises = bool(new) and odds[best] >= LEAST_NATS
    action = "" if promises else "; or ".join(dict.fromkeys(x for x in bench if x)) or BENCH
    at = float(f"{plan[best][0]:.3g}") if data.loops[0].record.clock else None
    counted = float(odds[best]) * coarsening(data.tests + 1)
    return NextTest(at, float(f"{plan[best][1]:.3g}"), cycles, names, counted, action)


def not_run(plans: Sequence[tuple[float, float]], data: GapData) -> list[tuple[float, float]]:
    """Those of the planned tests that are not in the campaign."""
    run = np.log([(x.frequency_hz, x.amplitude_mm) for x in data.loops])
    return [p for p in plans if np.min(np.max(np.abs(np.log(p) - run), axis=1)) > SAME]
