"""Effects on top of a fitted model, not yet refitted: where to start, and what one Gauss–Newton step promises."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.fits.data import GapData, predicted
from bayes_iwan.diagnosis.fits.discrepancy_size import FIRST, DiscrepancySize, normal_equations
from bayes_iwan.diagnosis.fits.evidence import Fit, newton_size
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.diagnosis.search.base_fit import newton_nats, sound_gap_N
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import ordered
from bayes_iwan.fitting.descent import descend
from bayes_iwan.fitting.least_squares import half_square
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models.parameter import Z_LIMIT

#: z of the strength, signed or not, and of extra parameters at which an effect is tried
STRENGTHS = {False: (-2.0, -1.0, -0.2, 0.6, 1.4, 2.2), True: (-1.2, -0.4, 0.4, 1.2)}
EXTRAS = (-1.6, -0.8, 0.0, 0.8, 1.6)
#: smallest share of the friction level at which a step is assessed
LEAST_SHARE = 1e-3
#: step of the differences behind a trial's own Jacobian, and the longest step that is believed of it, in prior sd
STEP, LONGEST = 1e-3, 1.5
#: trial points from which an effect is fitted in another one's place, and steps of that
PLACES, IN_PLACE = 3, 12


@dataclass(frozen=True)
class Candidate:
    """An effect on a smaller model: where its refit starts, (starts, ndim), the nats of evidence that one step
    promises, and all that is promised: these, and those of the gap in newtons that another step would leave."""

    effect: Effect
    problem: Problem
    starts: Array
    gain: float
    score: float

    @property
    def name(self) -> str:
        return self.effect.name


def on_top(smaller: Fit, effect: Effect) -> Problem:
    """The problem of a fit with one effect more."""
    return smaller.problem.with_effects(ordered((*smaller.effects, effect)))


def weighed_alike(data: GapData, fit: Fit) -> Fit:
    """A fit, at its optimum, in rows that weigh all residuals alike, as newtons do."""
    size = newton_size(max(fit.discrepancy_share[0], LEAST_SHARE))
    return replace(fit, size=size, linear=Rows(data, fit.problem, size.between).linear(fit.z))


def candidate(data: GapData, smaller: Fit, alike: Fit, gap_N: float, effect: Effect) -> Candidate:
    """One effect on top of a smaller fit; alike : see :func:`weighed_alike`; gap_N : the RMS gap, which counts where it
    is more than a sound specimen's."""
    optima = np.concatenate([smaller.z[None], smaller.optima[1:2]])
    at = replace(smaller.size, share=max(smaller.size.share, LEAST_SHARE), along=max(smaller.size.along, FIRST.along))
    problem = on_top(smaller, effect)
    rows = Rows(data, problem, smaller.size.between)
    points = start_points(effect, problem, optima, smaller.problem.names)
    with np.errstate(all="ignore"):
        by_model = predicted(data, problem, points)
        residual = rows.residual_from(by_model)
    start, gain = promising(rows, points, residual, smaller, at)
    if effect.strength_name not in problem.names:  # a number for each test: nothing of it is in any start
        gain = stepped(rows, points[0], smaller, at)
    if gap_N <= sound_gap_N(data):
        return Candidate(effect, problem, start[None], gain, gain)
    plain = Rows(data, problem, alike.size.between)
    with np.errstate(all="ignore"):
        nearest, less = promising(plain, points, plain.residual_from(by_model), alike, alike.size)
    removes = less / max(_cost(plain, alike, alike.size), 1e-300)
    left_N = gap_N * float(np.sqrt(np.clip(1.0 - removes, 0.0, 1.0)))
    sound_N = sound_gap_N(data)
    score = gain + newton_nats(left_N, sound_N, data.tests) - newton_nats(gap_N, sound_N, data.tests)
    return Candidate(effect, problem, np.stack([start, nearest]), gain, score)


def failing(data: GapData, smaller: Fit, effect: Effect) -> str:
    """Why an effect cannot be used on these tests, "" where it can: its force at its typical strength is not finite."""
    if effect.strength_value is not None and not np.isfinite(effect.strength_value):
        return "its strength could not be calibrated: no strength gives a finite change of the force"
    if not effect.possible(data):
        return ""
    problem = on_top(smaller, effect)
    z = np.zeros((1, problem.ndim))
    z[0, [problem.names.index(n) for n in smaller.problem.names]] = smaller.z
    with np.errstate(all="ignore"):
        finite = bool(np.all(np.isfinite(Rows(data, problem).residual(z))))
    return "" if finite else "its force is not finite (NaN or infinite) at its typical strength"


def extra_points(extras: int) -> list[tuple[float, ...]]:
    """z of an effect's extra parameters at which it is tried: fewer values of each where there are several."""
    return list(product(EXTRAS if extras == 1 else EXTRAS[::2], repeat=extras))


def start_points(effect: Effect, problem: Problem, optima: Array, base_names: Sequence[str]) -> Array:
    """Trial points (n, ndim) of an extended problem: each optimum of the smaller model with the effect switched on."""
    own = [problem.names.index(p.name) for p in effect.parameters if p.free and p.name in problem.names]
    at = [problem.names.index(n) for n in base_names]
    single = effect.strength_name in problem.names
    grid = [(0.0,) * len(own)]
    if single:
        tried = [problem.names.index(n) for n in (effect.strength_name, *effect.scanned) if n in problem.names]
        grid = []
        for s, others in product(STRENGTHS[effect.signed], extra_points(len(tried) - 1)):
            at_trial = dict(zip(tried, (s, *others)))
            grid.append(tuple(at_trial.get(i, 0.0) for i in own))
    out = []
    for optimum, values in product(optima, grid):
        z = np.zeros(problem.ndim)
        z[at] = optimum
        z[own] = values
        out.append(z)
    return np.array(out)


def in_place(data: GapData, fit: Fit, problem: Problem, effect: Effect) -> Array:
    """(ndim,) where the refit of a problem starts in which an effect replaces another one of a fit: all other numbers
    as they are there, and the effect's own where it alone does what the other did.

    Beside the refitted smaller model its first step leads where the base has made up for both; what two that look
    alike have in common lies elsewhere.
    """
    others = [n for n in fit.problem.names if n in problem.names]
    at = fit.z[None, [fit.problem.names.index(n) for n in others]]
    points = start_points(effect, problem, at, others)
    own = [i for i, n in enumerate(problem.names) if n not in others]
    rows = Rows(data, problem, fit.size.between)
    sd = rows.sd(fit.size)

    def residuals(z: Array) -> Array:
        every = np.repeat(points[:1], len(z), axis=0)
        every[:, own] = z
        with np.errstate(all="ignore"):
            return np.concatenate([rows.residual(every) / sd, z], axis=1)

    tried = points[:, own]
    nearest = np.argsort(half_square(residuals(tried)))[:PLACES]
    ended = descend(residuals, tried[nearest], np.tile([-Z_LIMIT, Z_LIMIT], (len(own), 1)), IN_PLACE)
    start = points[0].copy()
    start[own] = ended.x[ended.best]
    return start


def promising(rows: Rows, points: Array, residual: Array, smaller: Fit, size: DiscrepancySize) -> tuple[Array, float]:
    """Of trial points (n, ndim) with their residuals (n, m): where that whose cost is least after one step of the
    smaller model's parameters leads in one step of all parameters, where that helps, and its promised gain in nats over
    the smaller model."""
    names = rows.problem.names
    at = [names.index(n) for n in smaller.problem.names]
    variance = smaller.linear.variance(size)
    j = smaller.linear.jacobian / np.sqrt(variance)[:, None]
    n_shared = len(variance)
    r = residual / rows.sd(size)
    good = np.all(np.isfinite(r), axis=1)
    r = np.where(good[:, None], r, 0.0)
    shared, others = r[:, :n_shared], r[:, n_shared:]
    precision = j.T @ j + np.eye(len(at))
    z0 = points[:, at]
    b = shared @ j - z0  # minimise |r − J d|² + |z0 + d|²
    gain = np.einsum("ni,ni->n", b, np.linalg.solve(precision, b.T).T)
    cost = np.sum(shared**2, axis=1) + np.sum(others**2, axis=1) + np.sum(points**2, axis=1) - gain
    cost = np.where(good, cost, np.inf)
    i = int(np.argmin(cost))
    start, least = points[i], float(cost[i])
    if good[i]:
        own = [i for i in range(len(names)) if i not in at]
        moved, its_cost = stepped_on(rows, start, r[i], j, at, own, rows.sd(size))
        if its_cost < least:
            start, least = moved, its_cost
    return start, _cost(rows, smaller, size) - 0.5 * least


def stepped_on(
    rows: Rows, point: Array, residual: Array, shared: Array, at: list[int], own: list[int], sd: Array
) -> tuple[Array, float]:
    """Where one Gauss–Newton step of the effect's own parameters and the smaller model's leads from a trial point, and
    what that costs: a law's shape may matter more than its strength, and trial points have few shapes.

    residual (m,) there and shared (m of the smaller model, ndim of it), its Jacobian, both in units of `sd`
    """
    j = np.zeros((len(residual), len(point)))
    j[: len(shared), at] = shared
    with np.errstate(all="ignore"):
        tried = point + STEP * np.eye(len(point))[own]
        j[:, own] = (residual - rows.residual(tried) / sd).T / STEP  # residual = measured − predicted
        if not np.all(np.isfinite(j)):
            return point, np.inf
        b, precision = normal_equations(j, residual, point)
        step = np.linalg.solve(precision, b)
        moved = point + np.clip(step, -LONGEST, LONGEST)
        left = rows.residual(moved[None])[0] / sd
    cost = float(left @ left + moved @ moved)
    return moved, cost if np.isfinite(cost) else np.inf


def stepped(rows: Rows, point: Array, smaller: Fit, size: DiscrepancySize) -> float:
    """The gain in nats over the smaller model that one Gauss–Newton step of all parameters promises from a point, less
    what so many parameters cost (the evidence's Occam factor)."""
    linear = rows.linear(point)
    sd = rows.sd(size)
    j, r = linear.jacobian / sd[:, None], linear.residual / sd
    b, precision = normal_equations(j, r, point)
    after = r @ r + point @ point - b @ np.linalg.solve(precision, b)
    mine = smaller.linear.jacobian / np.sqrt(smaller.linear.variance(size))[:, None]
    occam = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(mine.T @ mine + np.eye(mine.shape[1]))[1]
    return _cost(rows, smaller, size) - 0.5 * float(after + occam)


def _cost(rows: Rows, smaller: Fit, size: DiscrepancySize) -> float:
    """Half the squared residuals of a smaller model, in the rows of a larger one, less what a step of its own would
    gain: at another size of the discrepancy than its own it is not at its optimum."""
    sd = np.sqrt(smaller.linear.variance(size))
    mine, j = smaller.linear.residual / sd, smaller.linear.jacobian / sd[:, None]
    b, precision = normal_equations(j, mine, smaller.z)
    own = b @ np.linalg.solve(precision, b)
    theirs = Rows(rows.data, smaller.problem, rows.between)
    steady = 0.0 if theirs.evolving or not rows.evolving else theirs.layout.steady_cost(size)
    return 0.5 * float(mine @ mine + smaller.z @ smaller.z - own) + steady
