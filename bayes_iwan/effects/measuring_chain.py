"""Effects of the measuring channels on loops: what the electronics make of force and displacement."""

from collections.abc import Mapping

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion, filtered, form
from bayes_iwan.effects.law_families import about, decay_over_block, lognormal, power_of


class ChannelDelay(Effect):
    name = "channel_delay"
    needs_clock = True
    law = "phase −2πfτ·(f/f_ref)^p; p = 0: a delay; a little below: an all-pass or a filter's own phase"
    strength = ("delay_s", "τ", "s", "delay of the force after the displacement")
    signed = True
    order = 3
    physics = "Force and displacement are not sampled at the same instant: multiplexing, or filters of unequal delay."
    reference = (
        "ISO 16063-1 (phase of transducers and amplifiers); Oppenheim & Schafer, Discrete-Time Signal Processing, §5.5 "
        "(all-pass systems)"
    )
    signature = "every harmonic of the force turns by hωτ: quadrature ∝ frequency × in-phase force"
    look_alikes = ("force_lowpass", "viscous_damping", "integration_highpass", "force_highpass")
    bench = "one common signal into both channels"
    remedy = "Shift one channel by this time, or sample both at one instant."

    def first_guess(self) -> float:
        return 5e-5 * self.scales.length_mm / self.scales.speed_m_s

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"dispersion": form("p", "growth of the delay with frequency, as a power", about(0.0, 0.2), -0.9, 0.9)}

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        delay, p = self.get(parameter_values, "delay_s"), self.get(parameter_values, "dispersion")
        reference_hz = 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm)

        def response(f: Array) -> np.ndarray:
            return np.exp(-2j * np.pi * f * delay * power_of(np.where(f > 0.0, f / reference_hz, 1.0), p))

        return filtered(force_N, motion, response)


def _highpass(f: Array, corner_hz: Array, second: Array, kept: Array) -> np.ndarray:
    """g + (1 − g)/(1 − ix − q x²), x = corner/f, and 1 at f = 0 (callers say what becomes of the mean)."""
    x = np.where(f > 0.0, corner_hz / np.where(f > 0.0, f, 1.0), 0.0)
    return kept + (1.0 - kept) / (1.0 - 1j * x - second * x * x)


def _second(sd: float) -> ExtraParameter:
    return form("q", "0: first order, ¼: two equal poles, ½: Butterworth of order 2", about(0.0, sd), -0.7, 0.7)


def _kept() -> ExtraParameter:
    """A shelf: a leak that another resistance bounds, a charge amplifier that is coupled to DC in part."""
    return form("g", "share that is left far below the corner; 0: none", about(0.0, 0.08), -0.5, 0.5)


class IntegrationHighpass(Effect):
    name = "integration_highpass"
    needs_clock = True
    law = (
        "high-pass g + (1 − g)/(1 − ix − q x²), x = f_c/f, of the displacement; g = 0, q = 0: first order, ½: "
        "Butterworth of order 2; g > 0: a shelf"
    )
    strength = ("corner_hz", "f_c", "Hz", "corner of the high-pass in the displacement channel (first order's)")
    order = -1
    physics = (
        "Integrating an accelerometer needs a high-pass against drift; near its corner the displacement is too "
        "small and runs ahead."
    )
    reference = "ISO 16063-21 (phase of accelerometers); Tietze, Schenk & Gamm, Electronic Circuits, ch. 13"
    signature = "phase between displacement and force ∝ 1/frequency, opposite in sign to a high-passed force"
    look_alikes = ("force_highpass", "channel_delay", "maxwell_branch")
    bench = "a lower test frequency; the integrator's data sheet; a displacement sensor beside the accelerometer"
    remedy = "Undo the high-pass with its known corner, or measure the displacement itself."

    def first_guess(self) -> float:
        return 0.01 * 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm)

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"second": _second(0.25), "kept": _kept()}

    def motion(self, motion: Motion, parameter_values: ParameterValues) -> Motion:
        corner, second, kept = (self.get(parameter_values, n) for n in ("corner_hz", "second", "kept"))

        def response(f: Array) -> np.ndarray:  # the inverse of the high-pass; no mean came through it
            return 1.0 / _highpass(f, corner, second, kept)

        seen = np.stack([motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2])
        return motion.moved(*filtered(seen, motion, response))


class ForceHighpass(Effect):
    name = "force_highpass"
    needs_clock = True
    law = (
        "high-pass g + (1 − g)/(1 − ix − q x²), x = f_c/f, of the force; g = 0, q = 0: first order, ½: Butterworth of "
        "order 2; g > 0: a shelf, through which the mean comes"
    )
    strength = ("corner_hz", "f_c", "Hz", "corner of the high-pass in the force channel (first order's)")
    order = 3
    physics = "A piezoelectric or AC-coupled force channel loses the mean and turns slow forces ahead."
    reference = "Gautschi, Piezoelectric Sensorics, ch. 11 (charge amplifiers)"
    signature = "no mean force; quadrature ∝ 1/frequency, which thins the loops at the lowest frequency"
    look_alikes = ("integration_highpass", "channel_delay", "maxwell_branch")
    bench = "DC coupling; a lower test frequency"
    remedy = "Couple the force channel DC, choose a longer time constant, or test at higher frequency."

    def first_guess(self) -> float:
        return 0.01 * 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm)

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"second": _second(0.25), "kept": _kept()}

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        corner, second = self.get(parameter_values, "corner_hz"), self.get(parameter_values, "second")
        kept = self.get(parameter_values, "kept")
        mean = self._mean_kept(corner, kept)
        return filtered(force_N, motion, lambda f: np.where(f > 0.0, _highpass(f, corner, second, kept), mean))

    @staticmethod
    def _mean_kept(corner_hz: Array, kept: Array) -> Array:
        """Share of the mean force that comes through in the long run: below a millihertz no test would be long enough
        to lose it, so the effect has a neutral limit."""
        return kept + (1.0 - kept) / (1.0 + (corner_hz / 1e-3) ** 2)


class ForceHighpassFromStart(ForceHighpass):
    """The same with its transient: the mean force has not yet leaked away when a record begins.

    A mean F̄ that was held for a time t has become F̄·(p₁e^(p₁t) − p₂e^(p₂t))/(p₁ − p₂), p₁ and p₂ the poles of
    s² + ω_c s + q ω_c².
    """

    law = (
        "the same, and the mean force, that was held since some cycles before each record, leaks away: "
        "e^(−2πf_c t) for a first order"
    )
    evolving = True
    signature = (
        "as a high-passed force; the loop sinks or rises to its middle from a record's start, in seconds alike in all"
    )

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            **super().extra_parameters(),
            "held_cycles": form(
                "n₀", "cycles before the record since which the mean force was held", lognormal(6.0, 0.8), 0.0, 200.0
            ),
            "held_share": form("m", "that mean force over the model's", about(1.0, 0.5), -2.0, 4.0),
        }

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        corner, second, kept, held, share = (
            self.get(parameter_values, n)[:, :, 0] for n in ("corner_hz", "second", "kept", "held_cycles", "held_share")
        )
        # the poles are −½ω_c(1 ± turn); at q = ¼ they are one, whose limit is theirs a hair apart
        turn = np.sqrt((1.0 - 4.0 * np.maximum(second, 0.0)).astype(complex))
        turn = np.where(np.abs(turn) < 1e-4, 1e-4, turn)
        theta = np.arange(motion.samples) / motion.samples
        left = np.zeros(1)
        for one in (turn, -turn):
            rate = np.pi * corner / motion.frequency_hz * (1.0 + one)  # per cycle
            rate = np.where(np.abs(rate) < 1e-9, 1e-9, rate)
            # it goes on falling within a cycle: at each place of the loop the average over the block's cycles
            block = decay_over_block(motion, rate) * rate / -np.expm1(-rate) * np.exp(-rate * held)
            left = left + (0.5 * (1.0 + one) / one * block)[:, :, None] * np.exp(
                -rate[:, :, None] * theta
            )  # of conjugates, so the sum is real
        passed = force_N.mean(axis=-1, keepdims=True) * (share * (1.0 - self._mean_kept(corner, kept)))[:, :, None]
        return super().force(force_N, motion, parameter_values) + passed * np.real(left)


class ForceLowpass(Effect):
    name = "force_lowpass"
    needs_clock = True
    law = "low-pass 1/(1 + ix − q x²), x = 2πfτ; q = 0: first order, ¼: two equal poles, ⅓: Bessel, ½: Butterworth"
    strength = ("tau_s", "τ", "s", "time constant of the low-pass in the force channel, 1/(2π corner)")
    order = 3
    physics = "The force channel is smoothed: a charge amplifier's or an anti-alias filter's corner is too low."
    reference = (
        "Tietze, Schenk & Gamm, Electronic Circuits, ch. 13 (first order, critically damped, Bessel, Butterworth)"
    )
    signature = "as a late force, and corners of the loop rounded"
    look_alikes = ("channel_delay", "viscous_damping")
    bench = "one common signal into both channels"
    remedy = "Raise the filter's corner to a hundred times the test frequency, or filter the displacement alike."

    def first_guess(self) -> float:
        return 5e-5 * self.scales.length_mm / self.scales.speed_m_s

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"second": _second(0.15)}  # near ⅓ (Bessel) the filter is a delay, and that has a name of its own

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        tau, second = self.get(parameter_values, "tau_s"), self.get(parameter_values, "second")

        def response(f: Array) -> np.ndarray:
            x = 2.0 * np.pi * f * tau
            return 1.0 / (1.0 + 1j * x - second * x * x)

        return filtered(force_N, motion, response)

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        tau = values[self.strength_name]
        return super().reported(values) | {"corner_hz": (1.0 / (2.0 * np.pi * tau), "Hz")}


class SteepLowpass(ForceLowpass):
    """A filter of higher order far below its corner: its group delay is what is left of it, and a faint droop.

    The logarithm of any low-pass is −ix − κx²/2 + … , x = 2πfτ: κ = 1/n for n equal poles, about 0 for Bessel and
    Butterworth filters. So a steep filter passes for a delay, and the two differ by their droop alone.
    """

    law = (
        "delay and droop exp(−ix − κx²/2), x = 2πfτ; κ = 1/n: n equal poles, κ → 0: Bessel or Butterworth of high order"
    )
    reference = "Zverev, Handbook of Filter Synthesis, ch. 2 (group delay below the corner)"

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        # a droop of its own is what makes it a filter: without one nothing tells it from a delay
        return {"droop": ExtraParameter("κ", "-", "droop over that of a first order", lognormal(0.3, 0.8), 0.0, 1.0)}

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        tau, droop = self.get(parameter_values, "tau_s"), self.get(parameter_values, "droop")

        def response(f: Array) -> np.ndarray:
            x = 2.0 * np.pi * f * tau
            return np.exp(-1j * x - 0.5 * droop * x * x)

        return filtered(force_N, motion, response)

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        return Effect.reported(self, values)


class ForceClipping(Effect):
    name = "force_clipping"
    law = (
        "F/(1 + |F/F_max|^p)^(1/p), softness s = 1/p; s → 0: hard; s = ½: an amplifier's soft saturation; the limit of "
        "pulling is F_max·e^b, that of pushing F_max·e^−b"
    )
    strength = ("inverse_limit_1_N", "1/F_max", "1/N", "inverse of the largest force that the channel passes")
    spread = 0.15  # a limit far above the largest force is none
    sudden = True
    order = 5
    physics = "The force channel reaches the end of its range, or its amplifier saturates."
    reference = "Rapp, Proc. 2nd European Conf. Satellite Communications, Liège (1991) 179 (soft limiter)"
    signature = "the loop's tips are flat at the same force in every test that reaches it"
    look_alikes = ("cubic_stiffness",)
    bench = "a coarser range"
    remedy = "Raise the force range and repeat the tests that reach it."

    def first_guess(self) -> float:
        return 0.5 / self.scales.force_N

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "softness": form("s", "0: hard, ½: soft saturation", lognormal(0.03, 1.0), 2e-3, 1.0),
            "unequal": form("b", "0: both signs limited alike; else an offset range", about(0.0, 0.2), -1.0, 1.0),
        }

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        inverse, soft = self.get(parameter_values, "inverse_limit_1_N"), self.get(parameter_values, "softness")
        wider = np.exp(np.sign(force_N) * self.get(parameter_values, "unequal"))
        with np.errstate(divide="ignore"):
            log_ratio = np.log(np.abs(force_N) * inverse / wider)
        over = np.logaddexp(0.0, log_ratio / soft)  # ln(1 + |F/F_max|^p)
        return force_N * np.exp(-soft * over)

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        return {
            "limit_N": (1.0 / values[self.strength_name], "N"),
            "softness": (values[f"{self.name}.softness"], "-"),
            "unequal": (values[f"{self.name}.unequal"], "-"),
        }


EFFECTS: tuple[type[Effect], ...] = (
    ChannelDelay,
    IntegrationHighpass,
    ForceHighpass,
    ForceHighpassFromStart,
    ForceLowpass,
    SteepLowpass,
    ForceClipping,
)
