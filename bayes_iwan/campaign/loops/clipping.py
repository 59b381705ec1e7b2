"""Whether a channel was limited by its amplifier, as far as the tests of a campaign together can tell.

An amplifier limits at one level: whatever the amplitude, the frequency and the sign, and nothing is recorded beyond
it. A specimen that yields or slides has flat tops too, at levels of its own. So what seems limited in one record is
held against the others before it is called clipped.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import Loop
from bayes_iwan.campaign.recording.records import Record
from bayes_iwan.campaign.timing.harmonics import white_noise
from bayes_iwan.screen import on_screen

COARSE = 0.01  # of the span: a smallest step so large that a flat top is a single value of the recorder
FLAT = 0.01  # of the force's height: what counts as its top
FLAT_STROKE, LONG_STROKE = 0.06, 0.2  # of the stroke that a spring's or a sliding specimen's top takes at most
CORNERED = 2.0  # times the usual change of speed within two samples: 1.4 at a sine's turn, many at a corner
THROUGH = 0.02  # of the stroke after the motion has turned: friction and springs have let go of the top by then
CORNER = 0.5  # slope just before the top over the secant stiffness: a friction force curves long before
ONE_LEVEL = 0.02  # of the level: so much an amplifier's limits differ between tests
TOP_PARTS = 64  # of a cycle, in which samples are averaged to see a flat top: harmonics would ripple at its corners
PIECE = 16  # samples of neighbouring phase, on a cubic but for noise
LEAST_NOISE = 2e-5  # of the span: less no recording has
LEVEL = 0.002  # of the height: scatter of a flat top's parts; one that only curves slowly has more
BEYOND = 0.02  # of the channel's height: what is recorded so far beyond a level was not limited there


@dataclass(frozen=True)
@on_screen
class Limit:
    """A level at which one channel of one test seems limited.

    exact : does it stay on one recorded value there, or only its averaged loop is flat? quiet : and does its noise,
    which it has elsewhere, stop there? share : of the time, or of the stroke
    """

    file: str
    channel: str
    side: int
    level: float
    exact: bool
    quiet: bool
    share: float


@dataclass(frozen=True)
class Top:
    """The flat part of a loop at one side: level (N), share of the stroke, slope before it over the secant stiffness,
    and whether it lasts after the motion has turned."""

    level: float
    stroke: float
    slope: float
    through: bool


def limits_of_loops(records: Sequence[Record], loops: Sequence[Loop]) -> tuple[Limit, ...]:
    """Where the tests of a campaign were limited by an amplifier; records : as recorded, nothing taken off."""
    found = [x for record, loop in zip(records, loops) for x in _suspected(record, loop)]
    return tuple(x for x in found if _as_an_amplifier(x, found, records, loops))


def said_of(limits: Sequence[Limit]) -> list[str]:
    """One line on the limits of a channel, which are at one side or at both: what, what it does, what to do."""
    out = []
    for (_, channel, exact, quiet), alike in groupby(limits, lambda x: (x.file, x.channel, x.exact, x.quiet)):
        some = list(alike)
        wrong, unit = ("slip forces come", "N") if channel == "force" else ("the stroke comes", "mm")
        at = f"{' and '.join(f'{x.level:.6g}' for x in some)} {unit}"
        how = f"stays there for {sum(x.share for x in some):.1%} of the time" if exact else "is flat, under noise"
        said = f"the {channel} may be clipped at {at}: it {how}. If so, {wrong} out too small"
        if quiet:
            said = f"the {channel} is clipped at {at}: it {how}, without the noise that it has elsewhere. "
            said += f"{wrong[0].upper()}{wrong[1:]} out too small"
        out.append(f"{said}. Raise the {channel} range (lower the gain) and record again")
    return out


def _suspected(record: Record, loop: Loop) -> list[Limit]:
    out = []
    index = loop.cut.index
    for channel, values in (("displacement", record.displacement_mm[index]), ("force", record.force_N[index])):
        span = float(np.ptp(values))
        steps = np.diff(np.unique(values))
        if span <= 0.0 or steps.min(initial=span) > COARSE * span:
            continue
        for side in (1, -1):
            share = _resting(side * values, loop.n_cycles, float(steps.min()))
            if share and (channel == "force" or _force_goes_on(side * values, record.force_N[index])):
                level = float(side * np.max(side * values))
                quiet = channel == "force" and _noise(loop, values, level) > max(steps.min(), LEAST_NOISE * span)
                out.append(Limit(record.file, channel, side, level, True, quiet, share))
            elif channel == "force" and (top := _top(loop, values, side)) is not None and _cornered(top):
                out.append(Limit(record.file, channel, side, top.level, False, False, top.stroke))
    return out


def _noise(loop: Loop, values: Array, level: float) -> float:
    """Standard deviation of a channel's noise from sample to sample, away from a level: values (n,), sorted by phase,
    less cubics through a few neighbours each; 0 where there are too few."""
    phase = loop.averager.phase % 1.0
    order = np.argsort(phase, kind="stable")
    left = np.full(values.size, np.nan)
    for piece in np.array_split(order, max(values.size // PIECE, 1)):
        if piece.size < PIECE or (values[piece] == level).any():
            continue
        x = np.vander((phase[piece] - phase[piece[0]]) / max(float(np.ptp(phase[piece])), 1e-12), 4)
        left[piece] = values[piece] - x @ np.linalg.lstsq(x, values[piece], rcond=None)[0]
    jumps = np.diff(left, 2)
    if np.count_nonzero(np.isfinite(jumps)) < PIECE:
        return 0.0
    return 1.4826 * float(np.nanmedian(np.abs(jumps))) / np.sqrt(6.0)


def _resting(values: Array, n_cycles: int, step: float) -> float:
    """Share of the time that a channel stays on its highest value in runs, cycle after cycle; 0 where it does not. A
    rounded peak also repeats its top level, but then the levels next to it fill as well."""
    at = values == values.max()
    runs = np.count_nonzero(at[1:] & at[:-1])
    if runs < 2 * n_cycles:
        return 0.0
    near = np.count_nonzero((values.max() - values < 1.5 * step) & ~at)
    return float(at.mean()) if np.count_nonzero(at) > 3 * near else 0.0


def _force_goes_on(values: Array, force: Array) -> bool:
    """Does the force (n,) move while the displacement stays on its highest value? A motion that goes on beyond
    has in the second half of that time half the speed that it leaves with, a dwell has none: a quarter parts them."""
    at = np.concatenate([[False], values == values.max(), [False]])
    first, last = np.flatnonzero(at[1:] & ~at[:-1]), np.flatnonzero(at[:-1] & ~at[1:]) - 1
    half = (last - first + 1) // 2
    whole = (half > 0) & (last + half < values.size)
    before, then, after = (force[x[whole]] for x in (last - half, last, last + half))
    return bool(4 * abs(np.mean(then - before)) > abs(np.mean(after - then))) if whole.any() else False


def _top(loop: Loop, values: Array, side: int) -> Top | None:
    """The flat part of the force at one side, values (n,) its samples averaged by phase, since noise hides it in each;
    None where there is none to speak of."""
    parts = min(TOP_PARTS, values.size // 4)
    order = np.argsort(loop.averager.phase % 1.0, kind="stable")
    starts = np.linspace(0, values.size, parts, endpoint=False).astype(int)
    count = np.diff(np.append(starts, values.size))
    motion = np.interp(loop.averager.phase % 1.0, loop.phase, loop.displacement_mm, period=1.0)
    force, u = (side * np.add.reduceat(x[order], starts) / count for x in (values, motion))
    level = float(np.median(np.sort(force)[-3:]))
    height = float(level - np.sort(force)[1])
    middle = parts // 2
    turn = middle - int(np.argmax(force))
    force, u = np.roll(force, turn), np.roll(u, turn)
    below = force <= level - FLAT * height
    a = int(np.flatnonzero(below[:middle])[-1]) + 1 if below[:middle].any() else 0
    b = middle + int(np.argmax(below[middle:])) if below[middle:].any() else force.size
    width = min(max(3, (b - a) // 2), 4)
    if a <= width or b - a < 6 or np.std(force[a + 1 : b - 1]) > LEVEL * height:
        return None
    stroke = float(np.ptp(u[a:b]) / np.ptp(u))
    # the part before the top may hold the corner: the slope is that before it
    run = max(float(u[a - 1] - u[a - 1 - width]), 1e-9 * float(np.ptp(u)))
    slope = float(force[a - 1] - force[a - 1 - width]) / run / float(np.ptp(force) / np.ptp(u))
    # where the force leaves the top, between two parts
    end = min(b, parts - 1)
    left = float(np.interp(-(level - FLAT * height), -force[[b - 1, end]], u[[b - 1, end]]))
    through = float(np.max(u[a:b])) - left > THROUGH * float(np.ptp(u))
    return Top(side * level, stroke, slope, through)


def _left_at_speed(record: Record, loop: Loop, limit: Limit) -> bool:
    """Does a force leave a level more straight than curved over three samples, or jump? So it leaves an amplifier's;
    friction leaves its plateau as the motion turns or begins: from rest, unless that has a corner there."""
    force, motion = (limit.side * x[loop.cut.index] for x in (record.force_N, record.displacement_mm))
    below = limit.side * limit.level - force
    ends = _last_of(below)
    back = -np.diff(motion)
    before, after = back[ends - 1 + np.array([0, 2])].T
    usual = np.median(np.abs(back[2:] - back[:-2]))
    turns = (after > np.maximum(2 * before, 0.0)) & (after - before > CORNERED * usual)
    first, second, third = below[ends + np.arange(1, 4)].T
    curve = (third - 2 * second + first) / 2
    speed = np.sqrt(np.maximum((second - first - curve) ** 2 - 4 * curve * first, 0.0))  # of a parabola at the level
    straight = np.median((2 * speed > (third - first) / 2) & ~turns)
    return bool(straight) or _jumps(below, motion) or _jumps(below[::-1], motion[::-1])


def _last_of(below: Array) -> NDArray[np.intp]:
    """(n, 1) where a force that is so far below a level is on it for the last time."""
    return np.flatnonzero((below[:-4] == 0) & (below[1:-3] > 0))[:, None]


def _jumps(below: Array, motion: Array) -> bool:
    """Does a force leave a level by more than it moves in the next two samples, as a code for what is out of range
    does? Dry friction jumps, too, but as the motion turns."""
    ends, steps = _last_of(below), np.diff(motion)
    first, third = below[ends + np.array([1, 3])].T
    before, after = steps[ends - 1 + np.array([0, 2])].T
    return ends.size > 0 and bool(np.median((first > third - first) & (before * after > 0)))


def _cornered(top: Top) -> bool:
    """Does the force rise steeply and then not at all?"""
    return top.stroke > FLAT_STROKE and top.slope > CORNER


def _as_an_amplifier(
    one: Limit, all_of_them: Sequence[Limit], records: Sequence[Record], loops: Sequence[Loop]
) -> bool:
    """Is this level the same in every test that reaches it, and does no record go on beyond it? Where it
    is exact, or lasts after the motion has turned, only this record is asked; where noise stops at it, none is."""
    if one.quiet:
        return True
    same = [x for x in all_of_them if x.channel == one.channel and x.side == one.side]
    if max(abs(x.level - one.level) for x in same) > ONE_LEVEL * abs(one.level):
        return False
    own = next((r, x) for r, x in zip(records, loops) if r.file == one.file)
    top = None
    if one.channel == "force" and one.exact and not _left_at_speed(*own, one):
        return False
    if one.channel == "force" and not one.exact:
        top = _top(own[1], own[0].force_N[own[1].cut.index], one.side)
    for record, loop in zip(records, loops):
        if record.file != one.file and (one.exact or (top is not None and top.through)):
            continue  # no friction does that: the range was set for this test alone
        values = (record.force_N if one.channel == "force" else record.displacement_mm)[loop.cut.index]
        if np.max(one.side * values) > one.side * one.level + max(
            BEYOND * float(np.ptp(values)), 5.0 * white_noise(values)
        ):
            return False
    alone = not one.exact and len(records) == 1  # one flat top under noise may be a specimen's
    return top is None or top.through or (top.stroke < LONG_STROKE and not alone)
