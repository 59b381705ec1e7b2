"""Units and sensitivities as data-acquisition systems write them, read by pint, into the campaign's working units."""

import re
import unicodedata
from functools import cache, lru_cache
from typing import Any

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.importing.names import WORDS, named
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.errors import nearest

#: role → working unit of a campaign → the same for pint. An angle has no dimension: it is known by its unit's name
ROLES: dict[str, dict[str, str]] = {
    "time": {"s": "second"},
    "displacement": {"mm": "millimeter", "mrad": "milliradian"},
    "acceleration": {"m/s²": "meter/second**2", "rad/s²": "radian/second**2"},
    "force": {"N": "newton", "N·m": "newton*meter", "kPa": "kilopascal"},
}
#: of samples whose largest possible value is 1: what it stands for is asked for with its number
FULL_SCALE = "full scale"
#: of channels that are not used: so that a row of units is known for one
_OTHER = ("volt", "ampere", "kelvin", "hertz", "coulomb", "meter/second", "ohm", "count")
#: of the thousand units of pint those that recorders write, by its names: others are words and letters in a heading
_UNITS = frozenset(
    "meter inch foot thou micron degree radian arcminute arcsecond turn second minute hour day newton "
    "force_pound kip force_kilogram force_gram force_metric_ton force_ounce pascal bar pound_force_per_square_inch "
    "torr meter_Hg kip_per_square_inch standard_atmosphere standard_gravity galileo volt ampere kelvin hertz ohm "
    "coulomb joule watt gram count".split()
)
_WHOLE = {"minute", "hour", "day"}  # without a prefix: HH is no hundred hours
_PREFIXES = {"", "pico", "nano", "micro", "milli", "centi", "deca", "hecto", "kilo", "mega", "giga"}
_ANGLES = ("radian", "degree", "arcminute", "arcsecond", "turn", "revolution")
#: what pint does not know, as it stands or in lower case
_WORDS = {
    "Nm": "N*m", "NM": "N*m", "mNm": "mN*m", "MNm": "MN*m", "MPA": "MPa", "Mpa": "MPa", "MV": "mV", "Mm": "mm",
    "Ms": "ms", "Min": "min", "kn": "kN", "dan": "daN", "pa": "Pa", "kpa": "kPa", "hz": "Hz", "knm": "kN*m",
    "ncm": "N*cm", "nmm": "N*mm", "lb": "lbf", "lbs": "lbf", "pounds": "lbf", "oz": "ozf", "in": "inch", "kg": "kgf",
    "kgs": "kgf", "kp": "kgf", "mp": "tf", "tonf": "tf", "kg-f": "kgf", "kg.f": "kgf", "lb-f": "lbf", "gn": "g_0",
    "gee": "g_0", "gees": "g_0", "g's": "g_0", "grad": "deg", "umdr": "turn", "rev": "turn", "cycle": "count",
    '"': "inch", "cycles": "count", "mil": "thou", "mils": "thou", "mikrometer": "um", "sek": "s", "sekunden": "s",
    "secondes": "s", "millisekunden": "ms", "millis": "ms", "micros": "us", "minuten": "min", "stunden": "hour",
    "std": "hour", "°c": "kelvin", "degc": "kelvin", "мм": "mm", "см": "cm", "м": "m", "мкм": "um",
    "н": "N", "кн": "kN", "дан": "daN", "кгс": "kgf", "тс": "tf",
    "с": "s", "сек": "s", "мс": "ms", "мкс": "us", "мин": "min", "в": "V", "мв": "mV", "град": "deg", "м/с2": "m/s**2",
    "毫米": "mm", "微米": "um", "秒": "s", "毫秒": "ms", "牛": "N", "千牛": "kN",
}  # fmt: skip
_RATIOS = {"%", "ue", "µe", "µε", "με", "microstrain", "ustrain", "strain", "-/-"}
#: units that stand without brackets ("Force N", force_N): others are more often words and letters there
_BARE = frozenset(
    "mm um µm μm nm cm m in inch inches ft thou deg degrees rad mrad N kN mN daN newton newtons lbf kip kgf Nm kNm mNm "
    "Pa kPa MPa bar mbar psi s ms us µs ns sec seconds min g mg m/s2 m/s² m/s^2 mm/s2 rad/s2 deg/s2 V mV".split()
)
_FACTOR = re.compile(r"(?:\d/\d+|\d[.,]\d+|\bin \d+)\s*$")  # before a unit: 1/10 s, 0.01 mm
_WIDE = str.maketrans("（）［］／，：", "()[]/,:")  # signs as wide as a Chinese character
_LETTERS = re.compile(r"[^\W\d_]|[°\"]")
_THOUSANDS = re.compile(r"[1-9]\d{0,2}(,\d{3})+")


def decimal_point(text: str) -> str:
    """A text with its numbers' decimal comma as a point ('9,55 mV/N'). Raises CampaignError where a comma may as well
    divide thousands ('1,000')."""

    def point(found: re.Match[str]) -> str:
        number = found[0]
        if "," not in number:
            return number
        if number.count(",") > 1 or "." in number or _THOUSANDS.fullmatch(number):
            raise CampaignError(f'{shown(text)}: is the comma in "{number}" a decimal mark? Write it with a point')
        return number.replace(",", ".")

    return re.sub(r"\d+(?:[.,]\d+)*", point, text)


@cache
def _registry() -> Any:
    import pint  # a second of work, wanted by imports alone

    return pint.UnitRegistry()


_BRACKETS = str.maketrans("[]{}<>", "()()()")
_ENCLOSED = re.compile(r"\(((?:[^()]|\([^()]*\))*)\)")
#: m/s², m·s⁻², and ms⁻², which is no millisecond; one unit, whatever is divided by it: 10.2 mV/m/s² and 10.2 mV/ms⁻²
_PER_SECOND_SQUARED = re.compile(
    r"(?<![A-Za-z])([A-Za-z]+?)\s*(?:/\s*s(?:\s*\*\*\s*2|\s*/\s*s)|[*\s]?\s*s\s*\*\*\s*-2)(?![\w.*])"
)
#: a longer text is no unit; pint takes most of a minute to say so of 20,000 letters
_LONGEST = 60
#: the powers that units have; others are not worked out, since 9**9**9**9 would never end
_POWER = re.compile(r"(?<=[A-Za-z])\s*\*\*\s*[+-]?\d(?![\d.eE]|\s*\*\*)")


def _spelt(text: str, role: str) -> str:
    """A unit's text in pint's spelling; g is gravity for an acceleration, in as much as it stands alone."""
    text = re.sub("[⁻¹²³]+", r"^\g<0>", text.replace("º", "°"))
    text = unicodedata.normalize("NFKC", text).translate(_BRACKETS).replace(" per ", "/").strip()
    while whole := _ENCLOSED.fullmatch(text):
        text = whole[1].strip()
    text = text.replace("·", "*").replace("⋅", "*").replace("−", "-").removesuffix(".")
    if text.lower() not in _WORDS:  # N.m, in-lb
        text = re.sub(r"(?<=[^\W\d_])[.-](?=[^\W\d_])", "*", text)
    text = "*".join(_WORDS.get(x) or _WORDS.get(x.lower(), x) for x in text.split("*"))
    text = text.replace("μ", "u").replace("°", "deg")
    text = re.sub(r"(?<![A-Za-z])(lb)(?![A-Za-z])", "lbf", text)
    text = re.sub(r"(?<=[A-Za-z])(?<!\d[eE])(-?[23]|-1)(?![\d.])", r"**\1", text.replace("^", "**"))  # m/s2, m s-2
    if role == "acceleration":
        text = re.sub(r"(?<![A-Za-z_])(m?)[gG](?![A-Za-z_])", r"\1g_0", text)
        text = _PER_SECOND_SQUARED.sub(r"(\1/s**2)", text)
    elif role == "force":
        text = {"g": "gf", "nm": "N*m"}.get(text, text)
    return text


def _quantity(text: str, role: str) -> Any:
    """A pint quantity ('9.55 mV/N', 'kN'), or None where the text is none."""
    spelt = _spelt(text, role) if len(text) <= _LONGEST else ""
    # pint passes over signs that it does not know, and would take ?m, which was µm, for m
    if not re.search(r"[A-Za-z]", spelt) or re.search(r"[^\w\s.*/+()%-]", spelt):
        return None
    if spelt.count("**") != len(_POWER.findall(spelt)):
        return None
    registry = _registry()
    for text in (spelt, spelt.lower()):  # Newton, Millimeter
        try:
            found = registry.Quantity(text)
        except Exception:  # pint's parser raises errors of many kinds, Python's own syntax errors among them
            continue
        parts = [
            {
                p + u
                for p, u, _ in registry.parse_unit_name(name)
                if p in _PREFIXES and u in _UNITS and not (p and u in _WHOLE)
            }
            for name, _ in found.unit_items()
        ]
        if all(parts):
            return found
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
    return next((role for role in ("time", "displacement", "acceleration", "force") if may_be(unit, role)), None)


@lru_cache(10_000)
def may_be(unit: str, role: str) -> bool:
    """Whether a unit can be one of a role: g is an acceleration, and of a load cell a force. "100 N" is none: a range,
    or what a sample of 1 means."""
    found = _quantity(unit, role)
    if found is None or found.magnitude != 1 or "joule" in str(found.units):  # an energy is no torque
        return False
    return _working(found, role) is not None


@lru_cache(10_000)
def is_unit(text: str) -> bool:
    """Whether a cell of a table's head can be a unit: of a role, of another usual channel, or a dash for none."""
    if text.strip().strip("[]()").strip() in ("", "-", "--", "1", "%", "none"):
        return True
    if role_of(text):
        return True
    found = _quantity(text, "")
    return found is not None and any(found.check(_registry().Quantity(1.0, other).dimensionality) for other in _OTHER)


def contradict(a: str, b: str) -> bool:
    """Whether two units of one channel cannot both be right: of two roles, or of two sizes."""
    role, other = role_of(a), role_of(b)
    return None not in (role, other) and (role != other or _quantity(a, role or "") != _quantity(b, role or ""))


def states_two(name: str) -> bool:
    """Whether a name ends in a unit that contradicts the one before it: Force (N), kN."""
    found = re.fullmatch(r"(.+?)\s*[,\[({<]\s*([^\[\](){}<>,]+)[\])}>]?", name)
    return found is not None and contradict(split_name(found[1])[1], found[2])


def is_ratio(text: str) -> bool:
    """Whether a unit is that of a strain: a length over a length, per cent, microstrain."""
    text = text.strip().strip("[]()").strip()
    if text.lower() in _RATIOS:
        return True
    found = _quantity(text, "") if "/" in text else None
    return found is not None and found.dimensionless and not _angular(found)


def is_volts(text: str) -> bool:
    """Whether a unit is that of a transducer's signal: volts, charge, current, a bridge's ratio of volts."""
    return bool(re.fullmatch(r"[mkuµμ]?V(/V)?|(milli)?volts?|[np]C|mA", text.strip("[]() "), re.IGNORECASE))


def split_name(name: str) -> tuple[str, str]:
    """Name and unit from 'Force [kN]', 'Weg in mm', 'Kraft / N', 'force_N'; the unit is "" where there is none."""
    name = name.translate(_WIDE).strip(" ;,")
    found = re.fullmatch(r"(.+?)\s*[\[({<]([^\[\](){}<>]+(?:\([^()]*\))?)[\])}>]", name)
    found = found if found and re.search(r"[^\W\d_]|[°%\"]", found[2]) else None
    if found:
        if contradict(split_name(found[1])[1], found[2]):
            return name, ""
        if is_unit(found[2]) or is_ratio(found[2]):
            return found[1].strip(), found[2].strip()
    for within in re.finditer(r"\s*[\[({<]([^\[\](){}<>]+)[\])}>]\s*", name):  # [mm] Weg, Force (N) Run 1
        if role_of(within[1]) or is_volts(within[1]):
            return f"{name[: within.start()]} {name[within.end() :]}".strip(), within[1].strip()
    if found:
        return name, ""
    for pattern in (r"(.+?)\s+in\s+(\S+)", r"(.+?)\s*/\s*(\S+)", r"(.+?)\s*[,:]\s*(\S+)", r"(.+?)\s+(?:-\s+)?(\S+)"):
        found = re.fullmatch(pattern, name)
        words = found and (_LETTERS.search(found[2]) and is_unit(found[2]))
        if found and (_bare(found[1], found[2]) if "[" in pattern or "-" in pattern else words):
            return (name, "") if _FACTOR.search(found[1]) else (found[1].strip(), found[2].strip())
    parts = name.split("_")
    if len(parts) > 2 and parts[-1] == "s" and may_be(parts[-2], "displacement"):
        return "_".join(parts[:-2]), f"{parts[-2]}/s"  # a velocity, no time
    for k in range(max(1, len(parts) - 3), len(parts)):
        stem, unit = "_".join(parts[:k]), "_".join(parts[k:])
        spelt = f"{unit[:-3]}/s2" if unit.endswith("_s2") else unit.replace("_", "*")
        if _bare(stem, spelt):
            return stem, spelt
    return name, name if len(name) > 1 and name.lower() != "min" and may_be(name, "time") else ""  # ms, millis


def _bare(stem: str, unit: str) -> bool:
    """Whether what stands without brackets behind a name is its unit: of a role that the name says, if it says one."""
    known = (
        x in _BARE or _WORDS.get(x.lower()) in _BARE or (x.isupper() and x.lower() in _BARE) for x in unit.split("*")
    )
    roles = [role for role in WORDS if named(stem, role)]
    return all(known) and (not roles or is_volts(unit) or any(may_be(unit, role) for role in roles))


def converted(values: Array, unit: str, sensitivity: str, role: str, where: str) -> tuple[Array, str]:
    """Samples in the campaign's working unit, and which that is.

    unit : of the samples. sensitivity : of a transducer whose signal they are ('9.55 mV/N', '104.7 N/V'), or "".
    Raises CampaignError that starts with `where`.
    """
    known = ", ".join(ROLES[role])
    quantity = _quantity(decimal_point(unit), role)
    if unit and quantity is None:
        near = nearest(unit, ROLES[role], f" ({known} ...)")
        raise CampaignError(f'{where}: unit {unit!r} is not known; say it with --unit "{role}=UNIT"{near}')
    if sensitivity:
        per = _quantity(decimal_point(sensitivity), role)
        if per is None or per.magnitude == 0:
            raise CampaignError(f'{where}: sensitivity {sensitivity!r} is no number with a unit, like "9.55 mV/N"')
        if quantity is not None and _working(quantity, role):
            raise CampaignError(f"{where}: the samples are in {unit} already; leave the sensitivity out")
        raw = _registry().Quantity(1.0, "volt") if quantity is None else quantity
        ways = [way for way in (raw / per, raw * per) if _working(way, role)]
        if not ways:
            raise CampaignError(f"{where}: {unit or 'V'} with a sensitivity of {sensitivity} gives no {role} ({known})")
        quantity = ways[0]
    working = None if quantity is None else _working(quantity, role)
    if working is None:
        raise CampaignError(f"{where}: unit {unit} is no unit of {role}{nearest(unit, ROLES[role])}")
    factor = float(quantity.to(ROLES[role][working]).magnitude)
    return values * factor, working
