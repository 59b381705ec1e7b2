"""Effects of the measuring channels: what the electronics make of force and displacement."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.effects.base import Effect, Motion, filtered, folded
from bayes_iwan.inference.parameters import Parameter


class ChannelDelay(Effect):
    name = "channel_delay"
    strength = ("delay_s", "τ", "s", "delay of the force after the displacement")
    signed = True
    order = 3
    physics = "Force and displacement are not sampled at the same instant: multiplexing, or filters of unequal delay."
    reference = "gap-notes, row 1; ISO 16063"
    signature = "every harmonic of the force turns by hωτ: quadrature ∝ frequency × in-phase force"
    look_alikes = ("force_lowpass", "viscous_damping", "integration_highpass", "force_highpass")
    bench = "one common signal into both channels"

    def first_guess(self) -> float:
        return 5e-5 * self.scales.length_mm / self.scales.speed_m_s

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        delay = self.get(numbers, "delay_s")
        return filtered(force_N, motion.frequency_hz, lambda f: np.exp(-2j * np.pi * f * delay))


class IntegrationHighpass(Effect):
    name = "integration_highpass"
    strength = ("corner_hz", "f_c", "Hz", "corner of the high-pass in the displacement channel")
    order = -1
    physics = (
        "Integrating an accelerometer needs a high-pass against drift; near its corner the displacement is too "
        "small and runs ahead."
    )
    reference = "gap-notes, row 4; D'Emilia et al. 2019"
    signature = "phase between displacement and force ∝ 1/frequency, opposite in sign to a high-passed force"
    look_alikes = ("force_highpass", "channel_delay", "maxwell_branch")
    bench = "a lower test frequency; the integrator's data sheet; a displacement sensor beside the accelerometer"

    def first_guess(self) -> float:
        return 0.01 * 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm)

    def motion(self, motion: Motion, numbers: Numbers) -> Motion:
        corner = self.get(numbers, "corner_hz")

        def response(f: Array) -> Array:  # the inverse of the high-pass; no mean came through it
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.where(f > 0.0, 1.0 - 1j * corner / f, 1.0)

        return motion.moved(
            *(
                filtered(x, motion.frequency_hz, response)
                for x in (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2)
            )
        )


class ForceHighpass(Effect):
    name = "force_highpass"
    strength = ("corner_hz", "f_c", "Hz", "corner of the high-pass in the force channel")
    order = 3
    physics = "A piezoelectric or AC-coupled force channel loses the mean and turns slow forces ahead."
    reference = "gap-notes, row 3"
    signature = "no mean force; quadrature ∝ 1/frequency, which thins the loops at the lowest frequency"
    look_alikes = ("integration_highpass", "channel_delay", "maxwell_branch")
    bench = "DC coupling; a lower test frequency"

    def first_guess(self) -> float:
        return 0.01 * 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm)

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        corner = self.get(numbers, "corner_hz")
        # below a millihertz no test would be long enough to lose the mean, so the effect has a neutral limit
        mean = 1.0 / (1.0 + (corner / 1e-3) ** 2)
        return filtered(
            force_N,
            motion.frequency_hz,
            lambda f: np.where(f > 0.0, 1.0 / (1.0 - 1j * corner / np.where(f > 0.0, f, 1.0)), mean),
        )


class ForceLowpass(Effect):
    name = "force_lowpass"
    strength = ("tau_s", "τ", "s", "time constant of the low-pass in the force channel, 1/(2π corner)")
    order = 3
    physics = "The force channel is smoothed: a charge amplifier's or an anti-alias filter's corner is too low."
    reference = "gap-notes, row 2"
    signature = "as a late force, and corners of the loop rounded"
    look_alikes = ("channel_delay", "viscous_damping")
    bench = "one common signal into both channels"

    def first_guess(self) -> float:
        return 5e-5 * self.scales.length_mm / self.scales.speed_m_s

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        tau = self.get(numbers, "tau_s")
        return filtered(force_N, motion.frequency_hz, lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau))

    def reported(self, values, force_N) -> dict[str, tuple[Array, str]]:
        tau = values[self.strength_name]
        return {"tau_s": (tau, "s"), "corner_hz": (1.0 / (2.0 * np.pi * tau), "Hz")}


class ForceDrift(Effect):
    name = "force_drift"
    strength = ("rate_N_s", "r", "N/s", "drift of the force channel's zero")
    signed = True
    evolving = True
    order = 4
    physics = "The zero of the force channel wanders during a test: temperature, charge leakage, creep of the mount."
    reference = "gap-notes, row 26"
    signature = "mean force grows along the record and within each cycle, the loop's shape stays"
    bench = "a record of the unloaded cell; time to warm up"

    def first_guess(self) -> float:
        return 0.05 * self.scales.slip_N

    def recorded(self, data, numbers: Numbers) -> Array:
        if "ramp" not in self.cache:
            self.cache["ramp"] = folded(data.loops, lambda t, time_s: time_s - time_s[0])
        return numbers[self.strength_name][:, None, None, None] * self.cache["ramp"]


class MainsHum(Effect):
    name = "mains_hum"
    strength = ("amplitude_N", "a", "N", "amplitude of the hum in the force channel")
    evolving = True
    order = 4
    which: ClassVar[int] = 0  # column of data.mains_hz
    physics = (
        "The mains induces a sine of 50 or 60 Hz in the force channel, at another phase in each record; cosine "
        "and sine of every test are numbers of their own."
    )
    reference = "gap-notes, row 12"
    signature = "a line at 50 or 60 Hz whatever the test frequency; in loops only where that is a harmonic"
    bench = "a record with the shaker off; test frequencies that do not divide the mains'"

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N

    def possible(self, data) -> bool:
        """Where records can show the line and none does there is no hum, however well its free phases would fit."""
        return data.mains_possible[self.which]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        typical = self.first_guess() if self.strength_value is None else self.strength_value
        prior = stats.norm(scale=1.2 * typical)
        return tuple(
            Parameter(f"{self.name}.{part}[{test}]", part[0], "N", f"{part} of the hum in {test}", prior)
            for part in ("cosine", "sine")
            for test in self.tests
        )

    def _parts(self, numbers: Numbers) -> tuple[Array, Array]:
        c, s = (np.stack([numbers[f"{self.name}.{p}[{t}]"] for t in self.tests], axis=1) for p in ("cosine", "sine"))
        return c, s

    def recorded(self, data, numbers: Numbers) -> Array:
        if "waves" not in self.cache:
            hz = data.mains_hz[:, self.which]

            def wave(shape):
                return folded(data.loops, lambda t, time_s: shape(2.0 * np.pi * hz[t] * time_s))

            self.cache.update(waves=[wave(np.cos), wave(np.sin)], hz=float(np.median(hz)))
        return sum(p[:, :, None, None] * w for p, w in zip(self._parts(numbers), self.cache["waves"]))

    def lines(self, data, numbers: Numbers) -> Array:
        c, s = self._parts(numbers)
        return (c + 1j * s)[:, :, None] * (np.arange(data.mains_hz.shape[1]) == self.which)

    def reported(self, values, force_N) -> dict[str, tuple[Array, str]]:
        c, s = self._parts(values)
        return {
            "amplitude_N": (np.sqrt(np.mean(c * c + s * s, axis=1)), "N"),
            "frequency_hz": (np.full(len(c), self.cache["hz"]), "Hz"),
        }


class MainsHum60(MainsHum):
    which = 1


class ForceClipping(Effect):
    name = "force_clipping"
    strength = ("inverse_limit_1_N", "1/F_max", "1/N", "inverse of the largest force that the channel passes")
    spread = 0.15  # a limit far above the largest force is none
    sudden = True
    order = 5
    physics = "The force channel reaches the end of its range, or its amplifier saturates."
    reference = "gap-notes, row 9"
    signature = "the loop's tips are flat at the same force in every test that reaches it"
    look_alikes = ("cubic_stiffness",)
    bench = "a coarser range"

    def first_guess(self) -> float:
        return 0.5 / self.scales.force_N

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        with np.errstate(divide="ignore"):
            limit = 1.0 / self.get(numbers, "inverse_limit_1_N")
        return np.clip(force_N, -limit, limit)

    def reported(self, values, force_N) -> dict[str, tuple[Array, str]]:
        return {"limit_N": (1.0 / values[self.strength_name], "N")}


EFFECTS: tuple[type[Effect], ...] = (
    ChannelDelay,
    IntegrationHighpass,
    ForceHighpass,
    ForceLowpass,
    ForceDrift,
    MainsHum,
    MainsHum60,
    ForceClipping,
)
