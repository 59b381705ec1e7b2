"""A fault: what the virtual rig has beyond the paper's model, by one of several laws, at some strength.

A fault is the rig's physical counterpart of an *effect* of the diagnosis (or of nothing that the diagnosis knows).
It is a name, the name of its law, and its numbers. A law turns the numbers into what acts: numbers and functions of
the kernel (`bayes_iwan.rig.kernel.Numbers`) or settings of the measuring chain (`bayes_iwan.rig.sensors.Chain`).
The strength of a fault runs from 0 (absent) to 1 (the strongest that a sensible rig or specimen has); the rig solves
for the strength that gives a wanted change of the force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.rig.specimen import Specimen

Parameters = Mapping[str, float]
#: what acts, by the names of the kernel's numbers, of the chain's settings, or of the functions in `laws.FUNCTIONS`
Acting = dict[str, Any]


@dataclass(frozen=True)
class Surroundings:
    """What the size of a sensible fault depends on: the campaign's motion and forces without it."""

    specimen: Specimen
    frequencies_hz: tuple[float, ...]
    amplitudes_mm: tuple[float, ...]
    record_s: float
    friction_rms_N: float
    force_peak_N: float

    @property
    def fastest_rad_s(self) -> float:
        return 2 * np.pi * max(self.frequencies_hz)

    @property
    def largest_mm(self) -> float:
        return max(self.amplitudes_mm)

    @property
    def speed_mm_s(self) -> float:
        """Peak speed of the largest motion at the highest frequency."""
        return self.fastest_rad_s * self.largest_mm

    @property
    def stiffness_N_mm(self) -> float:
        """Friction force over displacement: what a stiffness must be compared with."""
        return self.friction_rms_N / (self.largest_mm / np.sqrt(2))


@dataclass(frozen=True)
class Fault:
    """One fault as it acts in one rig: `name`, `law`, `parameters` with units in their names, `size` if measured.

    An empty `law` is the first of its kind, the one that the diagnosis' catalogue has too. `size`: RMS of the change of
    the force, over RMS friction force (`sizing.fault_size`). `visible`: the share of it that no change of the
    specimen's parameters imitates. `share` and `share_of_square`: its part of the gap that all faults of its case
    leave, in RMS and in squares (`sizing.shares_left`). nan if not measured.
    """

    name: str
    parameters: Parameters = field(default_factory=dict)
    law: str = ""
    size: float = float("nan")
    visible: float = float("nan")
    share: float = float("nan")
    share_of_square: float = float("nan")


def _nothing(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {}


Draw = Callable[[np.random.Generator, Surroundings], Parameters]


@dataclass(frozen=True)
class Law:
    """One law of a fault: what its numbers do (`acts`), and the numbers that only this law has, drawn.

    `evolves`: the change of the force changes along the record. `strongest`: where the main number follows from the
    strength otherwise than in the kind's other laws.
    """

    name: str
    acts: Callable[[Parameters], Acting]
    draw: Draw = _nothing
    evolves: bool = False
    strongest: Callable[[Surroundings, float], float] | None = None


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: its main number, how that follows from the strength in (0, 1], its laws, the shared one first.

    `draw` draws the numbers that all laws have beside the main one; `signed`: the main number may be negative;
    `listed`: the diagnosis' catalogue has an effect of this name.
    """

    name: str
    main: str
    strongest: Callable[[Surroundings, float], float]
    laws: tuple[Law, ...]
    draw: Draw = _nothing
    signed: bool = False
    listed: bool = True

    def law(self, name: str) -> Law:
        """The law of this name; the first for an empty one. Raises KeyError."""
        return self.laws[0] if not name else next(one for one in self.laws if one.name == name)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def linear(ceiling: Callable[[Surroundings], float]) -> Callable[[Surroundings, float], float]:
    """A main number in proportion to the strength."""
    return lambda s, strength: ceiling(s) * strength


def uniform_grid(reach: float, n: int) -> Array:
    """A grid from −reach to reach, its middle at 0."""
    return np.linspace(-reach, reach, 2 * n + 1)
