"""A straight drift of the displacement under its cycles: creep, a sensor that warms, an actuator that walks."""

from __future__ import annotations

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.timing.cycles import crossings

NOTED = 0.1  # of the amplitude over the record: less changes no amplitude by as much as 0.2 %
STRAIGHT = 0.3  # of the drift itself: how far single samples may be off the straight line


def without_drift(time_s: Array, displacement: Array) -> tuple[Array, tuple[str, ...]]:
    """The displacement (n,) with a straight line taken off where it drifts, and a word on it; as it was where not.

    The slope is the median of what the motion gains over whole cycles, half a record apart, which no part of a cycle
    at either end turns it, as it does a fitted line.
    """
    level = displacement - np.polynomial.Polynomial.fit(time_s, displacement, 1)(time_s)
    low, high = np.percentile(level, [2, 98])
    half = (high - low) / 2
    times = crossings(time_s, level, (low + high) / 2, half) if half > 0 else np.empty(0)
    if times.size < 4:
        return displacement, ()
    period = float(np.median(np.diff(times)))
    lag = period * max(1, int((time_s[-1] - time_s[0]) / period / 2))
    first = time_s[time_s <= time_s[-1] - lag]
    gained = np.interp(first + lag, time_s, displacement) - displacement[: first.size]
    gain = float(np.median(gained))
    slope = gain / lag
    span = time_s[-1] - time_s[0]
    straight = float(np.median(np.abs(gained - gain))) < STRAIGHT * abs(gain)
    if abs(slope) * span < NOTED * half or not straight:
        return displacement, ()
    line = slope * (time_s - time_s.mean())
    moved = float(np.ptp(np.percentile(displacement - line, [1, 99]))) / 2
    said = (
        f"the displacement drifts by {slope * span:.3g} mm over the record, {abs(slope) * span / moved:.2g} "
        "amplitudes: the straight line was taken off. Creep or a sensor that walks? What depends on the mean position "
        "is not seen"
    )
    return displacement - line, (said,)
