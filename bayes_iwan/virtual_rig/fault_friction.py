"""Faults of the friction itself: what slip speed, time, cycles and direction do to the slip forces.

Laws after: Armstrong-Hélouvry, Dupont & Canudas de Wit (1994) on falling friction; Dieterich (1979) and Ruina (1983) on
contacts that age; Eyring's arcsinh and power laws of strengthening (Persson, Sliding Friction, 2000); Prakash &
Clifton (1993) on the lag behind normal force; Findley, Lai & Onaran (1976) on recovery that is no exponential and has
several times; Archard (1953) and Blau (2005) on wear and running-in; Ettles (1986) on friction that its own heat
lowers.
"""

from collections.abc import Callable

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.virtual_rig.fault import Acting, Acts, FaultKind, Law, Parameters
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.law_parts import linear, log_uniform, moving, slip_speed, uniform

# ---- friction that falls with slip speed


def _falling(shape: Callable[[Array], Array]) -> Acts:
    return slip_speed(lambda w, p: 1.0 - p["drop"] * shape(w / (1e3 * p["v_s_m_s"])))


def _ageing(p: Parameters) -> Acting:
    """Dieterich's ageing: the logarithm of the contact's age, which slip renews over a length."""
    cut = p["length_mm"] / (1e3 * p["v_s_m_s"])
    drop, length, longest = p["drop"], p["length_mm"], max(p["rest_s"], 2 * cut)
    return Acting(motion=FaultValues(healing=drop, healing_slip=length, healing_cut=cut, healing_time=longest))


STRIBECK = FaultKind(
    "stribeck_weakening", "drop", linear(lambda s: 0.6), (
        Law("exponential", _falling(lambda x: 1.0 - np.exp(-x))),
        Law("gaussian", _falling(lambda x: 1.0 - np.exp(-(x**2)))),
        Law("lorentzian", _falling(lambda x: x**2 / (1.0 + x**2))),
        Law("hyperbolic", _falling(lambda x: x / (1.0 + x))),
        Law("ageing", _ageing,
            lambda g, s: {"length_mm": float(g.uniform(0.01, 0.04)) * s.largest_mm,
                          "rest_s": 0.25 / min(s.frequencies_hz)}),
        # friction that grows while a slider sticks and breaks down over a slip distance: a peak after each reversal
        Law("breakaway",
            lambda p: Acting(
                motion=FaultValues(ageing=2.5 * p["drop"], ageing_tau=p["ageing_s"], ageing_slip=p["slip_mm"])),
            lambda g, s: {"ageing_s": log_uniform(g, 0.002, 0.02),
                          "slip_mm": float(g.uniform(0.02, 0.08)) * s.largest_mm}),
    ),
    lambda g, s: {"v_s_m_s": log_uniform(g, 0.004, 0.04)},
)  # fmt: skip


# ---- friction that rises with it


def _rising(shape: Callable[[Array, Parameters], Array]) -> Acts:
    return slip_speed(lambda w, p: 1.0 + p["c"] * shape(w / (1e3 * p["v0_m_s"]), p))


RATE = FaultKind(
    "rate_strengthening", "c", linear(lambda s: 0.3), (
        Law("logarithm", _rising(lambda x, p: np.log1p(x))),
        # a power of nothing has no slope: rounded at a twentieth of v0
        Law("power", _rising(lambda x, p: (x + 0.05) ** p["power"] - 0.05 ** p["power"]), uniform(power=(0.15, 0.5))),
        Law("arcsinh", _rising(lambda x, p: np.arcsinh(x))),
        Law("saturating", _rising(lambda x, p: 2.0 * x / (p["saturation"] + x)), uniform(saturation=(5.0, 20.0))),
    ),
    lambda g, s: {"v0_m_s": log_uniform(g, 0.001, 0.02)},
)  # fmt: skip


# ---- a normal force that acts late

LAG = FaultKind(
    "normal_force_lag", "tau_s", linear(lambda s: 0.03), (
        Law("first_order", moving(lag_rise_s="tau_s", lag_fall_s="tau_s")),
        Law("second_order",
            lambda p: Acting(motion=FaultValues(
                lag_rise_s=0.5 * p["tau_s"], lag_fall_s=0.5 * p["tau_s"], lag_second_s=0.5 * p["tau_s"]))),
        Law("slow_release",
            lambda p: Acting(motion=FaultValues(
                lag_rise_s=p["tau_s"], lag_fall_s=p["ratio"] * p["tau_s"], lag_quick=p["quick"])),
            uniform(ratio=(2.0, 6.0), quick=(3.0, 10.0))),
        Law("with_transient",
            lambda p: Acting(motion=FaultValues(
                lag_rise_s=p["tau_s"], lag_fall_s=p["tau_s"], lag_slow_share=p["slow_share"],
                lag_slow_s=p["slow_ratio"] * p["tau_s"],
                lag_slower_s=p["slower_ratio"] * p["slow_ratio"] * p["tau_s"])),
            uniform(slow_share=(0.2, 0.5), slow_ratio=(4.0, 12.0), slower_ratio=(3.0, 8.0)), True),
    ),
)  # fmt: skip


# ---- friction that changes with the cycles


def _fading(shape: Callable[[Array], Array], by_work: bool = False, drags: bool = False) -> Acts:
    def acts(p: Parameters) -> Acting:
        work, power = p["work_a_cycle_Nmm"] if by_work else 0.0, p["stiffness_power"] if drags else 0.0
        faded = FaultValues(fade_work_Nmm=work, fade_stiffness=power)
        return Acting(motion=faded, fade_factor=lambda x: 1.0 - p["drop"] * shape(x / p["cycles"]))

    return acts


FADE = FaultKind(
    "friction_fade", "drop", linear(lambda s: 0.5), (
        Law("exponential", _fading(lambda x: 1.0 - np.exp(-x)), evolves=True),
        Law("power", _fading(lambda x: 1.0 - (1.0 + x) ** -0.5), evolves=True),
        Law("logarithm", _fading(lambda x: np.log1p(x) / np.log(10.0)), evolves=True),
        Law("work", _fading(lambda x: 1.0 - np.exp(-x), by_work=True),
            lambda g, s: {"work_a_cycle_Nmm": 3.5 * s.friction_rms_N * s.largest_mm}, True),
        Law("recovers", _fading(lambda x: x * np.exp(1.0 - x)), evolves=True),
        Law("with_stiffness", _fading(lambda x: 1.0 - np.exp(-x), drags=True),
            uniform(stiffness_power=(0.3, 1.0)), True),
        # a temperature that friction's own power raises and the surroundings take down again within a time
        Law("heat",
            lambda p: Acting(motion=FaultValues(heat_fade_1_mW=p["drop"] / p["reference_mW"], heat_tau=p["tau_s"])),
            lambda g, s: {"tau_s": log_uniform(g, 0.1, 0.6) * s.record_s, "reference_mW": s.power_mW},
            True),
    ),
    lambda g, s: {"cycles": log_uniform(g, 4.0, 25.0)},
)  # fmt: skip


# ---- friction that differs between to and fro, on the slip limits alone


def _directional(p: Parameters) -> Acting:
    """Of the two further parameters a law has one or none."""
    speed, slope = p.get("speed_mm_s", 0.0), p.get("slope_1_mm", 0.0)
    return Acting(motion=FaultValues(direction=p["asymmetry"], direction_speed=speed, direction_slope_1_mm=slope))


DIRECTION = FaultKind(
    "direction_dependent_friction", "asymmetry", linear(lambda s: 0.45), (
        Law("limits", _directional),
        Law("with_speed", _directional, uniform("speed_mm_s", speed_mm_s=(0.1, 0.4))),
        Law("with_position", _directional,
            lambda g, s: {"slope_1_mm": float(g.choice([-1, 1]) * g.uniform(0.3, 0.8)) / s.largest_mm}),
    ),
    signed=True,
)  # fmt: skip

KINDS = (STRIBECK, RATE, LAG, FADE, DIRECTION)
