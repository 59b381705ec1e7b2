"""Files of an identification, summary.csv, point.json and posterior.nc, each put in place whole; and their reader."""

import csv
import io
import json
import os
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop, read_campaign
from bayes_iwan.files import clear, write_whole
from bayes_iwan.fitting.genetic import GlobalOptimum
from bayes_iwan.inference.results.netcdf import ResultsError, Stored, read_netcdf, write_netcdf
from bayes_iwan.inference.results.posterior import Posterior, SummaryRow
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import sampled_and_derived
from bayes_iwan.models import Simulator
from bayes_iwan.models.user_file import load_simulator

#: all that an identification leaves in its folder beside the checkpoint; pages and tables are made from the others
WRITTEN = ("report.html", "report.pdf", "tables", "posterior.nc", "point.json", "summary.csv")


def write(posterior: Posterior, folder: Path) -> None:
    """summary.csv, point.json and posterior.nc into `folder`, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    clear(folder, *WRITTEN)
    write_whole(folder / "summary.csv", summary_csv(posterior).encode())
    write_whole(folder / "point.json", (json.dumps(point_record(posterior), indent=1) + "\n").encode())
    write_netcdf(posterior, folder / "posterior.nc")


def summary_csv(posterior: Posterior) -> str:
    """The summary as comma-separated text, names and notes in the campaign's own units; a quick one has a column that
    says so, and no diagnostics."""
    units, quick = posterior.problem.units, posterior.quick
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    columns = [f.name for f in fields(SummaryRow)]
    writer.writerow([*columns, "method"] if quick else columns)
    for row in posterior.summary():
        cells = [_cell(units.everywhere(getattr(row, name))) for name in columns]
        if quick:
            at = columns.index("ess_bulk")
            cells[at : at + 3] = ["", "", ""]
        writer.writerow([*cells, "quick"] if quick else cells)
    return out.getvalue()


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return value
    return "" if not np.isfinite(value) else f"{value:.8g}"


def point_record(posterior: Posterior) -> dict[str, object]:
    """The point estimate as plain numbers for point.json."""
    problem, point = posterior.problem, posterior.point

    def named(z: Array) -> dict[str, float]:
        return {name: float(q.values[0]) for name, q in sampled_and_derived(problem, z[None]).items()}

    def history(search: GlobalOptimum) -> dict[str, object]:
        return {
            "objective": search.objective,
            "evaluations": search.n_evaluations,
            "stopped": search.stopped,
            "best": search.best.tolist(),
            "median": search.median.tolist(),
        }

    return {
        "seed": posterior.seed,
        "eq8_minimum": {
            "value": point.goal,
            "share_of_friction_force": point.goal_share,
            "numbers": named(point.goal_z),
        },
        "most_probable": {
            "log_prob": point.log_prob,
            "eq8": point.goal_at_z,
            "numbers": named(point.z),
            "maxima_log_prob": point.optima_log_prob.tolist(),
            "best_log_prob_of_each_search": point.each_log_prob.tolist(),
        },
        "searches": [history(search) for search in point.searches],
        "evaluations": point.n_evaluations,
        "seconds": round(point.seconds, 3),
        "versions": dict(posterior.versions),
    }


def load(
    folder: str | os.PathLike[str],
    campaign: str | os.PathLike[str] | None = None,
    simulator: Simulator | str | os.PathLike[str] | None = None,
) -> Posterior:
    """The posterior that :func:`bayes_iwan.identify` wrote, equal to it; arguments and errors as of
    :func:`bayes_iwan.load`.

    The campaign is read again from where it lies as seen from the run's folder, so both can be moved together. Where a
    simulator of one's own was identified, name it: what a result names is data, and is never run.
    """
    path = Path(folder) / "posterior.nc"
    if not path.is_file():
        raise ResultsError(f"{path}: not found; {folder} is not a folder that `bayes-iwan identify` has finished")
    try:
        stored = read_netcdf(path)
    except ResultsError:
        raise
    except Exception as error:  # whatever HDF5 and its readers make of damaged bytes, and a hostile file of its numbers
        raise ResultsError(f"{path}: damaged ({_line(error)}); identify again") from None
    if not campaign and not stored.campaign:
        raise ResultsError(f"{path}: its loops came from no campaign folder, so it cannot be loaded without them")
    where = Path(campaign or Path(os.path.normpath(Path(folder).resolve() / stored.campaign)))
    if not where.exists():
        raise ResultsError(f"{path}: its campaign is not in {where}; name the campaign's folder (--campaign DIR)")
    file = stored.run["simulator_file"] and str((Path(folder) / stored.run["simulator_file"]).resolve())
    if file and simulator is None:
        raise ResultsError(
            f"{path}: was made with the simulator in {file}, a Python file that is not run unasked; name it "
            "(--simulator FILE, or the argument simulator) if you trust it"
        )
    if isinstance(simulator, str | os.PathLike):
        file, simulator = str(Path(simulator).resolve()), load_simulator(simulator)
    source = read_campaign(where)
    every = {x.file: x for x in source.loops(**asdict(stored.run["settings"].loops))}
    if missing := [name for name in stored.loops if name not in every]:
        raise ResultsError(f"{path}: the campaign {where} no longer has {missing[0]}; name the right campaign")
    loops = tuple(every[name] for name in stored.loops)
    problem = _same_problem(path, loops, stored, simulator)
    if missing := [name for name in problem.names if name not in stored.draws]:
        raise ResultsError(f"{path}: damaged (no draws of {missing[0]}); identify again")
    z = np.stack([stored.draws[name] for name in problem.names], axis=2)
    run = stored.run | {"simulator_file": file}
    return Posterior(problem, source, loops, z, stored.log_prob, **run)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _same_problem(path: Path, loops: tuple[Loop, ...], stored: Stored, simulator: Simulator | None) -> Problem:
    problem = make_problem(loops, stored.run["settings"], simulator, stored.scales)
    now = problem.fingerprint()
    for part in now:
        if stored.fingerprint.get(part) != now[part]:
            raise ResultsError(
                f"{path}: its {part} is not what the campaign and this version give now; "
                "identify again, or give the campaign it was made from"
            )
    return problem
