"""The forward model: a line of stages from motion to force.

    motion → [motion] → [around] → α(u, u̇) → [grip] → k(α) → [stiffness] → [slip] → sliders → + parallel spring
    → [force] → F

Each stage takes and returns arrays shaped (draws, loops, samples). The bracketed stations are empty for the paper's
model; the gap room puts effects there. `grip` changes the normal force and with it the stiffness; `slip` changes
what an element can carry at a given normal force (its coefficient of friction) and leaves k alone. Every model the
paper mentions is one :class:`Model` away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.physics import normal_force, sliders, slip_force, stiffness
from bayes_iwan.physics.motion import Motion
from bayes_iwan.physics.normal_force import ALPHA_FLOOR, Reference
from bayes_iwan.physics.stiffness import Stiffness
from bayes_iwan.threads import over_draws


class ModelError(ValueError):
    """A model that cannot be built, or numbers it cannot take; the message names what and the mend."""


class Station(Protocol):
    """What the model asks of an effect: any of these may change what passes its station."""

    @property
    def name(self) -> str: ...

    def motion(self, motion: Motion, numbers: Numbers) -> Motion: ...

    def grip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array: ...

    def stiffness(self, k: Array, alpha: Array, numbers: Numbers) -> Array: ...

    def slip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array: ...

    def asymmetry(self, numbers: Numbers) -> Array | float: ...

    def slip_table(self, tables: Array, top: Array, numbers: Numbers) -> Array: ...

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array: ...

    def around(self, inner: Callable[[Motion], Array], motion: Motion, numbers: Numbers) -> Array: ...


@dataclass(frozen=True)
class Model:
    """A generalized Iwan model by the names of its parts.

    slip : "gamma1", "gamma2", "gamma3", "uniform", "gaussian" or "power_law"
    grip : "constant" (classical Iwan), "polynomial1" … "polynomial6", "hunt_crossley_no_speed", "hunt_crossley"
    stiffness : "constant" or "saturating" (Eq. 12)
    reference : the campaign's scales (see :class:`bayes_iwan.physics.normal_force.Reference`)
    effects : what the gap room adds, in the order in which they act
    """

    reference: Reference
    slip: str = "gamma3"
    grip: str = "hunt_crossley"
    stiffness: str = "saturating"
    effects: tuple[Station, ...] = ()

    def __post_init__(self) -> None:
        for what, name, known in (
            ("slip", self.slip, slip_force.FAMILIES),
            ("grip", self.grip, normal_force.LAWS),
            ("stiffness", self.stiffness, stiffness.LAWS),
        ):
            if name not in known:
                raise ModelError(f"model.{what} = {name!r} is not known; choose one of {', '.join(known)}")

    @property
    def slip_family(self) -> slip_force.SlipForce:
        return slip_force.FAMILIES[self.slip]

    @property
    def grip_law(self) -> normal_force.NormalForce:
        return normal_force.LAWS[self.grip]

    @property
    def stiffness_law(self) -> Stiffness:
        return stiffness.LAWS[self.stiffness]

    @property
    def names(self) -> tuple[str, ...]:
        """Numbers the base model reads: parallel spring and force zero, then stiffness, slip forces, grip."""
        return ("kp_N_mm", "force_zero_N", *self.stiffness_law.names, *self.slip_family.names, *self.grip_law.names)

    def alpha(self, numbers: Numbers, motion: Motion) -> Array:
        """Relative normal force with the grip effects, (draws, loops, samples)."""
        alpha = self.grip_law.alpha(numbers, motion, self.reference, len(numbers["kp_N_mm"]))
        for effect in self.effects:
            alpha = effect.grip(alpha, motion, numbers)
        return np.maximum(alpha, ALPHA_FLOOR) if self.effects else alpha

    def friction_force(self, numbers: Numbers, motion: Motion) -> Array:
        """Friction force in N, (draws, loops, samples), of a specimen moved exactly so (grip effects included)."""
        nothing = np.zeros(len(numbers["kp_N_mm"]))
        return self._sum(numbers, motion, nothing, nothing)

    def specimen_force(self, numbers: Numbers, motion: Motion) -> Array:
        """Friction and parallel spring, N."""
        return self._sum(numbers, motion, numbers["kp_N_mm"], np.zeros(len(numbers["kp_N_mm"])))

    def _sum(self, numbers: Numbers, motion: Motion, parallel: Array, zero: Array) -> Array:
        """Friction + parallel·u + zero; parallel in N/mm and zero in N are (draws,).

        A draw's result does not depend on how the draws are parted among threads.
        """
        out = np.empty((len(parallel), motion.loops, motion.samples))

        def some_draws(part: slice) -> None:
            some = {name: value[part] for name, value in numbers.items()}
            moved = motion.of_draws(part)
            alpha = np.ascontiguousarray(self.alpha(some, moved))
            k = self.stiffness_law.k(some, alpha)
            for effect in self.effects:
                k = effect.stiffness(k, alpha, some)
            k = np.ascontiguousarray(k)
            for effect in self.effects:  # a coefficient of friction: what k(α) does not follow
                alpha = np.maximum(effect.slip(alpha, moved, some), ALPHA_FLOOR)
            alpha = np.ascontiguousarray(alpha)
            asymmetry = np.zeros(len(alpha))
            for effect in self.effects:
                asymmetry = asymmetry + effect.asymmetry(some)
            tables, top = self.slip_family.table(some)
            for effect in self.effects:
                tables = effect.slip_table(tables, top, some)
            sliders.friction(
                np.ascontiguousarray(moved.displacement_mm),
                alpha,
                k,
                asymmetry,
                moved.periodic,
                tables,
                top,
                parallel[part],
                zero[part],
                out[part],
            )

        over_draws(some_draws, len(parallel), motion.loops * motion.samples)
        return out

    def force(self, numbers: Numbers, motion: Motion) -> Array:
        """The force that the cell records, N, (draws, loops, samples): Eq. (3) with all effects and the force zero."""
        if not self.effects:
            return self._sum(numbers, motion, numbers["kp_N_mm"], numbers["force_zero_N"])
        for effect in self.effects:
            motion = effect.motion(motion, numbers)
        inner: Callable[[Motion], Array] = partial(self.specimen_force, numbers)
        for effect in self.effects:  # effects in series with the specimen need the force back
            inner = partial(effect.around, inner, numbers=numbers)
        out = inner(motion) + numbers["force_zero_N"][:, None, None]
        for effect in self.effects:
            out = effect.force(out, motion, numbers)
        return out
