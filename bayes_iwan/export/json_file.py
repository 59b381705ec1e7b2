"""The json target: the model as numbers with units, draws and covariance, and its reader.

Schema 1 of `isolator.json`: `schema` ("bayes_iwan.export 1"), `card` (as model_card.json), `scales` and `model` (what
rebuilds the simulator), `effects` (class, name and what made it), `parameters` (name, unit, description, point, draws),
`covariance` of the draws of the free parameters (`names` gives the order), in the units of each parameter.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bayes_iwan import former_names
from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import as_stored, of_stored
from bayes_iwan.export.card import Card
from bayes_iwan.export.device import ExportError, without_zero
from bayes_iwan.export.laws import OF_THE_RIG
from bayes_iwan.files import finite, reading
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model, Motion, Scales
from bayes_iwan.models.simulator import recorded_force
from bayes_iwan.screen import on_screen

NAME: str = "isolator.json"
SCHEMA = "bayes_iwan.export 1"


@dataclass(frozen=True, kw_only=True)
@on_screen
class ExportedModel:
    """What :func:`bayes_iwan.load` makes of an exported isolator.json.

    Attributes
    ----------
    card
        as model_card.json.
    model, effects
        the simulator and the device's effects.
    values
        (sets,) of each sampled parameter by name; set 0 is the point estimate, the others draws.
    names, covariance
        free parameters and their covariance (n, n) over the draws.
    """

    card: Mapping[str, object]
    model: Model
    effects: tuple[Effect, ...]
    values: ParameterValues
    names: tuple[str, ...]
    covariance: Array

    def force(self, motion: Motion) -> Array:
        """Force of the device in N, (sets, loops, samples), for steady loops, or for a record from rest where no effect
        is a filter, a lag or in series with the specimen (else EffectError: the exported C code has these)."""
        values = without_zero(self.values)
        return recorded_force(self.model, self.effects, {**values, **self.model.parameter_values(values)}, motion)


def files(problem: Problem, z: Array, card: Card) -> dict[str, str]:
    """isolator.json of a problem at coordinates z (sets, ndim), the point first."""
    model = problem.model
    values = problem.prior.values(z)
    kept = [e for e in problem.effects if not isinstance(e, OF_THE_RIG)]
    mine = {p.name for e in kept for p in e.parameters} | {p.name for p in problem.prior.parameters if not p.owner}
    inferred = [p for p in problem.prior.parameters if p.name in mine - problem.noise_names]
    free = [n for n in problem.names if n in {p.name for p in inferred}]
    draws = np.stack([values[n][1:] for n in free])
    out = {
        "schema": SCHEMA,
        "card": card.to_dict(),
        "scales": asdict(problem.scales),
        "model": {n: getattr(model, n) for n in ("slip", "normal_force", "stiffness", "embedded")}
        if isinstance(model, Model)
        else {"simulator": model.name},
        "effects": [as_stored(e) for e in kept],
        "parameters": [
            {n: getattr(p, n) for n in ("name", "unit", "description")}
            | {"point": float(values[p.name][0]), "draws": values[p.name][1:].tolist()}
            for p in inferred
        ],
        "names": free,
        "covariance": np.cov(draws).reshape(len(free), len(free)).tolist() if draws.shape[1] > 1 else None,
    }
    return {NAME: json.dumps(finite(out), indent=1) + "\n"}


def read(path: Path) -> ExportedModel:
    """An exported isolator.json. Raises ExportError in one line where it is missing, damaged or not of this version."""
    with reading(path, ExportError, "export the model again"):
        stored = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(stored, dict) or stored.get("schema") != SCHEMA:
            raise ExportError(f"{path}: not a model of this version ({SCHEMA}); export it again")
        parts = former_names.config_of(stored)["model"]
        if "simulator" in parts:
            raise ExportError(f"{path}: holds draws of {parts['simulator']}, a simulator of your own; read its numbers")
        scales = Scales(**stored["scales"])
        laws = (parts["slip"], parts["normal_force"], parts["stiffness"])
        model, now = Model(scales.reference, *laws, embedded=parts["embedded"]), former_names.parameters_in
        values = {now(str(p["name"])): np.array([p["point"], *p["draws"]], float) for p in stored["parameters"]}
        covariance = np.zeros((0, 0)) if stored["covariance"] is None else np.array(stored["covariance"], float)
        if len({len(x) for x in values.values()}) != 1 or not all(np.isfinite(x).all() for x in values.values()):
            raise ValueError("parameters of different lengths, or not finite")
        effects = of_stored(tuple(map(former_names.effect_of, stored["effects"])), (), model, scales, ())
        names = tuple(now(str(n)) for n in stored["names"])
        return ExportedModel(
            card=stored["card"], model=model, effects=effects, values=values, names=names, covariance=covariance
        )
