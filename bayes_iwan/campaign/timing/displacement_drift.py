"""A straight drift of the displacement under its cycles: creep, a sensor that warms, an actuator that walks."""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.timing.cycles import crossings

#: of the amplitude over the record: less changes no amplitude by as much as 0.2 %, and lets cycles be counted
NOTED, COARSE = 0.1, 0.5
STRAIGHT = 0.3  # of the drift itself: how far single samples may be off the straight line


def straight_drift(time_s: Array, displacement: Array) -> tuple[float, float]:
    """Slope (mm/s) of a straight drift under the cycles of a displacement (n,), and half the range of these without it;
    (0, 0) where there is no straight drift, or too few cycles to say.

    The slope is the median of what the motion gains over whole cycles, half a record apart, which no part of a cycle
    at either end turns, as it does a fitted line.
    """
    level = displacement - np.polynomial.Polynomial.fit(time_s, displacement, 1)(time_s)
    low, high = np.percentile(level, [2, 98])
    half = (high - low) / 2
    times = crossings(time_s, level, (low + high) / 2, half) if half > 0 else np.empty(0)
    if times.size < 4:
        return 0.0, 0.0
    period, span = float(np.median(np.diff(times))), float(time_s[-1] - time_s[0])
    if not period > span / time_s.size:  # nearly all of the record is a gap (damaged times)
        return 0.0, 0.0
    lag = period * max(1, int(span / period / 2))
    first = time_s[time_s <= time_s[-1] - lag]
    gained = np.interp(first + lag, time_s, displacement) - displacement[: first.size]
    gain = float(np.median(gained))
    if float(np.median(np.abs(gained - gain))) >= STRAIGHT * abs(gain):
        return 0.0, 0.0
    slope = gain / lag
    return slope, float(np.ptp(np.percentile(displacement - slope * time_s, [1, 99]))) / 2


def without_drift(time_s: Array, displacement: Array, noted: float = NOTED) -> tuple[Array, float, tuple[str, ...]]:
    """The displacement (n,) less a straight line where it drifts by `noted` amplitudes or more, that drift over the
    record (mm), and a word on it; as it was, 0 and no word where it does not."""
    slope, half = straight_drift(time_s, displacement)
    drift = slope * float(time_s[-1] - time_s[0])
    if not abs(drift) >= noted * half > 0:
        return displacement, 0.0, ()
    said = (
        f"the displacement drifts by {drift:.3g} mm over the record, {abs(drift) / half:.2g} amplitudes: the straight "
        "line was taken off. Creep or a sensor that walks? What depends on the mean position is not seen"
    )
    return displacement - slope * (time_s - 0.5 * (time_s[0] + time_s[-1])), drift, (said,)
