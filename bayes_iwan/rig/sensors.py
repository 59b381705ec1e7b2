"""The virtual rig's measuring chain: what two sensors, their amplifiers and a digitiser make of the motion.

Both channels have their own second-order response (matched to a fraction of a percent, as a pair of conditioned
sensors is), one common anti-alias filter, coloured noise and steps of the digitiser. Faults of the chain
(`rig_effects.Chain`) act where they would: a charge amplifier's corner before the anti-alias filter, a saturating
amplifier before it, a delay between the converters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy import signal

from bayes_iwan.rig.faults import Chain

Floats = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class Sensors:
    """The two sound channels.

    Attributes: corner frequencies (Hz) and damping ratios of the two second-order responses; the common
    fourth-order anti-alias corner; noise RMS of each channel; the noise's lag-one correlation and the share of
    its variance that wanders slowly; the digitiser's steps.
    """

    displacement_corner_hz: float = 1500.0
    force_corner_hz: float = 1500.0
    damping_ratio: float = 0.65
    antialias_hz: float = 480.0
    displacement_noise_mm: float = 0.0
    force_noise_N: float = 0.0
    noise_correlation: float = 0.3
    slow_share: float = 0.2
    displacement_step_mm: float = 1e-5
    force_step_N: float = 2e-4


def _second_order(x: Floats, rate_hz: float, corner_hz: float, ratio: float) -> Floats:
    w = 2 * np.pi * corner_hz
    b, a = signal.bilinear([w * w], [1.0, 2 * ratio * w, w * w], fs=rate_hz)
    return np.asarray(signal.lfilter(b, a, x))


def _first_order(x: Floats, rate_hz: float, corner_hz: float, kind: str) -> Floats:
    w = 2 * np.pi * corner_hz
    b, a = signal.bilinear([1.0, 0.0] if kind == "high" else [w], [1.0, w], fs=rate_hz)
    return np.asarray(signal.lfilter(b, a, x))


@njit(cache=True)
def _lagging_reading(x: Floats, width_mm: float, n: int = 5) -> Floats:
    """A reading that lags at reversals: the mean of `n` plays of widths up to `width_mm`."""
    out = np.zeros_like(x)
    for j in range(n):
        half, held = 0.5 * width_mm * (j + 0.5) / n, 0.0
        for i in range(x.size):
            held = min(max(held, x[i] - half), x[i] + half)
            out[i] += held
    return out / n


def coloured_noise(rng: np.random.Generator, n: int, rms: float, correlation: float, slow_share: float) -> Floats:
    """Noise of a given RMS: an AR(1) process, and a slowly wandering part made of three long AR(1) processes."""
    if rms == 0.0:
        return np.zeros(n)

    def ar(c: float) -> Floats:
        burn = int(min(5 / (1 - c), 4000))
        white = rng.standard_normal(n + burn) * np.sqrt(1 - c * c)
        return np.asarray(signal.lfilter([1.0], [1.0, -c], white))[burn:]

    slow = sum(ar(c) for c in (0.9, 0.98, 0.996)) / np.sqrt(3.0)
    return np.asarray(rms * (np.sqrt(1 - slow_share) * ar(correlation) + np.sqrt(slow_share) * slow))


def measure(
    time_s: Floats,
    displacement_mm: Floats,
    force_N: Floats,
    sample_times_s: Floats,
    sensors: Sensors,
    chain: Chain,
    rng: np.random.Generator,
    clean: bool = False,
) -> tuple[Floats, Floats]:
    """Sample the motion as the chain would.

    Parameters: `time_s` (n,) uniform fine steps, the displacement at the sensor and the force in the sensor's
    place (n,); `sample_times_s` (m,) within them. `clean` leaves noise and digitiser's steps out. Returns the
    displacement (mm) and the force (N), each (m,).
    """
    rate = 1.0 / (time_s[1] - time_s[0])
    x, f = displacement_mm, force_N
    if chain.moving_mass_kg != 0.0:
        f = f + chain.moving_mass_kg * 1e-3 * np.gradient(np.gradient(x, 1 / rate), 1 / rate)
    if chain.reading_lag_mm != 0.0:
        x = _lagging_reading(x, chain.reading_lag_mm)
    x = _second_order(x, rate, sensors.displacement_corner_hz, sensors.damping_ratio)
    f = _second_order(f, rate, sensors.force_corner_hz, sensors.damping_ratio)
    if chain.displacement_highpass_hz != 0.0:
        x = _first_order(x, rate, chain.displacement_highpass_hz, "high")
    if chain.force_highpass_hz != 0.0:
        f = _first_order(f, rate, chain.force_highpass_hz, "high")
    if chain.force_lowpass_hz != 0.0:
        f = _first_order(f, rate, chain.force_lowpass_hz, "low")
    phase, off, third = rng.uniform(0, 2 * np.pi), 0.05 * rng.standard_normal(), rng.uniform(0.0, 0.15)
    if chain.hum_N != 0.0:  # the grid is never quite at its nominal frequency, nor quite a sine
        turn = 2 * np.pi * (chain.hum_hz + off) * time_s + phase
        f = f + chain.hum_N * (np.sin(turn) + third * np.sin(3 * turn))
    f = f + chain.drift_N_s * np.maximum(time_s, 0.0)
    if chain.clip_N is not None:
        f = np.clip(f, -chain.clip_N, chain.clip_N)
    sos = signal.butter(4, sensors.antialias_hz, fs=rate, output="sos")
    x, f = signal.sosfilt(sos, x), signal.sosfilt(sos, f)
    u = np.interp(sample_times_s, time_s, x)
    force = np.interp(sample_times_s - chain.delay_s, time_s, f)
    if clean:
        return u, force
    n = sample_times_s.size
    u = u + coloured_noise(rng, n, sensors.displacement_noise_mm, sensors.noise_correlation, sensors.slow_share)
    force = force + coloured_noise(rng, n, sensors.force_noise_N, sensors.noise_correlation, sensors.slow_share)
    if sensors.displacement_step_mm > 0:
        u = np.round(u / sensors.displacement_step_mm) * sensors.displacement_step_mm
    if sensors.force_step_N > 0:
        force = np.round(force / sensors.force_step_N) * sensors.force_step_N
    return u, force
