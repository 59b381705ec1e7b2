"""A fault: what the virtual rig has beyond the paper's model, by one of several laws, at some strength.

A fault is the rig's physical counterpart of an *effect* of the diagnosis (or of nothing that the diagnosis knows).
It is a name, the name of its law, and its parameters. A law turns these into what acts (`Acting`): values and
functions of the kernel, or settings of the measuring chain.
The strength of a fault runs from 0 (absent) to 1 (the strongest that a sensible rig or specimen has); the rig solves
for the strength that gives a wanted change of the force.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.screen import on_screen
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.sensors import Chain

Parameters = Mapping[str, float]
Function = Callable[[Array], Array]
#: relative standard deviation from test to test, and the seed of the draw
Scatter = tuple[float, int]
#: the kernel's values and the measuring chain of a rig without a fault
NO_FAULT, SOUND_CHAIN = FaultValues(), Chain()


@dataclass(frozen=True)
class Acting:
    """What a fault does; by default nothing.

    motion, chain : the kernel's values and the measuring chain's settings. extra_compliance_mm_N : of the fixture.
    displacement_force, speed_force : a further force (N) of the specimen over its deformation (mm) and its speed
    (mm/s). joint_stretch : stretch (mm) of the joint over the force in it (N), beside the fixture's compliance.
    rate_factor : factor on a slip force over its remembered slip speed (mm/s). fade_factor : on all slip forces over
    the cycles, or over the work where `motion.fade_work_Nmm` says so. position_factor : on all slip forces over the
    specimen's deformation (mm). stiffness_scatter, friction_scatter, gain_scatter : of both springs, of the slip forces
    and of the force amplifier, from test to test. amplitude_gain : factor of the force amplifier over a test's
    amplitude (mm).
    """

    motion: FaultValues = NO_FAULT
    chain: Chain = SOUND_CHAIN
    extra_compliance_mm_N: float = 0.0
    displacement_force: Function | None = None
    speed_force: Function | None = None
    joint_stretch: Function | None = None
    rate_factor: Function | None = None
    fade_factor: Function | None = None
    position_factor: Function | None = None
    stiffness_scatter: Scatter | None = None
    friction_scatter: Scatter | None = None
    gain_scatter: Scatter | None = None
    amplitude_gain: Function | None = None

    @property
    def only_measured(self) -> bool:
        """Whether the motion is left as it is."""
        measured = Acting(chain=self.chain, gain_scatter=self.gain_scatter, amplitude_gain=self.amplitude_gain)
        return self.motion is NO_FAULT and self == measured

    @property
    def remembers(self) -> bool:
        """Whether each slider remembers its slip speed or how long it stuck."""
        return self.rate_factor is not None or self.motion.ageing != 0.0 or self.motion.healing != 0.0


@dataclass(frozen=True)
class Surroundings:
    """What the size of a sensible fault depends on: the campaign's motion and forces without it."""

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
    def power_mW(self) -> float:
        """What friction turns to heat at that speed, at most."""
        return 4 * self.friction_rms_N * self.largest_mm * max(self.frequencies_hz)

    @property
    def stiffness_N_mm(self) -> float:
        """Friction force over displacement: what a stiffness must be compared with."""
        return self.friction_rms_N / (self.largest_mm / np.sqrt(2))


@dataclass(frozen=True)
@on_screen
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


#: what a law's parameters do, and how they are drawn
Acts = Callable[[Parameters], Acting]
Draw = Callable[[np.random.Generator, Surroundings], Parameters]


def _nothing(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {}


@dataclass(frozen=True)
class Law:
    """One law of a fault: what its parameters do (`acts`), and the parameters that only this law has, drawn.

    `evolves`: the change of the force changes along the record. `strongest`: where the main parameter follows from the
    strength otherwise than in the kind's other laws.
    """

    name: str
    acts: Acts
    draw: Draw = _nothing
    evolves: bool = False
    strongest: Callable[[Surroundings, float], float] | None = None


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: its main parameter, how that follows from the strength in (0, 1], its laws.

    The first law is the one that the diagnosis' catalogue has too.
    `draw` draws the parameters that all laws have beside the main one; `signed`: the main one may be negative;
    `listed`: the diagnosis' catalogue has an effect of this name. `family`: what kinds from outside it have in common
    (whatever is fitted to such cases is scored with a whole family held out).
    """

    name: str
    main: str
    strongest: Callable[[Surroundings, float], float]
    laws: tuple[Law, ...]
    draw: Draw = _nothing
    signed: bool = False
    listed: bool = True
    family: str = ""

    def law(self, name: str) -> Law:
        """The law of this name; the first for an empty one. Raises KeyError."""
        return self.laws[0] if not name else next(one for one in self.laws if one.name == name)
