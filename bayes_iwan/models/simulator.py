"""What is fitted, and the line of stages along which effects act on it.

    motion → [motion] → [around] → simulator, with [normal_force], [stiffness], [slip] … where it offers them
    → + force zero → [force] → F

A simulator is whatever has parameters for given scales and turns parameter values and a motion into a force. Effects
sit at the bracketed stages; the outer ones apply to any simulator, the inner ones to those that offer them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayes_iwan import former_names
from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.errors import InputError
from bayes_iwan.models.motion import Motion
from bayes_iwan.models.parameter import Parameter, for_distinct
from bayes_iwan.models.scales import Scales
from bayes_iwan.screen import on_screen

#: stages that every simulator has, in the order of the signal, and those inside it that it may offer
OUTER = ("motion", "around", "force")
INNER = ("normal_force", "stiffness", "slip", "asymmetry", "slip_table")
#: the zero of the force channel, N: added to what the simulator says if it is among the parameters
FORCE_ZERO = "force_zero_N"


class ModelError(InputError):
    """A simulator that cannot be built or used; the message names what and the fix."""


class Inner(Protocol):
    """What an effect in series asks for the specimen's force."""

    def __call__(self, motion: Motion, some: NDArray[np.int64] | None = None, /) -> Array:
        """Force (draws, loops, samples), N; of the draws with indices `some` alone where these are given."""


class Modifier(Protocol):
    """What the line asks of an effect: any of these may change what passes its stage."""

    @property
    def name(self) -> str: ...

    @property
    def stages(self) -> frozenset[str]:
        """The stages at which it acts."""

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    def motion(self, motion: Motion, parameter_values: ParameterValues) -> Motion: ...

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array: ...

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array: ...

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array: ...

    def asymmetry(self, parameter_values: ParameterValues) -> Array | float: ...

    def slip_table(self, tables: Array, top: Array, parameter_values: ParameterValues) -> Array: ...

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array: ...

    def around(self, inner: Inner, motion: Motion, parameter_values: ParameterValues) -> Array: ...


@dataclass(frozen=True)
@on_screen
class Derived:
    """A quantity that follows from the sampled parameters: its unit and its value in each draw (draws,)."""

    unit: str
    values: Array


class Simulator(ABC):
    """Anything that can be identified and diagnosed. Subclass it: give a name, `parameters` and `force`.

    Attributes
    ----------
    stages
        the inner stages ("normal_force", "stiffness", "slip", "asymmetry", "slip_table") that `force` honours in the
        effects it is handed; none unless said.

    Raises
    ------
    ModelError
        from `force`, where it cannot be used for that motion; from :func:`bayes_iwan.make_problem`, for an effect at a
        stage that it does not offer.

    Examples
    --------
    >>> import numpy as np, bayes_iwan as bi
    >>> from scipy import stats
    >>> class Spring(bi.Simulator):
    ...     name = "spring"
    ...     def parameters(self, scales):
    ...         prior = stats.lognorm(s=1.0, scale=scales.soft_N_mm)
    ...         return (bi.Parameter("k_N_mm", "k", "N/mm", "stiffness", prior),)
    ...     def force(self, parameter_values, motion, effects=()):
    ...         return parameter_values["k_N_mm"][:, None, None] * motion.displacement_mm
    >>> motion = bi.sine_motion(frequency_hz=10.0, amplitude_mm=0.5)
    >>> float(Spring().force({"k_N_mm": np.array([7.0])}, motion).max())
    3.5
    """

    stages: frozenset[str] = frozenset()

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        for name in former_names.SIMULATOR_MEMBERS:
            if name in vars(cls):
                raise ModelError(f"{cls.__name__}.{name} {former_names.renamed(name, former_names.SIMULATOR_MEMBERS)}")

    @property
    @abstractmethod
    def name(self) -> str:
        """One word; a class attribute `name = "..."` will do."""

    @abstractmethod
    def parameters(self, scales: Scales) -> tuple[Parameter, ...]:
        """The sampled parameters with their priors, on the campaign's own scales of force, length and speed."""

    def parameter_values(self, values: ParameterValues) -> ParameterValues:
        """What `force` reads, (draws,) each, from sampled values by name; the same unless overridden."""
        return values

    @abstractmethod
    def force(self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()) -> Array:
        """Force of the specimen, N, shaped (draws, loops, samples), without the zero of the force channel.

        A periodic motion asks for steady loops, a record for the force from rest. NaN where there is none.
        effects : those that act at the stages offered.
        """

    def friction_force(
        self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()
    ) -> Array:
        """The part of the force that friction makes, N, (draws, loops, samples): shares of the gap refer to it.

        Unless overridden: the force less its mean and less the straight line in u that fits each loop best.
        """
        force = self.force(parameter_values, motion, effects)
        return force - straight_part(force, motion.displacement_mm)

    def spring_N_mm(self, parameter_values: ParameterValues) -> Array | None:
        """(draws,) stiffness of the spring beside the friction, which friction loops are drawn without; None where
        there is no such number: the straight line that fits each loop best is taken.
        """
        return parameter_values.get("kp_N_mm")

    def derived(self, parameter_values: ParameterValues) -> dict[str, Derived]:
        """Further quantities to report, by name, which cost no prediction."""
        return {}


def straight_part(force_N: Array, displacement_mm: Array) -> Array:
    """The straight line in u that fits each loop best, mean included, shaped as force_N (…, samples), N."""
    u = displacement_mm - displacement_mm.mean(axis=-1, keepdims=True)
    slope = np.sum(force_N * u, axis=-1, keepdims=True) / np.sum(u * u, axis=-1, keepdims=True)
    return force_N.mean(axis=-1, keepdims=True) + slope * u


def force_zero(scales: Scales) -> Parameter:
    """The zero of the force channel, which every problem has."""
    return Parameter(FORCE_ZERO, "F₀", "N", "zero of the force channel", stats.t(df=2, scale=0.003 * scales.force_N))


def inner_effects(effects: Sequence[Modifier]) -> tuple[Modifier, ...]:
    """Those that act inside the simulator."""
    return tuple(e for e in effects if not e.stages.isdisjoint(INNER))


def offered(stages: frozenset[str], simulator: Simulator) -> bool:
    """Does the simulator have the stages at which an effect acts?"""
    return stages <= simulator.stages.union(OUTER)


def recorded_force(
    simulator: Simulator, effects: Sequence[Modifier], parameter_values: ParameterValues, motion: Motion
) -> Array:
    """The force that the cell records, N, (draws, loops, samples), with all effects and the force zero."""
    inside = inner_effects(effects)
    outside = {p.name for e in effects if e not in inside for p in e.parameters}
    read = [n for n in parameter_values if n not in outside and n != FORCE_ZERO]
    for effect in effects:
        motion = effect.motion(motion, parameter_values)

    def specimen(at: Motion, some: NDArray[np.int64] | None = None) -> Array:
        values = _of(parameter_values, some)
        if at.draws > 1 or not outside:
            return simulator.force(values, at, inside)
        return for_distinct(lambda these: simulator.force(these, at, inside), read, values)

    inner: Inner = specimen
    for effect in effects:  # effects in series with the specimen need the force back
        if "around" in effect.stages:
            inner = _around(effect, inner, parameter_values)
    out = inner(motion)
    if FORCE_ZERO in parameter_values:
        out = out + parameter_values[FORCE_ZERO][:, None, None]
    for effect in effects:
        out = effect.force(out, motion, parameter_values)
    return out


def _around(effect: Modifier, inner: Inner, parameter_values: ParameterValues) -> Inner:
    def whole(motion: Motion, some: NDArray[np.int64] | None = None) -> Array:
        def within(at: Motion, these: NDArray[np.int64] | None = None) -> Array:
            return inner(at, these if some is None else some if these is None else some[these])

        return effect.around(within, motion, _of(parameter_values, some))

    return whole


def _of(values: ParameterValues, some: NDArray[np.int64] | None) -> ParameterValues:
    return values if some is None else {n: x[some] for n, x in values.items()}
