"""One test from several files or parts of a file, each with one sensor: a channel a file, a TDMS group a sensor."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_iwan.campaign.importing.channels import is_time, roles_held
from bayes_iwan.campaign.importing.names import WORDS, named
from bayes_iwan.campaign.importing.questions import Question
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.scaling import YEARS_S
from bayes_iwan.campaign.importing.unit_texts import converted
from bayes_iwan.campaign.recording.records import CampaignError
from bayes_iwan.errors import few

#: words that name a sensor beside what it measures (load cell)
SENSORS = r"cell|sensor|transducer|channel|signal|data|zelle|aufnehmer|kanal|messdose|capteur|sensore"


def joined(recordings: Sequence[Recording], recipe: Recipe, all_in_one: bool) -> tuple[list[Recording], list[Question]]:
    """Recordings that lack the motion or the force, put together with those that hold it, and what is asked of that.

    Parts of one file belong together, and files whose names differ in what they hold alone (f10_disp, f10_load; laser
    1, laser 2, cell 1, cell 2). What is left over is put together as if the question were answered.
    all_in_one : all files are one test, whatever their names. Raises CampaignError where the pieces do not fit.
    """
    recordings = _with_times(recordings)
    pieces = [_by_file(x) for x in recordings]
    if all_in_one or not pieces:
        return [_one(pieces)] if pieces else [], []
    held = [roles_held(x, recipe) for x in pieces]
    left = [k for k, roles in enumerate(held) if len(roles) < 2]
    out: dict[int, Recording] = dict(enumerate(recordings))
    for keys in (_stems(pieces), _without_common(pieces, held)):
        groups: dict[tuple[str, str], list[int]] = {}
        for k in left:
            groups.setdefault((pieces[k].file if pieces[k].part else "", keys[k]), []).append(k)
        for (file, _), members in groups.items():
            some = [held[k] for k in members]
            whole = sum("motion" in x for x in some) == sum("force" in x for x in some) == 1
            parts = file and len(some) > 1 and all(_alone(pieces[k]) for k in members)
            if whole or (parts and _one_test(some)):
                out[members[0]] = _one([pieces[k] for k in members])
                out = {k: x for k, x in out.items() if k not in members[1:]}
                left = [k for k in left if k not in members]
    odd = [k for k in left if _alone(pieces[k]) or {"motion", "force"} - held[k] in [held[j] for j in left]]
    if not odd:
        return list(out.values()), []
    if len(left) == len(pieces) > 1 and _one_test(held):
        said = (
            f"None of {few(x.where for x in pieces)} holds both displacement and force: are they channels of one test?"
        )
        return [_one(pieces)], [Question("--join", "", "", f"{said} If of several, import each test alone.")]
    what = " and ".join(x for x, role in (("displacement", "motion"), ("force", "force")) if role not in held[odd[0]])
    raise CampaignError(
        f"{pieces[odd[0]].where} lacks the {what}, and no other goes with it: add the file that holds it, or leave "
        "this one out. Name the files of one test alike (run1_disp, run1_force), or import each test alone with --join"
    )


def _signals(recording: Recording) -> list[Channel]:
    return [c for c in recording.channels if not is_time(c)]


def _alone(recording: Recording) -> bool:
    return len(_signals(recording)) < 2


def _one_test(held: Sequence[set[str]]) -> bool:
    """Whether pieces may be one test: not where several hold the motion and several the force."""
    return min(sum(role in x for x in held) for role in ("motion", "force")) <= 1


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


def _by_file(recording: Recording) -> Recording:
    """A recording whose only channel does not say what it is has its file's or part's name before it."""
    label, c = recording.part or Path(recording.file).stem, _signals(recording)[:1]
    if not _alone(recording) or not c or c[0].name.startswith(label) or any(named(c[0].name, x) for x in WORDS):
        return recording
    bare = re.fullmatch(r"column \d+|Untitled( \d+)?|channel \d+", c[0].name)
    new = replace(c[0], name=label if bare else f"{label}.{c[0].name}", heading="")
    return replace(recording, channels=tuple(new if x is c[0] else x for x in recording.channels))


def _stems(pieces: Sequence[Recording]) -> list[str]:
    """The names of files without the words that say what these hold; parts of a file are not parted."""
    words = "|".join([*(WORDS[role] for role in ("displacement", "acceleration", "force")), SENSORS])
    names = ["" if x.part else Path(x.file).stem for x in pieces]
    names = [re.sub(rf"(?<![^\W_])({words})(?![^\W\d_])", "", x, flags=re.IGNORECASE) for x in names]
    return [re.sub(r"[\W_]+", " ", x).strip().lower() for x in names]


def _without_common(pieces: Sequence[Recording], held: Sequence[set[str]]) -> list[str]:
    """The names of files or parts without what those that hold the same have in common, which says what they hold."""
    words = [re.findall(r"\d+|[^\W\d_]+", (x.part or Path(x.file).stem).lower()) for x in pieces]
    alike = [[w for w, other in zip(words, held) if other == roles] for roles in held]
    return [" ".join(x for x in w if len(a) < 2 or not all(x in y for y in a)) for w, a in zip(words, alike)]


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
