"""Fits that outlive the process: `fits.json` beside a diagnosis, enough to predict other tests of the same specimen."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.campaign import read_campaign
from bayes_iwan.effects import conditions
from bayes_iwan.effects.base import Effect, EffectError
from bayes_iwan.effects.catalogue import ordered, variants
from bayes_iwan.effects.conditions import FollowsCondition
from bayes_iwan.effects.user_file import load_effects
from bayes_iwan.gap.data import gap_data
from bayes_iwan.gap.evidence import Fit, Linear, base_problem, extended
from bayes_iwan.gap.gap_size import gap_size
from bayes_iwan.gap.residuals import residual_of
from bayes_iwan.inference.scales import Scales
from bayes_iwan.inference.user_file import load_simulator
from bayes_iwan.physics import Model


def fit_as_dict(fit: Fit) -> dict[str, Any]:
    """A fit as plain numbers."""
    return {
        "effects": [
            {"class": type(e).__name__, "name": e.name, "strength_value": e.strength_value}
            | ({"condition": e.condition, "values": list(e.values)} if isinstance(e, FollowsCondition) else {})
            for e in fit.effects
        ],
        "names": list(fit.problem.names),
        "z": fit.z.tolist(),
        "covariance": fit.covariance.tolist(),
        "share": fit.share,
        "length": fit.length,
    }


def stored_fits(
    base: Fit,
    fits: dict[str, Fit],
    scales: Scales,
    config: dict,
    effects_file: str | None,
    simulator_file: str | None = None,
) -> dict[str, Any]:
    """What `fits.json` holds."""
    return {
        "schema": 1,
        "scales": asdict(scales),
        "config": config,
        "effects_file": effects_file,
        "simulator_file": simulator_file,
        "base": fit_as_dict(base),
        "with": {name: fit_as_dict(f) for name, f in fits.items()},
    }


def read_fits(path: Path) -> dict[str, Any]:
    """What `stored_fits` gave, read back. Raises EffectError where the file is not that, or damaged."""
    try:
        stored = json.loads(path.read_text())
        if stored["schema"] != 1:
            raise EffectError(f"{path}: not of this version; diagnose again")
        Scales(**stored["scales"])
        for fit in (stored["base"], *stored["with"].values()):
            n = len(fit["names"])
            if np.shape(np.array(fit["z"], float)) != (n,) or np.shape(np.array(fit["covariance"], float)) != (n, n):
                raise TypeError("numbers that are not as many as their names")
            for spec in fit["effects"]:
                str(spec["class"]), str(spec["name"]), spec["strength_value"]
    except EffectError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise EffectError(f"{path}: damaged ({type(error).__name__}: {' '.join(str(error).split())[:120]})") from None
    return stored


def find_shrink(diagnosis: Path, unseen_campaign: Path, cause: str) -> float | None:
    """Shrink of the gap on tests of another campaign folder when a diagnosis' cause (with its second, if it named one)
    is added; None if the diagnosis holds no fit of that cause."""
    stored = read_fits(Path(diagnosis) / "fits.json")
    if cause not in stored["with"]:
        return None
    data = gap_data(read_campaign(unseen_campaign).loops(**LOOPS))
    before = gap_size(residual_of(data, _rebuilt(stored, stored["base"], data)))
    after = gap_size(residual_of(data, _rebuilt(stored, stored["with"][cause], data)), friction_N=before.friction_N)
    if before.all.rms_N <= 0.0:
        return None
    return 1.0 - after.all.rms_N / before.all.rms_N


#: grid and harmonics that diagnoses work on
LOOPS = {"n_phase": 80, "n_harmonics": 24}


def _rebuilt(stored: dict[str, Any], one: dict[str, Any], data) -> Fit:
    extra = load_effects(stored["effects_file"]) if stored["effects_file"] else ()
    scales = Scales(**stored["scales"])
    file = stored.get("simulator_file")
    simulator = load_simulator(file) if file else Model(scales.reference, **stored["config"].get("model", {}))
    makers = (k for kinds in variants(extra, simulator, form=True).values() for k in kinds)
    classes = {k.__name__: k for k in (*makers, *conditions.EFFECTS) if isinstance(k, type)}
    # copies: these loops are not those that the model was fitted to
    elsewhere = replace(data, loops=tuple(replace(x) for x in data.loops))
    files = tuple(x.file for x in elsewhere.loops)
    effects: list[Effect] = []
    for spec in one["effects"]:
        if spec["class"] not in classes:
            raise EffectError(f"fits.json names the effect {spec['name']!r}, which is not in the catalogue")
        more = {"condition": spec["condition"], "values": tuple(spec["values"])} if "condition" in spec else {}
        effects.append(classes[spec["class"]](scales, files, spec["strength_value"], **more))
    problem = extended(base_problem(elsewhere, stored["config"], scales, simulator), ordered(effects))
    at = [one["names"].index(n) for n in problem.names if n in one["names"]]
    keep = [n for n in problem.names if n in one["names"]]
    if len(keep) != len(problem.names):  # numbers of single tests (a hum's phases) predict nothing elsewhere
        problem = extended(problem, [e for e in effects if all(p.name in keep for p in e.parameters)])
    z = np.array(one["z"])[at]
    covariance = np.array(one["covariance"])[np.ix_(at, at)]
    nothing = Linear(np.zeros(0), np.zeros((0, len(z))), np.zeros(0), np.zeros(0, dtype=np.int64), z)
    return Fit(problem, z, np.zeros((1, 1)), one["share"], one["length"], covariance, z[None], nothing, True)
