"""Recordings into a campaign: channels found and scaled, frequency and amplitude read off, everything checked."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.folders.folder import WITHOUT_CLOCK_HZ, cycles_as_time
from bayes_iwan.campaign.folders.writing import FORCE_COLUMNS, MOTION_COLUMNS, stated, write_folder
from bayes_iwan.campaign.importing.channels import NO_TIME, Assigned, assign, matching, unit_asked
from bayes_iwan.campaign.importing.clocks import Series, paired, runs
from bayes_iwan.campaign.importing.defects import few_a_cycle, without_codes, without_repeats, wrapped_round
from bayes_iwan.campaign.importing.formats.stamps import unwrapped
from bayes_iwan.campaign.importing.joining import joined
from bayes_iwan.campaign.importing.names import named
from bayes_iwan.campaign.importing.questions import ImportAsks, Question
from bayes_iwan.campaign.importing.read import read_files
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.scaling import FEW_REPEATED, moments_unit, scaled, times_of
from bayes_iwan.campaign.importing.unit_texts import role_of
from bayes_iwan.campaign.loops.averaging import Loop, average
from bayes_iwan.campaign.loops.between_tests import compared
from bayes_iwan.campaign.loops.checks import check_record, check_time, step_warnings
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.campaign.recording.unapplied import said_of_name
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.campaign.timing.accelerometer import displacement_from_acceleration
from bayes_iwan.campaign.timing.displacement_drift import without_drift
from bayes_iwan.campaign.timing.drive import assess_drive, split_levels, staircase_said
from bayes_iwan.campaign.timing.period import crossings_a_period
from bayes_iwan.errors import nearest

ACCELERATION_COLUMNS = {"mm": "acceleration_m_s2", "mrad": "acceleration_rad_s2"}
NO_FREQUENCY_HZ = 1e-9
#: digits of what campaign.toml states; it names the test, so that 0.9962 and 1.003 mm belong together as 1 mm
FREQUENCY_DIGITS, AMPLITUDE_DIGITS = 4, 2
_RATE = Question(
    "--sample-rate", "", "HZ",
    "There is neither a time channel (--time NAME) nor a sample rate (none where rows have no clock, as of a "
    "quasi-static test).",
)  # fmt: skip
_SEVERAL = "The file states {} samples a second: which is right?"
_UNKNOWN = "The time {!r} goes up by {:.4g} a row and states no unit that is known: is it s, ms, us, min or day?"
_SECONDS = ("", "s", "sec", "Sec", "SEC")
STEPS_S = 1e-6, 0.1  # of a time without a unit: what is shorter may be in days, what is longer in ms
_ROWS = (
    "The time {!r} goes up by one a row: is that a clock of 1 Hz (1; 1000 if it counts ms), or a count of rows, which "
    "no frequency is read from (none)?"
)


@dataclass(frozen=True)
class ImportedTest:
    """One test: its record, the columns that are written for it, and how they came about, line by line."""

    record: Record
    columns: Mapping[str, Array]
    rate_hz: float | None
    loop: Loop
    said: tuple[str, ...]


def import_tests(
    files: Sequence[str | os.PathLike[str]],
    recipe: Recipe | None = None,
    split: bool = False,
    held_out: Sequence[str] = (),
    join: bool = False,
) -> tuple[ImportedTest, ...]:
    """Read files of a data-acquisition system as tests of one campaign.

    files : files, folders (all in them) or patterns ("run*.csv"). split : take a record whose drive goes through levels
    of amplitude or frequency as one test a level. held_out : names or patterns of files or tests that are kept out of
    fits. join : all files are channels of one test.
    Raises ImportAsks for what the files do not say, all of it at once, and CampaignError, in one line with the file and
    how to fix it, for everything that `read_campaign` would refuse.
    """
    recipe = recipe or Recipe()
    found, passed_over = read_files(files, recipe.layout)
    recordings, join_asked = joined(found, recipe, join)
    recordings = _named_parts(recordings, recipe)
    tests: list[ImportedTest] = []
    asked: list[ImportAsks] = []
    for recording in recordings:
        try:
            tests += _tests(recording, recipe, split)
        except ImportAsks as missing:
            asked.append(missing)
    if asked or join_asked:
        others = [replace(q, text=f"In {x.where}: {q.text}") for x in asked[1:] for q in x.questions]
        raise ImportAsks(recordings[0].where, [*join_asked, *(q for x in asked[:1] for q in x.questions), *others])
    if not tests:
        raise CampaignError("import: no files")
    tests[-1] = replace(tests[-1], said=(*tests[-1].said, *passed_over))
    first = tests[0]
    for test in tests:
        if list(test.columns) != list(first.columns):
            this, that = (f"{x.record.file} has {' and '.join([*x.columns][-2:])}" for x in (test, first))
            fix = (
                "import each kind into a campaign of its own, or name one channel that all files have (--displacement)"
            )
            raise CampaignError(f"{this}, {that}; a campaign holds one kind of record: {fix}")
    names = [test.record.file for test in tests]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise CampaignError(f"import: two recordings would be called {twice[0]}; rename one file")
    try:
        joint = compared([test.record for test in tests], [test.loop for test in tests])
    except CampaignError as error:
        raise CampaignError(str(error).replace("delete one [[test]]", "leave one out of the import")) from None
    records = _held_out(joint, held_out)
    return tuple(replace(test, record=record) for test, record in zip(tests, records))


def _named_parts(recordings: Sequence[Recording], recipe: Recipe) -> list[Recording]:
    """Without parts of a file that lack a channel that is named, where another part of the file has it."""
    out = []
    for x in recordings:
        kin = [y for y in recordings if y.file == x.file]
        wanted = [name for role, name in recipe.channels.items() if role != "time" or name.lower() != NO_TIME]
        if all(matching(x, name) or not any(matching(y, name) for y in kin) for name in wanted):
            out.append(x)
    return out


def _held_out(records: Sequence[Record], patterns: Sequence[str]) -> list[Record]:
    out = list(records)
    for pattern in patterns:
        stems = pattern.removesuffix(".csv"), Path(pattern.removesuffix(".csv")).stem
        hits = [k for k, r in enumerate(out) if any(fnmatch(r.file.removesuffix(".csv"), x) for x in stems)]
        if not hits:
            there = [r.file.removesuffix(".csv") for r in out]
            raise CampaignError(f"--held-out {pattern}: no test is called so{nearest(pattern, there)}")
        for k in hits:
            out[k] = replace(out[k], role="held-out")
    if all(r.role == "held-out" for r in out):
        raise CampaignError("--held-out: all tests would be held out; leave some to fit")
    return out


def write_tests(
    tests: Sequence[ImportedTest], out: str | os.PathLike[str], specimen: Mapping[str, str] | None = None
) -> None:
    """Write imported tests as a campaign folder, which must not be one already."""
    folder = Path(out)
    if (folder / "campaign.toml").exists():
        raise CampaignError(f"{folder}: is a campaign already; delete it or name another folder with --out")
    for test in tests:
        if (folder / test.record.file).exists():
            raise CampaignError(f"{folder / test.record.file}: would be written over; name another folder with --out")
    rates = {test.rate_hz for test in tests}
    *_, motion, force = tests[0].columns
    role = motion.partition("_")[0].replace("angle", "displacement")
    channels: dict[str, str | float] = {role: motion, "force": force}
    if not tests[0].record.clock:
        channels["clock"] = "none"
    elif len(rates) == 1 and None not in rates:
        channels["sample_rate_hz"] = float(rates.pop() or 0.0)
    write_folder(
        folder,
        specimen={"name": folder.resolve().name, "description": "", **(specimen or {})},
        channels=channels,
        tests=[(stated(test.record), test.columns) for test in tests],
        compress=False,
    )


def _tests(recording: Recording, recipe: Recipe, split: bool) -> list[ImportedTest]:
    found = assign(recording, recipe)
    if isinstance(found, list):
        raise ImportAsks(recording.where, [*found, *_rate_missing(recording, recipe)])
    if questions := _missing(found, recording, recipe):
        raise ImportAsks(recording.where, questions)
    clock, pairs = found.motion_time, ((found.motion_time, found.motion), (found.force_time, found.force))
    parts = [runs(x.values[: c.values.size]) if x is not None else [slice(None)] for x, c in pairs]
    if clock is not None and unwrapped(clock.values)[1]:
        parts = [[slice(None)], [slice(None)]]
    if len(parts[0]) != len(parts[1]):
        raise CampaignError(
            f"{recording.where}: {len(parts[0])} runs of {found.motion.name!r} and {len(parts[1])} of "
            f"{found.force.name!r}; give each run a file of its own"
        )
    out: list[ImportedTest] = []
    for k, (a, b) in enumerate(zip(*parts), 1):
        piece, part = found, recording
        if len(parts[0]) > 1:
            times = {"motion_time": _cut(found.motion_time, a), "force_time": _cut(found.force_time, b)}
            piece = replace(found, motion=_cut(found.motion, a), force=_cut(found.force, b), **times)
            if found.force_time is found.motion_time:
                piece = replace(piece, force_time=piece.motion_time)
            notes = (*recording.notes, f"its clock starts again: run {k} of {len(parts[0])}")
            part = replace(recording, part=f"{recording.part} run {k}".strip(), notes=notes)
        out += _one_run(part, piece, recipe, split)
    return out


def _cut(channel: Channel | None, part: slice) -> Any:
    return None if channel is None else replace(channel, values=channel.values[part])


def _missing(found: Assigned, recording: Recording, recipe: Recipe) -> list[Question]:
    """What the recording does not say of the channels that are used."""
    out = []
    for channel, role in ((found.motion, found.role), (found.force, "force")):
        if role not in recipe.units and channel.unit == "MN" and found.motion.unit in ("MM", "UM", "IN"):
            text = f"{channel.name!r} states MN among units in capitals: meganewtons or millinewtons?"
            out.append(Question("--unit", role, "mN", text))
        out += unit_asked([channel], role, recipe)
    return out + _rate_missing(recording, recipe, found)


def _rate_missing(recording: Recording, recipe: Recipe, found: Assigned | None = None) -> list[Question]:
    if recipe.sample_rate_hz or recording.rate_hz:
        return []
    several = " or ".join(f"{x:.6g}" for x in recording.rates_hz if x > 0)
    no_rate = replace(_RATE, text=_SEVERAL.format(several)) if " " in several else _RATE
    if found is None:
        known = any(c.rate_hz or role_of(c.unit) == "time" or named(c.name, "time") for c in recording.channels)
        return [] if known else [no_rate]
    for channel, time in ((found.motion, found.motion_time), (found.force, found.force_time)):
        if channel.rate_hz is not None:
            continue
        if time is None:
            return [no_rate]
        steps, unit = np.diff(time.values), recipe.units.get("time", time.unit)
        if (steps >= 0).all() and np.count_nonzero(steps == 0) > FEW_REPEATED * steps.size:
            text = f"The time {time.name!r} repeats: it is rounded too far."
            if unit in _SECONDS:
                text += f" Its first and last row make {steps.size / (time.values[-1] - time.values[0]):.4g} Hz."
            return [replace(_RATE, text=text)]
        if (steps == 1.0).all() and unit in _SECONDS:
            return [Question("--sample-rate", "", "none", _ROWS.format(time.name))]
        step = float(np.median(steps))
        odd = 0 < step < STEPS_S[0] or step >= STEPS_S[1] or re.search(r"[\[({<][^\])}>]*[^\W\d]|\d \w+$", time.name)
        if odd and not unit and not moments_unit(time.values):
            return [Question("--unit", "time", "ms", _UNKNOWN.format(time.name, step))]
    return []


def _one_run(recording: Recording, found: Assigned, recipe: Recipe, split: bool) -> list[ImportedTest]:
    where = recording.where
    said = [f"{where} ({'; '.join(recording.notes)}): {found.motion.values.size} samples"]
    warnings = recording.warnings
    codes: tuple[str, ...] = ()
    series: list[Series] = []
    in_units: list[str] = []
    lines: list[str] = []
    for channel, role, time in (
        (found.motion, found.role, found.motion_time),
        (found.force, "force", found.force_time),
    ):
        raw, found_codes = without_codes(channel.values, channel.name)
        codes += found_codes
        wrong = wrapped_round(raw, channel.name) or (few_a_cycle(raw, channel.name) if channel is found.motion else "")
        if wrong:
            raise CampaignError(f"{where}: {wrong}")
        raw, held = without_repeats(raw, channel.name)
        values, unit, line = scaled(replace(channel, values=raw), role, recipe, where)
        warnings += (*found_codes, *held)
        warnings += said_of_name(channel.name, (x.name for x in recording.channels))
        said.append(line)
        in_units.append(unit)
        if time is found.motion_time and series and (time is not None or _alike(found.motion, found.force)):
            series.append(replace(series[0], name=channel.name, values=values))
            if values.size != series[0].time_s.size:
                raise CampaignError(
                    f"{where}: {found.motion.name!r} has {found.motion.values.size} samples, {channel.name!r} has "
                    f"{values.size}, and nothing says when each was taken; export them with their times"
                )
            continue
        times, rate, more, doubts = times_of(channel, time, recording, recipe)
        lines, warnings = [*lines, *more], (*warnings, *doubts)
        series.append(Series(channel.name, times, values, rate))
    pairs = zip((found.motion, found.force), series)
    missing = [int(np.count_nonzero(np.isnan(c.values) & np.isfinite(x.time_s))) for c, x in pairs]
    time_s, motion_values, force_values, how = paired(series[0], series[1], where)
    said += [*dict.fromkeys(lines), *found.notes]
    if any(missing):
        gaps = f"{max(missing)} sample(s) without a number dropped: "
        said.append(f"{gaps}the gaps are bridged")
        codes = codes or (f"{gaps}was the range passed?",)
    warnings += how
    rate = series[0].rate_hz if series[0].rate_hz == series[1].rate_hz else None
    if rate is not None and abs(float(np.median(np.diff(time_s))) * rate - 1) > 0.01:
        rate = None
    time_s = time_s - time_s[0] if time_s.size and (series[0].rate_hz is None or how) else time_s
    units = Units("mrad" if in_units[0] in ("mrad", "rad/s²") else "mm", in_units[1])
    file = _file_name(recording)
    check_time(file, time_s, rate, NO_FREQUENCY_HZ)  # check_record counts the samples a cycle
    column = MOTION_COLUMNS[units.displacement] if split or found.role == "displacement" else ""
    acceleration = motion_values
    if found.role == "acceleration":
        if not recipe.clock:
            what = f"{found.motion.name!r} is an acceleration, which needs times"
            raise CampaignError(f"{where}: {what}: --sample-rate HZ")
        motion_values = displacement_from_acceleration(file, time_s, acceleration)
    steady = motion_values, 0.0, ()
    level, _, drift = without_drift(time_s, motion_values) if found.role == "displacement" else steady
    drive = None if split else assess_drive(time_s, level)
    staircase = drive is not None and drive.kind == "levels"
    if drift and (split or staircase):  # levels are found by crossings, which a drift moves; else `check` takes it off
        motion_values, warnings = level, (*warnings, *drift)
    record = Record(file, 1.0, 1.0, "fit", {}, time_s, motion_values, force_values, warnings, units, recipe.clock)
    pieces, dropped = split_levels(record) if split or staircase else ((record,), ())
    out: list[ImportedTest] = []
    for piece in pieces:
        try:
            named = _named(piece)  # what is written is as it was recorded: drifts are taken off when it is read
            steps = step_warnings(named.time_s) if recipe.clock else ()
            named = replace(named, warnings=(*named.warnings, *steps))
            checked, loop = check_record(named)
        except CampaignError as error:
            if len(pieces) == 1:
                raise CampaignError(" ".join((f"{error}.", *codes)).rstrip(".")) from None
            dropped = (*dropped, f"dropped: {error}")
            continue
        if (count := crossings_a_period(loop.displacement_mm)) > 1:
            several = (
                f"the displacement crosses its middle {count} times in the period that is taken, 1/{count} of "
                f"{count * loop.frequency_hz:.4g} Hz: as a multisine's does, or a drive's whose amplitude beats; which "
                "is it? A drive that beats gives no loop: steady it"
            )
            checked = replace(checked, warnings=(*checked.warnings, several))
        columns = {
            **({"time_s": named.time_s} if recipe.clock else {}),
            column or ACCELERATION_COLUMNS[units.displacement]: named.displacement_mm if column else acceleration,
            FORCE_COLUMNS[units.force]: named.force_N,
        }
        line = (
            f"found{f' in {checked.file}' if len(pieces) > 1 else ''}: "
            f"{f'{loop.frequency_hz:.4g} Hz, ' if recipe.clock else ''}{loop.amplitude_mm:.4g} {units.displacement}, "
            f"{loop.n_cycles} steady cycles, force RMS {loop.force_N.std():.4g} {units.force}"
        )
        out.append(ImportedTest(checked, columns, rate, loop, (f"    {line}",) if out else (*said, line)))
    if not out:
        raise CampaignError(
            f"{where}: none of {len(pieces)} levels can be used. {dropped[-1].removeprefix('dropped: ')}"
        )
    if drive is not None and staircase:
        text = f"It is {staircase_said(drive, recipe.clock)}, which would look like one specimen that changes: make a "
        raise ImportAsks(where, [Question("--split", "", "", f"{text}test of each.")])
    return [*out[:-1], replace(out[-1], said=(*out[-1].said, *dropped))]


def _alike(a: Channel, b: Channel) -> bool:
    """Whether two channels without time channels are of one rate and start, as far as the file says."""
    start = (a.start_s or 0.0) != (b.start_s or 0.0)  # what is not stated is the recording's own start
    rate = None not in (a.rate_hz, b.rate_hz) and abs((a.rate_hz or 1.0) / (b.rate_hz or 1.0) - 1) > 1e-6
    return not start and not rate


def _named(record: Record) -> Record:
    """The record with the frequency and amplitude that it shows, rounded to what names a test."""
    level, _, _ = without_drift(record.time_s, record.displacement_mm)
    if not record.clock:
        record = replace(record, time_s=cycles_as_time(record.file, level))
    found = average(replace(record, displacement_mm=level), n_blocks=1)
    return replace(
        record,
        frequency_hz=float(f"{found.frequency_hz:.{FREQUENCY_DIGITS}g}") if record.clock else WITHOUT_CLOCK_HZ,
        amplitude_mm=float(f"{found.amplitude_mm:.{AMPLITUDE_DIGITS}g}"),
    )


def _file_name(recording: Recording) -> str:
    name = f"{Path(recording.file.removesuffix('.gz')).stem} {recording.part}".strip()
    return "".join("_" if c in '/\\:*?"<>|' or not c.isprintable() else c for c in name) + ".csv"
