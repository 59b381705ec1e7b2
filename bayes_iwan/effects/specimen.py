"""Effects inside the specimen that add a force of their own, beside friction and the parallel spring."""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.effects.base import Effect, Motion, Shape, filtered


class ViscousDamping(Effect):
    name = "viscous_damping"
    strength = ("c_N_s_mm", "c", "N·s/mm", "viscous coefficient")
    physics = (
        "A force proportional to velocity beside the friction: oil, grease, squeezed air, or the matrix of the "
        "polymer at frequencies well above its relaxation."
    )
    reference = "Inman, Engineering Vibration, §1.3"
    signature = "quadrature force at the fundamental ∝ frequency × amplitude; loops grow fatter with frequency"
    look_alikes = ("maxwell_branch", "channel_delay", "force_lowpass", "rate_strengthening", "integration_highpass")
    bench = "the same tests at a frequency three times as high; a dummy elastic spring to see the channels' own phase"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / (1e3 * self.scales.speed_m_s)

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        return force_N + self.get(numbers, "c_N_s_mm") * 1e3 * motion.velocity_m_s


class MaxwellBranch(Effect):
    name = "maxwell_branch"
    strength = ("k_N_mm", "k_m", "N/mm", "stiffness of the branch")
    physics = (
        "A spring and a dashpot in series beside the rest: the polymer rope creeps, so part of its stiffness "
        "acts only above the frequency 1/(2πτ)."
    )
    reference = "Ferry, Viscoelastic Properties of Polymers, ch. 1"
    signature = "in-phase and quadrature force ∝ amplitude with a knee at 1/(2πτ); fundamental only for a sine"
    look_alikes = ("viscous_damping", "force_highpass", "integration_highpass")
    bench = "a test well below 1 Hz, where the branch is relaxed, or a step and hold"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.length_mm

    def shapes(self) -> dict[str, Shape]:
        return {"tau_s": Shape("τ", "s", "relaxation time", stats.lognorm(s=1.0, scale=0.012), 2e-4, 1.0)}

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        tau = self.get(numbers, "tau_s")

        def response(f: Array) -> Array:
            s = 2j * np.pi * f * tau
            return s / (1.0 + s)

        return force_N + self.get(numbers, "k_N_mm") * filtered(motion.displacement_mm, motion.frequency_hz, response)


class MovingMass(Effect):
    name = "moving_mass"
    strength = ("m_kg", "m", "kg", "mass between specimen and force cell")
    order = 1
    physics = (
        "Whatever moves between the specimen and the cell's sensing element, fixture and part of the specimen "
        "included, needs a force m·ü that the cell reads as if the specimen made it."
    )
    reference = "Ewins, Modal Testing, §3.4 (mass cancellation)"
    signature = "in-phase force falling with frequency squared; no work"
    look_alikes = ("maxwell_branch",)
    bench = "a run of the bare fixture; a known mass added"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N * self.scales.length_mm * 1e-3 / self.scales.speed_m_s**2

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        return force_N + self.get(numbers, "m_kg") * motion.acceleration_m_s2


class QuadraticStiffness(Effect):
    name = "quadratic_stiffness"
    strength = ("k2_N_mm2", "k₂", "N/mm²", "quadratic stiffness")
    signed = True
    physics = "The parallel spring is asymmetric: coils that touch on one side, or a preload off the middle."
    reference = "Nayfeh & Mook, Nonlinear Oscillations, §2.3"
    signature = "second harmonic in phase ∝ amplitude squared, at every frequency alike; no work"
    look_alikes = ("end_stop", "direction_dependent_friction")
    bench = "the same tests about a shifted mid-position"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.length_mm**2

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        return force_N + self.get(numbers, "k2_N_mm2") * motion.displacement_mm**2


class CubicStiffness(Effect):
    name = "cubic_stiffness"
    strength = ("k3_N_mm3", "k₃", "N/mm³", "cubic stiffness")
    signed = True
    physics = "The parallel spring hardens or softens symmetrically with stretch (geometry, coil contact, rubber)."
    reference = "Kovacic & Brennan, The Duffing Equation, ch. 2"
    signature = "in-phase first and third harmonics ∝ amplitude cubed, at every frequency alike; no work"
    look_alikes = ("end_stop", "force_clipping")
    bench = "larger amplitudes"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.length_mm**3

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        return force_N + self.get(numbers, "k3_N_mm3") * motion.displacement_mm**3


class EndStop(Effect):
    name = "end_stop"
    strength = ("k_N_mm", "k_s", "N/mm", "stiffness of the contact; negative: the stop is on the side u < −gap")
    signed = True
    sudden = True
    physics = "Beyond a displacement the moving part meets a stop, a coil closes, or the rope's end is reached."
    reference = "Shaw & Holmes, J. Sound Vib. 90 (1983) 129"
    signature = "nothing below the gap; beyond it a one-sided force, all harmonics in phase, at every frequency alike"
    look_alikes = ("cubic_stiffness", "quadratic_stiffness")
    bench = "amplitudes just below and above the gap"

    def first_guess(self) -> float:
        return self.scales.slip_N / self.scales.length_mm

    def shapes(self) -> dict[str, Shape]:
        a = self.scales.length_mm
        return {
            "gap_mm": Shape(
                "g",
                "mm",
                "displacement at which contact begins",
                stats.lognorm(s=0.35, scale=0.75 * a),
                0.02 * a,
                0.99 * a,
            )
        }

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        k = self.get(numbers, "k_N_mm")
        side = np.where(k < 0.0, -1.0, 1.0)
        return force_N + k * np.maximum(side * motion.displacement_mm - self.get(numbers, "gap_mm"), 0.0)


EFFECTS: tuple[type[Effect], ...] = (
    ViscousDamping,
    MaxwellBranch,
    MovingMass,
    QuadraticStiffness,
    CubicStiffness,
    EndStop,
)
