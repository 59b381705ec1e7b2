"""`bayes-iwan export`: a finished run, or a result in memory, as files for a target."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayes_iwan.campaign import Campaign, read_campaign
from bayes_iwan.errors import nearest
from bayes_iwan.export import c_code, fmu, json_file, opensees
from bayes_iwan.export.card import Card, card_of
from bayes_iwan.export.device import Device, ExportError, Source, device_of
from bayes_iwan.files import finite, reading, refuse_campaign, swapped, write_whole
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.run_files import load
from bayes_iwan.models import Model

if TYPE_CHECKING:
    from bayes_iwan.diagnosis.answer.result import Diagnosis
    from bayes_iwan.diagnosis.fits.evidence import Fit

TARGETS = ("c", "fmu", "opensees", "mujoco", "drake", "json")
MUJOCO, PLUGIN, DRAKE = "isolator_mujoco.py", "isolator_plugin.c", "isolator_drake.py"
CARD_TEXT, CARD_JSON = "model_card.txt", "model_card.json"
PathLike = str | os.PathLike[str]


def export(
    result: Posterior | Diagnosis | PathLike,
    to: str,
    out: PathLike,
    *,
    draws: int = 20,
    approximate: bool = False,
    campaign: PathLike | None = None,
    simulator: PathLike | None = None,
    error: float | None = None,
) -> Path:
    """The identified device as files that run elsewhere, with a model card.

    Parameters
    ----------
    result
        a posterior, a diagnosis, or the folder of either.
    to
        "c", "fmu", "opensees", "mujoco", "drake" or "json".
    out
        folder for the files; an older export there is replaced.
    draws
        of the posterior, beside the point estimate.
    approximate
        drop what a target cannot hold (opensees), instead of refusing.
    campaign
        the campaign's folder, where `result` is the folder of a diagnosis, or has moved.
    simulator
        the Python file of a run with a simulator of your own (json).
    error
        largest difference of a finite set of stop elements (opensees), as a share of the mean slip force; 5e-5.

    Returns
    -------
    Path
        the folder.

    Raises
    ------
    ExportError, ResultsError, SavedFitsError, OutputError
        InputErrors of one line; nothing is written then.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder, out = tempfile.mkdtemp(), tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> posterior = bi.identify(folder, quick=True, seed=1, config={"model": {"slip": "gamma1", "embedded": False}})
    >>> sorted(path.name for path in posterior.export("json", out, draws=5).iterdir())
    ['isolator.json', 'model_card.json', 'model_card.txt']
    """
    if to not in TARGETS:
        raise ExportError(f"{to!r} is no target{nearest(to, TARGETS)}")
    if draws < 0:
        raise ExportError(f"draws must be 0 or more, not {draws}")
    if to != "opensees" and (approximate or error is not None):
        raise ExportError(f"approximate and error are for opensees alone, not for {to}; leave them out")
    refuse_campaign(out)
    source = source_of(result, draws, campaign, simulator)
    made, card = files_of(source, to, approximate, opensees.ERROR if error is None else error)
    made = made | {CARD_TEXT: card.text() + "\n", CARD_JSON: json.dumps(finite(card.to_dict()), indent=1) + "\n"}
    with swapped(out, lambda name: name in OWN or fnmatch(name, "isolator_*.so")) as folder:
        for name, content in made.items():
            write_whole(folder / name, content)
    return Path(out)


#: what any target writes
OWN = {c_code.NAME, "isolator.py", *fmu.NAMES, MUJOCO, PLUGIN, DRAKE, *opensees.NAMES}
OWN |= {json_file.NAME, CARD_TEXT, CARD_JSON}


def files_of(source: Source, to: str, approximate: bool, error: float) -> tuple[dict[str, str | bytes], Card]:
    """Files of a target by name, and the card."""
    problem = source.problem
    hz = problem.motion.frequency_hz
    if to == "json" and not isinstance(problem.model, Model):
        # a simulator of the user's own has no stages here
        device = Device(tables=np.zeros((len(source.z), 1, 4)), top_N=np.full(len(source.z), np.nan))
    else:
        device = device_of(problem, source.z, (float(hz.min()), float(hz.max())))
    card = card_of(device, source)
    if to == "json":  # numbers, which nothing steps
        card = replace(card, discretisation="", step="")
        return {**json_file.files(problem, source.z, card)}, card
    if to == "opensees":
        card = replace(card, discretisation=opensees.DISCRETISATION, step=opensees.STEP)
        springs, notes = opensees.files(device, problem, source.z, card, approximate=approximate, error=error)
        return {**springs}, replace(card, target=notes)
    more, notes = fmu.files(device, card) if to == "fmu" else _around_the_step(device, to)
    card = replace(card, target=notes)
    files = {c_code.NAME: c_code.c_source(device, card.text())} | more
    if to != "fmu":
        files["isolator.py"] = c_code.filled(c_code.template("isolator.py"), {"SETS": str(device.sets)})
    return files, card


def _around_the_step(device: Device, to: str) -> tuple[dict[str, str | bytes], tuple[str, ...]]:
    """What a target has beside isolator.c and isolator.py, and what the card says of it."""
    if to == "mujoco":  # a passive force by Python's callback, and the source of a plugin in C
        # two devices in one scene are two plugins
        name = f"bayes_iwan.{hashlib.sha256(c_code.c_source(device, '').encode()).hexdigest()[:8]}"
        plugin = c_code.filled(c_code.template(PLUGIN), {"NAME": name})
        return {MUJOCO: c_code.template(MUJOCO), PLUGIN: plugin}, (
            "isolator_mujoco.py: a force on a joint (mujoco 3 or later) or tendon (4 or later); isolator_plugin.c: the "
            f"same as a plugin, {name}, for joints, its memory in mjData; the stretch is measured from qpos0",
        )
    if to == "drake":  # a LeafSystem with discrete state
        return {DRAKE: c_code.template(DRAKE)}, (
            "isolator_drake.py: IsolatorSystem, input motion (stretch, velocity, acceleration), output force; its "
            "memory is discrete state, updated every step_s",
        )
    return {}, ()


def source_of(
    result: Posterior | Diagnosis | PathLike, draws: int, campaign: PathLike | None, simulator: PathLike | None
) -> Source:
    """Problem, point and draws of a result or of a run's folder. Raises ExportError for a run that did not converge."""
    if isinstance(result, Posterior):
        return _of_posterior(result, draws)
    if not isinstance(result, str | os.PathLike):
        after = result.budget.after
        return _of_fit(result.fit, result.campaign, draws, result.seed, (after.rms_N, after.share))
    folder = Path(result)
    if (folder / "posterior.nc").is_file():
        return _of_posterior(load(folder, campaign, simulator), draws)
    if (folder / "fits.json").is_file():
        return _of_saved_diagnosis(folder, draws, campaign)
    raise ExportError(
        f"{folder}: no finished run there (posterior.nc or fits.json); name what identify or diagnose wrote"
    )


def _of_posterior(posterior: Posterior, draws: int) -> Source:
    if not posterior.converged and not posterior.quick:
        raise ExportError(
            f"the run has not converged ({posterior.message}); sample on with identify --resume, then export"
        )
    held = len(posterior.flat_z())
    if draws > held:
        raise ExportError(f"the posterior holds {held} draws, so draws can be {held} at most, not {draws}")
    kept = posterior.flat_z(draws) if draws else posterior.z[:0].reshape(0, posterior.ndim)
    residual = posterior.residual_size()
    return Source(
        problem=posterior.problem,
        z=np.concatenate([posterior.point.z[None], kept]),
        campaign=posterior.campaign,
        method="first draws of a short run" if posterior.quick else "sampled posterior",
        seed=posterior.seed,
        unexplained=(residual.gap_N, residual.gap_share),
    )


def _of_saved_diagnosis(folder: Path, draws: int, campaign: PathLike | None) -> Source:
    if campaign is None:
        raise ExportError(f"{folder}: is a diagnosis; name its campaign as well (--campaign DIR)")
    from bayes_iwan.diagnosis.answer.saved_fits import loops_of, read_fits, rebuilt
    from bayes_iwan.diagnosis.fits.data import gap_data

    stored = read_fits(folder / "fits.json")
    if stored.effects_file or stored.simulator_file:
        raise ExportError(f"{folder}: was made with a Python file of your own, which has no law in C to export")
    answer = folder / "diagnosis.json"
    with reading(answer, ExportError, "diagnose again"):
        said = json.loads(answer.read_text(encoding="utf-8"))
        seed, unexplained = int(said["seed"]), (float(said["gap"]["after_rms_N"]), float(said["gap"]["after_share"]))
    read = read_campaign(campaign)
    data = gap_data([x for x in loops_of(read) if x.role != "held-out"])
    with reading(folder / "fits.json", ExportError, "diagnose again"):
        fit = rebuilt(stored, stored.fits[max(stored.fits, key=len)], data)
    return _of_fit(fit, read, draws, seed, unexplained)


def _of_fit(fit: Fit, campaign: Campaign | None, draws: int, seed: int, unexplained: tuple[float, float]) -> Source:
    rng = np.random.default_rng([seed, 3])
    away = rng.standard_normal((draws, len(fit.z))) @ np.linalg.cholesky(fit.covariance).T
    return Source(
        problem=fit.problem,
        z=np.concatenate([fit.z[None], fit.z + away]),
        campaign=campaign,
        seed=seed,
        method="diagnosis: a Gaussian about the fit with all named effects",
        unexplained=unexplained,
    )
