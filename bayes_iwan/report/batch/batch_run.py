"""Many campaigns, one after the other or side by side: `bayes-iwan batch`. Restartable; what fails is listed.

OUT/specimens/NAME/   what `identify` and `diagnose` write of the campaign FOLDER/NAME, and specimen.json: what the
                      table and the page across specimens need of it. Where that stands, the specimen is finished.
OUT/batch.csv, batch.html, sheet.pdf, failures.csv (batch.xlsx with openpyxl, batch.parquet with pyarrow installed)

FOLDER/specimens.csv  says more of the specimens where it is there: a column "specimen" with the names of the folders,
                      and others of which `group` names one: the lot, the supplier.
"""

import hashlib
import io
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

import bayes_iwan
from bayes_iwan import executors
from bayes_iwan.arguments import path_of, seed_of
from bayes_iwan.arrays import Array
from bayes_iwan.files import finite, results_folder, write_whole
from bayes_iwan.former_names import refuse_former_options
from bayes_iwan.inference.results.population import DRAWS
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.config import NOISE, Config, settings_of
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.setup.settings import DiagnoseSettings, IdentifySettings
from bayes_iwan.report.batch.batch_page import write_batch_page
from bayes_iwan.report.batch.batch_sheet import write_sheet
from bayes_iwan.report.batch.specimens import Batch, BatchError, Finished, Quantity, lots_of, summarised
from bayes_iwan.report.diagnosis.diagnosis_files import write_diagnosis
from bayes_iwan.report.identification.marginals import identifiable
from bayes_iwan.report.page import Table, of_folder
from bayes_iwan.sampling.checkpoint import NAME as CHECKPOINT
from bayes_iwan.sampling.checkpoint import CheckpointError

_SCHEMA = 1


@dataclass(frozen=True)
class Job:
    """What is done with every campaign, and where."""

    folder: Path
    out: Path
    identify: bool
    diagnose: bool
    quick: bool
    seed: int
    config: IdentifySettings
    keep_chains: bool


@refuse_former_options
def batch(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    identify: bool = True,
    diagnose: bool = False,
    quick: bool = False,
    seed: int = 0,
    config: Config = None,
    keep_chains: bool = False,
    group: str | None = None,
    overwrite: bool = False,
    workers: executors.Workers = None,
    progress: bool = True,
) -> Batch:
    """Identify or diagnose (or both) every campaign in a folder, and summarise across them.

    A batch that was stopped goes on: a specimen that is finished, of the same data and settings, is not run again. One
    that fails is listed with its reason, the others are finished. Every specimen has the seed and configuration that
    are given, so its answer is that of `identify` or `diagnose` alone.

    Parameters
    ----------
    folder
        each folder in it that holds a campaign.toml is a specimen.
    out
        folder for batch.csv, batch.html, sheet.pdf and a folder for each specimen.
    identify, diagnose
        what to do.
    quick
        as of :func:`bayes_iwan.identify` and :func:`bayes_iwan.diagnose`, for whichever is done.
    seed
        of all random numbers.
    config
        as for :func:`bayes_iwan.identify`.
    keep_chains
        keep every draw of every specimen.
    group
        column of FOLDER/specimens.csv that says to which lot a specimen belongs: lots are then compared, and specimens
        shrunk towards the others of their lot.
    overwrite
        write over finished results of another folder's specimens.
    workers
        as for :func:`bayes_iwan.identify`: specimens are run side by side.
    progress
        show a bar.

    Returns
    -------
    Batch
        what is finished, what failed, and how the specimens differ.

    Raises
    ------
    BatchError
        nothing to do, or a specimens.csv that does not say what `group` asks.
    ConfigError, OutputError
        InputErrors of one line.

    Examples
    --------
    A folder of campaign folders, some minutes each::

        found = bi.batch("specimens", "runs/all", seed=1)
        found.populations["kp_N_mm"].typical   # median and 90 % interval of the typical specimen, N/mm
        found.outliers()                       # specimens that stand out, and in what
    """
    source, seed = path_of(folder, "folder"), seed_of(seed)
    if not (identify or diagnose):
        raise BatchError("neither to be identified nor to be diagnosed: nothing to do")
    if keep_chains and quick:
        raise BatchError("quick draws have no chains to keep: leave quick or keep_chains (--keep-chains) away")
    if not source.is_dir():
        raise BatchError(f"{source}: not a folder; name one that holds campaign folders")
    names = sorted(p.parent.name for p in source.glob("*/campaign.toml"))
    if not names:
        raise BatchError(f"{source}: no folder in it holds a campaign.toml")
    settings = settings_of(config)
    lots = {} if group is None else lots_of(source, group, names)
    with results_folder(out, "batch", source, overwrite=overwrite) as there:
        job = Job(source, there / "specimens", identify, diagnose, quick, seed, settings, keep_chains)
        pieces = {name: name for name in names}
        done = executors.run(pieces, _one, job, workers=workers, what="batch", unit="specimen", progress=progress)
        failed = {n: str(x) for n, x in done.items() if isinstance(x, executors.Failure)}
        failures = {n: reason.replace(f"{source}{os.sep}", "") for n, reason in failed.items()}  # for others to read
        finished = tuple(_read(job, n) for n in names if n not in failures)
        result = summarised(finished, failures, seed, group or "", lots)
        _write(result, there)
        write_batch_page(result, there, replace(of_folder(source, seed, names), counted="campaign"))
    return result


# ---- one specimen, in whatever process


def _one(job: Job, name: str) -> str:
    """Identify and diagnose one campaign into its folder, unless that is done already."""
    campaign, out = job.folder / name, job.out / name
    made_with = _made_with(job, campaign)
    if stored_specimen(out, made_with) is not None:
        return name
    began = time.monotonic()
    record: dict[str, object] = {"schema": _SCHEMA, "made_with": made_with, "quantities": {}}
    if job.identify:
        record |= _identified(job, campaign, out)
    if job.diagnose:
        # one configuration for both: a diagnosis takes the model and its priors of it
        own = {name: change for name, change in job.config.parameters.items() if name not in NOISE}
        settings = DiagnoseSettings(job.config.model, own)
        found = write_diagnosis(
            campaign, out, seed=job.seed, quick=job.quick, config=settings, progress=False, overwrite=True
        )
        answer = finite(found.to_dict())
        verdict, gap = answer["verdict"], answer["gap"]
        record |= {k: verdict[k] for k in ("cause", "second_cause", "probability")}
        record |= {"gap_share": gap["before_share"], "shrink": gap["shrink"]}
    record["seconds"] = time.monotonic() - began
    write_whole(out / "specimen.json", json.dumps(record))
    return name


def _made_with(job: Job, campaign: Path) -> dict[str, object]:
    """What a specimen's answer depends on; another one is not this batch's."""
    data = hashlib.sha256()
    for path in sorted(p for p in campaign.rglob("*") if p.is_file()):
        data.update(path.relative_to(campaign).as_posix().encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    chosen = {k: getattr(job, k) for k in ("identify", "diagnose", "quick", "seed")}
    whole = chosen | {"config": job.config.as_dict(), "data": data.hexdigest(), "version": bayes_iwan.__version__}
    return json.loads(json.dumps(whole))


def _identified(job: Job, campaign: Path, out: Path) -> dict[str, object]:
    def run(resume: bool) -> Posterior:
        return bayes_iwan.identify(
            campaign,
            out,
            config=job.config,
            seed=job.seed,
            resume=resume,
            keep_chains=job.keep_chains,
            progress=False,
            quick=job.quick,
            overwrite=True,  # these folders are the batch's own, which is guarded as a whole
        )

    try:
        posterior = run(resume=True)
    except CheckpointError:  # left by other settings or another version
        (out / CHECKPOINT).unlink(missing_ok=True)
        posterior = run(resume=False)
    if posterior.interrupted:
        raise KeyboardInterrupt
    rng = np.random.default_rng([job.seed, 62])
    draws, labels = identifiable(posterior)
    before = quantities(posterior.problem, posterior.problem.prior.draw(rng, 400), posterior.problem.loops[:1])
    found = posterior.quantities()
    record = {}
    for name, x in draws.items():
        low, median, high = np.quantile(x, [0.05, 0.5, 0.95])
        prior = np.asarray(before[name].values, dtype=float)
        record[posterior.problem.units.name(name)] = {
            "label": labels[name],
            "unit": found[name].unit,
            "median": float(median),
            "low": float(low),
            "high": float(high),
            "draws": _rounded(rng.choice(x, min(len(x), 2 * DRAWS), replace=False)),
            "prior": _rounded(prior[np.isfinite(prior)]),
        }
    converged, size = None if posterior.quick else posterior.converged, posterior.residual_size()
    return {
        "residual_share": size.share,
        "gap_share": size.gap_share,
        "converged": converged,
        "message": posterior.message,
        "quantities": record,
    }


def _rounded(x: Array) -> list[float]:
    return [float(f"{v:.7g}") for v in x]


# ---- files


def stored_specimen(out: Path, made_with: Mapping[str, object]) -> Finished | None:
    """What stands in a specimen's folder, if it was made with this; None for anything else, damaged files included."""
    try:
        record = json.loads((out / "specimen.json").read_text())
        if record["schema"] != _SCHEMA or record["made_with"] != made_with:
            return None
        found = {name: _quantity(q) for name, q in record["quantities"].items()}
        return Finished(out.name, quantities=found, **_fields(Finished, {"message": ""} | record))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return None


def _quantity(q: Mapping[str, object]) -> Quantity:
    """A quantity as it was written; ValueError, TypeError, KeyError for anything else."""
    draws, prior = (np.array(q[key], dtype=float) for key in ("draws", "prior"))
    if draws.ndim != 1 or prior.ndim != 1 or not draws.size or not np.isfinite([*draws, *prior]).all():
        raise ValueError("draws that are no list of numbers")
    return Quantity(draws=draws, prior=prior, **_fields(Quantity, q))


def _fields(kind: type, stored: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a dataclass that are of JSON's own types, a whole number where a number is asked for too."""
    out, plain = {}, (float, str, float | None, str | None, bool | None)
    for name, of in get_type_hints(kind).items():
        if of in plain and name != "name":
            value = stored.get(name)
            out[name] = float(value) if of in (float, float | None) and type(value) is int else value
            if not isinstance(out[name], of):
                raise TypeError(f"{value!r:.60} is no {of}")
    return out


def _read(job: Job, name: str) -> Finished:
    found = stored_specimen(job.out / name, _made_with(job, job.folder / name))
    if found is None:
        raise BatchError(f"{job.out / name}: changed while the batch ran; run it again")
    return found


def _write(result: Batch, out: Path) -> None:
    table = result.table()
    table.write_csv(out)
    failures = Table("failures", ("specimen", "reason"), tuple(result.failures.items()))
    failures.write_csv(out)
    write_sheet(result, out / "sheet.pdf")
    _write_excel(table, out / "batch.xlsx")
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:  # the same table is in batch.csv
        return
    content = io.BytesIO()
    pq.write_table(pa.table(dict(zip(table.columns, zip(*table.rows)))), content)
    write_whole(out / "batch.parquet", content.getvalue())


def _write_excel(table: Table, path: Path) -> None:
    """The same table for Excel, numbers as numbers, its head fixed and with filters."""
    try:
        from openpyxl import Workbook
    except ImportError:  # the same table is in batch.csv
        return
    book, content = Workbook(), io.BytesIO()
    sheet = book.active
    assert sheet is not None
    sheet.title = "specimens"
    for row in (table.columns, *table.rows):
        # what begins with "=" is text of a specimen's name, never a formula
        plain = ["'" + x if isinstance(x, str) and x[:1] in ("=", "+", "-", "@") else x for x in row]
        sheet.append([None if isinstance(x, float) and not np.isfinite(x) else x for x in plain])
    sheet.freeze_panes = "B2"
    sheet.auto_filter.ref = sheet.dimensions
    book.save(content)
    write_whole(path, content.getvalue())
