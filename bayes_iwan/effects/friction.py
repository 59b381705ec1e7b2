"""Effects on the friction itself: what the elements can carry."""

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion, filtered, form
from bayes_iwan.effects.law_families import about, falling, growing, lognormal, lost_within, over_block, power_of


class _OfSlipSpeed(Effect):
    """Friction that follows the slip speed: not the speed of this moment but, with a short memory, that of the last.

    Without the memory (Hess & Soom, J. Tribol. 112 (1990) 147, measured milliseconds) elements that begin to slip in
    mid-stroke would know the speed at once.
    """

    law_error = 0.1  # a slider's own speed is not quite the specimen's

    def memory(self) -> dict[str, ExtraParameter]:
        radian_s = 1e-3 * self.scales.length_mm / self.scales.speed_m_s
        return {
            "memory_s": ExtraParameter(
                "τ", "s", "time in which friction follows a change of slip speed", lognormal(0.2 * radian_s, 1.2)
            )
        }

    def speed_m_s(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        tau = self.get(parameter_values, "memory_s")
        speed = filtered(motion.speed_m_s, motion, lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau))
        return np.maximum(speed, 0.0)


class StribeckWeakening(_OfSlipSpeed):
    name = "stribeck_weakening"
    needs_clock = True
    law = (
        "1 − d·(1 − (1 + q x)^(−1/q)), x = (v/v_s)^δ; q → 0, δ = 1: exponential (Tustin), δ = 2: Gaussian; "
        "q = 1, δ = 2: Lorentzian (Hess & Soom)"
    )
    strength = ("drop", "d", "-", "share of the friction that is lost at high slip speed")
    limit = 0.9
    physics = (
        "Friction falls from its static to a lower kinetic level with slip speed, as asperities have less time "
        "to bond or a film begins to carry; it follows a change of speed after a short memory."
    )
    reference = (
        "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083; Bo & Pavelescu, Wear 82 (1982) 277 "
        "(exponent δ); Hess & Soom, J. Tribol. 112 (1990) 147 (Lorentzian)"
    )
    signature = "slipping force lower in mid-stroke than at its ends, more so at high frequency × amplitude"
    look_alikes = ("rate_strengthening",)
    bench = "tests ten times slower than the slowest"
    remedy = "Give the model's friction a falling characteristic, or a lubricant whose friction does not fall."

    def first_guess(self) -> float:
        return 0.1

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "v_s_m_s": ExtraParameter(
                "v_s", "m/s", "slip speed over which the friction falls", lognormal(0.2 * self.scales.speed_m_s, 0.9)
            ),
            **self.memory(),
            "exponent": form("δ", "exponent of the speed", lognormal(1.0, 0.4), 0.3, 1.0 / 0.3),
            "tail": form("q", "0: exponential, 1: Lorentzian for δ = 2", lognormal(0.05, 1.5)),
        }

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        def left(own: ParameterValues) -> Array:
            x = power_of(self.speed_m_s(motion, own) / self.get(own, "v_s_m_s"), self.get(own, "exponent"))
            return 1.0 - self.get(own, "drop") * (1.0 - falling(x, self.get(own, "tail")))

        return alpha * self.own(left, motion, parameter_values)


class RateStrengthening(_OfSlipSpeed):
    name = "rate_strengthening"
    needs_clock = True
    law = "1 + c·((1 + v/v₀)^q − 1)/q; q → 0: c·ln(1 + v/v₀), close to arsinh (Prandtl–Eyring); q > 0: a power"
    strength = ("c", "c", "-", "growth of the friction per e-fold of slip speed")
    limit = 1.0
    physics = (
        "Friction grows with the logarithm of slip speed, or a small power of it, after a short memory: thermally "
        "activated creep of the contacts."
    )
    reference = (
        "Baumberger & Caroli, Adv. Phys. 55 (2006) 279 (logarithm); Rice, Lapusta & Ranjith, J. Mech. Phys. Solids 49 "
        "(2001) 1865 (arsinh); Briscoe & Tabor, J. Adhesion 9 (1978) 145 (polymers, small powers)"
    )
    signature = "slipping force grows with log speed; odd harmonics; quadrature hardly depends on amplitude"
    look_alikes = ("stribeck_weakening", "viscous_damping")
    bench = "frequencies over two decades at one amplitude"
    remedy = "Give the model's friction a rising characteristic, or quote it for the speed of use."

    def first_guess(self) -> float:
        return 0.03

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "v0_m_s": ExtraParameter(
                "v₀", "m/s", "speed below which the friction is constant", lognormal(0.05 * self.scales.speed_m_s, 1.2)
            ),
            **self.memory(),
            "power": form("q", "0: logarithm, 1: proportional", about(0.0, 0.3), -0.9, 0.9),
        }

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        def grown(own: ParameterValues) -> Array:
            ratio = self.speed_m_s(motion, own) / self.get(own, "v0_m_s")
            return 1.0 + self.get(own, "c") * growing(ratio, self.get(own, "power"))

        return alpha * self.own(grown, motion, parameter_values)


class _FromCycleToCycle(Effect):
    """What is lost from cycle to cycle."""

    evolving = True

    def left(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        """The share that is left in each loop, (draws, loops, 1)."""
        raise NotImplementedError

    def within(self, values: ParameterValues, blocks: Motion) -> dict[str, tuple[Array, str]]:
        return lost_within(self.left(blocks, values), blocks)


class FrictionFade(_FromCycleToCycle):
    name = "friction_fade"
    law = (
        "1 − d·(2π f A/v)^p·(1 − (1 + q x)^(−1/q))·e^(−r x), x = (n/n₀)·(A/ℓ)^m·(v/(2π f ℓ))^h; q → 0: exponential, "
        "1: hyperbolic, large: logarithmic; m = h = 0: by cycles, m = 1: by sliding distance or work, h = 1: by time; "
        "p = 1: with the power that friction turns to heat; r > 0: it recovers; the stiffness loses the share s of it"
    )
    strength = ("drop", "d", "-", "share of the friction that is lost in the end")
    limit = 0.9
    physics = (
        "Friction falls over the cycles of a test toward a plateau: wear particles, polishing, or the polymer "
        "softening as it warms; what softens as it warms loses stiffness, too."
    )
    reference = (
        "Fouvry, Kapsa & Vincent, Wear 200 (1996) 186 (dissipated work); Blau, Tribol. Int. 38 (2005) 1007 (running-in "
        "curves); Archard, J. Appl. Phys. 24 (1953) 981 (sliding distance); Ettles, ASLE Trans. 29 (1986) 321 (thermal "
        "control of friction)"
    )
    signature = "loops grow thinner from cycle to cycle; trend in quadrature and odd harmonics, none in the mean"
    look_alikes = ("spring_softening",)
    bench = "return to the first test after the last; pause, then repeat (heat recovers, wear does not)"
    remedy = "Run the specimen in before measuring, let it cool between tests, and state the cycle that values are for."

    def first_guess(self) -> float:
        return 0.1

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "cycles": ExtraParameter("n₀", "-", "cycles over which it fades", lognormal(15.0, 1.0), 0.5, 2000.0),
            "tail": form("q", "0: exponential, 1: hyperbolic, large: logarithm", lognormal(0.1, 1.8)),
            "recovery": form("r", "pace of the recovery over that of the fade", lognormal(0.01, 1.8)),
            "by_stroke": form("m", "power of the amplitude in the pace", about(0.0, 0.7), -3.0, 3.0),
            "by_time": form("h", "0: by cycles, 1: by time", about(0.0, 0.6), -2.5, 2.5),
            "by_power": form("p", "power of amplitude × frequency in the loss", about(0.0, 0.6), -2.5, 2.5),
            "of_stiffness": form("s", "share of the loss that the stiffness follows", about(0.0, 0.4), -1.5, 1.5),
        }

    def left(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        """The share of the friction that is left in each loop, (draws, loops, 1)."""
        cycles, tail, recovery, stroke, by_time, by_power, drop = (
            parameter_values[f"{self.name}.{n}"][:, None]
            for n in ("cycles", "tail", "recovery", "by_stroke", "by_time", "by_power", "drop")
        )
        omega = 2e-3 * np.pi * motion.frequency_hz / self.scales.speed_m_s  # over the speed, 1/mm
        pace = (motion.amplitude_mm / self.scales.length_mm) ** stroke / cycles
        pace = pace / (omega * self.scales.length_mm) ** by_time
        lost = over_block(motion, lambda n: (1.0 - falling(n * pace, tail)) * np.exp(-recovery * n * pace))
        return np.maximum(1.0 - drop * (omega * motion.amplitude_mm) ** by_power * lost, 0.05)[:, :, None]

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return alpha * self.left(motion, parameter_values)

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return k * self.left(motion, parameter_values) ** self.get(parameter_values, "of_stiffness")


class SpringSoftening(_FromCycleToCycle):
    name = "spring_softening"
    law = (
        "1 − d·(2π f A/v)^p·(A/ℓ)^r·(1 − (1 + q x)^(−1/q)), x = (t/τ)·(2π f ℓ/v)^m, of all springs; m = 0: by time, "
        "1: by cycles; p = 1: with the power that friction turns to heat, r that of loops that widen with the amplitude"
    )
    strength = ("drop", "d", "-", "share of the stiffness that is lost in the end")
    limit = 0.9
    physics = (
        "The springs soften along a test, the friction stays: a rubber or polymer that warms, with time or with the "
        "power lost in it, or the stress softening of a filled rubber in its first cycles."
    )
    reference = (
        "Mullins, Rubber Chem. Technol. 42 (1969) 339 (stress softening); Payne, J. Appl. Polym. Sci. 6 (1962) 57; "
        "Ferry, Viscoelastic Properties of Polymers, 3rd ed. (1980), ch. 11 (temperature)"
    )
    signature = "loops lean over from cycle to cycle while their height stays; trend in phase, little in quadrature"
    look_alikes = ("friction_fade",)
    bench = "return to the first test after a pause: heat recovers; a thermometer on the specimen"
    remedy = "Let the specimen reach its working temperature before measuring, and state it beside the values."

    def first_guess(self) -> float:
        return 0.05

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        cycle_s = 2e-3 * np.pi * self.scales.length_mm / self.scales.speed_m_s
        return {
            "tau_s": ExtraParameter("τ", "s", "time over which they soften", lognormal(15.0 * cycle_s, 1.0)),
            "tail": form("q", "0: exponential, 1: hyperbolic, large: logarithm", lognormal(0.1, 1.8)),
            "by_cycles": form("m", "0: by time, 1: by cycles", about(0.0, 0.6), -2.5, 2.5),
            "by_power": form("p", "power of amplitude × frequency in the loss", about(0.0, 0.6), -2.5, 2.5),
            "by_amplitude": form("r", "power of the amplitude in the loss beside that", about(0.0, 0.4), -2.0, 2.0),
        }

    def left(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        """The share of the stiffness that is left in each loop, (draws, loops, 1)."""
        tau, tail, by_cycles, by_power, drop = (
            parameter_values[f"{self.name}.{n}"][:, None] for n in ("tau_s", "tail", "by_cycles", "by_power", "drop")
        )
        by_amplitude = parameter_values[f"{self.name}.by_amplitude"][:, None]
        omega = 2e-3 * np.pi * motion.frequency_hz / self.scales.speed_m_s  # over the speed, 1/mm
        pace = (omega * self.scales.length_mm) ** by_cycles / (motion.frequency_hz * tau)
        still = over_block(motion, lambda n: falling(n * pace, tail))
        loss = drop * (omega * motion.amplitude_mm) ** by_power
        loss = loss * (motion.amplitude_mm / self.scales.length_mm) ** by_amplitude
        return np.maximum(1.0 - loss * (1.0 - still), 0.05)[:, :, None]

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return k * self.left(motion, parameter_values)

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        if "kp_N_mm" not in parameter_values:  # a simulator without a parallel spring
            return force_N
        lost = 1.0 - self.left(motion, parameter_values)
        return force_N - lost * parameter_values["kp_N_mm"][:, None, None] * motion.displacement_mm


class DirectionDependentFriction(Effect):
    name = "direction_dependent_friction"
    law = "slip forces × (1 ± a), whole from the reversal on"
    strength = ("asymmetry", "a", "-", "friction × (1 ± asymmetry), + for slip in the direction of rising u")
    signed = True
    limit = 0.9
    physics = (
        "The surface resists one direction of slip more than the other: fibre lay, wound rope, inclined asperities."
    )
    reference = "Zmitrowicz, Int. J. Solids Struct. 25 (1989) 1407"
    signature = "even harmonics and a mean force, at every frequency and amplitude alike"
    look_alikes = ("quadratic_stiffness",)
    bench = "the specimen mounted the other way round"
    remedy = "Give the model two friction levels, one for each direction, or turn every second specimen round."

    def first_guess(self) -> float:
        return 0.1

    def asymmetry(self, parameter_values: ParameterValues) -> Array:
        # not a matter of the motion's sign alone: at a reversal a sticking element keeps what it carries
        return parameter_values[self.strength_name]


class DirectionDependentNormalForce(DirectionDependentFriction):
    """Direction dependence of the normal force, as of a wedge or a wound rope that tightens itself: the stiffness
    follows it, and it turns over with the motion rather than at once."""

    law = "normal force × (1 + a·tanh(v/v₀)): a self-tightening contact, whose stiffness follows"
    reference = (
        "Budynas & Nisbett, Shigley's Mechanical Engineering Design, ch. 16 (self-energizing brakes); Zmitrowicz, Int. "
        "J. Solids Struct. 25 (1989) 1407"
    )

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "v0_m_s": ExtraParameter(
                "v₀", "m/s", "speed over which it turns over", lognormal(0.15 * self.scales.speed_m_s, 0.8), scan=False
            )
        }

    def asymmetry(self, parameter_values: ParameterValues) -> Array:
        return np.zeros_like(parameter_values[self.strength_name])

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return alpha * self.leaning(motion, parameter_values)

    def leaning(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        """1 + a·tanh(v/v₀), (draws, loops, samples)"""
        turned = np.tanh(motion.velocity_m_s / self.get(parameter_values, "v0_m_s"))
        return 1.0 + self.get(parameter_values, "asymmetry") * turned


class DirectionDependentSlip(DirectionDependentNormalForce):
    """The same of the slip forces alone: asperities that lean, and yield the more the faster they are met."""

    law = "slip forces × (1 + a·tanh(v/v₀)): turns over with the motion, the stiffness stays"
    reference = DirectionDependentFriction.reference

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return alpha

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return alpha * self.leaning(motion, parameter_values)


EFFECTS: tuple[type[Effect], ...] = (
    StribeckWeakening,
    RateStrengthening,
    FrictionFade,
    SpringSoftening,
    DirectionDependentFriction,
    DirectionDependentNormalForce,
    DirectionDependentSlip,
)
