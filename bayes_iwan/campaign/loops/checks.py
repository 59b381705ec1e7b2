"""What a record must satisfy before anything is inferred from it, and what each refusal advises.

What tests say of each other is in `between_tests`. What cannot be seen from the data, and so is not checked: a gain
error or wrong unit shared by all tests (it only rescales stiffness and slip forces), the wrong unit of a campaign's
only test, all times scaled with the stated frequency, whole cycles lost, and both channels reversed in all tests.
"""

import math
from dataclasses import replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import FEWEST_PER_CYCLE, Loop, average
from bayes_iwan.campaign.loops.drift import friction_N, level_record
from bayes_iwan.campaign.loops.resolution import MOST_POINTS, coarse_steps
from bayes_iwan.campaign.loops.steadiness import disturbances, late_by, when
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.campaign.timing.cycles import MOST_HARMONICS
from bayes_iwan.campaign.timing.displacement_drift import COARSE, without_drift
from bayes_iwan.campaign.timing.drive import assess_drive, refuse_unsteady
from bayes_iwan.campaign.timing.harmonics import white_noise
from bayes_iwan.campaign.timing.period import ALIKE

NOMINAL_TOLERANCE = 0.10
LATE_SAID = 0.002  # sine of an angle (0.1°) below which a loop that gives out energy changes nothing
SIGMAS = 3.0  # standard errors: what is less is noise
REVERSED = 0.03  # sine of the loss angle below minus this means a reversed channel, if the force pulls back as well
LATE = 0.3  # below minus this the delay is so long that no loop is left to identify
TURNED = 0.05  # of the force's height, lost before the displacement turns: friction and springs turn with the motion
AT_TURN = 0.002  # of the stroke: nearer to its end the displacement turns, or is held
PRELOAD = 2.0  # mean force over its height: so much more that it is said
#: cycles that are not used from which it is said, and their motion over the others'
UNUSED, MOVES, MUCH_LESS = 1.5, 0.03, 0.5
CORNER_ERROR = 0.02  # of amplitude or energy: a loop that is off its samples by more is refused
SPIKE = 1.0  # distance from the middle of the loop, over its whole height
ROUNDED = 1e-3  # of a step: times that are off an even clock by more are rounded, and so is the first
LARGEST_G = 1e4  # in g: ten times what shakers reach with a specimen
RATE_OFF = 0.02  # by which a time's steps may differ from a stated sample rate
EPOCH_S = 1e10  # the year 2286: a later time in seconds is a time in ms


def on_grid_of_rate(time: Array, rate: float) -> Array:
    """The exact times of samples at `rate` where the column (n,) is a rounded copy of them (it may then repeat).

    They begin where the column is off them by as much to either side: one time is known to a unit of rounding alone.
    """
    steps, off = np.diff(time), time - time[0] - np.arange(time.size) / rate
    if not (steps >= 0).all() or not (steps > 0).any():
        return time
    if (steps == 0).any():  # rounded to more than a step: nearer to its own value than to those before and after
        levels, of = np.unique(time, return_inverse=True)
        half = np.diff(levels)[[0, *range(levels.size - 1), -1]] / 2
        low, high = float((off - half[of]).max()), float((off + half[of + 1]).min())
        rounded = low - high <= 0.02 * half.min()
    else:
        low, high = float(off.min()), float(off.max())
        rounded = max(-low, high) < 0.75 / rate
    if not rounded:
        return time
    return time - off + ((low + high) / 2 if np.ptp(off) * rate > ROUNDED else 0.0)


def usual_step(time: Array) -> float:
    """The mean step of times (n,) without the gaps, which are longer than nearly all steps; 0 where none rises.
    Rounding moves single steps, and with them the median."""
    steps = np.diff(time)
    rising = steps[steps > 0]
    return float(steps[steps <= 1.5 * np.percentile(rising, 98)].mean()) if rising.size else 0.0


def contradicts(time: Array, rate: float) -> bool:
    """Whether a sample rate is neither that of the usual step nor, where many rows are lost, of the median step."""
    return min(abs(step * rate - 1) for step in (usual_step(time), float(np.median(np.diff(time))))) > RATE_OFF


def check_epoch(file: str, start_s: float, fix: str) -> None:
    """Refuse a clock that counts milliseconds and is said to count seconds."""
    if start_s > EPOCH_S:
        raise CampaignError(
            f"{file}: time starts at {start_s:.6g} s, {start_s / 3.15576e7:,.0f} years: milliseconds since 1970? {fix}"
        )


def check_time(file: str, time: Array, rate: float | None, frequency_hz: float) -> None:
    """Refuse a record whose time column runs backwards, contradicts its sample rate or aliases the motion."""
    if time.size < 2 * FEWEST_PER_CYCLE:
        raise CampaignError(f"{file}: {time.size} samples; at least two whole cycles are needed")
    steps = np.diff(time)
    check_epoch(file, float(time[0]), "Name the column time_ms")
    if not (steps > 0).all():
        k = int(np.argmin(steps > 0))
        fix = "export the record again, or let `bayes-iwan import` read it"
        if (steps >= 0).all() and np.count_nonzero(steps == 0) > 0.02 * time.size:
            fix = "it is rounded too far: state sample_rate_hz in [channels]"
        raise CampaignError(
            f"{file} line {k + 3}: time does not increase ({time[k]:.12g} s, then {time[k + 1]:.12g} s); {fix}"
        )
    step = float(np.median(steps))
    if rate is not None and contradicts(time, rate):
        raise CampaignError(
            f"{file}: the time column steps by {step:.6g} s, but sample_rate_hz = {rate:g} in [channels] means "
            f"{1 / rate:.6g} s; fix whichever is wrong"
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
            f"{gaps.size} gap(s) of up to {gaps.max():.3g} s (steps are {step:.3g} s), dropped samples? They are "
            "bridged by the time column and cost only their cycles; where they are many, look at the recorder"
        )
    usual = steps[steps <= 1.5 * step]
    if usual.max() - usual.min() > 0.02 * step:
        notes.append(
            f"irregular steps, {usual.min():.3g} to {usual.max():.3g} s: each sample keeps its own time, which does no "
            "harm if the time column is true"
        )
    return tuple(notes)


def check_record(record: Record) -> tuple[Record, Loop]:
    """Refuse a record that contradicts campaign.toml or has a reversed channel.

    Returns the record with its warnings completed, and its loop for what tests say of each other.
    """
    coarse = [
        *coarse_steps(record.displacement_mm, "displacement", record.units.displacement),
        *coarse_steps(record.force_N, "force", record.units.force),
    ]
    # cycles cannot be counted on a large drift; what is left of it, and what is smaller, is looked at below
    level, line_mm, _ = without_drift(record.time_s, record.displacement_mm, COARSE)
    record = replace(record, displacement_mm=level)
    refuse_unsteady(record.file, assess_drive(record.time_s, record.displacement_mm), record.clock)
    loop = average(record, n_blocks=1)
    record, drifts = level_record(record, loop, line_mm)
    loop = average(record, n_blocks=1) if record is not loop.record else loop
    notes, corners = [*record.warnings, *coarse, *drifts], _corners(loop)
    steps = np.diff(record.time_s)  # and the frequency if each were the logger's shortest
    counted = loop.frequency_hz * float(np.mean(steps) / np.percentile(steps, 5))
    if abs(loop.frequency_hz / record.frequency_hz - 1) > NOMINAL_TOLERANCE >= abs(counted / record.frequency_hz - 1):
        notes.append(
            f"campaign.toml states {record.frequency_hz:.4g} Hz, which counts samples as if their steps were even; by "
            f"the time column it is {loop.frequency_hz:.4g} Hz, which is used"
        )
    elif record.clock:
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
    notes += _beyond_shakers(loop) + _angle(loop)
    notes += corners
    notes += disturbances(loop)
    _refuse_smeared(loop)
    static, height = float(loop.harmonics_N[0].real), float(np.ptp(loop.force_N))
    if abs(static) > PRELOAD * height:
        notes.append(
            f"the force's mean is {static:.4g} N, {abs(static) / max(height, 1e-300):.3g} times the height of the loop "
            f"({height:.3g} N): a "
            "static load, or an offset of the channel? It is identified as a constant; subtract it if it is no load"
        )
    notes += [
        said.format(n)
        for n, said in (
            (loop.cut.gap_cycles, "{} cycle(s) omitted: long gaps or pauses. Fewer widen intervals"),
            (loop.cut.run_in, "{} run-in cycle(s) omitted at the start, which would pass for other slip forces"),
            (
                loop.cut.late,
                "until its first turn the force still shows what was before: these {:.2g} cycle(s) are "
                "omitted. Record more cycles",
            ),
            (loop.cut.run_out, "{} unsteady cycle(s) omitted at the end, where the drive stops"),
        )
        if n
    ]
    notes += _unused(record, loop)
    for name, values, mean in (
        ("displacement", record.displacement_mm[index] - loop.offset_mm, loop.displacement_mm),
        ("force", record.force_N[index], loop.force_N),
    ):
        spikes = np.flatnonzero(np.abs(values - (mean.max() + mean.min()) / 2) > SPIKE * np.ptp(mean))
        if spikes.size:
            notes.append(
                f"{spikes.size} spike(s) in the {name}, the first at {when(loop, record.time_s[index[spikes[0]]])}, "
                "are averaged in: delete their lines, the gaps will be bridged"
            )
    return replace(record, warnings=tuple(notes)), loop


def _refuse_smeared(loop: Loop) -> None:
    """Raise CampaignError where a loop lacks much of the displacement that its record has beyond noise."""
    u = loop.record.displacement_mm[loop.cut.index] - loop.offset_mm
    whole, kept = (float(np.mean(np.sort(x**2)[: int(0.95 * x.size)])) for x in (u, loop.displacement_mm))  # no spikes
    lost = whole - kept - white_noise(u) ** 2
    if lost > ALIKE**2 * whole:
        raise CampaignError(
            f"{loop.file}: {np.sqrt(lost / whole):.0%} of the displacement is lost in averaging: it does not repeat "
            f"after {loop.cut.frequency_hz**-1:.4g} s, or moves faster than the {MOST_HARMONICS} harmonics of a loop. "
            f"Steady the drive; take a multisine's highest frequency below {MOST_HARMONICS} times its base"
        )


def _unused(record: Record, loop: Loop) -> list[str]:
    """Parts before and after the cycles that are used in which the motion is much smaller, and is no standstill."""
    time, kept, notes = record.time_s, record.time_s[loop.cut.index], []
    for where, part, said in (("start", time < kept[0], loop.cut.run_in), ("end", time > kept[-1], loop.cut.run_out)):
        cycles = float(np.ptp(time[part])) * loop.frequency_hz if np.count_nonzero(part) > 1 else 0.0
        if said or cycles < UNUSED:
            continue
        off = np.abs(record.displacement_mm[part] - loop.offset_mm)
        swing = float(np.median(off)) / (np.sqrt(0.5) * loop.amplitude_mm)
        if MOVES < swing < MUCH_LESS:
            notes.append(
                f"the {where} of the record, as long as {cycles:.3g} cycles, is not used: the motion there is "
                f"{swing:.0%} of the other cycles'. A run-up or run-out does no harm; a gain that was switched makes "
                "one of the parts wrong"
            )
    return notes


def _corners(loop: Loop) -> list[str]:
    """A drive with corners is kept whole, but what the channels make of the corners is not the specimen's doing.

    Raises CampaignError for corners that neither the samples nor the loop's harmonics follow.
    """
    if loop.corners:
        fine, whole = average(loop.record, MOST_POINTS, n_blocks=1), loop.averager.phase >= np.ceil(loop.cut.late)
        u, force = (x[loop.averager.index[whole]] for x in (loop.record.displacement_mm, loop.record.force_N))
        cycles, first = np.unique(np.floor(loop.averager.phase[whole]), return_index=True)
        unit = loop.record.units.displacement
        stroke = float(np.median(np.maximum.reduceat(u, first) - np.minimum.reduceat(u, first)))
        # of the same cycles: a specimen that hardens or runs in is no jump
        energy = _area(fine.displacement_mm, fine.force_of_cycles_N(cycles.astype(int)))
        own = _area(u, force) / cycles.size
        # noise makes a stroke longer, never shorter
        if (
            abs(energy - own) > CORNER_ERROR * 2 * stroke * friction_N(fine)
            or 2 * fine.amplitude_mm > (1 + CORNER_ERROR) * stroke
        ):
            raise CampaignError(
                f"{loop.file}: the displacement jumps faster than samples and harmonics follow: an amplitude of "
                f"{fine.amplitude_mm:.4g} where samples show {stroke / 2:.4g} {unit}, an "
                f"energy of {energy:.4g} for {own:.4g} N {unit}. Move more slowly where it jumps"
            )
    if not loop.corners_gap:
        return []
    return [
        "the displacement has corners (a triangle, holds, a sensor's ripple): it is kept whole, but what turns "
        f"at once is more than filtered channels pass. A gap of up to {100 * loop.corners_gap:.2g} % of the friction "
        "force may be theirs, and `diagnose` lays that on nothing; run sines"
    ]


def _area(u: Array, force: Array) -> float:
    """Area within closed curves of displacement (n,) and force (n,)."""
    return 0.5 * float(np.sum((force + np.roll(force, -1)) * (np.roll(u, -1) - u)))


def _near(record: Record, key: str, found: float, stated: float, unit: str, hint: str = "") -> None:
    if abs(found / stated - 1) <= NOMINAL_TOLERANCE:
        return
    power = round(math.log10(found / stated))
    for size, wrong in (
        (1 / 25.4, "25.4 × too small: inches named mm?"),
        (25.4, "25.4 × too large: mm named in?"),
        (10.0**power, f"a factor of 1e{power:+d}: a wrong unit?"),
    ):
        if not hint and (unit == "mm" or size == 10.0**power) and abs(found / stated / size - 1) <= NOMINAL_TOLERANCE:
            hint = f" ({wrong})"
    raise CampaignError(
        f"{record.file}: the record shows {found:.4g} {unit}, campaign.toml states {key} = {stated:.4g}{hint}; fix "
        "campaign.toml, the column's unit, or take the right file"
    )


def _beyond_shakers(loop: Loop) -> list[str]:
    """What is said of an acceleration that a wrong unit of the time or the displacement makes."""
    acceleration_g = (2 * math.pi * loop.frequency_hz) ** 2 * loop.amplitude_mm * 1e-3 / 9.81
    if not loop.record.clock or loop.record.units.displacement != "mm" or acceleration_g < LARGEST_G:
        return []
    return [
        f"{loop.frequency_hz:.3g} Hz at {loop.amplitude_mm:.3g} mm is an acceleration of {acceleration_g:.2g} g, more "
        "than shakers reach: check the units of the time and the displacement"
    ]


def _angle(loop: Loop) -> list[str]:
    """What the angle between force and displacement says: a reversed channel, a late one, or an early one.

    A reversed channel turns both the loss and the elastic part round; a delay only tips the loop over. At the end of
    the stroke a friction contact and a spring turn with the motion: a force that has turned long before belongs to a
    viscous specimen, or is early.
    """
    loss, elastic = _loss(loop)
    if loss < -REVERSED and elastic < 0:
        raise CampaignError(
            f"{loop.file}: the loop gives out energy and the force pulls along with the motion (sine of the loss angle "
            f"{loss:.2f}), so one channel is reversed. Multiply this file's force or displacement column by -1 (where "
            "all files are reversed, `import --reverse force` does it); the force must be the one that moves the "
            "specimen along +displacement"
        )
    noise = float(loop.noise_N[1]) / max(float(np.abs(loop.harmonics_N[1])), 1e-300)
    if loss < -max(LATE_SAID, SIGMAS * noise):
        angle = math.degrees(math.atan2(-loss, elastic))
        what = (
            "the loop gives out energy, which no passive specimen does: the force is late by "
            f"{angle:.2g}°{late_by(loop, angle)} and more, a delayed or AC-coupled channel, or the two channels are "
            "swapped"
        )
        if loss < -LATE:
            raise CampaignError(f"{loop.file}: {what}. Shift the force column back by its delay, and record both alike")
        return [
            f"{what}. Stiffness and slip forces take the delay up: `diagnose` searches for it, a calibration settles it"
        ]
    u, force, near = loop.displacement_mm, loop.force_N, AT_TURN * float(np.ptp(loop.displacement_mm))
    at_top, at_bottom = force[u >= u.max() - near].max(), force[u <= u.min() + near].min()
    fallen = (force.max() - at_top + at_bottom - force.min()) / 2
    scatter = float(np.median(loop.force_scatter_N)) / math.sqrt(loop.n_cycles)
    height = max(float(np.ptp(loop.force_N)), 1e-300)
    if fallen <= max(TURNED * height, SIGMAS * scatter):
        return []
    return [
        f"the force falls by {fallen / height:.0%} of the loop's height before the displacement turns, as viscous "
        "damping, inertia, a late displacement channel or a force without its sign (absolute value, RMS) make it: "
        "check the delay between the channels"
    ]


def _loss(loop: Loop) -> tuple[float, float]:
    """How much of the force moves with the velocity and with the displacement: sine and cosine of a loss angle.

    The velocity is that of the displacement's grid: at a corner the true one is of neither sign, and a spring's force
    times it does not add up to nothing.
    """
    force = loop.force_N - loop.force_N.mean()

    def along(motion: Array) -> float:
        size = float(np.std(force) * np.std(motion))
        return float(np.mean(force * motion)) / size if size > 0 else 0.0

    u = loop.displacement_mm
    return along(np.roll(u, -1) - np.roll(u, 1)), along(u)
