"""A population of specimens from the posteriors of single ones: mean and spread of each quantity, and who stands out.

Hierarchical model of one quantity: θᵢ ~ Normal(μ, τ²) over specimens (of its logarithm where it is positive), with flat
priors on μ and τ. What specimen i's loops say of θᵢ is in its posterior's draws, less the prior that these were drawn
under: the likelihood of (μ, τ) is the product over i of Σ w(θ)·Normal(θ; μ, τ²) over the draws, w = 1/prior (importance
reweighting of single posteriors: Hogg, Myers & Bovy 2010, doi:10.1088/0004-637X/725/2/2166). Draws are smoothed by a
narrow kernel that leaves their mean and variance as they are, so that a τ far below their spacing has a likelihood too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, brief

#: grid over μ and τ, and draws of each posterior
GRID, DRAWS = 40, 160
#: fewer specimens than this say nothing about a spread
LEAST = 3


@dataclass(frozen=True)
class SpecimenDraws:
    """Draws (n,) of one quantity of one specimen, and draws of the same quantity under the prior they came from."""

    name: str
    draws: Array
    prior: Array

    __repr__ = brief


@dataclass(frozen=True)
class Population:
    """One quantity over specimens: median and 90 % interval of the typical value and of the spread.

    typical : the median specimen, in the quantity's unit. spread : standard deviation between specimens, as a share of
    the typical value if `relative`, else in the quantity's unit. next_specimen : interval for a specimen not yet seen.
    surprise : for each specimen the two-sided probability of a value as far out, learnt from the others alone.
    """

    names: tuple[str, ...]
    relative: bool
    typical: tuple[float, float, float]
    spread: tuple[float, float, float]
    next_specimen: tuple[float, float]
    surprise: tuple[float, ...]

    __repr__ = brief

    def outliers(self, level: float = 0.01) -> tuple[str, ...]:
        """Specimens less probable than `level`, with their number allowed for."""
        return tuple(n for n, p in zip(self.names, self.surprise) if p * len(self.names) < level)


def population(specimens: Sequence[SpecimenDraws], seed: int = 0) -> Population | None:
    """The population of one quantity; None for fewer than :data:`LEAST` specimens, for draws that do not vary, and for
    such as differ by more than double precision can hold."""
    if len(specimens) < LEAST:
        return None
    every = np.concatenate([s.draws for s in specimens])
    if not np.all(np.isfinite(every)) or any(np.ptp(s.draws) == 0.0 for s in specimens):
        return None
    relative = bool(np.all(every > 0.0) and all(np.all(s.prior > 0.0) for s in specimens))
    scale = np.log if relative else np.asarray
    rng = np.random.default_rng([seed, 61])
    draws = [scale(s.draws if len(s.draws) <= DRAWS else rng.choice(s.draws, DRAWS, replace=False)) for s in specimens]
    weights = [_weights(d, scale(s.prior)) for d, s in zip(draws, specimens)]
    centre = np.array([np.average(d, weights=w) for d, w in zip(draws, weights)])
    error = np.array([np.sqrt(np.average((d - c) ** 2, weights=w)) for d, w, c in zip(draws, weights, centre)])

    wide = float(np.hypot(np.std(centre), np.median(error)))
    n = len(specimens)
    mean = np.mean(centre) + 6.0 * wide / np.sqrt(n) * np.linspace(-1.0, 1.0, GRID)
    tau = _spreads(wide, float(np.median(error)), n)
    log_like = np.stack([_log_likelihood(d, w, mean, tau) for d, w in zip(draws, weights)])  # (specimens, μ, τ)
    measure = np.log(np.gradient(tau))  # flat in τ
    posterior = _normalised(log_like.sum(axis=0) + measure)
    if not np.all(np.isfinite(posterior)):
        return None
    middle = _quantiles(mean, posterior.sum(axis=1))
    between = _quantiles(tau, posterior.sum(axis=0))
    flat = rng.choice(posterior.size, 4000, p=posterior.ravel())
    at, width = mean[flat // GRID], tau[flat % GRID]
    unseen = np.quantile(at + width * rng.standard_normal(flat.size), [0.05, 0.95])
    surprise = []
    for i in range(n):
        others = _normalised(log_like.sum(axis=0) - log_like[i] + measure)
        sd = np.sqrt(tau**2 + error[i] ** 2)
        tail = float(np.sum(others * stats.norm.cdf((centre[i] - mean[:, None]) / sd)))
        surprise.append(2.0 * min(tail, 1.0 - tail))
    back = np.exp if relative else np.asarray
    return Population(
        tuple(s.name for s in specimens),
        relative,
        _three(back(middle)),
        _three(between),
        (float(back(unseen[0])), float(back(unseen[1]))),
        tuple(surprise),
    )


def _three(x: Array) -> tuple[float, float, float]:
    """(5 %, 50 %, 95 %) quantiles as median, low, high."""
    return float(x[1]), float(x[0]), float(x[2])


def _weights(draws: Array, prior: Array) -> Array:
    """1 / prior density of each draw, normalised; the prior as the normal distribution of its draws, and never so thin
    that one draw at its edge outweighs the rest."""
    z = (draws - np.mean(prior)) / max(float(np.std(prior)), 1e-12)
    log_w = np.minimum(0.5 * z**2, np.median(0.5 * z**2) + 5.0)
    w = np.exp(log_w - log_w.max())
    return w / w.sum()


def _spreads(wide: float, error: float, n: int) -> Array:
    """Spreads τ on a grid that is fine near zero and ends where no n specimens could lie."""
    most = wide * (4.0 + 40.0 / n)
    return most * np.linspace(0.02, 1.0, GRID) ** 2 + 1e-3 * min(error, wide)


def _log_likelihood(draws: Array, weights: Array, mean: Array, tau: Array) -> Array:
    """ln Σ w Normal(θ; μ, τ² + kernel²) over the draws, (μ, τ)."""
    centre = np.average(draws, weights=weights)
    sd = np.sqrt(np.average((draws - centre) ** 2, weights=weights))
    narrow = 0.5 * len(draws) ** -0.2  # of the draws' own spread; shrinking the draws keeps their variance
    points = centre + np.sqrt(1.0 - narrow**2) * (draws - centre)
    out = np.empty((mean.size, tau.size))
    for j, t in enumerate(tau):
        width = np.hypot(t, narrow * sd)
        half = 0.5 * ((points - mean[:, None]) / width) ** 2
        least = half.min(axis=1)
        out[:, j] = np.log(np.exp(least[:, None] - half) @ weights) - least - np.log(width)
    return out


def _normalised(log_density: Array) -> Array:
    p = np.exp(log_density - log_density.max())
    return p / p.sum()


def _quantiles(x: Array, p: Array) -> Array:
    """(5 %, 50 %, 95 %) of a distribution with mass p at x, mass spread evenly around each."""
    upto = np.cumsum(p) - 0.5 * p
    return np.interp([0.05, 0.5, 0.95], upto, x)
