"""Faults that no catalogue lists: the right answer to them is that the cause is unknown.

With the catalogue's nearest member and the cosine between the two changes of the force once the specimen's own
parameters are adjusted (measured on Table 1 at 8, 14, 25 Hz and 0.3, 0.6, 1 mm, each by its first law):
`quadratic_drag` (rate_strengthening 0.81), `base_resonance` (the fixture under the specimen swings; moving_mass 0.65),
`sensor_hysteresis` (the reading lags at reversals; force_highpass 0.54), `remount_scatter` (the stiffness differs from
test to test; moving_mass 0.37), `wear_groove` (friction varies with position; cubic_stiffness 0.31), `rocking` (every
second stroke presses harder; friction_fade 0.21).
Not measured so: `subharmonic_whirl` (a whirl near half the drive's frequency), `fixture_resonance` (the force path
rings), `cell_hysteresis` (the force cell lags), `impact_chatter` (a burst of ringing after each reversal),
`range_switching` (the amplifier's gain differs by test), `misaligned_rod` (friction grows away from a position),
`detent` (a ball falls into a notch), `lubrication_peak` (friction is highest at one speed), `loose_debris` (what lies
in the contact makes it stiffer or softer from cycle to cycle), `stick_slip` (the sliding force is a sawtooth over the
way), `room_climate` (friction differs by test), `two_ranges` (a force amplifier changes its gain where it changes its
range), `amplitude_gain` (the gain follows the amplitude), `slow_zero` (the zero swings with the building's heating),
`noise_bursts` (a loose plug), `coarse_steps` (a converter with few bits).
For drag and both hystereses the diagnosis has a pattern that names no cause
(:mod:`bayes_iwan.effects.empirical_patterns`), for the hystereses by another law; studies tell them apart from the
others.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.virtual_rig.fault import Acting, Acts, Draw, FaultKind, Law, Parameters, Surroundings
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.law_parts import damper, linear, measuring, moving, slip_speed, spring, uniform
from bayes_iwan.virtual_rig.sensors import Chain


def _one(
    name: str,
    family: str,
    main: str,
    ceiling: Callable[[Surroundings], float],
    acts: Acts,
    draw: Draw = lambda g, s: {},
    evolves: bool = False,
) -> FaultKind:
    return FaultKind(
        name, main, linear(ceiling), (Law(name, acts, evolves=evolves),), draw, listed=False, family=family
    )


def _base(p: Parameters) -> Acting:
    k = 1.0 / p["mobility_mm_N"]
    mass_kg = 1e3 * k / (2 * np.pi * p["resonance_hz"]) ** 2
    return Acting(motion=FaultValues(base_k=k, base_mass_kg=mass_kg, base_damping_ratio=p["damping_ratio"]))


def _adding(shape: Callable[[Parameters, Array, Array, Array, np.random.Generator], Array]) -> Acts:
    """What is added to the force: shape(parameters, times, cycles, displacement, random generator)."""

    def acts(p: Parameters) -> Acting:
        return Acting(chain=Chain(additions=(partial(shape, p),)))

    return acts


@_adding
def _whirl(p: Parameters, t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
    turn = 2 * np.pi * p["order"] * cycle + rng.uniform(0, 2 * np.pi)
    return np.asarray(p["amplitude_N"] * (np.sin(turn) + 0.2 * np.sin(2 * turn)))


@_adding
def _chatter(p: Parameters, t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
    speed = np.gradient(u)
    turns = np.flatnonzero(np.sign(speed[1:]) * np.sign(speed[:-1]) < 0)
    since = np.full(t.size, 1e3)
    for i in turns:
        since[i:] = t[i:] - t[i]
    ringing = np.exp(-since / p["decay_s"]) * np.sin(2 * np.pi * p["ringing_hz"] * since)
    return np.asarray(p["amplitude_N"] * ringing)


@_adding
def _slow_zero(p: Parameters, t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
    return np.asarray(p["amplitude_N"] * np.sin(2 * np.pi * t / p["period_s"] + rng.uniform(0, 2 * np.pi)))


@_adding
def _bursts(p: Parameters, t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
    out = np.zeros(t.size)
    for at in rng.uniform(t[0], t[-1], 1 + int((t[-1] - t[0]) / p["every_s"])):
        here = np.flatnonzero(np.abs(t - at) < 4 * p["lasts_s"])
        out[here] += np.exp(-(((t[here] - at) / p["lasts_s"]) ** 2)) * rng.standard_normal() * p["amplitude_N"]
    return out


@_adding
def _stick_slip(p: Parameters, t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
    step = np.diff(u, prepend=u[0])
    way = np.cumsum(np.abs(step)) / p["jump_mm"]
    return np.asarray(p["amplitude_N"] * np.sign(step) * (way - np.floor(way) - 0.5))


def _ringing_path(p: Parameters) -> Acting:
    """1 + share·(resonance − 1): at share 1 the whole force passes the resonance."""
    w, z, a = 2 * np.pi * p["resonance_hz"], p["damping_ratio"], p["share"]
    ringing = (1.0 - a, 2 * z * w * (1.0 - a), w * w), (1.0, 2 * z * w, w * w)
    return Acting(chain=Chain(force_filters=(ringing,)))


def _debris(p: Parameters) -> Acting:
    factor = 1.0 + p["sd_share"] * np.random.default_rng(int(p["draw"])).standard_normal(402)
    return Acting(motion=FaultValues(fade_stiffness=1.0), fade_factor=lambda n: np.interp(n, np.arange(402.0), factor))


def _seed(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {"draw": float(rng.integers(2**31))}


def _between_tests(name: str, family: str, most: float, what: str) -> FaultKind:
    """A factor that each test has of its own on what is named."""

    def acts(p: Parameters) -> Acting:
        how: Any = {what: (p["sd_share"], int(p["draw"]))}
        return Acting(**how)

    return _one(name, family, "sd_share", lambda s: most, acts, _seed)


KINDS = (
    # friction or force that depends on where the specimen is
    _one("wear_groove", "position", "share", lambda s: 0.7,
         moving(groove="share", groove_pitch="pitch_mm", groove_phase="phase_rad"),
         lambda g, s: {"pitch_mm": float(g.uniform(0.25, 0.7)) * s.largest_mm,
                       "phase_rad": float(g.uniform(0, 2 * np.pi))}),
    _one("misaligned_rod", "position", "share", lambda s: 1.5,
         lambda p: Acting(
             position_factor=lambda d: 1.0 + p["share"] * np.abs((d - p["at_mm"]) / p["length_mm"]) ** p["power"]),
         lambda g, s: {"at_mm": float(g.uniform(-0.7, 0.7)) * s.largest_mm, "length_mm": s.largest_mm,
                       "power": float(g.choice([1.0, 2.0]))}),
    _one("detent", "position", "depth_N", lambda s: 2.0 * s.friction_rms_N,
         spring(lambda d, p: p["depth_N"] * (x := (d - p["at_mm"]) / p["width_mm"]) * np.exp(-0.5 * x**2)),
         lambda g, s: {"at_mm": float(g.uniform(-0.6, 0.6)) * min(s.amplitudes_mm),
                       "width_mm": float(g.uniform(0.05, 0.2)) * s.largest_mm}),
    # on how fast it moves
    _one("quadratic_drag", "rate", "c_N_s2_mm2", lambda s: 2 * s.friction_rms_N / s.speed_mm_s**2,
         damper(lambda v, p: p["c_N_s2_mm2"] * v * np.abs(v))),
    _one("lubrication_peak", "rate", "share", lambda s: 1.0,
         slip_speed(lambda w, p: 1.0 + p["share"] * np.exp(-0.5 * ((w - p["at_mm_s"]) / p["width_mm_s"]) ** 2)),
         lambda g, s: {"at_mm_s": (at := float(g.uniform(0.2, 0.6)) * s.speed_mm_s),
                       "width_mm_s": float(g.uniform(0.2, 0.5)) * at}),
    # resonances
    _one("base_resonance", "resonance", "mobility_mm_N", lambda s: 0.06, _base,
         lambda g, s: {"resonance_hz": float(g.uniform(1.3, 2.2)) * max(s.frequencies_hz),
                       "damping_ratio": float(g.uniform(0.02, 0.06))}),
    _one("fixture_resonance", "resonance", "share", lambda s: 1.0, _ringing_path,
         lambda g, s: {"resonance_hz": float(g.uniform(2.2, 4.0)) * max(s.frequencies_hz),
                       "damping_ratio": float(g.uniform(0.03, 0.1))}),
    # what differs from cycle to cycle
    _one("rocking", "cycle", "share", lambda s: 0.9, moving(rocking="share")),
    _one("loose_debris", "cycle", "sd_share", lambda s: 0.5, _debris, _seed, evolves=True),
    _one("subharmonic_whirl", "half frequency", "amplitude_N", lambda s: 0.6 * s.friction_rms_N, _whirl,
         lambda g, s: {"order": float(g.choice([0.5, g.uniform(0.42, 0.49)]))}),
    # jumps and impacts
    _one("stick_slip", "jumps", "amplitude_N", lambda s: 2.0 * s.friction_rms_N, _stick_slip,
         uniform("largest_mm", jump_mm=(0.05, 0.3))),
    _one("impact_chatter", "impact", "amplitude_N", lambda s: 1.5 * s.friction_rms_N, _chatter,
         uniform(decay_s=(0.004, 0.012), ringing_hz=(90.0, 200.0))),
    # what differs from test to test
    _between_tests("remount_scatter", "between tests", 0.15, "stiffness_scatter"),
    _between_tests("room_climate", "between tests", 0.3, "friction_scatter"),
    # gains
    _between_tests("range_switching", "gain", 0.12, "gain_scatter"),
    _one("two_ranges", "gain", "gain_error", lambda s: 0.3,
         lambda p: Acting(chain=Chain(saturation=lambda f: f * (1.0 + p["gain_error"] * (np.abs(f) > p["change_N"])))),
         uniform("force_peak_N", change_N=(0.3, 0.8))),
    _one("amplitude_gain", "gain", "gain_error", lambda s: 0.3,
         lambda p: Acting(amplitude_gain=lambda a: 1.0 + p["gain_error"] * a / p["largest_mm"]),
         lambda g, s: {"largest_mm": s.largest_mm}),
    # readings that lag at reversals
    _one("sensor_hysteresis", "hysteresis", "lag_mm", lambda s: 0.1 * s.largest_mm, measuring(reading_lag_mm="lag_mm")),
    _one("cell_hysteresis", "hysteresis", "lag_N", lambda s: 0.8 * s.friction_rms_N, measuring(cell_lag_N="lag_N")),
    # the channel's zero, noise and steps
    _one("slow_zero", "zero", "amplitude_N", lambda s: s.friction_rms_N, _slow_zero,
         uniform("record_s", period_s=(0.2, 0.8)), evolves=True),
    _one("noise_bursts", "noise", "amplitude_N", lambda s: 3.0 * s.friction_rms_N, _bursts,
         lambda g, s: {"every_s": float(g.uniform(0.05, 0.3)) * s.record_s, "lasts_s": float(g.uniform(0.002, 0.05))},
         evolves=True),
    _one("coarse_steps", "steps", "step_N", lambda s: s.friction_rms_N,
         lambda p: Acting(chain=Chain(saturation=lambda f: p["step_N"] * np.round(f / p["step_N"])))),
)  # fmt: skip
