"""Units that free lines above or beside a table state of its columns: "Disp: mm", "Force unit = kN", "Units: mm, N"."""

import re
from collections.abc import Sequence

from bayes_iwan.campaign.importing.names import WORDS, named
from bayes_iwan.campaign.importing.unit_texts import is_unit, is_volts, may_be, split_name

#: what makes a label one of units, and alone one of all columns
UNIT_WORDS = r"(?:v|y|ch\w*)?[ _-]?(?:units?|einheit(?:en)?)|unit[ée]s?|単位|单位"
_UNIT_WORD = re.compile(rf"(?<![^\W_])(?:{UNIT_WORDS})(?:[ _]of)?(?![^\W_])", re.IGNORECASE)
_LONGEST = 40  # letters of a value: more is a sentence


def units_above(names: Sequence[str], lines: Sequence[str]) -> dict[int, str]:
    """The units of columns of these names, by column, where lines state one alone that can be the column's."""
    said: dict[str, list[str]] = {}
    for line in lines:
        label = None
        for piece in re.split(r"[;,\t|]", line):
            own, mark, value = re.sub(r"^\W*", "", piece).partition("=" if "=" in piece else ":")
            label, value = (own, value.strip()) if mark else (label, piece.strip())
            stem, unit = split_name(value) if len(value) < _LONGEST else (value, "")
            if unit and stem != value:  # displacement [mm]
                label, value = stem, unit
            units = value.split() if len(value) < _LONGEST else []
            if not units or not all(re.search(r"\w", x) and is_unit(x) for x in units):
                label = value or label
            elif label is not None:
                said.setdefault(label, []).extend(units)
    found: dict[int, set[str]] = {k: set() for k in range(len(names))}
    for label, units in said.items():
        what = _UNIT_WORD.sub("", label).strip(" _-.()").lower()
        for k, unit in (_listed(names, units) if not what else _labelled(names, what, units)).items():
            found[k].add(unit)
    return {k: some.pop() for k, some in found.items() if len(some) == 1}


def _listed(names: Sequence[str], units: Sequence[str]) -> dict[int, str]:
    """Units of all columns, or without one of times of all others, in order; else where no other can be a column's."""
    timed = any(may_be(u, "time") for u in units)
    for columns in (range(len(names)), [k for k, x in enumerate(names) if timed or not named(x, "time")]):
        if len(columns) == len(units) and all(_may_be(names[k], u) for k, u in zip(columns, units)):
            return dict(zip(columns, units))
    fits = {k: {u for u in units if _may_be(x, u)} for k, x in enumerate(names) if _roles(x)}
    return {k: some.pop() for k, some in fits.items() if len(some) == 1}


def _labelled(names: Sequence[str], what: str, units: Sequence[str]) -> dict[int, str]:
    """The unit of the columns that a label means: by their name or words of it, by its role, or as oscilloscopes do."""
    if len(set(units)) > 1:
        return {}
    words = [set(re.findall(r"[^\W_]+", x.lower())) for x in (what, *names)]
    same = [k for k, x in enumerate(names) if what == x.lower()]
    same = {"vertical": [len(names) - 1], "horizontal": [0]}.get(what, same)
    same = same or [k for k, x in enumerate(words[1:]) if x and (x <= words[0] or words[0] <= x)]
    same = same or [k for k, x in enumerate(names) if _roles(x) & _roles(what)]
    return {k: units[0] for k in same if _may_be(names[k], units[0])}


def _roles(name: str) -> set[str]:
    return {role for role in WORDS if named(name, role)}


def _may_be(name: str, unit: str) -> bool:
    """Whether a unit can be that of a column: of a role that its name says, if it says one."""
    return not (roles := _roles(name)) or is_volts(unit) or any(may_be(unit, role) for role in roles)
