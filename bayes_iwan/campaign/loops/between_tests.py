"""What the tests of one campaign say of each other: copies, wrong units, odd angles, one test turned round."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import Loop
from bayes_iwan.campaign.loops.clipping import limits_of_loops, said_of
from bayes_iwan.campaign.loops.drift import level_means
from bayes_iwan.campaign.loops.steadiness import late_by
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.campaign.timing.groups import SAME, groups_of

UNIT_MARGIN = 5.0  # two forces further apart than amplitude, frequency and load explain: a unit or gain error
FEWEST = 4  # tests from which one can be distinguished from the others
ODD_ANGLE = 12.0  # degrees of loss angle, off what the other tests lead one to expect
ASYMMETRY = 0.02  # of the force's size: the even part of a loop to compare
ALIKE = 0.7  # correlation of two tests' even parts


def compared(
    records: Sequence[Record], loops: Sequence[Loop], recorded: Sequence[Record] | None = None
) -> tuple[Record, ...]:
    """The records with what they say of each other added to their warnings, and mean forces that contradict each other
    taken off. recorded : the same before anything was taken off them.

    Raises CampaignError for copies and for a force in the wrong unit.
    """
    check_copies(records)
    check_units(records, loops)
    notes = [a + b for a, b in zip(_odd_angles(loops), _turned_round(loops))]
    limits = limits_of_loops(records if recorded is None else recorded, loops)
    notes = [n + said_of([x for x in limits if x.file == r.file]) for n, r in zip(notes, records)]
    noted = [replace(r, warnings=r.warnings + tuple(n)) if n else r for r, n in zip(records, notes)]
    return level_means(noted, loops)


def _odd_angles(loops: Sequence[Loop]) -> list[list[str]]:
    """A delay in one test: its loss angle is off the plane in log amplitude and frequency through the others, and
    outside of what its neighbours in amplitude span, since friction's angle changes with amplitude."""
    n = len(loops)
    out: list[list[str]] = [[] for _ in loops]
    if n < FEWEST:
        return out
    angle = np.array([_angle(loop) for loop in loops])
    size = np.log([loop.amplitude_mm for loop in loops])
    hz = [loop.frequency_hz for loop in loops]
    x = np.column_stack([size, hz if len(groups_of(hz)) > 1 else np.zeros(n)])  # not how one frequency is estimated
    x = (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-9)
    worst, excess, off = -1, 0.0, 0.0
    for k in range(n):
        others = np.arange(n) != k
        # a weak ridge holds what few tests leave open (all at one frequency, say)
        design = np.column_stack([np.ones(others.sum()), x[others]])
        normal = design.T @ design + np.diag([0.0, 0.1, 0.1])
        found = np.linalg.solve(normal, design.T @ angle[others])
        here = float(angle[k] - found @ np.concatenate([[1.0], x[k]]))
        over = abs(here) - ODD_ANGLE - 2 * float(np.abs(angle[others] - design @ found).max())
        over = min(over, _outside(k, size, angle))
        if over > excess:
            worst, excess, off = k, over, here
    if worst >= 0:
        said = late_by(loops[worst], off)
        out[worst].append(
            f"the force {'leads' if off > 0 else 'lags'} by {abs(off):.0f}°{said} more than "
            "the other tests lead one to expect: a channel of this test is delayed? Its damping would be wrong by as "
            "much; record it again or shift the column"
        )
    return out


def _outside(k: int, size: Array, angle: Array) -> float:
    """Degrees by which a test's angle is outside of what its neighbours in log amplitude span; at the end of the
    amplitudes, of what these and a line through the next ones span, less ODD_ANGLE for its curvature."""
    off = size - size[k]
    sides = []
    for side in (1.0, -1.0):
        there = np.flatnonzero((side * off > -SAME) & (np.arange(size.size) != k))
        if there.size:
            near = float(np.min(side * off[there]))
            sides.append(there[side * off[there] < near + SAME])
    known = angle[np.concatenate(sides)]
    slack = 0.0
    if len(sides) == 1:
        first, others = sides[0], np.delete(np.arange(size.size), [k, *sides[0]])
        at = float(np.mean(size[first]))
        slack = ODD_ANGLE
        if others.size:
            second = others[np.argmin(np.abs(size[others] - at))]
            slope = (angle[second] - np.mean(angle[first])) / (size[second] - at)
            known = np.append(known, np.mean(angle[first]) + slope * (size[k] - at))
    early, late = float(angle[k] - known.max()), float(known.min() - angle[k])
    sticks = len(sides) == 1 and off.min() >= -SAME  # the smallest amplitude, at which contacts hardly slip
    return (early if sticks else max(early, late)) - slack


def _angle(loop: Loop) -> float:
    """Loss angle of the fundamental, degrees; 0 is a spring, 90 a damper."""
    u = np.mean(loop.displacement_mm * np.exp(-2j * np.pi * loop.phase))
    return float(np.degrees(np.angle(loop.harmonics_N[1] / u)))


def _turned_round(loops: Sequence[Loop]) -> list[list[str]]:
    """Both channels of one test reversed: the asymmetry of its loop is the opposite of the others'.

    The even part of the force (of half a cycle's period), less that of the displacement times the stiffness, changes
    its sign when both channels do, and nothing else of the loop does.
    """
    out: list[list[str]] = [[] for _ in loops]
    parts: list[Array | None] = []
    for loop in loops:
        half = loop.phase.size // 2
        u = 2 * np.mean(loop.displacement_mm * np.exp(-2j * np.pi * loop.phase))
        slope = float(np.real(loop.harmonics_N[1] / u))
        force = loop.force_N - loop.force_N.mean() - slope * loop.displacement_mm
        even = (force[:half] + force[half:]) / 2
        size = float(np.std(even))
        parts.append(even / size if size > ASYMMETRY * float(np.std(loop.force_N)) else None)
    usable = [k for k, part in enumerate(parts) if part is not None]
    if len(usable) < FEWEST:
        return out
    shapes = np.stack([part for part in parts if part is not None])
    alike = shapes @ shapes.T / shapes.shape[1]
    for i, k in enumerate(usable):
        apart = np.arange(len(usable)) != i
        others = alike[np.ix_(apart, apart)]
        if np.median(alike[i, apart]) < -ALIKE and np.median(others) > ALIKE:
            out[k].append(
                "its asymmetry is the opposite of the other tests': both channels reversed in this test? Multiply "
                "both columns by -1, or the asymmetry of the normal force is averaged away"
            )
    return out


def check_copies(records: Sequence[Record]) -> None:
    """Refuse the same samples under two names: each copy would narrow every interval as if measured again."""
    seen: dict[bytes, str] = {}
    for record in records:
        digest = hashlib.blake2b(record.displacement_mm.tobytes())
        digest.update(record.force_N.tobytes())
        other = seen.setdefault(digest.digest(), record.file)
        if other != record.file:
            raise CampaignError(
                f"{record.file}: the same samples as {other}; a copy is no second measurement: delete one [[test]]"
            )


def check_units(records: Sequence[Record], loops: Sequence[Loop]) -> None:
    """Refuse a test whose force is far from what the campaign's other tests allow.

    From four tests on, the RMS force is compared with a power law in amplitude (exponent 0, friction, to 2, a
    stiffening spring) and frequency (exponent -1 to 1) through the others; a factor of 4 beyond their own scatter
    stands out. Fewer are compared two by two, with UNIT_MARGIN. Other stated numbers widen either by their own ratio.
    """
    n = len(records)
    if n < 2:
        return
    size = np.log([max(float(np.std(loop.force_N)), 1e-300) for loop in loops])
    x = np.log([[loop.amplitude_mm, loop.frequency_hz] for loop in loops])
    extras = [x.extras for x in records]
    spans = np.array([[sum(_span(a.get(key), b.get(key)) for key in a) for b in extras] for a in extras])
    odd, far = (_off_power_law if n >= 4 else _off_each_other)(size, x, spans)
    if far == 0:
        return
    who = records[odd].file if n > 2 else f"{records[0].file} or {records[1].file}"
    raise CampaignError(
        f"{who}: the force is about {math.exp(far):.2g} times what the other tests lead one to expect, more than "
        "amplitude, frequency and load explain: a wrong unit or gain? Scale the column, or name its unit in the "
        "header (force_N, force_kN, torque_N_m, pressure_bar ...)"
    )


def _off_power_law(size: Array, x: Array, spans: Array) -> tuple[int, float]:
    """The test furthest off the power law through the others, and log of how far; 0 where none stands out."""
    best, excess, far = 0, 0.0, 0.0
    for k in range(size.size):
        others = np.arange(size.size) != k
        design = np.column_stack([np.ones(others.sum()), x[others] - x[k]])
        found = lsq_linear(design, size[others], bounds=([-np.inf, 0, -1], [np.inf, 2, 1]))
        off = float(size[k] - found.x[0])
        over = abs(off) - math.log(4.0) - 2 * float(np.abs(found.fun).max()) - float(spans[k].max())
        if over > excess:
            best, excess, far = k, over, off
    return best, far


def _off_each_other(size: Array, x: Array, spans: Array) -> tuple[int, float]:
    """The test that lies outside what every other allows, and log of how far; 0 where there is none."""
    step = x[:, None] - x[None]  # (i, j, amplitude or frequency)
    slack = np.abs(step[..., 1]) + math.log(UNIT_MARGIN) + spans
    off = size[:, None] - size[None]
    above = off > np.maximum(2 * step[..., 0], 0) + slack
    below = off < np.minimum(2 * step[..., 0], 0) - slack
    out = above.astype(int) - below
    scores = np.abs(out.sum(axis=1))
    k = int(np.argmax(scores))
    return (k, float(np.median(np.delete(off[k], k)))) if scores[k] == size.size - 1 else (k, 0.0)


def _span(a: float | None, b: float | None) -> float:
    if a is None or b is None or a == b:
        return 0.0
    if a * b <= 0:
        return math.log(1000.0)  # from zero to something (a coil current, say) anything may happen
    return abs(math.log(a / b))
