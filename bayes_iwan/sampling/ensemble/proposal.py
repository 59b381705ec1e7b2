"""The distribution that global proposals come from: a mixture of charts, each a t distribution on a bent sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.mixture import fit_mixture, log_sum_exp
from bayes_iwan.sampling.ensemble.charts import ChartStack
from bayes_iwan.sampling.ensemble.warp import Warp, fit_warp, monomials

_CHART_FIELDS = ("mean", "axes", "sd", "shift", "spread")


@dataclass(frozen=True)
class Chart:
    """A t distribution with nu degrees of freedom in the straightened coordinates y of one warp.

    centre (ndim,) and root (ndim, ndim, lower triangular) are its location and the root of its scale matrix.
    """

    warp: Warp
    centre: Array
    root: Array
    nu: float


@dataclass(frozen=True)
class Places:
    """Places z (n, ndim) as a proposal sees them: ln(weight·density) (n, charts) of each chart, the standardised
    coordinates in it (n, charts, ndim), and their squares' sums (n, charts)."""

    z: Array
    parts: Array
    standard: Array
    squared: Array

    def put(self, rows: NDArray, other: Places) -> None:
        """Take these rows from another set of as many places, or from one of just these rows."""
        whole = len(other.z) == len(self.z)
        for name in ("z", "parts", "standard", "squared"):
            new = getattr(other, name)
            getattr(self, name)[rows] = new[rows] if whole else new


@dataclass(frozen=True)
class Proposal:
    """The density g(z) = sum_k weights[k]·chart_k(z): a plain distribution, fitted to draws and then left as it is.

    The t's polynomial tails are heavier than those of a target with Gaussian or exponential ones, so the ratio
    target/g stays bounded and independence proposals from g are safe (Mengersen & Tweedie 1996).
    """

    weights: Array  # (charts,)
    charts: tuple[Chart, ...]

    @cached_property
    def _stack(self) -> ChartStack:
        centres, roots = (np.stack([getattr(c, name) for c in self.charts]) for name in ("centre", "root"))
        return ChartStack(tuple(c.warp for c in self.charts), centres, roots)

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """nu (charts,) and the logarithms of the weights and the t's normalisations (charts,)."""
        ndim = len(self.charts[0].centre)
        nu = np.array([c.nu for c in self.charts])
        log_root = np.array([np.log(np.diag(c.root)).sum() for c in self.charts])
        norm = gammaln(0.5 * (nu + ndim)) - gammaln(0.5 * nu) - 0.5 * ndim * np.log(nu * np.pi)
        return nu, np.log(self.weights) + norm - log_root

    def at(self, z: Array) -> Places:
        """What the proposal says of places z (n, ndim)."""
        nu, constant = self._constants
        x, squared, log_det = self._stack.standard(z)
        return Places(z, constant + log_det - 0.5 * (nu + z.shape[1]) * np.log1p(squared / nu), x, squared)

    def log_density(self, z: Array) -> Array:
        """ln g (n,) at z (n, ndim)."""
        return log_sum_exp(self.at(z).parts)

    def responsibilities(self, z: Array) -> Array:
        """(n, charts) the probability that z came from each chart."""
        parts = self.at(z).parts
        return np.exp(parts - log_sum_exp(parts)[:, None])

    def step(self, now: Places, independent: float, rho: Array, random: np.random.RandomState) -> tuple[Places, Array]:
        """Proposals z' (n, ndim) that leave g in balance, and ln g(z) - ln g(z') (n,). See `MixtureMove`."""
        n, ndim = now.z.shape
        log_g = log_sum_exp(now.parts)
        fresh = random.random_sample(n) < independent
        chances = np.where(np.asarray(fresh)[:, None], self.weights, np.exp(now.parts - log_g[:, None]))
        cumulative = chances.cumsum(axis=1)
        k = (random.random_sample((n, 1)) * cumulative[:, -1:] > cumulative[:, :-1]).sum(axis=1)
        x = now.standard[np.arange(n), k]
        nu = self._constants[0][k]
        rho = np.where(fresh, 1.0, rho[random.randint(len(rho), size=n)])
        # The t's scale: from its prior for a fresh draw, else given how far out x lies.
        shape = np.where(fresh, 0.5 * nu, 0.5 * (nu + ndim))
        rate = np.where(fresh, 0.5 * nu, 0.5 * (nu + now.squared[np.arange(n), k]))
        scale = random.standard_gamma(shape) / rate
        xi = random.standard_normal((n, ndim))
        new = np.sqrt(1.0 - rho**2)[:, None] * x + (rho / np.sqrt(scale))[:, None] * xi
        there = self.at(self._stack.place(new, k))
        return there, log_g - log_sum_exp(there.parts)

    def sample(self, n: int, seed: int) -> Array:
        """(n, ndim) independent draws from g."""
        ndim = len(self.charts[0].centre)
        return self.step(self.at(np.zeros((n, ndim))), 1.0, np.ones(1), np.random.RandomState(seed))[0].z

    def to_arrays(self) -> dict[str, NDArray]:
        """All numbers of the proposal, for a checkpoint."""
        out: dict[str, NDArray] = {"weights": self.weights}
        for k, chart in enumerate(self.charts):
            out |= {f"{k}_{name}": getattr(chart.warp, name) for name in _CHART_FIELDS}
            out |= {f"{k}_centre": chart.centre, f"{k}_root": chart.root}
            out[f"{k}_whole"] = np.array([chart.warp.wide, chart.warp.degree, chart.nu])
        return out

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Proposal:
        """The proposal that `to_arrays` wrote."""
        charts = []
        for k in range(len(arrays["weights"])):
            mean, axes, sd, shift, spread = (arrays[f"{k}_{name}"] for name in _CHART_FIELDS)
            wide, degree, nu = arrays[f"{k}_whole"]
            warp = Warp(mean, axes, sd, int(wide), int(degree), shift, spread)
            charts.append(Chart(warp, arrays[f"{k}_centre"], arrays[f"{k}_root"], float(nu)))
        return cls(arrays["weights"], tuple(charts))


def fit_proposal(
    draws: Array,
    rng: np.random.Generator,
    *,
    start: Proposal | None = None,
    charts: int = 12,
    wide: int = 8,
    degree: int = 2,
    nu: float = 5.0,
    iterations: int = 8,
    most_repeats: int = 10,
) -> Proposal:
    """Fit to draws (..., ndim) by expectation–maximisation, each chart a weighted regression.

    start : go on from this proposal's assignment of draws to charts, with half as many iterations; by default a
        mixture of plain t distributions gives the first assignment.
    most_repeats : a draw that comes several times, because a walker stood still, weighs as often as it comes, up to
        this: where walkers stand still the proposal is too thin, but a few places alone are no sheet to fit.

    A chart whose draws are too few for its degree gets a lower one; one left with hardly any is dropped.
    """
    ndim = draws.shape[-1]
    z, repeats = np.unique(draws.reshape(-1, ndim), axis=0, return_counts=True)
    weights = np.minimum(repeats, most_repeats)[:, None].astype(float)
    if start is None:
        plain = fit_mixture(z, charts, rng, nu=nu, iterations=30)
        parts = plain.log_parts(z)
        r = np.exp(parts - log_sum_exp(parts)[:, None])
    else:
        r = start.responsibilities(z)
        iterations = max(1, iterations // 2)
    proposal = start
    for _ in range(iterations):
        keep = r.sum(axis=0) >= min(3.0 * ndim, r.sum(axis=0).max())  # different draws, however often they come
        r = weights * r[:, keep] / np.maximum(r[:, keep].sum(axis=1, keepdims=True), 1e-300)
        mass = r.sum(axis=0)
        fitted = tuple(_fit_chart(z, r[:, k], wide, degree, nu) for k in range(len(mass)))
        proposal = Proposal(mass / mass.sum(), fitted)
        r = proposal.responsibilities(z)
    assert proposal is not None
    return proposal


def _fit_chart(z: Array, weights: Array, wide: int, degree: int, nu: float) -> Chart:
    ndim = z.shape[1]
    rows = weights > 1e-2 * weights.max()  # what is left out weighs next to nothing and takes most of the time
    z, weights = z[rows], weights[rows]
    total = weights.sum()
    while degree > 0 and total < 8 * monomials(min(wide, ndim - 1), degree):
        degree -= 1
    warp = fit_warp(z, wide, degree, weights)
    y = warp.forward(z)[0]
    centre = (weights @ y) / total
    scale = np.eye(ndim)
    for _ in range(4):  # EM for the t's location and scale, with the identity as ndim draws of its own
        out = np.linalg.solve(np.linalg.cholesky(scale), (y - centre).T)
        u = weights * (nu + ndim) / (nu + np.einsum("in,in->n", out, out))
        centre = (u @ y) / u.sum()
        off = y - centre
        scale = ((off * u[:, None]).T @ off + ndim * np.eye(ndim)) / (total + ndim)
    return Chart(warp, centre, np.asarray(np.linalg.cholesky(scale)), nu)
