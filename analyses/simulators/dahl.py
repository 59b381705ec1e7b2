"""A model of your own: Dahl's friction (Dahl 1968) beside a linear spring.

    F = kp u + z,    dz/du = σ (1 − (z/Z) sgn u̇),    Z the friction force, σ the stiffness of the contact

Between two samples z approaches ±Z exponentially, so a cycle maps its start z linearly onto its end: the steady loop
is the fixed point of that line. The model offers the stage `slip`: effects of the catalogue that change how much
friction there is (weakening with speed, fading, ...) scale Z. With weakening it is LuGre's model without the damping
of its bristles.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayes_iwan.models import Parameter, Simulator


class Dahl(Simulator):
    name = "dahl"
    stages = frozenset({"slip"})

    def parameters(self, scales):
        return (
            Parameter("kp_N_mm", "kp", "N/mm", "parallel spring", stats.lognorm(s=1.0, scale=0.7 * scales.soft_N_mm)),
            Parameter("dahl_force_N", "Z", "N", "friction force", stats.lognorm(s=0.8, scale=1.2 * scales.slip_N)),
            Parameter("dahl_k_N_mm", "σ", "N/mm", "contact stiffness", stats.lognorm(s=1.0, scale=scales.stiff_N_mm)),
        )

    def friction_force(self, parameter_values, motion, effects=()):
        limit = parameter_values["dahl_force_N"][:, None, None]
        share = np.ones((len(limit), motion.loops, motion.samples))
        for effect in effects:
            share = effect.slip(share, motion, parameter_values)
        limit = np.maximum(limit * share, 1e-12)
        step = np.diff(motion.displacement_mm, axis=-1, prepend=motion.displacement_mm[..., -1:])
        if not motion.periodic:
            step[..., 0] = motion.displacement_mm[..., 0]
        kept = np.exp(-parameter_values["dahl_k_N_mm"][:, None, None] * np.abs(step) / limit)
        added = np.sign(step) * limit * (1.0 - kept)
        z = np.zeros(kept.shape[:2])
        if motion.periodic:  # where the line z → z kept + added of a whole cycle meets z
            for i in range(motion.samples):
                z = z * kept[..., i] + added[..., i]
            z = z / (1.0 - np.prod(kept, axis=-1))
        out = np.empty_like(kept)
        for i in range(motion.samples):
            z = z * kept[..., i] + added[..., i]
            out[..., i] = z
        return out

    def force(self, parameter_values, motion, effects=()):
        spring = parameter_values["kp_N_mm"][:, None, None] * motion.displacement_mm
        return self.friction_force(parameter_values, motion, effects) + spring
