"""Fits that outlive the process: `fits.json` beside a diagnosis, enough to predict other tests of the same specimen."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import read_campaign
from bayes_iwan.effects import conditions
from bayes_iwan.effects.base import Effect, EffectError
from bayes_iwan.effects.catalogue import UNLISTED, ordered, variants
from bayes_iwan.effects.conditions import FollowsCondition
from bayes_iwan.effects.user_file import load_effects
from bayes_iwan.gap.budget import shapley
from bayes_iwan.gap.data import GapData, gap_data
from bayes_iwan.gap.evidence import Fit, Linear, Rest, base_problem, extended
from bayes_iwan.gap.gap_size import gap_power_N2
from bayes_iwan.gap.residuals import residual_of
from bayes_iwan.inference.scales import Scales
from bayes_iwan.inference.user_file import load_simulator
from bayes_iwan.physics import Model

SCHEMA = 2
#: phases, harmonics and blocks of cycles that diagnoses work on
LOOPS = {"n_phase": 64, "n_harmonics": 20, "n_blocks": 4}


class SavedFitsError(ValueError):
    """`fits.json` that cannot be read or used; the message names the file and what is wrong."""


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
        "along": fit.along,
    }


def stored_fits(
    fits: Mapping[frozenset[str], Fit],
    scales: Scales,
    config: dict,
    effects_file: str | None,
    simulator_file: str | None,
) -> dict[str, Any]:
    """What `fits.json` holds: the fit of every set of named effects, the base under "base"."""
    return {
        "schema": SCHEMA,
        "scales": asdict(scales),
        "config": config,
        "effects_file": effects_file,
        "simulator_file": simulator_file,
        "fits": {"+".join(sorted(names)) or "base": fit_as_dict(f) for names, f in fits.items()},
    }


def read_fits(path: Path) -> dict[str, Any]:
    """What `fits.json` holds. Raises SavedFitsError in one line where it is missing, damaged or of another version."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SavedFitsError(f"{path}: cannot be read ({error.strerror}); diagnose the campaign again") from None
    except (ValueError, RecursionError):
        raise SavedFitsError(f"{path}: damaged, no JSON; diagnose the campaign again") from None
    if not isinstance(stored, dict) or stored.get("schema") != SCHEMA:
        raise SavedFitsError(f"{path}: not fits of this version (schema {SCHEMA}); diagnose the campaign again")
    return stored


def find_shares(
    diagnosis: Path, unseen_campaign: Path, *, allow_own_files: bool = False
) -> tuple[float | None, dict[str, float]]:
    """What the named causes of a diagnosis remove of the gap on tests of another campaign folder of the specimen.

    Returns the shrink by all of them together (None where none is named or there is no gap) and each one's share of
    the gap (Shapley value). allow_own_files : run the Python files of own effects or simulators that `fits.json` names.
    Raises SavedFitsError, EffectError.
    """
    path = Path(diagnosis) / "fits.json"
    stored = read_fits(path)
    own = stored["effects_file"] or stored["simulator_file"]
    if own and not allow_own_files:
        raise SavedFitsError(f"{path}: names a Python file, which is not run unasked: {own}")
    data = gap_data(read_campaign(unseen_campaign).loops(**LOOPS))
    try:
        sets = {frozenset() if k == "base" else frozenset(k.split("+")): _rebuilt(stored, f, data)
                for k, f in stored["fits"].items()}  # fmt: skip
        gap = {k: _gap_N(data, f) for k, f in sets.items()}
        whole, before = max(sets, key=len), gap[frozenset()]
        if before <= 0.0 or not whole:
            return None, {}
        parts = shapley(whole, lambda k: np.array(-gap[k] / before))
    except (KeyError, TypeError, IndexError, AttributeError, np.linalg.LinAlgError) as error:
        raise SavedFitsError(
            f"{path}: damaged ({type(error).__name__}: {error}); diagnose the campaign again"
        ) from None
    return 1.0 - gap[whole] / before, {n: float(v) for n, v in parts.items()}


def _gap_N(data: GapData, fit: Fit) -> float:
    return float(np.sqrt(max(float(gap_power_N2(residual_of(data, fit, refitted=False)).mean()), 0.0)))


def _rebuilt(stored: dict[str, Any], one: dict[str, Any], data: GapData) -> Fit:
    extra = load_effects(stored["effects_file"]) if stored["effects_file"] else ()
    scales, file = Scales(**stored["scales"]), stored["simulator_file"]
    simulator = load_simulator(file) if file else Model(scales.reference, **stored["config"].get("model", {}))
    kinds = [k for some in variants(extra, simulator, form=True).values() for k in some]
    classes = {k.__name__: k for k in (*kinds, *UNLISTED, *conditions.EFFECTS) if isinstance(k, type)}
    files = tuple(x.file for x in data.loops)
    effects: list[Effect] = []
    for spec in one["effects"]:
        if spec["class"] not in classes:
            raise EffectError(f"fits.json names the effect {spec['name']!r}, which is not in the catalogue")
        more = {"condition": spec["condition"], "values": tuple(spec["values"])} if "condition" in spec else {}
        effects.append(classes[spec["class"]](scales, files, spec["strength_value"], **more))
    problem = extended(base_problem(data, stored["config"], scales, simulator), ordered(effects))
    keep = [n for n in problem.names if n in one["names"]]
    if len(keep) != len(problem.names):  # parameters of single tests (a mains line's phases) predict nothing elsewhere
        problem = extended(problem, [e for e in effects if all(p.name in keep for p in e.parameters)])
    at = [one["names"].index(n) for n in problem.names]
    z: Array = np.array(one["z"])[at]
    covariance = np.array(one["covariance"])[np.ix_(at, at)]
    none = Rest(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool))
    linear = Linear(np.zeros(0), np.zeros((0, len(z))), none, z)
    size = float(one["share"]), float(one["length"]), float(one["along"])
    return Fit(problem, z, np.zeros((1, 1)), *size, covariance, z[None], linear, True)
