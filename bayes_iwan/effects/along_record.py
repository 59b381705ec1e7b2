"""Effects of the force channel that run along whole records and do not repeat with the cycle."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Records, form
from bayes_iwan.effects.by_test import ByTest
from bayes_iwan.effects.law_families import about

#: powers of time that a drift is made of: enough for e^(−b x) on [0, 1] to 1e-4 for |b| ≤ 4
RAMPS = 7
_NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(2 * RAMPS) + 0.5) / (2 * RAMPS))
_POWERS_OF_NODES = np.linalg.pinv(np.vander(_NODES, RAMPS, increasing=True)).T


class ForceDrift(Effect):
    name = "force_drift"
    needs_clock = True
    law = "r·T·(1 − e^(−b t/T))/b, T the longest record; b → 0: linear, b > 0: levelling off"
    strength = ("rate_N_s", "r", "N/s", "drift of the force channel's zero (at the record's start)")
    signed = True
    evolving = True
    order = 4
    physics = "The zero of the force channel wanders during a test: temperature, charge leakage, creep of the mount."
    reference = (
        "Gautschi, Piezoelectric Sensorics, ch. 11 (drift of charge amplifiers); OIML R 60 (creep of load cells)"
    )
    signature = "mean force grows along the record and within each cycle, the loop's shape stays"
    bench = "a record of the unloaded cell; time to warm up"
    remedy = "Let the channel warm up, zero it before each test, or take a straight line off each record."

    def first_guess(self) -> float:
        return 0.05 * self.scales.slip_N

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "levelling": form(
                "b", "how far the drift has levelled off in the longest record", about(0.0, 1.0), -4.0, 4.0
            )
        }

    def recorded(self, data: Records, parameter_values: ParameterValues) -> Array:
        b = parameter_values[f"{self.name}.levelling"][:, None]
        b = np.where(np.abs(b) < 1e-7, 1e-7, b)
        parts = (-np.expm1(-b * _NODES) / b) @ _POWERS_OF_NODES  # (draws, RAMPS)
        drift = np.tensordot(parts, data.ramps, axes=1)
        return (parameter_values[self.strength_name] * data.longest_s)[:, None, None, None] * drift


class ForceDriftByTest(ByTest):
    """A zero that wanders in each test by itself: a line, and the first two bows of a random walk about it.

    A random walk less the line through its ends is a Brownian bridge, whose first two modes have amplitudes of 0.45 and
    0.23 of the walk's end (Karhunen and Loève); the bows are polynomials of those sizes for equal numbers.
    """

    name = ForceDrift.name
    needs_clock = True
    law = "d·(r x + 2 b x(1 − x) + 3 s x(1 − x)(1 − 2x)), x = t/d over a record of length d; numbers of its own in each"
    strength = ForceDrift.strength
    parts = (
        ("rate_N_s", "r", "N/s", "drift of the force channel's zero"),
        ("bow_N_s", "b", "N/s", "bow of that drift"),
        ("sway_N_s", "s", "N/s", "sway of that drift"),
    )
    evolving = True
    order = 4
    physics = ForceDrift.physics
    reference = ForceDrift.reference + "; Ghanem & Spanos, Stochastic Finite Elements, ch. 2 (modes of a random walk)"
    signature = "mean force wanders along each record, in each in its own way; the loop's shape stays"
    bench = ForceDrift.bench
    remedy = ForceDrift.remedy

    def per_N(self) -> float:
        """A newton within some ten cycles."""
        return 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm) / 10.0

    def recorded(self, data: Records, parameter_values: ParameterValues) -> Array:
        rate, bow, sway = (x * data.durations_s for x in self.by_test(parameter_values))
        # in powers of x; a ramp's is t over the longest record
        powers = (rate + 2.0 * bow + 3.0 * sway, -2.0 * bow - 9.0 * sway, 6.0 * sway)
        longer = data.longest_s / data.durations_s
        return sum((c * longer**p)[:, :, None, None] * data.ramps[p] for p, c in enumerate(powers, start=1))

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        rate, *_ = self.by_test(values)
        return {"rate_N_s": (np.sqrt(np.mean(rate * rate, axis=1)), "N/s")}


class MainsInterference(ByTest):
    name = "mains_interference"
    needs_clock = True
    law = "a sine at the mains' frequency, 50 Hz, and its third harmonic locked to it"
    strength = ("amplitude_N", "a", "N", "amplitude of the mains interference in the force channel")
    parts = (
        ("cosine", "c", "N", "cosine of the mains interference"),
        ("sine", "s", "N", "sine of the mains interference"),
    )
    evolving = True
    sudden = True  # in loops whose harmonic it is the base has adapted to it: a first step tells little there
    order = 4
    which: ClassVar[int] = 0  # column of the data's mains_hz
    physics = (
        "The mains induces a sine of 50 or 60 Hz in the force channel, at another phase in each record, with a third "
        "harmonic where a core saturates; cosine and sine of every test are parameters of their own."
    )
    reference = "Ott, Electromagnetic Compatibility Engineering, ch. 2 and 3"
    signature = "a line at 50 or 60 Hz whatever the test frequency; in loops only where that is a harmonic"
    bench = "a record with the shaker off; test frequencies that do not divide the mains'"
    remedy = "Break the ground loop or shield the cable; test at frequencies that do not divide the mains'."

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            part: form(symbol, f"third harmonic over the first, {what}", about(0.0, 0.15), -0.9, 0.9)
            for part, symbol, what in (("third_cosine", "c₃", "in step"), ("third_sine", "s₃", "a quarter turn late"))
        }

    def possible(self, data: Records) -> bool:
        """Where records can show the line and none does the force has none, however well its free phases would fit."""
        return data.mains_possible[self.which]

    def recorded(self, data: Records, parameter_values: ParameterValues) -> Array:
        c, s = self.by_test(parameter_values)
        # the line is Re(g e^{iωt}), g = c − is: its third harmonic, at the same place on the wave, goes with g³/|g|²
        g = c - 1j * s
        third = g**3 / np.maximum(np.abs(g) ** 2, 1e-300)
        third = (
            third
            * (parameter_values[f"{self.name}.third_cosine"] - 1j * parameter_values[f"{self.name}.third_sine"])[
                :, None
            ]
        )
        first_wave, third_wave = data.mains_waves[self.which]
        parts = (c, s, third.real, -third.imag)
        return sum(p[:, :, None, None] * w for p, w in zip(parts, (*first_wave, *third_wave)))

    def lines(self, data: Records, parameter_values: ParameterValues) -> Array:
        c, s = self.by_test(parameter_values)
        return (c + 1j * s)[:, :, None] * (np.arange(data.mains_hz.shape[1]) == self.which)

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        c, s = self.by_test(values)
        third = np.hypot(values[f"{self.name}.third_cosine"], values[f"{self.name}.third_sine"])
        return {
            "amplitude_N": (np.sqrt(np.mean(c * c + s * s, axis=1)), "N"),
            "frequency_hz": (np.full(len(c), self.nominal_hz), "Hz"),
            "third_share": (third, "-"),
        }

    @property
    def nominal_hz(self) -> float:
        return (50.0, 60.0)[self.which]


class MainsInterference60(MainsInterference):
    law = "a sine at the mains' frequency, 60 Hz, and its third harmonic locked to it"
    which = 1


EFFECTS: tuple[type[Effect], ...] = (ForceDrift, ForceDriftByTest, MainsInterference, MainsInterference60)
