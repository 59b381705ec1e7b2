"""Objective and likelihoods: how far a predicted loop is from a measured one, and how probable that makes it.

Residual = measured − predicted force, everywhere. A loop averaged with H harmonics is 2H + 1 independent numbers on
however fine a phase grid it is drawn; the likelihoods below count it as that many, so neither the grid nor the
weights of Eq. (9), which are scaled to mean one over a loop, create information.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy import fft, stats

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.parameters import Parameter
from bayes_iwan.inference.scales import Scales, loop_energy_mJ
from bayes_iwan.threads import over_draws

#: error of the model's own arithmetic (samples a cycle, tables) as a share of the friction force, per harmonic
MODEL_FLOOR = 1e-4
#: the displacement at which the specimen rests is known to this share of the amplitude, so the mean force is known to
#: that share times the loop's secant stiffness times its amplitude
ZERO_FLOOR = 0.003


def paper_weights(displacement_mm: Array, amplitude_mm: Array) -> Array:
    """w of Eq. (9), 0.2 + √(1 − (u/A)²), as printed; displacement (tests, samples), amplitude (tests,)."""
    x = displacement_mm / np.asarray(amplitude_mm)[:, None]
    return 0.2 + np.sqrt(np.maximum(1.0 - x * x, 0.0))


def goal_function(residual_N: Array, displacement_mm: Array, amplitude_mm: Array, squared: bool = False) -> Array:
    """Eq. (8) summed over tests, 1/(A n) Σ w |r|, or with r² for `squared` (the text's words); N/mm or N²/mm.

    residual_N : (draws, tests, samples). Returns (draws,).
    Minimising it is maximum likelihood for independent Laplace (squared: Gaussian) errors of weighted scale.
    """
    size = residual_N * residual_N if squared else np.abs(residual_N)
    w = paper_weights(displacement_mm, amplitude_mm) / np.asarray(amplitude_mm)[:, None]
    return np.einsum("dts,ts->d", size, w) / residual_N.shape[2]


def friction_level_N(loops: Sequence[Loop]) -> Array:
    """Each loop's friction force level, dissipated energy / (4 amplitude), (tests,) in N, from the data alone."""
    level = [
        max(
            float(loop_energy_mJ(x.displacement_mm, x.force_N)) / (4.0 * x.amplitude_mm),
            0.02 * float(np.std(x.force_N)),
        )
        for x in loops
    ]
    return np.array(level)


def harmonics_of(force_N: Array, count: int) -> Array:
    """c_h, h < count, with force = Re Σ c_h e^{2πih·phase}; force (…, samples) on a uniform phase grid from 0."""
    c = fft.rfft(force_N, axis=-1)[..., :count] * (2.0 / force_N.shape[-1])
    c[..., 0] *= 0.5
    return c


class Likelihood(Protocol):
    """A noise model over a fixed set of loops."""

    @property
    def name(self) -> str: ...

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    def log_likelihood(self, residual_N: Array, numbers: Numbers) -> Array:
        """ln p(data | prediction), (draws,); residual (draws, tests, samples)."""

    def pointwise(self, residual_N: Array, numbers: Numbers) -> Array:
        """The same by independent data, (draws, points), summing to :meth:`log_likelihood`."""

    def rows(self, residual_N: Array, numbers: Numbers) -> Array:
        """Whitened residuals, (draws, m), for least squares; their squares sum to −2 ln p but for a constant."""

    def replicate(self, force_N: Array, numbers: Numbers, rng: np.random.Generator) -> Array:
        """Predicted loops (draws, tests, samples) with noise drawn from this model added, where there are data."""

    def of_loops(self, loops: tuple[Loop, ...]) -> Likelihood:
        """The same noise model for other forces of the same tests."""


@dataclass(frozen=True)
class Independent:
    """Independent errors along the loop, `laplace` (Eq. 8 as printed) or `gaussian` (its squared form).

    The data are generated so: F_i = model_i + e_i with e_i Laplace of scale b/w_i, or Gaussian of variance σ²/w_i;
    w of Eq. (9) over its mean in the loop; b = σ = noise_N, sampled. Each loop weighs as 2H + 1 points.
    """

    loops: tuple[Loop, ...]
    scales: Scales
    kind: str = "gaussian"

    @property
    def name(self) -> str:
        return self.kind

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "noise_N",
                "σ" if self.kind == "gaussian" else "b",
                "N",
                "scale of the independent errors",
                stats.lognorm(s=2.0, scale=0.01 * self.scales.force_N),
            ),
        )

    @cached_property
    def _weights(self) -> Array:
        amplitude = np.array([x.amplitude_mm for x in self.loops])
        w = paper_weights(np.stack([x.displacement_mm for x in self.loops]), amplitude)
        return w / w.mean(axis=1, keepdims=True)

    @cached_property
    def _count(self) -> Array:
        """Independent numbers a sample stands for, (tests, 1)."""
        samples = len(self.loops[0].phase)
        return np.array([[(2 * np.count_nonzero(np.isfinite(x.noise_N)) - 1) / samples] for x in self.loops])

    def pointwise(self, residual_N: Array, numbers: Numbers) -> Array:
        scale = numbers["noise_N"][:, None, None]
        if self.kind == "laplace":
            log_p = np.log(self._weights / (2.0 * scale)) - self._weights * np.abs(residual_N) / scale
        else:
            z = residual_N / scale
            log_p = 0.5 * np.log(self._weights / (2.0 * np.pi * scale**2)) - 0.5 * self._weights * z * z
        return (self._count * log_p).reshape(len(residual_N), -1)

    def log_likelihood(self, residual_N: Array, numbers: Numbers) -> Array:
        scale = numbers["noise_N"]
        cw = self._count * self._weights
        total = self._count.sum() * residual_N.shape[2]
        if self.kind == "laplace":
            misfit = np.einsum("dts,ts->d", np.abs(residual_N), cw)
            return np.sum(self._count * np.log(self._weights)) - total * np.log(2.0 * scale) - misfit / scale
        misfit = np.einsum("dts,ts->d", residual_N * residual_N, cw)
        return (
            0.5 * np.sum(self._count * np.log(self._weights))
            - 0.5 * total * np.log(2.0 * np.pi * scale**2)
            - 0.5 * misfit / scale**2
        )

    def rows(self, residual_N: Array, numbers: Numbers) -> Array:
        w = np.sqrt(self._count * self._weights)
        return (w * residual_N / numbers["noise_N"][:, None, None]).reshape(len(residual_N), -1)

    def replicate(self, force_N: Array, numbers: Numbers, rng: np.random.Generator) -> Array:
        scale = numbers["noise_N"][:, None, None]
        if self.kind == "laplace":
            return force_N + rng.laplace(size=force_N.shape) * scale / self._weights
        return force_N + rng.standard_normal(force_N.shape) * scale / np.sqrt(self._weights)

    def of_loops(self, loops: tuple[Loop, ...]) -> Independent:
        return replace(self, loops=loops)


@dataclass(frozen=True)
class Correlated:
    """Errors correlated along the loop and between tests: a smooth misfit of unknown shape, marginalised, plus noise.

    The data are generated so: every harmonic of every averaged loop, c_th = model + noise + discrepancy; the noise is
    independent with the standard errors that the records' own repeatability gives, times `noise_scale`; the
    discrepancy is Gaussian over phase with variance (share · friction level)² and the spectrum (1 + (2πhℓ)²)⁻² of a
    periodic Matérn process, ℓ = discrepancy_length in cycles, and between tests it is correlated by their distance in
    ln f and ln A, since a model's error at 10 Hz is much the same at 15 Hz. `BETWEEN` says how.
    """

    loops: tuple[Loop, ...]
    #: friction level of each test, (tests,) in N, if it is not to be taken from the loops
    level_N: tuple[float, ...] | None = None
    name = "correlated"
    #: lengths of the correlation between tests in ln f and ln A, and the share each test has to itself
    BETWEEN = (0.8, 0.5, 0.3)

    parameters = (
        Parameter(
            "noise_scale", "s", "-", "noise over what the records' repeatability says", stats.lognorm(s=0.3, scale=1.0)
        ),
        Parameter(
            "discrepancy_share",
            "a",
            "-",
            "smooth misfit of the model, RMS over the friction level",
            stats.lognorm(s=1.2, scale=0.01),
        ),
        Parameter(
            "discrepancy_length",
            "ℓ",
            "cycles",
            "correlation length of that misfit along the loop",
            stats.lognorm(s=0.5, scale=0.06),
            0.01,
            0.5,
        ),
    )

    @cached_property
    def level(self) -> Array:
        """(tests,) N: the discrepancy is a share of it."""
        return friction_level_N(self.loops) if self.level_N is None else np.array(self.level_N)

    @cached_property
    def resolved(self) -> NDArray[np.bool_]:
        """(tests, harmonics): which harmonics of which loops are data."""
        return np.isfinite(np.stack([x.noise_N for x in self.loops]))

    @cached_property
    def rotation(self) -> tuple[Array, Array, Array, Array]:
        """W (H, tests, tests), eigenvalues λ (H, tests), weight (H, tests) 1 where a datum stands, ln of the noise."""
        noise = np.stack([x.noise_N for x in self.loops], axis=1)
        used = int(np.max(np.nonzero(np.isfinite(noise).any(axis=1))[0])) + 1
        noise = noise[:used]
        level = self.level
        noise = np.where(np.isfinite(noise), np.hypot(noise, MODEL_FLOOR * level), np.inf)
        swing = np.array([0.5 * float(np.ptp(x.force_N)) for x in self.loops])
        noise[0] = np.hypot(noise[0], ZERO_FLOOR * swing)
        covariance = level[:, None] * level * between_tests(self.loops, self.BETWEEN)
        turn, values = np.zeros((used, len(level), len(level))), np.zeros((used, len(level)))
        there = np.zeros((used, len(level)))
        for h in range(used):
            have = np.nonzero(np.isfinite(noise[h]))[0]
            scaled = covariance[np.ix_(have, have)] / (noise[h, have, None] * noise[h, have])
            value, vector = np.linalg.eigh(scaled)
            turn[h, : len(have), have] = vector / noise[h, have, None]
            values[h, : len(have)] = np.maximum(value, 0.0)
            there[h, : len(have)] = 1.0
        return turn, values, there, np.log(np.where(np.isfinite(noise), noise, 1.0))

    @property
    def mean_error_N(self) -> Array:
        """(tests,) N: what the mean force may be off by, with the place of rest (:data:`ZERO_FLOOR`) unknown."""
        return np.exp(self.rotation[3][0])

    def _whitened(self, residual_N: Array, numbers: Numbers) -> tuple[Array, Array]:
        """Rotated residuals (2, H, draws, tests), real and imaginary, and their variances (H, draws, tests)."""
        turn, values, _, _ = self.rotation
        c = harmonics_of(residual_N, len(turn))
        parts = np.empty((2, len(turn), *residual_N.shape[:2]))
        parts[0] = c.real.transpose(2, 0, 1)
        parts[1] = c.imag.transpose(2, 0, 1)
        rotated = parts @ turn.transpose(0, 2, 1)
        spectrum = discrepancy_spectrum(numbers["discrepancy_share"], numbers["discrepancy_length"], len(turn))
        variance = numbers["noise_scale"][:, None] ** 2 + spectrum.T[:, :, None] * values[:, None, :]
        return rotated, variance

    def _log_p(self, residual_N: Array, numbers: Numbers) -> Array:
        """ln p by harmonic, (H, draws, tests)."""
        rotated, variance = self._whitened(residual_N, numbers)
        _, _, there, log_noise = self.rotation
        degrees = np.full((len(there), 1, 1), 2.0)
        degrees[0] = 1.0  # the mean has no imaginary part
        # the Jacobian of the rotation is Π 1/noise; spread evenly over the harmonic's data
        own = np.sum(log_noise, axis=1, keepdims=True) / np.maximum(there.sum(axis=1, keepdims=True), 1.0)
        log_p = -0.5 * (rotated[0] ** 2 + rotated[1] ** 2) / variance
        log_p -= 0.5 * degrees * (np.log(2.0 * np.pi * variance) + 2.0 * own[:, None, :])
        return log_p * there[:, None, :]

    def log_likelihood(self, residual_N: Array, numbers: Numbers) -> Array:
        turn, values, there, log_noise = self.rotation
        degrees = np.where(np.arange(len(there)) == 0, 1.0, 2.0)[:, None]
        constant = -0.5 * float(np.sum(degrees * (there * np.log(2.0 * np.pi) + 2.0 * there * log_noise)))
        spectrum = discrepancy_spectrum(numbers["discrepancy_share"], numbers["discrepancy_length"], len(turn))
        noise = numbers["noise_scale"] ** 2
        out = np.empty(len(residual_N))

        def some_draws(part: slice) -> None:
            _misfit(
                harmonics_of(residual_N[part], len(turn)), turn, values, there, spectrum[part], noise[part], out[part]
            )

        over_draws(some_draws, len(residual_N), residual_N[0].size)
        return constant - 0.5 * out

    def pointwise(self, residual_N: Array, numbers: Numbers) -> Array:
        there = self.rotation[2].astype(bool)
        return self._log_p(residual_N, numbers).transpose(1, 0, 2)[:, there]

    def rows(self, residual_N: Array, numbers: Numbers) -> Array:
        rotated, variance = self._whitened(residual_N, numbers)
        rotated /= np.sqrt(variance)
        return rotated.transpose(2, 0, 1, 3).reshape(len(residual_N), -1)

    def replicate(self, force_N: Array, numbers: Numbers, rng: np.random.Generator) -> Array:
        draws, tests, samples = force_N.shape
        turn, _, _, log_noise = self.rotation
        level = self.level
        half = np.linalg.cholesky(between_tests(self.loops, self.BETWEEN)) * level[:, None]
        spectrum = discrepancy_spectrum(numbers["discrepancy_share"], numbers["discrepancy_length"], len(turn))
        unit = rng.standard_normal((2, 2, draws, tests, len(turn)))
        c = np.einsum("ij,pdjh,dh->pdih", half, unit[0], np.sqrt(spectrum))
        c += unit[1] * np.exp(log_noise).T * numbers["noise_scale"][:, None, None]
        c *= self.resolved[:, : len(turn)]  # a measured loop has nothing where its sampling resolves nothing
        whole = np.zeros((draws, tests, samples // 2 + 1), dtype=complex)
        whole[..., : len(turn)] = (c[0] + 1j * c[1]) * (0.5 * samples)
        whole[..., 0] = c[0, ..., 0] * samples
        return force_N + fft.irfft(whole, n=samples, axis=-1)

    def of_loops(self, loops: tuple[Loop, ...]) -> Correlated:
        return replace(self, loops=loops, level_N=tuple(self.level))


@nb.njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
def _misfit(c, turn, values, there, spectrum, noise, out):
    """Σ |rotated residual|² / variance + ln determinant, over harmonics and tests, into out (draws,)."""
    draws, tests, _ = c.shape
    real, imag = np.empty(tests), np.empty(tests)
    for d in range(draws):
        total = 0.0
        for h in range(turn.shape[0]):
            for j in range(tests):
                real[j], imag[j] = c[d, j, h].real, c[d, j, h].imag
            degrees = 1.0 if h == 0 else 2.0  # the mean has no imaginary part
            product = 1.0  # one logarithm for several variances: it costs as much as they do
            for i in range(tests):
                if there[h, i] == 0.0:
                    continue
                a = b = 0.0
                for j in range(tests):
                    a += turn[h, i, j] * real[j]
                    b += turn[h, i, j] * imag[j]
                variance = noise[d] + spectrum[d, h] * values[h, i]
                total += (a * a + b * b) / variance
                product *= variance
                if i % 8 == 7:
                    total += degrees * math.log(product)
                    product = 1.0
            total += degrees * math.log(product)
        out[d] = total


def between_tests(loops: Sequence[Loop], lengths: tuple[float, float, float]) -> Array:
    """Correlation of a model's misfit between tests, (tests, tests): by distance in ln f, ln A, and a share alone."""
    f, a = (np.log([getattr(x, name) for x in loops]) for name in ("frequency_hz", "amplitude_mm"))
    near = np.exp(-0.5 * ((f[:, None] - f) / lengths[0]) ** 2 - 0.5 * ((a[:, None] - a) / lengths[1]) ** 2)
    return (1.0 - lengths[2]) * near + lengths[2] * np.eye(len(f))


def discrepancy_spectrum(share: Array, length: Array, count: int) -> Array:
    """Variance of each harmonic's real part over level², (draws, count); a periodic Matérn-3/2-like decay."""
    s = (1.0 + (2.0 * np.pi * np.arange(count) * length[:, None]) ** 2) ** -2
    return share[:, None] ** 2 * s / s.sum(axis=1, keepdims=True)


KINDS = ("correlated", "gaussian", "laplace")


def make_likelihood(kind: str, loops: Sequence[Loop], scales: Scales) -> Likelihood:
    """The likelihood by name: correlated (default), gaussian or laplace."""
    if kind == "correlated":
        return Correlated(tuple(loops))
    if kind in KINDS:
        return Independent(tuple(loops), scales, kind)
    raise ValueError(f"likelihood.kind = {kind!r} is not known; choose one of {', '.join(KINDS)}")
