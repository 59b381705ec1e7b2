"""A leading model sampled with emcee, its discrepancy with it, in place of Laplace's approximation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.gap.fitting.data import GapData
from bayes_iwan.gap.fitting.evidence import Fit, Rows
from bayes_iwan.gap.fitting.rest import LENGTHS
from bayes_iwan.gap.judging.calibration import calibration
from bayes_iwan.inference.setup.parameters import Z_LIMIT
from bayes_iwan.sampling.ensembles import sample
from bayes_iwan.sampling.walkers import enough_walkers

#: seconds that one model may be sampled for
BUDGET_S = 100.0


class Target:
    """ln posterior over (z, score of ln share, score of ln length), each standard normal under its prior."""

    def __init__(self, data: GapData, fit: Fit) -> None:
        self.rows = Rows(data, fit.problem)
        self.ndim, self.size = len(fit.z) + 2, fit.size
        self.share_prior = stats.lognorm(s=1.2, scale=4.0 * calibration().usual[0])

    def log_prob(self, points: Array) -> Array:
        """(n, ndim) to (n,)."""
        inside = np.all(np.abs(points) <= Z_LIMIT, axis=1)
        z = np.clip(points, -Z_LIMIT, Z_LIMIT)
        share = self.share_prior.kwds["scale"] * np.exp(self.share_prior.kwds["s"] * z[:, -2])
        length = np.clip(np.sqrt(LENGTHS[0] * LENGTHS[-1]) * np.exp(0.5 * z[:, -1]), 0.01, 0.5)
        with np.errstate(all="ignore"):
            r = self.rows.residual(z[:, :-2])
            variance = self.rows.rest.variances(share, length, self.size)
            value = -0.5 * np.sum(r * r / variance + np.log(variance), axis=1) - 0.5 * np.sum(points**2, axis=1)
        return np.where(inside & np.isfinite(value), value, -np.inf)


def sampled_fit(data: GapData, fit: Fit, seed: int, progress: Callable[[str], None]) -> Fit:
    """The fit with mean and covariance of z from emcee's draws (numbers of effects and of the base alike)."""
    progress(f"sampling {fit.name}")
    target = Target(data, fit)
    rng = np.random.default_rng([seed, 3])
    n = len(fit.z)
    root = np.linalg.cholesky(fit.covariance)
    share = (np.log(fit.size.share) - np.log(4.0 * calibration().usual[0])) / 1.2 + 0.3 * rng.standard_normal((512, 1))
    start = np.concatenate(
        [fit.z + 1.5 * rng.standard_normal((512, n)) @ root.T, share, 0.5 * rng.standard_normal((512, 1))], axis=1
    )
    names = (*fit.problem.names, "discrepancy_share", "discrepancy_length")
    chains = sample(
        target.log_prob,
        start,
        names=names,
        seed=seed,
        n_walkers=max(40, enough_walkers(len(names))),
        budget_s=BUDGET_S,
        progress=True,
    )
    draws = chains.flat(4000)[:, :n]
    covariance = np.cov(draws.T) + 1e-12 * np.eye(n)
    return replace(
        fit,
        covariance=covariance,
        z=draws.mean(axis=0) if chains.converged else fit.z,
        converged=fit.converged and chains.converged,
    )
