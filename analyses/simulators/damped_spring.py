"""A model of your own: a linear spring with viscous and structural damping, no friction at all.

    F = k (1 + iη) U + iω c U  for each harmonic U of the displacement

The structural (hysteretic) part is the same at every frequency, the viscous one grows with it. Use it with

    bayes-iwan identify CAMPAIGN --simulator analyses/simulators/damped_spring.py --out DIR
    bayes-iwan diagnose CAMPAIGN --simulator analyses/simulators/damped_spring.py --out DIR
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayes_iwan.models import ModelError, Parameter, Simulator


class DampedSpring(Simulator):
    name = "damped_spring"

    def parameters(self, scales):
        c = 0.3 * scales.slip_N / (1e3 * scales.speed_m_s)
        return (
            Parameter("k_N_mm", "k", "N/mm", "stiffness", stats.lognorm(s=1.0, scale=scales.soft_N_mm)),
            Parameter("eta", "η", "-", "structural loss factor", stats.lognorm(s=1.5, scale=0.1)),
            Parameter("c_N_s_mm", "c", "N·s/mm", "viscous damping", stats.lognorm(s=1.5, scale=c)),
        )

    def force(self, parameter_values, motion, effects=()):
        if not motion.periodic:
            raise ModelError("damped_spring: structural damping is defined for steady loops only, not for a record")
        k, eta, c = (parameter_values[n][:, None, None] for n in ("k_N_mm", "eta", "c_N_s_mm"))
        harmonics = np.fft.rfft(motion.displacement_mm, axis=-1)
        harmonics[..., 0] = 0.0  # a mean displacement is not turned
        turned = np.fft.irfft(1j * harmonics, n=motion.samples, axis=-1)
        return k * motion.displacement_mm + k * eta * turned + c * 1e3 * motion.velocity_m_s
