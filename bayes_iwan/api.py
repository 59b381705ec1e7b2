"""What `import bayes_iwan as bi` offers: a function a command, each with a typed result to be shown and written."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_iwan.arguments import CAMPAIGN, classes_of, path_of, seed_of
from bayes_iwan.campaign import Campaign, Loop
from bayes_iwan.campaign.folders.check import Check as Check
from bayes_iwan.campaign.folders.check import check as check
from bayes_iwan.campaign.folders.folder import folder_of
from bayes_iwan.executors import Workers, opened
from bayes_iwan.export import export
from bayes_iwan.files import clear, results_folder
from bayes_iwan.former_names import refuse_former_options
from bayes_iwan.inference.each_frequency import identify_frequencies
from bayes_iwan.inference.identify import NotConverged, identify_campaign
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.run_files import load as load_run
from bayes_iwan.inference.results.run_files import write as write_run
from bayes_iwan.inference.setup.config import Config, ConfigError
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models import Simulator
from bayes_iwan.report import accessors as accessors  # gives posteriors their plots
from bayes_iwan.sampling.checkpoint import NAME as CHECKPOINT

if TYPE_CHECKING:  # each function imports the folders that it needs itself: together they take a second
    from bayes_iwan.comparison.families import Comparison
    from bayes_iwan.diagnosis.answer.result import Diagnosis
    from bayes_iwan.effects.base import Effect
    from bayes_iwan.export.json_file import ExportedModel

__all__ = ["Check", "check", "compare", "diagnose", "identify", "load", "write"]
PathLike = str | os.PathLike[str]


@refuse_former_options
def identify(
    campaign: Campaign | PathLike,
    out: PathLike | None = None,
    *,
    config: Config = None,
    seed: int = 0,
    per_test: bool = False,
    resume: bool = False,
    keep_chains: bool = False,
    progress: bool = True,
    simulator: Simulator | PathLike | None = None,
    quick: bool = False,
    overwrite: bool = False,
    workers: Workers = None,
) -> Posterior:
    """The joint posterior of a campaign's tests, with all its files, report.html among them, in `out` if given.

    Parameters
    ----------
    campaign
        a campaign, or its folder.
    out
        folder for the results, checked before anything is computed; None writes nothing.
    config
        a TOML file, its tables as a mapping, or :class:`bayes_iwan.IdentifySettings`.
    seed
        of all random numbers.
    per_test
        identify each frequency alone as well.
    resume
        go on from the checkpoint in out where a run was stopped.
    keep_chains
        keep that checkpoint, which holds every draw, when the run has converged.
    simulator
        a model of your own in the place of the Iwan model, or its Python file (its code is run).
    quick
        the most probable point and the first draws about it, in about a minute, not asked whether they have converged.
    overwrite
        write over finished results of another campaign in `out`.
    workers
        number of processes, address of a Dask scheduler ("tcp://host:port"), or an executor of your own: the draws are
        the same. With `per_test` each frequency is a piece of work.

    Returns
    -------
    Posterior
        draws, summary, predictions and plots.

    Raises
    ------
    CampaignError, ConfigError, ParameterError, ModelError, CheckpointError, OutputError
        InputErrors of one line.

    Warns
    -----
    NotConverged
        the run ended before its chains had converged.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=1).write(folder)
    >>> posterior = bi.identify(folder, quick=True, seed=1, config={"model": {"slip": "gamma1", "embedded": False}})
    >>> low, middle, high = posterior.predict(frequency_hz=12.0, amplitude_mm=0.6).band()
    >>> bool((low <= high).all()), middle.shape
    (True, (1, 128))
    """
    for option, asked in (("per_test", per_test), ("keep_chains", keep_chains)):
        if asked and (out is None or quick):
            raise ConfigError(
                f"{option} writes files of sampled runs: name a folder for them (out), and leave quick away"
            )
    with opened(workers, along=not per_test) as executor:
        identified = partial(
            identify_campaign, campaign, config=config, seed=seed, progress=progress, simulator=simulator, quick=quick,
            workers=executor,
        )  # fmt: skip
        if out is None:
            return _warned(identified())
        from bayes_iwan.report.identification.identification_page import identification_report

        going_on = resume and (Path(out) / CHECKPOINT).exists()  # which knows its campaign
        with results_folder(out, "identify", folder_of(campaign), overwrite=overwrite or going_on) as folder:
            if not resume and (folder / CHECKPOINT).exists():
                raise ConfigError(
                    f"{folder}: holds a run already ({CHECKPOINT}); go on from it with --resume, or choose another "
                    "folder (--out)"
                )
            posterior = _warned(identified(folder, resume=resume))
            if posterior.interrupted:
                return posterior
            identification_report(posterior, folder)  # stands should the runs of single frequencies be cut short
            if per_test:
                identify_frequencies(posterior, folder, resume=resume, progress=progress, workers=executor)
                identification_report(posterior, folder)
            if posterior.converged and not keep_chains:
                alone = (p.parent.name for p in folder.glob(f"per_test/*/{CHECKPOINT}"))
                clear(folder, CHECKPOINT, *(f"per_test/{name}/{CHECKPOINT}" for name in alone))
        return posterior


def _warned(posterior: Posterior) -> Posterior:
    if not posterior.converged and not posterior.quick:
        warnings.warn(posterior.message, NotConverged, stacklevel=4)
    return posterior


@refuse_former_options
def diagnose(
    campaign: Campaign | PathLike,
    out: PathLike | None = None,
    *,
    config: DiagnoseSettings | Config = None,
    seed: int = 0,
    quick: bool = False,
    base: str = "generalized",
    effects: Sequence[type[Effect]] | PathLike = (),
    simulator: Simulator | PathLike | None = None,
    progress: bool = True,
    overwrite: bool = False,
    workers: Workers = None,
) -> Diagnosis:
    """Where the model misses, which cause explains it, how far the gap shrinks; files and page in `out` if given.

    Parameters
    ----------
    campaign
        a campaign, or its folder.
    out
        folder for diagnosis.json, fits.json, the page and the figures; None writes nothing.
    config
        [model] and [parameters] tables, a TOML file with them, or :class:`bayes_iwan.DiagnoseSettings`.
    seed
        of all random numbers.
    quick
        stop at refits and an approximate evidence.
    base
        model to start from: "generalized", "no_speed" or "classical".
    effects
        effects of your own, as classes, or the Python file that defines them (its code is run).
    simulator
        a model of your own in the place of the Iwan model, or its Python file (its code is run).
    progress
        show a bar.
    overwrite
        write over finished results of another campaign in `out`.
    workers
        as for :func:`identify`: effects are refitted side by side, with the same answer.

    Returns
    -------
    Diagnosis
        verdict, budget of the gap (RMS in N and shares), next test; its repr is the answer in plain words.

    Raises
    ------
    CampaignError, ConfigError, EffectError, ModelError, OutputError
        InputErrors of one line.

    Examples
    --------
    A dashpot on the virtual rig, found again (ten seconds):

    >>> import tempfile, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(f, a, cycles=8) for f in (8.0, 20.0) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, fault="viscous_damping", size=0.2, seed=1).write(folder)
    >>> found = bi.diagnose(folder, quick=True, seed=1)
    >>> found.verdict.names, found.verdict.causes[0].share.value > 0.5
    (('viscous_damping',), True)
    """
    from bayes_iwan.diagnosis.answer.result import Diagnosis
    from bayes_iwan.diagnosis.diagnosis import diagnose_campaign
    from bayes_iwan.effects.base import Effect
    from bayes_iwan.report.diagnosis.diagnosis_files import write_diagnosis

    seed = seed_of(seed)
    if not isinstance(campaign, Campaign):
        path_of(campaign, "campaign", CAMPAIGN)
    effects = classes_of(effects, "effects", Effect)
    setattr(Diagnosis, "export", export)  # noqa: B010  (as posteriors have it)
    diagnosed = diagnose_campaign if out is None else partial(write_diagnosis, out=out, overwrite=overwrite)
    return diagnosed(
        campaign, config=config, seed=seed, quick=quick, base=base, effects=effects, simulator=simulator,
        progress=progress, workers=workers,
    )  # fmt: skip


@refuse_former_options
def compare(
    campaign: Campaign | PathLike | Sequence[Loop],
    out: PathLike | None = None,
    *,
    families: str | Sequence[str] | None = None,
    config: Config = None,
    seed: int = 0,
    by: str = "auto",
    simulator: Simulator | PathLike | None = None,
    overwrite: bool = False,
    workers: Workers = None,
    progress: bool = True,
) -> Comparison:
    """Fit model families to a campaign and rank them by how well they predict; compare.html in `out` if given.

    Parameters
    ----------
    campaign
        a campaign, its folder, or averaged loops.
    out
        folder for compare.html and compare.csv; None writes nothing.
    families
        one name or several of :data:`bayes_iwan.comparison.families.FAMILIES` (default: all).
    config, seed
        as for :func:`identify`.
    by
        "loo" (single data held out), "tests" (whole tests held out) or "auto" (the first where its Pareto k hold).
    simulator
        a model of your own that is compared too, or its Python file (its code is run).
    overwrite
        write over finished results of another campaign in `out`.
    workers
        as for :func:`identify`: families are fitted side by side.
    progress
        show a bar.

    Returns
    -------
    Comparison
        families, best first, with differences of the expected log predictive density in nats.

    Raises
    ------
    CompareError
        unknown families or rankings.
    CampaignError, ConfigError, OutputError
        as for :func:`identify`.

    References
    ----------
    Vehtari, Gelman & Gabry, Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC,
    Statistics and Computing 27 (2017) 1413.

    Examples
    --------
    Slip forces by a gamma or a uniform distribution, by short runs (for an answer that counts leave `config` away, some
    minutes):

    >>> import tempfile, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(f, a, cycles=6) for f, a in ((8.0, 0.4), (20.0, 0.9))]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=3).write(folder)
    >>> short = {"search": {"members": 40, "evaluations": 400, "starts": 2, "second_search": False},
    ...          "sampling": {"ensembles": 2, "budget_s": 2.0, "draws": 200}}
    >>> ranked = bi.compare(folder, families=["uniform", "gamma1"], config=short, by="loo", seed=1, progress=False)
    >>> [row.name for row in ranked.rows()], ranked.rows()[0].difference
    (['gamma1', 'uniform'], 0.0)
    """
    from bayes_iwan.comparison.families import compare_families

    chosen = partial(
        compare_families, campaign, families, config=config, seed=seed, by=by, simulator=simulator, workers=workers,
        progress=progress,
    )  # fmt: skip
    if out is None:
        return chosen()
    from bayes_iwan.report.comparison_page import comparison_report

    with results_folder(out, "compare", folder_of(campaign), overwrite=overwrite) as folder:
        result = chosen()
        comparison_report(result, folder)
    return result


def load(
    folder: PathLike, campaign: PathLike | None = None, simulator: Simulator | PathLike | None = None
) -> Posterior | ExportedModel:
    """The posterior that :func:`identify` wrote, or the model that was exported to JSON.

    Parameters
    ----------
    folder
        what was given as `out`, or an isolator.json, or the folder of one.
    campaign, simulator
        of a posterior: the campaign's folder, if that has moved; the model of one's own that was identified, or its
        Python file (its code is run).

    Returns
    -------
    Posterior or ExportedModel
        equal to the one that was written.

    Raises
    ------
    ResultsError, ExportError
        no result there, a damaged one, or a campaign or version that gives another problem.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder, out = tempfile.mkdtemp(), tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> posterior = bi.identify(folder, quick=True, seed=1, config={"model": {"slip": "gamma1", "embedded": False}})
    >>> model = bi.load(posterior.export("json", out, draws=3))
    >>> model.force(bi.sine_motion(frequency_hz=10.0, amplitude_mm=0.5)).shape  # the point and three draws
    (4, 1, 128)
    """
    path = path_of(folder, "folder")
    if path.is_file() or (not (path / "posterior.nc").exists() and (path / "isolator.json").exists()):
        from bayes_iwan.export.json_file import read

        return read(path if path.is_file() else path / "isolator.json")
    return load_run(folder, campaign, simulator)


def write(result: Posterior | Diagnosis | Comparison, folder: PathLike, *, overwrite: bool = False) -> Path:
    """Write a result with its page, tables and figures into a folder, as the command line does.

    Parameters
    ----------
    result
        of :func:`identify`, :func:`diagnose` or :func:`compare`.
    folder
        is made where it does not exist.
    overwrite
        write over finished results of another campaign in `folder`.

    Returns
    -------
    Path
        of the page: report.html, diagnosis.html or compare.html.

    Raises
    ------
    OutputError, TypeError
        a folder that cannot be written to; something that is no result.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, 0.9, cycles=6)], seed=1).write(folder)
    >>> posterior = bi.identify(folder, quick=True, seed=1, config={"model": {"slip": "gamma1", "embedded": False}})
    >>> bi.write(posterior, tempfile.mkdtemp()).name
    'report.html'
    """
    if isinstance(result, Posterior):
        from bayes_iwan.report.identification.identification_page import identification_report

        with results_folder(folder, "identify", folder_of(result.campaign), overwrite=overwrite) as out:
            write_run(result, out)
            return identification_report(result, out)
    from bayes_iwan.comparison.families import Comparison
    from bayes_iwan.diagnosis.answer.result import Diagnosis

    if isinstance(result, Diagnosis):
        from bayes_iwan.report.diagnosis.diagnosis_files import write_found

        return write_found(result, Path(folder), overwrite)
    if isinstance(result, Comparison):
        from bayes_iwan.report.comparison_page import comparison_report

        origin = folder_of(result.campaign)
        with results_folder(folder, "compare", origin, overwrite=overwrite) as out:
            return comparison_report(result, out)
    raise TypeError(f"{type(result).__name__} is no result of identify, diagnose or compare")
