"""The point estimate: the paper's own way (a genetic algorithm on Eq. 8), and the most probable point.

Both start from populations, not from a guess. The genetic algorithm and, as a second opinion, differential
evolution minimise the goal over the model's parameters; least squares polishes. The most probable point is then sought
by least squares from many of their members and from the prior, first with the noise held, then all parameters together.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array, brief
from bayes_iwan.inference.setup.loop_error import friction_level_N, goal_function, paper_weights
from bayes_iwan.inference.setup.parameters import Z_LIMIT
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import SearchSettings
from bayes_iwan.optimize.genetic import BatchObjective, GlobalOptimum, differential_evolution_search, genetic_search
from bayes_iwan.optimize.least_squares import BatchResiduals, least_squares_batch

_SPREAD = 1.3  # of the sampler's starts, in posterior standard deviations


@dataclass(frozen=True)
class Point:
    """What was found. z arrays are coordinates of the problem; where the goal ignores a number, its z is 0.

    goal_z, goal : best point of the search's objective and its value; goal_share : Eq. (8) there, over Eq. (8) of
    the friction level itself: how far the loops are missed, as a share of the friction force.
    z, log_prob : the most probable point; goal_at_z : Eq. (8) there.
    optima, optima_log_prob : the different maxima that least squares ended in, best first (k, ndim).
    search, second : histories of the genetic algorithm and of differential evolution (None if it was not asked for).
    each_z, each_log_prob : (searches, ndim), (searches,) the most probable point that each search found by itself, from
        its own population and its own draws of the prior. The sampler's starts come from the maxima of all of them.
    """

    objective: str
    goal_z: Array
    goal: float
    goal_share: float
    z: Array
    log_prob: float
    goal_at_z: float
    optima: Array
    optima_log_prob: Array
    search: GlobalOptimum
    second: GlobalOptimum | None
    n_evaluations: int
    seconds: float
    each_z: Array
    each_log_prob: Array

    __repr__ = brief

    @property
    def missed_nats(self) -> float:
        """By how much the best maximum of the poorest search lies below the best of all; 0 for a single search."""
        return float(np.max(self.each_log_prob) - np.min(self.each_log_prob))


def goal_share(problem: Problem, z: Array) -> Array:
    """Eq. (8) at z over Eq. (8) of residuals as large as each loop's friction level, (draws,)."""
    motion = problem.motion
    level = np.broadcast_to(friction_level_N(problem.loops)[:, None], problem.measured_N.shape)
    return problem.goal(z) / goal_function(level[None], motion.displacement_mm[0], motion.amplitude_mm)[0]


def find_point(problem: Problem, seed: int, settings: SearchSettings, progress: bool = True) -> Point:
    """The point estimate; `settings` say how it is searched for."""
    began = time.monotonic()
    objective, ladder, columns = _objective(problem, settings.objective)
    box = np.tile([-settings.reach, settings.reach], (len(columns), 1))
    found = genetic_search(
        objective, box, seed=seed, members=settings.members, max_evaluations=settings.evaluations, progress=progress
    )
    second = None
    if settings.second_opinion:
        second = differential_evolution_search(
            objective, box, seed=seed, members=settings.members, max_evaluations=settings.evaluations, progress=progress
        )
    searches = [s for s in (found, second) if s is not None]

    members_of = [_some(s, 6) for s in searches]
    polished_of = [_polished(objective, ladder, m, box) for m in members_of]
    members, polished = np.concatenate(members_of), np.concatenate([p for p, _ in polished_of])
    polishing = sum(n for _, n in polished_of)
    reached = np.concatenate([polished, members])
    values = objective(reached)
    best = int(np.argmin(values))
    goal_z = _embedded(problem, columns, reached[best : best + 1])[0]

    # each search seeks the most probable point by itself: what one of them misses shows beside the other
    share = -(-settings.starts // len(searches))
    each = []
    for k in range(len(searches)):
        own = polished_of[k][0]
        own = own[_different(own, -objective(own), tolerance=0.1, depth=np.inf)]
        starts = np.concatenate([_embedded(problem, columns, own), _prior_starts(problem, share, seed, k)])
        each.append(most_probable(problem, starts))
    optima, log_prob = np.concatenate([e[0] for e in each]), np.concatenate([e[1] for e in each])
    order = np.argsort(-log_prob)
    order = order[_different(optima[order], log_prob[order], tolerance=0.3)]
    optima, log_prob, used = optima[order], log_prob[order], sum(e[2] for e in each)
    return Point(
        objective=settings.objective,
        goal_z=goal_z,
        goal=float(values[best]),
        goal_share=float(goal_share(problem, goal_z[None])[0]),
        z=optima[0],
        log_prob=float(log_prob[0]),
        goal_at_z=float(problem.goal(optima[:1])[0]),
        optima=optima,
        optima_log_prob=log_prob,
        search=found,
        second=second,
        n_evaluations=sum(s.n_evaluations for s in searches) + polishing + used,
        seconds=time.monotonic() - began,
        each_z=np.stack([e[0][0] for e in each]),
        each_log_prob=np.array([e[1][0] for e in each]),
    )


def _noise_names(problem: Problem) -> set[str]:
    return {p.name for p in problem.likelihood.parameters}


def _embedded(problem: Problem, columns: NDArray[np.int64], x: Array) -> Array:
    """x (n, len(columns)) as coordinates of the problem, the others at their prior medians."""
    z = np.zeros((len(x), problem.ndim))
    z[:, columns] = x
    return z


def _objective(problem: Problem, kind: str) -> tuple[BatchObjective, Sequence[BatchResiduals], NDArray[np.int64]]:
    """The batch objective, the least-squares rows that lead to its minimum one after the other, and the coordinates
    it depends on."""
    if kind == "likelihood":
        return (lambda z: -problem.log_prob(z)), (lambda z: joint_rows(problem, z),), np.arange(problem.ndim)
    noise = _noise_names(problem)
    columns = np.array([i for i, name in enumerate(problem.names) if name not in noise])
    motion = problem.motion
    w = paper_weights(motion.displacement_mm[0], motion.amplitude_mm) / motion.amplitude_mm[:, None] / motion.samples
    bend = 1e-3 * friction_level_N(problem.loops)[:, None]

    def goal(x: Array) -> Array:
        return problem.goal(_embedded(problem, columns, x), squared=kind == "squared")

    def squared(x: Array) -> Array:
        return (np.sqrt(w) * problem.residual(_embedded(problem, columns, x))).reshape(len(x), -1)

    def absolute(x: Array) -> Array:  # |r|, rounded off below `bend`, as a square
        r = problem.residual(_embedded(problem, columns, x))
        r = np.sign(r) * np.sqrt(bend * (np.hypot(bend, r) - bend))
        return (np.sqrt(w) * r).reshape(len(x), -1)

    return goal, ((squared,) if kind == "squared" else (squared, absolute)), columns


def _some(search: GlobalOptimum, count: int) -> Array:
    """The best member of a search and others spread over its last population, (count + 1, columns)."""
    even = np.linspace(0, len(search.population) - 1, count).astype(int)
    return np.concatenate([search.x[None], search.population[even]])


def _polished(objective: BatchObjective, ladder: Sequence[BatchResiduals], x: Array, box: Array) -> tuple[Array, int]:
    """Where least squares leads from x, and the evaluations used; of each rung the best three climb the next."""
    reached, used = [], 0
    for rows in ladder:
        fit = least_squares_batch(rows, x, box, max_iterations=60, ftol=1e-6)
        used += fit.n_evaluations
        reached.append(fit.x)
        x = fit.x[np.argsort(objective(fit.x))[:3]]
    return np.concatenate(reached[::-1]), used


def joint_rows(problem: Problem, z: Array) -> Array:
    """Rows for least squares over all parameters, noise included, (draws, m): ½Σ rows² = −log posterior + constant.

    The log-determinant is no square; it enters as √(2(K + its half)), K large: exact as a value, and nearly linear.
    """
    parameter_values = problem.parameter_values(z)
    residual = problem.measured_N - problem.force(parameter_values)
    whitened = problem.likelihood.rows(residual, parameter_values)
    rest = -problem.likelihood.log_likelihood(residual, parameter_values) - 0.5 * np.einsum(
        "dm,dm->d", whitened, whitened
    )
    last = np.sqrt(2.0 * np.maximum(50.0 * whitened.shape[1] + rest, 0.0))
    return np.concatenate([whitened, z, last[:, None]], axis=1)


def _prior_starts(problem: Problem, count: int, seed: int, search: int) -> Array:
    """The best by Eq. (8) of 32 times as many draws from the prior, noise at its median, (count, ndim)."""
    z = problem.prior.draw(np.random.default_rng([seed, 11, search]), 32 * count)
    z[:, [name in _noise_names(problem) for name in problem.names]] = 0.0
    return z[np.argsort(problem.goal(z))[:count]]


def most_probable(problem: Problem, starts: Array) -> tuple[Array, Array, int]:
    """Different maxima (k, ndim) of the posterior over z, best first, their log_prob (k,), and evaluations used.

    Least squares from each start with the noise held at what the start says, then with all parameters free.
    """
    noise = np.array([name in _noise_names(problem) for name in problem.names])
    free = np.flatnonzero(~noise)
    held = starts.copy()
    used = 0
    for value in np.unique(starts[:, noise], axis=0):
        rows = np.flatnonzero(np.all(starts[:, noise] == value, axis=1))

        def residuals(x: Array, value: Array = value) -> Array:
            z = np.empty((len(x), problem.ndim))
            z[:, free], z[:, noise] = x, value
            return problem.rows(z)

        fit = least_squares_batch(
            residuals, starts[rows][:, free], np.tile([-Z_LIMIT, Z_LIMIT], (len(free), 1)), max_iterations=60, ftol=1e-5
        )
        held[np.ix_(rows, free)] = fit.x
        used += fit.n_evaluations
    log_prob = problem.log_prob(held)
    order = np.argsort(-log_prob)
    keep = _different(held[order], log_prob[order], tolerance=1.0)
    fit = least_squares_batch(
        lambda z: joint_rows(problem, z),
        held[order][keep],
        np.tile([-Z_LIMIT, Z_LIMIT], (problem.ndim, 1)),
        max_iterations=60,
        ftol=1e-7,
    )
    log_prob = problem.log_prob(fit.x)
    order = np.argsort(-log_prob)
    order = order[_different(fit.x[order], log_prob[order], tolerance=0.3)]
    return fit.x[order], log_prob[order], used + fit.n_evaluations


def _different(z: Array, log_prob: Array, tolerance: float, depth: float = 200.0) -> list[int]:
    """Indices of rows that lie apart by `tolerance` (z is in prior standard deviations), not `depth` below the first;
    the first of those that lie together is kept."""
    kept: list[int] = []
    for i in range(len(z)):
        if not np.isfinite(log_prob[i]) or log_prob[i] < log_prob[0] - depth:
            continue
        if all(np.max(np.abs(z[i] - z[j])) > tolerance for j in kept):
            kept.append(i)
    if not kept:
        raise ValueError("no start of the search reached a finite posterior density; check the data's scale and priors")
    return kept


def laplace_scale(problem: Problem, z: Array) -> Array:
    """Lower triangular L (ndim, ndim), L Lᵀ the Gauss–Newton covariance of the posterior at an optimum z (ndim,)."""
    step = 1e-4
    eye = step * np.eye(problem.ndim)
    both = joint_rows(problem, np.concatenate([z + eye, z - eye]))
    jacobian = (both[: problem.ndim] - both[problem.ndim :]).T / (2.0 * step)
    information = jacobian.T @ jacobian
    values, vectors = np.linalg.eigh(information)
    # the prior alone contributes 1 to each direction, so nothing less is meant
    root = vectors / np.sqrt(np.maximum(values, 1.0))
    return np.linalg.cholesky(root @ root.T + 1e-12 * np.eye(problem.ndim))


def starting_population(problem: Problem, point: Point, seed: int, count: int) -> Array:
    """Dispersed starts (≤ count, ndim) for the sampler: "randomise, then optimise" (Bardsley et al. 2014), spread wide.

    Each is a fit to loops and priors that were shifted by `_SPREAD` times their own noise, started from a Laplace draw
    about one of the maxima found. For a linear model such fits would be draws of the posterior with `_SPREAD` times its
    standard deviation; for this one they lie along its bent sheets and in its lesser branches, which draws of a normal
    distribution miss. Lesser maxima get the same share as the best: a sampler that ends in one agreement was not led.
    """
    rng = np.random.default_rng([seed, 12])
    reach = point.optima_log_prob > point.optima_log_prob[0] - 30.0
    centres = point.optima[reach][:16]
    draws = []
    for k, centre in enumerate(centres):
        n = count // len(centres) + (k < count % len(centres))
        draws.append(centre + rng.standard_normal((n, problem.ndim)) @ laplace_scale(problem, centre).T)
    starts = np.clip(np.concatenate(draws), -0.95 * Z_LIMIT, 0.95 * Z_LIMIT)
    rows = joint_rows(problem, starts[:1]).shape[1]
    box = np.tile([-Z_LIMIT, Z_LIMIT], (problem.ndim, 1))
    fitted = []
    for part in np.array_split(starts, max(1, len(starts) // 64)):  # Jacobians of all at once would take gigabytes
        offsets = _SPREAD * rng.standard_normal((len(part), rows))
        offsets[:, -1] = 0.0  # the log-determinant's row is no datum
        fit = least_squares_batch(
            lambda z: joint_rows(problem, z), part, box, max_iterations=8, ftol=1e-4, xtol=1e-4, offsets=offsets
        )
        fitted.append(fit.x)
    # a shift of the data hardly moves the parameters of the noise: they are spread by themselves
    noise = np.array([name in _noise_names(problem) for name in problem.names])
    sd = np.linalg.norm(laplace_scale(problem, centres[0]), axis=1) * noise
    z = np.concatenate(fitted) + _SPREAD * sd * rng.standard_normal((len(starts), problem.ndim))
    z = np.clip(z, -0.95 * Z_LIMIT, 0.95 * Z_LIMIT)
    log_prob = problem.log_prob(z)
    # starts far out cost warm-up steps: within 25 + 2·ndim of the best is dispersed enough
    good = log_prob > point.log_prob - 25.0 - 2.0 * problem.ndim
    return z[good] if np.count_nonzero(good) >= 2 * problem.ndim + 2 else z[np.argsort(-log_prob)[: max(count // 4, 2)]]
