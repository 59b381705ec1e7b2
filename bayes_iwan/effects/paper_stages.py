"""What the paper adds to the classical Iwan model, as effects: for diagnoses that start from a model without them.

Together on the classical base they are Eqs. (11) and (12) exactly, with one exponent β for both terms of α.
"""

from collections.abc import Mapping

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion
from bayes_iwan.models import Model, Simulator, normal_force
from bayes_iwan.models import stiffness as laws
from bayes_iwan.models.iwan_parameters import EXPONENT_PRIOR

#: below this d ln k / d ln α the stiffness is taken as constant: Eq. (12) then follows only an all but vanishing
#: influence of the normal force
LEAST_ELASTICITY = 1e-6


def _beta() -> ExtraParameter:
    return ExtraParameter("β", "-", "exponent of the Hunt–Crossley normal force", EXPONENT_PRIOR, 0.004, 5.0)


class VaryingNormalForce(Effect):
    name = "varying_normal_force"
    strength = ("slope", "k̃ₙβℓ^β", "-", "relative change of the normal force with displacement")
    signed = True
    limit = 4.0
    physics = (
        "The spring squeezes the rope more as it shortens: the normal force, and with it what every element "
        "carries, follows the penetration A − u to the power β."
    )
    reference = "the paper, Eq. (11) without its speed term; Hunt & Crossley, J. Appl. Mech. 42 (1975) 440"
    signature = "loops asymmetric about their middle, more so at large amplitude, at every frequency alike"
    look_alikes = ("quadratic_stiffness", "direction_dependent_friction", "speed_dependent_normal_force")
    bench = "the same tests about a shifted mid-position; a cell that measures the normal force"

    def first_guess(self) -> float:
        return 0.2

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"beta": _beta()}

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        zero, beta = np.log(self.scales.length_mm), self.get(parameter_values, "beta")
        top = np.log(motion.amplitude_mm)[:, None] - zero
        change = np.expm1(beta * (motion.log_penetration - zero)) - np.expm1(beta * top)
        return alpha + self.get(parameter_values, "slope") * change / beta


class SpeedDependentNormalForce(Effect):
    name = "speed_dependent_normal_force"
    needs_clock = True
    strength = ("rate", "λk̃ₙℓ^βv", "-", "relative change of the normal force with speed")
    signed = True
    limit = 4.0
    order = 0
    physics = (
        "The contact of rope and spring is lossy, so the normal force grows (or falls) with the speed of the "
        "stroke, in proportion to the penetration to the power β."
    )
    reference = "the paper, Eq. (11), last term; Hunt & Crossley, J. Appl. Mech. 42 (1975) 440"
    signature = "friction in mid-stroke grows with frequency × amplitude, more where the rope is squeezed"
    look_alikes = ("rate_strengthening", "stribeck_weakening", "viscous_damping", "varying_normal_force")
    bench = "very slow tests; a cell that measures the normal force"

    def first_guess(self) -> float:
        return 0.2

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"beta": _beta()}

    def exponent(self, parameter_values: ParameterValues) -> Array:
        """β of whatever else gives the normal force its shape (Eq. 11 has one), else of this effect, (draws,)."""
        for owner in ("beta", f"{VaryingNormalForce.name}.beta"):
            if owner in parameter_values:
                return parameter_values[owner]
        return parameter_values[f"{self.name}.beta"]

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        squeezed = np.exp(
            self.exponent(parameter_values)[:, None, None] * (motion.log_penetration - np.log(self.scales.length_mm))
        )
        return alpha + self.get(parameter_values, "rate") * squeezed * (motion.speed_m_s / self.scales.speed_m_s)

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        return {"rate": (values[self.strength_name], "-"), "beta": (self.exponent(values), "-")}


class StiffnessOfNormalForce(Effect):
    name = "stiffness_of_normal_force"
    strength = (
        *("elasticity", "ε", "-"),
        "d ln k / d ln α at α = 1; 1: the stiffness is proportional to the normal force",
    )
    limit = 1.0 - 1e-4
    order = 1  # after whatever changes α
    physics = "Contacts that are squeezed harder are stiffer, up to the stiffness of the bodies themselves."
    reference = "the paper, Eq. (12)"
    signature = "slope after reversals differs between the two ends of the loop; nothing while α is constant"
    look_alikes = ("varying_normal_force", "quadratic_stiffness")
    bench = "small amplitudes about several mid-positions"

    def first_guess(self) -> float:
        return 0.4

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        # Eq. (12) over its value at α = 1, so that the base's k stays k(1)
        value = np.atleast_1d(parameter_values[self.strength_name])
        ratio = laws.ratio_of_elasticity(np.clip(value, LEAST_ELASTICITY, self.limit))[:, None, None]
        factor = np.expm1(-ratio * alpha) / np.expm1(-ratio)
        return k * np.where(value[:, None, None] < LEAST_ELASTICITY, 1.0, factor)


EFFECTS: tuple[type[Effect], ...] = (VaryingNormalForce, SpeedDependentNormalForce, StiffnessOfNormalForce)


def missing_terms(simulator: Simulator | None) -> tuple[type[Effect], ...]:
    """Those of the paper's terms that an Iwan model does without; none for another simulator."""
    if not isinstance(simulator, Model):
        return ()
    law, stiffness = simulator.normal_force, simulator.stiffness
    lacks = {
        VaryingNormalForce: law == normal_force.Constant.name,
        SpeedDependentNormalForce: law != normal_force.HuntCrossley().name,
        StiffnessOfNormalForce: stiffness == laws.ConstantStiffness.name,
    }
    return tuple(effect for effect in EFFECTS if lacks[effect])
