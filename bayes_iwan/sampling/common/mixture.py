"""A mixture of multivariate t distributions, fitted to draws by expectation–maximisation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from bayes_iwan.arrays import Array


@dataclass(frozen=True)
class StudentMixture:
    """sum_k weights[k] · t_nu(x; means[k], scales[k] scales[k]ᵀ), with scales lower triangular.

    The t's polynomial tails are heavier than those of any target with Gaussian or exponential ones, so the ratio
    target/mixture stays bounded and independence proposals from it are safe (Mengersen & Tweedie 1996).
    """

    weights: Array  # (K,)
    means: Array  # (K, ndim)
    scales: Array  # (K, ndim, ndim)
    nu: float

    @cached_property
    def log_weights(self) -> Array:
        return np.log(self.weights)

    @cached_property
    def _whitening(self) -> tuple[Array, Array, Array]:
        """One matrix product that whitens for all components, its shift, and the log normalisations."""
        k, ndim = self.means.shape
        inverse = np.linalg.inv(self.scales)
        shift = np.einsum("kij,kj->ki", inverse, self.means)
        log_det = np.log(np.abs(np.einsum("kjj->kj", self.scales))).sum(axis=1)
        constant = gammaln(0.5 * (self.nu + ndim)) - gammaln(0.5 * self.nu) - 0.5 * ndim * np.log(self.nu * np.pi)
        return np.ascontiguousarray(inverse.reshape(k * ndim, ndim).T), shift.ravel(), constant - log_det

    def squared_distances(self, x: Array) -> Array:
        """(n, K) squared Mahalanobis distances of x (n, ndim) from the components."""
        matrix, shift, _ = self._whitening
        y = (x @ matrix - shift).reshape(len(x), *self.means.shape)
        return np.einsum("nkj,nkj->nk", y, y)

    def log_parts(self, x: Array, distances: Array | None = None) -> Array:
        """(n, K) logarithms of weights[k]·t_k(x); `distances` may be passed if they are known."""
        ndim = self.means.shape[1]
        distances = self.squared_distances(x) if distances is None else distances
        tail = -0.5 * (self.nu + ndim) * np.log1p(distances / self.nu)
        return tail + (self._whitening[2] + self.log_weights)

    def log_density(self, x: Array) -> Array:
        """(n,) logarithm of the density at x (n, ndim)."""
        return log_sum_exp(self.log_parts(x))

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """(n, ndim) independent draws."""
        k = rng.choice(len(self.weights), size=n, p=self.weights)
        spread = np.sqrt(rng.chisquare(self.nu, size=n) / self.nu)
        xi = rng.standard_normal((n, self.means.shape[1])) / spread[:, None]
        return self.means[k] + np.einsum("nij,nj->ni", self.scales[k], xi)


def log_sum_exp(parts: Array) -> Array:
    """(n,) of (n, K), without overflow."""
    top = parts.max(axis=1)
    return top + np.log(np.exp(parts - top[:, None]).sum(axis=1))


def fit_mixture(
    x: Array,
    components: int,
    rng: np.random.Generator,
    *,
    nu: float = 8.0,
    iterations: int = 60,
    tolerance: float = 1e-3,
) -> StudentMixture:
    """Fit a mixture of t distributions to draws x (n, ndim) by EM (Peel & McLachlan 2000) with nu held.

    Covariances are drawn towards the draws' own covariance with the weight of ndim draws, so that a component
    with few draws cannot collapse; components left with fewer than two draws' weight a dimension are dropped.
    """
    n, ndim = x.shape
    centre = x.mean(axis=0)
    pooled = np.cov(x, rowvar=False).reshape(ndim, ndim) + 1e-12 * float(np.var(x)) * np.eye(ndim)
    root = np.linalg.cholesky(pooled)
    y = np.linalg.solve(root, (x - centre).T).T  # whitened: the fit does not depend on units
    means = _seeds(y, components, rng)
    # Start from small round components of equal weight, EM does the rest.
    size = 0.7
    mixture = StudentMixture(
        np.full(components, 1.0 / components), means, np.tile(size * np.eye(ndim), (components, 1, 1)), nu
    )
    last = -np.inf
    for _ in range(iterations):
        parts = mixture.log_parts(y)
        log_g = log_sum_exp(parts)
        r = np.exp(parts - log_g[:, None])
        level = log_g.mean()
        if abs(level - last) < tolerance:
            break
        last = level
        ru = r * (nu + ndim) / (nu + mixture.squared_distances(y))
        mass = r.sum(axis=0)
        keep = mass > 2.0 * ndim
        if not keep.any():
            keep[np.argmax(mass)] = True
        r, ru, mass = r[:, keep], ru[:, keep], mass[keep]
        means = (ru.T @ y) / ru.sum(axis=0)[:, None]
        scales = np.empty((len(mass), ndim, ndim))
        for k in range(len(mass)):
            off = y - means[k]
            spread = (ru[:, k, None] * off).T @ off
            # in whitened units the pooled covariance is the identity; its share shrinks with the component's size
            share = mass[k] / n
            scales[k] = np.linalg.cholesky((spread + ndim * share * np.eye(ndim)) / (mass[k] + ndim))
        mixture = StudentMixture(mass / mass.sum(), means, scales, nu)
    return StudentMixture(mixture.weights, centre + mixture.means @ root.T, root @ mixture.scales, nu)


def _seeds(y: Array, k: int, rng: np.random.Generator) -> Array:
    """k of the rows of y, far from each other at random (k-means++)."""
    chosen = [int(rng.integers(len(y)))]
    nearest = np.full(len(y), np.inf)
    for _ in range(k - 1):
        nearest = np.minimum(nearest, ((y - y[chosen[-1]]) ** 2).sum(axis=1))
        total = nearest.sum()
        chosen.append(int(rng.choice(len(y), p=nearest / total)) if total > 0 else int(rng.integers(len(y))))
    return y[chosen].copy()
