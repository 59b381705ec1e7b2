"""What a posterior predicts: loops at other conditions, its misfit, and the fitted tests measured once more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.inference.setup.discrepancy import Correlated
from bayes_iwan.inference.setup.loop_error import friction_rms_N
from bayes_iwan.inference.setup.problem import Problem


@dataclass(frozen=True)
class Prediction:
    """Loops that were predicted, with what the posterior knows of them.

    frequency_hz, amplitude_mm : (loops,); displacement_mm : (loops, samples); force_N : (draws, loops, samples), the
    model's alone, without noise; units : the campaign's, for what is printed.
    """

    frequency_hz: Array
    amplitude_mm: Array
    displacement_mm: Array
    force_N: Array
    units: Units

    def band(self, level: float = 0.9) -> tuple[Array, Array, Array]:
        """Lower end, median and upper end of the central interval, (loops, samples) each, N."""
        low, middle, high = np.quantile(self.force_N, [0.5 - level / 2, 0.5, 0.5 + level / 2], axis=0)
        return low, middle, high

    def __repr__(self) -> str:
        low, _, high = self.band()
        return "\n".join(
            f"{f:g} Hz, {a:g} {self.units.displacement}: ±{0.5 * np.mean(high[i] - low[i]):.3g} {self.units.force} "
            "(90 %, mean along the loop)"
            for i, (f, a) in enumerate(zip(self.frequency_hz, self.amplitude_mm))
        )


@dataclass(frozen=True)
class Misfit:
    """rms_N : RMS residual of the median prediction over the fitted tests; share : the same over the RMS friction force
    of all tests (:func:`bayes_iwan.inference.setup.loop_error.friction_rms_N`), as a diagnosis has it."""

    rms_N: float
    share: float


def misfit_of(problem: Problem, z: Array) -> Misfit:
    """Misfit of the median prediction of draws z, (n, ndim); the tests' mean forces, which drift, left aside."""
    values = problem.parameter_values(z)
    predicted = np.median(problem.predict(z), axis=0)
    friction = friction_rms_N(np.median(problem.friction_force(values), axis=0), problem.loops)
    squares = [np.var(loop.force_N - predicted[t]) for t, loop in enumerate(problem.loops)]
    rms = float(np.sqrt(np.mean(squares)))
    return Misfit(rms, rms / float(np.sqrt(np.mean(friction**2))))


def replicated(
    problem: Problem, force_N: Array, parameter_values: Mapping[str, Array], rng: np.random.Generator
) -> Array:
    """Predicted forces of the fitted tests, (draws, tests, samples), with errors as a new measurement would have.

    The errors are the likelihood's, but for the mean force. There the correlated likelihood allows for a place of
    rest known to 0.3 % of the stroke only, so that no offset can pull the fit; as a prediction that is ten times
    too wide for a careful rig. How far the means have wandered from the median prediction the tests themselves
    say: a new one is drawn from the Student t that follows (three tests or more).
    """
    likelihood, tests = problem.likelihood, len(problem.loops)
    loop = likelihood.replicate(force_N, parameter_values, rng)
    if not isinstance(likelihood, Correlated) or tests < 3:
        return loop
    middle, allowed = np.median(force_N.mean(axis=-1), axis=0), likelihood.mean_error_N
    seen = (problem.measured_N.mean(axis=-1) - middle) / allowed
    scale = np.sqrt((1.0 + 1.0 / tests) * np.sum(seen**2) / rng.chisquare(tests - 1, len(loop)))
    mean = middle + scale[:, None] * allowed * rng.standard_normal((len(loop), tests))
    return loop + (mean - loop.mean(axis=-1))[..., None]


def resolved(noise_N: Array, loops: Sequence[Loop]) -> Array:
    """Noise without its mean and without harmonics that the sampling cannot resolve: the loop shown has neither."""
    c = np.fft.rfft(noise_N, axis=-1)
    for t, loop in enumerate(loops):
        kept = np.zeros(c.shape[-1])
        count = min(len(kept), len(loop.noise_N))
        kept[:count] = np.isfinite(loop.noise_N[:count])
        kept[0] = 0.0
        c[:, t] *= kept
    return np.fft.irfft(c, n=noise_N.shape[-1], axis=-1)
