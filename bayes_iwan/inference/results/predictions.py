"""What a posterior predicts: loops at other conditions, its residual, and the fitted tests measured once more."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arguments import level_of
from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.folders.folder import WITHOUT_CLOCK_HZ
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.errors import InputError
from bayes_iwan.inference.setup.discrepancy import Correlated
from bayes_iwan.inference.setup.loop_error import beyond_noise_N2, friction_rms_N, harmonics_of, resolved
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models.motion import sine_motion
from bayes_iwan.screen import on_screen, screen

#: an amplitude or peak speed within this factor of the tested ones is tested, and a frequency, which the model knows by
#: the speed alone, within FREQUENCY_MARGIN; beyond REFUSED times what was tested nothing is predicted
MARGIN, FREQUENCY_MARGIN, REFUSED = 1.05, 1.5, 5.0


class Extrapolation(UserWarning):
    """A prediction at conditions that no test had."""


class PredictionError(InputError):
    """Conditions at which nothing can be predicted; the message says which were tested."""


@dataclass(frozen=True)
@on_screen
class Prediction:
    """Loops that were predicted, with what the posterior knows of them.

    frequency_hz (None without a clock), amplitude_mm : (loops,); displacement_mm : (loops, samples); force_N : (draws,
    loops, samples), the model's alone, without noise; units : the campaign's, for what is printed; extrapolated :
    (loops,) why each is an extrapolation, "" where it is none.
    """

    frequency_hz: Array | None
    amplitude_mm: Array
    displacement_mm: Array
    force_N: Array
    units: Units
    extrapolated: tuple[str, ...]

    def band(self, level: float = 0.9) -> tuple[Array, Array, Array]:
        """Lower end, median and upper end of the central interval, (loops, samples) each, N."""
        level = level_of(level)
        low, middle, high = np.quantile(self.force_N, [0.5 - level / 2, 0.5, 0.5 + level / 2], axis=0)
        return low, middle, high

    def __repr__(self) -> str:
        low, _, high = self.band()
        at = (
            ["" for _ in self.amplitude_mm] if self.frequency_hz is None else [f"{f:g} Hz, " for f in self.frequency_hz]
        )
        rows = [
            f"{at[i]}{a:g} {self.units.displacement}: ±{0.5 * np.mean(high[i] - low[i]):.3g} {self.units.force} "
            f"(90 %, mean along the loop){'; extrapolated: ' + self.extrapolated[i] if self.extrapolated[i] else ''}"
            for i, a in enumerate(self.amplitude_mm)
        ]
        return screen(rows, (), where=".band()")


def predicted_at(
    problem: Problem, z: Array, frequency_hz: float | Array | None, amplitude_mm: float | Array, samples: int
) -> Prediction:
    """Steady sines of (loops,) frequencies and amplitudes, broadcast against each other, by the draws z (draws, ndim).

    Warns Extrapolation where a test was at no such amplitude, peak speed or frequency. Raises InputError for
    what is not positive, and PredictionError for amplitudes or speeds of more than REFUSED times the largest tested and
    for a frequency where the tests have no clock (it is None then).
    """
    clock = problem.loops[0].record.clock
    if clock == (frequency_hz is None):
        raise PredictionError(
            "frequency_hz is None: say the frequency of the loops"
            if clock
            else "the tests have no clock, so nothing is known of a frequency; give frequency_hz=None"
        )
    frequency_hz = WITHOUT_CLOCK_HZ if frequency_hz is None else frequency_hz
    f, a = np.broadcast_arrays(np.atleast_1d(frequency_hz).astype(float), np.asarray(amplitude_mm, dtype=float))
    motion = sine_motion(frequency_hz=f, amplitude_mm=a, samples=samples)
    beyond = tuple(_beyond(problem, float(x), float(y)) for x, y in zip(f, a))
    for said in sorted({b for b in beyond if b}):
        warnings.warn(f"extrapolated: {said}", Extrapolation, stacklevel=3)
    return Prediction(
        f if clock else None, a, motion.displacement_mm[0], problem.predict(z, motion), problem.units, beyond
    )


def _beyond(problem: Problem, frequency_hz: float, amplitude_mm: float) -> str:
    """Why a sine is an extrapolation of the fitted tests, "" where it is none."""
    length, motion = problem.units.displacement, problem.motion
    tested = {
        "amplitude": (motion.amplitude_mm, length, MARGIN),
        "peak speed": (2.0 * np.pi * motion.frequency_hz * motion.amplitude_mm, f"{length}/s", MARGIN),
        "frequency": (motion.frequency_hz, "Hz", FREQUENCY_MARGIN),
    }
    if not problem.loops[0].record.clock:
        tested = {"amplitude": tested["amplitude"]}
    asked = (amplitude_mm, 2.0 * np.pi * frequency_hz * amplitude_mm, frequency_hz)
    said = []
    for (name, (values, unit, margin)), value in zip(tested.items(), asked):
        low, high = float(values.min()), float(values.max())
        span = f"{low:.3g} to {high:.3g} {unit}"
        if name != "frequency" and value > REFUSED * high:
            swapped = "frequency" in tested and all(
                v.min() / m <= x <= v.max() * m
                for (v, _, m), x in zip((tested["amplitude"], tested["frequency"]), (frequency_hz, amplitude_mm))
            )
            hint = (
                "; are frequency_hz and amplitude_mm exchanged?"
                if swapped
                else "; a motion of your own can still be given to posterior.problem.predict"
            )
            at = f"{frequency_hz:g} Hz and " if "frequency" in tested else ""
            raise PredictionError(
                f"{at}{amplitude_mm:g} {length} ({name} {value:.3g} {unit}) are beyond "
                f"{REFUSED:g} times what was tested ({name} {span}){hint}"
            )
        if name == "peak speed":
            low = 0.0  # slower than any test: the law of speed ends at rest, which every loop passes
        if not low / margin <= value <= high * margin:
            said.append(f"{name} {value:.3g} {unit}, tested {span}")
    return "; ".join(said)


@dataclass(frozen=True)
@on_screen
class ResidualSize:
    """rms_N : RMS residual of the median prediction over the fitted tests; share : the same over the RMS friction force
    of all tests (:func:`bayes_iwan.inference.setup.loop_error.friction_rms_N`). gap_N, gap_share : the same beyond
    noise, as a diagnosis has it (:func:`bayes_iwan.inference.setup.loop_error.beyond_noise_N2`)."""

    rms_N: float
    share: float
    gap_N: float
    gap_share: float

    def __str__(self) -> str:
        return f"{100 * self.gap_share:.2g} % of the friction force (residual with noise {100 * self.share:.2g} %)"


def residual_size(problem: Problem, z: Array) -> ResidualSize:
    """Residual of the median prediction of draws z, (n, ndim); the tests' mean forces, which drift, left aside."""
    values = problem.parameter_values(z)
    predicted = np.median(problem.predict(z), axis=0)
    friction = friction_rms_N(np.median(problem.friction_force(values), axis=0), problem.loops)
    left = problem.measured_N - predicted
    rms = float(np.sqrt(np.mean(np.var(left, axis=-1))))
    gap = float(np.sqrt(max(float(np.mean(_gap_power_N2(left, problem.loops))), 0.0)))
    level = float(np.sqrt(np.mean(friction**2)))
    return ResidualSize(rms, rms / level, gap, gap / level)


def _gap_power_N2(residual_N: Array, loops: Sequence[Loop]) -> Array:
    """(tests,) squared gap of averaged loops, their mean forces left aside; residual_N (tests, samples)."""
    noise_N = np.array([x.noise_N[1:] for x in loops])
    harmonics = harmonics_of(residual_N, noise_N.shape[1] + 1)[:, 1:]
    there = np.isfinite(noise_N)
    residual_N2, noise_N2 = (
        np.sum(np.where(there, x, 0.0), axis=1) for x in (0.5 * np.abs(harmonics) ** 2, noise_N**2)
    )
    return beyond_noise_N2(residual_N2, noise_N2)


def replicated(
    problem: Problem, force_N: Array, parameter_values: Mapping[str, Array], rng: np.random.Generator
) -> Array:
    """Predicted forces of the fitted tests, (draws, tests, samples), with errors as a new measurement would have.

    The errors are the likelihood's, but for the mean force. There the correlated likelihood allows for a place of
    rest position known to 0.3 % of the stroke only, so that no offset can pull the fit; as a prediction that is ten
    times too wide for a careful rig. How far the means have wandered from the median prediction the tests themselves
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


def shown_noise(noise_N: Array, loops: Sequence[Loop]) -> Array:
    """Noise without its mean and without harmonics that the sampling cannot resolve: the loop shown has neither."""
    kept = resolved(noise_N, loops)
    return kept - kept.mean(axis=-1, keepdims=True)
