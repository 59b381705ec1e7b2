"""The period of a drive whose cycles cross the middle several times: multisines, a strong third harmonic."""

import numpy as np

from bayes_iwan.arrays import Array

MOST = 40  # crossings in a period
UNLIKE = 0.3  # RMS from one crossing to the next, over that of two signals without relation: no cycle ends there
POINTS = 64  # of a cycle that is compared with the next, whatever time each takes
SMALL = 0.25  # of the amplitude: nearer to the middle no side is counted
ALIKE = 0.2  # the same from one period to the next
SEARCH = 0.02  # of a period that the median of crossings may be off


def whole_period(time_s: Array, displacement: Array, times: Array) -> float | None:
    """The period (s) of a motion (n,) that repeats after several upward crossings (m,); None where one is a cycle.

    It is the shortest lag between crossings at which the motion is like itself.
    """
    span = time_s[-1] - time_s[0]
    if times.size < 3:
        return None
    places = times[:-1, None] + np.diff(times)[:, None] * np.arange(POINTS) / POINTS
    cycles = np.interp(places, time_s, displacement)
    if np.mean(np.diff(cycles, axis=0) ** 2) < UNLIKE**2 * 2 * np.var(cycles):
        return None
    if _unlike(time_s, displacement, float(np.median(np.diff(times)))) < UNLIKE:
        return None  # a cycle ends at each crossing but a few: a spike or a dropout made those
    for m in range(2, min(MOST, times.size - 1) + 1):
        lag = float(np.median(times[m:] - times[:-m]))
        if 2 * lag > span * 1.001 + 2 * float(np.median(np.diff(time_s))):
            return None
        period, off = _best_lag(time_s, displacement, lag)
        if off <= ALIKE:
            return period
    return None


def short_period(time_s: Array, displacement: Array, up: Array, down: Array) -> float | None:
    """The period (s) of a motion (n,) of two periods or a little more that were not cut at its upward crossings; None
    where there are not two. up, down : times of the crossings."""
    steps = np.concatenate([np.diff(up), np.diff(down)])
    if not steps.size or np.ptp(steps) > ALIKE * steps.min():
        return None
    period, off = _best_lag(time_s, displacement, float(np.mean(steps)))
    step = float(np.median(np.diff(time_s)))
    return period if off <= ALIKE and 2 * period <= time_s[-1] - time_s[0] + 1.01 * step else None


def crossings_a_period(displacement: Array) -> int:
    """How often a periodic displacement (samples,) of mean zero crosses it upwards, but for small ripples."""
    side = np.sign(displacement[np.abs(displacement) > SMALL * np.max(np.abs(displacement))])
    return int(np.count_nonzero((side > 0) & (np.roll(side, 1) < 0)))


def _best_lag(time_s: Array, values: Array, lag: float) -> tuple[float, float]:
    """The lag near another one after which a signal (n,) is most like itself, and how unlike it is then."""
    lags = lag * (1 + np.linspace(-SEARCH, SEARCH, 41))
    for _ in range(4):  # finer each time
        off = np.array([_unlike(time_s, values, x) for x in lags])
        k = int(np.argmin(off))
        best, width = (float(lags[k]), float(off[k])), lags[1] - lags[0]
        if best[1] > ALIKE:
            break
        lags = lags[k] + width * np.linspace(-1, 1, 21)
    return best


def period_marks(time_s: Array, period: float) -> Array:
    """Times at which periods begin, from the record's first sample on; the last may be a sample's step beyond."""
    step = float(np.median(np.diff(time_s)))
    n = int(np.floor((time_s[-1] - time_s[0] + 1.01 * step) / period))
    return time_s[0] - 0.005 * step + period * np.arange(n + 1)


def _unlike(time_s: Array, values: Array, lag: float) -> float:
    """RMS of a signal (n,) less itself a lag later, over that of two without relation."""
    n = int(np.searchsorted(time_s, time_s[-1] - lag, side="right"))
    if n < 8:
        return np.inf
    later = np.interp(time_s[:n] + lag, time_s, values)
    return float(np.sqrt(np.mean((later - values[:n]) ** 2) / max(2 * float(np.var(values)), 1e-300)))
