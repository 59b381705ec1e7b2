"""Shapes of force that stand for no cause of the catalogue: what makes "unknown" sharper than a smooth misfit.

A catalogue can always close part of a gap whose cause it lacks: weakening with speed imitates a drag, a cubic spring a
stop on both sides. A smooth discrepancy alone is a weak rival to that, since it must learn the misfit of every test
anew. These shapes say in one or two numbers how such gaps run; a named effect has to beat them too, and where one of
them wins the answer is "unknown", with the shape told. They name no cause: many mechanisms share each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.effects.base import Effect, Motion, Shape
from bayes_iwan.inference.parameters import Parameter


class SpeedSquared(Effect):
    name = "speed_squared"
    strength = ("c_N_s2_m2", "c", "N·s²/m²", "force over speed squared")
    physics = "a force against the motion that grows with the square of speed, as fluid pushed through a gap makes it"
    reference = "gap-notes, row 17"
    signature = "quadrature at the fundamental and third harmonic ∝ (frequency × amplitude)²"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.speed_m_s**2

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        v = motion.velocity_m_s
        return force_N + self.get(numbers, "c_N_s2_m2") * v * np.abs(v)


class BothEnds(Effect):
    name = "both_ends"
    strength = ("k_N_mm", "k", "N/mm", "stiffness near the ends, at the largest amplitude's length of contact")
    physics = "an elastic force near both ends of the stroke that grows faster than the way into it, as of round stops"
    reference = "Johnson, Contact Mechanics, ch. 4 (exponent 3/2)"
    signature = "nothing in mid-stroke; odd harmonics in phase, at every frequency alike"

    def first_guess(self) -> float:
        return self.scales.slip_N / self.scales.length_mm

    def shapes(self) -> dict[str, Shape]:
        a = self.scales.length_mm
        return {
            "gap_mm": Shape(
                "g", "mm", "displacement at which it begins", stats.lognorm(s=0.35, scale=0.7 * a), 0.02 * a, 0.99 * a
            )
        }

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        u = motion.displacement_mm
        deep = np.maximum(np.abs(u) - self.get(numbers, "gap_mm"), 0.0)
        return force_N + np.sign(u) * self.get(numbers, "k_N_mm") * deep * np.sqrt(deep / self.scales.length_mm)


class BreakAway(Effect):
    name = "break_away"
    strength = ("rise", "r", "-", "share by which friction is higher after a reversal")
    physics = "friction that is higher after each reversal and wears off as the contact slides"
    reference = "gap-notes, row 21; Dieterich, J. Geophys. Res. 84 (1979) 2161"
    signature = "a hump in the friction force after each reversal, at every frequency alike"
    limit = 5.0

    def first_guess(self) -> float:
        return 0.1

    def shapes(self) -> dict[str, Shape]:
        a = self.scales.length_mm
        return {
            "slide_mm": Shape(
                "ℓ", "mm", "way over which it wears off", stats.lognorm(s=0.8, scale=0.3 * a), 0.01 * a, 10.0 * a
            )
        }

    def slip(self, alpha: Array, motion: Motion, numbers: Numbers) -> Array:
        u = motion.displacement_mm
        since = np.where(
            motion.velocity_m_s > 0.0, u - u.min(axis=-1, keepdims=True), u.max(axis=-1, keepdims=True) - u
        )
        return alpha * (1.0 + self.get(numbers, "rise") * np.exp(-since / self.get(numbers, "slide_mm")))


@dataclass(frozen=True)
class _ByTest(Effect):
    """An elastic force with a size of its own in every test."""

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        prior = stats.norm(scale=self.first_guess() if self.strength_value is None else self.strength_value)
        return tuple(
            Parameter(f"{self.name}.force_N[{test}]", "F", "N", f"{self.strength[3]}, in {test}", prior)
            for test in self.tests
        )

    def share(self, motion: Motion) -> Array:
        """How much of it there is in each loop, (loops,)."""
        return np.ones(motion.loops)

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        by_test = np.stack([numbers[f"{self.name}.force_N[{test}]"] for test in self.tests], axis=1)
        part = by_test[:, motion.test] * (self.share(motion) / motion.amplitude_mm)
        return force_N + part[..., None] * motion.displacement_mm

    def reported(self, values: Mapping[str, Array], force_N: Callable[[], Array]) -> dict[str, tuple[Array, str]]:
        own = np.stack([values[p.name] for p in self.parameters], axis=1)
        return {"force_N": (np.sqrt(np.mean(own * own, axis=1)), "N")}


class DifferingTests(_ByTest):
    name = "tests_differ"
    strength = ("force_N", "F", "N", "further elastic force at the amplitude")
    physics = "a stiffness that differs from test to test, as a specimen that was mounted anew between tests has it"
    reference = "gap-notes, row 27"
    signature = "in-phase fundamental that follows neither frequency nor amplitude"


class ChangingStiffness(_ByTest):
    name = "stiffness_changes"
    strength = ("force_N", "F", "N", "change of the elastic force at the amplitude within some ten cycles")
    evolving = True
    physics = "a stiffness that changes along the records, in each its own way, as a part that warms or settles has it"
    reference = "gap-notes, row 25"
    signature = "trend of the in-phase fundamental, and none of the friction"

    def share(self, motion: Motion) -> Array:
        return -np.expm1(-motion.cycle / 10.0)


EFFECTS: tuple[type[Effect], ...] = (SpeedSquared, BothEnds, BreakAway, DifferingTests, ChangingStiffness)
