"""Likelihoods: how probable the measured loops are, given predicted ones.

Residual = measured − predicted force, everywhere. A loop averaged with H harmonics is 2H + 1 independent numbers on
however fine a phase grid it is drawn; the likelihoods below count it as that many, so neither the grid nor the
weights of Eq. (9), which are scaled to mean one, create information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.errors import nearest
from bayes_iwan.inference.setup.config import ConfigError
from bayes_iwan.inference.setup.discrepancy import MEASURED_BETWEEN, Correlated
from bayes_iwan.inference.setup.loop_error import paper_weights, resolved
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.priors import Parameter
from bayes_iwan.inference.setup.spectrum import ODD_EVEN


class Likelihood(Protocol):
    """A noise model over a fixed set of loops."""

    @property
    def name(self) -> str: ...

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def normal(self) -> bool:
        """Are the errors normal, given its parameters? Then `rows` says all of how probable a residual is."""

    def log_likelihood(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        """ln p(data | prediction), (draws,); residual (draws, tests, samples)."""

    def pointwise(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        """The same by independent data, (draws, points), summing to :meth:`log_likelihood`."""

    def rows(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        """Whitened residuals, (draws, m), for least squares; their squares sum to −2 ln p but for a constant. Of
        several residuals a draw, (draws, columns, tests, samples), those of each: (draws, columns, m)."""

    def replicate(self, force_N: Array, parameter_values: ParameterValues, rng: np.random.Generator) -> Array:
        """Predicted loops (draws, tests, samples) with noise drawn from this model added, where there are data."""

    def carried_over(
        self, residual_N: Array, parameter_values: ParameterValues, loops: Sequence[Loop], rng: np.random.Generator
    ) -> Array:
        """What a measurement of other tests would differ by from their predictions, (draws, loops, samples), drawn
        given what the predictions of these miss, (draws, tests, samples)."""

    def of_loops(self, loops: tuple[Loop, ...]) -> Likelihood:
        """The same noise model for other forces of the same tests."""

    def of_tests(self, tests: Sequence[int]) -> Likelihood:
        """The same noise model for some of the tests."""


@dataclass(frozen=True)
class Independent:
    """Independent errors along the loop: `laplace`, which is Eq. (8) as printed, or `gaussian`, its squared form.

    The data are generated so: F_i = model_i + e_i with e_i Laplace of scale b/v_i, or Gaussian of variance σ²/v_i;
    v = (w/A) over its geometric mean in all loops' samples, w of Eq. (9), A the test's amplitude; b = σ = noise_N,
    sampled. Every test weighs the same, as it does in Eq. (8): an equal part of the Σ (2H + 1) numbers that all loops
    hold. So ln p = constant − N ln b − (N/T)·c·Eq. (8)/b.

    units : the geometric mean of w/A and how many numbers a sample stands for, if not to be taken from the loops: of
    some of the tests, or of others, noise_N means what it means of all.
    """

    loops: tuple[Loop, ...]
    scales: Scales
    kind: str = "gaussian"
    units: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        return self.kind

    @property
    def normal(self) -> bool:
        return self.kind == "gaussian"

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
    def weights(self) -> Array:
        """v, (tests, samples): the scale of a sample's error is noise_N/v (Laplace) or noise_N/√v (Gaussian)."""
        return self._plain_weights / self._units[0]

    @cached_property
    def _plain_weights(self) -> Array:
        """w/A, (tests, samples)."""
        amplitude = np.array([x.amplitude_mm for x in self.loops])
        return paper_weights(np.stack([x.displacement_mm for x in self.loops]), amplitude) / amplitude[:, None]

    @cached_property
    def _units(self) -> tuple[float, float]:
        if self.units is not None:
            return self.units
        v = self._plain_weights
        return float(np.exp(np.mean(np.log(v)))), float(np.mean(self._known))

    @property
    def _known(self) -> Array:
        """(tests,): numbers that a loop's harmonics are, over its samples."""
        there = np.isfinite(np.stack([x.noise_N for x in self.loops]))
        return (2 * np.count_nonzero(there, axis=1) - 1) / len(self.loops[0].phase)

    @property
    def count(self) -> float:
        """Independent numbers that a sample stands for."""
        return self._units[1]

    def pointwise(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        scale = parameter_values["noise_N"][:, None, None]
        if self.kind == "laplace":
            log_p = np.log(self.weights / (2.0 * scale)) - self.weights * np.abs(residual_N) / scale
        else:
            z = residual_N / scale
            log_p = 0.5 * np.log(self.weights / (2.0 * np.pi * scale**2)) - 0.5 * self.weights * z * z
        return (self.count * log_p).reshape(len(residual_N), -1)

    def log_likelihood(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        scale = parameter_values["noise_N"]
        points, logs = self.weights.size, float(np.sum(np.log(self.weights)))
        if self.kind == "laplace":
            error = np.einsum("dts,ts->d", np.abs(residual_N), self.weights)
            return -self.count * (points * np.log(2.0 * scale) - logs + error / scale)
        error = np.einsum("dts,ts->d", residual_N * residual_N, self.weights)
        return -0.5 * self.count * (points * np.log(2.0 * np.pi * scale**2) - logs + error / scale**2)

    def rows(self, residual_N: Array, parameter_values: ParameterValues) -> Array:
        w = np.sqrt(self.count * self.weights)
        noise_N = parameter_values["noise_N"].reshape(-1, *[1] * (residual_N.ndim - 1))
        return (w * residual_N / noise_N).reshape(-1, *residual_N.shape[1:-2], w.size)

    def replicate(self, force_N: Array, parameter_values: ParameterValues, rng: np.random.Generator) -> Array:
        """Errors as large at each sample as the likelihood has them, in the harmonics that the loops have: so many
        independent numbers, so few of them that Laplace errors would be normal, too."""
        scale = parameter_values["noise_N"][:, None, None]
        unit = resolved(rng.standard_normal(force_N.shape), self.loops) / np.sqrt(self._known)[:, None]
        if self.kind == "laplace":  # of the same mean absolute error
            return force_N + np.sqrt(0.5 * np.pi) * unit * scale / self.weights
        return force_N + unit * scale / np.sqrt(self.weights)

    def carried_over(
        self, residual_N: Array, parameter_values: ParameterValues, loops: Sequence[Loop], rng: np.random.Generator
    ) -> Array:
        none = np.zeros((len(residual_N), len(loops), residual_N.shape[-1]))
        return self.of_loops(tuple(loops)).replicate(none, parameter_values, rng)

    def of_loops(self, loops: tuple[Loop, ...]) -> Independent:
        return replace(self, loops=loops, units=self._units)

    def of_tests(self, tests: Sequence[int]) -> Independent:
        return self.of_loops(tuple(self.loops[t] for t in tests))


KINDS = ("correlated", "unweighted", "matern", "gaussian", "laplace")


def make_likelihood(kind: str, loops: Sequence[Loop], scales: Scales) -> Likelihood:
    """The likelihood by name: correlated (default), the same unweighted, matern (unweighted, odd and even harmonics
    alike), gaussian or laplace."""
    if kind in ("correlated", "unweighted"):
        weighted = scales if kind == "correlated" else None
        return Correlated(tuple(loops), weighted, between=MEASURED_BETWEEN, spectrum=ODD_EVEN)
    if kind == "matern":
        return Correlated(tuple(loops))
    if kind in KINDS:
        return Independent(tuple(loops), scales, kind)
    raise ConfigError(f"likelihood.kind = {kind!r} is not known{nearest(kind, KINDS)}")
