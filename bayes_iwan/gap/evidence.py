"""Evidence of one model for a campaign's data: refit from several starts, Laplace's approximation, and a grid over the
rest that stands beside every model.

measured = simulator(base + effects) + rest + noise. The rest is Gaussian, smooth along the loop and between tests, of
share a of the friction force (:class:`bayes_iwan.inference.discrepancy.Correlated`), and changes along the record by a
share b. Its sizes are inferred for every set of effects and need not be small: the prior over a is flat in ln a, so a
cause may explain a part of the gap and leave the rest without a name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect, effects_of
from bayes_iwan.gap.data import GapData, predicted
from bayes_iwan.inference.discrepancy import discrepancy_spectrum
from bayes_iwan.inference.problem import Problem, iwan_model, make_problem
from bayes_iwan.inference.scales import Scales
from bayes_iwan.inference.settings import DiagnoseSettings, IdentifySettings, LikelihoodSettings, ParameterChange
from bayes_iwan.optimize.least_squares import LeastSquaresFit, least_squares_batch
from bayes_iwan.physics import Model, Simulator

#: grid of the discrepancy: RMS share of the friction level, and correlation length in cycles
SHARES = np.geomspace(5e-4, 0.4, 12)
LENGTHS = np.array([0.03, 0.1])
#: shares of the friction level by which the rest may change along the record
ALONG_SHARES = np.array([0.0, 0.004, 0.016, 0.064, 0.256])
#: the point of the grid at which models are fitted first
FIRST = (0.01, 0.05, 0.004)
#: relative change of a cost of some hundreds at which a refit ends: a tenth of a nat
TOLERANCE = 2e-4
#: z of every parameter stays within these prior standard deviations
Z_BOX = 5.0
_FIXED_NOISE = {
    "noise_scale": ParameterChange(fixed=1.0),
    "discrepancy_share": ParameterChange(fixed=FIRST[0]),
    "discrepancy_length": ParameterChange(fixed=FIRST[1]),
}


class FitError(ValueError):
    """A model that has no finite force for these tests."""


@dataclass(frozen=True)
class Fit:
    """One model refitted to the data.

    z : (ndim,) optimum at the grid's best point; log_z : (shares, lengths) ln evidence over the grid, the change of
        the rest along the record averaged over
    share, length, along : the best point; covariance : (ndim, ndim) of z there
    residual : (m,) measured − predicted and jacobian (m, ndim), d predicted / dz, both rotated but not whitened, in
        units of the noise; eigen : (m,) variance of the discrepancy per unit a² · spectrum; order : (m,) harmonic
    optima : (k, ndim) distinct optima found, best first
    """

    problem: Problem
    z: Array
    log_z: Array
    share: float
    length: float
    along: float
    covariance: Array
    optima: Array
    linear: Linear
    converged: bool

    @property
    def name(self) -> str:
        return "+".join(e.name for e in self.effects) or "none"

    @property
    def effects(self) -> tuple[Effect, ...]:
        return effects_of(self.problem)

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects in the model."""
        return frozenset(e.name for e in self.effects)

    @cached_property
    def log_evidence(self) -> float:
        """ln ∫ Z(a, ℓ) p(a, ℓ), p flat in ln a and over the lengths."""
        return float(np.logaddexp.reduce(self.log_z.ravel()) - np.log(self.log_z.size))

    @cached_property
    def rest_share(self) -> tuple[float, float, float]:
        """The rest's size as a share of the friction level: median and 90 % interval of its posterior."""
        weight = np.exp(np.logaddexp.reduce(self.log_z, axis=1) - np.logaddexp.reduce(self.log_z.ravel()))
        below = np.cumsum(weight) - 0.5 * weight
        low, middle, high = np.exp(np.interp([0.05, 0.5, 0.95], below, np.log(SHARES)))
        return float(middle), float(low), float(high)


@dataclass(frozen=True)
class Rest:
    """How noise and rest add up in rows that are scaled by the noise: variance = 1 + a² S_order(ℓ) eigen.

    eigen (m,), order (m,) the harmonic, changing (m,) rows of the change along the record, whose share is b instead
    of a; rows with eigen = 0 (lines of the mains) carry none.
    """

    eigen: Array
    order: NDArray[np.int64]
    changing: NDArray[np.bool_]

    def variance(self, share: float, length: float, along: float) -> Array:
        """(m,) variance of each row at shares a and b and length ℓ (cycles); changes are as smooth as they get."""
        return self.variances(np.array([share]), np.array([length]), along)[0]

    def variances(self, share: Array, length: Array, along: float) -> Array:
        """(draws, m) the same for several a and ℓ, (draws,) each."""
        top = int(self.order.max(initial=0)) + 1
        loop = discrepancy_spectrum(share, length, top)[:, self.order]
        change = discrepancy_spectrum(np.array([along]), LENGTHS[-1:], top)[0, self.order]
        return 1.0 + np.where(self.changing, change, loop) * self.eigen


@dataclass(frozen=True)
class Linear:
    """Residual and Jacobian at an optimum in coordinates in which noise and discrepancy are both diagonal.

    residual (m,), jacobian (m, ndim) in units of the noise. z (ndim,): the point of linearisation.
    """

    residual: Array
    jacobian: Array
    rest: Rest
    z: Array

    def variance(self, share: float, length: float, along: float) -> Array:
        """(m,) see :meth:`Rest.variance`."""
        return self.rest.variance(share, length, along)

    def evidence(self, share: float, length: float, along: float) -> tuple[float, tuple[Array, Array]]:
        """ln evidence at one grid point by one Gauss–Newton step from z; also the stepped z and its precision."""
        variance = self.variance(share, length, along)
        j = self.jacobian / np.sqrt(variance)[:, None]
        r = self.residual / np.sqrt(variance)
        precision = j.T @ j + np.eye(len(self.z))
        factor = np.linalg.cholesky(precision)
        target = j.T @ (r + j @ self.z)  # minimise |r − J(z' − z)|² + |z'|²
        z = np.linalg.solve(precision, target)
        left = r - j @ (z - self.z)
        log_z = -0.5 * (left @ left + z @ z) - 0.5 * np.sum(np.log(variance)) - np.sum(np.log(np.diagonal(factor)))
        return float(log_z), (np.asarray(z), np.asarray(precision))


def base_model(settings: DiagnoseSettings, scales: Scales) -> Model:
    """The Iwan model that a diagnosis starts from, on a campaign's scales; the gap's effects are what bends it."""
    return iwan_model(scales, replace(settings.model, embedded=False))


def base_problem(
    data: GapData, settings: DiagnoseSettings, scales: Scales, simulator: Simulator | None = None
) -> Problem:
    """The base model (a simulator, or the Iwan model of the settings), noise fixed, for the loops of `data`."""
    chosen = IdentifySettings(
        likelihood=LikelihoodSettings("matern"), parameters={**settings.parameters, **_FIXED_NOISE}
    )
    model = base_model(settings, scales) if simulator is None else simulator
    return make_problem(data.loops, chosen, model, scales)


def extended(problem: Problem, effects: Sequence[Effect]) -> Problem:
    """The same problem with these effects and no others."""
    return problem.with_effects(effects)


class Rows:
    """Residual rows of a model in units of the noise, and what is needed to whiten them by any rest."""

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
        loop = Rest(
            np.r_[values[real], values[imaginary]],
            np.r_[order[real], order[imaginary]].astype(np.int64),
            np.zeros(int(real.sum() + imaginary.sum()), dtype=bool),
        )
        self.rest = loop
        self.constant = 0.0
        changing = self._changing()
        if self.evolving:
            lines = 2 * int(self._line.sum())
            self.rest = Rest(
                np.r_[loop.eigen, changing.eigen, np.zeros(lines)],
                np.r_[loop.order, changing.order, np.zeros(lines, dtype=np.int64)],
                np.r_[loop.changing, changing.changing, np.zeros(lines, dtype=bool)],
            )
        else:  # a steady model misses all changes and lines: what that costs, whatever its numbers
            logdet = [0.5 * float(np.sum(np.log(changing.variance(0.0, LENGTHS[-1], b)))) for b in ALONG_SHARES]
            cost = [-self.missed(float(b)) - d for b, d in zip(ALONG_SHARES, logdet)]
            self.constant = float(np.logaddexp.reduce(cost) - np.log(len(cost)))

    def missed(self, along: float) -> float:
        """Half the squares of all changes along the record and lines, in units of noise and rest: a steady model's."""
        change = (self.data.trend_N / self.data.trend_noise_N)[self._trend]
        lines = np.abs(self.data.mains_N[self._line] / self.data.mains_noise_N[self._line]) ** 2
        square = np.r_[change.real, change.imag] ** 2 / self._changing().variance(0.0, LENGTHS[-1], along)
        return 0.5 * float(square.sum() + lines.sum())

    def _changing(self) -> Rest:
        """The rest in the contrasts along the record: each as large as its test's friction level times b."""
        level = np.broadcast_to(self.data.level_N[:, None, None], self.data.trend_noise_N.shape)[self._trend]
        eigen = (level / self.data.trend_noise_N[self._trend]) ** 2
        order = np.broadcast_to(np.arange(self._trend.shape[2]), self._trend.shape)[self._trend].astype(np.int64)
        return Rest(np.r_[eigen, eigen], np.r_[order, order], np.ones(2 * len(order), dtype=bool))

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
        return Linear(r[0], jacobian, self.rest, z.copy())

    def sd(self, share: float, length: float, along: float) -> Array:
        """(m,) what the rows are divided by, so that they are white."""
        return np.sqrt(self.rest.variance(share, length, along))

    def fit(self, starts: Array, share: float, length: float, along: float, iterations: int) -> LeastSquaresFit:
        """Least squares from all starts at one size of the rest."""
        sd = self.sd(share, length, along)

        def rows(z: Array) -> Array:
            with np.errstate(all="ignore"):
                return np.concatenate([self.residual(z) / sd, z], axis=1)

        box = np.tile([-Z_BOX, Z_BOX], (starts.shape[1], 1))
        return least_squares_batch(rows, starts, box, max_iterations=iterations, ftol=TOLERANCE, xtol=1e-4, gtol=1e-5)


def fit_model(data: GapData, problem: Problem, starts: Array, iterations: int = 40) -> Fit:
    """Fit a model from all starts, tabulate its evidence over the rest's grid, refit at the best point.

    Raises FitError where no start reaches a finite cost: the model has no force there.
    """
    rows = Rows(data, problem)
    found = rows.fit(starts, *FIRST, iterations)
    cost = np.where(np.isfinite(found.cost), found.cost, np.inf)
    order = np.argsort(cost)
    if not np.isfinite(cost[order[0]]):
        raise FitError(f"{'+'.join(e.name for e in effects_of(problem)) or 'the base model'}: no finite force")
    optima = _distinct(found.x[order], cost[order])
    grid = _grid(rows.linear(optima[0]))
    if abs(np.log(grid.best[0] / FIRST[0])) > 0.5:
        near = np.stack([*optima, np.clip(grid.z, -Z_BOX, Z_BOX)])  # the best there may be another one
        again = rows.fit(near, *grid.best, iterations)
        grid = _grid(rows.linear(again.x[again.best]))
    return Fit(
        problem,
        grid.linear.z,
        grid.log_z + rows.constant,
        *grid.best,
        grid.covariance,
        optima,
        grid.linear,
        bool(found.converged[order[0]]),
    )


@dataclass(frozen=True)
class _Grid:
    """ln evidence (shares, lengths) over the rest's grid; the best point and the step to its optimum z there."""

    linear: Linear
    log_z: Array
    z: Array
    covariance: Array
    best: tuple[float, float, float]


def _grid(linear: Linear) -> _Grid:
    along, change = ALONG_SHARES[0], 0.0
    if linear.rest.changing.any():  # the change along the record has its own size, found where the loops' is best
        share = max(SHARES[::2], key=lambda a: linear.evidence(float(a), LENGTHS[-1], FIRST[2])[0])
        by_change = np.array([linear.evidence(float(share), LENGTHS[-1], float(b))[0] for b in ALONG_SHARES])
        along = ALONG_SHARES[int(np.argmax(by_change))]
        change = float(np.logaddexp.reduce(by_change) - np.log(len(by_change)) - by_change.max())
    log_z = np.empty((len(SHARES), len(LENGTHS)))
    kept: dict[tuple[int, int], tuple[Array, Array]] = {}
    for i, share in enumerate(SHARES):
        for k, length in enumerate(LENGTHS):
            log_z[i, k], kept[i, k] = linear.evidence(float(share), float(length), float(along))
    i, k = divmod(int(np.argmax(log_z)), len(LENGTHS))
    z, precision = kept[i, k]
    covariance = np.asarray(np.linalg.inv(precision))
    return _Grid(linear, log_z + change, z, covariance, (float(SHARES[i]), float(LENGTHS[k]), float(along)))


def _distinct(x: Array, cost: Array, most: int = 4) -> Array:
    """Different optima, best first: those that lie apart in z and cost less than 50 more than the best."""
    kept = [x[0]]
    for one, value in zip(x[1:], cost[1:]):
        if value < cost[0] + 50.0 and all(np.max(np.abs(one - k)) > 0.3 for k in kept) and len(kept) < most:
            kept.append(one)
    return np.array(kept)
