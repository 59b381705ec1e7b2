"""A leading model sampled, its discrepancy with it, in place of Laplace's approximation."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.discrepancy_size import LENGTHS
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.inference.setup.priors import Z_LIMIT
from bayes_iwan.sampling.chains import Stop
from bayes_iwan.sampling.moves.metropolis import LeastSquares
from bayes_iwan.sampling.nuisance import Nuisance, log_mean_exp
from bayes_iwan.sampling.plan import Plan
from bayes_iwan.sampling.run import sample

#: seconds that one model may be sampled for
BUDGET_S = 45.0
_TRIED = 4096  # sizes of the discrepancy from which those at the optimum are learnt


@dataclass(frozen=True)
class Sampling:
    """Quality of the draws behind a fit's numbers: did they converge, why they ended and what is short of its
    target, the least effective number of draws and the largest R-hat of any number (None where there are no draws)."""

    converged: bool
    message: str
    least_ess: float | None
    worst_r_hat: float | None


class Target:
    """ln posterior over (z, score of ln share, score of ln length), each standard normal under its prior."""

    def __init__(self, data: GapData, fit: Fit) -> None:
        self.residuals = Rows(data, fit.problem, fit.size.between)
        self.ndim, self.size = len(fit.z) + 2, fit.size
        self.held: NDArray[np.int64] = np.array([self.ndim - 2, self.ndim - 1])
        self.names = (*fit.problem.names, "discrepancy_share", "discrepancy_length")
        self.share_prior = stats.lognorm(s=1.2, scale=4.0 * calibration().usual[0])

    def _variance(self, held: Array) -> Array:
        """(n, m) of the rows, with nuisance parameters (n, 2)."""
        share = self.share_prior.kwds["scale"] * np.exp(self.share_prior.kwds["s"] * held[:, 0])
        length = np.clip(np.sqrt(LENGTHS[0] * LENGTHS[-1]) * np.exp(0.5 * held[:, 1]), 0.01, 0.5)
        return self.residuals.discrepancy.variances(share, length, self.size)

    def residual(self, z: Array) -> Array:
        """Residuals (n, m) in units of the noise at z (n, ndim)."""
        return self.residuals.residual(z[:, :-2])

    def rows(self, z: Array) -> Array:
        """Whitened residuals (n, m) at z (n, ndim)."""
        return self.residual(z) / np.sqrt(self._variance(z[:, -2:]))

    def log_prob_of_held(self, z: Array, held: Array) -> Array:
        """(n, count) with nuisance parameters (n, count, 2) in the place of z's own, −∞ outside ±Z_LIMIT."""
        with np.errstate(all="ignore"):
            square = self.residuals.residual(np.clip(z[:, :-2], -Z_LIMIT, Z_LIMIT)) ** 2
            value = np.empty(held.shape[:2])
            for i, one in enumerate(square):  # all at once would be hundreds of megabytes
                variance = self._variance(np.clip(held[i], -Z_LIMIT, Z_LIMIT))
                value[i] = -0.5 * np.sum(one / variance + np.log(variance), axis=1)
        value -= 0.5 * np.sum(z[:, :-2] ** 2, axis=1)[:, None] + 0.5 * np.sum(held**2, axis=2)
        inside = np.all(np.abs(z[:, :-2]) <= Z_LIMIT, axis=1)[:, None] & np.all(np.abs(held) <= Z_LIMIT, axis=2)
        return np.where(inside & np.isfinite(value), value, -np.inf)

    def held_at(self, z: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Mean (2,) and lower triangular root (2, 2) of the covariance of the nuisance parameters at z (1, ndim)."""
        tried = rng.standard_normal((1, _TRIED, 2))
        log_w = self.log_prob_of_held(z, tried) + 0.5 * np.sum(tried**2, axis=2)
        weight = np.diff(log_mean_exp(log_w)[1][0], prepend=0.0)
        mean = weight @ tried[0]
        apart = tried[0] - mean
        return mean, np.linalg.cholesky((apart.T * weight) @ apart + 1e-4 * np.eye(2))


def sampled_fit(data: GapData, fit: Fit, seed: int, progress: Callable[[str], None]) -> tuple[Fit, Sampling]:
    """The fit with mean and covariance of z from draws (numbers of effects and of the base alike), its optimum kept
    where they did not converge. And the quality of the draws. Raises KeyboardInterrupt where it was interrupted."""
    progress(f"sampling {fit.name}")
    target = Target(data, fit)
    z = np.concatenate([fit.z[None], fit.optima])
    mean, root = target.held_at(np.append(fit.z, [0.0, 0.0])[None], np.random.default_rng([seed, 3]))
    starts = np.concatenate([z, np.tile(mean, (len(z), 1))], axis=1)
    log_prob = target.log_prob_of_held(starts, starts[:, None, -2:])[:, 0]
    order = np.argsort(-log_prob)
    posterior = LeastSquares(
        target.rows, target.log_prob_of_held, Nuisance(target.held, mean, root), target.ndim, Z_LIMIT
    )
    chains = sample(
        lambda z: target.log_prob_of_held(z, z[:, None, -2:])[:, 0],
        posterior,
        starts[order],
        Plan(target.names, seed, budget_s=BUDGET_S, progress=False),
    )
    if chains.stop is Stop.INTERRUPTED:
        raise KeyboardInterrupt
    draws = chains.flat(4000)[:, : len(fit.z)]
    drawn = replace(
        fit,
        covariance=np.cov(draws.T) + 1e-12 * np.eye(len(fit.z)),
        z=draws.mean(axis=0) if chains.converged else fit.z,
        converged=fit.converged and chains.converged,
    )
    quality = chains.convergence
    least, worst = (None, None) if quality is None else (quality.least_ess, quality.worst_r_hat)
    return drawn, Sampling(chains.converged, chains.message, least, worst)
