"""Evidence of one model for a campaign's data: refit from several starts, Laplace's approximation, and a grid over the
smooth misfit that a model is allowed.

Every model, with or without effects, is compared with a discrepancy beside it: Gaussian, smooth along the loop and
between tests, of share a of the friction force (:class:`bayes_iwan.inference.discrepancy.Correlated`). So a tiny misfit
makes nothing certain, and "unknown" is no special case: it is the base model with a large discrepancy. The evidence is
tabulated over (a, ℓ); priors over a come later, in :mod:`.attribution`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect, effects_of
from bayes_iwan.gap.data import GapData, predicted
from bayes_iwan.inference.discrepancy import discrepancy_spectrum
from bayes_iwan.inference.problem import Problem, make_problem
from bayes_iwan.inference.scales import Scales
from bayes_iwan.optimize.least_squares import least_squares_batch
from bayes_iwan.physics import Simulator

#: grid of the discrepancy: RMS share of the friction level, and correlation length in cycles
SHARES = np.geomspace(5e-4, 0.4, 12)
LENGTHS = np.array([0.03, 0.1])
#: the point of the grid at which models are fitted first
FIRST = (0.01, 0.05)
#: relative change of a cost of some hundreds at which a refit ends: a tenth of a nat
TOLERANCE = 2e-4
#: z of every parameter stays within these prior standard deviations
Z_BOX = 5.0
_FIXED_NOISE = {
    "noise_scale": {"fixed": 1.0},
    "discrepancy_share": {"fixed": FIRST[0]},
    "discrepancy_length": {"fixed": FIRST[1]},
}


@dataclass(frozen=True)
class Fit:
    """One model refitted to the data.

    z : (ndim,) optimum at the grid's best point; log_z : (shares, lengths) ln evidence over the grid
    share, length : the best point; covariance : (ndim, ndim) of z there
    residual : (m,) measured − predicted and jacobian (m, ndim), d predicted / dz, both rotated but not whitened, in
        units of the noise; eigen : (m,) variance of the discrepancy per unit a² · spectrum; order : (m,) harmonic
    optima : (k, ndim) distinct optima found, best first
    """

    problem: Problem
    z: Array
    log_z: Array
    share: float
    length: float
    covariance: Array
    optima: Array
    linear: Linear
    converged: bool

    @property
    def effects(self) -> tuple[Effect, ...]:
        return effects_of(self.problem)

    @property
    def name(self) -> str:
        return "+".join(e.name for e in self.effects) or "none"

    def log_evidence(self, log_prior: Array) -> float:
        """ln ∫ Z(a, ℓ) p(a, ℓ): log_prior is (shares,) or (shares, lengths), normalised."""
        prior = log_prior if log_prior.ndim == 2 else log_prior[:, None] - np.log(len(LENGTHS))
        return float(np.logaddexp.reduce((self.log_z + prior).ravel()))


@dataclass(frozen=True)
class Linear:
    """Residual and Jacobian at an optimum in coordinates in which noise and discrepancy are both diagonal.

    residual (m,), jacobian (m, ndim) in units of the noise; eigen (m,), order (m,): variance = 1 + a² S_order(ℓ) eigen;
    rows with eigen = 0 (trends, lines) carry no discrepancy. z (ndim,): the point of linearisation.
    """

    residual: Array
    jacobian: Array
    eigen: Array
    order: NDArray[np.int64]
    z: Array

    def variance(self, share: float, length: float) -> Array:
        top = int(self.order.max()) + 1
        spectrum = discrepancy_spectrum(np.array([share]), np.array([length]), top)[0]
        return 1.0 + spectrum[self.order] * self.eigen

    def evidence(self, share: float, length: float) -> tuple[float, tuple[Array, Array]]:
        """ln evidence at one grid point by one Gauss–Newton step from z; also the stepped z and its precision."""
        variance = self.variance(share, length)
        j = self.jacobian / np.sqrt(variance)[:, None]
        r = self.residual / np.sqrt(variance)
        precision = j.T @ j + np.eye(len(self.z))
        factor = np.linalg.cholesky(precision)
        target = j.T @ (r + j @ self.z)  # minimise |r − J(z' − z)|² + |z'|²
        z = np.linalg.solve(precision, target)
        left = r - j @ (z - self.z)
        log_z = -0.5 * (left @ left + z @ z) - 0.5 * np.sum(np.log(variance)) - np.sum(np.log(np.diagonal(factor)))
        return float(log_z), (np.asarray(z), np.asarray(precision))


def base_problem(data: GapData, config: dict, scales: Scales, simulator: Simulator | None = None) -> Problem:
    """The base model (a simulator, or the Iwan model of the configuration), noise fixed, for the loops of `data`."""
    parameters = {**config.get("parameters", {}), **_FIXED_NOISE}
    settings = {**config, "likelihood": {"kind": "matern"}, "parameters": parameters}
    settings["model"] = {**config.get("model", {}), "embedded": False}  # the gap's effects are what bends this model
    return make_problem(data.loops, settings, simulator, scales)


def extended(problem: Problem, effects: Sequence[Effect]) -> Problem:
    """The same problem with these effects and no others."""
    return problem.with_effects(effects)


class Rows:
    """Residual rows of a model in units of the noise, and what is needed to whiten them by any discrepancy."""

    def __init__(self, data: GapData, problem: Problem) -> None:
        self.data, self.problem = data, problem
        self.turn, values, there, _ = data.likelihood.rotation
        self.there = there.astype(bool)
        self.used = len(self.turn)
        order = np.broadcast_to(np.arange(self.used)[:, None], self.there.shape)
        real, imaginary = self.there, self.there & (order > 0)
        self.evolving = any(e.evolving for e in effects_of(problem))
        self._masks = real, imaginary
        self._trend = np.isfinite(data.trend_noise_N)
        self._line = np.isfinite(data.mains_noise_N)
        extra = 2 * (self._trend.sum() + self._line.sum()) if self.evolving else 0
        self.eigen = np.r_[values[real], values[imaginary], np.zeros(extra)]
        self.order = np.r_[order[real], order[imaginary], np.zeros(extra, dtype=int)].astype(np.int64)
        # a steady model misses all trends and lines: the same cost for every such model
        missed = np.abs(data.trend_N[self._trend] / data.trend_noise_N[self._trend]) ** 2
        lines = np.abs(data.mains_N[self._line] / data.mains_noise_N[self._line]) ** 2
        self.constant = 0.0 if self.evolving else -0.5 * float(missed.sum() + lines.sum())

    def residual(self, z: Array) -> Array:
        """Measured − predicted in units of the noise, rotated, (draws, m)."""
        data = self.data
        mean, trend, lines = predicted(data, self.problem, z)
        c = (data.harmonics_N[:, : self.used] - mean[..., : self.used]).transpose(2, 0, 1)
        turn = self.turn.transpose(0, 2, 1)
        parts = [
            (c.real @ turn).transpose(1, 0, 2)[:, self._masks[0]],
            (c.imag @ turn).transpose(1, 0, 2)[:, self._masks[1]],
        ]
        if self.evolving:
            r = ((data.trend_N - trend) / data.trend_noise_N)[:, self._trend]
            line = np.zeros((len(z), *data.mains_N.shape)) if lines is None else lines
            q = ((data.mains_N - line) / data.mains_noise_N)[:, self._line]
            parts += [r.real, r.imag, q.real, q.imag]
        return np.concatenate(parts, axis=1)

    def linear(self, z: Array, step: float = 1e-4) -> Linear:
        """Residual and central-difference Jacobian at z (ndim,), in one batch call."""
        n = len(z)
        points = np.concatenate([z[None], z + step * np.eye(n), z - step * np.eye(n)])
        r = self.residual(points)
        jacobian = (r[n + 1 :] - r[1 : n + 1]).T / (2.0 * step)
        return Linear(r[0], jacobian, self.eigen, self.order, z.copy())

    def fit(self, starts: Array, share: float, length: float, iterations: int):
        """Least squares from all starts at one discrepancy."""
        blank = Linear(np.zeros(0), np.zeros((0, 0)), self.eigen, self.order, np.zeros(0))
        sd = np.sqrt(blank.variance(share, length))

        def rows(z: Array) -> Array:
            with np.errstate(all="ignore"):
                return np.concatenate([self.residual(z) / sd, z], axis=1)

        box = np.tile([-Z_BOX, Z_BOX], (starts.shape[1], 1))
        return least_squares_batch(rows, starts, box, max_iterations=iterations, ftol=TOLERANCE, xtol=1e-4, gtol=1e-5)


def fit_model(data: GapData, problem: Problem, starts: Array, iterations: int = 40) -> Fit:
    """Fit a model from all starts, tabulate its evidence over the discrepancy grid, refit at the best point."""
    rows = Rows(data, problem)
    found = rows.fit(starts, *FIRST, iterations)
    cost = np.where(np.isfinite(found.cost), found.cost, np.inf)
    order = np.argsort(cost)
    optima = _distinct(found.x[order], cost[order])
    linear = rows.linear(optima[0])
    log_z, z, covariance, best = _grid(linear)
    if abs(np.log(SHARES[best[0]] / FIRST[0])) > 0.5:
        near = np.stack([*optima, np.clip(z, -Z_BOX, Z_BOX)])  # the best there may be another one
        again = rows.fit(near, SHARES[best[0]], LENGTHS[best[1]], iterations)
        linear = rows.linear(again.x[again.best])
        log_z, z, covariance, best = _grid(linear)
    return Fit(
        problem,
        linear.z,
        log_z + rows.constant,
        float(SHARES[best[0]]),
        float(LENGTHS[best[1]]),
        covariance,
        optima,
        linear,
        bool(found.converged[order[0]]),
    )


def _grid(linear: Linear) -> tuple[Array, Array, Array, tuple[int, int]]:
    log_z = np.empty((len(SHARES), len(LENGTHS)))
    kept: dict[tuple[int, int], tuple[Array, Array]] = {}
    for i, share in enumerate(SHARES):
        for k, length in enumerate(LENGTHS):
            log_z[i, k], kept[i, k] = linear.evidence(share, length)
    i, k = divmod(int(np.argmax(log_z)), len(LENGTHS))
    z, precision = kept[i, k]
    return log_z, z, np.asarray(np.linalg.inv(precision)), (i, k)


def _distinct(x: Array, cost: Array, most: int = 4) -> Array:
    """Different optima, best first: those that lie apart in z and cost less than 50 more than the best."""
    kept = [x[0]]
    for one, value in zip(x[1:], cost[1:]):
        if value < cost[0] + 50.0 and all(np.max(np.abs(one - k)) > 0.3 for k in kept) and len(kept) < most:
            kept.append(one)
    return np.array(kept)
