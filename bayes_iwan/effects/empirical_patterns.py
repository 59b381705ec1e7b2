"""Patterns of force that stand for no cause of the catalogue: what makes "unknown" sharper than a smooth discrepancy.

A catalogue can always close part of a gap whose cause it lacks: weakening with speed imitates a drag. A smooth
discrepancy alone is a weak alternative to that, since it must learn the gap of every test anew. These patterns say
in a few parameters how such gaps run; a named effect has to beat them too, and where one of them wins the answer is
"unknown", with the pattern reported. They name no cause: many mechanisms share each of them.
"""

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion, moved_by, require_loops
from bayes_iwan.effects.law_families import lognormal
from bayes_iwan.models.kernels.relaxing import lagging


class SpeedSquared(Effect):
    name = "speed_squared"
    needs_clock = True
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
                "ℓ", "mm", "way over which it wears off", lognormal(0.3 * a, 0.8), 0.01 * a, 10.0 * a
            )
        }

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        require_loops(motion)
        u = motion.displacement_mm
        since = np.where(
            motion.velocity_m_s > 0.0, u - u.min(axis=-1, keepdims=True), u.max(axis=-1, keepdims=True) - u
        )

        def raised(own: ParameterValues) -> Array:
            return 1.0 + self.get(own, "rise") * np.exp(-since / self.get(own, "slide_mm"))

        return alpha * self.own(raised, motion, parameter_values)


def lag_behind(signal: Array, motion: Motion, path: Array) -> Array:
    """How far along (−1 to 1) a reading lags that gives way over a path ℓ (draws,) after each reversal, whatever the
    speed: (draws, loops, samples). Its loops are those of Dahl (1968), of Coleman and Hodgdon in their linear case."""
    require_loops(motion)
    out = np.empty((max(len(signal), len(path)), *signal.shape[1:]))
    lagging(np.ascontiguousarray(signal), np.maximum(path, 1e-300), out)
    return out


class LaggingForce(Effect):
    name = "lagging_force"
    law = "F − L·z, ℓ dz = (sgn dF − z)|dF|"
    strength = ("lag_N", "L", "N", "how far the reading lags at most")
    order = 2
    physics = "a force reading that lags after every reversal, as a force cell with hysteresis does"
    reference = "Coleman & Hodgdon, Int. J. Engng Sci. 24 (1986) 897; ISO 376 (reversibility of force transducers)"
    signature = "dissipation that grows with the whole force, the spring's too, and not with speed"

    def first_guess(self) -> float:
        return 0.05 * self.scales.force_N

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "path_N": ExtraParameter(
                "ℓ", "N", "force over which it gives way", lognormal(0.3 * self.scales.force_N, 1.0)
            )
        }

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return force_N - self.get(parameter_values, "lag_N") * lag_behind(
            force_N, motion, parameter_values[f"{self.name}.path_N"]
        )


class LaggingReading(Effect):
    name = "lagging_reading"
    law = "u + L·z, ℓ dz = (sgn du − z)|du|: where the specimen is, from where it is read"
    strength = ("lag_mm", "L", "mm", "how far the reading lags at most")
    order = -1
    physics = (
        "a displacement reading that lags after every reversal, as a sensor with hysteresis or a slack coupling does"
    )
    reference = "Coleman & Hodgdon, Int. J. Engng Sci. 24 (1986) 897; ISO 230-2 (reversal value)"
    signature = "the whole force, the spring's too, runs ahead of the displacement by the same way at every speed"

    def first_guess(self) -> float:
        return 0.01 * self.scales.length_mm

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "path_mm": ExtraParameter(
                "ℓ", "mm", "way over which it gives way", lognormal(0.1 * self.scales.length_mm, 1.0)
            )
        }

    def motion(self, motion: Motion, parameter_values: ParameterValues) -> Motion:
        ahead = self.own(
            lambda own: (
                self.get(own, "lag_mm") * lag_behind(motion.displacement_mm, motion, own[f"{self.name}.path_mm"])
            ),
            motion,
            parameter_values,
        )
        return moved_by(motion, motion.displacement_mm + ahead)


EFFECTS: tuple[type[Effect], ...] = (SpeedSquared, BreakAway, LaggingForce, LaggingReading)
