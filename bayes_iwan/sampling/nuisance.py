"""Nuisance parameters, those of the noise: integrated out at every place, since they cost no prediction.

The integral over them is estimated by importance sampling and is unbiased, so nothing is approximated when it stands in
the place of the density (pseudo-marginal: Andrieu & Roberts, Ann. Stat. 37, 2009, 697). One of its draws is kept. An
estimate that is too high by chance would hold a chain back, so all draws but the kept one are drawn anew before every
step, which leaves the posterior as it is (conditional importance sampling: Andrieu, Lee & Vihola, Bernoulli 24, 2018,
842).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import gammaln

from bayes_iwan.arrays import Array

#: z (n, ndim), nuisance parameters (n, count, columns) in the place of z's own → ln p (n, count)
NuisanceFunction = Callable[[Array, Array], Array]

#: degrees of freedom of the t distribution that they are drawn from, and its scale over the posterior's
_NU, _WIDER = 6.0, 1.2


class Integrated(NamedTuple):
    """ln of the posterior with the nuisance parameters integrated out (n,); z (n, ndim) with one of their draws in
    their place; ln of the posterior there (n,)."""

    log_total: Array
    z: Array
    log_prob: Array


@dataclass(frozen=True)
class Nuisance:
    """Which coordinates they are, the centre (columns,) of their t distribution, the lower triangular root of the
    covariance that they seem to have, and how many draws an integral takes: few make it noisy, which wastes proposals;
    many cost little, since they take no prediction."""

    columns: NDArray[np.int64]
    centre: Array
    root: Array
    count: int = 64

    def integrated(
        self, log_prob: NuisanceFunction, z: Array, random: np.random.RandomState, keep: bool = False
    ) -> Integrated:
        """The integral at z (n, ndim).

        keep : z's own nuisance parameters are one of the draws, in the place of the first.
        """
        n, width = len(z), len(self.columns)
        unit = t_draws(random, (n, self.count if width else 1, width), _NU)
        chance = random.random_sample(n)
        if keep and width:
            unit[:, 0] = solve_triangular(_WIDER * self.root, (z[:, self.columns] - self.centre).T, lower=True).T
        drawn = self.centre + unit @ (_WIDER * self.root).T
        log_density = t_log_density(unit, _NU) - np.log(_WIDER * np.diag(self.root)).sum()
        level = log_prob(z, drawn)
        total, cumulative = log_mean_exp(level - log_density)
        pick = (cumulative < chance[:, None]).sum(axis=1).clip(max=unit.shape[1] - 1)
        rows = np.arange(n)
        there = z.copy()
        there[:, self.columns] = drawn[rows, pick]
        return Integrated(total, there, level[rows, pick])

    def fitted(self, drawn: Array) -> Nuisance:
        """The same about the mean and covariance of draws (n, columns)."""
        if not len(self.columns):
            return self
        covariance = np.atleast_2d(np.cov(drawn.T)) + 1e-8 * np.eye(len(self.columns))
        return Nuisance(self.columns, drawn.mean(axis=0), np.asarray(np.linalg.cholesky(covariance)), self.count)


def t_draws(random: np.random.RandomState, shape: tuple[int, ...], nu: float) -> Array:
    """Standard t draws over the last axis."""
    unit = random.standard_normal(shape)
    return np.asarray(unit / np.sqrt(random.chisquare(nu, shape[:-1]) / nu)[..., None])


def t_log_density(unit: Array, nu: float) -> Array:
    """(…,) of standard t draws (…, ndim)."""
    ndim = unit.shape[-1]
    norm = gammaln(0.5 * (nu + ndim)) - gammaln(0.5 * nu) - 0.5 * ndim * np.log(nu * np.pi)
    return np.asarray(norm - 0.5 * (nu + ndim) * np.log1p(np.sum(unit * unit, axis=-1) / nu))


def log_mean_exp(x: Array) -> tuple[Array, Array]:
    """(n,) logarithm of the mean of e^x (n, count), and the terms' shares added up (n, count); −∞ where all are."""
    top = np.max(x, axis=1, keepdims=True)
    part = np.exp(x - np.where(np.isfinite(top), top, 0.0))
    total = part.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (top + np.log(total / x.shape[1]))[:, 0], np.nan_to_num(np.cumsum(part, axis=1) / total, nan=1.0)
