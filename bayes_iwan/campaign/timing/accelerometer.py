"""Displacement from an accelerometer: the steady motion divided by -(2 pi f)^2 harmonic by harmonic, which is exact,
and what is left over (changes between cycles, run-in, noise) integrated in the frequency domain.

Response, displacement found over displacement true, for a motion of frequency f: amplitude 1 and phase 0 at its
harmonics (up to 0.45 of the sampling rate, 60 at most) and, of what is not periodic, above 0.6 f; a ramp of phase 0
down to nothing at 0.4 f. The mean position is put to 0. The sensor's own response is not known and not corrected.
"""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError
from bayes_iwan.campaign.timing.cycles import Cut, cut_cycles
from bayes_iwan.campaign.timing.harmonics import evaluate, fit

#: for pages and terminals: what the conversion does, in one sentence
STATED = (
    "Displacement is the acceleration integrated twice: harmonics of the drive with amplitude 1 and phase 0 (divided "
    "by -(2πf)², no filter), changes between cycles with amplitude 1 and phase 0 above 0.6 of the drive's frequency "
    "and none below 0.4; the mean position is unknown and put to 0. The accelerometer's own response is not "
    "corrected."
)


def displacement_from_acceleration(file: str, time_s: Array, acceleration_m_s2: Array) -> Array:
    """(n,) displacement in mm from a (n,) acceleration in m/s^2.

    Raises CampaignError where no steady cycles can be found.
    """
    fundamental = _dominant(file, time_s, acceleration_m_s2)
    displacement = _integrate(time_s, acceleration_m_s2, 0.5 * fundamental)
    # the transform takes the record for periodic, which spoils its ends: the first cut leaves them out
    duration = time_s[-1] - time_s[0]
    trim = 1.5 / fundamental if duration * fundamental > 6 else 0.0
    inside = slice(*np.searchsorted(time_s, [time_s[0] + trim, time_s[-1] - trim]))
    for part in (inside, slice(None)):
        cut = cut_cycles(file, time_s[part], displacement[part])
        displacement = _by_harmonics(time_s, acceleration_m_s2, part, cut)
    return displacement * 1e3


def _by_harmonics(time_s: Array, acceleration: Array, part: slice, cut: Cut) -> Array:
    """(n,) displacement in m, from the harmonics of the steady cycles that `cut` found in `part`."""
    times = time_s[part]
    phase = np.interp(time_s, times, cut.phase)
    phase += np.minimum(time_s - times[0], 0) * cut.frequency_hz + np.maximum(time_s - times[-1], 0) * cut.frequency_hz
    index = np.arange(time_s.size)[part][cut.index]
    n_harmonics = int(max(1, min(60, 0.45 * index.size / cut.cycles.size)))
    harmonics = fit(phase[index], acceleration[index], n_harmonics)
    left = acceleration - evaluate(harmonics, phase)
    harmonics[0] = 0
    harmonics[1:] /= -((2 * np.pi * cut.frequency_hz * np.arange(1, n_harmonics + 1)) ** 2)
    return evaluate(harmonics, phase) + _integrate(time_s, left, 0.5 * cut.frequency_hz)


def _even(time_s: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    """Even times (n,), an acceleration at these less a straight line, and the frequencies of its transform."""
    even = np.linspace(time_s[0], time_s[-1], time_s.size)
    a = np.interp(even, time_s, acceleration)
    a = a - np.polynomial.Polynomial.fit(even, a, 1)(even)
    return even, a, np.fft.rfftfreq(a.size, even[1] - even[0])


def _dominant(file: str, time_s: Array, acceleration: Array) -> float:
    """Frequency of the strongest line of the velocity, whose spectrum favours the fundamental, in Hz."""
    _, a, frequency = _even(time_s, acceleration)
    spectrum = np.abs(np.fft.rfft(a * np.hanning(a.size)))
    if spectrum.size < 4 or np.ptp(acceleration) <= 1e-9 * np.abs(acceleration).max():
        raise CampaignError(f"{file}: the acceleration does not move; is the right column named in [channels]?")
    return float(frequency[2 + np.argmax(spectrum[2:] / frequency[2:])])


def _integrate(time_s: Array, acceleration: Array, low_hz: float) -> Array:
    """Second integral in m of what lies above `low_hz`, by Fourier transform."""
    even, a, frequency = _even(time_s, acceleration)
    spectrum = np.fft.rfft(a)
    keep = np.clip((frequency / low_hz - 0.8) / 0.4, 0, 1)  # a ramp, not a step, so that it rings little
    spectrum[1:] *= -keep[1:] / (2 * np.pi * frequency[1:]) ** 2
    spectrum[0] = 0
    return np.interp(time_s, even, np.fft.irfft(spectrum, a.size))
