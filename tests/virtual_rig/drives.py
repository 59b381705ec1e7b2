"""Drives that go wrong: what a shaker, its generator and a recorder do, while the specimen is sound.

`simulate_test` runs the steady sine that a test asks for. Here the same specimen, kernel and sensors are driven by
any motion, and the recorder may lose rows: a diagnosis must not blame the specimen for what these did.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Record
from bayes_iwan.virtual_rig.fault import Acting
from bayes_iwan.virtual_rig.kernel import march
from bayes_iwan.virtual_rig.sensors import Chain, measure
from bayes_iwan.virtual_rig.simulate import COARSE, Fidelity, Setup, kernel_values, shaker_stretch
from bayes_iwan.virtual_rig.specimen import RigError, Specimen

#: cycles so far at time t (n,) in s, and the motion in amplitudes (n,) at these cycles
Clock = Callable[[Array], Array]
Wave = Callable[[Array], Array]


@dataclass(frozen=True)
class RigDrive:
    """A motion of the armature: amplitude_mm(cycles) * wave(cycles), cycles = clock(time).

    frequency_hz, amplitude_mm : what the operator writes into campaign.toml; the largest amplitude in mm and the
    duration in s are those of the whole record.
    """

    name: str
    frequency_hz: float
    amplitude_mm: float
    duration_s: float
    clock: Clock
    envelope_mm: Clock
    wave: Wave


def sine(cycles: Array) -> Array:
    return np.asarray(np.sin(2 * np.pi * cycles))


def triangle(cycles: Array) -> Array:
    return np.asarray(2 / np.pi * np.arcsin(np.sin(2 * np.pi * cycles)))


def trapezoid(cycles: Array) -> Array:
    """A triangle cut off at five eighths of its height: it holds for three eighths of the cycle."""
    return np.clip(1.6 * triangle(cycles), -1.0, 1.0)


def distorted(share: float, order: int = 3, phase: float = 0.7) -> Wave:
    """A sine with one harmonic of `share` of its amplitude."""

    def wave(cycles: Array) -> Array:
        return sine(cycles) + share * np.asarray(np.sin(2 * np.pi * order * cycles + phase))

    return wave


def steady(
    frequency_hz: float, amplitude_mm: float, cycles: float = 40.0, wave: Wave = sine, name: str = "steady"
) -> RigDrive:
    """One frequency, one amplitude, any wave."""
    return RigDrive(
        name,
        frequency_hz,
        amplitude_mm,
        cycles / frequency_hz,
        lambda t: frequency_hz * t,
        lambda c: np.full(c.shape, amplitude_mm),
        wave,
    )


def staircase(frequency_hz: float, amplitudes_mm: Sequence[float], cycles: int = 20) -> RigDrive:
    """`cycles` at each of the amplitudes, one after the other in one record."""
    levels = np.asarray(amplitudes_mm, dtype=float)
    whole = steady(frequency_hz, float(np.mean(levels)), cycles * levels.size, name="staircase")
    return replace(whole, envelope_mm=lambda c: levels[np.clip((c // cycles).astype(int), 0, levels.size - 1)])


def stepped_frequency(frequencies_hz: Sequence[float], amplitude_mm: float, cycles: int = 20) -> RigDrive:
    """`cycles` at each of the frequencies, one after the other in one record, without a jump of phase."""
    f = np.asarray(frequencies_hz, dtype=float)
    edges = np.concatenate([[0.0], np.cumsum(cycles / f)])
    whole = replace(steady(float(np.mean(f)), amplitude_mm, name="stepped frequency"), duration_s=float(edges[-1]))
    counted = cycles * np.arange(f.size + 1.0)
    return replace(whole, clock=lambda t: np.interp(t, edges, counted) + np.minimum(t, 0) * f[0])


def drifting_amplitude(
    frequency_hz: float, amplitude_mm: float, first: float = 0.8, last: float = 1.2, cycles: int = 40
) -> RigDrive:
    """The amplitude runs from `first` to `last` times the wanted one."""
    whole = steady(frequency_hz, amplitude_mm, cycles, name="drifting amplitude")
    return replace(whole, envelope_mm=lambda c: amplitude_mm * (first + (last - first) * np.clip(c / cycles, 0, 1)))


def sweep(first_hz: float, last_hz: float, amplitude_mm: float, duration_s: float = 6.0) -> RigDrive:
    """The frequency runs evenly from `first_hz` to `last_hz`; the operator writes the middle down."""
    rate = (last_hz - first_hz) / duration_s
    whole = replace(steady((first_hz + last_hz) / 2, amplitude_mm, name="sweep"), duration_s=duration_s)
    return replace(whole, clock=lambda t: first_hz * t + rate * np.maximum(t, 0) ** 2 / 2)


def simulate_drive(
    specimen: Specimen,
    drive: RigDrive,
    *,
    setup: Setup | None = None,
    seed: int = 0,
    file: str = "drive.csv",
    run_in: int = 6,
    fidelity: Fidelity = COARSE,
) -> Record:
    """Run a sound specimen under `drive` and record it, with the sensors' noise and the digitiser's steps.

    Raises RigError where the drive is beyond the rig.
    """
    setup = setup or Setup()
    if not drive.duration_s * drive.frequency_hz >= 2 or not 0.1 <= drive.frequency_hz <= 200:
        raise RigError(f"the drive {drive.name!r} must last two cycles and lie within 0.1 to 200 Hz")
    body = specimen.coarse(fidelity.sliders)
    rate = max(8, int(np.ceil(fidelity.steps * drive.frequency_hz / setup.sample_rate_hz))) * setup.sample_rate_hz
    begin = -run_in / drive.frequency_hz
    time = begin + np.arange(int((drive.duration_s - begin + 0.01) * rate)) / rate
    cycles = drive.clock(time)
    rise = np.sin(0.5 * np.pi * np.clip((cycles - cycles[0]) / min(3.0, run_in), 0, 1)) ** 2
    moved = rise * drive.envelope_mm(np.maximum(cycles, 0.0)) * drive.wave(cycles)
    values = kernel_values(body, setup, Acting(), drive.frequency_hz, float(np.abs(moved).max()), 1 / rate)
    force, _, _ = march(moved, cycles, 1 / rate, body.stiffness_share, body.slip_share_N, *values)
    samples = np.arange(int(drive.duration_s * setup.sample_rate_hz)) / setup.sample_rate_hz
    seen = moved - shaker_stretch(force, values[0])
    u, f = measure(time, seen, force, samples, setup.sensors, Chain(), np.random.default_rng([seed, 7]))
    return Record(file, drive.frequency_hz, drive.amplitude_mm, "fit", {}, samples, u, f)


def without_rows(record: Record, rows: np.ndarray) -> Record:
    """What a recorder writes that loses `rows` and numbers on: the time column shows nothing of it."""
    keep = np.ones(record.time_s.size, dtype=bool)
    keep[rows] = False
    return replace(
        record,
        time_s=record.time_s[: int(keep.sum())],
        displacement_mm=record.displacement_mm[keep],
        force_N=record.force_N[keep],
    )


def dropped_samples(record: Record, count: int, seed: int = 0) -> Record:
    """`count` single rows lost at random places."""
    n = record.time_s.size
    return without_rows(record, np.random.default_rng([seed, 11]).choice(n, count, replace=False))


def lost_trigger(record: Record, block: int = 500, which: int = 3) -> Record:
    """A recorder that writes blocks of `block` samples and waits too long before one: half that block is lost."""
    first = which * block
    if first + block // 2 >= record.time_s.size:
        raise RigError(f"{record.file}: no block number {which} of {block} samples")
    return without_rows(record, np.arange(first, first + block // 2))
