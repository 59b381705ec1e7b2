"""Recordings into a campaign: channels found and scaled, frequency and amplitude read off, everything checked."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.folders.writing import FORCE_COLUMNS, MOTION_COLUMNS, stated, write_folder
from bayes_iwan.campaign.importing.channels import assign
from bayes_iwan.campaign.importing.formats import read_file
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.units import converted
from bayes_iwan.campaign.loops.averaging import Loop, average
from bayes_iwan.campaign.loops.between_tests import compared
from bayes_iwan.campaign.loops.checks import check_epoch, check_record, check_time, on_grid_of_rate, step_warnings
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.campaign.timing.accelerometer import displacement_from_acceleration
from bayes_iwan.campaign.timing.drive import split as split_levels

ACCELERATION_COLUMNS = {"mm": "acceleration_m_s2", "mrad": "acceleration_rad_s2"}
SAME_RATE = 1e-4  # two statements of a sample rate that differ by more contradict each other
NO_FREQUENCY_HZ = 1e-9
#: digits of what campaign.toml states; it names the test, so that 0.9962 and 1.003 mm belong together as 1 mm
FREQUENCY_DIGITS, AMPLITUDE_DIGITS = 4, 2


@dataclass(frozen=True)
class ImportedTest:
    """One test: its record, the columns that are written for it, and how they came about, line by line."""

    record: Record
    columns: Mapping[str, Array]
    rate_hz: float | None
    loop: Loop
    said: tuple[str, ...]

    @property
    def motion(self) -> str:
        """Name of the motion's column."""
        return list(self.columns)[1]

    @property
    def force(self) -> str:
        return list(self.columns)[2]


def import_tests(
    files: Sequence[str | os.PathLike[str]], recipe: Recipe | None = None, split: bool = False
) -> tuple[ImportedTest, ...]:
    """Read files of a data-acquisition system as tests of one campaign.

    split : take a record whose drive goes through levels of amplitude or frequency as one test a level.
    Raises CampaignError, in one line with the file and the mend, for everything that `read_campaign` would refuse.
    """
    recipe = recipe or Recipe()
    tests = [test for path in files for x in read_file(Path(path), recipe.layout) for test in _tests(x, recipe, split)]
    if not tests:
        raise CampaignError("import: no files")
    first = tests[0]
    for test in tests:
        if list(test.columns) != list(first.columns):
            raise CampaignError(
                f"{test.record.file}: has {test.motion} and {test.force}, {first.record.file} has {first.motion} and "
                f"{first.force}; a campaign holds one kind of record"
            )
    names = [test.record.file for test in tests]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise CampaignError(f"import: two recordings would be called {twice[0]}; rename one file")
    records = compared([test.record for test in tests], [test.loop for test in tests])
    return tuple(replace(test, record=record) for test, record in zip(tests, records))


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
    channels: dict[str, str | float] = {
        tests[0].motion.partition("_")[0].replace("angle", "displacement"): tests[0].motion,
        "force": tests[0].force,
    }
    if len(rates) == 1 and None not in rates:
        channels["sample_rate_hz"] = float(rates.pop() or 0.0)
    write_folder(
        folder,
        specimen={"name": folder.resolve().name, "description": "", **(specimen or {})},
        channels=channels,
        tests=[(stated(test.record), test.columns) for test in tests],
        compress=False,
    )


def _tests(recording: Recording, recipe: Recipe, split: bool) -> list[ImportedTest]:
    roles, notes = assign(recording, recipe)
    where = recording.file + (f", {recording.part}" if recording.part else "")
    motion_role = "displacement" if "displacement" in roles else "acceleration"
    motion, force = roles[motion_role], roles["force"]
    if motion.values.size != force.values.size:
        raise CampaignError(
            f"{where}: {motion.name!r} has {motion.values.size} samples, {force.name!r} has {force.values.size}; "
            "record both at one rate"
        )
    said = [f"{where} ({'; '.join(recording.notes)}): {motion.values.size} samples"]
    motion_values, motion_unit, line = _scaled(motion, motion_role, recipe, where)
    force_values, force_unit, force_line = _scaled(force, "force", recipe, where)
    time, rate, time_line = _time(roles, recipe, where)
    said += [line, force_line, time_line, *notes]
    whole = np.isfinite(motion_values) & np.isfinite(force_values) & np.isfinite(time)
    if missing := int(whole.size - whole.sum()):
        time, motion_values, force_values = time[whole], motion_values[whole], force_values[whole]
        said.append(f"{missing} sample(s) without a number left out: the gaps are bridged")
    units = Units("mrad" if motion_unit in ("mrad", "rad/s²") else "mm", force_unit)
    file = _file_name(recording)
    check_time(file, time, rate, NO_FREQUENCY_HZ)  # check_record counts the samples a cycle
    warnings = step_warnings(time)
    column = MOTION_COLUMNS[units.displacement] if split or motion_role == "displacement" else ""
    acceleration = motion_values
    if motion_role == "acceleration":
        motion_values, more = displacement_from_acceleration(file, time, acceleration)
        warnings += more
    record = Record(file, 1.0, 1.0, "fit", {}, time, motion_values, force_values, warnings, units)
    pieces = split_levels(record) if split else (record,)
    out = []
    for piece in pieces:
        named = _named(piece)  # what is written is as it was recorded: drifts are taken off when it is read
        checked, loop = check_record(named)
        columns = {
            "time_s": named.time_s,
            column or ACCELERATION_COLUMNS[units.displacement]: named.displacement_mm if column else acceleration,
            FORCE_COLUMNS[units.force]: named.force_N,
        }
        found = (
            f"found{f' in {checked.file}' if len(pieces) > 1 else ''}: {loop.frequency_hz:.4g} Hz, "
            f"{loop.amplitude_mm:.4g} {units.displacement}, {loop.n_cycles} steady cycles, force RMS "
            f"{loop.force_N.std():.4g} {units.force}"
        )
        out.append(ImportedTest(checked, columns, rate, loop, ((*said, found) if piece is pieces[0] else (found,))))
    return out


def _named(record: Record) -> Record:
    """The record with the frequency and amplitude that it shows, rounded to what names a test."""
    found = average(record, n_phase=64, n_harmonics=8, n_blocks=1)
    return replace(
        record,
        frequency_hz=float(f"{found.frequency_hz:.{FREQUENCY_DIGITS}g}"),
        amplitude_mm=float(f"{found.amplitude_mm:.{AMPLITUDE_DIGITS}g}"),
    )


def _scaled(channel: Channel, role: str, recipe: Recipe, where: str) -> tuple[Array, str, str]:
    """A channel in the campaign's working unit, that unit, and a line that says what was done."""
    stated_unit = recipe.units.get(role, channel.unit)
    sensitivity, gain = recipe.sensitivities.get(role, ""), float(recipe.gains.get(role, 1.0))
    values, unit = converted(channel.values, stated_unit, sensitivity, role, f"{where}: {channel.name!r}")
    values = values / (-gain if role in recipe.reverse else gain)
    how = [stated_unit or "no unit: taken for V"]
    how += [sensitivity] if sensitivity else []
    how += [f"gain {gain:g}"] if gain != 1.0 else []
    how += ["reversed"] if role in recipe.reverse else []
    some = values[np.isfinite(values)]
    if not some.size:
        raise CampaignError(f"{where}: {channel.name!r} holds no number")
    if some.min() == some.max():
        raise CampaignError(f"{where}: {channel.name!r} stays at {some[0]:.4g} {unit}: a dead or wrong channel?")
    return values, unit, f"{role}: {channel.name!r} ({', '.join(how)}), {some.min():.4g} to {some.max():.4g} {unit}"


def _time(roles: Mapping[str, Channel], recipe: Recipe, where: str) -> tuple[Array, float | None, str]:
    """Times from 0 in s, the sample rate if there is one, and a line that says where they come from."""
    channel, n = roles.get("time"), roles["force"].values.size
    rate = recipe.sample_rate_hz
    if channel is None or channel.values.size != n:
        from_file = roles["force"].rate_hz
        if rate is not None and from_file is not None and abs(rate / from_file - 1) > SAME_RATE:
            raise CampaignError(
                f"{where}: the file says {from_file:g} samples a second, you say {rate:g}; which is right?"
            )
        rate = rate or from_file
        if rate is None:
            raise CampaignError(f"{where}: no time channel and no sample rate; say --sample-rate HZ or --time NAME")
        return np.arange(n) / rate, rate, f"time: {rate:.9g} samples a second"
    unit = recipe.units.get("time", channel.unit) or "s"
    time, _ = converted(channel.values, unit, "", "time", f"{where}: {channel.name!r}")
    start = float(time[np.flatnonzero(np.isfinite(time))[:1]].sum())
    check_epoch(where, start, "Say --unit time=ms")
    time = time - start
    if rate is not None:
        time = on_grid_of_rate(time, rate)
    known = time[np.isfinite(time)]
    span = float(np.ptp(known)) if known.size > 1 else 0.0
    per_second = f"{(known.size - 1) / span:.6g} samples a second" if span > 0 else "one time for all samples"
    return time, rate, f"time: {channel.name!r} ({unit}), {per_second}"


def _file_name(recording: Recording) -> str:
    name = recording.file
    for ending in (".gz", *Path(name).suffixes[-1:], Path(name.removesuffix(".gz")).suffix):
        if ending:
            name = name.removesuffix(ending)
    part = re.sub(r"[/\\:*?\"<>|\0]+", "_", recording.part).strip()
    return f"{name} {part}.csv" if part else f"{name}.csv"
