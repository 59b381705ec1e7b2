"""What a user says of the files: channels, units, sensitivities, signs, layout. From a TOML file, or built in Python.

sample_rate_hz = 1280                    # where the files do not say it; "none" where rows have no clock
reverse = ["force"]                      # roles whose sign is turned round
[channels]                               # time, displacement or acceleration, force
acceleration = "ai0"                     # name in the file, or its number counted from 1
force = "ai1"
[units]                                  # of the samples, where the file says none or a wrong one
force = "V"
[sensitivities]                          # of the transducers whose volts the samples are
acceleration = "105 mV/g"
force = "9.55 mV/N"
[gains]                                  # of amplifiers before the recorder: divided out
force = 10
[text]                                   # of text files, where it is not found by itself
separator = ";"
decimal = ","
encoding = "cp1252"
[specimen]
name = "isolator 7"                      # also description, source, licence
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from bayes_iwan.campaign.folders.folder import SPECIMEN
from bayes_iwan.campaign.importing.formats.text_layout import Layout
from bayes_iwan.campaign.importing.recordings import RATES_HZ
from bayes_iwan.campaign.importing.unit_texts import ROLES
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.stated import only, read_toml

NO_CLOCK = "none"  # in the place of a sample rate


@dataclass(frozen=True)
class Recipe:
    """How recordings become tests; whatever is open is taken from the files or found in them.

    sample_rate_hz : "none" for rows without a clock, as of quasi-static tests.
    channels, units, sensitivities, gains : by role (time, displacement, acceleration, force). reverse : roles.
    specimen : name, description, source, licence.
    """

    channels: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sensitivities: Mapping[str, str] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    reverse: tuple[str, ...] = ()
    sample_rate_hz: float | str | None = None
    layout: Layout = field(default_factory=Layout)
    specimen: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in ("channels", "units", "sensitivities", "gains"):
            only(getattr(self, what), set(ROLES), f"import {what}")
        only(dict.fromkeys(self.reverse), set(ROLES) - {"time"}, "import reverse")
        only(self.specimen, set(SPECIMEN), "import specimen")
        if {"displacement", "acceleration"} <= set(self.channels):
            raise CampaignError("import: name a displacement or an acceleration, not both")
        for role, said in (*self.units.items(), *self.sensitivities.items()):
            if "<" in said:
                raise CampaignError(
                    f'import: "{role}={said}" is an example; write what is right in its place, without < >'
                )
        for role, gain in self.gains.items():
            if not isinstance(gain, int | float) or isinstance(gain, bool) or not abs(gain) > 0:  # type: ignore[redundant-expr]
                raise CampaignError(f"import: the gain of {role} must be a number other than 0, not {shown(gain)}")
        rate = self.sample_rate_hz
        if rate not in (None, NO_CLOCK) and (
            not isinstance(rate, int | float) or isinstance(rate, bool) or not RATES_HZ[0] < rate < RATES_HZ[1]
        ):
            raise CampaignError(
                f"import: the sample rate must be a number between {RATES_HZ[0]:g} and {RATES_HZ[1]:g} Hz or "
                f'"none", not {shown(rate)}'
            )

    @property
    def clock(self) -> bool:
        """Have the rows a clock?"""
        return self.sample_rate_hz != NO_CLOCK

    @property
    def rate_hz(self) -> float | None:
        """The sample rate, where one is stated."""
        return float(self.sample_rate_hz) if isinstance(self.sample_rate_hz, int | float) else None

    def over(self, other: Recipe) -> Recipe:
        """This recipe, with what it leaves open taken from another."""
        merged = {
            what: {**getattr(other, what), **getattr(self, what)}
            for what in ("channels", "units", "sensitivities", "gains", "specimen")
        }
        if {"displacement", "acceleration"} & set(self.channels):  # naming one takes the other back
            merged["channels"] = {
                role: name
                for role, name in merged["channels"].items()
                if role in self.channels or role not in ("displacement", "acceleration")
            }
        said = {f.name: getattr(self.layout, f.name) for f in fields(Layout)}
        return Recipe(
            **merged,
            reverse=tuple(dict.fromkeys(self.reverse + other.reverse)),
            sample_rate_hz=other.sample_rate_hz if self.sample_rate_hz is None else self.sample_rate_hz,
            layout=replace(other.layout, **{k: v for k, v in said.items() if v is not None}),
        )


def read_recipe(path: str | os.PathLike[str]) -> Recipe:
    """A recipe from a TOML file (see this module's text). Raises CampaignError."""
    path = Path(path)
    stated = read_toml(path, "a recipe is a TOML file; see bayes_iwan/campaign/importing/recipe.py")
    only(stated, {f.name for f in fields(Recipe)} - {"layout"} | {"text"}, str(path))
    tables = {}
    for key in ("channels", "units", "sensitivities", "gains", "text", "specimen"):
        table = stated.get(key, {})
        if not isinstance(table, dict):
            raise CampaignError(f"{path}: {key} must be a table [{key}], not {shown(table)}")
        for name, value in table.items():
            if key != "gains" and not isinstance(value, str):
                if key == "channels" and isinstance(value, int) and not isinstance(value, bool):
                    table[name] = str(value)
                    continue
                raise CampaignError(f"{path}: {name} in [{key}] must be text in quotes, not {shown(value)}")
        tables[key] = table
    text: dict[str, Any] = tables.pop("text")
    only(text, {f.name for f in fields(Layout)}, f"{path} [text]")
    reverse = stated.get("reverse", [])
    if not isinstance(reverse, list) or not all(isinstance(x, str) for x in reverse):
        raise CampaignError(f'{path}: reverse must be a list of roles, like ["force"], not {shown(reverse)}')
    return Recipe(**tables, reverse=tuple(reverse), sample_rate_hz=stated.get("sample_rate_hz"), layout=Layout(**text))
