"""All faults of the virtual rig by name: the catalogue's, each by several laws, and some from outside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_iwan.rig import fault_chain, fault_friction, fault_outside, fault_specimen
from bayes_iwan.rig.fault import Acting, Fault, FaultKind, Surroundings
from bayes_iwan.rig.specimen import RigError

KINDS: dict[str, FaultKind] = {
    k.name: k for k in (*fault_specimen.KINDS, *fault_friction.KINDS, *fault_chain.KINDS, *fault_outside.KINDS)
}
CATALOGUE: tuple[str, ...] = tuple(k.name for k in KINDS.values() if k.listed)
OUTSIDE: tuple[str, ...] = tuple(k.name for k in KINDS.values() if not k.listed)
MAIN_PARAMETER: dict[str, str] = {k.name: k.main for k in KINDS.values()}
#: which laws are drawn: the one that the catalogue has too, any but that one, or all alike
LAWS = ("catalogue", "other", "all")

#: functions that a law may give: those of several faults act in a row (True: multiplied) or beside one another (added)
_FUNCTIONS = {
    "displacement_force": False,
    "speed_force": False,
    "joint_stretch": False,
    "rate_factor": True,
    "fade_factor": True,
}
_LISTS = ("force_filters", "displacement_filters", "additions")


def check_faults(faults: Sequence[Fault]) -> None:
    """Raise `RigError` for an unknown name or law, or for a fault without its main number."""
    for fault in faults:
        if fault.name not in KINDS:
            raise RigError(f"no fault {fault.name!r}; the rig has: {', '.join(KINDS)}")
        kind = KINDS[fault.name]
        laws = [law.name for law in kind.laws]
        if fault.law and fault.law not in laws:
            raise RigError(f"fault {fault.name!r} has no law {fault.law!r}; there are: {', '.join(laws)}")
        if kind.main not in fault.parameters:
            raise RigError(f"fault {fault.name!r} needs the number {kind.main!r}")


def laws_of(name: str, laws: str = "catalogue", leave_out: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the laws of a fault to draw from; `leave_out` holds entries like "end_stop:hertz".

    A fault from outside the catalogue has one law, whatever is asked for. Raises `RigError` if none is left.
    """
    if laws not in LAWS:
        raise RigError(f"no choice of laws {laws!r}; there are: {', '.join(LAWS)}")
    names = [law.name for law in KINDS[name].laws]
    if KINDS[name].listed and laws != "all":
        names = names[:1] if laws == "catalogue" else names[1:]
    left = tuple(n for n in names if f"{name}:{n}" not in leave_out)
    if not left:
        raise RigError(f"every law of {name} among the {laws} ones is left out; leave one in, or the fault out")
    return left


def drawn(name: str, law: str, surroundings: Surroundings, rng: np.random.Generator) -> dict[str, float]:
    """All numbers of a fault but its main one; `_sign` is that one's sign where it may be negative."""
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
    """What these faults do together: the kernel's numbers and functions, and the chain's settings."""
    out: Acting = {}
    for fault in faults:
        for key, value in KINDS[fault.name].law(fault.law).acts(fault.parameters).items():
            if key in out and key in _FUNCTIONS:
                out[key] = _combined(out[key], value, _FUNCTIONS[key])
            elif key in out and key in _LISTS:
                out[key] = (*out[key], *value)
            elif key in out and key not in ("end_mass_kg", "end_damping"):
                raise RigError(f"{' and '.join(f.name for f in faults)} cannot act together: both set {key}")
            else:
                out[key] = value
    return out


def _combined(first, second, product: bool):
    if product:
        return lambda x: first(x) * second(x)
    return lambda x: first(x) + second(x)


def scatter(seed: int, sd: float, test_index: int) -> float:
    """A factor about 1 that belongs to one test."""
    return float(np.exp(sd * np.random.default_rng([seed, test_index]).standard_normal()))
