"""A population of specimens from the posteriors of single ones: typical value, spread, and a band for further ones.

Hierarchical model of one quantity: zᵢ ~ Normal(μ, τ²) over specimens, with flat priors on μ and τ. z is the quantity on
the scale on which the specimens' common prior is standard normal, so bands stay within what the prior allows, and a
quantity that no specimen determines has the prior's band. What specimen i's loops say of zᵢ is in its posterior's
draws, less the prior that these were drawn under: the likelihood of (μ, τ) is the product over i of Σ w(z)·Normal(z; μ,
τ²) over the draws, w = 1/prior (importance reweighting of single posteriors: Hogg, Myers & Bovy 2010,
doi:10.1088/0004-637X/725/2/2166). Draws are smoothed by a narrow kernel that leaves their mean and variance as they
are, so that a τ far below their spacing has a likelihood too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special, stats
from scipy.interpolate import PchipInterpolator

from bayes_iwan.arrays import Array
from bayes_iwan.screen import on_screen

#: grid over μ and τ, and draws of each posterior
GRID, DRAWS = 40, 160
#: fewer specimens than this say nothing about a spread
LEAST = 3
#: p-value below which the population model does not fit
LEAST_FIT = 0.01
#: data set no end where the likelihood of the outer tenth of draws is at least this share of that of the middle half,
#: and at most the second at the other end: one as wide as the prior, and normal, has 0.6 at both
OPEN = 0.8, 0.5


@dataclass(frozen=True)
@on_screen
class SpecimenDraws:
    """Draws (n,) of one quantity of one specimen, and draws of the same quantity under the prior they came from."""

    name: str
    draws: Array
    prior: Array


@dataclass(frozen=True)
@on_screen
class Coordinate:
    """A monotone scale z of a quantity on which draws of its prior are standard normal; beyond these it is linear in
    the quantity (in its logarithm where it is positive).

    at_z, at_x : (knots,) increasing, x the quantity or its logarithm.
    """

    positive: bool
    at_z: Array
    at_x: Array

    def z(self, value: Array) -> Array:
        """Scores of values."""
        return _linear(np.log(value) if self.positive else np.asarray(value), self.at_x, self.at_z)

    def value(self, z: Array) -> Array:
        """Values of scores."""
        x = _linear(np.asarray(z), self.at_z, self.at_x)
        return np.exp(x) if self.positive else x


def coordinate_of(prior: Array, positive: bool) -> Coordinate | None:
    """The scale from draws of the prior (n,); None where they do not vary."""
    x = np.log(prior) if positive else prior
    z = np.linspace(-2.0, 2.0, 9)
    with np.errstate(over="ignore", invalid="ignore"):
        knots = np.quantile(x, stats.norm.cdf(z))
        if not np.all(np.isfinite(knots)) or not np.all(np.isfinite(np.diff(knots))) or np.min(np.diff(knots)) <= 0.0:
            return None
    fine = np.linspace(z[0], z[-1], 401)
    return Coordinate(positive, fine, PchipInterpolator(z, knots)(fine))


def _linear(x: Array, from_: Array, to: Array) -> Array:
    """Interpolation, linear beyond the ends too."""
    out = np.interp(x, from_, to)
    for end, inner, beyond in ((0, 1, x < from_[0]), (-1, -2, x > from_[-1])):
        slope = (to[end] - to[inner]) / (from_[end] - from_[inner])
        out = np.where(beyond, to[end] + slope * (x - from_[end]), out)
    return out


@dataclass(frozen=True)
@on_screen
class Population:
    """One quantity over specimens: median and 90 % interval of the typical value and of the spread.

    typical : the median specimen, in the quantity's unit; typical_draws (n,) of it. spread : standard deviation between
    specimens, as a share of the typical value if `relative`, else in the quantity's unit. next_specimen : 90 % interval
    for a specimen not yet seen. pit : for each specimen the probability of a smaller value, learnt from the others
    alone, with its own posterior's error; uniform where the population is as the model says.
    open_end : "lower" or "upper" where the data of half the specimens or more do not set that end, so that the tail of
    their prior alone decides; else "". centre, error : (specimens,) of each on the scale z, the prior taken off.
    from_others : (specimens, μ, τ) probability of mean and tau, (μ,) and (τ,), from all others.
    """

    names: tuple[str, ...]
    relative: bool
    typical: tuple[float, float, float]
    spread: tuple[float, float, float]
    next_specimen: tuple[float, float]
    pit: tuple[float, ...]
    open_end: str
    typical_draws: Array
    coordinate: Coordinate
    centre: Array
    error: Array
    mean: Array
    tau: Array
    from_others: Array

    def fits(self) -> float:
        """p-value of the population model: do specimens lie where the others say (Kolmogorov–Smirnov on `pit`)?"""
        return float(stats.kstest(self.pit, "uniform").pvalue)

    @property
    def doubt(self) -> str:
        """Why typical value, spread and band say nothing; "" where they do."""
        if self.open_end:
            return f"{self.open_end} end not known"
        return "" if self.fits() >= LEAST_FIT else "does not fit"


def population(specimens: Sequence[SpecimenDraws], seed: int = 0) -> Population | None:
    """The population of one quantity; None for fewer than :data:`LEAST` specimens, for draws that do not vary, and for
    such as differ by more than double precision can hold."""
    if len(specimens) < LEAST:
        return None
    every = np.concatenate([s.draws for s in specimens])
    before = np.concatenate([s.prior for s in specimens])
    if not np.all(np.isfinite(every)) or any(np.ptp(s.draws) == 0.0 for s in specimens):
        return None
    relative = bool(np.all(every > 0.0) and np.all(before > 0.0))
    coordinate = coordinate_of(before, relative)
    if coordinate is None:
        return None
    rng = np.random.default_rng([seed, 61])
    draws = [
        coordinate.z(s.draws if len(s.draws) <= DRAWS else rng.choice(s.draws, DRAWS, replace=False)) for s in specimens
    ]
    weights = [prior_weights(d, coordinate.z(s.prior)) for d, s in zip(draws, specimens)]
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
    flat = rng.choice(posterior.size, 4000, p=posterior.ravel())
    step = mean[1] - mean[0]
    at, width = mean[flat // GRID] + step * (rng.random(flat.size) - 0.5), tau[flat % GRID]
    typical = coordinate.value(at)
    middle = coordinate.value(_quantiles(mean, posterior.sum(axis=1)))
    small = 0.01 * wide
    steep = float((coordinate.value(at.mean() + small) - coordinate.value(at.mean() - small)) / (2.0 * small))
    between = _quantiles(tau, posterior.sum(axis=0)) * steep / (float(middle[1]) if relative else 1.0)
    another = coordinate.value(np.quantile(at + width * rng.standard_normal(flat.size), [0.05, 0.95]))
    whole = np.concatenate([every, before])  # a bounded quantity stays within its bounds
    low, high = map(float, np.clip(another, whole.min(), whole.max()))
    from_others = np.stack([_normalised(log_like.sum(axis=0) - log_like[i] + measure) for i in range(n)])
    pit = tuple(_smaller(d, w, mean, tau, p) for d, w, p in zip(draws, weights, from_others))
    end = next((e for e in ("lower", "upper") if 2 * sum(_open_end(s) == e for s in specimens) >= n), "")
    names, known = tuple(s.name for s in specimens), (coordinate, centre, error, mean, tau, from_others)
    return Population(names, relative, _three(middle), _three(between), (low, high), pit, end, typical, *known)


def _three(x: Array) -> tuple[float, float, float]:
    """(5 %, 50 %, 95 %) quantiles as median, low, high."""
    return float(x[1]), float(x[0]), float(x[2])


def _open_end(specimen: SpecimenDraws) -> str:
    """The end of a quantity that a specimen's data do not set, if they set the other."""
    low, first, third, high = np.quantile(specimen.draws, [0.1, 0.25, 0.75, 0.9])
    prior = specimen.prior
    middle = 0.5 / max(float(np.mean((prior > first) & (prior < third))), 1e-9)
    ends = {"lower": prior < low, "upper": prior > high}
    share = {end: 0.1 / max(float(np.mean(beyond)), 1e-9) / middle for end, beyond in ends.items()}
    open_, other = sorted(share, key=lambda end: -share[end])
    return open_ if share[open_] >= OPEN[0] and share[other] <= OPEN[1] else ""


def prior_weights(draws: Array, prior: Array) -> Array:
    """1 / prior density of each draw, normalised; the prior as the normal distribution of its draws, and never so thin
    that one draw at its edge outweighs all others."""
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


def _smaller(draws: Array, weights: Array, mean: Array, tau: Array, known: Array) -> float:
    """Probability of a smaller value than a specimen's in the population that is so known (μ, τ): the mean over its own
    draws, which of normal ones is Φ((centre − μ)/√(τ² + error²)), and of skewed ones not."""
    below = np.stack([special.ndtr((draws - mean[:, None]) / t) @ weights for t in tau], axis=1)
    return float(np.sum(known * below))


def _normalised(log_density: Array) -> Array:
    p = np.exp(log_density - log_density.max())
    return p / p.sum()


def _quantiles(x: Array, p: Array) -> Array:
    """(5 %, 50 %, 95 %) of a distribution with mass p at x, mass spread evenly around each."""
    upto = np.cumsum(p) - 0.5 * p
    return np.interp([0.05, 0.5, 0.95], upto, x)
