"""Names of before, each with the one that it has now: files that were written with them stay readable.

Readers of stored files map what they read here, once. What a user writes by hand is not mapped: the message names the
new name (:func:`renamed`).
"""

import functools
import re
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar

from bayes_iwan.errors import InputError

Asked = ParamSpec("Asked")
Given = TypeVar("Given")

#: keys of [model] in a configuration
MODEL_PARTS = {"grip": "normal_force"}
#: parameters of the Iwan model
PARAMETERS = {
    "grip_slope": "normal_force_slope",
    "grip_rate": "normal_force_rate",
    "grip_corner": "normal_force_corner",
    "stiffness_bend": "stiffness_ratio",
    **{f"slip_tilt{k}": f"slip_deviation{k}" for k in range(1, 7)},
}
#: effects by the name that files give them
EFFECTS = {"mains_hum": "mains_interference"}
#: parameters of effects
_EFFECT_PARAMETERS = {
    "viscous_damping.bend_m_s": "viscous_damping.thinning_m_s",
    "cubic_stiffness.bend": "cubic_stiffness.knee",
    "stiffness_law_free.bend": "stiffness_law_free.growth",
    "force_highpass.stood_cycles": "force_highpass.held_cycles",
    "force_highpass.stood_share": "force_highpass.held_share",
}
#: classes of effects, which saved fits and exported models name
EFFECT_CLASSES = {
    "MainsHum": "MainsInterference",
    "MainsHum60": "MainsInterference60",
    "BentStiffness": "TrilinearStiffness",
    "DirectionDependentGrip": "DirectionDependentNormalForce",
}
#: what a user's own effect or simulator defines
EFFECT_MEMBERS = {"grip": "normal_force"}
SIMULATOR_MEMBERS = {"stations": "stages"}
#: options of the functions that `import bayes_iwan` offers
OPTIONS = {"executor": "workers"}
#: families of models that are compared
FAMILIES = {"constant_grip": "constant_normal_force"}
#: keys of a diagnosis of schema 2
DIAGNOSIS = {
    "rest": "unexplained",
    "unknown_rest": "unknown_cause",
    "looks_like": "resembles",
    "rivals": "alternatives",
    "cannot_tell_apart": "tied_with",
}
#: keys of a sealed truth, and the folder of its sealed tests
TRUTH = {"unseen_data": "sealed_data", "unseen": "sealed"}
#: keys of the figures of an effect, as studies store them
FIGURES = {"rivals": "alternatives", "unseen": "held_out"}

_PARAMETER = re.compile(rf"(?<![\w.])({'|'.join(map(re.escape, {**PARAMETERS, **_EFFECT_PARAMETERS}))})(?!\w)")
_EFFECT = re.compile(rf"(?<![\w.])({'|'.join(EFFECTS)})(?![a-z_])")


def renamed(name: str, names: Mapping[str, str]) -> str:
    """What a message says of a name of before and how to fix it; "" for any other."""
    return f'is called "{names[name]}" now; rename it' if name in names else ""


def refuse_former_options(function: Callable[Asked, Given]) -> Callable[Asked, Given]:
    """A function whose options of before are an InputError that names the new one."""

    @functools.wraps(function)
    def checked(*args: Asked.args, **options: Asked.kwargs) -> Given:
        for name in options:
            if name in OPTIONS:
                raise InputError(f"{function.__name__}: the option {name} {renamed(name, OPTIONS)}")
        return function(*args, **options)

    return checked


def parameters_in(text: str) -> str:
    """A text in which every parameter and effect has the name of now."""
    text = _PARAMETER.sub(lambda found: {**PARAMETERS, **_EFFECT_PARAMETERS}[found[1]], text)
    return _EFFECT.sub(lambda found: EFFECTS[found[1]], text)


def config_of(stored: Mapping[str, object]) -> dict[str, Any]:
    """A stored configuration (its tables) with the names of now."""
    out = dict(stored)
    if isinstance(model := out.get("model"), Mapping):
        out["model"] = {MODEL_PARTS.get(k, k): v for k, v in model.items()}
    if isinstance(changes := out.get("parameters"), Mapping):
        out["parameters"] = {parameters_in(k): _tied(change) for k, change in changes.items()}
    return out


def _tied(change: object) -> object:
    """A parameter's stored change; what it is tied to is a name, too."""
    if isinstance(change, Mapping) and isinstance(change.get("tied"), str):
        return {**change, "tied": parameters_in(change["tied"])}
    return change


def effect_of(stored: Mapping[str, Any]) -> dict[str, Any]:
    """A stored effect ({"class", "name", …}) with the names of now."""
    kind, name = stored["class"], stored["name"]
    return {**stored, "class": EFFECT_CLASSES.get(kind, kind), "name": EFFECTS.get(name, name)}


def diagnosis_of(stored: Any) -> Any:
    """A stored diagnosis (or any part of it) with the keys and effects of schema 3; one of schema 3 as it is."""
    if isinstance(stored, Mapping):
        return {DIAGNOSIS.get(k, EFFECTS.get(k, k)): diagnosis_of(v) for k, v in stored.items()}
    if isinstance(stored, list | tuple):
        return [diagnosis_of(x) for x in stored]
    return EFFECTS.get(stored, stored) if isinstance(stored, str) else stored
