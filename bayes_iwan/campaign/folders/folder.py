"""The campaign folder: reading and checking `campaign.toml` and its records."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.folders.contents import folders_said
from bayes_iwan.campaign.loops.averaging import FEWEST_PER_CYCLE, Loop, average
from bayes_iwan.campaign.loops.between_tests import compared
from bayes_iwan.campaign.loops.checks import check_record, check_time, on_grid_of_rate, step_warnings
from bayes_iwan.campaign.loops.resolution import POINTS, points_for
from bayes_iwan.campaign.recording.limits import RigLimits, limits_of
from bayes_iwan.campaign.recording.records import ROLES, CampaignError, Record, shown
from bayes_iwan.campaign.recording.stated import number_of, only, positive, read_toml
from bayes_iwan.campaign.recording.table import column, ending, header_has, read_table, times_in, working_unit
from bayes_iwan.campaign.recording.unapplied import said_of_name
from bayes_iwan.campaign.recording.units import ACCELERATIONS, DISPLACEMENTS, FORCES, TIMES, Units
from bayes_iwan.campaign.timing.accelerometer import displacement_from_acceleration
from bayes_iwan.campaign.timing.cycles import cut_cycles
from bayes_iwan.errors import nearest
from bayes_iwan.screen import Listed, on_screen, screen
from bayes_iwan.threads import alongside

FORMAT = 1
SPECIMEN = ("name", "description", "source", "licence")
CHANNELS = {"time", "displacement", "acceleration", "force", "sample_rate_hz", "clock"}
#: numbers that a user may expect to be applied to a record; none is, so they are not taken for a property of the test
NOT_APPLIED = re.compile(r"(gain|scale|factor|offset|sign|sensitivity|delay|calibration)($|_)", re.IGNORECASE)
WITHOUT_CLOCK_HZ = 1.0  # frequency of every test of a campaign without a clock: the cycle is the unit of time
TYPO = 0.88  # likeness from which a key of a test is taken for a known one misspelt


@dataclass(frozen=True)
@on_screen
class Campaign:
    """All tests of one specimen, as `campaign.toml` lists them; made by :func:`read_campaign`.

    Parameters
    ----------
    name, description, source, licence
        text of [specimen].
    path
        the folder.
    tests
        the records, in the order of the file.
    from_acceleration
        whether the displacement was integrated from an accelerometer's channel.
    limits
        what the rig can do, as [rig] states it.

    Raises
    ------
    CampaignError
        from :meth:`loops`.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> campaign = bi.read_campaign(folder)
    >>> campaign.units.force, [loop.force_N.shape for loop in campaign.loops(n_phase=64, n_harmonics=20)]
    ('N', [(64,), (64,)])
    """

    name: str
    description: str
    source: str
    licence: str
    path: Path
    tests: tuple[Record, ...]
    from_acceleration: bool = False
    limits: RigLimits = field(default_factory=RigLimits)

    def __repr__(self) -> str:
        said = f": {self.description}" if self.description else ""
        head = f"campaign {self.name} (folder {self.path.name or self.path}), {len(self.tests)} tests{said}"
        return screen((head,), [f"  {test!r}" for test in self.tests], where=".tests")

    @property
    def units(self) -> Units:
        """What displacement and force are: mm and N, or the units of an angle and a torque, a stroke and a pressure."""
        return self.tests[0].units

    @property
    def clock(self) -> bool:
        """Whether the records have real times; without, nothing that needs them can be said."""
        return self.tests[0].clock

    def loops(self, n_phase: int | None = None, n_harmonics: int = 50, n_blocks: int = 6) -> tuple[Loop, ...]:
        """Each test's phase-averaged loop, in the order of `tests`.

        Parameters
        ----------
        n_phase
            points of a loop (default: 128, and up to 512 where a test reverses more than twice a cycle or has corners).
        n_harmonics
            harmonics that are kept, at most n_phase/2 − 1.
        n_blocks
            blocks of consecutive cycles, for what changes along the record.

        Returns
        -------
        tuple of Loop
            one a test.

        Raises
        ------
        CampaignError
            a record without enough whole cycles at its frequency; the message names file and fix.
        """

        def averaged(points: int) -> tuple[Loop, ...]:
            return Listed(alongside(lambda test: average(test, points, n_harmonics, n_blocks), self.tests))

        if n_phase is not None:
            return averaged(n_phase)
        loops = averaged(POINTS)
        points = points_for([x.displacement_mm for x in loops], [x.velocity_m_s for x in loops])
        return loops if points == POINTS else averaged(points)


def folder_of(campaign: Campaign | str | os.PathLike[str] | object | None) -> Path | None:
    """The folder that data came from; None where they came from none."""
    if isinstance(campaign, Campaign):
        return campaign.path
    return Path(campaign) if isinstance(campaign, str | os.PathLike) else None


def read_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Read and check a campaign folder.

    Parameters
    ----------
    path
        the folder, or its campaign.toml.

    Returns
    -------
    Campaign
        its records in s, mm and N (or what `units` says).

    Raises
    ------
    CampaignError
        one line with the file, the line where there is one, and the fix.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=1).write(folder)
    >>> [(test.frequency_hz, test.amplitude_mm) for test in bi.read_campaign(folder).tests]
    [(10.0, 0.4), (10.0, 0.9)]
    """
    return read_checked(path)[0]


def read_checked(path: str | os.PathLike[str]) -> tuple[Campaign, tuple[Loop, ...]]:
    """The same, and the averaged loops (of one block) that were checked, for those who look at them next."""
    folder = Path(path)
    if folder.name == "campaign.toml":
        folder = folder.parent
    if not (folder / "campaign.toml").exists() and (said := folders_said(folder)):
        raise CampaignError(said)
    stated = read_toml(folder / "campaign.toml", "a campaign is a folder with a file campaign.toml in it")
    only(stated, {"format", "specimen", "channels", "rig", "test"}, "campaign.toml")
    if stated.get("format") != FORMAT or isinstance(stated["format"], bool):
        raise CampaignError(
            f"campaign.toml: format is {shown(stated.get('format'))}; this version reads format = {FORMAT}"
        )
    specimen = _table(stated, "specimen")
    only(specimen, set(SPECIMEN), "campaign.toml [specimen]")
    for key, value in specimen.items():
        if not isinstance(value, str):
            raise CampaignError(f"campaign.toml [specimen]: {key} must be text in quotes, not {shown(value)}")
    if not specimen.get("name"):
        raise CampaignError('campaign.toml [specimen]: name is missing; write name = "..."')
    channels = _channels(_table(stated, "channels"))
    entries = stated.get("test")
    if not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
        raise CampaignError("campaign.toml: no tests; add a [[test]] table for each record")
    units = Units(
        working_unit(channels.motion, channels.motion_units) or "mm", working_unit(channels.force, FORCES) or "N"
    )
    limits = limits_of(_table(stated, "rig"), units) if "rig" in stated else RigLimits()
    tests = [_test(entry, k, units, channels.clock) for k, entry in enumerate(entries, 1)]
    seen: set[str] = set()
    for test in tests:
        if test.file in seen:
            raise CampaignError(f"campaign.toml: {test.file} is listed twice; each record is one [[test]]")
        seen.add(test.file)
    try:
        recorded = [_record(folder, test, channels, units) for test in tests]
        checked = [check_record(record) for record in recorded]
        loops = [loop for _, loop in checked]
        records = compared([record for record, _ in checked], loops, recorded)
    except CampaignError as error:
        raise CampaignError(units.text(str(error))) from None
    records = tuple(replace(record, warnings=units.everywhere(record.warnings)) for record in records)
    campaign = Campaign(
        **{key: specimen.get(key, "") for key in SPECIMEN},
        path=folder,
        tests=records,
        from_acceleration=channels.motion_units is ACCELERATIONS,
        limits=limits,
    )
    same = [loop.record.force_N is record.force_N for loop, record in zip(loops, records)]
    pairs = [replace(x, record=r) if kept else average(r, n_blocks=1) for x, r, kept in zip(loops, records, same)]
    return campaign, tuple(pairs)


def _table(stated: Mapping[str, Any], name: str) -> dict[str, Any]:
    if not isinstance(stated.get(name), dict):
        raise CampaignError(f"campaign.toml: the table [{name}] is missing")
    return dict(stated[name])


@dataclass(frozen=True)
class _Channels:
    """Columns by what they hold, as [channels] states them; motion_units : DISPLACEMENTS or ACCELERATIONS."""

    force: str
    motion: str
    motion_units: Mapping[str, Mapping[str, float]]
    time: str | None
    sample_rate_hz: float | None
    clock: bool


@dataclass(frozen=True)
class _Test:
    """What a [[test]] states, checked."""

    file: str
    frequency_hz: float
    amplitude_mm: float
    role: str
    extras: dict[str, float]


def _channels(stated: dict[str, Any]) -> _Channels:
    where = "campaign.toml [channels]"
    only(stated, CHANNELS, where)
    if stated.get("clock", "none") != "none":
        raise CampaignError(
            f'{where}: clock = {shown(stated["clock"])}; write clock = "none" where rows have no time, or leave it out'
        )
    for key in CHANNELS - {"sample_rate_hz", "clock"}:
        if key in stated and (not isinstance(stated[key], str) or not stated[key]):
            raise CampaignError(f"{where}: {key} must name a column, not {shown(stated[key])}")
    if ("displacement" in stated) == ("acceleration" in stated):
        raise CampaignError(f"{where}: name one column as displacement or one as acceleration, not both or none")
    if "force" not in stated:
        raise CampaignError(f'{where}: force is missing; write force = "force_N"')
    rate, clock = stated.get("sample_rate_hz"), "clock" not in stated
    if not clock and ("acceleration" in stated or rate is not None):
        raise CampaignError(
            f'{where}: clock = "none" goes with neither an acceleration nor sample_rate_hz, which need real times; '
            "delete one of them"
        )
    rate = None if rate is None else positive(rate, f"{where}: sample_rate_hz")
    role, units = ("displacement", DISPLACEMENTS) if "displacement" in stated else ("acceleration", ACCELERATIONS)
    return _Channels(stated["force"], stated[role], units, stated.get("time"), rate, clock)


def _test(entry: dict[str, Any], number: int, units: Units, clock: bool) -> _Test:
    file = entry.get("file")
    if not isinstance(file, str) or not file:
        raise CampaignError(f'campaign.toml: [[test]] number {number} has no file; write file = "..."')
    if not file.isprintable():
        raise CampaignError(f"campaign.toml: the file {shown(file)} of [[test]] number {number} is no name of a file")
    where = f"campaign.toml: test {file}"
    if Path(file).is_absolute() or ".." in Path(file).parts:
        raise CampaignError(f"{where}: the record must lie inside the campaign folder")
    sizes = {f"amplitude_{unit}": size for unit, size in DISPLACEMENTS[units.displacement].items()}
    amplitude = next((key for key in sizes if key in entry), f"amplitude_{units.displacement}")
    known = {"file", "role", "frequency_hz", amplitude}
    for key in ("frequency_hz", amplitude) if clock else (amplitude,):
        if key not in entry:
            said = nearest(key, set(entry) - known, "")
            raise CampaignError(f"{where}: {key} is missing{said and said.removesuffix('?') + f' to be {key}?'}")
        positive(entry[key], f"{where}: {key}")
    if not isinstance(entry.get("role", "fit"), str) or entry.get("role", "fit") not in ROLES:
        raise CampaignError(f"{where}: role {shown(entry['role'])} is not known{nearest(entry['role'], ROLES)}")
    extras = {}
    for key in entry.keys() - known:
        if key in sizes:
            raise CampaignError(f"{where}: {key} stands beside {amplitude}; keep one of them")
        _not_meant(key, where, known)
        extras[key] = number_of(entry[key], f"{where}: {shown(key) if not key.isprintable() else key}")
    return _Test(
        file,
        float(entry["frequency_hz"]) if clock else WITHOUT_CLOCK_HZ,
        float(entry[amplitude]) * sizes[amplitude],
        entry.get("role", "fit"),
        {key: extras[key] for key in entry if key in extras},
    )


def _not_meant(key: str, where: str, known: set[str]) -> None:
    """Refuse a key that would be kept as a property of the test although something else was meant by it."""
    if meant := nearest(key.lower(), known, "", TYPO):
        raise CampaignError(f"{where}: unknown key {shown(key)}{meant}")
    if NOT_APPLIED.match(key):
        raise CampaignError(
            f"{where}: {shown(key)} would not be applied to the record; scale or shift the column itself and delete "
            "the key"
        )


def _record(folder: Path, test: _Test, channels: _Channels, units: Units) -> Record:
    file = test.file
    if not (folder / file).resolve().is_relative_to(folder.resolve()):
        raise CampaignError(
            f"campaign.toml: test {file}: the record must lie inside the campaign folder, not behind a link"
        )
    names, table, warnings = read_table(folder / file, file)
    rate = channels.sample_rate_hz
    time_name = channels.time or "time_s"
    motion = column(names, table, channels.motion, channels.motion_units, file)
    if not channels.clock:
        time = cycles_as_time(file, motion)
    elif time_name in names:
        time = column(names, table, time_name, {"s": TIMES}, file)
    elif channels.time is None and rate is not None:
        time = np.arange(len(table)) / rate
    else:
        there = times_in(names)
        fix = f'Write time = "{there[0]}" in [channels]' if there else "Add it, or state sample_rate_hz in [channels]"
        raise CampaignError(f"{file}: no column {shown(time_name)}; {header_has(names)}. {fix}")
    if rate is not None:
        time = on_grid_of_rate(time, rate)
    force = column(names, table, channels.force, FORCES, file)
    if channels.clock:
        check_time(file, time, rate, test.frequency_hz)
    if channels.motion_units is ACCELERATIONS:
        motion = displacement_from_acceleration(file, time, motion)
    for name, units_of in ((channels.motion, channels.motion_units), (channels.force, FORCES)):
        warnings += said_of_name(name.removesuffix(f"_{ending(name, units_of)}"), names)
    warnings += step_warnings(time) if channels.clock else ()
    stated = test.file, test.frequency_hz, test.amplitude_mm, test.role, test.extras
    return Record(*stated, time, motion, force, warnings, units, channels.clock)


def cycles_as_time(file: str, displacement: Array) -> Array:
    """Row numbers over the rows of a cycle: without a clock the cycle is the unit of time."""
    rows = np.arange(len(displacement), dtype=float)
    if len(rows) < 2 * FEWEST_PER_CYCLE:
        raise CampaignError(f"{file}: {len(rows)} samples; at least two whole cycles are needed")
    return rows * (cut_cycles(file, rows, displacement).frequency_hz / WITHOUT_CLOCK_HZ)
