"""A normal force that acts late: how it follows the motion, and the transient with which a record begins."""

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion, filtered, form, require_loops
from bayes_iwan.effects.law_families import about, decay_over_block, lognormal
from bayes_iwan.models.kernels.relaxing import relaxed

#: a late normal force is no less than this, over that at rest
LEAST = 0.02


class NormalForceLag(Effect):
    name = "normal_force_lag"
    needs_clock = True
    law = "τ e^(±r/2) dα/dt = α∞(u, u̇) − α, + where α falls: r > 0 is let go later than taken up; long after the start"
    strength = ("tau_s", "τ", "s", "relaxation time of the normal force")
    physics = "The compressed rope takes time to follow the spring's motion: α relaxes toward Eq. (11) with a time τ."
    reference = (
        "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440, with a relaxing contact (standard linear solid); Lakes, "
        "Viscoelastic Materials (2009), ch. 2 (recovery slower than creep)"
    )
    signature = "the loop's asymmetry turns between the branches as frequency rises; even harmonics change phase"
    look_alikes = ("channel_delay",)
    bench = "very slow tests, where the lag vanishes"
    remedy = "Let the normal force of the model relax with this time, or quote it for the frequency of use."

    def first_guess(self) -> float:
        return 2e-4 * self.scales.length_mm / self.scales.speed_m_s

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"release": form("r", "log ratio of the times of falling and rising", about(0.0, 0.6), -2.5, 2.5)}

    def late(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        """α long after the start, shaped as `alpha` (draws, loops, samples), but for its floor."""
        require_loops(motion)
        tau = np.maximum(parameter_values[self.strength_name], 1e-15)[:, None]
        half = 0.5 * parameter_values[f"{self.name}.release"][:, None]
        sample = 1.0 / (motion.frequency_hz * motion.samples * tau)  # (draws, loops)
        out = np.empty((max(len(alpha), len(sample)), *alpha.shape[1:]))
        up, down = (
            np.ascontiguousarray(np.broadcast_to(sample * np.exp(s * half), out.shape[:2])) for s in (1.0, -1.0)
        )
        relaxed(np.ascontiguousarray(alpha), up, down, out)
        return out

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return np.maximum(self.late(alpha, motion, parameter_values), LEAST)


class NormalForceLagFromStart(NormalForceLag):
    """The same with a slow part and its transient: a slow normal force begins a record off its steady level and creeps
    to it."""

    law = (
        "the same for a share 1 − s of α, τ times longer by a number for the share s; from the start of each record, "
        "where α is off its steady level and creeps to it with the longer time"
    )
    reference = NormalForceLag.reference + "; Ferry, Viscoelastic Properties of Polymers, ch. 1 (several times)"
    evolving = True
    signature = (
        "as a lag long after the start; in the first moments of every record, of the same length in seconds, friction "
        "and stiffness creep to their level"
    )

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "start": ExtraParameter(
                "Δα₀", "-", "how far the normal force is off its steady level at a record's start", about(0.0, 0.3)
            ),
            "slow_share": form("s", "share of the normal force that follows slowly", about(0.0, 0.3), 0.0, 0.95),
            "slow_ratio": ExtraParameter("ρ", "-", "the slow part's time over τ", lognormal(5.0, 1.0), 1.0, 200.0),
            **super().extra_parameters(),
        }

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        ratio, share = self.get(parameter_values, "slow_ratio"), self.get(parameter_values, "slow_share")
        slow = self.get(parameter_values, "tau_s") * ratio
        left = decay_over_block(motion, 1.0 / (motion.frequency_hz * np.maximum(slow[:, :, 0], 1e-15)))[:, :, None]
        crept = filtered(alpha, motion, lambda f: 1.0 / (1.0 + 2j * np.pi * f * slow))
        late = self.late(alpha, motion, parameter_values)
        return np.maximum(late + share * (crept - late) + self.get(parameter_values, "start") * left, LEAST)


EFFECTS: tuple[type[Effect], ...] = (NormalForceLag, NormalForceLagFromStart)
