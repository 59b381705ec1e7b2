"""The intervals that are reported: the posterior's, wider by what the posterior cannot know.

Variances add up. The posterior's own is right if the model is. Where the model's form may bend (:mod:`.bent`), the bent
form's numbers stand beside the plain one's, and what is reported is of both, averaged by their evidence: the centre
moves towards the bent form's, the widths are theirs, and how far the two are apart adds to them. How far the tests
disagree, the between-test variance (:mod:`.jackknife`), is seen without that. And no smooth family of slip forces is
nature's: the share of the elements below a slip force is off, by about the same at every quantile, and
:data:`ROUGHNESS` of it goes into the quantiles; that differs from specimen to specimen, hence Student's quantiles for
it. It was chosen on specimens of the virtual rig and counted on others; how far the share is off is told as well
(analyses/coverage_rig.py).

Some numbers are not reached by any loop: elements that slip within the finest step that the trusted harmonics resolve
after a reversal, and elements that never slip at the largest amplitude, are extrapolated by the family of slip forces
alone. That is said of them (:attr:`Widening.reach`); their intervals hold with what is added to all.

Tests of one amplitude share much of their misfit, so leaving one of them out understates how far all of them may be
off; :func:`shared` is the factor that a mean over such tests needs, and what a number of a single test gets. A number
of the specimen is no mean: :data:`BEYOND` times that. And so many tests tell the variance between them no better than
fewer independent ones would (:func:`freedom_of`).

A few tests tell the variance between them badly. So it is moderated (Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3):
beside what they show stands what is usual on the rig, :data:`USUAL` of the posterior's own variance, as if
:data:`USUAL_FREEDOM` further tests had shown it; of a single test that is all there is. Student's quantiles for the sum
follow Welch (1947) and Satterthwaite (1946). Where all draws are positive, all this is done with logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import SLIP_SHARES, quantities
from bayes_iwan.inference.solving.bent import bent_form
from bayes_iwan.inference.solving.jackknife import jackknife_variance, left_out_optima
from bayes_iwan.inference.solving.point import laplace_scale
from bayes_iwan.physics import Model

#: correlation of the misfits of two tests of one amplitude on the virtual rig; of one frequency it is 0.08, left out
#: here (both printed by analyses/coverage_rig.py)
CORRELATED = 0.62
#: further factor of the jackknife's standard deviation for numbers of the specimen, chosen on 580 specimens of the rig
#: (seeds 5401, 5501, 5601, 6703, 6701)
BEYOND = 1.6
#: usual variance between tests over the posterior's own, and the degrees of freedom that this counts for; chosen
#: on 400 specimens of the rig (seed 4101)
USUAL, USUAL_FREEDOM = 0.9, 4
#: standard deviation of the share of the elements below a slip force, for nature's slip forces are of no smooth family,
#: and its degrees of freedom; chosen on 300 specimens of the rig (seeds 7401 and 9903; 900 others with blunter gamma
#: components had asked for 0.0075)
ROUGHNESS, ROUGH_FREEDOM = 0.007, 4
#: step of the central differences, in prior standard deviations
_STEP = 1e-4
#: k(1) is extrapolated where the least slip force that loops resolve is this part of the elements' lower quartile
_WORTH_SAYING = 0.12


@dataclass(frozen=True)
class Form:
    """What the bent form says of one number. weight : its probability by evidence; about : the number at the plain
    form's most probable point, the logarithm of it where relative; shift : of the centre; ratio : of the posterior's
    standard deviation, at most 1, and of how far draws lie from `about`: where the bent form is the likelier and
    narrower one, the plain draws' own skewness counts only as far; spread : standard deviation that adds, between the
    two forms and where the bent one is wider. As in :class:`Widening` relative or not."""

    weight: float = 0.0
    about: float = 0.0
    shift: float = 0.0
    ratio: float = 1.0
    spread: float = 0.0

    def moved(self, middle: float) -> float:
        """Where the plain form's median comes to lie."""
        return self.about + self.ratio * (middle - self.about) + self.shift


@dataclass(frozen=True)
class Widening:
    """What adds to the posterior's interval of one number, beside the draws' own spread.

    between_sd : standard deviation between tests, in the number's unit, NaN for a single test; rough_sd : that of what
    no smooth family of slip forces has; freedom : degrees of freedom of between_sd; form : what the bent form says;
    usual_sd : what between_sd usually is, 0 to go by what was seen alone. All are relative to the number where
    `relative`. reach : empty, or why the number is extrapolated and what determines it.
    """

    between_sd: float
    rough_sd: float
    freedom: float
    relative: bool
    reach: str
    form: Form = Form()
    usual_sd: float = 0.0

    def alone(self) -> Widening:
        """Nothing that widens: the interval of the draws (n,) themselves."""
        return replace(self, between_sd=float("nan"), rough_sd=0.0, form=Form(), usual_sd=0.0)

    @property
    def moderated(self) -> tuple[float, float]:
        """Variance between tests as it goes into the interval, and its degrees of freedom."""
        seen = 0.0 if math.isnan(self.between_sd) else self.freedom
        usual = USUAL_FREEDOM if self.usual_sd > 0.0 else 0
        if seen + usual == 0:
            return 0.0, math.inf
        shown = seen * self.between_sd**2 if seen else 0.0
        return (shown + usual * self.usual_sd**2) / (seen + usual), seen + usual

    def centre(self, draws: Array) -> float:
        """The median that is reported of draws (n,)."""
        middle = float(np.median(draws))
        return math.exp(self.form.moved(math.log(middle))) if self.relative else self.form.moved(middle)

    def interval(self, draws: Array, level: float = 0.9) -> tuple[float, float]:
        """Central interval (low, high) of the draws (n,) with all variances."""
        tail = 0.5 * (1.0 - level)
        x = np.log(draws) if self.relative else draws
        low, middle, high = np.quantile(x, [tail, 0.5, 1.0 - tail])
        below, above = (self.form.ratio * (middle - low), self.form.ratio * (high - middle))
        middle = self.form.moved(float(middle))
        between, freedom = self.moderated
        normal = float(stats.norm.isf(tail))
        others = between + self.rough_sd**2 + self.form.spread**2
        total = ((below + above) / (2.0 * normal)) ** 2 + others
        if total == 0.0 or not math.isfinite(total):
            return float(np.quantile(draws, tail)), float(np.quantile(draws, 1.0 - tail))
        uncertain = between**2 / freedom + self.rough_sd**4 / ROUGH_FREEDOM
        student = float(stats.t.isf(tail, total**2 / uncertain)) if uncertain > 0.0 else normal
        added = others * normal**2
        factor = student / normal
        below = middle - factor * math.hypot(below, added**0.5)
        above = middle + factor * math.hypot(above, added**0.5)
        return (math.exp(below), math.exp(above)) if self.relative else (float(below), float(above))


@dataclass(frozen=True)
class Reach:
    """What the loops of a campaign reach: slip forces from lowest_N to highest_N, steps from step_mm on.

    part : lowest_N over the lower quartile of the slip forces; amplitudes_mm : of the tests.
    """

    step_mm: float
    lowest_N: float
    highest_N: float
    part: float
    amplitudes_mm: tuple[float, float]


def reach_of(problem: Problem, z: Array) -> Reach | None:
    """The reach of a problem's loops at z (ndim,); None for a simulator without slip forces.

    Within a phase of π/H after a reversal, H the highest trusted harmonic, the displacement has moved A(1 − cos(π/H)).
    Elements up to φ = k(1)·step/2 have slipped by then. Those beyond k(1)·A never slip.
    """
    model = problem.model
    if not isinstance(model, Model):
        return None
    steps = [_step_mm(x) for x in problem.loops]
    amplitudes = [x.amplitude_mm for x in problem.loops]
    parameter_values = problem.parameter_values(z[None])
    k1 = float(parameter_values["k1_N_mm"][0])
    lowest, highest = 0.5 * k1 * min(steps), k1 * max(amplitudes)
    quartile = float(
        _quantiles(model, parameter_values, np.array([0.25]), 4.0 * max(highest, problem.scales.slip_N))[0]
    )
    return Reach(min(steps), lowest, highest, lowest / quartile, (min(amplitudes), max(amplitudes)))


def _step_mm(loop: Loop) -> float:
    order = int(np.max(np.nonzero(np.isfinite(loop.noise_N))[0]))
    return loop.amplitude_mm * (1.0 - math.cos(math.pi / max(order, 1)))


def widenings(problem: Problem, z: Array, loops: Sequence[Loop] | None = None) -> dict[str, Widening]:
    """By name, for every reported quantity of the tests `loops`, at the most probable point z (ndim,)."""
    freedom = freedom_of([x.amplitude_mm for x in problem.loops])
    plain, bent = _judged(problem, z, loops), bent_form(problem, z)
    beside = None if bent is None else _judged(bent.problem, bent.z, loops)
    weight = 0.0 if bent is None else bent.weight
    reach = reach_of(problem, z)
    told = {} if reach is None else _beyond_family(problem, z, reach)
    out = {}
    for name, own in plain.items():
        other = own if beside is None else beside[name]
        relative = own.relative and other.relative
        a, b = (x if relative else x.plain() for x in (own, other))
        between = math.sqrt((1.0 - weight) * a.between_sd**2 + weight * b.between_sd**2)
        usual = math.sqrt(USUAL * ((1.0 - weight) * a.sd**2 + weight * b.sd**2))
        form = _form(weight, a.value, b.value, a.sd, b.sd)
        sd, why = told.get(name, (0.0, ""))
        sd = sd if relative else sd * own.plain().value
        out[name] = Widening(between, sd, freedom, relative, why, form, usual)
    return out


def _form(weight: float, at: float, other: float, sd: float, other_sd: float) -> Form:
    """Mean and variance of a mixture of the two forms, one's number `at`, the other's `other`. Where the bent form is
    the wider one its variance adds, so that a posterior wider than its normal approximation is not stretched."""
    more, apart = weight * (other_sd**2 - sd**2), other - at
    form = Form(
        weight,
        at,
        weight * apart,
        math.sqrt(1.0 + more / sd**2) if more < 0.0 else 1.0,
        math.sqrt(weight * (1.0 - weight) * apart**2 + max(more, 0.0)),
    )
    return form if math.isfinite(form.shift) and math.isfinite(form.spread) else Form(weight)


@dataclass(frozen=True)
class _Judged:
    """One number at an optimum: its value, standard deviation to first order and between tests; of its logarithm
    where `relative`."""

    value: float
    sd: float
    between_sd: float
    relative: bool

    def plain(self) -> _Judged:
        """The same of the number itself."""
        if not self.relative:
            return self
        value = math.exp(self.value)
        return _Judged(value, self.sd * value, self.between_sd * value, False)


def _judged(problem: Problem, z: Array, loops: Sequence[Loop] | None) -> dict[str, _Judged]:
    """Every reported quantity at the most probable point z (ndim,)."""
    tests, n, root = len(problem.loops), problem.ndim, laplace_scale(problem, z)
    of_test = shared([x.amplitude_mm for x in problem.loops])
    without = left_out_optima(problem, z) if tests > 1 else z[None]
    found = quantities(problem, np.concatenate([z[None], z + _STEP * np.eye(n), z - _STEP * np.eye(n), without]), loops)
    out = {}
    for name, quantity in found.items():
        relative = bool(np.all(quantity.values > 0.0))
        x = np.log(quantity.values) if relative else quantity.values
        sd = float(np.linalg.norm(root.T @ (x[1 : n + 1] - x[n + 1 : 2 * n + 1]) / (2.0 * _STEP)))
        factor = of_test if name.endswith("]") else BEYOND * of_test
        between = factor * float(np.sqrt(jackknife_variance(x[2 * n + 1 :]))) if tests > 1 else float("nan")
        out[name] = _Judged(float(x[0]), sd, between, relative)
    return out


def shared(amplitudes_mm: Sequence[float]) -> float:
    """What the jackknife's standard deviation of a mean over tests (T,) must be multiplied by, where those of one
    amplitude are correlated by ρ: with P = ρ times the number of ordered pairs of one amplitude, the mean's variance is
    1 + P/T times that of independent tests, and the jackknife expects 1 − P/(T(T − 1)) times that."""
    tests = len(amplitudes_mm)
    pairs = CORRELATED * sum(len(g) * (len(g) - 1) for g in groups_of(amplitudes_mm))
    return math.sqrt((1.0 + pairs / tests) / (1.0 - pairs / (tests * (tests - 1)))) if tests > 1 else 1.0


def freedom_of(amplitudes_mm: Sequence[float]) -> float:
    """Degrees of freedom of the variance between tests (T,), those of one amplitude correlated by ρ: of a sum of
    squares about the mean, (tr CR)²/tr (CR)², C the centring matrix and R the correlations (Box, Ann. Math. Stat. 25
    (1954) 290); T − 1 where all amplitudes differ, 0 for a single test."""
    tests = len(amplitudes_mm)
    if tests < 2:
        return 0.0
    correlation = np.eye(tests)
    for group in groups_of(amplitudes_mm):
        correlation[np.ix_(group, group)] += CORRELATED * (1.0 - np.eye(len(group)))
    about_mean = correlation - correlation.mean(axis=0)
    return float(np.trace(about_mean) ** 2 / np.sum(about_mean * about_mean.T))


def between_draws(without: Array, amplitudes_mm: Sequence[float], draws: int, rng: np.random.Generator) -> Array:
    """(draws, …) N(0, between-test covariance) of any array, e.g. forces; without (tests, …): it without each test,
    amplitudes_mm (tests,) of these."""
    tests = len(without)
    if tests < 2:
        return np.zeros((draws, *without.shape[1:]))
    factor = BEYOND * shared(amplitudes_mm) * math.sqrt((tests - 1) / tests)
    return np.tensordot(rng.standard_normal((draws, tests)), (without - without.mean(axis=0)) * factor, axes=1)


def _beyond_family(problem: Problem, z: Array, reach: Reach) -> dict[str, tuple[float, str]]:
    """Relative standard deviation of what no smooth family has, and why the number is extrapolated, "" where it is not,
    by name."""
    model = problem.model
    assert isinstance(model, Model)
    parameter_values = problem.parameter_values(z[None])
    said = (
        f"extrapolated below a slip force of {reach.lowest_N:.3g} N: no step under {reach.step_mm:.2g} mm is resolved; "
        f"determined by amplitudes {reach.amplitudes_mm[0]:.3g} to {reach.amplitudes_mm[1]:.3g} mm"
    )
    out = {"k1_N_mm": (0.0, said if reach.part > _WORTH_SAYING else "")}
    shares = np.array(SLIP_SHARES)
    moved = np.concatenate([shares, np.clip(shares - ROUGHNESS, 1e-3, None)])
    at = _quantiles(model, parameter_values, moved, 4.0 * max(reach.highest_N, problem.scales.slip_N))
    for share, middle, other in zip(SLIP_SHARES, at[: len(shares)], at[len(shares) :]):
        why = said if middle < reach.lowest_N else ""
        if middle > reach.highest_N:
            why = f"extrapolated: elements above {reach.highest_N:.3g} N never slip at the largest amplitude"
        out[f"slip_force_q{round(100 * share):02d}_N"] = (abs(math.log(middle / other)), why)
    return out


def _quantiles(model: Model, parameter_values: ParameterValues, shares: Array, top_N: float) -> Array:
    """(shares,) N of one draw."""
    phi = top_N * np.linspace(0.0, 1.0, 4000) ** 3
    below = np.maximum.accumulate(1.0 - model.slip_family.survival(phi, parameter_values)[0])
    return np.maximum(np.interp(shares, below, phi), 1e-9 * top_N)
