"""The virtual rig's measuring chain: what two sensors, their amplifiers and a digitiser make of the motion.

Both channels have their own second-order response (matched to a fraction of a percent, as a pair of conditioned
sensors is), one common anti-alias filter, coloured noise and steps of the digitiser. Faults of the chain
(`Chain`) act where they would: a charge amplifier's corner before the anti-alias filter, a saturating
amplifier before it, a delay between the converters.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from scipy import signal

from bayes_iwan.arrays import Array

#: numerator and denominator in s (rad/s)
Transfer = tuple[tuple[float, ...], tuple[float, ...]]
#: force (N) added to a record, from times (s), cycles, displacement (mm) and a random generator
Addition = Callable[[Array, Array, Array, np.random.Generator], Array]


@dataclass(frozen=True)
class Chain:
    """What the measuring chain adds to two sound channels; nothing by default.

    `gain` is the force amplifier's in this test, `saturation` maps the force that it is given (N) to what it can give.
    """

    moving_mass_kg: float = 0.0
    mass_mount_hz: float = 0.0
    mass_mount_ratio: float = 0.0
    delay_s: float = 0.0
    displacement_filters: tuple[Transfer, ...] = ()
    force_filters: tuple[Transfer, ...] = ()
    additions: tuple[Addition, ...] = ()
    saturation: Callable[[Array], Array] | None = None
    reading_lag_mm: float = 0.0
    cell_lag_N: float = 0.0
    gain: float = 1.0


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


def _second_order(x: Array, rate_hz: float, corner_hz: float, ratio: float) -> Array:
    w = 2 * np.pi * corner_hz
    return _filtered(x, rate_hz, ((w * w,), (1.0, 2 * ratio * w, w * w)))


@cache
def _digital(transfer: Transfer, rate_hz: float) -> tuple[Array, Array]:
    b, a = signal.bilinear(*transfer, fs=rate_hz)
    return b, a


def _filtered(x: Array, rate_hz: float, transfer: Transfer) -> Array:
    return np.asarray(signal.lfilter(*_digital(transfer, rate_hz), x))


@cache
def _antialias(corner_hz: float, rate_hz: float) -> Array:
    return np.asarray(signal.butter(4, corner_hz, fs=rate_hz, output="sos"))


@njit(cache=True)
def _lagging_reading(x: Array, width: float, n: int = 5) -> Array:
    """A reading that lags at reversals: the mean of `n` plays of widths up to `width_mm`."""
    out = np.zeros_like(x)
    for j in range(n):
        half, held = 0.5 * width * (j + 0.5) / n, 0.0
        for i in range(x.size):
            held = min(max(held, x[i] - half), x[i] + half)
            out[i] += held
    return out / n


def coloured_noise(rng: np.random.Generator, n: int, rms: float, correlation: float, slow_share: float) -> Array:
    """Noise of a given RMS: an AR(1) process, and a slowly wandering part made of three long AR(1) processes."""
    if rms == 0.0:
        return np.zeros(n)

    def ar(c: float) -> Array:
        burn = int(min(5 / (1 - c), 4000))
        white = rng.standard_normal(n + burn) * np.sqrt(1 - c * c)
        return np.asarray(signal.lfilter([1.0], [1.0, -c], white))[burn:]

    slow = sum(ar(c) for c in (0.9, 0.98, 0.996)) / np.sqrt(3.0)
    return np.asarray(rms * (np.sqrt(1 - slow_share) * ar(correlation) + np.sqrt(slow_share) * slow))


def measure(
    time_s: Array,
    displacement_mm: Array,
    force_N: Array,
    sample_times_s: Array,
    sensors: Sensors,
    chain: Chain,
    rng: np.random.Generator,
    clean: bool = False,
    frequency_hz: float = 1.0,
) -> tuple[Array, Array]:
    """Sample the motion as the chain would.

    Parameters: `time_s` (n,) uniform fine steps, the displacement at the sensor and the force in the sensor's
    place (n,); `sample_times_s` (m,) within them. `clean` leaves noise and digitiser's steps out; `frequency_hz` is the
    drive's. Returns the displacement (mm) and the force (N), each (m,).
    """
    rate = 1.0 / (time_s[1] - time_s[0])
    x, f = displacement_mm, force_N
    more = rng.spawn(1)[0]  # of its own, so that noise does not depend on what is added
    if chain.moving_mass_kg != 0.0:
        carried = x
        if chain.mass_mount_hz != 0.0:  # the mass swings on its mount
            carried = _second_order(x, rate, chain.mass_mount_hz, chain.mass_mount_ratio)
        f = f + chain.moving_mass_kg * 1e-3 * np.gradient(np.gradient(carried, 1 / rate), 1 / rate)
    if chain.cell_lag_N != 0.0:
        f = _lagging_reading(f, chain.cell_lag_N)
    if chain.reading_lag_mm != 0.0:
        x = _lagging_reading(x, chain.reading_lag_mm)
    x = _second_order(x, rate, sensors.displacement_corner_hz, sensors.damping_ratio)
    f = _second_order(f, rate, sensors.force_corner_hz, sensors.damping_ratio)
    for transfer in chain.displacement_filters:
        x = _filtered(x, rate, transfer)
    for transfer in chain.force_filters:
        f = _filtered(f, rate, transfer)
    for add in chain.additions:
        f = f + add(time_s, frequency_hz * time_s, x, more)
    f = chain.gain * f
    if chain.saturation is not None:
        f = chain.saturation(f)
    sos = _antialias(sensors.antialias_hz, rate)
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
