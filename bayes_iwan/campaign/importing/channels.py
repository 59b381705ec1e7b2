"""Which channels of a recording are the motion, the force and their times: as named, or found by unit and name."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.campaign.importing.names import WORDS, named
from bayes_iwan.campaign.importing.questions import Question
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.scaling import SAME_RATE, SINGLE_S
from bayes_iwan.campaign.importing.unit_texts import (
    FULL_SCALE,
    ROLES,
    converted,
    is_ratio,
    is_volts,
    may_be,
    role_of,
    states_two,
)
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.unapplied import NOT_MEASURED
from bayes_iwan.errors import nearest
from bayes_iwan.screen import on_screen

NO_TIME = "none"  # as the name of a time channel: there is none, the rate counts
#: examples of sensitivities, by role
TRANSDUCER = {"force": "9.55 mV/N", "displacement": "2 V/mm", "acceleration": "105 mV/g"}
_WHICH = "Which is the time: {}? If each is of one channel, put it before that channel."
RISING = 0.9  # of the steps of a time channel go up
LATE = 0.5  # of a record by which one of two clocks may be late and still be its channel's own


@dataclass(frozen=True)
@on_screen
class Assigned:
    """The channels of a test. role : "displacement" or "acceleration" of the motion. times : None where there is a rate
    only, else the time channel that stands beside the motion and the one beside the force, which may be one."""

    role: str
    motion: Channel
    force: Channel
    motion_time: Channel | None
    force_time: Channel | None
    notes: tuple[str, ...]


def roles_held(recording: Recording, recipe: Recipe) -> set[str]:
    """Which of motion and force a recording has a channel for."""
    named_as, channels = recipe.channels, list(recording.channels)
    return {
        "force" if role == "force" else "motion"
        for role in ("displacement", "acceleration", "force")
        if (matching(recording, named_as[role]) if role in named_as else _candidates(channels, role, recipe))
    }


def assign(recording: Recording, recipe: Recipe) -> Assigned | list[Question]:
    """The channels of a test, or what must be asked. Raises CampaignError for a name that is not there."""
    wanted = {role: name for role, name in recipe.channels.items() if role != "time"}
    found: dict[str, Channel] = {role: _ask(recording, role, name) for role, name in wanted.items()}
    for role, channel in found.items():
        if other := next((r for r, c in found.items() if c is channel and r != role), None):
            raise CampaignError(f"{recording.where}: {channel.name!r} is named as {role} and as {other}")
    left = [c for c in recording.channels if c not in found.values()]
    notes: list[str] = []
    questions: list[Question] = []

    def which(role: str, text: str) -> Question:
        return Question(f"--{role}", "", "NAME", text, lambda name: _ask(recording, role, name))

    for what, roles in (("force", ("force",)), ("displacement or acceleration", ("displacement", "acceleration"))):
        if set(roles) & set(found):
            continue
        held = {role: some for role in roles if (some := _candidates(left, role, recipe))}
        role, some = next(iter(held.items()), (roles[0], []))
        if len(held) > 1:
            names = ", ".join(repr(c.name) for c in held["acceleration"])
            notes.append(f"the displacement is used, not the acceleration {names}: --acceleration NAME takes that")
        if len(some) == 1:
            found[role] = some[0]
        elif some:
            among = _list(recording, some)
            questions += [which(role, f"Which channel is the {role}: {among}?"), *unit_asked(some, role, recipe)]
        else:
            free = [c for c in left if role_of(c.unit) is None and not named(c.name, "time")]
            among = _list(recording, left, numbers=not any(c.unit for c in free))
            questions.append(which(role, f"No channel is known as {what} among {among}."))
            questions += unit_asked(free, role, recipe)
    times: list[Channel | None] = [None, None]
    motion = found.get("displacement", found.get("acceleration"))
    both = [motion, found.get("force")]
    if "time" in recipe.channels and recipe.channels["time"].lower() != NO_TIME:
        time = _ask(recording, "time", recipe.channels["time"])
        times = [time, time]
    elif "time" not in recipe.channels and recipe.clock:
        used = list(found.values())
        for k, one in enumerate(both):
            here = _times(recording, one, used, recipe) if one else []
            if len(here) > 1:
                questions.append(which("time", _WHICH.format(_list(recording, here))))
            times[k] = here[0] if here else None
    if questions or motion is None or both[1] is None:
        return questions + [q for role, channel in found.items() for q in unit_asked([channel], role, recipe)]
    return Assigned(
        "displacement" if "displacement" in found else "acceleration", motion, both[1], times[0], times[1], tuple(notes)
    )


def unit_asked(some: Sequence[Channel], role: str, recipe: Recipe) -> list[Question]:
    """What must be asked of a role's unit, whichever of some channels it is: nothing where they need not be asked
    alike."""
    if role in recipe.sensitivities:
        return []
    asked: dict[tuple[str, str], str] = {}
    for unit in (recipe.units.get(role, c.unit) for c in some):
        if not unit:
            two = all(states_two(c.name) for c in some)
            asked["--unit", "UNIT"] = (
                f"states {'two units' if two else 'no unit'} ({', '.join(ROLES[role])} or another)."
            )
        elif is_volts(unit) and "/" in unit:
            asked["--unit", "50 N"] = f"is in {unit}, a bridge's ratio: what load is 1 {unit}?"
        elif is_volts(unit):
            asked["--sensitivity", TRANSDUCER[role]] = f"is in {unit}: of what transducer?"
        elif is_ratio(unit) and role != "force":
            what = "say the length that it is of (50 mm for samples in mm/mm, gauge 50 mm)."
            asked["--unit", "50 mm"] = f"is in {unit}, a ratio and no {role}: {what}"
        elif role not in recipe.units and not may_be(unit, role):
            example = f"50 {next(iter(ROLES[role]))}" if unit == FULL_SCALE else "UNIT"
            asked["--unit", example] = f"is in {unit}: what is a sample of 1?"
        else:
            return []
    name = f"{some[0].name!r} ({role})" if len(some) == 1 else f"The {role}"
    checks: dict[str, Callable[[str], object]] = {
        "--unit": lambda unit: converted(np.ones(1), unit, "", role, "--unit"),
        "--sensitivity": lambda of: converted(np.ones(1), "", of, role, "--sensitivity"),
    }
    found = [Question(option, role, x, f"{name} {what}", checks[option]) for (option, x), what in asked.items()]
    return found if len(found) == 1 else []


def is_time(channel: Channel) -> bool:
    """Whether a channel holds times, by its unit or, where it has none, by its name."""
    return role_of(channel.unit) == "time" or (not channel.unit and named(channel.name, "time"))


def _times(recording: Recording, channel: Channel, used: list[Channel], recipe: Recipe) -> list[Channel]:
    """The time channels that may be a channel's own: of its group, before it; several only where they differ. Raises
    CampaignError where all of them run backwards or are in no order."""
    n = channel.values.size
    clocks = [c for c in recording.channels if c not in used and c.values.size == n and is_time(c)]
    some = [c for c in clocks if _rises(c.values)]
    known = channel.rate_hz or not recipe.clock
    if clocks and not some and not known and (role_of(clocks[0].unit) or recipe.rate_hz or not recording.rate_hz):
        raise CampaignError(f"{recording.where}: {_disorder(clocks[0])}")
    some = [c for c in some if c.group == channel.group] or [c for c in some if not c.group] or some
    some = [c for c in some if not (np.diff(c.values) < 0).any()] or some  # not one that starts anew at each cycle
    if len(some) < 2:
        return some
    if len(own := [c for c in some if channel.name.lower() in c.name.lower()]) == 1:
        return own
    place = recording.channels.index
    at, times, others = place(channel), [*map(place, some)], [*map(place, used)]
    before, after = [k for k in times if k < at], [k for k in times if k > at]
    if before and min(times) < min(others) and not max(times) < min(others):
        return [recording.channels[before[-1]]]  # time, channel, time, channel
    if after and max(times) > max(others) and min(others) < min(times) < max(others):
        return [recording.channels[after[0]]]  # channel, time, channel, time
    first = some[0].values - some[0].values[0]
    scale = float(np.nanmax(np.abs(first))) or 1.0
    for c in some[1:]:
        other = c.values - c.values[0]
        size = float(np.nanmax(np.abs(other))) / scale
        if not _as_units_say(size, some[0], c):
            return some
        late = abs(c.values[0] - some[0].values[0] * size) / (scale * size)  # of the record: more is another day's
        if not np.allclose(other, first * size, atol=1e-6 * scale * size, equal_nan=True) or 1e-6 < late < LATE:
            return some
    return some[:1]


def _as_units_say(size: float, first: Channel, other: Channel) -> bool:
    """Whether one clock may count so many times what another counts: by the units that they state, or any without."""
    one, another = (
        converted(np.ones(1), c.unit, "", "time", c.name)[0] if c.unit else tuple(SINGLE_S.values())
        for c in (first, other)
    )
    return any(abs(size * b / a - 1.0) < SAME_RATE for a in one for b in another)


def _disorder(clock: Channel) -> str:
    """What is wrong with times that do not go up, and how to put it right."""
    values = clock.values[np.isfinite(clock.values)]
    steps = np.diff(values)
    k, what, fix = int(np.argmax(steps < 0)), "is in no order", "Export the recording again"
    if not steps.any():
        what = "does not move"
    elif np.mean(steps <= 0) >= RISING:
        what, fix = "runs backwards", "If the rows were written last first, turn their order round"
    return (
        f"the time {clock.name!r} {what}: {values[k]:.12g}, then {values[k + 1]:.12g} at sample {k + 2}. {fix}; if "
        "only this column is wrong, leave it out: --time none --sample-rate HZ"
    )


def _rises(values: np.ndarray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps.size and np.mean(steps >= 0) >= RISING and np.any(steps > 0))


def _candidates(channels: list[Channel], role: str, recipe: Recipe) -> list[Channel]:
    """Channels whose unit is the role's; where none is, those whose name says so and whose unit says nothing else."""
    channels = [c for c in channels if not NOT_MEASURED.search(c.name)]
    by_unit = [c for c in channels if role_of(c.unit) == role and not _other_by_name(c, role)]
    said = role in recipe.units or role in recipe.sensitivities
    by_name = [
        c
        for c in channels
        if named(c.name, role)
        and (may_be(c.unit, role) or not c.unit or is_volts(c.unit) or (said and role_of(c.unit) is None))
    ]
    kinds = [converted(np.zeros(1), c.unit, "", role, c.name)[1] for c in by_unit]
    both = [(c, kind) for c, kind in zip(by_unit, kinds) if c in by_name]
    if len(both) == 1 and kinds.count(both[0][1]) == 1:  # a load among stresses, not a stroke beside an extensometer
        return [both[0][0]]
    return by_unit or by_name


def _other_by_name(channel: Channel, role: str) -> bool:
    """Whether a unit that may be of two roles (g) is the other one's by the channel's name."""
    others = [x for x in WORDS if x != role and may_be(channel.unit, x)]
    return any(named(channel.name, x) for x in others) and not named(channel.name, role)


def matching(recording: Recording, name: str) -> list[Channel]:
    """Channels that a name means: as it stands, as the file heads it, or by its last part (force for run1.force)."""
    ways: tuple[Callable[[Channel], str], ...] = (
        lambda c: c.name, lambda c: c.heading, lambda c: _plain(c.name), lambda c: _plain(c.heading or c.name),
        lambda c: _plain(f"{c.name} {c.unit}"), lambda c: _plain(c.name.rpartition(".")[2]),
    )  # fmt: skip
    for way in ways:
        for wanted in (name, _plain(name)):
            if same := [c for c in recording.channels if way(c) == wanted]:
                return same
    return []


def _plain(name: str) -> str:
    return re.sub(r"[\s\[\](){}<>%#]+", " ", name.casefold()).strip()


def _ask(recording: Recording, role: str, name: str) -> Channel:
    """The channel that a name or number means. Raises CampaignError."""
    same = matching(recording, name)
    if len(same) == 1:
        return same[0]
    if not same and name.isdecimal() and 1 <= int(name) <= len(recording.channels):
        return recording.channels[int(name) - 1]
    if len(same) > 1:
        raise CampaignError(
            f"{recording.where}: {len(same)} channels are called {name!r}; give the number of the {role}: "
            f"{_list(recording, same)}"
        )
    among = f"{_list(recording, list(recording.channels))}{nearest(name, [c.name for c in recording.channels], '')}"
    raise CampaignError(f"{recording.where}: no channel {shown(name)} ({role}) among {among}")


def _list(recording: Recording, some: list[Channel], numbers: bool = False) -> str:
    """Names with units; with their numbers where two are the same, or where asked."""
    texts = [c.name + (f" ({c.unit})" if c.unit else "") for c in some]
    if numbers or len({_plain(c.name) for c in some}) < len(some):
        texts = [f"{recording.channels.index(c) + 1}: {text}" for c, text in zip(some, texts)]
    text = ", ".join(texts) or "none"
    return text if len(text) <= 300 else text[:297] + "..."
