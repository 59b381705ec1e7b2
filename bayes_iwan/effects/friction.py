"""Effects on the friction itself: what the elements can carry, or how the normal force follows the motion."""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.effects.base import Effect, Motion, Shape, filtered


class _OfSlipSpeed(Effect):
    """Friction that follows the slip speed: not the speed of this moment but, with a short memory, that of the last.

    Without the memory (Hess & Soom, J. Tribol. 112 (1990) 147, measured milliseconds) elements that begin to slip in
    mid-stroke would know the speed at once.
    """

    law_error = 0.1  # a slider's own speed is not quite the specimen's

    def memory(self) -> dict[str, Shape]:
        radian_s = 1e-3 * self.scales.length_mm / self.scales.speed_m_s
        return {
            "memory_s": Shape(
                "τ",
                "s",
                "time in which friction follows a change of slip speed",
                stats.lognorm(s=1.2, scale=0.2 * radian_s),
            )
        }

    def speed_m_s(self, motion: Motion, numbers: Numbers) -> Array:
        tau = self.get(numbers, "memory_s")
        speed = filtered(motion.speed_m_s, motion.frequency_hz, lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau))
        return np.maximum(speed, 0.0)


class StribeckWeakening(_OfSlipSpeed):
    name = "stribeck_weakening"
    strength = ("drop", "d", "-", "share of the friction that is lost at high slip speed")
    limit = 0.9
    physics = (
        "Friction falls from its static to a lower kinetic level with slip speed, as asperities have less time "
        "to bond or a film begins to carry; it follows a change of speed after a short memory."
    )
    reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    signature = "slipping force lower in mid-stroke than at its ends, more so at high frequency × amplitude"
    look_alikes = ("rate_strengthening",)
    bench = "very slow tests, 0.1 Hz and below"

    def first_guess(self) -> float:
        return 0.1

    def shapes(self) -> dict[str, Shape]:
        return {
            "v_s_m_s": Shape(
                "v_s",
                "m/s",
                "slip speed over which the friction falls",
                stats.lognorm(s=0.9, scale=0.2 * self.scales.speed_m_s),
            ),
            **self.memory(),
        }

    def slip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array:
        lost = -np.expm1(-self.speed_m_s(motion, numbers) / self.get(numbers, "v_s_m_s"))
        return alpha * (1.0 - self.get(numbers, "drop") * lost)


class RateStrengthening(_OfSlipSpeed):
    name = "rate_strengthening"
    strength = ("c", "c", "-", "growth of the friction per e-fold of slip speed")
    limit = 1.0
    physics = (
        "Friction grows with the logarithm of slip speed, after a short memory: thermally activated creep of "
        "the contacts."
    )
    reference = "Baumberger & Caroli, Adv. Phys. 55 (2006) 279"
    signature = "slipping force grows with log speed; odd harmonics; quadrature hardly depends on amplitude"
    look_alikes = ("stribeck_weakening", "viscous_damping")
    bench = "frequencies over two decades at one amplitude"

    def first_guess(self) -> float:
        return 0.03

    def shapes(self) -> dict[str, Shape]:
        return {
            "v0_m_s": Shape(
                "v₀",
                "m/s",
                "speed below which the friction is constant",
                stats.lognorm(s=1.2, scale=0.05 * self.scales.speed_m_s),
            ),
            **self.memory(),
        }

    def slip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array:
        ratio = self.speed_m_s(motion, numbers) / self.get(numbers, "v0_m_s")
        return alpha * (1.0 + self.get(numbers, "c") * np.log1p(ratio))


class NormalForceLag(Effect):
    name = "normal_force_lag"
    strength = ("tau_s", "τ", "s", "relaxation time of the normal force")
    limit = 0.5
    physics = "The compressed rope takes time to follow the spring's motion: α relaxes toward Eq. (11) with a time τ."
    reference = "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440, with a relaxing contact"
    signature = "the loop's asymmetry turns between the branches as frequency rises; even harmonics change phase"
    look_alikes = ("channel_delay",)
    bench = "very slow tests, where the lag vanishes"

    def first_guess(self) -> float:
        return 2e-4 * self.scales.length_mm / self.scales.speed_m_s

    def grip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array:
        tau = self.get(numbers, "tau_s")
        return np.maximum(filtered(alpha, motion.frequency_hz, lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau)), 0.02)


class FrictionFade(Effect):
    name = "friction_fade"
    strength = ("drop", "d", "-", "share of the friction that is lost in the end")
    limit = 0.9
    evolving = True
    physics = (
        "Friction falls over the cycles of a test toward a plateau: wear particles, polishing, or the polymer "
        "softening as it warms."
    )
    reference = "Fouvry et al., Wear 200 (1996) 186"
    signature = "loops grow thinner from cycle to cycle; trend in quadrature and odd harmonics, none in the mean"
    look_alikes = ()
    bench = "return to the first test after the last; rest, then repeat (heat recovers, wear does not)"

    def first_guess(self) -> float:
        return 0.1

    def shapes(self) -> dict[str, Shape]:
        return {"cycles": Shape("n₀", "-", "cycles over which it fades", stats.lognorm(s=0.8, scale=15.0), 1.0, 500.0)}

    def slip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array:
        gone = -np.expm1(-motion.cycle[:, None] / self.get(numbers, "cycles"))
        return alpha * (1.0 - self.get(numbers, "drop") * gone)


class DirectionDependentFriction(Effect):
    name = "direction_dependent_friction"
    strength = ("asymmetry", "a", "-", "friction × (1 ± asymmetry), + for slip in the direction of rising u")
    signed = True
    limit = 0.9
    physics = "The surface resists one direction of slip more than the other: fibre lay, wound rope, tilted asperities."
    reference = "Zmitrowicz, Int. J. Solids Struct. 25 (1989) 1407"
    signature = "even harmonics and a mean force, at every frequency and amplitude alike"
    look_alikes = ("quadratic_stiffness",)
    bench = "the specimen mounted the other way round"

    def first_guess(self) -> float:
        return 0.1

    def asymmetry(self, numbers: Numbers) -> Array:
        # not a matter of the motion's sign alone: at a reversal a sticking element keeps what it carries
        return numbers[self.strength_name]


EFFECTS: tuple[type[Effect], ...] = (
    StribeckWeakening,
    RateStrengthening,
    NormalForceLag,
    FrictionFade,
    DirectionDependentFriction,
)
