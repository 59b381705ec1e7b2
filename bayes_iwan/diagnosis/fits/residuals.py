"""The residual of a fit in newtons, and what noise, small discrepancies and refitting would make of it.

Residual = measured − predicted. A :class:`Residual` holds it test by test as one row of complex numbers: harmonics of
the averaged loop, contrasts between blocks of cycles, lines of the mains. Each number comes with its standard error
and with the weight at which its square counts in a mean square force.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.constants import TREND_FLOOR
from bayes_iwan.diagnosis.fits.data import TREND_HARMONICS, GapData, predicted
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.residual_rows import STEP, Rows, slopes
from bayes_iwan.effects.by_test import ByTest
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.spectrum import between_tests, discrepancy_spectrum
from bayes_iwan.screen import on_screen

#: kinds of numbers: harmonics of the averaged loop, its mean, contrasts between blocks of cycles, lines of the mains
LOOP, MEAN, ALONG, MAINS = 0, 1, 2, 3
#: what a gap is made of. The mean is not: it hangs on where the specimen comes to a standstill, which no dynamic
#: displacement tells
COUNTED = (LOOP, ALONG, MAINS)


@dataclass(frozen=True)
@on_screen
class Residual:
    """Residuals of one model for the tests of `data` (T of them, M complex numbers each).

    value : (T, M) complex, N; 0 where there is no datum
    noise : (T, M) standard error of real (= imaginary) part, as the records' repeatability gives it
    allowed : (T, M) the same with what needs no cause: the discrepancy position, slight changes along the record
    weight : (T, M), so that Σ weight·|value|² is the mean square of the residual force over a test's record, N²
    real : (M,) numbers without an imaginary part (means)
    kind : (M,) LOOP, MEAN, ALONG or MAINS; order : (M,) harmonic (−1: none); contrast : (M,) index of the contrast
        between blocks, or −1
    problem : the model as it predicts these tests
    refitted : are these the data that the model was fitted to?
    """

    data: GapData
    fit: Fit
    value: np.ndarray
    noise: Array
    allowed: Array
    weight: Array
    real: NDArray[np.bool_]
    kind: NDArray[np.int64]
    order: NDArray[np.int64]
    contrast: NDArray[np.int64]
    problem: Problem
    refitted: bool

    @cached_property
    def slope(self) -> np.ndarray:
        """(ndim, T, M) complex d predicted / dz, by central differences."""
        z, steps = self.fit.z, STEP * np.eye(len(self.fit.z))
        flat = _flat(self.data, self.problem, np.concatenate([z[None], z + steps, z - steps]))
        return np.where(self.weight > 0.0, slopes(*np.split(flat, [1, len(z) + 1])), 0.0)

    def power(self, value: np.ndarray, *kinds: int) -> Array:
        """Mean square force of complex residuals (…, T, M), by test (…, T), N²; of the kinds named."""
        at = np.isin(self.kind, kinds)
        part = value[..., at]
        return np.einsum("tm,...tm->...t", self.weight[:, at], part.real**2 + part.imag**2)

    def noise_power(self, *kinds: int) -> Array:
        """Expected mean square of the noise alone, (T,), N²."""
        at = np.isin(self.kind, kinds)
        return np.sum(self.weight[:, at] * self.noise[:, at] ** 2 * np.where(self.real[at], 1.0, 2.0), axis=1)

    def draw_noise(self, draws: int, rng: np.random.Generator, allowed: bool = False) -> np.ndarray:
        """(draws, T, M) complex noise, with or without the allowed floors."""
        unit = rng.standard_normal((2, draws, *self.noise.shape))
        return (self.allowed if allowed else self.noise) * (unit[0] + 1j * np.where(self.real, 0.0, unit[1]))

    def draw_discrepancy(self, shares: Array, lengths: Array, rng: np.random.Generator) -> np.ndarray:
        """(draws, T, M) complex smooth discrepancies of averaged loops; shares of the friction level, lengths
        (draws,)."""
        at = np.flatnonzero(self.kind <= MEAN)
        together = between_tests(self.data.loops, self.fit.size.between)
        half = np.linalg.cholesky(together) * self.data.likelihood.level[:, None]
        spectrum = np.sqrt(discrepancy_spectrum(shares, lengths, len(at)))
        unit = rng.standard_normal((2, len(shares), len(half), len(at)))
        part = np.einsum("ij,pdjh,dh->pdih", half, unit, spectrum)
        out = np.zeros((len(shares), *self.value.shape), dtype=complex)
        out[..., at] = part[0] + 1j * np.where(self.real[at], 0.0, part[1])
        return np.where(self.weight > 0.0, out, 0.0)

    def after_refit(self, change: np.ndarray) -> np.ndarray:
        """What remains of small changes of the data (draws, T, M) once the model has been fitted again."""
        if not self.refitted:
            return change
        sd = np.sqrt(self.fit.linear.variance(self.fit.size))
        moved = (self.rows_of(change) / sd) @ self._gain.T
        return change - np.einsum("dn,ntm->dtm", moved, self.slope)

    def draw_parameters(self, draws: int, rng: np.random.Generator) -> np.ndarray:
        """(draws, T, M) complex errors of the prediction from the posterior of the parameters, to first order."""
        z = rng.standard_normal((draws, len(self.fit.z))) @ np.linalg.cholesky(self.fit.covariance).T
        return np.einsum("dn,ntm->dtm", z, self.slope)

    @cached_property
    def _rows(self) -> Rows:
        return Rows(self.data, self.fit.problem, self.fit.size.between)

    @cached_property
    def _gain(self) -> Array:
        """(ndim, rows) d ẑ / d whitened data."""
        sd = np.sqrt(self.fit.linear.variance(self.fit.size))
        return self.fit.covariance @ (self.fit.linear.jacobian / sd[:, None]).T

    def rows_of(self, change: np.ndarray) -> Array:
        """(draws, rows) changes of the data (draws, T, M) in the coordinates of the fit's `linear`."""
        rows = self._rows
        parts = rows.turned(change[..., : rows.layout.used])
        if rows.evolving:
            layout = rows.layout
            for kind, noise, real, imaginary in (
                (ALONG, self.data.trend_noise_N, layout.trend, layout.turning),
                (MAINS, self.data.mains_noise_N, layout.line, layout.line),
            ):
                scaled = change[..., self.kind == kind].reshape(len(change), *noise.shape) / noise
                parts += [scaled.real[:, real], scaled.imag[:, imaginary]]
        return np.concatenate(parts, axis=1)


def residual_of(data: GapData, fit: Fit, *, refitted: bool = True) -> Residual:
    """The residual of a fitted model for its own data, or (`refitted` False) for other tests of the same specimen.

    Effects whose parameters belong to single tests (of mains interference: its phase) predict nothing for tests that
    were not fitted.
    """
    problem = fit.problem if refitted else _elsewhere(fit.problem)
    tests, count = data.harmonics_N.shape
    flat = _flat(data, problem, fit.z[None])[0]
    measured = np.concatenate([data.harmonics_N, data.trend_N.reshape(tests, -1), data.mains_N], axis=1)
    allowed = np.concatenate(
        [_loop_noise(data, count), data.trend_noise_N.reshape(tests, -1), data.mains_noise_N], axis=1
    )
    noise = allowed.copy()
    noise[:, 0] = [x.noise_N[0] for x in data.loops]
    floor = (TREND_FLOOR * data.level_N)[:, None]
    noise[:, count:-2] = np.sqrt(np.maximum(noise[:, count:-2] ** 2 - floor**2, 0.0))
    contrasts, trended = data.trend_N.shape[1], TREND_HARMONICS + 1
    order = np.r_[np.arange(count), np.tile(np.arange(trended), contrasts), -1, -1]
    kind = np.repeat([MEAN, LOOP, ALONG, MAINS], [1, count - 1, contrasts * trended, 2])
    contrast = np.r_[np.full(count, -1), np.repeat(np.arange(contrasts), trended), -1, -1]
    blocks = np.array([len(x.block_cycle) for x in data.loops])
    weight = np.where(order == 0, 1.0, 0.5) * np.where(kind == ALONG, 1.0 / blocks[:, None], 1.0)
    there = np.isfinite(allowed)
    value, noise, allowed, weight = (np.where(there, x, 0.0) for x in (measured - flat, noise, allowed, weight))
    return Residual(data, fit, value, noise, allowed, weight, order == 0, kind, order, contrast, problem, refitted)


def _flat(data: GapData, problem: Problem, z: Array) -> np.ndarray:
    """(draws, T, M) complex predictions: harmonics, changes along the record, lines."""
    tests, count = data.harmonics_N.shape
    mean, trend, lines = predicted(data, problem, z)
    flat = np.zeros((len(z), tests, count + data.trend_N[0].size + 2), dtype=complex)
    flat[..., :count] = mean
    if trend is not None:
        flat[..., count:-2] = trend.reshape(len(z), tests, -1)
    if lines is not None:
        flat[..., -2:] = lines
    return flat


def _loop_noise(data: GapData, count: int) -> Array:
    """(T, count) standard error of the averaged loops' harmonics, floors of the arithmetic and of the mean included."""
    log_noise = data.likelihood.rotation[3]
    out = np.full((data.tests, count), np.inf)
    for t, loop in enumerate(data.loops):
        have = np.isfinite(loop.noise_N[: len(log_noise)])
        out[t, : len(have)][have] = np.exp(log_noise[have, t])
    return out


def _elsewhere(problem: Problem) -> Problem:
    """The same model for tests that it was not fitted to: nothing kept from the fitted records."""
    kept = tuple(e for e in problem.effects if not isinstance(e, ByTest))
    return replace(problem, effects=kept)
