"""How the variance of a model's discrepancy is spread over the harmonics of a loop, and how that of different tests is
correlated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.setup.priors import Parameter
from bayes_iwan.screen import on_screen


@dataclass(frozen=True)
class Spectrum:
    """How the discrepancy's variance is spread over the harmonics, by parameters that are sampled."""

    parameters: tuple[Parameter, ...]

    def variance(self, parameter_values: ParameterValues, count: int) -> Array:
        """Of each harmonic's real part over level², (draws, count)."""
        raise NotImplementedError


@dataclass(frozen=True)
@on_screen
class Matern(Spectrum):
    """(1 + (2πhℓ)²)⁻² of a periodic Matérn process; odd and even harmonics alike."""

    parameters: tuple[Parameter, ...] = (
        Parameter(
            "discrepancy_share",
            "a",
            "-",
            "smooth discrepancy of the model, RMS over the friction level",
            stats.lognorm(s=1.2, scale=0.01),
        ),
        Parameter(
            "discrepancy_length",
            "ℓ",
            "cycles",
            "correlation length of that discrepancy along the loop",
            stats.lognorm(s=0.5, scale=0.06),
            0.01,
            0.5,
        ),
    )

    def variance(self, parameter_values: ParameterValues, count: int) -> Array:
        return discrepancy_spectrum(
            parameter_values["discrepancy_share"], parameter_values["discrepancy_length"], count
        )


@dataclass(frozen=True)
@on_screen
class OddEven(Spectrum):
    """h^−p, p = discrepancy_slope, with a share of its own for odd and for even harmonics (the mean is even).

    A loop that misses by the same both ways, as friction's does, misses in odd harmonics.
    """

    parameters: tuple[Parameter, ...] = (
        Parameter(
            "discrepancy_odd",
            "a1",
            "-",
            "discrepancy of the model in odd harmonics, RMS over the friction level",
            stats.lognorm(s=1.2, scale=0.01),
        ),
        Parameter(
            "discrepancy_even",
            "a2",
            "-",
            "discrepancy of the model in even harmonics, RMS over the friction level",
            stats.lognorm(s=1.2, scale=0.005),
        ),
        Parameter(
            "discrepancy_slope",
            "p",
            "-",
            "fall of the discrepancy's power with the harmonic, its exponent",
            stats.norm(loc=2.0, scale=1.0),
            0.0,
            6.0,
        ),
    )

    def variance(self, parameter_values: ParameterValues, count: int) -> Array:
        order = np.maximum(np.arange(count), 1)
        power = order ** -parameter_values["discrepancy_slope"][:, None]
        odd = np.arange(count) % 2 == 1
        total = [np.maximum(np.sum(power[:, part], axis=1, keepdims=True), 1e-300) for part in (~odd, odd)]
        share = [parameter_values[name][:, None] for name in ("discrepancy_even", "discrepancy_odd")]
        return power * np.where(odd, share[1] ** 2 / total[1], share[0] ** 2 / total[0])


MATERN, ODD_EVEN = Matern(), OddEven()


def between_tests(loops: Sequence[Loop], lengths: tuple[float, float, float]) -> Array:
    """Correlation of a model's discrepancy between tests, (tests, tests): by distance in ln f, ln A, and a share
    alone."""
    return shared_between(loops, loops, lengths) + lengths[2] * np.eye(len(loops))


def shared_between(some: Sequence[Loop], others: Sequence[Loop], lengths: tuple[float, float, float]) -> Array:
    """The same, (some, others), without the share that each test has alone."""
    near = np.zeros((len(some), len(others)))
    for name, length in zip(("frequency_hz", "amplitude_mm"), lengths):
        one, other = (np.log([getattr(x, name) for x in loops]) for loops in (some, others))
        near -= 0.5 * ((one[:, None] - other) / length) ** 2
    return (1.0 - lengths[2]) * np.exp(near)


def discrepancy_spectrum(share: Array, length: Array, count: int) -> Array:
    """Variance of each harmonic's real part over level², (draws, count); a periodic Matérn-3/2-like decay."""
    s = (1.0 + (2.0 * np.pi * np.arange(count) * length[:, None]) ** 2) ** -2
    return share[:, None] ** 2 * s / s.sum(axis=1, keepdims=True)
