"""What a record must satisfy before anything is inferred from it, and what each refusal advises.

What cannot be seen from the data, and so is not checked: a gain error or wrong unit shared by all tests (it
only rescales stiffness and slip forces), the wrong unit of a campaign's only test, and both channels reversed
together.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.averaging import Loop, average
from bayes_iwan.campaign.drive import judge, refuse_unsteady
from bayes_iwan.campaign.records import CampaignError, Record

NOMINAL_TOLERANCE = 0.10
FEWEST_PER_CYCLE = 8.0
UNIT_MARGIN = 5.0  # two forces further apart than amplitude, frequency and load explain: a unit or gain error
REVERSED = 0.03  # sine of the loss angle below minus this means a reversed channel, if the force pulls along as well
LATE = 0.3  # below minus this no late or AC-coupled channel explains it
SPIKE = 1.0  # distance from the middle of the loop, over its whole height
EPOCH_S = 1e10  # the year 2286: a later time in seconds is a time in ms
RAIL_SHARE = 0.004  # of the kept samples at one extreme value, in runs, before a channel looks clipped


def on_grid_of_rate(time: Array, rate: float) -> Array:
    """The exact sample times where the column is only a rounded copy of them (it may then even repeat)."""
    exact = time[0] + np.arange(time.size) / rate
    rounded = (np.diff(time) >= 0).all() and np.abs(time - exact).max() < 0.75 / rate
    return exact if rounded else time


def check_time(file: str, time: Array, rate: float | None, frequency_hz: float) -> None:
    """Refuse a record whose time column runs backwards, contradicts its sample rate or aliases the motion."""
    if time.size < 2 * FEWEST_PER_CYCLE:
        raise CampaignError(f"{file}: {time.size} samples; at least two whole cycles are needed")
    steps = np.diff(time)
    if time[0] > EPOCH_S:
        raise CampaignError(
            f"{file}: time starts at {time[0]:.6g} s, {time[0] / 3.15576e7:,.0f} years: milliseconds since 1970? Name "
            "the column time_ms"
        )
    if not (steps > 0).all():
        k = int(np.argmin(steps > 0))
        mend = "sort the rows or delete the repeated one"
        if (steps >= 0).all() and np.count_nonzero(steps == 0) > 0.02 * time.size:
            mend = "it is rounded too far: state sample_rate_hz in [channels]"
        raise CampaignError(
            f"{file} line {k + 3}: time does not increase ({time[k]:.12g} s, then {time[k + 1]:.12g} s); {mend}"
        )
    step = float(np.median(steps))
    if rate is not None and abs(step * rate - 1) > 0.02:
        raise CampaignError(
            f"{file}: the time column steps by {step:.6g} s, but sample_rate_hz = {rate:g} in [channels] means "
            f"{1 / rate:.6g} s; mend whichever is wrong"
        )
    if 1 / (step * frequency_hz) < FEWEST_PER_CYCLE:
        raise CampaignError(
            f"{file}: {1 / (step * frequency_hz):.1f} samples a cycle at {frequency_hz:g} Hz; at least "
            f"{FEWEST_PER_CYCLE:g} are needed or the loop is aliased. Sample faster"
        )


def step_warnings(time: Array) -> tuple[str, ...]:
    """What is said of irregular steps and gaps: averaging on the phase of every sample bridges both."""
    steps = np.diff(time)
    step = float(np.median(steps))
    notes = []
    gaps = steps[steps > 1.5 * step]
    if gaps.size:
        notes.append(
            f"{gaps.size} gap(s) of up to {gaps.max():.3g} s (steps are {step:.3g} s): bridged (dropped samples?)"
        )
    rest = steps[steps <= 1.5 * step]
    if rest.max() - rest.min() > 0.02 * step:
        notes.append(f"irregular steps, {rest.min():.3g} to {rest.max():.3g} s: each sample kept at its own time")
    return tuple(notes)


def check_record(record: Record) -> tuple[Record, Loop]:
    """Refuse a record that contradicts campaign.toml or has a reversed channel.

    Returns the record with its warnings completed, and a coarse loop for `check_units`.
    """
    refuse_unsteady(record.file, judge(record.time_s, record.displacement_mm))
    loop = average(record, n_phase=64, n_harmonics=8, n_blocks=1)
    notes = list(record.warnings)
    counted = _counted_frequency(record.time_s, loop.frequency_hz)
    if abs(loop.frequency_hz / record.frequency_hz - 1) > NOMINAL_TOLERANCE >= abs(counted / record.frequency_hz - 1):
        notes.append(
            f"campaign.toml states {record.frequency_hz:.4g} Hz, which counts samples as if their steps were even; by "
            f"the time column it is {loop.frequency_hz:.4g} Hz, which is used"
        )
    else:
        _near(record, "frequency_hz", loop.frequency_hz, record.frequency_hz, "Hz")
    unit = record.units.displacement
    swing = float(np.ptp(loop.force_N)) / 2
    if swing <= 1e-9 * float(np.abs(loop.force_N).max()):
        raise CampaignError(
            f"{record.file}: the force stays at {loop.force_N[0]:.4g}: a dead channel, or the wrong column named in "
            "[channels]?"
        )
    swapped = abs(swing / record.amplitude_mm - 1) <= NOMINAL_TOLERANCE
    hint = " (the force column moves by as much: are the two swapped?)" if swapped else ""
    _near(record, f"amplitude_{unit}", loop.amplitude_mm, record.amplitude_mm, unit, hint)
    index = loop.cut.index
    per_cycle = index.size / loop.n_cycles
    if per_cycle < FEWEST_PER_CYCLE:
        raise CampaignError(
            f"{record.file}: {per_cycle:.1f} samples a cycle; at least {FEWEST_PER_CYCLE:g} are needed or the loop "
            "is aliased. Sample faster"
        )
    loss, elastic = _loss(loop)
    if loss < -LATE or (loss < -REVERSED and elastic < 0.0):  # a reversed channel turns both round
        raise CampaignError(
            f"{record.file}: the loop gives out energy (sine of the loss angle {loss:.2f}), so one channel is "
            "reversed. Multiply the force or the displacement column by -1; the force must be the one that "
            "moves the specimen along +displacement"
        )
    if loss < 0:
        notes.append(
            f"the loop gives out energy (sine of the loss angle {loss:.3f}): a delayed or AC-coupled channel? If one "
            "is reversed, multiply it by -1"
        )
    if loop.cut.gap_cycles:
        notes.append(f"{loop.cut.gap_cycles} cycle(s) left out: long gaps or pauses")
    if loop.cut.run_in:
        notes.append(f"{loop.cut.run_in} run-in cycle(s) left out at the start")
    if loop.cut.run_out:
        notes.append(f"{loop.cut.run_out} unsteady cycle(s) left out at the end")
    for name, values, mean in (
        ("displacement", record.displacement_mm[index] - loop.offset_mm, loop.displacement_mm),
        ("force", record.force_N[index], loop.force_N),
    ):
        notes += _rails(name, values, loop.n_cycles)
        spikes = np.flatnonzero(np.abs(values - (mean.max() + mean.min()) / 2) > SPIKE * np.ptp(mean))
        if spikes.size:
            notes.append(
                f"{spikes.size} spike(s) in the {name}, the first at {record.time_s[index[spikes[0]]]:.6g} s, are "
                "averaged in: delete their lines, the gaps will be bridged"
            )
    return replace(record, warnings=tuple(notes)), loop


def _counted_frequency(time: Array, frequency_hz: float) -> float:
    """The frequency of a record with irregular steps if every step were the logger's shortest, in Hz."""
    steps = np.diff(time)
    return frequency_hz * float(np.mean(steps) / np.percentile(steps, 5))


def _near(record: Record, key: str, found: float, stated: float, unit: str, hint: str = "") -> None:
    if abs(found / stated - 1) <= NOMINAL_TOLERANCE:
        return
    power = round(math.log10(found / stated))
    for inches, how in (
        (stated / found / 25.4, "small: inches named mm"),
        (found / stated / 25.4, "large: mm named in"),
    ):
        if not hint and unit == "mm" and abs(inches - 1) <= NOMINAL_TOLERANCE:
            hint = f" (25.4 × too {how}?)"
    if not hint and power and abs(found / stated / 10.0**power - 1) <= NOMINAL_TOLERANCE:
        hint = f" (a factor of 1e{power:+d}: a wrong unit?)"
    raise CampaignError(
        f"{record.file}: the record shows {found:.4g} {unit}, campaign.toml states {key} = {stated:.4g}{hint}; mend "
        "campaign.toml, the column's unit, or take the right file"
    )


def _loss(loop: Loop) -> tuple[float, float]:
    """How much of the force moves with the velocity and with the displacement: sine and cosine of a loss angle."""
    force = loop.force_N - loop.force_N.mean()

    def along(motion: Array) -> float:
        size = float(np.std(force) * np.std(motion))
        return float(np.mean(force * motion)) / size if size > 0 else 0.0

    return along(loop.velocity_m_s), along(loop.displacement_mm)


def _rails(name: str, values: Array, n_cycles: int) -> list[str]:
    """A warning where a channel rests on its extreme value in runs, cycle after cycle, as a clipped one does.

    A rounded peak also repeats its top level, but then the levels next to it fill as well.
    """
    notes = []
    for side, extreme in (("highest", values.max()), ("lowest", values.min())):
        at = values == extreme
        share = at.mean()
        runs = np.count_nonzero(at[1:] & at[:-1])
        if share < RAIL_SHARE or runs < 2 * n_cycles:
            continue
        span = np.ptp(values)
        levels = np.unique(values[np.abs(values - extreme) < 0.02 * span])
        near = np.count_nonzero((np.abs(values - extreme) < 0.02 * span) & ~at)
        if levels.size < 2 or np.count_nonzero(at) > 3 * near:
            notes.append(f"the {name} rests on its {side} value {extreme:.6g} for {share:.1%} of the time: clipped?")
    return notes


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
    stiffening spring) and frequency (exponent -1 to 1) through the others; a factor of 4 beyond their own
    scatter stands out, so a gain of 10, kgf (9.8) or kN (1000) does. Fewer tests are compared two by two, with a
    margin of 5 on top of the widest of those exponents. Other stated numbers (normal force, pressure) widen
    either by their own ratio. A wrong unit shared by all tests, or by a campaign's only one, cannot be seen.
    """
    n = len(records)
    if n < 2:
        return
    size = np.log([max(float(np.std(loop.force_N)), 1e-300) for loop in loops])
    x = np.log([[loop.amplitude_mm, loop.frequency_hz] for loop in loops])
    spans = np.array([[_spans(a, b) for b in records] for a in records])
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


def _spans(a: Record, b: Record) -> float:
    return sum(_span(a.extras.get(key), b.extras.get(key)) for key in a.extras)


def _span(a: float | None, b: float | None) -> float:
    if a is None or b is None or a == b:
        return 0.0
    if a * b <= 0:
        return math.log(1000.0)  # from zero to something (a coil current, say) anything may happen
    return abs(math.log(a / b))
