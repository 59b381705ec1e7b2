"""Fits that outlive the process: `fits.json` beside a diagnosis, enough to predict other tests of the same specimen."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan import former_names
from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Campaign, Loop, read_campaign
from bayes_iwan.campaign.loops.resolution import POINTS, points_for
from bayes_iwan.diagnosis.assessment.budget import shares_of
from bayes_iwan.diagnosis.fits.data import GapData, gap_data
from bayes_iwan.diagnosis.fits.discrepancy_size import Discrepancy, DiscrepancySize, Linear
from bayes_iwan.diagnosis.fits.evidence import Fit, base_model, base_problem
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.effects.catalogue import as_stored, load_effects, of_stored, ordered
from bayes_iwan.errors import InputError
from bayes_iwan.files import reading, seen_from, write_json
from bayes_iwan.inference.setup.config import diagnose_settings_of
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models.user_file import load_simulator

SCHEMA = 5
AGAIN = "diagnose the campaign again"
#: phases, harmonics and blocks of cycles that diagnoses work on
LOOPS = {"n_phase": 64, "n_harmonics": 20, "n_blocks": 4}


def loops_of(campaign: Campaign) -> tuple[Loop, ...]:
    """The loops that diagnoses work on: half as many phases as identifications where they reverse more than twice a
    cycle or at sharp corners; corners that channels rounded need no more."""
    loops = campaign.loops(**LOOPS)
    points = points_for([x.displacement_mm for x in loops], [x.velocity_m_s for x in loops if x.sharp])
    return loops if points == POINTS else campaign.loops(**LOOPS | {"n_phase": points // 2})


class SavedFitsError(InputError):
    """`fits.json` that cannot be read or used; the message names the file and what is wrong."""


@dataclass(frozen=True)
class SavedFit:
    """One fit: its effects as :func:`~bayes_iwan.effects.catalogue.as_stored` says them, names and z (ndim,) of its
    parameters, their covariance, and the size of its discrepancy."""

    effects: tuple[Mapping[str, Any], ...]
    names: tuple[str, ...]
    z: Array
    covariance: Array
    size: DiscrepancySize


@dataclass(frozen=True)
class SavedFits:
    """What `fits.json` holds: the fit of every set of named effects, the base under the empty set."""

    scales: Scales
    settings: DiagnoseSettings
    effects_file: str | None
    simulator_file: str | None
    fits: Mapping[frozenset[str], SavedFit]


def _plain(fit: Fit) -> dict[str, object]:
    """A fit as JSON holds it."""
    return {
        "effects": [as_stored(e) for e in fit.effects],
        "names": list(fit.problem.names),
        "z": fit.z.tolist(),
        "covariance": fit.covariance.tolist(),
        **asdict(fit.size),
    }


def write_fits(
    path: Path,
    fits: Mapping[frozenset[str], Fit],
    scales: Scales,
    settings: DiagnoseSettings,
    effects_file: str | None,
    simulator_file: str | None,
) -> None:
    """Write `fits.json`."""
    effects, simulator = (file and seen_from(path.parent, file) for file in (effects_file, simulator_file))
    stored = {
        "schema": SCHEMA,
        "scales": asdict(scales),
        "config": settings.as_dict(),
        "effects_file": effects,
        "simulator_file": simulator,
        "fits": {"+".join(sorted(names)) or "base": _plain(f) for names, f in fits.items()},
    }
    write_json(path, stored)


def read_fits(path: Path) -> SavedFits:
    """What `fits.json` holds. Raises SavedFitsError in one line where it is missing, damaged or of another version."""
    with reading(path, SavedFitsError, AGAIN):
        stored = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(stored, dict) or stored.get("schema") != SCHEMA:
            raise SavedFitsError(f"{path}: not fits of this version (schema {SCHEMA}); {AGAIN}")
        files = (stored[k] for k in ("effects_file", "simulator_file"))
        effects, simulator = (None if file is None else str((path.parent / file).resolve()) for file in files)
        fits = {_set_of(k): _fit(f) for k, f in stored["fits"].items()}
        return SavedFits(
            Scales(**stored["scales"]),
            diagnose_settings_of(former_names.config_of(stored["config"])),
            effects,
            simulator,
            fits,
        )


def _set_of(key: str) -> frozenset[str]:
    return frozenset() if key == "base" else frozenset(former_names.EFFECTS.get(n, n) for n in key.split("+"))


def _fit(stored: dict[str, Any]) -> SavedFit:
    z, covariance = np.array(stored["z"], float), np.array(stored["covariance"], float)
    if len(z) != len(stored["names"]) or covariance.shape != (len(z), len(z)):
        raise ValueError("names, z and covariance do not agree")
    share, length, along = (float(stored[k]) for k in ("share", "length", "along"))
    loops, changes = (tuple(map(float, stored[k])) for k in ("spectrum", "along_spectrum"))
    frequency, amplitude, alone = map(float, stored["between"])
    size = DiscrepancySize(share, length, along, loops, changes, (frequency, amplitude, alone))
    effects = tuple(map(former_names.effect_of, stored["effects"]))
    return SavedFit(effects, tuple(former_names.parameters_in(str(n)) for n in stored["names"]), z, covariance, size)


def find_shares(diagnosis: Path, held_out_campaign: Path, *, allow_own_files: bool = False) -> dict[str, float]:
    """Share of the gap (Shapley value) that each named cause of a diagnosis removes on tests of another campaign folder
    of the specimen; empty where none is named or there is no gap.

    allow_own_files : run the Python files of own effects or simulators that `fits.json` names. Raises SavedFitsError,
    EffectError.
    """
    path = Path(diagnosis) / "fits.json"
    stored = read_fits(path)
    own = stored.effects_file or stored.simulator_file
    if own and not allow_own_files:
        raise SavedFitsError(f"{path}: names a Python file, which is not run unasked: {own}")
    data = gap_data(loops_of(read_campaign(held_out_campaign)))
    with reading(path, SavedFitsError, AGAIN):
        power_N2 = {
            k: gap_power_N2(residual_of(data, rebuilt(stored, f, data), refitted=False)).mean()
            for k, f in stored.fits.items()
        }
        gap = {k: float(np.sqrt(max(float(x), 0.0))) for k, x in power_N2.items()}
        whole = max(gap, key=len)
        return shares_of(whole, gap) if whole and gap[frozenset()] > 0.0 else {}


def rebuilt(stored: SavedFits, one: SavedFit, data: GapData) -> Fit:
    extra = load_effects(stored.effects_file) if stored.effects_file else ()
    scales, file = stored.scales, stored.simulator_file
    simulator = load_simulator(file) if file else base_model(stored.settings, scales)
    effects = of_stored(one.effects, extra, simulator, scales, tuple(x.file for x in data.loops))
    problem = base_problem(data, stored.settings, scales, simulator).with_effects(ordered(effects))
    keep = [n for n in problem.names if n in one.names]
    if len(keep) != len(
        problem.names
    ):  # parameters of single tests (of mains interference: its phases) predict nothing elsewhere
        problem = problem.with_effects([e for e in effects if all(p.name in keep for p in e.parameters)])
    at = [one.names.index(n) for n in problem.names]
    z, covariance = one.z[at], one.covariance[np.ix_(at, at)]
    none = Discrepancy(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool))
    linear = Linear(np.zeros(0), np.zeros((0, len(z))), none, z)
    return Fit(
        problem, z, np.zeros((1, 1)), one.size, (one.size.share,) * 3, covariance, z[None], linear, converged=True
    )
