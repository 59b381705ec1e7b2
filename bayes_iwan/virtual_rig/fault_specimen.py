"""Faults of the specimen beside its friction: further forces of displacement, speed and memory.

Laws after: Lakes, Viscoelastic Materials (2009), on spectra of relaxation times; Scott Blair (1947) on the springpot;
Carreau (1972) on shear thinning; Terenzi (1999) on dampers with |v|^p; Johnson, Contact Mechanics (1985), and Hunt &
Crossley (1975) on stops; Fung (1967) on exponential hardening.
"""

from collections.abc import Callable

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.virtual_rig.fault import Acting, Draw, FaultKind, Law, Parameters, Surroundings, linear, log_uniform
from bayes_iwan.virtual_rig.kernel import FaultValues


def _largest(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {"reach_mm": s.largest_mm}


# ---- viscous damping: c is the damping of a linear one with the same force at the reference speed


def _draw_power(rng: np.random.Generator, s: Surroundings) -> Parameters:
    power = rng.uniform(0.35, 0.75) if rng.random() < 0.5 else rng.uniform(1.2, 1.5)
    return {"power": float(power), "reference_mm_s": 0.5 * s.speed_mm_s}


def _blow_off(p: Parameters) -> Acting:
    """A relief valve opens at a speed: beyond it the force grows at a fifth of its pace."""
    c, opens = p["c_N_s_mm"], p["opens_mm_s"]

    def force(v: Array) -> Array:
        return c * np.sign(v) * (np.minimum(np.abs(v), opens) + 0.2 * np.maximum(np.abs(v) - opens, 0.0))

    return Acting(speed_force=force)


VISCOUS = FaultKind(
    "viscous_damping",
    "c_N_s_mm",
    linear(lambda s: 2 * s.stiffness_N_mm / s.fastest_rad_s),
    (
        Law("linear", lambda p: Acting(speed_force=lambda v: p["c_N_s_mm"] * v)),
        Law(
            "power",
            lambda p: Acting(
                speed_force=lambda v: (
                    p["c_N_s_mm"] * (v0 := p["reference_mm_s"]) * np.sign(v) * np.abs(v / v0) ** p["power"]
                )
            ),
            _draw_power,
        ),
        Law(
            "shear_thinning",
            lambda p: Acting(speed_force=lambda v: p["c_N_s_mm"] * v / np.sqrt(1.0 + (v / p["thinning_mm_s"]) ** 2)),
            lambda g, s: {"thinning_mm_s": float(g.uniform(0.2, 0.6)) * s.speed_mm_s},
        ),
        Law("blow_off", _blow_off, lambda g, s: {"opens_mm_s": float(g.uniform(0.25, 0.6)) * s.speed_mm_s}),
        Law(
            "one_way_valve",
            lambda p: Acting(speed_force=lambda v: p["c_N_s_mm"] * np.where(v > 0.0, v, p["return_ratio"] * v)),
            lambda g, s: {"return_ratio": float(g.uniform(0.3, 0.7))},
        ),
    ),
)


# ---- a branch that relaxes


def _springpot(p: Parameters) -> Acting:
    """A power law of relaxation over four decades of times, two branches a decade."""
    tau = np.logspace(-4.0, 0.0, 9)
    weight = (tau / p["tau_s"]) ** -p["order"]
    k = p["k_N_mm"] * weight / weight[np.argmin(np.abs(np.log(tau / p["tau_s"])))] * 0.4
    return Acting(motion=FaultValues(branch_k=k, branch_tau=tau))


def _spread_times(p: Parameters) -> Acting:
    tau = p["tau_s"] * np.exp(p["spread"] * np.linspace(-2.0, 2.0, 7))
    weight = np.exp(-0.5 * np.linspace(-2.0, 2.0, 7) ** 2)
    return Acting(motion=FaultValues(branch_k=p["k_N_mm"] * weight / weight.sum(), branch_tau=tau))


def _two_times(p: Parameters) -> Acting:
    k, slow = p["k_N_mm"], p["slow_share"]
    times = np.array([p["tau_s"], p["slow_tau_s"]])
    return Acting(motion=FaultValues(branch_k=np.array([k * (1 - slow), k * slow]), branch_tau=times))


MAXWELL = FaultKind(
    "maxwell_branch",
    "k_N_mm",
    linear(lambda s: 3 * s.stiffness_N_mm),
    (
        Law(
            "one_time",
            lambda p: Acting(motion=FaultValues(branch_k=np.array([p["k_N_mm"]]), branch_tau=np.array([p["tau_s"]]))),
        ),
        Law("springpot", _springpot, lambda g, s: {"order": float(g.uniform(0.2, 0.6))}),
        Law("lognormal_times", _spread_times, lambda g, s: {"spread": float(g.uniform(0.6, 1.4))}),
        Law(
            "two_times",
            _two_times,
            lambda g, s: {"slow_share": float(g.uniform(0.3, 0.7)), "slow_tau_s": log_uniform(g, 0.1, 0.6)},
        ),
    ),
    lambda g, s: {"tau_s": log_uniform(g, 0.002, 0.06)},
)


# ---- springs that are not straight; parameters are those of the leading power at the reach


def _two_slopes(p: Parameters) -> Acting:
    """Another stiffness to either side of a rounded corner."""
    k = p["k2_N_mm2"] * p["reach_mm"]
    corner, place = p["corner_share"] * p["reach_mm"], p["place_share"] * p["reach_mm"]
    middle = np.sqrt(place**2 + corner**2)
    return Acting(displacement_force=lambda d: k * (np.sqrt((d - place) ** 2 + corner**2) - middle))


QUADRATIC = FaultKind(
    "quadratic_stiffness",
    "k2_N_mm2",
    linear(lambda s: 2 * s.stiffness_N_mm / s.largest_mm),
    (
        Law("square", lambda p: Acting(displacement_force=lambda d: p["k2_N_mm2"] * d**2)),
        # hardens to one side as collagen does: k2·d² is its first term, the straight one taken off
        Law(
            "exponential",
            lambda p: Acting(
                displacement_force=lambda d: (
                    2 * p["k2_N_mm2"] / (a := p["steepness"] / p["reach_mm"]) ** 2 * (np.exp(a * d) - 1.0 - a * d)
                )
            ),
            lambda g, s: {**_largest(g, s), "steepness": float(g.uniform(0.8, 2))},
        ),
        Law(
            "one_sided",
            lambda p: Acting(displacement_force=lambda d: 2 * p["k2_N_mm2"] * np.where(d > 0.0, d * d, 0.0)),
        ),
        Law(
            "two_slopes",
            _two_slopes,
            lambda g, s: {
                **_largest(g, s),
                "corner_share": float(g.uniform(0.1, 0.4)),
                "place_share": float(g.uniform(-0.2, 0.2)),
            },
        ),
    ),
    signed=True,
)


def _trilinear(p: Parameters) -> Acting:
    """Straight up to a displacement on either side, another slope beyond."""
    k, at, w = p["k3_N_mm3"] * p["reach_mm"] ** 2, p["bend_share"] * p["reach_mm"], 0.05 * p["reach_mm"]
    return Acting(displacement_force=lambda d: k * np.sign(d) * w * np.logaddexp(0.0, (np.abs(d) - at) / w))


def _tanh_spring(p: Parameters) -> Acting:
    """A stiffness that fades out at large displacements: the straight part taken off."""
    k, d0 = p["k3_N_mm3"] * p["reach_mm"] ** 2, p["bend_share"] * p["reach_mm"]
    return Acting(displacement_force=lambda d: k * (d - d0 * np.tanh(d / d0)))


def _sinh_spring(p: Parameters) -> Acting:
    k, d0 = p["k3_N_mm3"] * p["reach_mm"] ** 2, p["bend_share"] * p["reach_mm"]
    return Acting(displacement_force=lambda d: k * (d0 * np.sinh(d / d0) - d) / np.sinh(p["reach_mm"] / d0))


def _draw_knee(low: float, high: float) -> Draw:
    return lambda g, s: {"reach_mm": s.largest_mm, "bend_share": float(g.uniform(low, high))}


CUBIC = FaultKind(
    "cubic_stiffness",
    "k3_N_mm3",
    linear(lambda s: 2 * s.stiffness_N_mm / s.largest_mm**2),
    (
        Law("cube", lambda p: Acting(displacement_force=lambda d: p["k3_N_mm3"] * d**3)),
        Law("bends", _trilinear, _draw_knee(0.35, 0.65)),
        Law("tanh", _tanh_spring, _draw_knee(0.3, 0.8)),
        Law("sinh", _sinh_spring, _draw_knee(0.2, 0.4)),
    ),
    signed=True,
)


# ---- a stop on one side


def _stop(power: float, loss: bool = False) -> Callable[[Parameters], Acting]:
    def acts(p: Parameters) -> Acting:
        k = p["k_N_mm"] * p.get("indent_mm", 1.0) ** (1.0 - power)
        lost = p["loss_s_m"] if loss else 0.0
        return Acting(motion=FaultValues(stop_gap=p["clearance_mm"], stop_k=k, stop_power=power, stop_loss_s_m=lost))

    return acts


END_STOP = FaultKind(
    "end_stop",
    "k_N_mm",
    linear(lambda s: 60.0),
    (
        Law("straight", _stop(1.0)),
        Law("hertz", _stop(1.5), lambda g, s: {"indent_mm": 0.2 * s.largest_mm}),
        Law("lossy", _stop(1.0, loss=True), lambda g, s: {"loss_s_m": float(g.uniform(5.0, 25.0))}),
        Law(
            "rounded",
            lambda p: Acting(
                displacement_force=lambda d: (
                    p["k_N_mm"] * p["width_mm"] * np.logaddexp(0.0, (d - p["clearance_mm"]) / p["width_mm"])
                )
            ),
            lambda g, s: {"width_mm": float(g.uniform(0.03, 0.08)) * s.largest_mm},
        ),
        Law(
            "two_stage",
            lambda p: Acting(
                displacement_force=lambda d: (
                    0.3 * p["k_N_mm"] * np.maximum(d - p["clearance_mm"], 0.0)
                    + p["k_N_mm"] * np.maximum(d - p["second_clearance_mm"], 0.0)
                )
            ),
            lambda g, s: {"second_clearance_mm": float(g.uniform(0.8, 0.92)) * s.largest_mm},
        ),
        Law(
            "hertz_both_sides",
            lambda p: Acting(
                displacement_force=lambda d: (
                    np.sign(d)
                    * (p["k_N_mm"] * p["indent_mm"] ** -0.5)
                    * np.maximum(np.abs(d) - p["clearance_mm"], 0.0) ** 1.5
                )
            ),
            lambda g, s: {"indent_mm": 0.2 * s.largest_mm},
        ),
    ),
    lambda g, s: {"clearance_mm": float(g.uniform(0.5, 0.78)) * s.largest_mm},
)

# ---- springs that soften along a record


SOFTENING = FaultKind(
    "spring_softening",
    "drop",
    linear(lambda s: 0.5),
    (
        Law(
            "settles",
            lambda p: Acting(motion=FaultValues(warming_1_s=p["drop"] / p["tau_s"], warming_tau=p["tau_s"])),
            evolves=True,
        ),
        Law(
            "steadily",
            lambda p: Acting(motion=FaultValues(warming_1_s=p["drop"] / p["record_s"])),
            lambda g, s: {"record_s": s.record_s},
            True,
        ),
        # with the power that friction turns to heat: the drop is that at the reference power
        Law(
            "friction_heat",
            lambda p: Acting(motion=FaultValues(heat_loss_1_mW=p["drop"] / p["reference_mW"], heat_tau=p["tau_s"])),
            lambda g, s: {"tau_s": float(g.uniform(0.5, 3.0)), "reference_mW": s.power_mW},
            True,
        ),
    ),
    lambda g, s: {"tau_s": log_uniform(g, 0.1, 0.6) * s.record_s},
)

KINDS = (VISCOUS, MAXWELL, QUADRATIC, CUBIC, END_STOP, SOFTENING)
