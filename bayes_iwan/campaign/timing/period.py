"""The period of a drive whose cycles cross the middle several times: multisines, a strong third harmonic."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import minimum_filter1d

from bayes_iwan.arrays import Array

UNLIKE = 0.05  # RMS from one crossing to the next, over that of two signals without relation: no cycle ends there
POINTS = 64  # of a cycle that is compared with others
SMALL = 0.25  # of the amplitude: nearer to the middle no side is counted
ALIKE = 0.2  # the same from one period to the next, and over that from one crossing to the next
SEARCH = 0.02  # of a period that the median of crossings may be off


def whole_period(time_s: Array, displacement: Array, times: Array) -> float | None:
    """The period (s) of a motion (n,) that repeats after several upward crossings (m,); None where one is a cycle.

    It is the shortest lag at which the motion is like itself, and far more so than from one crossing to the next.
    """
    if times.size < 3:
        return None
    one = float(np.median(np.diff(times)))
    if _mostly_gaps(time_s, one):
        return None
    places = times[:-1, None] + np.diff(times)[:, None] * np.arange(POINTS) / POINTS
    cycles = np.interp(places, time_s, displacement)
    if np.median(np.mean(np.diff(cycles, axis=0) ** 2, axis=1)) < UNLIKE**2 * 2 * np.var(cycles):
        return None  # levels that are held: they change between a few cycles only
    lag, off = _unlike(time_s, displacement, one)
    first = _least(lag, off, one)[1]
    if first < UNLIKE:
        return None  # a cycle ends at each crossing but a few: a spike or a dropout made those
    most = 0.501 * float(time_s[-1] - time_s[0]) + float(np.median(np.diff(time_s)))
    around = max(3, int(one / lag[1]))
    for k in np.flatnonzero((off == minimum_filter1d(off, around)) & (lag < most))[1:]:
        period, least = _least(lag, off, lag[k])
        if least <= ALIKE * min(first, 1.0):
            return period
    return None


def short_period(time_s: Array, displacement: Array, up: Array, down: Array) -> float | None:
    """The period (s) of a motion (n,) of two periods or a little more that were not cut at its upward crossings; None
    where there are not two. up, down : times of the crossings."""
    steps = np.concatenate([np.diff(up), np.diff(down)])
    if not steps.size or np.ptp(steps) > ALIKE * steps.min():
        return None
    one = float(np.mean(steps))
    if _mostly_gaps(time_s, one):
        return None
    period, off = _least(*_unlike(time_s, displacement, one), one)
    step = float(np.median(np.diff(time_s)))
    return period if off <= ALIKE and 2 * period <= time_s[-1] - time_s[0] + 1.01 * step else None


def crossings_a_period(displacement: Array) -> int:
    """How often a periodic displacement (samples,) of mean zero crosses it upwards, but for small ripples."""
    side = np.sign(displacement[np.abs(displacement) > SMALL * np.max(np.abs(displacement))])
    return int(np.count_nonzero((side > 0) & (np.roll(side, 1) < 0)))


def period_marks(time_s: Array, period: float) -> Array:
    """Times at which periods begin, from the record's first sample on; the last may be a sample's step beyond."""
    step = float(np.median(np.diff(time_s)))
    n = int(np.floor((time_s[-1] - time_s[0] + 1.01 * step) / period))
    return time_s[0] - 0.005 * step + period * np.arange(n + 1)


def _mostly_gaps(time_s: Array, one: float) -> bool:
    """Whether a record lasts more cycles than it has samples: one time of 1e300 is enough."""
    return bool(time_s[-1] - time_s[0] > one * time_s.size)


def _unlike(time_s: Array, values: Array, one: float) -> tuple[Array, Array]:
    """Lags (s), POINTS to a cycle of `one` or as fine as the samples, and the mean square of a signal (n,) less itself
    so much later, over that of two without relation."""
    from scipy.signal import correlate  # takes half a second, and most records are of single sines

    n = max(time_s.size, int(POINTS * (time_s[-1] - time_s[0]) / one))
    even = CubicSpline(time_s, values)(np.linspace(time_s[0], time_s[-1], n))
    even -= even.mean()
    upto = np.concatenate([[0.0], np.cumsum(even**2)])
    lags = np.arange(n - 8)
    apart = upto[n - lags] + upto[n] - upto[lags] - 2 * correlate(even, even)[n - 1 :][lags]
    return lags * (time_s[-1] - time_s[0]) / (n - 1), apart / (n - lags) / max(2 * float(np.var(even)), 1e-300)


def _least(lags: Array, off: Array, near: float) -> tuple[float, float]:
    """The lag near another one after which a signal is most like itself, by a parabola, and how unlike it is then."""
    a, b = np.minimum(np.searchsorted(lags, [(1 - SEARCH) * near, (1 + SEARCH) * near]), lags.size - 2)
    k = min(max(a + int(np.argmin(off[a : b + 1])), 1), lags.size - 2)
    fall, curvature = (off[k - 1] - off[k + 1]) / 2, off[k - 1] - 2 * off[k] + off[k + 1]
    shift = float(np.clip(fall / curvature, -1.0, 1.0)) if curvature > 0 else 0.0
    least = float(off[k]) - shift * fall + shift**2 * curvature / 2
    return float(lags[k] + shift * lags[1]), float(np.sqrt(max(least, 0.0)))
