"""One test from several files or parts of a file, each with one sensor: a channel a file, a TDMS group a sensor."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_iwan.campaign.importing.channels import is_time, roles_held
from bayes_iwan.campaign.importing.names import WORDS, named
from bayes_iwan.campaign.importing.questions import ImportAsks, Question
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.scaling import YEARS_S
from bayes_iwan.campaign.importing.unit_texts import converted
from bayes_iwan.campaign.recording.records import CampaignError

#: words that name a sensor beside what it measures (load cell)
SENSORS = r"cell|sensor|transducer|channel|signal|data|zelle|aufnehmer|kanal|messdose|capteur|sensore"


def joined(recordings: Sequence[Recording], recipe: Recipe, all_in_one: bool) -> list[Recording]:
    """Recordings that lack the motion or the force, put together with those that hold it.

    Parts of one file belong together, and files whose names differ in what they hold alone (f10_disp, f10_load).
    all_in_one : all files are one test, whatever their names. Raises CampaignError where the pieces do not fit.
    """
    recordings = _with_times(recordings)
    pieces = [_by_file(x) for x in recordings]
    held = [roles_held(x, recipe) for x in pieces]
    if all_in_one:
        return [_one(pieces)] if pieces else []
    groups: dict[tuple[str, str], list[int]] = {}
    for k, (x, roles) in enumerate(zip(pieces, held)):
        if len(roles) < 2:
            same_file = sum(y.file == x.file for y in pieces) > 1
            groups.setdefault((x.file, "") if same_file else ("", _stem(x)), []).append(k)
    out: list[Recording] = list(recordings)
    gone: set[int] = set()
    for members in groups.values():
        some = [held[k] for k in members]
        if set().union(*some) == {"motion", "force"} and sum(map(len, some)) == 2:
            out[members[0]] = _one([pieces[k] for k in members])
            gone.update(members[1:])
            for k in members:
                held[k] = {"motion", "force"}
    _ask_to_join(pieces, held)
    return [x for k, x in enumerate(out) if k not in gone]


def _with_times(recordings: Sequence[Recording]) -> list[Recording]:
    """Parts of a file that hold times alone, as a TDMS group does, lend them to the parts that have no clock."""
    times = [x for x in recordings if x.part and all(map(is_time, x.channels))]
    out = []
    for x in (x for x in recordings if x not in times):
        lent = [replace(c, name=f"{y.part} {c.name}", group="") for y in times if y.file == x.file for c in y.channels]
        if x.rate_hz or any(is_time(c) or c.rate_hz for c in x.channels):
            lent = []
        n = x.channels[0].values.size
        out.append(replace(x, channels=(*(c for c in lent if c.values.size == n), *x.channels)))
    return out or list(recordings)


def _ask_to_join(pieces: Sequence[Recording], held: Sequence[set[str]]) -> None:
    """Ask whether recordings that hold the motion alone and the force alone are one test."""
    motions, forces = ([x for x, roles in zip(pieces, held) if roles == {role}] for role in ("motion", "force"))
    if not motions or not forces:
        return
    said = f"{motions[0].where} holds the displacement alone, {forces[0].where} the force alone"
    if len(pieces) == 2:
        raise ImportAsks(motions[0].where, [Question("--join", "", "", f"{said}: are they channels of one test?")])
    raise CampaignError(
        f"{said}: name the files of one test alike (run1_disp, run1_force), or import each test alone with --join"
    )


def _by_file(recording: Recording) -> Recording:
    """A recording whose only channel has no name of its own is named by its file."""
    own = [c for c in recording.channels if not re.fullmatch(r"column \d+|Untitled( \d+)?|channel \d+", c.name)]
    if len(recording.channels) - len(own) != 1 or any(named(c.name, r) for c in own for r in WORDS if r != "time"):
        return recording
    name = recording.part or Path(recording.file).stem
    channels = tuple(c if c in own else replace(c, name=name, heading=name) for c in recording.channels)
    return replace(recording, channels=channels)


def _stem(recording: Recording) -> str:
    """A file's name without the word that says what it holds."""
    stem = Path(recording.file).stem
    for role in ("displacement", "acceleration", "force"):
        stem = re.sub(rf"(?<![^\W_])({WORDS[role]}|{SENSORS})(?![^\W\d_])", "", stem, flags=re.IGNORECASE)
    return re.sub(r"[\W_]+", " ", stem).strip().lower()


def _one(pieces: Sequence[Recording]) -> Recording:
    channels: list[Channel] = []
    begun = [x.began_s for x in pieces if x.began_s is not None]
    for x in pieces:
        label = x.part or Path(x.file).stem
        late = (x.began_s or 0.0) - min(begun) if len(begun) == len(pieces) else 0.0
        for c in x.channels:
            twice = any(c.name == y.name for p in pieces if p is not x for y in p.channels)
            name = f"{label}.{c.name}" if twice else c.name
            rate = c.rate_hz or x.rate_hz
            if late and is_time(c):
                c = replace(c, values=c.values + late / converted(np.ones(1), c.unit or "s", "", "time", x.where)[0][0])
            start = (c.start_s or 0.0) + late if late else c.start_s
            channels.append(replace(c, name=name, group=f"{label}/{c.group}", rate_hz=rate, start_s=start))
    sizes = {c.values.size for c in channels if c.rate_hz is None}
    timed = all(any(named(c.name, "time") or c.rate_hz for c in x.channels) for x in pieces)
    if len(sizes) > 1 and not timed:
        raise CampaignError(
            f"{pieces[0].where}: channels that belong together have {', '.join(map(str, sorted(sizes)))} samples "
            "and no times; export them with a time column"
        )
    first = pieces[0]
    others = ", ".join(x.where if x.file != first.file else repr(x.part) for x in pieces[1:])
    notes = (*first.notes, f"joined with {others}")
    warnings = tuple(dict.fromkeys(w for x in pieces for w in x.warnings))
    shared = len(begun) == len(pieces) or any(is_time(c) and c.values[0] > YEARS_S[0] for c in channels)
    if not shared and len({x.file for x in pieces}) > 1:
        warnings += ("the files do not say when they began: their times are taken for one clock",)
    return Recording(first.file, "", tuple(channels), notes, first.rates_hz, warnings)
