"""Effects of rig and mounting in series with the specimen: it moves less than was measured."""

from __future__ import annotations

import math
from collections.abc import Callable

import numba as nb
import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion, moved_by
from bayes_iwan.models.kernels import pointwise

#: passes over the loop that settle how far the rig gives, or where the force crosses zero
PASSES = 4
#: a secant stiffness of the specimen is believed up to this many times the stiffness after reversals
STIFFEST = 5.0


class RigCompliance(Effect):
    name = "rig_compliance"
    flexible = True  # other slip forces imitate nearly all of it, and it imitates theirs
    law = "u − C·(F + (ρ − 1)·F₁·(1 − e^(−|F|/F₁))·sgn F); ρ = 1: linear, ρ > 1: softer at small forces"
    strength = ("compliance_mm_N", "C", "mm/N", "compliance in series")
    order = 1
    physics = "Fixture, glue and force cell give under the force, so the specimen moves by u − C·F."
    reference = "ISO 7626-5 (impedance of fixtures); Bickford, Introduction to the Design and Behavior of Bolted Joints"
    signature = "every stiffness lowered at once; hardly any shape of its own: absorbed by k and the slip forces"
    look_alikes = ("free_play",)
    bench = "a second accelerometer across the fixture"
    remedy = "Measure the displacement across the specimen itself, or stiffen the fixture."

    def first_guess(self) -> float:
        return 0.02 * self.scales.length_mm / self.scales.force_N

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "soft_ratio": ExtraParameter(
                "ρ",
                "-",
                "compliance at small forces over that at large ones",
                stats.lognorm(s=0.7, scale=1.0),
            ),
            "soft_N": ExtraParameter(
                "F₁",
                "N",
                "force over which a soft first part closes",  # over much less it is a play with soft ends
                stats.lognorm(s=0.35, scale=0.4 * self.scales.force_N),
                scan=False,
            ),
        }

    def around(self, inner: Callable[[Motion], Array], motion: Motion, parameter_values: ParameterValues) -> Array:
        compliance, first_N, ratio = (
            np.ascontiguousarray(parameter_values[f"{self.name}.{n}"])
            for n in ("compliance_mm_N", "soft_N", "soft_ratio")
        )
        u = np.ascontiguousarray(motion.displacement_mm)
        force = inner(motion)
        at = u + np.zeros_like(force)
        step, stiffness = np.zeros_like(force), np.zeros_like(force)
        least, most = 1e-12 * self.scales.length_mm, STIFFEST * self.scales.stiff_N_mm
        for _ in range(PASSES):  # Newton's method with the secant stiffness of the last two passes, sample by sample
            pointwise.give_step(u, force, compliance, ratio - 1.0, first_N, stiffness, at, step)
            before, force = force, np.ascontiguousarray(inner(moved_by(motion, at)))
            pointwise.secants(force, before, step, least, most, stiffness)
        return force


_jit = nb.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _softplus(x):
    """ln(1 + e^x), at large x without overflow."""
    return x + math.log1p(math.exp(-x)) if x > 0.0 else math.log1p(math.exp(x))


@_jit
def _play(u, velocity, force, specimen, half, soft, crossing, out):
    """One pass: where the force crosses zero on each branch (rising, falling), and the specimen's motion that follows:
    at rest within the play, and over a share `soft` of it gradually with the rig at its ends.

    `specimen` is the motion that gave `force`; `crossing` (draws, loops, 2) is updated in place.
    """
    draws, loops, samples = force.shape
    for d in range(draws):
        m = d % u.shape[0]
        for j in range(loops):
            for branch in range(2):
                rising = branch == 0
                nearest, at, found = np.inf, 0.0, False
                for i in range(samples):
                    before = i - 1 if i > 0 else samples - 1
                    if (velocity[m, j, i] > 0.0) != rising:
                        continue
                    f0, f1 = force[d, j, before], force[d, j, i]
                    x0, x1 = specimen[d, j, before], specimen[d, j, i]
                    if (f0 < 0.0) != (f1 < 0.0) and (f1 >= f0) == rising and f0 != f1:
                        at, found = x0 - f0 * (x1 - x0) / (f1 - f0), True
                        break
                    if abs(f1) < nearest:
                        nearest = abs(f1)
                if found:
                    crossing[d, j, branch] = at
                elif np.isnan(crossing[d, j, branch]):
                    # the force keeps one sign on this branch: the play never opens there
                    crossing[d, j, branch] = -np.inf if force[d, j, 0] > 0.0 else np.inf
            for i in range(samples):
                c = crossing[d, j, 0] if velocity[m, j, i] > 0.0 else crossing[d, j, 1]
                x = u[m, j, i]
                width = soft[d] * half[d]
                if math.isinf(c) or not abs(abs(x - c) - half[d]) < 40.0 * width:
                    out[d, j, i] = min(max(c, x - half[d]), x + half[d])
                else:
                    ahead, behind = (x - c - half[d]) / width, (c - x - half[d]) / width
                    out[d, j, i] = c + width * (_softplus(ahead) - _softplus(behind))


class FreePlay(Effect):
    name = "free_play"
    law = "a dead zone of width δ about zero force; its ends close within the share w of it (w → 0: hard)"
    strength = ("play_mm", "δ", "mm", "width of the play")
    order = 1
    physics = (
        "Backlash in series (a loose thread or pin): while the play is crossed no force is carried, so the "
        "measured force stays at zero; beyond it the specimen follows at half the play's distance."
    )
    reference = (
        "Nordin & Gutman, Automatica 38 (2002) 1633; Kim, Rook & Singh, J. Sound Vib. 263 (2003) 665 (smoothed ends)"
    )
    signature = "a flat at zero force on both branches, of the same width at every amplitude and frequency"
    look_alikes = ("rig_compliance",)
    bench = "preload that keeps the force of one sign; a second accelerometer across the joint"
    remedy = "Tighten the joint, or preload it so that its force keeps one sign."

    def first_guess(self) -> float:
        return 0.02 * self.scales.length_mm

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "softness": ExtraParameter(
                "w",
                "-",
                "way over which the ends close, over half the play",
                stats.lognorm(s=1.0, scale=0.05),
                1e-4,
                1.0,
                scan=False,
            )
        }

    def around(self, inner: Callable[[Motion], Array], motion: Motion, parameter_values: ParameterValues) -> Array:
        half, soft = 0.5 * parameter_values[self.strength_name], parameter_values[f"{self.name}.softness"]
        force = inner(motion)
        draws = len(half)
        u = np.ascontiguousarray(motion.displacement_mm)
        velocity = np.ascontiguousarray(motion.velocity_m_s)
        specimen = np.broadcast_to(u, force.shape).copy()
        crossing = np.full((draws, *force.shape[1:2], 2), np.nan)
        for _ in range(PASSES):
            moved = np.empty_like(force)
            _play(u, velocity, force, specimen, half, soft, crossing, moved)
            specimen = moved
            force = inner(moved_by(motion, specimen))
        return force


EFFECTS: tuple[type[Effect], ...] = (RigCompliance, FreePlay)
