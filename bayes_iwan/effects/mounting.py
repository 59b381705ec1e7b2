"""Effects of rig and mounting in series with the specimen: it moves less than was measured."""

from __future__ import annotations

from collections.abc import Callable

import numba as nb
import numpy as np

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.effects.base import Effect, Motion, moved_by

#: fixed-point passes over the loop; each shrinks the error by compliance × stiffness, or settles the zero crossings
PASSES = 4


class RigCompliance(Effect):
    name = "rig_compliance"
    strength = ("compliance_mm_N", "C", "mm/N", "compliance in series")
    order = 1
    physics = "Fixture, glue and force cell give under the force, so the specimen moves by u − C·F."
    reference = "ISO 7626-5 (impedance of fixtures)"
    signature = "every stiffness lowered at once; hardly any shape of its own: absorbed by k and the slip forces"
    look_alikes = ("free_play",)
    bench = "a second accelerometer across the fixture"

    def first_guess(self) -> float:
        return 0.02 * self.scales.length_mm / self.scales.force_N

    def around(self, inner: Callable[[Motion], Array], motion: Motion, numbers: Numbers) -> Array:
        compliance = self.get(numbers, "compliance_mm_N")
        force = inner(motion)
        for _ in range(PASSES):
            force = inner(moved_by(motion, motion.displacement_mm - compliance * force))
        return force


@nb.njit(cache=True, error_model="numpy")
def _play(u, velocity, force, specimen, half, crossing, out):
    """One pass: where the force crosses zero on each branch (rising, falling), and the specimen's motion that follows.

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
                out[d, j, i] = min(max(c, x - half[d]), x + half[d])


class FreePlay(Effect):
    name = "free_play"
    strength = ("play_mm", "δ", "mm", "width of the play")
    order = 1
    physics = (
        "Backlash in series (a loose thread or pin): while the play is crossed no force is carried, so the "
        "measured force rests at zero; beyond it the specimen follows at half the play's distance."
    )
    reference = "Nordin & Gutman, Automatica 38 (2002) 1633"
    signature = "a flat at zero force on both branches, of the same width at every amplitude and frequency"
    look_alikes = ("rig_compliance",)
    bench = "preload that keeps the force of one sign; a second accelerometer across the joint"

    def first_guess(self) -> float:
        return 0.02 * self.scales.length_mm

    def around(self, inner: Callable[[Motion], Array], motion: Motion, numbers: Numbers) -> Array:
        half = 0.5 * numbers["free_play.play_mm"]
        force = inner(motion)
        draws = len(half)
        u = np.ascontiguousarray(motion.displacement_mm)
        velocity = np.ascontiguousarray(motion.velocity_m_s)
        specimen = np.broadcast_to(u, force.shape).copy()
        crossing = np.full((draws, *force.shape[1:2], 2), np.nan)
        for _ in range(PASSES):
            moved = np.empty_like(force)
            _play(u, velocity, force, specimen, half, crossing, moved)
            specimen = moved
            force = inner(moved_by(motion, specimen))
        return force


EFFECTS: tuple[type[Effect], ...] = (RigCompliance, FreePlay)
