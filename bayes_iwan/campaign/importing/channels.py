"""Which channel of a recording is the time, the motion and the force: as named, or told by unit and name."""

from __future__ import annotations

import difflib
import re

from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.units import role_of
from bayes_iwan.campaign.recording.records import CampaignError, shown

#: words of English, German, French, Italian and Spanish that begin a word in a channel's name
WORDS = {
    "time": r"time|zeit|temps|tempo|tiempo|t|x_value",
    "displacement": r"disp|displ|displacement|weg|position|pos|stroke|hub|lvdt|laser|auslenkung|verschiebung"
    r"|deplacement|déplacement|spostamento|desplazamiento|angle|winkel|drehwinkel|rotation|x|u|extension",
    "acceleration": r"acc|accel|accelerometer|acceleration|accélération|accelerazione|aceleración|beschl|beschleunigung"
    r"|a",
    "force": r"force|kraft|load|last|fz|fx|fy|f|torque|moment|drehmoment|couple|coppia|pressure|druck|pression|fuerza"
    r"|forza|effort",
}


def _named(channel: Channel, role: str) -> bool:
    return bool(re.search(rf"(?<![^\W_])({WORDS[role]})(?![^\W\d_])", channel.name, re.IGNORECASE))


def assign(recording: Recording, recipe: Recipe) -> tuple[dict[str, Channel], tuple[str, ...]]:
    """The channel of each role (time may be missing), and what was guessed. Raises CampaignError."""
    found: dict[str, Channel] = {role: _ask(recording, role, name) for role, name in recipe.channels.items()}
    for role, channel in found.items():
        if other := next((r for r, c in found.items() if c is channel and r != role), None):
            raise CampaignError(f"{_where(recording)}: {channel.name!r} is named as {role} and as {other}")
    notes = []
    left = [c for c in recording.channels if not any(c is used for used in found.values())]
    wanted = ["time", "force"]
    if not {"displacement", "acceleration"} & set(found):
        wanted += ["displacement", "acceleration"]
    candidates = {role: _candidates(left, role, recipe) for role in wanted if role not in found}
    if candidates.get("displacement") and candidates.get("acceleration"):
        names = ", ".join(repr(c.name) for c in candidates.pop("acceleration"))
        notes.append(f"the displacement is used, not the acceleration {names}: --acceleration NAME takes that")
    for role, some in candidates.items():
        if len(some) == 1:
            found[role] = some[0]
        elif len(some) > 1 and role != "time":
            names = ", ".join(repr(c.name) for c in some)
            raise CampaignError(f"{_where(recording)}: which channel is the {role}, {names}? Say it with --{role} NAME")
        elif len(some) > 1:
            found[role] = some[0]
    if "force" not in found:
        raise CampaignError(f"{_where(recording)}: no force among {_list(recording)}; name it with --force NAME")
    if not {"displacement", "acceleration"} & set(found):
        raise CampaignError(
            f"{_where(recording)}: no displacement or acceleration among {_list(recording)}; name it with "
            "--displacement NAME or --acceleration NAME"
        )
    return found, tuple(notes)


def _candidates(channels: list[Channel], role: str, recipe: Recipe) -> list[Channel]:
    """Channels whose unit is the role's; where none is, those whose name says so and whose unit says nothing else."""
    by_unit = [c for c in channels if role_of(c.unit) == role]
    by_name = [c for c in channels if _named(c, role) and role_of(c.unit) in (None, role)]
    if len(by_unit) > 1:
        both = [c for c in by_unit if c in by_name]
        return both if len(both) == 1 else by_unit
    return by_unit or by_name


def _ask(recording: Recording, role: str, name: str) -> Channel:
    names = [c.name for c in recording.channels]
    same = [c for c in recording.channels if c.name == name] or [
        c for c in recording.channels if c.name.casefold() == name.strip().casefold()
    ]
    if len(same) == 1:
        return same[0]
    if not same and name.isdecimal() and 1 <= int(name) <= len(names):
        return recording.channels[int(name) - 1]
    if len(same) > 1:
        raise CampaignError(
            f"{_where(recording)}: {len(same)} channels are called {name!r}; give the number of the {role} (1 to "
            f"{len(names)})"
        )
    near = difflib.get_close_matches(name, names, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise CampaignError(f"{_where(recording)}: no channel {shown(name)} ({role}) among {_list(recording)}{hint}")


def _where(recording: Recording) -> str:
    return recording.file + (f", {recording.part}" if recording.part else "")


def _list(recording: Recording) -> str:
    text = ", ".join(c.name + (f" ({c.unit})" if c.unit else "") for c in recording.channels)
    return text if len(text) <= 300 else text[:297] + "..."
