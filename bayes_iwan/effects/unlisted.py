"""Patterns of force that stand for no cause of the catalogue: what makes "unknown" sharper than a smooth misfit.

A catalogue can always close part of a gap whose cause it lacks: weakening with speed imitates a drag. A smooth
discrepancy alone is a weak rival to that, since it must learn the misfit of every test anew. These patterns say
in a few parameters how such gaps run; a named effect has to beat them too, and where one of them wins the answer is
"unknown", with the pattern reported. They name no cause: many mechanisms share each of them.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion


class SpeedSquared(Effect):
    name = "speed_squared"
    strength = ("c_N_s2_m2", "c", "N·s²/m²", "force over speed squared")
    physics = "a force against the motion that grows with the square of speed, as fluid in an orifice makes it"
    reference = "Nayfeh & Mook, Nonlinear Oscillations, §3.3.2"
    signature = "quadrature at the fundamental and third harmonic ∝ (frequency × amplitude)²"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.speed_m_s**2

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        v = motion.velocity_m_s
        return force_N + self.get(parameter_values, "c_N_s2_m2") * v * np.abs(v)


class BreakAway(Effect):
    name = "break_away"
    strength = ("rise", "r", "-", "share by which friction is higher after a reversal")
    physics = "friction that is higher after each reversal and wears off as the contact slides"
    reference = "Dieterich, J. Geophys. Res. 84 (1979) 2161"
    signature = "a hump in the friction force after each reversal, at every frequency alike"
    limit = 5.0

    def first_guess(self) -> float:
        return 0.1

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        a = self.scales.length_mm
        return {
            "slide_mm": ExtraParameter(
                "ℓ", "mm", "way over which it wears off", stats.lognorm(s=0.8, scale=0.3 * a), 0.01 * a, 10.0 * a
            )
        }

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        u = motion.displacement_mm
        since = np.where(
            motion.velocity_m_s > 0.0, u - u.min(axis=-1, keepdims=True), u.max(axis=-1, keepdims=True) - u
        )

        def raised(own: ParameterValues) -> Array:
            return 1.0 + self.get(own, "rise") * np.exp(-since / self.get(own, "slide_mm"))

        return alpha * self.own(raised, motion, parameter_values)


EFFECTS: tuple[type[Effect], ...] = (SpeedSquared, BreakAway)
