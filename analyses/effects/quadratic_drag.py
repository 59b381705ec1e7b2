"""A cause of one's own in one file: drag that grows with speed squared, as of air or oil pushed through a gap.

    bayes-iwan diagnose CAMPAIGN --out RUN --effects analyses/effects/quadratic_drag.py

What must be there: a name, the strength (name, symbol, unit, description), three sentences for the reader, a first
guess of the strength (any value of the right order: its prior is scaled to the specimen afterwards), and one stage
of the model: motion, normal_force, slip, force or around. More parameters would go into `extra_parameters`; `law` and
`remedy` are sentences for the report. A second class with the same name would be another law of the same cause.
"""

from __future__ import annotations

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect
from bayes_iwan.models import Motion


class QuadraticDrag(Effect):
    name = "quadratic_drag"
    strength = ("c2_N_s2_m2", "c₂", "N·s²/m²", "drag over speed squared")
    physics = "Air or oil is pushed through a gap: turbulent drag against the motion grows with the square of speed."
    reference = "Nayfeh & Mook, Nonlinear Oscillations, §3.3.2"
    law = "c₂·v·|v|"
    remedy = "Open the gap, or give the model a drag of this size."
    signature = "quadrature at the fundamental and the third harmonic ∝ (frequency × amplitude) squared"
    look_alikes = ("viscous_damping",)
    bench = "the same tests with the gap opened, or in vacuum"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.speed_m_s**2

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        v = motion.velocity_m_s
        return force_N + self.get(parameter_values, "c2_N_s2_m2") * v * np.abs(v)
