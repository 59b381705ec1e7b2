"""Global search: a real-coded genetic algorithm.

It works on whole populations through a batch objective, which is minimised; +inf (or NaN) marks an x where the model
does not exist.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from tqdm.auto import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError

BatchObjective = Callable[[Array], Array]


class SearchError(InputError):
    """The bounds or the objective cannot be searched."""


@dataclass(frozen=True)
class GlobalOptimum:
    """What a global search found.

    x is the best vector of all, objective its value; first and population hold the first and the last population,
    sorted from best to worst; best and median are the history, one value a generation; stopped says which rule ended
    the search ("stall", "evaluations" or "time").
    """

    seed: int
    x: Array  # (ndim,)
    objective: float
    first: Array  # (members, ndim)
    population: Array  # (members, ndim)
    best: Array  # (generations,)
    median: Array  # (generations,)
    n_evaluations: int
    stopped: str


def genetic_search(
    objective: BatchObjective,
    bounds: ArrayLike,
    first: ArrayLike,
    *,
    seed: int,
    members: int = 200,
    max_evaluations: int = 60_000,
    stall: int = 60,
    stall_tolerance: float = 1e-4,
    budget_s: float | None = None,
    crossover: float = 0.9,
    crossover_index: float = 5.0,
    mutation_index: float = 20.0,
    elite: int = 4,
    progress: bool = True,
) -> GlobalOptimum:
    """Minimise `objective` in a box by a real-coded genetic algorithm.

    Parameters
    ----------
    objective
        maps (n, ndim) to (n,), lower is better.
    bounds
        (ndim, 2), finite.
    first
        (n, ndim), within the bounds: the best `members` of these are the first population.
    members
        size of the population.
    stall, stall_tolerance
        stop when the best objective fell by less than this share of itself (or by less
        than this share of its distance to the median, if that is less) over so many generations.
    max_evaluations, budget_s
        other ends; time is only looked at between generations.
    crossover, crossover_index
        probability and distribution index of simulated binary crossover (Deb &
        Agrawal 1995); mutation_index : that of polynomial mutation (Deb & Goyal 1996), one number a child on
        average. elite : members that survive unchanged.

    Raises
    ------
    SearchError
        unusable bounds, or no finite objective in the whole first population.
    """
    lower, upper = _box(bounds)
    ndim = len(lower)
    rng = np.random.default_rng(seed)
    call = _Objective(objective, ndim)
    began = time.monotonic()

    x = np.asarray(first, float)
    f = call(x)
    if not np.isfinite(f).any():
        raise SearchError(
            f"the objective is not finite at any of the {len(x)} members of the first population; "
            "narrow the priors to where the model exists"
        )
    order = np.argsort(f, kind="stable")[:members]
    x, f = x[order], f[order]
    founders = x
    best, median = [f[0]], [np.median(f)]
    stopped = "evaluations"
    with tqdm(total=max_evaluations, desc="genetic search", disable=None if progress else True) as bar:
        while call.count + members - elite <= max_evaluations:
            children = _offspring(x, members - elite, lower, upper, rng, crossover, crossover_index, mutation_index)
            g = call(children)
            x = np.concatenate([x[:elite], children])
            f = np.concatenate([f[:elite], g])
            order = np.argsort(f, kind="stable")
            x, f = x[order], f[order]
            best.append(f[0])
            median.append(np.median(f))
            bar.update(members - elite)
            bar.set_postfix(best=f"{f[0]:.5g}", refresh=False)
            if _stalled(best, median, stall, stall_tolerance):
                stopped = "stall"
                break
            if budget_s is not None and time.monotonic() - began > budget_s:
                stopped = "time"
                break
    return GlobalOptimum(
        seed=seed,
        x=x[0].copy(),
        objective=float(f[0]),
        first=founders,
        population=x,
        best=np.array(best),
        median=np.array(median),
        n_evaluations=call.count,
        stopped=stopped,
    )


class _Objective:
    """The objective with its shape checked, its rows counted and NaN read as "not possible"."""

    def __init__(self, function: BatchObjective, ndim: int) -> None:
        self.function, self.ndim, self.count = function, ndim, 0

    def __call__(self, x: Array) -> Array:
        values = np.asarray(self.function(np.ascontiguousarray(x)), dtype=float)
        if values.shape != (len(x),):
            raise SearchError(f"objective(x) returned shape {values.shape} for x of shape {x.shape}")
        self.count += len(x)
        return np.where(np.isnan(values), np.inf, values)


def _box(bounds: ArrayLike) -> tuple[Array, Array]:
    box = np.asarray(bounds, dtype=float)
    if box.ndim != 2 or box.shape[1] != 2 or not np.isfinite(box).all() or not (box[:, 0] < box[:, 1]).all():
        raise SearchError(f"bounds must be finite, of shape (ndim, 2), with lower < upper; got shape {box.shape}")
    return box[:, 0], box[:, 1]


def _offspring(
    x: Array,
    n: int,
    lower: Array,
    upper: Array,
    rng: np.random.Generator,
    crossover: float,
    crossover_index: float,
    mutation_index: float,
) -> Array:
    """(n, ndim) children of members x sorted from best to worst: tournament, SBX, polynomial mutation."""
    members, ndim = x.shape
    pairs = -(-n // 2)
    # The population is sorted, so the better of two members is the one with the lower index.
    parents = rng.integers(members, size=(2, pairs, 2)).min(axis=2)
    a, b = x[parents[0]], x[parents[1]]

    u = rng.random((pairs, ndim))
    power = 1.0 / (crossover_index + 1.0)
    spread = np.where(u <= 0.5, (2 * u) ** power, (2 * np.maximum(1 - u, 1e-16)) ** -power)
    mixed = (rng.random((pairs, 1)) < crossover) & (rng.random((pairs, ndim)) < 0.5)
    spread = np.where(mixed, spread, 1.0)
    middle, half = 0.5 * (a + b), 0.5 * (a - b)
    children = np.concatenate([middle + spread * half, middle - spread * half])[:n]

    u = rng.random(children.shape)
    power = 1.0 / (mutation_index + 1.0)
    shift = np.where(u < 0.5, (2 * u) ** power - 1.0, 1.0 - (2 * (1 - u)) ** power)
    hit = rng.random(children.shape) < 1.0 / ndim
    children = children + np.where(hit, shift * (upper - lower), 0.0)
    # Reflecting at the bounds keeps the population from gluing itself to them, as clipping would.
    width = upper - lower
    folded = np.abs((children - lower) % (2 * width))
    return lower + np.where(folded > width, 2 * width - folded, folded)


def _stalled(best: Sequence[float], median: Sequence[float], stall: int, tolerance: float) -> bool:
    if len(best) <= stall:
        return False
    fell = best[-1 - stall] - best[-1]
    spread = median[-1] - best[-1]
    return bool(fell <= tolerance * min(abs(best[-1]), spread) or spread <= 1e-12 * abs(best[-1]))
