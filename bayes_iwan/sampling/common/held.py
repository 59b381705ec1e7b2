"""Numbers that scale the residuals, those of the noise: integrated out wherever a proposal leads, for they cost no
prediction. The estimate of the integral is unbiased, so nothing is approximated: as an importance weight (importance
sampling squared: Tran et al. 2013), or in the place of the density (pseudo-marginal: Andrieu & Roberts, Ann. Stat. 37,
2009, 697). One of the integral's draws is kept. A chain whose estimate is too high by chance would stand still for
long: now and then all draws but the kept one are drawn anew, which leaves the posterior of draws and place as it is
(conditional importance sampling: Andrieu, Lee & Vihola, Bernoulli 24, 2018, 842).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import gammaln

from bayes_iwan.arrays import Array

HeldFunction = Callable[[Array, Array], Array]

#: degrees of freedom of the t distribution that they are drawn from, and its scale over the posterior's
_NU, _WIDER = 6.0, 1.2


@dataclass(frozen=True)
class Held:
    """Which coordinates they are, the centre (held,) of their t distribution, and the lower triangular root of the
    covariance that they seem to have; count : draws that an integral takes."""

    columns: NDArray[np.int64]
    centre: Array
    root: Array
    count: int

    def chances(self, n: int, rng: np.random.Generator) -> Array:
        """Standard t draws (n, count, held); one of nothing where nothing is held."""
        return t_draws(rng, (n, self.count if len(self.columns) else 1, len(self.columns)), _NU)

    def integrated(
        self, log_prob: HeldFunction, z: Array, unit: Array, chance: Array, keep: bool = False
    ) -> tuple[Array, Array, Array]:
        """ln of the posterior with these numbers integrated out (n,), z (n, ndim) with one of their draws in their
        place, and ln of the posterior there (n,).

        log_prob : z (n, ndim), held numbers (n, count, held) → (n, count); unit : :meth:`chances`; chance (n,) in 0…1;
        keep : z's own are one of the draws, in the place of the first.
        """
        if keep and len(self.columns):
            unit = unit.copy()
            unit[:, 0] = solve_triangular(_WIDER * self.root, (z[:, self.columns] - self.centre).T, lower=True).T
        held = self.centre + unit @ (_WIDER * self.root).T
        log_h = t_log_density(unit, _NU) - np.log(_WIDER * np.diag(self.root)).sum()
        level = log_prob(z, held)
        total, cumulative = log_mean_exp(level - log_h)
        pick = (cumulative < chance[:, None]).sum(axis=1).clip(max=unit.shape[1] - 1)
        rows = np.arange(len(z))
        there = z.copy()
        there[:, self.columns] = held[rows, pick]
        return total, there, level[rows, pick]

    def learnt(self, held: Array) -> Held:
        """The same about the mean and covariance of draws (n, held)."""
        if not len(self.columns):
            return self
        covariance = np.atleast_2d(np.cov(held.T)) + 1e-8 * np.eye(len(self.columns))
        return Held(self.columns, held.mean(axis=0), np.asarray(np.linalg.cholesky(covariance)), self.count)


def t_draws(rng: np.random.Generator, shape: tuple[int, ...], nu: float) -> Array:
    """Standard t draws over the last axis."""
    unit = rng.standard_normal(shape)
    return unit / np.sqrt(rng.chisquare(nu, shape[:-1]) / nu)[..., None]


def t_log_density(unit: Array, nu: float) -> Array:
    """(…,) of standard t draws (…, ndim)."""
    ndim = unit.shape[-1]
    norm = gammaln(0.5 * (nu + ndim)) - gammaln(0.5 * nu) - 0.5 * ndim * np.log(nu * np.pi)
    return norm - 0.5 * (nu + ndim) * np.log1p(np.sum(unit * unit, axis=-1) / nu)


def log_t(x: Array, centre: Array, root: Array, nu: float) -> Array:
    """ln of the t density (n,) of x (n, ndim) about a centre, with a lower triangular root of its scale."""
    unit = solve_triangular(root, (x - centre).T, lower=True).T
    return t_log_density(unit, nu) - np.log(np.diag(root)).sum()


def log_mean_exp(x: Array) -> tuple[Array, Array]:
    """(n,) logarithm of the mean of e^x (n, count), and the terms' shares added up (n, count); −∞ where all are."""
    top = np.max(x, axis=1, keepdims=True)
    part = np.exp(x - np.where(np.isfinite(top), top, 0.0))
    total = part.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (top + np.log(total / x.shape[1]))[:, 0], np.nan_to_num(np.cumsum(part, axis=1) / total, nan=1.0)
