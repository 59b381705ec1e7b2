"""Units and sensitivities as data-acquisition systems write them, read by pint, into the campaign's working units."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.importing.recordings import library
from bayes_iwan.campaign.recording.records import CampaignError

#: role → working unit of a campaign → the same for pint. An angle has no dimension: it is told by its unit's name
ROLES: dict[str, dict[str, str]] = {
    "time": {"s": "second"},
    "displacement": {"mm": "millimeter", "mrad": "milliradian"},
    "acceleration": {"m/s²": "meter/second**2", "rad/s²": "radian/second**2"},
    "force": {"N": "newton", "N·m": "newton*meter", "kPa": "kilopascal"},
}
#: of channels that are not used: so that a row of units is known for one
_OTHER = ("volt", "ampere", "kelvin", "hertz", "coulomb", "meter/second", "ohm")
_ANGLES = ("radian", "degree", "arcminute", "arcsecond", "turn", "revolution")
_WORDS = {
    "°": "deg", "grad": "deg", "degrees": "deg", "degree": "deg", "umdr": "turn",
    "nm": "N*m", "knm": "kN*m", "mnm": "mN*m", "ncm": "N*cm", "nmm": "N*mm",
    "lb": "lbf", "lbs": "lbf", "kp": "kgf", "kips": "kip", "newtons": "N", "sec": "s", "secs": "s", "sek": "s",
    "sekunden": "s", "secondes": "s", '"': "inch", "volts": "V", "m/s/s": "m/s**2", "gee": "g_0", "gn": "g_0",
    "ft-lb": "foot*lbf", "in-lb": "inch*lbf", "lb-in": "inch*lbf", "lb-ft": "foot*lbf", "lbf-in": "inch*lbf",
    "in-lbf": "inch*lbf", "ft-lbf": "foot*lbf", "lbf-ft": "foot*lbf", "°c": "kelvin", "degc": "kelvin",
}  # fmt: skip


@cache
def _registry() -> Any:
    return library("pint", "pint", "units", "reading units").UnitRegistry()


#: a longer text is no unit; pint takes most of a minute to say so of 20,000 letters
_LONGEST = 60
#: the powers that units have; others are not worked out, since 9**9**9**9 would never end
_POWER = re.compile(r"(?<=[A-Za-z])\s*\*\*\s*[+-]?\d(?![\d.eE]|\s*\*\*)")


def _spelt(text: str, role: str) -> str:
    """A unit's text in pint's spelling; g is gravity for an acceleration, in as much as it stands alone."""
    text = text.strip().strip("[]()").strip()
    if text.lower() in _WORDS and text not in ("mN", "nm", "Mnm"):
        text = _WORDS[text.lower()]
    text = text.replace("·", "*").replace("⋅", "*").replace("µ", "u").replace("μ", "u").replace("°", "deg")
    text = re.sub(r"(?<=[A-Za-z])\.(?=[A-Za-z])", "*", text)  # N.m
    text = re.sub(r"(?<![A-Za-z])(lb)(?![A-Za-z])", "lbf", text)
    text = text.replace("^", "**").replace("²", "**2").replace("³", "**3")
    text = re.sub(r"(?<=[A-Za-z])([23])(?![\d.])", r"**\1", text)  # m/s2
    if role == "acceleration":
        text = re.sub(r"(?<![A-Za-z_])[gG](?![A-Za-z_])", "g_0", text)
    return text


def _quantity(text: str, role: str) -> Any:
    """A pint quantity ('9.55 mV/N', 'kN'), or None where the text is none."""
    spelt = _spelt(text, role) if len(text) <= _LONGEST else ""
    if not re.search(r"[A-Za-z]", spelt) or spelt.count("**") != len(_POWER.findall(spelt)):
        return None
    registry = _registry()
    for text in (spelt, spelt.lower()):  # Newton, Millimeter
        try:
            return registry.Quantity(text)
        except Exception:  # pint's parser raises errors of many kinds, Python's own syntax errors among them
            continue
    return None


def _angular(quantity: Any) -> bool:
    return any(word in str(quantity.units) for word in _ANGLES)


def _working(quantity: Any, role: str) -> str | None:
    """The campaign's working unit that a quantity can be turned into for a role, None if it cannot."""
    for name, unit in ROLES[role].items():
        target = _registry().Quantity(1.0, unit)
        if quantity.check(target.dimensionality) and _angular(quantity) == _angular(target):
            return name
    return None


def role_of(unit: str) -> str | None:
    """The role of a channel by its unit alone; None for volts, no unit and anything else."""
    for role in ("time", "displacement", "force", "acceleration"):
        found = _quantity(unit, role)
        if found is not None and _working(found, role):
            return role
    return None


def is_unit(text: str) -> bool:
    """Whether a cell of a table's head can be a unit: of a role, of another usual channel, or a dash for none."""
    if text.strip().strip("[]()").strip() in ("", "-", "--", "1", "%", "none"):
        return True
    if role_of(text):
        return True
    found = _quantity(text, "")
    return found is not None and any(found.check(_registry().Quantity(1.0, other).dimensionality) for other in _OTHER)


def split_name(name: str) -> tuple[str, str]:
    """Name and unit from 'Force [kN]', 'Weg in mm', 'Kraft / N', 'force_N'; the unit is "" where there is none."""
    name = name.strip()
    for pattern in (r"(.+?)\s*[\[(]([^\[\]()]+)[\])]", r"(.+?)\s+in\s+(\S+)", r"(.+?)\s*/\s*(\S+)"):
        found = re.fullmatch(pattern, name)
        if found and re.search(r"[^\W\d_]|[°\"]", found[2]) and is_unit(found[2]):
            return found[1].strip(), found[2].strip()
    parts = name.split("_")
    for k in range(max(1, len(parts) - 3), len(parts)):
        unit = "_".join(parts[k:])
        spelt = {"m_s2": "m/s2", "mm_s2": "mm/s2", "rad_s2": "rad/s2", "deg_s2": "deg/s2"}.get(
            unit, unit.replace("_", "*")
        )
        if role_of(spelt) or spelt in ("V", "mV"):
            return "_".join(parts[:k]), spelt
    return name, ""


def converted(values: Array, unit: str, sensitivity: str, role: str, where: str) -> tuple[Array, str]:
    """Samples in the campaign's working unit, and which that is.

    unit : of the samples. sensitivity : of a transducer whose signal they are ('9.55 mV/N', '104.7 N/V'), or "".
    Raises CampaignError that starts with `where`.
    """
    known = ", ".join(ROLES[role])
    quantity = _quantity(unit, role)
    if unit and quantity is None:
        raise CampaignError(f"{where}: unit {unit!r} is not known; say it with --unit {role}=UNIT ({known} ...)")
    if sensitivity:
        per = _quantity(sensitivity, role)
        if per is None or per.magnitude == 0:
            raise CampaignError(f"{where}: sensitivity {sensitivity!r} is no number with a unit, like '9.55 mV/N'")
        if quantity is not None and _working(quantity, role):
            raise CampaignError(f"{where}: the samples are in {unit} already; leave the sensitivity out")
        raw = _registry().Quantity(1.0, "volt") if quantity is None else quantity
        ways = [way for way in (raw / per, raw * per) if _working(way, role)]
        if not ways:
            raise CampaignError(f"{where}: {unit or 'V'} with a sensitivity of {sensitivity} gives no {role} ({known})")
        quantity = ways[0]
    if quantity is None:
        raise CampaignError(f"{where}: the file states no unit; say it with --unit {role}=UNIT ({known} ...)")
    working = _working(quantity, role)
    if working is None:
        volts = quantity.check(_registry().Quantity(1.0, "volt").dimensionality)
        mend = f"say what it means: --sensitivity '{role}=9.55 mV/N'" if volts else f"it must be one of {known} ..."
        raise CampaignError(f"{where}: unit {unit} is no unit of {role}; {mend}")
    factor = float(quantity.to(ROLES[role][working]).magnitude)
    return values * factor, working
