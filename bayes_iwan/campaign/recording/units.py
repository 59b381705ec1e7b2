"""What a campaign measures: a force over a displacement, a torque over an angle, a pressure over a stroke.

Inside the package every number stands in the working units below. They are chosen so that one set of formulas serves
all quantities: a displacement is a thousandth of the unit of length in the velocity (mm and m/s, mrad and rad/s), so
that force times displacement is a thousandth of the force times the velocity's length (N·mm = mJ, N·m·mrad = mJ).
Only texts differ from one quantity to another: `Units.text` puts a campaign's own units in place of mm and N.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar, cast

#: working unit → what a column's name may end in, and its size in the working unit
DISPLACEMENTS: Mapping[str, Mapping[str, float]] = {
    "mm": {"mm": 1.0, "m": 1e3, "um": 1e-3, "in": 25.4},
    "mrad": {"mrad": 1.0, "rad": 1e3, "deg": 1e3 * math.pi / 180},
}
#: by the displacement's working unit; accelerations are m/s² or rad/s²
ACCELERATIONS: Mapping[str, Mapping[str, float]] = {
    "mm": {"m_s2": 1.0, "mm_s2": 1e-3, "g": 9.80665},
    "mrad": {"rad_s2": 1.0, "deg_s2": math.pi / 180},
}
FORCES: Mapping[str, Mapping[str, float]] = {
    "N": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": 4.4482216152605},
    "N·m": {"N_m": 1.0, "kN_m": 1e3, "N_mm": 1e-3, "mN_m": 1e-3, "lbf_in": 0.1129848290276167},
    "kPa": {"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3, "bar": 100.0, "psi": 6.894757293168361},
}
TIMES: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_LENGTH = {"mm": "m", "mrad": "rad"}
_ENERGY = {("mm", "N"): "mJ", ("mrad", "N·m"): "mJ", ("mm", "kPa"): "J/m²"}
_THOUSAND = {"N": "kN", "N·m": "kN·m", "kPa": "MPa"}
_THOUSANDTH = {"N": "mN", "N·m": "mN·m", "kPa": "Pa"}
#: how the units above are written inside names (kp_N_mm, mean_slip_force_N)
_NAMED = {"N": "N", "N·m": "Nm", "kPa": "kPa", "mJ": "mJ", "J/m²": "J_m2"}
_NAME = re.compile(r"(?<![\w/])[A-Za-z]\w*_(?:N|mJ|mm)(?:_\w+|\d)?(?![\w.])")
T = TypeVar("T")
_TOKEN = re.compile(r"(?<![A-Za-z0-9_·µ])(kN|mN|mJ|mm|N|m)(?![A-Za-z0-9_₀-₉])(?!·m\b)([²³^])?")


@dataclass(frozen=True)
class Units:
    """The working units of a campaign's displacement and force, as texts."""

    displacement: str = "mm"
    force: str = "N"

    @property
    def stiffness(self) -> str:
        return f"{self.force}/{self.displacement}"

    @property
    def energy(self) -> str:
        return _ENERGY.get((self.displacement, self.force), f"{self.force}·{self.displacement}")

    @property
    def velocity(self) -> str:
        return f"{_LENGTH[self.displacement]}/s"

    @property
    def plain(self) -> bool:
        """True for N and mm, in which every text of the package is written."""
        return self == Units()

    def text(self, unit: str) -> str:
        """A unit text written for N and mm ('N/mm', 'N·s²/m²', 'mJ') in this campaign's units.

        Works inside a longer text as well ('force (N)', '2.5 N at 0.3 mm').
        """
        if self.plain:
            return unit
        own = {
            "N": self.force,
            "kN": _THOUSAND[self.force],
            "mN": _THOUSANDTH[self.force],
            "mJ": self.energy,
            "mm": self.displacement,
            "m": _LENGTH[self.displacement],
        }

        def put(found: re.Match[str]) -> str:
            new, power = own[found[1]], found[2] or ""
            return (f"({new})" if power and "·" in new else new) + power

        return _TOKEN.sub(put, unit)

    def name(self, name: str) -> str:
        """A name that ends in N, mm or mJ units ('kp_N_mm', 'dissipated_energy_mJ[f10.csv]') with this campaign's."""
        if self.plain:
            return name
        own = {"N": _NAMED[self.force], "mJ": _NAMED.get(self.energy, "energy"), "mm": self.displacement}
        stem, bracket, after = name.partition("[")
        return re.sub(r"(?<=_)(N|mJ|mm)(?=_|\d|$)", lambda found: own[found[1]], stem) + bracket + after

    def said(self, text: str) -> str:
        """Any text, table cell or label written for N and mm, names of parameters in it included, in these units."""
        return text if self.plain else _NAME.sub(lambda found: self.name(found[0]), self.text(text))

    def everywhere(self, value: T) -> T:
        """`said` for every text in nested lists, tuples and dictionaries of an answer; keys stay as they are."""
        if self.plain:
            return value
        out: object = value
        if isinstance(value, str):
            out = self.said(value)
        elif isinstance(value, dict):
            out = {key: self.everywhere(inner) for key, inner in value.items()}
        elif isinstance(value, list | tuple):
            out = type(value)(self.everywhere(inner) for inner in value)
        return cast(T, out)
