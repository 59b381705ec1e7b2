"""A leading model sampled, its discrepancy with it, in place of Laplace's approximation."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.discrepancy_size import LENGTHS
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.inference.setup.priors import Z_LIMIT
from bayes_iwan.sampling.blocks import Density
from bayes_iwan.sampling.chains import Stop
from bayes_iwan.sampling.plan import Plan
from bayes_iwan.sampling.run import sample

#: seconds that one model may be sampled for
BUDGET_S = 45.0
_TRIED = 1024  # sizes of the discrepancy among which walkers' starts are sought
_HELD_SD = 0.2  # of the discrepancy's two numbers about there


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
        self.names = (*fit.problem.names, "discrepancy_share", "discrepancy_length")
        self.share_prior = stats.lognorm(s=1.2, scale=4.0 * calibration().usual[0])

    def _variance(self, held: Array) -> Array:
        """(n, m) of the rows, with nuisance parameters (n, 2)."""
        share = self.share_prior.kwds["scale"] * np.exp(self.share_prior.kwds["s"] * held[:, 0])
        length = np.clip(np.sqrt(LENGTHS[0] * LENGTHS[-1]) * np.exp(0.5 * held[:, 1]), 0.01, 0.5)
        return self.residuals.discrepancy.variances(share, length, self.size)

    def __call__(self, z: Array) -> Array:
        """ln p (n,) at z (n, ndim), −∞ outside ±Z_LIMIT."""
        with np.errstate(all="ignore"):
            inside = np.clip(z, -Z_LIMIT, Z_LIMIT)
            square, variance = self.residuals.residual(inside[:, :-2]) ** 2, self._variance(inside[:, -2:])
            value = -0.5 * (np.sum(square / variance + np.log(variance), axis=1) + np.sum(z**2, axis=1))
        return np.where(np.all(z == inside, axis=1) & np.isfinite(value), value, -np.inf)


def sampled_fit(data: GapData, fit: Fit, seed: int, progress: Callable[[str], None]) -> tuple[Fit, Sampling]:
    """The fit with mean and covariance of z from draws (numbers of effects and of the base alike), its optimum kept
    where they did not converge. And the quality of the draws. Raises KeyboardInterrupt where it was interrupted."""
    progress(f"sampling {fit.name}")
    target = Target(data, fit)
    z = np.concatenate([fit.z[None], fit.optima])
    tried = np.random.default_rng([seed, 3]).standard_normal((_TRIED, 2))
    level = target(np.concatenate([np.tile(fit.z, (_TRIED, 1)), tried], axis=1))
    starts = np.concatenate([z, np.tile(tried[np.argmax(level)], (len(z), 1))], axis=1)
    root = np.eye(target.ndim) * _HELD_SD
    root[:-2, :-2] = np.linalg.cholesky(fit.covariance)
    every = np.arange(target.ndim)
    blocks = (every[:-2], every[-2:])
    chains = sample(
        Density(lambda x, random: target(x)[:, None], every, every[:0], blocks),
        starts[np.argsort(-target(starts))],
        root,
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
