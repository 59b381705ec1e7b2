"""The drive, assessed first: is this one record one test?

Frequency and amplitude are taken cycle by cycle, before any averaging, and described by whichever is closer: levels
that are held, or a smooth change. Levels can be split into tests (`split_levels`); a smooth change of more than SMOOTH
cannot be one test, and is refused. The wave form is not assessed.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.campaign.timing.cycles import HYSTERESIS, crossings, cycle_shapes, phase_between
from bayes_iwan.campaign.timing.harmonics import white_noise
from bayes_iwan.campaign.timing.period import period_marks, whole_period
from bayes_iwan.screen import on_screen

LEVEL = 0.03  # two levels further apart than this (of amplitude or frequency) are two tests
HELD = 3  # cycles that a level lasts at least; fewer are a transition
SHORT = 2, 0.8, 0.01  # the same where this share of all cycles stands in levels, each as steady as this
SMALLEST = 0.03  # of the largest stroke: smaller ones are not seen as cycles
SECOND = 5  # cycles from which a second level is a test of its own
MAIN = 0.55  # share of the cycles at one level from which the others are run-in, run-out or a disturbance
GOES_ON = 0.35  # of the step to the next level, from half a level to its other half: a sweep's pieces do half of it
SMOOTH = 0.10  # change of amplitude or frequency over the record beyond which no one loop stands for it
PAUSE = 0.8, 0.1  # of a usual cycle in which nothing crosses the middle, or all stands still: a pause
STILL = 0.25  # of what is not seen as a cycle: noise is half of it, and the way through the middle three times


@dataclass(frozen=True)
class Level:
    """Cycles at one amplitude and frequency: `first` and one past the `last`, and what they hold."""

    first: int
    last: int
    frequency_hz: float
    amplitude_mm: float


@dataclass(frozen=True)
@on_screen
class Drive:
    """What a record was driven with, cycle by cycle.

    start_s : (n + 1,) upward crossings; a cycle lies between two. frequency_hz, amplitude_mm : (n,); the amplitude is
    half the peak-to-peak, from each cycle's fundamental and the record's wave form.
    levels : amplitudes and frequencies that are held, in order; one for a steady drive.
    kind : "steady", "levels", "drift" (a smooth change) or "unsteady" (neither). pauses_s : start and end of pauses.
    """

    start_s: Array
    frequency_hz: Array
    amplitude_mm: Array
    levels: tuple[Level, ...]
    kind: str
    pauses_s: tuple[tuple[float, float], ...] = ()


def assess_drive(time_s: Array, displacement: Array) -> Drive | None:
    """The drive of a record: time (n,) in s, displacement (n,) in mm; None where too few cycles are seen."""
    given = time_s, displacement
    low, high = np.percentile(displacement, [0.5, 99.5])
    half = (high - low) / 2
    if not half > 0:
        return None
    middle, hysteresis = (low + high) / 2, min(max(SMALLEST, 8 * white_noise(displacement) / half), HYSTERESIS)
    times = crossings(time_s, displacement, middle, half, hysteresis=hysteresis, ends=True)
    repeats = whole_period(time_s, displacement, times)  # a multisine swings little for a while, which is no pause
    pauses = _pauses(time_s, displacement - middle, hysteresis * half, times) if repeats is None else []
    whole = whole_s = time_s
    if pauses:  # levels with pauses between them: seen without the pauses
        moving = np.ones(time_s.size, dtype=bool)
        time_s = time_s.copy()
        for a, b in pauses:
            moving[a:b] = False
            time_s[b:] -= whole_s[min(b, whole_s.size - 1)] - whole_s[a]
        time_s, whole_s, displacement = time_s[moving], whole_s[moving], displacement[moving]
        half = float(np.ptp(np.percentile(displacement, [0.5, 99.5]))) / 2
        times = crossings(time_s, displacement, middle, half, hysteresis=hysteresis, ends=True)
    if repeats is not None:
        times = period_marks(time_s, repeats)
    size, y, groups, kind = _by_cycles(time_s, displacement, times, half, repeats is not None)
    starts = times + (np.interp(times, time_s, whole_s) - np.clip(times, time_s[0], time_s[-1]))
    ends = 0  # of a level, that may last into a pause
    if kind != "steady" and not _goes_on(y, groups):  # levels that start anew, wherever in its cycle the last one ended
        marks, halves = _half_cycles(*given, middle, hysteresis * (high - low) / 2)
        sizes = halves * [1.0, 0.0]  # by size alone: the last half cycle of a level may be cut short
        apart = _merged(sizes, _segments(sizes / LEVEL, 0, len(halves)), HELD)
        held, fewest = sum(b - a for a, b in apart), len(groups) if kind == "levels" else 1
        within = [(max(a - 1, 0), min(b - 1, len(halves) - 2)) for a, b in apart]  # the record's ends may cut a swing
        enough = len(apart) > fewest and held >= SHORT[1] * len(halves)
        if enough and _kind(sizes[1:-1], within) == "levels":
            starts, size, y, groups, kind, ends = marks, np.exp(halves[:, 0]), halves, apart, "levels", 1
    if not kind:
        return None
    levels = [Level(a, b, *_middle(y[a + ends : b - ends])) for a, b in groups]
    return Drive(starts, np.exp(y[:, 1]), size, tuple(levels), kind, tuple((whole[a], whole[b - 1]) for a, b in pauses))


def _by_cycles(
    time_s: Array, displacement: Array, times: Array, half: float, multisine: bool
) -> tuple[Array, Array, list[tuple[int, int]], str]:
    """Size of each cycle between times (n + 1,), logarithms of that and of its frequency (n, 2), the levels among them
    and the kind of drive; "" where too few cycles are seen."""
    per_cycle = np.diff(np.searchsorted(time_s, times))
    if times.size <= HELD or per_cycle.min() < 4:
        return np.empty(0), np.empty((0, 2)), [], ""
    phase = phase_between(time_s, times, np.arange(float(times.size)))
    # a multisine may have no fundamental: its size is that of all its harmonics
    harmonics = max(1, min(24, int(0.4 * per_cycle.min()))) if multisine else 1
    (rows,) = cycle_shapes(phase, np.arange(times.size - 1), [displacement], harmonics)
    size = np.sqrt(2) * np.linalg.norm(rows[:, 1:], axis=1)
    size = size * half / max(float(np.percentile(size, 95)), 1e-300)
    if not size.min() > 0:
        return np.empty(0), np.empty((0, 2)), [], ""
    y = np.stack([np.log(size), -np.log(np.diff(times))], axis=1)
    segments = _segments(y / LEVEL, 0, len(y))
    groups = _merged(y, segments, HELD)
    kind = _kind(y, groups)
    if kind != "steady" and not _goes_on(y, groups):
        fewest, share, steady = SHORT
        short = _merged(y, segments, fewest)
        stepped = y[:, np.ptp(y, axis=0) > LEVEL]  # what is the same throughout need not be steadier than that
        within = sum(b - a for a, b in short if float(np.abs(np.diff(stepped[a:b], axis=0)).mean()) < steady)
        if len(short) > max(len(groups), 1) and within >= share * len(y):
            groups, kind = short, "levels"
    return size, y, groups, kind


def _pauses(time_s: Array, values: Array, small: float, times: Array) -> list[tuple[int, int]]:
    """Where values (n,) stay within +-small for most of a usual cycle or longer, or still for a part of it: index of
    the first and past the last sample of each pause."""
    if times.size <= HELD:
        return []
    period = float(np.median(np.diff(times)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.abs(values) < small, [False]]).astype(int)))
    out = []
    for a, b in edges.reshape(-1, 2):
        off = np.abs(values[a:b] - np.median(values[a:b]))
        spread = 1.4826 * float(np.median(off))
        if time_s[b - 1] - time_s[a] > PAUSE[int(spread < STILL * small)] * period:
            still = np.flatnonzero(off <= max(6 * spread, 0.01 * small))  # not the ways into the pause and out of it
            out.append((int(a + still[0]), int(a + still[-1]) + 1))
    return out


def _half_cycles(time_s: Array, values: Array, middle: float, small: float) -> tuple[Array, Array]:
    """Times (n + 1,) between swings of values beyond +-small of the middle, to either side or twice to one, and
    logarithms of their size and frequency, (n, 2)."""
    values = values - middle
    side = np.where(np.abs(values) > small, np.sign(values), 0.0)
    seen = np.flatnonzero((side != 0) | (np.abs(values) < small / 2))
    begins = np.diff(side[seen], prepend=0.0) != 0
    first, last = seen[begins & (side[seen] != 0)], seen[np.append(begins[1:], True) & (side[seen] != 0)]
    at = np.array([a + np.argmin(np.abs(values[a : b + 1])) for a, b in zip([0, *last], [*first, values.size - 1])])
    at = np.unique(at)
    size = np.maximum.reduceat(np.abs(values), at[:-1])
    slope, step = np.gradient(values, time_s)[at], np.gradient(time_s)[at]
    shift = np.divide(-values[at], slope, out=np.zeros(at.size), where=np.abs(slope) * step > np.abs(values[at]))
    marks = time_s[at] + shift
    marks[[0, -1]] += -step[0], step[-1]
    return marks, np.log(np.stack([size, 0.5 / np.diff(marks)], axis=1))


def _middle(y: Array) -> tuple[float, float]:
    size, frequency = np.exp(np.median(y, axis=0))
    return float(frequency), float(size)


def _segments(y: Array, a: int, b: int) -> list[tuple[int, int]]:
    """Cut [a, b) where the sum of squares falls most, as long as the two parts' medians are one apart."""
    n = b - a
    if n < 2:
        return [(a, b)]
    part = y[a:b] - y[a:b].mean(axis=0)
    sums = np.cumsum(part, axis=0)[:-1]
    left = np.arange(1, n)[:, None]
    gain = (sums**2 / left + sums**2 / (n - left)).sum(axis=1)
    cut = a + 1 + int(np.argmax(gain))
    if np.abs(np.median(y[a:cut], axis=0) - np.median(y[cut:b], axis=0)).max() < 1:
        return [(a, b)]
    return _segments(y, a, cut) + _segments(y, cut, b)


def _merged(y: Array, segments: list[tuple[int, int]], held: int) -> list[tuple[int, int]]:
    """Levels of at least `held` cycles; neighbours at one level are one, whatever short disturbance lies between."""
    out: list[tuple[int, int]] = []
    for a, b in segments:
        if b - a < held:
            continue
        if out and np.abs(np.median(y[slice(*out[-1])], axis=0) - np.median(y[a:b], axis=0)).max() < LEVEL:
            out[-1] = (out[-1][0], b)
        else:
            out.append((a, b))
    return out


def _kind(y: Array, levels: list[tuple[int, int]]) -> str:
    n = len(y)
    first, second = [*sorted((b - a for a, b in levels), reverse=True), 0, 0][:2]
    if first >= MAIN * n and second < SECOND:
        return "steady"
    # what is left of levels, and of a smooth curve: most cycles of the right description lie on it
    middles = np.array([np.median(y[a:b], axis=0) for a, b in levels]).reshape(-1, 1, 2)
    off_levels = np.abs(y - middles).max(axis=2).min(axis=0) if levels else np.full(n, 1e3)
    x = np.linspace(-1, 1, n)
    # as free as the levels are: a beat is no staircase of its highs and lows
    basis = np.polynomial.legendre.legvander(x, min(max(5, 2 * len(levels)), n // 4))
    off_curve = np.abs(y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]).max(axis=1)
    levels_off, curve_off = np.percentile(off_levels, 60), np.percentile(off_curve, 60)
    spread = float(np.ptp(np.percentile(y, [5, 95], axis=0), axis=0).max())
    held = len(levels) > 1 and not _goes_on(y, levels)
    if curve_off < min(levels_off if held else np.inf, 0.3 * spread):
        return "drift"
    return "levels" if held and levels_off < 0.3 * spread else "unsteady"


def _goes_on(y: Array, levels: list[tuple[int, int]]) -> bool:
    """Whether y goes on changing within most levels towards the next one, as in a sweep, of which short enough pieces
    are as close to it as any curve."""
    goes = []
    for (a, b), after in pairwise(levels):
        step = np.median(y[slice(*after)], axis=0) - np.median(y[a:b], axis=0)
        half = (b - a) // 2
        within = np.median(y[b - half : b], axis=0) - np.median(y[a : a + half], axis=0)
        k = np.argmax(np.abs(step))
        goes.append(within[k] / step[k])
    return bool(np.median(goes) > GOES_ON) if goes else False


def refuse_unsteady(file: str, drive: Drive | None, clock: bool = True) -> None:
    """Raise CampaignError where the drive makes several tests, or none, of one record."""
    if drive is None or drive.kind == "steady":
        return
    if drive.kind == "levels":
        raise CampaignError(
            f"{file}: {staircase_said(drive, clock)}; averaged as one test these would look like a specimen that "
            "changes. Import the recording again with --split, which makes a test of each"
        )
    for name, unit, values in (("frequency", "Hz", drive.frequency_hz), ("amplitude", "mm", drive.amplitude_mm)):
        low, high = np.percentile(values, [3, 97])
        if high / low - 1 <= SMOOTH or (name == "frequency" and not clock):
            continue
        end = max(2, values.size // 20)
        first, last = float(np.median(values[:end])), float(np.median(values[-end:]))
        if drive.kind == "drift" and abs(last - first) > 0.5 * (high - low):
            how = f"{'sweeps' if name == 'frequency' else 'drifts'} in {name}, from {first:.3g} to {last:.3g} {unit}"
            fix = "Run each frequency and amplitude steadily, and list one test for each"
        else:
            how = f"swings in {name}" if drive.kind == "drift" else f"varies in {name} from cycle to cycle"
            fix = "Steady the drive, or cut out a part that is steady"
        raise CampaignError(
            f"{file}: the drive {how} (between {low:.3g} and {high:.3g} {unit}): no one loop stands for it. {fix}"
        )


def staircase_said(drive: Drive, clock: bool = True) -> str:
    """A staircase in words: how many steps, and of what; no frequency without a clock."""
    pieces = drive.levels
    frequencies, amplitudes = ([getattr(p, key) for p in pieces] for key in ("frequency_hz", "amplitude_mm"))
    by_amplitude = not clock or max(amplitudes) / min(amplitudes) > max(frequencies) / min(frequencies)
    values, unit = (amplitudes, "mm") if by_amplitude else (frequencies, "Hz")
    shown = ", ".join(f"{v:.3g}" for v in values[:8]) + (" ..." if len(values) > 8 else "")
    return f"a staircase of {len(pieces)} levels ({shown} {unit}) in one record"


def split_levels(record: Record) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """One record for each level of a staircase of amplitudes or frequencies, named _1, _2 ..., with the level's cycles,
    its own time from 0, and the frequency and amplitude that were found, and a line for each part that is in no piece;
    the record itself where it is steady.

    Raises CampaignError where the drive drifts, sweeps or wanders instead.
    """
    drive = assess_drive(record.time_s, record.displacement_mm)
    if drive is None or drive.kind == "steady":
        return (record,), ()
    if drive.kind != "levels":
        refuse_unsteady(record.file, drive, record.clock)
        return (record,), ()
    out: list[Record] = []
    stem = record.file.removesuffix(".gz").removesuffix(".csv")
    ending = record.file[len(stem) :] or ".csv"
    for level in drive.levels:
        # not a sample of the next level: a much larger one would hide this one's crossings
        first, last = drive.start_s[[level.first, level.last]]
        near = 0.1 / level.frequency_hz  # no sample of the other side of a pause
        first = max([first, *(b for a, b in drive.pauses_s if a - near < first < b)])
        last = min([last, *(a for a, b in drive.pauses_s if a < last < b + near)])
        keep = (record.time_s >= first) & (record.time_s < last)
        for a, b in drive.pauses_s:
            keep &= (record.time_s < a) | (record.time_s > b)
        out.append(
            replace(
                record,
                file=f"{stem}_{len(out) + 1}{ending}",
                frequency_hz=float(f"{level.frequency_hz:.4g}"),
                amplitude_mm=float(f"{level.amplitude_mm:.4g}"),
                time_s=record.time_s[keep] - record.time_s[keep][0],
                displacement_mm=record.displacement_mm[keep],
                force_N=record.force_N[keep],
            )
        )
    return tuple(out), tuple(_omitted(record, drive))


def _omitted(record: Record, drive: Drive) -> list[str]:
    """What stands between the levels of a staircase, and before and after them."""
    ends = [0, *(x for level in drive.levels for x in (level.first, level.last)), drive.start_s.size - 1]
    said, unit = [], "s" if record.clock else "rows"
    for a, b in zip(ends[::2], ends[1::2]):
        if b > a:
            sizes = ", ".join(f"{x:.3g}" for x in drive.amplitude_mm[a : min(b, a + 4)])
            said.append(
                f"dropped: {b - a} cycle(s) from {drive.start_s[a]:.4g} to {drive.start_s[b]:.4g} {unit} ({sizes} mm): "
                f"no level that is held for {SHORT[0]} cycles"
            )
    longest = 2.0 / float(np.min(drive.frequency_hz))
    for a, b in ((record.time_s[0], drive.start_s[0]), (drive.start_s[-1], record.time_s[-1])):
        if b - a > longest:
            said.append(
                f"dropped: {a:.4g} to {b:.4g} {unit}: no cycle of more than {SMALLEST:.0%} of the largest stroke"
            )
    return said
