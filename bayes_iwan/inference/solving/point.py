"""The point estimate: the paper's own (a genetic algorithm on Eq. 8), and the most probable point.

The genetic algorithm's first population is drawn from the prior; it minimises Eq. (8) over the parameters of the
paper's model, with the embedded model error at none, and least squares polishes its result. The most probable point is
then sought by least squares from the best of its first and of its last population, first with the noise held, then with
all parameters free. A second search with a population of its own says whether the first one did not find a maximum.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.fitting.descent import Descent, descend
from bayes_iwan.fitting.genetic import BatchObjective, GlobalOptimum, genetic_search
from bayes_iwan.fitting.least_squares import BatchResiduals
from bayes_iwan.inference.setup.loop_error import friction_level_N, goal_function, paper_weights
from bayes_iwan.inference.setup.priors import Z_LIMIT
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import SearchSettings
from bayes_iwan.models.embedded_error import NAMES as EMBEDDED
from bayes_iwan.screen import on_screen

_DEPTH = 12.0  # nats
#: steps of least squares from a start, and nats to which an optimum is sought
_ITERATIONS, _ENOUGH = 60, 1e-3
#: the noise, as a share of the friction force, in whose nats the minimum of Eq. (8) is sought
_GOAL_NOISE = 1e-3


@dataclass(frozen=True)
@on_screen
class Point:
    """What was found. z arrays are coordinates of the problem; where Eq. (8) ignores a parameter, its z is 0.

    goal_z, goal : the minimum of Eq. (8) and its value; goal_share : that over Eq. (8) of the friction level itself:
    how far the residual is, as a share of the friction force. z, log_prob : the most probable point; goal_at_z :
    Eq. (8) there. optima, optima_log_prob : the different maxima that least squares ended in, best first (k, ndim).
    searches : histories of the genetic algorithm, one or two. each_z, each_log_prob : (searches, ndim), (searches,) the
    most probable point that each search found by itself. The sampler's walkers start from the maxima of all of them.
    """

    goal_z: Array
    goal: float
    goal_share: float
    z: Array
    log_prob: float
    goal_at_z: float
    optima: Array
    optima_log_prob: Array
    searches: tuple[GlobalOptimum, ...]
    n_evaluations: int
    seconds: float
    each_z: Array
    each_log_prob: Array

    @property
    def short_nats(self) -> float:
        """By how much the best maximum of the poorest search lies below the best of all; 0 for a single search."""
        return float(np.max(self.each_log_prob) - np.min(self.each_log_prob))


def near_optima(optima: Array, log_prob: Array) -> Array:
    """Those of optima (k, ndim), best first, that are near enough to the best by ln p (k,) to matter."""
    return optima[log_prob > log_prob[0] - _DEPTH]


def goal_share(problem: Problem, z: Array) -> Array:
    """Eq. (8) at z over Eq. (8) of residuals as large as each loop's friction level, (draws,)."""
    motion = problem.motion
    level = np.broadcast_to(friction_level_N(problem.loops)[:, None], problem.measured_N.shape)
    return problem.goal(z) / goal_function(level[None], motion.displacement_mm[0], motion.amplitude_mm)[0]


def find_point(problem: Problem, seed: int, settings: SearchSettings, progress: bool = True) -> Point:
    """The point estimate; `settings` say how it is searched for."""
    began = time.monotonic()
    columns = _searched(problem)
    box = np.tile([-settings.reach, settings.reach], (len(columns), 1))

    def objective(x: Array) -> Array:
        return problem.goal(_embedded(problem, columns, x))

    searches, goal_ends, each, used = [], [], [], 0
    for k in range(2 if settings.second_search else 1):
        rng = np.random.default_rng([seed, 11, k])
        first = np.clip(rng.standard_normal((4 * settings.members, len(columns))), -settings.reach, settings.reach)
        found = genetic_search(
            objective, box, first, seed=int(rng.integers(2**31)), members=settings.members,
            max_evaluations=settings.evaluations, progress=progress,
        )  # fmt: skip
        members = np.concatenate([found.population[_even(found.population)], found.first[: settings.starts]])
        polished, n = _polished(objective, _goal_rows(problem, columns), members, box)
        goal_ends.append(np.concatenate([polished, found.x[None]]))
        starts = np.concatenate([polished, members])
        starts = starts[_different(starts, -objective(starts), tolerance=0.1, depth=np.inf)]
        each.append(most_probable(problem, _embedded(problem, columns, starts)))
        searches.append(found)
        used += found.n_evaluations + n + each[-1][2]
    ends = np.concatenate(goal_ends)
    values = objective(ends)
    goal_z = _embedded(problem, columns, ends[np.argmin(values)][None])
    optima, log_prob = np.concatenate([e[0] for e in each]), np.concatenate([e[1] for e in each])
    order = np.argsort(-log_prob)
    order = order[_different(optima[order], log_prob[order], tolerance=0.3)]
    optima, log_prob = optima[order], log_prob[order]
    return Point(
        goal_z=goal_z[0],
        goal=float(values.min()),
        goal_share=float(goal_share(problem, goal_z)[0]),
        z=optima[0],
        log_prob=float(log_prob[0]),
        goal_at_z=float(problem.goal(optima[:1])[0]),
        optima=optima,
        optima_log_prob=log_prob,
        searches=tuple(searches),
        n_evaluations=used,
        seconds=time.monotonic() - began,
        each_z=np.stack([e[0][0] for e in each]),
        each_log_prob=np.array([e[1][0] for e in each]),
    )


def _searched(problem: Problem) -> NDArray[np.int64]:
    """Coordinates that Eq. (8) is minimised over: those of the paper's model, without noise and embedded model
    error."""
    others = problem.noise_names | set(EMBEDDED)
    return np.array([i for i, name in enumerate(problem.names) if name not in others], dtype=np.int64)


def _even(population: Array, count: int = 6) -> NDArray[np.int64]:
    """Places spread over a population, its best member first."""
    return np.linspace(0, len(population) - 1, count).astype(np.int64)


def _embedded(problem: Problem, columns: NDArray[np.int64], x: Array) -> Array:
    """x (n, len(columns)) as coordinates of the problem, the others at their prior medians."""
    z = np.zeros((len(x), problem.ndim))
    z[:, columns] = x
    return z


def _goal_rows(problem: Problem, columns: NDArray[np.int64]) -> Sequence[BatchResiduals]:
    """Rows whose squares lead to the minimum of Eq. (8): its squared form, then itself, rounded off near zero."""
    motion = problem.motion
    w = paper_weights(motion.displacement_mm[0], motion.amplitude_mm) / motion.amplitude_mm[:, None]
    corner = _GOAL_NOISE * friction_level_N(problem.loops)[:, None]
    scale = np.sqrt(w / w.mean() * problem.loops[0].harmonics_N.size / motion.samples) / corner

    def squared(x: Array) -> Array:
        return (scale * problem.residual(_embedded(problem, columns, x))).reshape(len(x), -1)

    def absolute(x: Array) -> Array:
        r = problem.residual(_embedded(problem, columns, x))
        r = np.sign(r) * np.sqrt(corner * (np.hypot(corner, r) - corner))
        return (scale * r).reshape(len(x), -1)

    return squared, absolute


def _polished(objective: BatchObjective, ladder: Sequence[BatchResiduals], x: Array, box: Array) -> tuple[Array, int]:
    """Where least squares leads from x, and the evaluations used; of each rung the best three climb the next."""
    reached, used = [], 0
    for rows in ladder:
        fit = descend(rows, x, box, _ITERATIONS, enough=_ENOUGH)
        used += fit.n_evaluations
        reached.append(fit.x)
        x = fit.x[np.argsort(objective(fit.x))[:3]]
    return np.concatenate(reached[::-1]), used


def _fitted(rows: BatchResiduals, starts: Array) -> Descent:
    """Least squares from all starts, each to its own optimum."""
    box = np.tile([-Z_LIMIT, Z_LIMIT], (starts.shape[1], 1))
    return descend(rows, starts, box, _ITERATIONS, enough=_ENOUGH, give_up=False)


def joint_rows(problem: Problem, z: Array) -> Array:
    """Rows for least squares over all parameters, noise included, (draws, m): ½Σ rows² = −log posterior + constant.

    The log-determinant is no square; it enters as √(2(K + its half)), K large: exact as a value, and nearly linear.
    """
    parameter_values = problem.parameter_values(z)
    residual = problem.measured_N - problem.force(parameter_values)
    whitened = problem.likelihood.rows(residual, parameter_values)
    constant = -problem.likelihood.log_likelihood(residual, parameter_values) - 0.5 * np.einsum(
        "dm,dm->d", whitened, whitened
    )
    last = np.sqrt(2.0 * np.maximum(50.0 * whitened.shape[1] + constant, 0.0))
    return np.concatenate([whitened, z, last[:, None]], axis=1)


def most_probable(problem: Problem, starts: Array) -> tuple[Array, Array, int]:
    """Different maxima (k, ndim) of the posterior over z, best first, their log_prob (k,), and evaluations used.

    Least squares from each start with the noise held at what the start says, then with all parameters free.
    """
    noise = np.array([name in problem.noise_names for name in problem.names])
    free = np.flatnonzero(~noise)
    held = starts.copy()
    used = 0
    for value in np.unique(starts[:, noise], axis=0):
        rows = np.flatnonzero(np.all(starts[:, noise] == value, axis=1))

        def residuals(x: Array, value: Array = value) -> Array:
            z = np.empty((len(x), problem.ndim))
            z[:, free], z[:, noise] = x, value
            return problem.rows(z)

        fit = _fitted(residuals, starts[rows][:, free])
        held[np.ix_(rows, free)] = fit.x
        used += fit.n_evaluations
    log_prob = problem.log_prob(held)
    order = np.argsort(-log_prob)
    keep = _different(held[order], log_prob[order], tolerance=0.3)
    fit = _fitted(lambda z: joint_rows(problem, z), held[order][keep])
    ended = fit.arrived | (np.arange(len(fit.x)) == fit.best)
    found, log_prob = fit.x[ended], problem.log_prob(fit.x[ended])
    order = np.argsort(-log_prob)
    order = order[_different(found[order], log_prob[order], tolerance=0.3)]
    return found[order], log_prob[order], used + fit.n_evaluations


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
        raise InputError("no start of the search reached a finite posterior density; check the data's scale and priors")
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
