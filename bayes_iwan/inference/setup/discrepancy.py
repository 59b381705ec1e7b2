"""The likelihood with a smooth discrepancy of the model's own beside the noise, correlated along the loop and between
tests.

A model that is a little wrong is wrong in much the same way at neighbouring phases and in neighbouring tests. Errors
taken for independent would be counted as so much more information than there is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy import fft, stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.setup.loop_error import friction_level_N, paper_weights
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.priors import Parameter
from bayes_iwan.inference.setup.spectrum import MATERN, Spectrum, between_tests, shared_between
from bayes_iwan.screen import on_screen
from bayes_iwan.threads import over_draws

#: error of the model's own arithmetic (samples a cycle, tables) as a share of the friction force, per harmonic
MODEL_FLOOR = 1e-4
#: the displacement at which the specimen is at rest is known to this share of the amplitude, so the mean force is known
#: to that share times the loop's secant stiffness times its amplitude
ZERO_FLOOR = 0.003
#: lengths of the discrepancy's correlation between tests in ln f and ln A, and the share each test has to itself
BETWEEN = (0.8, 0.5, 0.3)
#: the same as measured on the rig (`analyses/coverage_rig.py --forms plain --seed 12 --laplace --cases 14` prints
#: how what a fit leaves correlates): tests of one amplitude miss alike, tests of one frequency do not
MEASURED_BETWEEN = (1.5, 0.25, 0.3)
#: of the discrepancy on tests that were not fitted: the share that each has to itself in the first harmonic over that
#: in the others, and the variance of the higher harmonics over that on fitted tests. Chosen, so that 90 % bands of
#: held-out frequencies hold 90 % of points, energies and stiffnesses, on 44 sound specimens of the rig (seeds 19 and 21
#: of `analyses/predict_untested.py`)
FIRST_ALONE, ELSEWHERE = 0.1, 1.7


NOISE_SCALE = Parameter(
    "noise_scale", "s", "-", "noise over what the records' repeatability says", stats.lognorm(s=0.05, scale=1.0)
)


@dataclass(frozen=True)
@on_screen
class Correlated:
    """Errors correlated along the loop and between tests: a smooth discrepancy of unknown shape, marginalised, plus
    noise.

    The data are generated so: force = model + noise + discrepancy. The noise of every harmonic is independent with the
    standard errors that the records' own repeatability gives, times `noise_scale`. The discrepancy is Gaussian. Along
    the loop it is a stationary process over √(w/w̄), w of Eq. (9): its variance goes as 1/w. It has the spectrum
    (1 + (2πhℓ)²)⁻² of a periodic Matérn process, ℓ = discrepancy_length in cycles. From test to test its variance goes
    as the amplitude A, for Eq. (8) divides by A; its RMS is `discrepancy_share` of the mean slip force at the largest
    amplitude. Between tests it is correlated by their distance in ln f and ln A, since a model's error at 10 Hz is much
    the same at 15 Hz; `between` says how. For uncorrelated discrepancies without noise −2 ln p is Eq. (8) with squares,
    but for a constant.

    What is compared is therefore the weighted loop error √(w/w̄)·(residual − its mean) by harmonics, and the mean by
    itself. Weighting leaves the noise's harmonics correlated by at most 0.25; their variances are exact, this
    correlation is omitted.

    `weighted` is None for the unweighted form: the discrepancy is stationary along the loop and a share of each test's
    own friction level.
    """

    loops: tuple[Loop, ...]
    weighted: Scales | None = None
    #: friction level and half the swing of each test's force, (tests,) in N, if not to be taken from the loops
    levels_N: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    #: lengths of the correlation between tests in ln f and ln A, and the share each test has to itself
    between: tuple[float, float, float] = BETWEEN
    #: how the discrepancy's variance is spread over the harmonics
    spectrum: Spectrum = MATERN

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (NOISE_SCALE, *self.spectrum.parameters)

    @property
    def name(self) -> str:
        if self.weighted is not None:
            return "correlated"
        return "matern" if self.spectrum is MATERN else "unweighted"

    @cached_property
    def friction_level(self) -> Array:
        """(tests,) N"""
        return friction_level_N(self.loops) if self.levels_N is None else np.array(self.levels_N[0])

    @cached_property
    def swing(self) -> Array:
        """(tests,) N: half of what the force swings by."""
        if self.levels_N is not None:
            return np.array(self.levels_N[1])
        return np.array([0.5 * float(np.ptp(x.force_N)) for x in self.loops])

    @cached_property
    def level(self) -> Array:
        """(tests,) N: the discrepancy is a share of it."""
        if self.weighted is None:
            return self.friction_level
        amplitude = np.array([x.amplitude_mm for x in self.loops])
        return self.weighted.slip_N * np.sqrt(amplitude / self.weighted.length_mm)

    @cached_property
    def resolved(self) -> NDArray[np.bool_]:
        """(tests, harmonics): which harmonics of which loops are data."""
        return np.isfinite(np.stack([x.noise_N for x in self.loops]))

    @cached_property
    def used(self) -> int:
        """Harmonics that any test has, the mean included."""
        return int(np.max(np.nonzero(self.resolved.any(axis=0))[0])) + 1

    @cached_property
    def noise_N(self) -> Array:
        """(tests, used): standard error of the harmonics' real parts, with floors; inf where there is no datum."""
        noise = np.stack([x.noise_N[: self.used] for x in self.loops])
        noise = np.where(np.isfinite(noise), np.hypot(noise, MODEL_FLOOR * self.friction_level[:, None]), np.inf)
        noise[:, 0] = np.hypot(noise[:, 0], ZERO_FLOOR * self.swing)
        return noise

    @cached_property
    def root_weights(self) -> Array:
        """(tests, samples): √(w/w̄); ones in the unweighted form."""
        u = np.stack([x.displacement_mm for x in self.loops])
        if self.weighted is None:
            return np.ones_like(u)
        w = paper_weights(u, np.array([x.amplitude_mm for x in self.loops]))
        return np.sqrt(w / w.mean(axis=1, keepdims=True))

    @cached_property
    def _waves(self) -> tuple[Array, Array]:
        """Samples from harmonics' real and imaginary parts (samples, 2·used), and the parts from samples (2·used,
        samples); that of the mean's imaginary part is zero."""
        samples = len(self.loops[0].phase)
        angle = 2.0 * np.pi * np.outer(np.arange(samples) / samples, np.arange(self.used))
        synthesis = np.concatenate([np.cos(angle), -np.sin(angle)], axis=1)
        analysis = synthesis.T * (2.0 / samples)
        analysis[0] *= 0.5
        return synthesis, analysis

    @cached_property
    def projection(self) -> Array:
        """(tests, samples, 2·used): a residual times it gives real, then imaginary parts of what is compared."""
        synthesis, analysis = self._waves
        out = np.empty((len(self.loops), len(synthesis), 2 * self.used))
        for t, root in enumerate(self.root_weights):
            there = np.tile(self.resolved[t, : self.used], 2)
            kept = (synthesis * there) @ analysis  # what the sampling resolves of a residual
            mean = (root / root.sum()) @ kept
            out[t] = ((analysis * root) @ (kept - mean)).T
            out[t, :, 0] = mean
            out[t] *= there
        return out

    @cached_property
    def rotation(self) -> tuple[Array, Array, Array, Array]:
        """W (H, tests, tests), eigenvalues λ (H, tests), weight (H, tests) 1 where a datum stands, ln of the noise."""
        synthesis, _ = self._waves
        physical = np.where(np.isfinite(self.noise_N), self.noise_N, 0.0)
        variance = np.einsum("tnq,np->tqp", self.projection, synthesis) ** 2 @ np.tile(physical**2, 2)[:, :, None]
        real, imaginary = variance[:, : self.used, 0], variance[:, self.used :, 0]
        noise = np.where(np.isfinite(self.noise_N), np.sqrt(0.5 * (real + imaginary)), np.inf)
        noise[:, 0] = np.sqrt(real[:, 0])
        noise = np.ascontiguousarray(noise.T)
        covariance = self.level[:, None] * self.level * between_tests(self.loops, self.between)
        tests = len(self.loops)
        turn, values = np.zeros((self.used, tests, tests)), np.zeros((self.used, tests))
        there = np.zeros((self.used, tests))
        for h in range(self.used):
            have = np.nonzero(np.isfinite(noise[h]))[0]
            scaled = covariance[np.ix_(have, have)] / (noise[h, have, None] * noise[h, have])
            value, vector = np.linalg.eigh(scaled)
            turn[h, : len(have), have] = vector / noise[h, have, None]
            values[h, : len(have)] = np.maximum(value, 0.0)
            there[h, : len(have)] = 1.0
        return turn, values, there, np.log(np.where(np.isfinite(noise), noise, 1.0))

    @property
    def mean_error_N(self) -> Array:
        """(tests,) N: what the mean force may be off by, with the rest position (:data:`ZERO_FLOOR`) unknown."""
        return np.exp(self.rotation[3][0])

    def _parts(self, residual_N: Array) -> Array:
        """(tests, draws, 2·used): real, then imaginary parts of the harmonics of the (weighted) loop error."""
        return np.matmul(residual_N.transpose(1, 0, 2), self.projection)

    def _spectrum(self, parameter_values: ParameterValues) -> Array:
        return self.spectrum.variance(parameter_values, self.used)

    def _rotated(self, residual_N: Array) -> Array:
        """Residuals (2, H, draws, tests), real and imaginary, in coordinates that are independent."""
        parts = self._parts(residual_N).reshape(len(self.loops), len(residual_N), 2, self.used)
        return parts.transpose(2, 3, 1, 0) @ self.rotation[0].transpose(0, 2, 1)

    def _variance(self, parameter_values: ParameterValues) -> Array:
        """(H, draws, tests) of the rotated residuals."""
        noise, spectrum = parameter_values["noise_scale"][:, None] ** 2, self._spectrum(parameter_values)
        return noise + spectrum.T[:, :, None] * self.rotation[1][:, None, :]

    def _log_p(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        """ln p by harmonic, (H, draws, tests)."""
        rotated, variance = self._rotated(residual_N), self._variance(parameter_values)
        _, _, there, log_noise = self.rotation
        degrees = np.full((len(there), 1, 1), 2.0)
        degrees[0] = 1.0  # the mean has no imaginary part
        # the Jacobian of the rotation is Π 1/noise; spread evenly over the harmonic's data
        own = np.sum(log_noise, axis=1, keepdims=True) / np.maximum(there.sum(axis=1, keepdims=True), 1.0)
        log_p = -0.5 * (rotated[0] ** 2 + rotated[1] ** 2) / variance
        log_p -= 0.5 * degrees * (np.log(2.0 * np.pi * variance) + 2.0 * own[:, None, :])
        return log_p * there[:, None, :]

    @property
    def normal(self) -> bool:
        return True

    def log_likelihood(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        turn, values, there, log_noise = self.rotation
        degrees = np.where(np.arange(len(there)) == 0, 1.0, 2.0)[:, None]
        constant = -0.5 * float(np.sum(degrees * (there * np.log(2.0 * np.pi) + 2.0 * log_noise)))
        noise, spectrum = parameter_values["noise_scale"] ** 2, self._spectrum(parameter_values)
        out = np.empty(noise.shape)

        def some_draws(part: slice) -> None:
            _discrepancy(self._parts(residual_N[part]), turn, values, there, spectrum[part], noise[part], out[part])

        over_draws(some_draws, len(residual_N), residual_N[0].size)
        return constant - 0.5 * out

    def pointwise(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        there = self.rotation[2].astype(bool)
        return self._log_p(residual_N, parameter_values).transpose(1, 0, 2)[:, there]

    def rows(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        draws, *columns, tests, samples = residual_N.shape
        each = math.prod(columns)
        rotated = self._rotated(residual_N.reshape(draws * each, tests, samples))
        rotated = rotated.reshape(2, self.used, draws, each, tests).transpose(2, 3, 0, 1, 4)
        per_sd = 1.0 / np.sqrt(self._variance(parameter_values)).transpose(1, 0, 2)[:, None, None]
        rows = np.multiply(rotated, per_sd, order="C")
        return rows.reshape(len(rows), *columns, 2 * self.used * tests)

    def replicate(self, force_N: Array, parameter_values: ParameterValues, rng: np.random.Generator) -> Array:
        unit = rng.standard_normal((2, len(force_N), len(self.loops), self.used))
        return self._measured(force_N, self._smooth(unit, self._spectrum(parameter_values)), parameter_values, rng)

    def _smooth(self, unit: Array, power: Array) -> Array:
        """Discrepancies (2, draws, tests, used) of these powers (draws, used) from standard normal numbers of that
        shape."""
        half = np.linalg.cholesky(between_tests(self.loops, self.between)) * self.level[:, None]
        return np.einsum("ij,pdjh,dh->pdih", half, unit, np.sqrt(power))

    def carried_over(
        self, residual_N: Array, parameter_values: ParameterValues, loops: Sequence[Loop], rng: np.random.Generator
    ) -> Array:
        """Residual on on other tests of the specimen, (draws, loops, samples), drawn given what is
        left on these. Parameters and discrepancy make up for each other, so that both drawn apart would be far too wide
        in the first harmonic, which energy and stiffness follow from: there the discrepancy is carried over (simple
        kriging). In the others it is larger than where the model was fitted (:data:`ELSEWHERE`)."""
        there = replace(self, loops=tuple(loops), levels_N=None)
        unit = rng.standard_normal((2, len(residual_N), len(loops), there.used))
        smooth = there._smooth(unit, ELSEWHERE * there._spectrum(parameter_values))
        between = (*self.between[:2], FIRST_ALONE * self.between[2])
        have = np.flatnonzero(np.isfinite(self.noise_N[:, 1]))
        first, scale = self._spectrum(parameter_values)[:, 1, None, None], parameter_values["noise_scale"]
        noise = np.exp(self.rotation[3][1, have]) * scale[:, None]
        together = self.level[:, None] * self.level * between_tests(self.loops, between)
        seen = first * together[np.ix_(have, have)] + noise[:, :, None] ** 2 * np.eye(len(have))
        shared = shared_between(loops, self.loops, between)[:, have]
        across = first * there.level[:, None] * self.level[have] * shared
        weight = np.linalg.solve(seen, across.transpose(0, 2, 1)).transpose(0, 2, 1)
        left = first * there.level[:, None] * there.level * between_tests(loops, between)
        root = np.linalg.cholesky(left - weight @ across.transpose(0, 2, 1))
        for p, column in enumerate((1, self.used + 1)):
            known = self._parts(residual_N)[have, :, column].T
            smooth[p, :, :, 1] = (weight @ known[:, :, None] + root @ unit[p, :, :, 1, None])[:, :, 0]
        none = np.zeros((len(residual_N), len(loops), residual_N.shape[-1]))
        return there._measured(none, smooth, parameter_values, rng)

    def _measured(
        self, force_N: Array, smooth: Array, parameter_values: ParameterValues, rng: np.random.Generator
    ) -> Array:
        """Predicted loops with noise and a discrepancy, parts of its weighted harmonics (2, draws, tests, used)."""
        draws, tests, samples = force_N.shape
        noise = rng.standard_normal((2, draws, tests, self.used)) * np.where(
            np.isfinite(self.noise_N), self.noise_N, 0.0
        )
        noise *= parameter_values["noise_scale"][:, None, None]
        noise[..., 0] += smooth[..., 0]
        smooth[..., 0] = 0.0
        whole = on_phases(smooth, samples) / self.root_weights
        c = fft.rfft(whole, axis=-1)[..., : self.used] * (2.0 / samples) + noise[0] + 1j * noise[1]
        c[..., 0] -= whole.mean(axis=-1)  # the line above takes the mean twice
        # a measured loop has nothing where its sampling resolves nothing
        c *= self.resolved[:, : self.used]
        return force_N + on_phases(np.stack([c.real, c.imag]), samples)

    def with_between(self, between: tuple[float, float, float]) -> Correlated:
        """The same with another correlation between tests."""
        if between == self.between:
            return self
        other = replace(self, between=between)
        vars(other)["projection"] = self.projection  # it knows nothing of that, and is dear
        return other

    def of_loops(self, loops: tuple[Loop, ...]) -> Correlated:
        return replace(self, loops=loops, levels_N=(tuple(self.friction_level), tuple(self.swing)))

    def of_tests(self, tests: Sequence[int]) -> Correlated:
        chosen = list(tests)
        levels = tuple(self.friction_level[chosen]), tuple(self.swing[chosen])
        some = replace(self, loops=tuple(self.loops[t] for t in chosen), levels_N=levels)
        if some.used == self.used:  # each test's is its own, and dear
            vars(some)["projection"] = self.projection[chosen]
        return some


def on_phases(parts: Array, samples: int) -> Array:
    """Loops (…, samples) from the real and imaginary parts (2, …, H) of their harmonics."""
    whole = np.zeros((*parts.shape[1:-1], samples // 2 + 1), dtype=complex)
    whole[..., : parts.shape[-1]] = (parts[0] + 1j * parts[1]) * (0.5 * samples)
    whole[..., 0] = parts[0, ..., 0] * samples
    return fft.irfft(whole, n=samples, axis=-1)


@nb.njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
def _discrepancy(
    parts: Array, turn: Array, values: Array, there: Array, spectrum: Array, noise: Array, out: Array
) -> None:
    """Σ |rotated residual|² / variance + ln determinant, over harmonics and tests, into out (draws,)."""
    tests, draws, _ = parts.shape
    used = turn.shape[0]
    for d in range(draws):
        out[d] = 0.0
        for h in range(used):
            degrees = 1.0 if h == 0 else 2.0  # the mean has no imaginary part
            total, product = 0.0, 1.0  # one logarithm for several variances: it costs as much as they do
            for i in range(tests):
                if there[h, i] == 0.0:
                    continue
                a = b = 0.0
                for j in range(tests):
                    a += turn[h, i, j] * parts[j, d, h]
                    b += turn[h, i, j] * parts[j, d, used + h]
                variance = noise[d] + spectrum[d, h] * values[h, i]
                total += (a * a + b * b) / variance
                product *= variance
                if i % 8 == 7:
                    total += degrees * math.log(product)
                    product = 1.0
            out[d] += total + degrees * math.log(product)
