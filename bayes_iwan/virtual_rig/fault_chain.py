"""Faults of mounting and measuring: joints, play, masses, filters, drift, mains, saturation.

Laws after: Greenwood & Williamson (1966) on joints that stiffen under load; Hertz on soft contacts; Oppenheim & Schafer
on all-pass, Bessel and Butterworth responses; EN 50160 on what mains voltages are like.
A filter is a transfer function (numerator, denominator) in s, rad/s.
"""

from collections.abc import Callable

import numpy as np
from scipy import signal

from bayes_iwan.arrays import Array
from bayes_iwan.virtual_rig.fault import Acting, Acts, FaultKind, Law, Parameters, Surroundings
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.law_parts import linear, measuring, uniform
from bayes_iwan.virtual_rig.sensors import Chain, Transfer

# ---- between sensor and specimen


def _joint(stretch: Callable[[Array], Array]) -> Acts:
    """A joint whose compliance falls with load: its stretch over the reference force's, of the force over that."""
    return lambda p: Acting(
        joint_stretch=lambda f: p["compliance_mm_N"] * p["reference_N"] * stretch(f / p["reference_N"])
    )


_load = uniform("force_peak_N", reference_N=(0.2, 0.6))
COMPLIANCE = FaultKind(
    "rig_compliance", "compliance_mm_N", linear(lambda s: 0.08), (
        Law("linear", lambda p: Acting(extra_compliance_mm_N=p["compliance_mm_N"])),
        Law("stiffening", _joint(np.arcsinh), _load),
        Law("hertz", _joint(lambda x: (x + 0.02) ** (2 / 3) - 0.02 ** (2 / 3)), _load),
    ),
)  # fmt: skip


def _loose(play_mm: float) -> FaultValues:
    """What rattles in a play is a light coupling."""
    return FaultValues(play=play_mm, end_mass_kg=3e-4, end_damping=2e-5)


def _soft_play(stretch: Callable[[Array], Array]) -> Acts:
    """A play whose ends give: by a share of its width at the reference force."""

    def acts(p: Parameters) -> Acting:
        give, f0 = p["give_share"] * p["play_mm"], p["reference_N"]
        return Acting(motion=_loose(p["play_mm"]), joint_stretch=lambda f: give * stretch(f / f0))

    return acts


def _give(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {"give_share": float(rng.uniform(0.15, 0.6)), "reference_N": 0.5 * s.force_peak_N}


PLAY = FaultKind(
    "free_play", "play_mm", linear(lambda s: 0.25 * s.largest_mm), (
        Law("hard", lambda p: Acting(motion=_loose(p["play_mm"]))),
        Law("hertz_ends", _soft_play(lambda x: (x + 0.01) ** (2 / 3) - 0.01 ** (2 / 3)), _give),
        Law("rough_ends", _soft_play(lambda x: np.log1p(20.0 * x) / np.log(21.0)), _give),
    ),
)  # fmt: skip

MASS = FaultKind(
    "moving_mass", "m_kg", linear(lambda s: 2e3 * s.stiffness_N_mm / s.fastest_rad_s**2), (
        Law("rigid", measuring(moving_mass_kg="m_kg")),
        Law("soft_mount", measuring(moving_mass_kg="m_kg", mass_mount_hz="mount_hz", mass_mount_ratio="ratio"),
            lambda g, s: {"mount_hz": float(g.uniform(2.0, 4.0)) * max(s.frequencies_hz),
                          "ratio": float(g.uniform(0.03, 0.4))}),
    ),
)  # fmt: skip


# ---- delays and filters


def first_order(corner_hz: float, high: bool) -> Transfer:
    w = 2 * np.pi * corner_hz
    return ((1.0, 0.0) if high else (w,)), (1.0, w)


def _order(design: str, order: int, corner_hz: float, high: bool = False) -> Transfer:
    w, kind = 2 * np.pi * corner_hz, "highpass" if high else "lowpass"
    if design == "bessel":
        b, a = signal.bessel(order, w, kind, analog=True, norm="delay" if not high else "mag")
    else:
        b, a = signal.butter(order, w, kind, analog=True)
    return tuple(map(float, b)), tuple(map(float, a))


def _delayed(filtered: Callable[[float], Transfer]) -> Acts:
    """A response with this delay at low frequencies, in the channel that comes late."""
    return lambda p: Acting(chain=(_force if p["delay_s"] > 0 else _displacement)(filtered(abs(p["delay_s"]))))


DELAY = FaultKind(
    "channel_delay", "delay_s", linear(lambda s: 0.004), (
        Law("pure", measuring(delay_s="delay_s")),
        Law("all_pass", _delayed(lambda t: ((-0.5 * t, 1.0), (0.5 * t, 1.0)))),
        Law("second_order", _delayed(lambda t: ((1.0,), (0.36 * t * t, t, 1.0)))),
    ),
    signed=True,
)  # fmt: skip


#: the name of a law, and its filter for a corner frequency (Hz)
Design = tuple[str, Callable[[float], Transfer]]


def _through(chain: Callable[[Transfer], Chain], *designs: Design) -> tuple[Law, ...]:
    def law(name: str, design: Callable[[float], Transfer]) -> Law:
        return Law(name, lambda p: Acting(chain=chain(design(p["corner_hz"]))))

    return tuple(law(*one) for one in designs)


def _displacement(transfer: Transfer) -> Chain:
    return Chain(displacement_filters=(transfer,))


def _force(transfer: Transfer) -> Chain:
    return Chain(force_filters=(transfer,))


def _twice(corner_hz: float) -> Transfer:
    """Two equal corners in a row, each at half the frequency: the same phase far above."""
    w = np.pi * corner_hz
    return (1.0, 0.0, 0.0), (1.0, 2 * w, w * w)


def _shelf(corner_hz: float) -> Transfer:
    """A leak that stops at a tenth of the corner: the mean survives, reduced."""
    w = 2 * np.pi * corner_hz
    return (1.0, 0.1 * w), (1.0, w)


_HIGH = (
    ("first_order", lambda f: first_order(f, True)),
    ("second_order", lambda f: _order("butter", 2, f, True)),
    ("two_corners", _twice),
    ("shelf", _shelf),
)
_below_all = linear(lambda s: 0.15 * min(s.frequencies_hz))
INTEGRATION = FaultKind("integration_highpass", "corner_hz", _below_all, _through(_displacement, *_HIGH))
HIGH_PASS = FaultKind("force_highpass", "corner_hz", _below_all, _through(_force, *_HIGH))
LOW_PASS = FaultKind(
    "force_lowpass", "corner_hz", lambda s, strength: 1.0 / (2 * np.pi * 0.004 * strength),
    _through(
        _force,
        ("first_order", lambda f: first_order(f, False)),
        ("butterworth", lambda f: _order("butter", 2, f)),
        ("bessel", lambda f: _order("bessel", 2, f)),
        ("fourth_order", lambda f: _order("butter", 4, f)),
    ),
)  # fmt: skip


# ---- what is added to the force


def _added(shape: Callable[[Array, Parameters, np.random.Generator], Array]) -> Acts:
    """`shape(t, p, rng)` times the rate and the record's length; nothing before the record starts."""

    def acts(p: Parameters) -> Acting:
        def add(t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
            return p["rate_N_s"] * p.get("record_s", 1.0) * shape(np.maximum(t, 0.0), p, rng)

        return Acting(chain=Chain(additions=(add,)))

    return acts


def _wander(t: Array, p: Parameters, rng: np.random.Generator) -> Array:
    """A random walk in twenty strides, of the record's length in RMS at its end."""
    knots = np.linspace(0.0, p["record_s"], 21)
    walk = np.concatenate([[0.0], np.cumsum(rng.standard_normal(20))]) / np.sqrt(20)
    return np.asarray(np.interp(t, knots, walk))


def _record(rng: np.random.Generator, s: Surroundings) -> Parameters:
    return {"record_s": s.record_s}


DRIFT = FaultKind(
    "force_drift", "rate_N_s", linear(lambda s: 2.0 * s.friction_rms_N / s.record_s), (
        Law("steady", _added(lambda t, p, rng: t), evolves=True),
        Law("settling", _added(lambda t, p, rng: 1.0 - np.exp(-t / (p["settle_share"] * p["record_s"]))),
            lambda g, s: {**_record(g, s), "settle_share": float(g.uniform(0.15, 0.5))}, True),
        Law("random_walk", _added(_wander), _record, True),
        Law("root_of_time", _added(lambda t, p, rng: np.sqrt(t / p["record_s"])), _record, True),
    ),
    signed=True,
)  # fmt: skip


def _mains(third: float, fifth: float, wander_hz: float = 0.0, beat: float = 0.0) -> Acts:
    def acts(p: Parameters) -> Acting:
        def add(t: Array, cycle: Array, u: Array, rng: np.random.Generator) -> Array:
            phase, off = rng.uniform(0, 2 * np.pi, 3), 0.03 * rng.standard_normal()
            turn = 2 * np.pi * (p["frequency_hz"] + off) * t + phase[0]
            if wander_hz:  # the grid's frequency walks about its mean
                knots = np.arange(t[0], t[-1] + 0.5, 0.25)
                walk = wander_hz * np.cumsum(rng.standard_normal(knots.size)) * np.sqrt(0.25)
                turn = turn + 2 * np.pi * np.interp(t, knots, np.cumsum(walk - walk.mean()) * 0.25)
            wave = np.sin(turn) + third * np.sin(3 * turn + phase[1]) + fifth * np.sin(5 * turn + phase[2])
            return np.asarray(p["amplitude_N"] * (1.0 + beat * np.sin(2 * np.pi * 0.7 * t + phase[1])) * wave)

        return Acting(chain=Chain(additions=(add,)))

    return acts


MAINS = FaultKind(
    "mains_interference", "amplitude_N", linear(lambda s: 0.6 * s.friction_rms_N), (
        Law("sine", _mains(0.0, 0.0)),
        Law("harmonics", _mains(0.35, 0.15)),
        Law("wandering", _mains(0.1, 0.0, wander_hz=0.08)),
        Law("beating", _mains(0.1, 0.05, beat=0.5)),
    ),
    lambda g, s: {"frequency_hz": float(g.choice([50.0, 60.0]))},
)  # fmt: skip


# ---- one limit in newtons for the whole campaign


def _clipped(shape: Callable[[Array, Parameters], Array]) -> Acts:
    return lambda p: Acting(chain=Chain(saturation=lambda f: p["limit_N"] * shape(f / p["limit_N"], p)))


def _soft_knee(x: Array, p: Parameters) -> Array:
    n = p["sharpness"]
    return np.asarray(x / (1.0 + np.abs(x) ** n) ** (1.0 / n))


def _compressed(x: Array, p: Parameters) -> Array:
    """An amplifier that runs out of range gradually: beyond the limit the reading grows with the logarithm."""
    over = np.maximum(np.abs(x), 1.0)
    return np.asarray(np.where(np.abs(x) < 1.0, x, np.sign(x) * (1.0 + 0.3 * np.log(over))))


def _unequal(p: Parameters) -> Acting:
    """The lower limit cuts less off the peak than the upper one does."""
    lower = p["peak_N"] - p["lower_share"] * (p["peak_N"] - p["limit_N"])
    return Acting(chain=Chain(saturation=lambda f: np.clip(f, -lower, p["limit_N"])))


CLIPPING = FaultKind(
    "force_clipping", "limit_N", lambda s, strength: s.force_peak_N * (1.0 - 0.7 * strength), (
        Law("hard", _clipped(lambda x, p: np.clip(x, -1.0, 1.0))),
        Law("soft", _clipped(_soft_knee), uniform(sharpness=(4.0, 12.0)),
            strongest=lambda s, strength: s.force_peak_N * 0.3 / strength),
        Law("compressed", _clipped(_compressed)),
        Law("one_side", _clipped(lambda x, p: np.minimum(x, 1.0))),
        Law("unequal", _unequal, lambda g, s: {"lower_share": float(g.uniform(0.3, 0.8)), "peak_N": s.force_peak_N}),
    ),
)  # fmt: skip

KINDS = (COMPLIANCE, PLAY, MASS, DELAY, INTEGRATION, HIGH_PASS, LOW_PASS, DRIFT, MAINS, CLIPPING)
