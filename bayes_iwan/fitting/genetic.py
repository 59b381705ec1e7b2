"""Global search: a real-coded genetic algorithm.

It works on whole populations through a batch objective, which is minimised; +inf (or NaN) marks an x where the model
does not exist.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.screen import on_screen

BatchObjective = Callable[[Array], Array]

#: members that survive unchanged
ELITE = 4
#: the search ends when over so many generations the best objective fell by less than this share of itself, or of its
#: distance to the median if that is less
STALL, STALL_TOLERANCE = 60, 1e-4
#: probability and distribution index of simulated binary crossover (Deb & Agrawal 1995), and index of polynomial
#: mutation (Deb & Goyal 1996), one number a child on average
CROSSOVER, CROSSOVER_INDEX, MUTATION_INDEX = 0.9, 5.0, 20.0


class SearchError(InputError):
    """The bounds or the objective cannot be searched."""


@dataclass(frozen=True)
@on_screen
class GlobalOptimum:
    """What a global search found.

    x is the best vector of all, objective its value; first and population hold the first and the last population,
    sorted from best to worst; best and median are the history, one value a generation; stopped says which rule ended
    the search ("stall" or "evaluations").
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
    progress: bool = True,
) -> GlobalOptimum:
    """Minimise `objective` in a box by a real-coded genetic algorithm.

    objective : maps (n, ndim) to (n,), lower is better. bounds : (ndim, 2), finite. first : (n, ndim), within the
    bounds: the best `members` of these are the first population. members : size of the population. max_evaluations :
    the search ends before it would ask for more.
    Raises SearchError for unusable bounds, or no finite objective in the whole first population.
    """
    lower, upper = _box(bounds)
    ndim = len(lower)
    rng = np.random.default_rng(seed)
    call = _Objective(objective, ndim)

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
        while call.count + members - ELITE <= max_evaluations:
            children = _offspring(x, members - ELITE, lower, upper, rng)
            g = call(children)
            x = np.concatenate([x[:ELITE], children])
            f = np.concatenate([f[:ELITE], g])
            order = np.argsort(f, kind="stable")
            x, f = x[order], f[order]
            best.append(f[0])
            median.append(np.median(f))
            bar.update(members - ELITE)
            bar.set_postfix(best=f"{f[0]:.5g}", refresh=False)
            if _stalled(best, median):
                stopped = "stall"
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


def _offspring(x: Array, n: int, lower: Array, upper: Array, rng: np.random.Generator) -> Array:
    """(n, ndim) children of members x sorted from best to worst: tournament, SBX, polynomial mutation."""
    members, ndim = x.shape
    pairs = -(-n // 2)
    # The population is sorted, so the better of two members is the one with the lower index.
    parents = rng.integers(members, size=(2, pairs, 2)).min(axis=2)
    a, b = x[parents[0]], x[parents[1]]

    u = rng.random((pairs, ndim))
    power = 1.0 / (CROSSOVER_INDEX + 1.0)
    spread = np.where(u <= 0.5, (2 * u) ** power, (2 * np.maximum(1 - u, 1e-16)) ** -power)
    mixed = (rng.random((pairs, 1)) < CROSSOVER) & (rng.random((pairs, ndim)) < 0.5)
    spread = np.where(mixed, spread, 1.0)
    middle, half = 0.5 * (a + b), 0.5 * (a - b)
    children = np.concatenate([middle + spread * half, middle - spread * half])[:n]

    u = rng.random(children.shape)
    power = 1.0 / (MUTATION_INDEX + 1.0)
    shift = np.where(u < 0.5, (2 * u) ** power - 1.0, 1.0 - (2 * (1 - u)) ** power)
    hit = rng.random(children.shape) < 1.0 / ndim
    children = children + np.where(hit, shift * (upper - lower), 0.0)
    # Reflecting at the bounds keeps the population from gluing itself to them, as clipping would.
    width = upper - lower
    folded = np.abs((children - lower) % (2 * width))
    return lower + np.where(folded > width, 2 * width - folded, folded)


def _stalled(best: Sequence[float], median: Sequence[float]) -> bool:
    if len(best) <= STALL:
        return False
    fell = best[-1 - STALL] - best[-1]
    spread = median[-1] - best[-1]
    return bool(fell <= STALL_TOLERANCE * min(abs(best[-1]), spread) or spread <= 1e-12 * abs(best[-1]))
