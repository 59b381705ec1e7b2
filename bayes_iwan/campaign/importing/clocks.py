"""When each sample of a channel was taken, and two channels on one clock: aligned by start, resampled where they must.

Whatever the format, a channel's times come from the time channel beside it or from its own rate and start. Two channels
are paired by these times and never by their place in the file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError

SAME_TIME = 0.02  # of a step: two samples closer than this were taken together
PAIRED = 0.9  # of the samples have a partner: no interpolation then
LONG_GAP = 2.5  # steps: across a longer hole nothing is interpolated


@dataclass(frozen=True)
class Series:
    """A channel's samples with their times: time_s, values (n,). name : for messages. rate_hz : if it is stated."""

    name: str
    time_s: Array
    values: Array
    rate_hz: float | None = None

    @property
    def step_s(self) -> float:
        return float(np.median(np.diff(self.time_s)))

    def finite(self) -> Series:
        """Without samples that are no number."""
        good = np.isfinite(self.values) & np.isfinite(self.time_s)
        return self if good.all() else replace(self, time_s=self.time_s[good], values=self.values[good])


def runs(time: Array) -> list[slice]:
    """Parts of a record whose clock (n,) starts anew: at each step back to near where the part before began."""
    there, cuts, start = np.flatnonzero(np.isfinite(time)), [0], 0
    known = np.interp(np.arange(time.size), there, time[there]) if there.size else np.zeros(time.size)
    for k in np.flatnonzero(np.diff(known) < 0) + 1:
        span = known[k - 1] - known[start]
        if span > 0 and abs(known[k] - known[start]) <= 0.1 * span and k - start >= 16:
            cuts.append(int(k))
            start = int(k)
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], time.size])]


def paired(motion: Series, force: Series, where: str) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Times (n,), motion (n,) and force (n,) at these, and what was done, each a warning.

    Raises CampaignError where the two do not overlap in time, or a clock runs backwards.
    """
    notes: list[str] = []
    late = float(force.time_s[0] - motion.time_s[0]) if force.time_s.size and motion.time_s.size else 0.0
    a, b = motion.finite(), force.finite()
    for x in (a, b):
        if x.time_s.size < 16:
            raise CampaignError(f"{where}: {x.name!r} has {x.time_s.size} samples that are numbers")
    if a.time_s.size == b.time_s.size and np.array_equal(a.time_s, b.time_s):
        return a.time_s, a.values, b.values, ()
    for x in (a, b):
        if not (np.diff(x.time_s) > 0).all() and motion.time_s is not force.time_s:
            raise CampaignError(f"{where}: the times of {x.name!r} do not increase; name its time with --time NAME")
    step = min(a.step_s, b.step_s)
    if motion.time_s is not force.time_s and abs(late) > SAME_TIME * step:
        first, second = (force.name, motion.name) if late > 0 else (motion.name, force.name)
        notes.append(f"{first!r} starts {abs(late):.4g} s after {second!r} by the file's clock: aligned by start")
    ratio = b.step_s / a.step_s
    if abs(ratio - 1) > 0.01:
        notes.append(
            f"two rates: {motion.name!r} {1 / a.step_s:.6g}, {force.name!r} {1 / b.step_s:.6g} samples a second; what "
            "the slower one's filter delays is not known: check the delay between the channels"
        )
    near = np.clip(np.searchsorted(b.time_s, a.time_s), 1, b.time_s.size - 1)
    near -= (a.time_s - b.time_s[near - 1]) < (b.time_s[near] - a.time_s)
    together = np.abs(b.time_s[near] - a.time_s) <= SAME_TIME * step
    low, high = max(a.time_s[0], b.time_s[0]), min(a.time_s[-1], b.time_s[-1])
    inside = [np.count_nonzero((x.time_s >= low - step) & (x.time_s <= high + step)) for x in (a, b)]
    if high <= low or min(inside) < 16:
        raise CampaignError(
            f"{where}: {motion.name!r} ({a.time_s[0]:.6g} to {a.time_s[-1]:.6g} s) and {force.name!r} "
            f"({b.time_s[0]:.6g} to {b.time_s[-1]:.6g} s) were not recorded at the same time"
        )
    if np.count_nonzero(together) >= PAIRED * min(inside) or motion.time_s is force.time_s:
        return a.time_s[together], a.values[together], b.values[near[together]], tuple(notes)
    # the faster channel at the slower one's times; of two alike the motion, which is the smoother
    if b.step_s < 0.99 * a.step_s:
        values, keep = _at(b, a.time_s)
        out = a.time_s[keep], a.values[keep], values
        name = force.name
    else:
        values, keep = _at(a, b.time_s)
        out = b.time_s[keep], values, b.values[keep]
        name = motion.name
    notes.append(f"no sample of the two channels was taken at one time: {name!r} is interpolated by cubic splines")
    return *out, tuple(notes)


def _at(x: Series, time: Array) -> tuple[Array, np.ndarray]:
    """A series at other times where they lie within it and not in a hole, and which these are."""
    k = np.clip(np.searchsorted(x.time_s, time), 1, x.time_s.size - 1)
    hole = x.time_s[k] - x.time_s[k - 1] > LONG_GAP * x.step_s
    keep = (time >= x.time_s[0]) & (time <= x.time_s[-1]) & ~hole
    return CubicSpline(x.time_s, x.values)(time[keep]), keep
