"""Refits of every candidate together with the base model, from several starts, then of pairs, stepwise.

A missed optimum of the base is the commonest false gap, so the base starts from many points and again from the
optima of the best extended models. An effect starts from the base's optima at several strengths and shapes: those
that promise most once the base's own parameters may move (one Gauss–Newton step).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.effects import catalogue
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import ordered, unlisted
from bayes_iwan.gap.data import GapData
from bayes_iwan.gap.evidence import FIRST, Fit, Linear, Rows, base_problem, extended, fit_model
from bayes_iwan.gap.strength import calibrated
from bayes_iwan.inference.problem import Problem
from bayes_iwan.inference.scales import Scales
from bayes_iwan.physics import Simulator

BASE_POINTS, BASE_STARTS = 600, 16
#: z of the strength and of shapes at which an effect is tried
STRENGTHS = {False: (-2.4, -1.6, -0.8, -0.3, 0.2, 0.7, 1.2, 1.8, 2.4), True: (-1.2, -0.4, 0.4, 1.2)}
SHAPES = (-1.6, -0.8, 0.0, 0.8, 1.6)
EFFECT_STARTS = 3
#: single effects are refitted if they are among so many most promising ones, or promise as much as a second one must,
#: or are sudden
SINGLE_MOST = 7
#: a second effect is refitted if one Gauss–Newton step promises this many nats, and at most so many are
PAIR_PROMISE, PAIR_MOST = 3.0, 5


@dataclass(frozen=True)
class Search:
    """All fits of one campaign: the base, every variant of every effect by name, the pairs that promised much, and the
    shapes without a cause (:mod:`.effects_unlisted`) that did."""

    data: GapData
    scales: Scales
    config: dict
    base: Fit
    singles: dict[str, tuple[Fit, ...]]
    pairs: dict[tuple[str, str], Fit]
    effects: dict[str, tuple[Effect, ...]]
    unlisted: dict[str, Fit] = field(default_factory=dict)


def fit_base(
    data: GapData, config: dict, scales: Scales, rng: np.random.Generator, simulator: Simulator | None = None
) -> Fit:
    """The base model from the best of many prior draws."""
    problem = base_problem(data, config, scales, simulator)
    return fit_model(data, problem, best_draws(data, problem, BASE_POINTS, BASE_STARTS, rng))


def best_draws(data: GapData, problem: Problem, points: int, most: int, rng: np.random.Generator) -> Array:
    """(most, ndim) the prior draws of least cost."""
    z = problem.prior.draw(rng, points)
    rows = Rows(data, problem)
    sd = np.sqrt(Linear(np.zeros(0), np.zeros((0, 0)), rows.eigen, rows.order, np.zeros(0)).variance(0.05, FIRST[1]))
    cost = np.sum((rows.residual(z) / sd) ** 2, axis=1) + np.sum(z * z, axis=1)
    return z[np.argsort(np.where(np.isfinite(cost), cost, np.inf))[:most]]


def shape_points(shapes: int) -> list[tuple[float, ...]]:
    """z of an effect's shapes at which it is tried: fewer values of each where there are several."""
    return list(product(SHAPES if shapes == 1 else SHAPES[::2], repeat=shapes))


def start_points(effect: Effect, problem: Problem, optima: Array, base_names: Sequence[str]) -> Array:
    """Trial points (n, ndim) of an extended problem: each optimum of the smaller model with the effect switched on."""
    own = [problem.names.index(p.name) for p in effect.parameters if p.free and p.name in problem.names]
    at = [problem.names.index(n) for n in base_names]
    single = effect.strength_name in problem.names
    grid = [(0.0,) * len(own)]
    if single:
        tried = [problem.names.index(n) for n in (effect.strength_name, *effect.scanned) if n in problem.names]
        grid = []
        for s, rest in product(STRENGTHS[effect.signed], shape_points(len(tried) - 1)):
            at_trial = dict(zip(tried, (s, *rest)))
            grid.append(tuple(at_trial.get(i, 0.0) for i in own))
    out = []
    for optimum, values in product(optima, grid):
        z = np.zeros(problem.ndim)
        z[at] = optimum
        z[own] = values
        out.append(z)
    return np.array(out)


def promising(rows: Rows, points: Array, smaller: Fit, share: float, length: float, most: int) -> tuple[Array, float]:
    """The `most` points whose cost is least after one step of the smaller model's parameters, and the promised gain
    in nats of the best over the smaller model."""
    names = rows.problem.names
    at = [names.index(n) for n in smaller.problem.names]
    variance = smaller.linear.variance(share, length)
    j = smaller.linear.jacobian / np.sqrt(variance)[:, None]
    n_shared = len(variance)
    sd = np.sqrt(Linear(np.zeros(0), np.zeros((0, 0)), rows.eigen, rows.order, np.zeros(0)).variance(share, length))
    r = rows.residual(points) / sd
    good = np.all(np.isfinite(r), axis=1)
    r = np.where(good[:, None], r, 0.0)
    shared, rest = r[:, :n_shared], r[:, n_shared:]
    precision = j.T @ j + np.eye(len(at))
    z0 = points[:, at]
    b = shared @ j - z0  # minimise |r − J d|² + |z0 + d|²
    gain = np.einsum("ni,ni->n", b, np.linalg.solve(precision, b.T).T)
    cost = np.sum(shared**2, axis=1) + np.sum(rest**2, axis=1) + np.sum(points**2, axis=1) - gain
    cost = np.where(good, cost, np.inf)
    order = np.argsort(cost)
    return points[order[:most]], _cost(rows, smaller, share, length) - 0.5 * float(cost[order[0]])


def stepped(rows: Rows, point: Array, smaller: Fit, share: float, length: float) -> float:
    """The gain in nats over the smaller model that one Gauss–Newton step of all numbers promises from a point."""
    linear = rows.linear(point)
    sd = np.sqrt(linear.variance(share, length))
    j, r = linear.jacobian / sd[:, None], linear.residual / sd
    b = j.T @ r - point
    after = r @ r + point @ point - b @ np.linalg.solve(j.T @ j + np.eye(len(point)), b)
    return _cost(rows, smaller, share, length) - 0.5 * float(after)


def _cost(rows: Rows, smaller: Fit, share: float, length: float) -> float:
    """Half the squared residuals of a smaller model at its optimum, in the rows of a larger one."""
    mine = smaller.linear.residual / np.sqrt(smaller.linear.variance(share, length))
    constant = -2.0 * (Rows(rows.data, smaller.problem).constant - rows.constant)
    return 0.5 * float(mine @ mine + smaller.z @ smaller.z + constant)


@dataclass(frozen=True)
class Candidate:
    """An effect on top of a smaller model, before it is refitted: where to start and what one step promises."""

    name: str
    problem: Problem
    starts: Array
    gain: float


def candidates(data: GapData, smaller: Fit, effects: dict[str, tuple[Effect, ...]]) -> list[Candidate]:
    """All effects (each variant) that the records allow on top of a smaller fit, the most promising first."""
    out = []
    optima = np.concatenate([smaller.z[None], smaller.optima[1:3]])
    for name, some in effects.items():
        for effect in some:
            if not effect.possible(data):
                continue
            problem = extended(smaller.problem, ordered((*smaller.effects, effect)))
            points = start_points(effect, problem, optima, smaller.problem.names)
            at = max(smaller.share, 1e-3), smaller.length
            starts, gain = promising(Rows(data, problem), points, smaller, *at, EFFECT_STARTS)
            if effect.strength_name not in problem.names:  # a number for each test: nothing of it is in any start
                gain = stepped(Rows(data, problem), points[0], smaller, *at)
            out.append(Candidate(name, problem, starts, gain))
    return sorted(out, key=lambda c: -c.gain)


def search(
    data: GapData,
    scales: Scales,
    config: dict,
    kinds: dict[str, tuple[catalogue.Maker, ...]],
    rng: np.random.Generator,
    progress: Callable[[str], None] = lambda what: None,
    base: Fit | None = None,
    simulator: Simulator | None = None,
) -> Search:
    """Fit the base (unless it is given), every single effect, then pairs around the best single one."""
    if base is None:
        progress("base model")
        base = fit_base(data, config, scales, rng, simulator)
    effects = {
        name: tuple(calibrated(k, scales, data, base.problem, base.z) for k in classes)
        for name, classes in kinds.items()
    }

    def all_singles(base: Fit) -> dict[str, tuple[Fit, ...]]:
        out: dict[str, tuple[Fit, ...]] = {name: () for name in effects}
        for i, one in enumerate(candidates(data, base, effects)):
            sudden, starts = effects[one.name][0].sudden, one.starts
            if i < SINGLE_MOST or one.gain > PAIR_PROMISE or sudden:
                progress(one.name)
                if sudden:  # the base may have bent too far to lead there
                    starts = np.concatenate([starts, best_draws(data, one.problem, BASE_POINTS, EFFECT_STARTS, rng)])
                out[one.name] += (fit_model(data, one.problem, starts, iterations=20),)
        return out

    singles = all_singles(base)
    better = _base_again(data, base, singles)
    if better.log_z.max() > base.log_z.max() + 1.0:  # the base had missed its optimum: once more from there
        base, singles = better, all_singles(better)
    pairs = _pairs(data, base, singles, effects, progress)
    singles = _singles_again(data, singles, pairs)
    return Search(data, scales, config, base, singles, pairs, effects, _unlisted(data, scales, base, progress))


def _singles_again(
    data: GapData, singles: dict[str, tuple[Fit, ...]], pairs: dict[tuple[str, str], Fit]
) -> dict[str, tuple[Fit, ...]]:
    """The two effects of the best pair, each alone from its part of its pairs' optima: a single effect that had missed
    its optimum would make any idle second one look needed."""
    leading = max(pairs, key=lambda k: pairs[k].log_z.max(), default=())
    out = dict(singles)
    for name in leading:
        fits = sorted(singles[name], key=lambda f: -f.log_z.max())
        with_it = sorted((f for k, f in pairs.items() if name in k), key=lambda f: -f.log_z.max())[:4]
        starts = [
            f.z[[f.problem.names.index(n) for n in fits[0].problem.names]]
            for f in with_it
            if fits and set(fits[0].problem.names) <= set(f.problem.names)
        ]  # the same variant
        if starts and with_it[0].log_z.max() > fits[0].log_z.max():
            again = fit_model(data, fits[0].problem, np.array([fits[0].z, *starts]), iterations=20)
            if again.log_z.max() > fits[0].log_z.max():
                out[name] = (again, *fits[1:])
    return out


def _base_again(data: GapData, base: Fit, singles: dict[str, tuple[Fit, ...]]) -> Fit:
    """The base from its part of the best extended optima."""
    leaders = sorted((f for fits in singles.values() for f in fits), key=lambda f: -f.log_z.max())[:4]
    starts = [f.z[[f.problem.names.index(n) for n in base.problem.names]] for f in leaders]
    return fit_model(data, base.problem, np.array([base.z, *starts]), iterations=40)


def _unlisted(data: GapData, scales: Scales, base: Fit, progress: Callable[[str], None]) -> dict[str, Fit]:
    """Shapes without a cause that promise as much as a second effect must."""
    shapes: dict[str, tuple[Effect, ...]] = {
        k.name: (calibrated(k, scales, data, base.problem, base.z),) for k in unlisted(base.problem.model)
    }
    out = {}
    for one in candidates(data, base, shapes):
        if one.gain > PAIR_PROMISE:
            progress(one.name)
            out[one.name] = fit_model(data, one.problem, one.starts, iterations=20)
    return out


def _pairs(
    data: GapData,
    base: Fit,
    singles: dict[str, tuple[Fit, ...]],
    effects: dict[str, tuple[Effect, ...]],
    progress: Callable[[str], None],
) -> dict[tuple[str, str], Fit]:
    """The best single effect with each other one; then the best partner with each other one (swap)."""
    best = {name: max(fits, key=lambda f: f.log_z.max()) for name, fits in singles.items() if fits}
    if not best:
        return {}
    out: dict[tuple[str, str], Fit] = {}

    def helps(fit: Fit) -> bool:
        return bool(fit.log_z.max() > base.log_z.max() + PAIR_PROMISE)

    def with_each(first: str) -> None:
        others = {n: e for n, e in effects.items() if n != first and _key(first, n) not in out}
        for i, one in enumerate(candidates(data, best[first], others)):
            alone = best.get(one.name)
            sudden = effects[one.name][0].sudden and alone is not None and helps(alone)
            if (i >= PAIR_MOST or one.gain < PAIR_PROMISE) and not sudden:
                continue
            progress(f"{first} + {one.name}")
            starts = one.starts
            if alone is not None and set(alone.problem.names) <= set(one.problem.names):  # the base as the second
                starts = np.concatenate([starts, _together(one.problem, best[first], alone)[None]])  # alone left it
            key, fit = _key(first, one.name), fit_model(data, one.problem, starts, iterations=20)
            if key not in out or fit.log_z.max() > out[key].log_z.max():
                out[key] = fit

    first = max(best, key=lambda n: best[n].log_z.max())
    if not helps(best[first]):
        return {}
    with_each(first)
    if out:
        leading = max(out, key=lambda k: out[k].log_z.max())
        partner = leading[0] if leading[1] == first else leading[1]
        if partner not in best:  # it promised nothing on its own
            alone = candidates(data, base, {partner: effects[partner]})[0]
            best[partner] = fit_model(data, alone.problem, alone.starts, iterations=20)
        with_each(partner)
    return out


def _together(problem: Problem, first: Fit, second: Fit) -> Array:
    """(ndim,) two single effects as each was fitted alone, the base's numbers as the second left them."""
    z = dict(zip(first.problem.names, first.z)) | dict(zip(second.problem.names, second.z))
    return np.array([z.get(n, 0.0) for n in problem.names])


def _key(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)
