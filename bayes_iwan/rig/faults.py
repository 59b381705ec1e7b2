"""What the virtual rig can have beyond the paper's model: the catalogue's causes, and some from outside it.

An effect here is a name and its numbers; it acts as physics inside the rig. Mechanical effects become numbers
of the kernel (`rig_kernel.Numbers`), those of the measuring chain become `Chain` settings of `rig_sensors`.
The strength of an effect runs from 0 (absent) to 1 (the strongest that a sensible rig or specimen has); the rig
solves for the strength that gives a wanted change of the force.

Outside the catalogue, with the catalogue's nearest member and the cosine between the two changes of the force
once the specimen's own numbers are adjusted (measured on Table 1 at 8, 14, 25 Hz and 0.3, 0.6, 1 mm):
`stiction_peak` (friction grows while a slider rests and breaks down over a slip distance; stribeck_weakening
0.90), `hertz_stops` (on both sides; cubic_stiffness 0.88), `quadratic_drag` (rate_strengthening 0.81),
`base_resonance` (the fixture under the specimen swings; moving_mass 0.65), `sensor_hysteresis` (the reading lags
at reversals; force_highpass 0.54), `heating` (springs soften with the power lost in friction; maxwell_branch
0.52), `remount_scatter` (the stiffness differs from test to test; moving_mass 0.37), `wear_groove` (friction
varies with position; cubic_stiffness 0.31), `rocking` (every second stroke presses harder; friction_fade 0.21).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_iwan.rig.specimen import RigError, Specimen


@dataclass(frozen=True)
class Chain:
    """What the measuring chain adds to two sound channels; every number is 0 (or None) when absent."""

    moving_mass_kg: float = 0.0
    delay_s: float = 0.0
    displacement_highpass_hz: float = 0.0
    force_highpass_hz: float = 0.0
    force_lowpass_hz: float = 0.0
    drift_N_s: float = 0.0
    hum_N: float = 0.0
    hum_hz: float = 50.0
    clip_N: float | None = None
    reading_lag_mm: float = 0.0


@dataclass(frozen=True)
class Surroundings:
    """What the size of a sensible effect depends on: the campaign's motion and forces without it."""

    specimen: Specimen
    frequencies_hz: tuple[float, ...]
    amplitudes_mm: tuple[float, ...]
    record_s: float
    friction_rms_N: float
    force_peak_N: float

    @property
    def fastest_rad_s(self) -> float:
        return 2 * np.pi * max(self.frequencies_hz)

    @property
    def largest_mm(self) -> float:
        return max(self.amplitudes_mm)


@dataclass(frozen=True)
class Effect:
    """One effect as it acts in one rig: `name`, `parameters` with units in their names, `size` if measured.

    `size`: RMS of the change of the force, over RMS friction force (`rig_sizing.effect_size`). `visible`: the share
    of it that no change of the specimen's numbers imitates (`rig_sizing.visible_shares`). nan if not measured.
    """

    name: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    size: float = float("nan")
    visible: float = float("nan")


Parameters = dict[str, float]


@dataclass(frozen=True)
class Kind:
    """A kind of effect: how it is drawn and where it acts.

    `others(rng, surroundings)` draws every number but the strength; `strongest(others, surroundings, strength)`
    completes the parameters for a strength in (0, 1].
    """

    name: str
    catalogue: bool
    main: str
    others: Callable[[np.random.Generator, Surroundings], Parameters]
    at: Callable[[Parameters, Surroundings, float], Parameters]


def _nothing(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {}


def _sign(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {"_sign": float(rng.choice([-1.0, 1.0]))}


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _linear(name: str, ceiling: Callable[[Surroundings], float]) -> Callable[..., Parameters]:
    def at(others: Parameters, s: Surroundings, strength: float) -> Parameters:
        rest = {k: v for k, v in others.items() if not k.startswith("_")}
        return {name: others.get("_sign", 1.0) * ceiling(s) * strength, **rest}

    return at


def _kind(
    name: str,
    main: str,
    ceiling: Callable[[Surroundings], float],
    others: Callable[[np.random.Generator, Surroundings], Parameters] = _nothing,
    catalogue: bool = True,
) -> Kind:
    return Kind(name, catalogue, main, others, _linear(main, ceiling))


def _reference_stiffness(s: Surroundings) -> float:
    """Friction force over displacement: what a stiffness must be compared with."""
    return s.friction_rms_N / (s.largest_mm / np.sqrt(2))


KINDS: dict[str, Kind] = {
    k.name: k
    for k in (
        _kind("viscous_damping", "c_N_s_mm", lambda s: 2 * _reference_stiffness(s) / s.fastest_rad_s),
        _kind("maxwell_branch", "k_N_mm", lambda s: 3 * _reference_stiffness(s),
              lambda g, s: {"tau_s": _log_uniform(g, 0.002, 0.06)}),
        _kind("moving_mass", "m_kg", lambda s: 2e3 * _reference_stiffness(s) / s.fastest_rad_s**2),
        _kind("quadratic_stiffness", "k2_N_mm2", lambda s: 2 * _reference_stiffness(s) / s.largest_mm, _sign),
        _kind("cubic_stiffness", "k3_N_mm3", lambda s: 2 * _reference_stiffness(s) / s.largest_mm**2, _sign),
        _kind("end_stop", "k_N_mm", lambda s: 60.0,
              lambda g, s: {"gap_mm": float(g.uniform(0.5, 0.9)) * s.largest_mm}),
        _kind("stribeck_weakening", "drop", lambda s: 0.6,
              lambda g, s: {"v_s_m_s": _log_uniform(g, 0.004, 0.04)}),
        _kind("rate_strengthening", "c", lambda s: 0.3,
              lambda g, s: {"v0_m_s": _log_uniform(g, 0.001, 0.02)}),
        _kind("normal_force_lag", "tau_s", lambda s: 0.03),
        _kind("friction_fade", "drop", lambda s: 0.5, lambda g, s: {"cycles": _log_uniform(g, 4.0, 25.0)}),
        _kind("direction_dependent_friction", "asymmetry", lambda s: 0.45, _sign),
        _kind("rig_compliance", "compliance_mm_N", lambda s: 0.08),
        _kind("free_play", "play_mm", lambda s: 0.25 * s.largest_mm),
        _kind("channel_delay", "delay_s", lambda s: 0.004, _sign),
        _kind("integration_highpass", "corner_hz", lambda s: 0.15 * min(s.frequencies_hz)),
        _kind("force_highpass", "corner_hz", lambda s: 0.15 * min(s.frequencies_hz)),
        Kind("force_lowpass", True, "corner_hz", _nothing,
             lambda o, s, x: {"corner_hz": 1.0 / (2 * np.pi * 0.004 * x)}),
        _kind("force_drift", "rate_N_s", lambda s: 2.0 * s.friction_rms_N / s.record_s, _sign),
        _kind("mains_hum", "amplitude_N", lambda s: 0.6 * s.friction_rms_N,
              lambda g, s: {"frequency_hz": float(g.choice([50.0, 60.0]))}),
        Kind("force_clipping", True, "limit_N", _nothing,
             lambda o, s, x: {"limit_N": s.force_peak_N * (1.0 - 0.7 * x)}),
        # ---- outside the catalogue
        _kind("stiction_peak", "rise", lambda s: 1.5,
              lambda g, s: {"ageing_s": _log_uniform(g, 0.002, 0.02),
                            "slip_mm": float(g.uniform(0.02, 0.08)) * s.largest_mm}, False),
        _kind("quadratic_drag", "c_N_s2_mm2",
              lambda s: 2 * s.friction_rms_N / (s.largest_mm * s.fastest_rad_s) ** 2, catalogue=False),
        _kind("wear_groove", "share", lambda s: 0.7,
              lambda g, s: {"pitch_mm": float(g.uniform(0.25, 0.7)) * s.largest_mm,
                            "phase_rad": float(g.uniform(0, 2 * np.pi))}, False),
        _kind("hertz_stops", "k_N_mm15", lambda s: 80.0,
              lambda g, s: {"gap_mm": float(g.uniform(0.6, 0.85)) * s.largest_mm}, False),
        _kind("base_resonance", "mobility_mm_N", lambda s: 0.06,
              lambda g, s: {"resonance_hz": float(g.uniform(1.3, 2.2)) * max(s.frequencies_hz),
                            "damping_ratio": float(g.uniform(0.02, 0.06))}, False),
        _kind("rocking", "share", lambda s: 0.9, catalogue=False),
        _kind("remount_scatter", "sd_share", lambda s: 0.15,
              lambda g, s: {"draw": float(g.integers(2**31))}, False),
        _kind("heating", "loss_1_mW",
              lambda s: 0.6 / (4 * s.friction_rms_N * s.largest_mm * max(s.frequencies_hz)),
              lambda g, s: {"tau_s": float(g.uniform(0.5, 3.0))}, False),
        _kind("sensor_hysteresis", "lag_mm", lambda s: 0.1 * s.largest_mm, catalogue=False),
    )
}  # fmt: skip

CATALOGUE: tuple[str, ...] = tuple(k.name for k in KINDS.values() if k.catalogue)
OUTSIDE: tuple[str, ...] = tuple(k.name for k in KINDS.values() if not k.catalogue)
MAIN_PARAMETER: dict[str, str] = {k.name: k.main for k in KINDS.values()}


def complete(name: str, others: Parameters, surroundings: Surroundings, strength: float) -> Effect:
    """The effect `name` at a strength in (0, 1] in these surroundings."""
    numbers = KINDS[name].at(others, surroundings, strength)
    return Effect(name, {k: float(v) for k, v in numbers.items()})


def check(effects: tuple[Effect, ...]) -> None:
    """Raise `RigError` for an unknown name, or for numbers that the effect does not have."""
    for effect in effects:
        if effect.name not in KINDS:
            raise RigError(f"no effect {effect.name!r}; the rig has: {', '.join(KINDS)}")
        if KINDS[effect.name].main not in effect.parameters:
            raise RigError(f"effect {effect.name!r} needs the number {KINDS[effect.name].main!r}")


def kernel_changes(effects: tuple[Effect, ...]) -> dict[str, Any]:
    """The kernel's numbers that these effects change."""
    n: dict[str, Any] = {}
    for e in effects:
        p = e.parameters
        match e.name:
            case "viscous_damping":
                n["viscous"] = p["c_N_s_mm"]
            case "maxwell_branch":
                n["maxwell_k"], n["maxwell_tau"] = p["k_N_mm"], p["tau_s"]
            case "quadratic_stiffness":
                n["k2"] = p["k2_N_mm2"]
            case "cubic_stiffness":
                n["k3"] = p["k3_N_mm3"]
            case "end_stop":
                n["stop_gap"], n["stop_k"], n["stop_loss_s_m"] = p["gap_mm"], p["k_N_mm"], 0.3
            case "stribeck_weakening":
                n["rate_drop"], n["rate_drop_speed"] = p["drop"], 1e3 * p["v_s_m_s"]
            case "rate_strengthening":
                n["rate_rise"], n["rate_rise_speed"] = p["c"], 1e3 * p["v0_m_s"]
            case "normal_force_lag":
                n["normal_lag"] = p["tau_s"]
            case "friction_fade":
                n["fade_drop"], n["fade_cycles"] = p["drop"], p["cycles"]
            case "direction_dependent_friction":
                n["direction"] = p["asymmetry"]
            case "rig_compliance":
                n["extra_compliance"] = p["compliance_mm_N"]
            case "free_play":  # what rattles in it is a light coupling
                n["play"], n["end_mass_kg"], n["end_damping"] = p["play_mm"], 3e-4, 2e-5
            case "stiction_peak":
                n["ageing"], n["ageing_tau"], n["ageing_slip"] = p["rise"], p["ageing_s"], p["slip_mm"]
            case "quadratic_drag":
                n["drag"] = p["c_N_s2_mm2"]
            case "wear_groove":
                n["groove"], n["groove_pitch"], n["groove_phase"] = p["share"], p["pitch_mm"], p["phase_rad"]
            case "hertz_stops":
                n["hertz_gap"], n["hertz_k"] = p["gap_mm"], p["k_N_mm15"]
            case "base_resonance":
                n["base_k"] = 1.0 / p["mobility_mm_N"]
                n["base_mass_kg"] = 1e3 * n["base_k"] / (2 * np.pi * p["resonance_hz"]) ** 2
                n["base_damping_ratio"] = p["damping_ratio"]
            case "rocking":
                n["rocking"] = p["share"]
            case "heating":
                n["heat_loss_1_mW"], n["heat_tau"] = p["loss_1_mW"], p["tau_s"]
    return n


def chain(effects: tuple[Effect, ...]) -> Chain:
    """The measuring chain with these effects in it."""
    c: dict[str, Any] = {}
    for e in effects:
        p = e.parameters
        match e.name:
            case "moving_mass":
                c["moving_mass_kg"] = p["m_kg"]
            case "channel_delay":
                c["delay_s"] = p["delay_s"]
            case "integration_highpass":
                c["displacement_highpass_hz"] = p["corner_hz"]
            case "force_highpass":
                c["force_highpass_hz"] = p["corner_hz"]
            case "force_lowpass":
                c["force_lowpass_hz"] = p["corner_hz"]
            case "force_drift":
                c["drift_N_s"] = p["rate_N_s"]
            case "mains_hum":
                c["hum_N"], c["hum_hz"] = p["amplitude_N"], p["frequency_hz"]
            case "force_clipping":
                c["clip_N"] = p["limit_N"]
            case "sensor_hysteresis":
                c["reading_lag_mm"] = p["lag_mm"]
    return Chain(**c)


def stiffness_factor(effects: tuple[Effect, ...], test_index: int) -> float:
    """By how much the springs of this test differ from the specimen's (remounting between tests)."""
    factor = 1.0
    for e in effects:
        if e.name == "remount_scatter":
            rng = np.random.default_rng([int(e.parameters["draw"]), test_index])
            factor *= float(np.exp(e.parameters["sd_share"] * rng.standard_normal()))
    return factor
