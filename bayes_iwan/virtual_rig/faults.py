"""All faults of the virtual rig by name: the catalogue's, each by several laws, and some from outside it."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from bayes_iwan.errors import nearest
from bayes_iwan.virtual_rig import fault_chain, fault_friction, fault_outside, fault_specimen
from bayes_iwan.virtual_rig.fault import NO_FAULT, Acting, Fault, FaultKind, Function, Scatter, Surroundings
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.sensors import Chain
from bayes_iwan.virtual_rig.specimen import RigError

T = TypeVar("T")

KINDS: dict[str, FaultKind] = {
    k.name: k for k in (*fault_specimen.KINDS, *fault_friction.KINDS, *fault_chain.KINDS, *fault_outside.KINDS)
}
CATALOGUE: tuple[str, ...] = tuple(k.name for k in KINDS.values() if k.listed)
OUTSIDE: tuple[str, ...] = tuple(k.name for k in KINDS.values() if not k.listed)
#: what faults from outside the catalogue have in common, by their names
FAMILY: dict[str, str] = {k.name: k.family for k in KINDS.values() if not k.listed}
#: which laws are drawn: the one that the catalogue has too, any but that one, or all alike
LAWS = ("catalogue", "other", "all")


def check_faults(faults: Sequence[Fault]) -> None:
    """Raise `RigError` for an unknown name or law, or for a fault without its main parameter."""
    for fault in faults:
        if fault.name not in KINDS:
            raise RigError(f"no fault {fault.name!r}{nearest(fault.name, KINDS)}")
        kind = KINDS[fault.name]
        laws = [law.name for law in kind.laws]
        if fault.law and fault.law not in laws:
            raise RigError(f"fault {fault.name!r} has no law {fault.law!r}{nearest(fault.law, laws)}")
        if kind.main not in fault.parameters:
            raise RigError(f"fault {fault.name!r} needs the parameter {kind.main!r}")


def laws_of(name: str, laws: str = "catalogue", excluded: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the laws of a fault to draw from; `excluded` holds entries like "end_stop:hertz".

    A fault from outside the catalogue has one law, whatever is asked for. Raises `RigError` if none is left.
    """
    if laws not in LAWS:
        raise RigError(f"no choice of laws {laws!r}{nearest(laws, LAWS)}")
    names = [law.name for law in KINDS[name].laws]
    if KINDS[name].listed and laws != "all":
        names = names[:1] if laws == "catalogue" else names[1:]
    left = tuple(n for n in names if f"{name}:{n}" not in excluded)
    if not left:
        raise RigError(f"every law of {name} among the {laws} ones is excluded; keep one, or remove the fault")
    return left


def drawn(name: str, law: str, surroundings: Surroundings, rng: np.random.Generator) -> dict[str, float]:
    """All parameters of a fault but its main one; `_sign` is that one's sign where it may be negative."""
    kind = KINDS[name]
    parameter_values = {**kind.draw(rng, surroundings), **kind.law(law).draw(rng, surroundings)}
    return parameter_values | ({"_sign": float(rng.choice([-1.0, 1.0]))} if kind.signed else {})


def complete(name: str, law: str, others: dict[str, float], surroundings: Surroundings, strength: float) -> Fault:
    """The fault at a strength in (0, 1] in these surroundings."""
    kind = KINDS[name]
    main = others.get("_sign", 1.0) * (kind.law(law).strongest or kind.strongest)(surroundings, strength)
    parameter_values = {kind.main: float(main), **{k: float(v) for k, v in others.items() if not k.startswith("_")}}
    return Fault(name, parameter_values, law or kind.laws[0].name)


def acting(faults: Sequence[Fault]) -> Acting:
    """What these faults do together. Raises `RigError` where two set the same value of kernel or chain."""
    out, who = Acting(), " and ".join(f.name for f in faults)
    for fault in faults:
        out = _beside(out, KINDS[fault.name].law(fault.law).acts(fault.parameters), who)
    return out


_ONE_OF = ("stiffness_scatter", "friction_scatter", "gain_scatter")
_COMBINED: dict[str, np.ufunc] = {
    **dict.fromkeys(("displacement_force", "speed_force", "joint_stretch"), np.add),
    **dict.fromkeys(("rate_factor", "fade_factor", "position_factor", "amplitude_gain"), np.multiply),
}


def _beside(a: Acting, b: Acting, who: str) -> Acting:
    """Both: filters and additions one after the other, forces and stretches added, factors multiplied."""

    def one(key: str, first: T, second: T, off: T) -> T:
        if _is_off(second, off):
            return first
        if not _is_off(first, off) and key not in ("end_mass_kg", "end_damping"):
            raise RigError(f"{who} cannot act together: both set {key}")
        return second

    in_a_row = ("force_filters", "displacement_filters", "additions")
    motion = (one(*values) for values in zip(FaultValues._fields, a.motion, b.motion, NO_FAULT))
    single = {f.name: f.default for f in fields(Chain) if f.name not in in_a_row}
    settings = {n: one(n, getattr(a.chain, n), getattr(b.chain, n), off) for n, off in single.items()}
    more: dict[str, Any] = {k: one(k, getattr(a, k), getattr(b, k), None) for k in _ONE_OF}
    more |= {k: _combined(getattr(a, k), getattr(b, k), by) for k, by in _COMBINED.items()}
    return Acting(
        motion=a.motion if b.motion is NO_FAULT else FaultValues._make(motion),
        chain=replace(a.chain, **settings, **{k: getattr(a.chain, k) + getattr(b.chain, k) for k in in_a_row}),
        extra_compliance_mm_N=one("compliance_mm_N", a.extra_compliance_mm_N, b.extra_compliance_mm_N, 0.0),
        **more,
    )


def _is_off(value: object, off: object) -> bool:
    return value is off or (not isinstance(value, np.ndarray) and value == off)


def _combined(first: Function | None, second: Function | None, by: np.ufunc) -> Function | None:
    if first is None or second is None:
        return first or second
    return lambda x: by(first(x), second(x))


def scatter(how: Scatter, test_index: int) -> float:
    """A factor about 1 that belongs to one test."""
    sd, seed = how
    return float(np.exp(sd * np.random.default_rng([seed, test_index]).standard_normal()))
