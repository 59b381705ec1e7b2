"""Faults of the specimen beside its friction: further forces of displacement, speed and memory.

Laws after: Lakes, Viscoelastic Materials (2009), on spectra of relaxation times; Scott Blair (1947) on the springpot;
Carreau (1972) on shear thinning; Terenzi (1999) on dampers with |v|^p; Johnson, Contact Mechanics (1985), and Hunt &
Crossley (1975) on stops; Fung (1967) on exponential hardening.
"""

from collections.abc import Callable

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.virtual_rig.fault import Acting, Acts, Draw, FaultKind, Law, Parameters, Surroundings
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.law_parts import damper, linear, log_uniform, spring, uniform


def _reaching(draw: Draw) -> Draw:
    """The largest deformation, in the parameters of a law that is given there, before what else is drawn."""
    return lambda g, s: {"reach_mm": s.largest_mm, **draw(g, s)}


# ---- viscous damping: c is the damping of a linear one with the same force at the reference speed


def _draw_power(rng: np.random.Generator, s: Surroundings) -> Parameters:
    power = rng.uniform(0.35, 0.75) if rng.random() < 0.5 else rng.uniform(1.2, 1.5)
    return {"power": float(power), "reference_mm_s": 0.5 * s.speed_mm_s}


def _power(v: Array, p: Parameters) -> Array:
    v0 = p["reference_mm_s"]
    return p["c_N_s_mm"] * v0 * np.sign(v) * np.abs(v / v0) ** p["power"]


def _blow_off(v: Array, p: Parameters) -> Array:
    """A relief valve opens at a speed: beyond it the force grows at a fifth of its pace."""
    opens = p["opens_mm_s"]
    return p["c_N_s_mm"] * np.sign(v) * (np.minimum(np.abs(v), opens) + 0.2 * np.maximum(np.abs(v) - opens, 0.0))


VISCOUS = FaultKind(
    "viscous_damping", "c_N_s_mm", linear(lambda s: 2 * s.stiffness_N_mm / s.fastest_rad_s), (
        Law("linear", damper(lambda v, p: p["c_N_s_mm"] * v)),
        Law("power", damper(_power), _draw_power),
        Law("shear_thinning", damper(lambda v, p: p["c_N_s_mm"] * v / np.sqrt(1.0 + (v / p["thinning_mm_s"]) ** 2)),
            uniform("speed_mm_s", thinning_mm_s=(0.2, 0.6))),
        Law("blow_off", damper(_blow_off), uniform("speed_mm_s", opens_mm_s=(0.25, 0.6))),
        Law("one_way_valve", damper(lambda v, p: p["c_N_s_mm"] * np.where(v > 0.0, v, p["return_ratio"] * v)),
            uniform(return_ratio=(0.3, 0.7))),
    ),
)  # fmt: skip


# ---- a branch that relaxes


def _branches(k_N_mm: object, tau_s: object) -> Acting:
    return Acting(motion=FaultValues(branch_k=np.asarray(k_N_mm), branch_tau=np.asarray(tau_s)))


def _springpot(p: Parameters) -> Acting:
    """A power law of relaxation over four decades of times, two branches a decade."""
    tau = np.logspace(-4.0, 0.0, 9)
    weight = (tau / p["tau_s"]) ** -p["order"]
    return _branches(p["k_N_mm"] * weight / weight[np.argmin(np.abs(np.log(tau / p["tau_s"])))] * 0.4, tau)


def _spread_times(p: Parameters) -> Acting:
    weight = np.exp(-0.5 * np.linspace(-2.0, 2.0, 7) ** 2)
    return _branches(p["k_N_mm"] * weight / weight.sum(), p["tau_s"] * np.exp(p["spread"] * np.linspace(-2.0, 2.0, 7)))


def _two_times(p: Parameters) -> Acting:
    k, slow = p["k_N_mm"], p["slow_share"]
    return _branches([k * (1 - slow), k * slow], [p["tau_s"], p["slow_tau_s"]])


MAXWELL = FaultKind(
    "maxwell_branch", "k_N_mm", linear(lambda s: 3 * s.stiffness_N_mm), (
        Law("one_time", lambda p: _branches([p["k_N_mm"]], [p["tau_s"]])),
        Law("springpot", _springpot, uniform(order=(0.2, 0.6))),
        Law("lognormal_times", _spread_times, uniform(spread=(0.6, 1.4))),
        Law("two_times", _two_times,
            lambda g, s: {"slow_share": float(g.uniform(0.3, 0.7)), "slow_tau_s": log_uniform(g, 0.1, 0.6)}),
    ),
    lambda g, s: {"tau_s": log_uniform(g, 0.002, 0.06)},
)  # fmt: skip


# ---- springs that are not straight; parameters are those of the leading power at the reach


def _hardening(d: Array, p: Parameters) -> Array:
    """Hardens to one side as collagen does: k2·d² is its first term, the straight one taken off."""
    a = p["steepness"] / p["reach_mm"]
    return 2 * p["k2_N_mm2"] / a**2 * (np.exp(a * d) - 1.0 - a * d)


def _two_slopes(d: Array, p: Parameters) -> Array:
    """Another stiffness to either side of a rounded corner."""
    k = p["k2_N_mm2"] * p["reach_mm"]
    corner, place = p["corner_share"] * p["reach_mm"], p["place_share"] * p["reach_mm"]
    return k * (np.sqrt((d - place) ** 2 + corner**2) - np.sqrt(place**2 + corner**2))


QUADRATIC = FaultKind(
    "quadratic_stiffness", "k2_N_mm2", linear(lambda s: 2 * s.stiffness_N_mm / s.largest_mm), (
        Law("square", spring(lambda d, p: p["k2_N_mm2"] * d**2)),
        Law("exponential", spring(_hardening), _reaching(uniform(steepness=(0.8, 2)))),
        Law("one_sided", spring(lambda d, p: 2 * p["k2_N_mm2"] * np.where(d > 0.0, d * d, 0.0))),
        Law("two_slopes", spring(_two_slopes), _reaching(uniform(corner_share=(0.1, 0.4), place_share=(-0.2, 0.2)))),
    ),
    signed=True,
)  # fmt: skip


def _with_knee(force_N: Callable[[Array, float, float, float], Array]) -> Acts:
    """A spring with a knee on either side: force_N(deformation, stiffness of the cube at the reach, place of the knee,
    reach)."""

    def of(d: Array, p: Parameters) -> Array:
        reach = p["reach_mm"]
        return force_N(d, p["k3_N_mm3"] * reach**2, p["bend_share"] * reach, reach)

    return spring(of)


def _trilinear(d: Array, k: float, at: float, reach: float) -> Array:
    """Straight up to a displacement on either side, another slope beyond."""
    w = 0.05 * reach
    return k * np.sign(d) * w * np.logaddexp(0.0, (np.abs(d) - at) / w)


CUBIC = FaultKind(
    "cubic_stiffness", "k3_N_mm3", linear(lambda s: 2 * s.stiffness_N_mm / s.largest_mm**2), (
        Law("cube", spring(lambda d, p: p["k3_N_mm3"] * d**3)),
        Law("bends", _with_knee(_trilinear), _reaching(uniform(bend_share=(0.35, 0.65)))),
        # a stiffness that fades out at large displacements: the straight part taken off
        Law("tanh", _with_knee(lambda d, k, at, reach: k * (d - at * np.tanh(d / at))),
            _reaching(uniform(bend_share=(0.3, 0.8)))),
        Law("sinh", _with_knee(lambda d, k, at, reach: k * (at * np.sinh(d / at) - d) / np.sinh(reach / at)),
            _reaching(uniform(bend_share=(0.2, 0.4)))),
    ),
    signed=True,
)  # fmt: skip


# ---- a stop on one side


def _stop(power: float, loss: bool = False) -> Acts:
    def acts(p: Parameters) -> Acting:
        k = p["k_N_mm"] * p.get("indent_mm", 1.0) ** (1.0 - power)
        lost = p["loss_s_m"] if loss else 0.0
        return Acting(motion=FaultValues(stop_gap=p["clearance_mm"], stop_k=k, stop_power=power, stop_loss_s_m=lost))

    return acts


def _rounded(d: Array, p: Parameters) -> Array:
    return p["k_N_mm"] * p["width_mm"] * np.logaddexp(0.0, (d - p["clearance_mm"]) / p["width_mm"])


def _two_stages(d: Array, p: Parameters) -> Array:
    first, second = (np.maximum(d - p[gap], 0.0) for gap in ("clearance_mm", "second_clearance_mm"))
    return 0.3 * p["k_N_mm"] * first + p["k_N_mm"] * second


def _both_sides(d: Array, p: Parameters) -> Array:
    pressed = np.maximum(np.abs(d) - p["clearance_mm"], 0.0)
    return np.sign(d) * (p["k_N_mm"] * p["indent_mm"] ** -0.5) * pressed**1.5


def _indent(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {"indent_mm": 0.2 * s.largest_mm}


END_STOP = FaultKind(
    "end_stop", "k_N_mm", linear(lambda s: 60.0), (
        Law("straight", _stop(1.0)),
        Law("hertz", _stop(1.5), _indent),
        Law("lossy", _stop(1.0, loss=True), uniform(loss_s_m=(5.0, 25.0))),
        Law("rounded", spring(_rounded), uniform("largest_mm", width_mm=(0.03, 0.08))),
        Law("two_stage", spring(_two_stages), uniform("largest_mm", second_clearance_mm=(0.8, 0.92))),
        Law("hertz_both_sides", spring(_both_sides), _indent),
    ),
    uniform("largest_mm", clearance_mm=(0.5, 0.78)),
)  # fmt: skip


# ---- springs that soften along a record

SOFTENING = FaultKind(
    "spring_softening", "drop", linear(lambda s: 0.5), (
        Law("settles",
            lambda p: Acting(motion=FaultValues(warming_1_s=p["drop"] / p["tau_s"], warming_tau=p["tau_s"])),
            evolves=True),
        Law("steadily", lambda p: Acting(motion=FaultValues(warming_1_s=p["drop"] / p["record_s"])),
            lambda g, s: {"record_s": s.record_s}, True),
        # with the power that friction turns to heat: the drop is that at the reference power
        Law("friction_heat",
            lambda p: Acting(motion=FaultValues(heat_loss_1_mW=p["drop"] / p["reference_mW"], heat_tau=p["tau_s"])),
            lambda g, s: {"tau_s": float(g.uniform(0.5, 3.0)), "reference_mW": s.power_mW}, True),
    ),
    lambda g, s: {"tau_s": log_uniform(g, 0.1, 0.6) * s.record_s},
)  # fmt: skip

KINDS = (VISCOUS, MAXWELL, QUADRATIC, CUBIC, END_STOP, SOFTENING)
