"""Whether a channel was limited by its amplifier, as far as the tests of a campaign together can tell.

An amplifier limits at one level: whatever the amplitude, the frequency and the sign, and nothing is recorded beyond
it. A specimen that yields or slides has flat tops too, at levels of its own. So what seems limited in one record is
held against the others before it is called clipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import Loop
from bayes_iwan.campaign.recording.records import Record

RAIL_SHARE = 0.004  # of the kept samples at one extreme value, in runs, before a channel seems limited
COARSE = 0.01  # of the span: a smallest step so large that a flat top is a single value of the recorder
FLAT = 0.01  # of the force's height: what counts as its top
FLAT_STROKE, LONG_STROKE = 0.06, 0.2  # of the stroke that a spring's or a sliding specimen's top takes at most
THROUGH = 0.04  # of the stroke after the motion has turned: friction and springs have let go of the top by then
CORNER = 0.5  # slope just before the top over the secant stiffness: a friction force curves long before
ONE_LEVEL = 0.02  # of the level: so much an amplifier's limits differ between tests
ONE_SIZE = 0.1  # of the level: so much its two limits differ, where the record's zero is not the amplifier's
BEYOND = 0.02  # of the channel's height: what is recorded so far beyond a level was not limited there


@dataclass(frozen=True)
class Limit:
    """A level at which one channel of one test seems limited.

    exact : does it stay on one recorded value there, or only its averaged loop is flat? share : of the time, or of
    the stroke
    """

    file: str
    channel: str
    side: int
    level: float
    exact: bool
    share: float


@dataclass(frozen=True)
class Top:
    """The flat part of an averaged loop at one side: share of the stroke, slope before it over the secant stiffness,
    and whether it lasts after the motion has turned."""

    stroke: float
    slope: float
    through: bool


def limits_of_loops(records: Sequence[Record], loops: Sequence[Loop]) -> tuple[Limit, ...]:
    """Where the tests of a campaign were limited by an amplifier; records : as recorded, nothing taken off."""
    found = [x for record, loop in zip(records, loops) for x in _suspected(record, loop)]
    return tuple(x for x in found if _as_an_amplifier(x, found, records, loops))


def said_of(limit: Limit) -> str:
    """One line on a limit: what, what it does, what to do."""
    wrong, unit = ("slip forces come", "N") if limit.channel == "force" else ("the stroke comes", "mm")
    how = f"stays on it for {limit.share:.1%} of the time" if limit.exact else "has a flat top there, under noise"
    return (
        f"the {limit.channel} may be clipped at {limit.level:.6g} {unit}: it {how}. If so, {wrong} out too small. "
        f"Raise the {limit.channel} range (lower the gain) and record again"
    )


def _suspected(record: Record, loop: Loop) -> list[Limit]:
    out = []
    index = loop.cut.index
    for channel, values in (("displacement", record.displacement_mm[index]), ("force", record.force_N[index])):
        span = float(np.ptp(values))
        steps = np.diff(np.unique(values))
        if span <= 0.0 or steps.min(initial=span) > COARSE * span:
            continue
        for side in (1, -1):
            share = _resting(side * values, loop.n_cycles)
            if share:
                out.append(Limit(record.file, channel, side, float(side * np.max(side * values)), True, share))
            elif channel == "force" and (top := _top(loop, side)) is not None and _cornered(top):
                out.append(
                    Limit(record.file, channel, side, float(side * np.max(side * loop.force_N)), False, top.stroke)
                )
    return out


def _resting(values: Array, n_cycles: int) -> float:
    """Share of the time that a channel stays on its highest value in runs, cycle after cycle; 0 where it does not. A
    rounded peak also repeats its top level, but then the levels next to it fill as well."""
    at = values == values.max()
    runs = np.count_nonzero(at[1:] & at[:-1])
    if at.mean() < RAIL_SHARE or runs < 2 * n_cycles:
        return 0.0
    near = np.count_nonzero((values.max() - values < 0.02 * np.ptp(values)) & ~at)
    return float(at.mean()) if np.count_nonzero(at) > 3 * near else 0.0


def _top(loop: Loop, side: int) -> Top | None:
    """The flat part of the averaged force at one side, since noise hides it in the samples; None where there is none
    to speak of."""
    force, u = side * loop.force_N, side * loop.displacement_mm
    middle = force.size // 2
    turn = middle - int(np.argmax(force))
    force, u = np.roll(force, turn), np.roll(u, turn)
    below = force <= force[middle] - FLAT * np.ptp(force)
    a = int(np.flatnonzero(below[:middle])[-1]) + 1 if below[:middle].any() else 0
    b = middle + int(np.argmax(below[middle:])) if below[middle:].any() else force.size
    width = min(max(3, (b - a) // 2), 8)
    if a < width:
        return None
    stroke = float(np.ptp(u[a:b]) / np.ptp(u))
    run = max(float(u[a] - u[a - width]), 1e-9 * float(np.ptp(u)))
    slope = float(force[a] - force[a - width]) / run / float(np.ptp(force) / np.ptp(u))
    through = float(np.max(u[a:b]) - u[b - 1]) > THROUGH * float(np.ptp(u))
    return Top(stroke, slope, through)


def _rail(record: Record, loop: Loop, limit: Limit) -> Top:
    """The same of the samples that stay on one value."""
    index, phase = loop.cut.index, loop.averager.phase
    u = limit.side * np.interp(phase % 1.0, loop.phase, loop.displacement_mm, period=1.0)
    falls = limit.side * np.interp(phase % 1.0, loop.phase, loop.velocity_m_s, period=1.0) < 0.0
    at = record.force_N[index] == limit.level
    whole = float(np.ptp(loop.displacement_mm))
    lowest = float(np.min(u[at & falls], initial=np.inf))
    return Top(float(np.ptp(u[at])) / whole, np.inf, float(u.max()) - lowest > THROUGH * whole)


def _cornered(top: Top) -> bool:
    """Does the force rise steeply and then not at all, without letting go when the motion turns?"""
    return top.stroke > FLAT_STROKE and top.slope > CORNER and (top.through or top.stroke < LONG_STROKE)


def _as_an_amplifier(
    one: Limit, all_of_them: Sequence[Limit], records: Sequence[Record], loops: Sequence[Loop]
) -> bool:
    """Is this level the same in every test that reaches it and at both signs, and does no record go on beyond
    it? Where it is exact, or lasts after the motion has turned, only this record is asked."""
    same = [x for x in all_of_them if x.channel == one.channel and x.side == one.side]
    if max(abs(x.level - one.level) for x in same) > ONE_LEVEL * abs(one.level):
        return False
    own = next((r, x) for r, x in zip(records, loops) if r.file == one.file)
    top = None
    if one.channel == "force":
        top = _rail(*own, one) if one.exact else _top(own[1], one.side)
    for record, loop in zip(records, loops):
        if record.file != one.file and (one.exact or (top is not None and top.through)):
            continue  # no friction does that: the range was set for this test alone
        values = (record.force_N if one.channel == "force" else record.displacement_mm)[loop.cut.index]
        step = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6)
        if np.max(one.side * values) > one.side * one.level + max(BEYOND * float(np.ptp(values)), 5.0 * step):
            return False
    other = [x.level for x in all_of_them if x.channel == one.channel and x.file == one.file and x.side != one.side]
    if other and not one.exact and abs(abs(other[0]) - abs(one.level)) > ONE_SIZE * abs(one.level):
        return False
    return top is None or top.through or top.stroke < LONG_STROKE
