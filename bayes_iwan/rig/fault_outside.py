"""Faults that no catalogue lists: the right answer to them is that the cause is unknown.

With the catalogue's nearest member and the cosine between the two changes of the force once the specimen's own
parameters are adjusted (measured on Table 1 at 8, 14, 25 Hz and 0.3, 0.6, 1 mm, each by its first law):
`quadratic_drag` (rate_strengthening 0.81), `base_resonance` (the fixture under the specimen swings; moving_mass 0.65),
`sensor_hysteresis` (the reading lags at reversals; force_highpass 0.54), `remount_scatter` (the stiffness differs from
test to test; moving_mass 0.37), `wear_groove` (friction varies with position; cubic_stiffness 0.31), `rocking` (every
second stroke presses harder; friction_fade 0.21).
Not measured so: `subharmonic_whirl` (a whirl near half the drive's frequency), `fixture_resonance` (the force path
rings), `cell_hysteresis` (the force cell lags), `impact_chatter` (a burst of ringing after each reversal),
`range_switching` (the amplifier's gain differs by test).
For drag and both hystereses the diagnosis has a pattern that names no cause (:mod:`bayes_iwan.effects.unlisted`), for
the hystereses by another law; studies tell them apart from the others.
"""

from __future__ import annotations

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.rig.fault import Acting, Draw, FaultKind, Law, Parameters, linear
from bayes_iwan.rig.kernel import FaultValues
from bayes_iwan.rig.sensors import Chain


def _one(name: str, main: str, ceiling, acts, draw: Draw = lambda g, s: {}) -> FaultKind:
    return FaultKind(name, main, linear(ceiling), (Law(name, acts),), draw, listed=False)


def _base(p: Parameters) -> Acting:
    k = 1.0 / p["mobility_mm_N"]
    mass_kg = 1e3 * k / (2 * np.pi * p["resonance_hz"]) ** 2
    return Acting(motion=FaultValues(base_k=k, base_mass_kg=mass_kg, base_damping_ratio=p["damping_ratio"]))


def _whirl(p: Parameters) -> Acting:
    def add(t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
        turn = 2 * np.pi * p["order"] * cycle + rng.uniform(0, 2 * np.pi)
        return np.asarray(p["amplitude_N"] * (np.sin(turn) + 0.2 * np.sin(2 * turn)))

    return Acting(chain=Chain(additions=(add,)))


def _chatter(p: Parameters) -> Acting:
    def add(t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
        speed = np.gradient(u)
        turns = np.flatnonzero(np.sign(speed[1:]) * np.sign(speed[:-1]) < 0)
        since = np.full(t.size, 1e3)
        for i in turns:
            since[i:] = t[i:] - t[i]
        ringing = np.exp(-since / p["decay_s"]) * np.sin(2 * np.pi * p["ringing_hz"] * since)
        return np.asarray(p["amplitude_N"] * ringing)

    return Acting(chain=Chain(additions=(add,)))


def _ringing_path(p: Parameters) -> Acting:
    """1 + share·(resonance − 1): at share 1 the whole force passes the resonance."""
    w, z, a = 2 * np.pi * p["resonance_hz"], p["damping_ratio"], p["share"]
    ringing = (1.0 - a, 2 * z * w * (1.0 - a), w * w), (1.0, 2 * z * w, w * w)
    return Acting(chain=Chain(force_filters=(ringing,)))


KINDS = (
    _one("quadratic_drag", "c_N_s2_mm2", lambda s: 2 * s.friction_rms_N / s.speed_mm_s**2,
         lambda p: Acting(speed_force=lambda v: p["c_N_s2_mm2"] * v * np.abs(v))),
    _one("wear_groove", "share", lambda s: 0.7,
         lambda p: Acting(
             motion=FaultValues(groove=p["share"], groove_pitch=p["pitch_mm"], groove_phase=p["phase_rad"])),
         lambda g, s: {"pitch_mm": float(g.uniform(0.25, 0.7)) * s.largest_mm,
                       "phase_rad": float(g.uniform(0, 2 * np.pi))}),
    _one("base_resonance", "mobility_mm_N", lambda s: 0.06, _base,
         lambda g, s: {"resonance_hz": float(g.uniform(1.3, 2.2)) * max(s.frequencies_hz),
                       "damping_ratio": float(g.uniform(0.02, 0.06))}),
    _one("rocking", "share", lambda s: 0.9, lambda p: Acting(motion=FaultValues(rocking=p["share"]))),
    _one("remount_scatter", "sd_share", lambda s: 0.15,
         lambda p: Acting(stiffness_scatter=(p["sd_share"], int(p["draw"]))),
         lambda g, s: {"draw": float(g.integers(2**31))}),
    _one("sensor_hysteresis", "lag_mm", lambda s: 0.1 * s.largest_mm,
         lambda p: Acting(chain=Chain(reading_lag_mm=p["lag_mm"]))),
    _one("subharmonic_whirl", "amplitude_N", lambda s: 0.6 * s.friction_rms_N, _whirl,
         lambda g, s: {"order": float(g.choice([0.5, g.uniform(0.42, 0.49)]))}),
    _one("fixture_resonance", "share", lambda s: 1.0, _ringing_path,
         lambda g, s: {"resonance_hz": float(g.uniform(2.2, 4.0)) * max(s.frequencies_hz),
                       "damping_ratio": float(g.uniform(0.03, 0.1))}),
    _one("cell_hysteresis", "lag_N", lambda s: 0.8 * s.friction_rms_N,
         lambda p: Acting(chain=Chain(cell_lag_N=p["lag_N"]))),
    _one("impact_chatter", "amplitude_N", lambda s: 1.5 * s.friction_rms_N, _chatter,
         lambda g, s: {"decay_s": float(g.uniform(0.004, 0.012)), "ringing_hz": float(g.uniform(90.0, 200.0))}),
    _one("range_switching", "sd_share", lambda s: 0.12,
         lambda p: Acting(gain_scatter=(p["sd_share"], int(p["draw"]))),
         lambda g, s: {"draw": float(g.integers(2**31))}),
)  # fmt: skip
