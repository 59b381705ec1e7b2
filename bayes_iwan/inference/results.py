"""Files of an identification, summary.csv, point.json and posterior.nc, each put in place whole; and their reader."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop, read_campaign
from bayes_iwan.files import clear, write_whole
from bayes_iwan.inference.config import settings_of
from bayes_iwan.inference.point import Point
from bayes_iwan.inference.posterior import Posterior
from bayes_iwan.inference.problem import Problem, make_problem
from bayes_iwan.inference.quantities import sampled_and_derived
from bayes_iwan.inference.rows import ConvergenceRow, SummaryRow
from bayes_iwan.inference.user_file import load_simulator
from bayes_iwan.optimize.genetic import GlobalOptimum
from bayes_iwan.physics import Scales, Simulator
from bayes_iwan.sampling.ensembles import Stop

FORMAT = 2
#: what stands behind posterior.nc's own end (HDF5 does not look there), before the SHA-256 of all before it
_SEAL = b"bayes_iwan sha256 "
#: all that an identification leaves in its folder beside the checkpoint; pages and tables are made from the rest
WRITTEN = ("report.html", "report.pdf", "tables", "posterior.nc", "point.json", "summary.csv")
#: groups that are looked at but not gone on from: seven digits are enough
_SHOWN = ("posterior", "prior", "posterior_predictive", "prior_predictive", "log_likelihood")
PREDICTIVE_DRAWS = 200
POINTWISE_DRAWS = 1000


class ResultsError(ValueError):
    """A folder of results that cannot be read back; the message says why."""


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
        writer.writerow([*cells, "laplace"] if quick else cells)
    return out.getvalue()


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "" if not np.isfinite(value) else f"{value:.8g}"


def point_record(posterior: Posterior) -> dict[str, Any]:
    """The point estimate as plain numbers for point.json."""
    problem, point = posterior.problem, posterior.point

    def named(z: Array) -> dict[str, float]:
        return {name: float(q.values[0]) for name, q in sampled_and_derived(problem, z[None]).items()}

    def history(search: GlobalOptimum | None) -> dict[str, Any] | None:
        if search is None:
            return None
        return {
            "method": search.method,
            "objective": search.objective,
            "evaluations": search.n_evaluations,
            "stopped": search.stopped,
            "best": search.best.tolist(),
            "median": search.median.tolist(),
        }

    return {
        "seed": posterior.seed,
        "objective": {
            "kind": point.objective,
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
        "search": history(point.search),
        "second_opinion": history(point.second),
        "evaluations": point.n_evaluations,
        "seconds": round(point.seconds, 3),
        "versions": dict(posterior.versions),
    }


def write_netcdf(posterior: Posterior, path: Path) -> None:
    """posterior.nc, readable by `arviz.from_netcdf`.

    Groups: posterior (every reported quantity), unconstrained_posterior (z), prior, prior_predictive,
    posterior_predictive, log_likelihood, sample_stats, observed_data, constant_data; the root's attributes hold the
    seed, configuration, versions and convergence.
    """
    import h5netcdf
    import xarray as xr  # some 0.5 s to import: only where files are written
    from xarray.backends import H5NetCDFStore

    buffer = io.BytesIO()  # not the disk: HDF5 ends the whole process where a disk is full
    with h5netcdf.File(buffer, "w") as file:
        xr.Dataset(attrs=_attributes(posterior)).dump_to_store(H5NetCDFStore(file, mode="w"))
        for group, dataset in _groups(posterior, xr).items():
            few = {"dtype": "f4"} if group in _SHOWN else {}
            packed = {name: {"zlib": True, "complevel": 4, "shuffle": True, **few} for name in dataset.data_vars}
            dataset.dump_to_store(H5NetCDFStore(file, group=group, mode="a"), encoding=packed)
    whole = buffer.getvalue()  # a damaged byte makes HDF5's reader wrong, slow or dead: it shall not see one
    write_whole(path, whole + _SEAL + hashlib.sha256(whole).digest())


def _groups(posterior: Posterior, xr: Any) -> dict[str, Any]:
    problem, loops = posterior.problem, posterior.problem.loops
    chains, draws, _ = posterior.z.shape
    files = [x.file for x in loops]

    def over_draws(variables: Mapping[str, tuple[str, Array]], n_chains: int = chains) -> Any:
        return xr.Dataset(
            {
                name: (["chain", "draw"], x.reshape(n_chains, -1), {"unit": unit})
                for name, (unit, x) in variables.items()
            }
        )

    at = {"test": files, "phase": loops[0].phase}
    dims = ("chain", "draw", "test", "phase")
    some = np.linspace(0, draws - 1, min(draws, PREDICTIVE_DRAWS // chains + 1)).round().astype(int)
    rng = np.random.default_rng([posterior.seed, 13])

    def some_draws(x: Array) -> Array:
        return x.reshape(chains, len(some), *x.shape[1:])

    z = posterior.z[:, some].reshape(-1, problem.ndim)
    force = problem.predict(z)
    replicated = some_draws(posterior.replicate(force, problem.parameter_values(z), rng))
    force = some_draws(force)
    prior_z = problem.prior.draw(rng, 1000)
    few = prior_z[:PREDICTIVE_DRAWS]
    prior_force = problem.predict(few)
    prior_replicated = problem.likelihood.replicate(prior_force, problem.parameter_values(few), rng)[None]
    prior_force = prior_force[None]
    each = np.linspace(0, draws - 1, min(draws, POINTWISE_DRAWS // chains)).round().astype(int)
    point_log = problem.pointwise(posterior.z[:, each].reshape(-1, problem.ndim))
    stacked = {
        name: np.stack([getattr(x, name) for x in loops])
        for name in ("displacement_mm", "velocity_m_s", "acceleration_m_s2", "force_N", "force_scatter_N", "noise_N")
    }
    harmonics = np.stack([x.harmonics_N for x in loops])
    constant: dict[str, Any] = {
        name: (("test", "phase"), stacked[name])
        for name in ("displacement_mm", "velocity_m_s", "acceleration_m_s2", "force_scatter_N")
    }
    constant["noise_N"] = (("test", "harmonic"), stacked["noise_N"])
    constant |= {
        name: (("test",), np.array([getattr(x, name) for x in loops], float))
        for name in ("frequency_hz", "amplitude_mm", "offset_mm", "n_cycles")
    }
    return {
        "posterior": over_draws({n: (q.unit, q.values) for n, q in posterior.quantities().items()}),
        "unconstrained_posterior": over_draws({n: ("-", posterior.z[..., i]) for i, n in enumerate(problem.names)}),
        "sample_stats": over_draws({"lp": ("-", posterior.log_prob)}),
        "prior": over_draws({n: (q.unit, q.values) for n, q in sampled_and_derived(problem, prior_z).items()}, 1),
        "prior_predictive": xr.Dataset({"force_N": (dims, prior_replicated), "model_N": (dims, prior_force)}, at),
        "posterior_predictive": xr.Dataset(
            {"force_N": (dims, replicated), "model_N": (dims, force)}, {**at, "draw": some}
        ),
        "log_likelihood": xr.Dataset(
            {"data": (("chain", "draw", "datum"), point_log.reshape(chains, len(each), -1))}, {"draw": each}
        ),
        "observed_data": xr.Dataset(
            {
                "force_N": (("test", "phase"), stacked["force_N"]),
                "harmonics_real_N": (("test", "harmonic"), harmonics.real),
                "harmonics_imag_N": (("test", "harmonic"), harmonics.imag),
            },
            at,
        ),
        "constant_data": xr.Dataset(constant, at),
    }


def to_arviz(posterior: Posterior) -> Any:
    """The groups of posterior.nc as ArviZ's own object: `InferenceData` up to 0.23, xarray's `DataTree` from 1.0."""
    import warnings

    import xarray as xr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 0.23 announces 1.0 at import
        import arviz as az
    groups = _groups(posterior, xr)
    if int(az.__version__.split(".")[0]) >= 1:
        return xr.DataTree.from_dict(groups)
    return az.InferenceData(**groups, warn_on_custom_groups=False)


def _attributes(posterior: Posterior) -> dict[str, Any]:
    campaign = posterior.campaign
    return {
        "format": FORMAT,
        "seed": posterior.seed,
        "walkers": posterior.walkers,
        "thin": posterior.thin,
        "converged": int(posterior.converged),
        "message": posterior.message,
        "stop": posterior.stop.name,
        "campaign_name": "" if campaign is None else campaign.name,
        "campaign_path": "" if campaign is None else str(campaign.path.resolve()),
        "loops": json.dumps([x.file for x in posterior.loops]),
        "scales": json.dumps(asdict(posterior.problem.scales)),
        "config": json.dumps(posterior.settings.as_dict()),
        "simulator_file": posterior.simulator_file,
        "versions": json.dumps(dict(posterior.versions)),
        "timings": json.dumps(dict(posterior.timings)),
        "convergence": json.dumps([asdict(row) for row in posterior.convergence]),
        "fingerprint": json.dumps(posterior.problem.fingerprint()),
        "point": json.dumps(_plain_point(posterior.point)),
    }


def _plain_point(point: Point) -> dict[str, Any]:
    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        if isinstance(value, GlobalOptimum):  # without its populations
            return {
                k: plain(getattr(value, k))
                for k in (f.name for f in fields(value))
                if k not in ("population", "population_objective")
            }
        return value

    return {f.name: plain(getattr(point, f.name)) for f in fields(point)}


def _point_of(plain: Mapping[str, Any]) -> Point:
    def search(stored: Mapping[str, Any] | None) -> GlobalOptimum | None:
        if stored is None:
            return None
        arrays = {k: np.array(stored[k]) for k in ("x", "best", "median")}
        none = np.empty((0, len(stored["x"])))
        return GlobalOptimum(**{**stored, **arrays}, population=none, population_objective=np.empty(0))

    arrays = {k: np.array(plain[k]) for k in ("goal_z", "z", "optima", "optima_log_prob", "each_z", "each_log_prob")}
    return Point(**{**plain, **arrays, "search": search(plain["search"]), "second": search(plain["second"])})


def load(
    folder: str | os.PathLike[str],
    campaign: str | os.PathLike[str] | None = None,
    simulator: Simulator | str | os.PathLike[str] | None = None,
) -> Posterior:
    """The posterior that :func:`bayes_iwan.identify` wrote.

    The campaign is read again from where it was. Where a simulator of one's own was identified, name it: what a result
    names is data, and is never run.

    Parameters
    ----------
    folder
        what was given as `out`.
    campaign
        its folder, if that has moved.
    simulator
        the model of one's own that was identified, or its Python file (its code is run).

    Returns
    -------
    Posterior
        equal to the one that was written.

    Raises
    ------
    ResultsError
        no result there, a damaged one, or a campaign or version that gives another problem.

    Examples
    --------
    What `bi.identify("data/rope_spring", "runs/rope")` or the command line wrote::

        posterior = bi.load("runs/rope")
        posterior.summary()
    """
    path = Path(folder) / "posterior.nc"
    if not path.is_file():
        raise ResultsError(f"{path}: not found; {folder} is not a folder that `bayes-iwan identify` has finished")
    try:
        stored = _stored(path)
    except ResultsError:
        raise
    except Exception as error:  # whatever HDF5 and its readers make of damaged bytes, and a hostile file of its numbers
        raise ResultsError(f"{path}: damaged ({_line(error)}); identify again") from None
    where = campaign or stored.campaign_path
    if not where:
        raise ResultsError(f"{path}: its loops came from no campaign folder, so it cannot be loaded without them")
    file = stored.fields["simulator_file"]
    if file and simulator is None:
        raise ResultsError(
            f"{path}: was made with the simulator in {file}, a Python file that is not run unasked; name it "
            "(--simulator FILE, or the argument simulator) if you trust it"
        )
    if isinstance(simulator, str | os.PathLike):
        file, simulator = str(Path(simulator).resolve()), load_simulator(simulator)
    source = read_campaign(where)
    every = {x.file: x for x in source.loops(**asdict(stored.fields["settings"].loops))}
    if missing := [name for name in stored.loops if name not in every]:
        raise ResultsError(f"{path}: the campaign {where} no longer has {missing[0]}; name the right campaign")
    loops = tuple(every[name] for name in stored.loops)
    problem = _same_problem(path, loops, stored, simulator)
    if missing := [name for name in problem.names if name not in stored.draws]:
        raise ResultsError(f"{path}: damaged (no draws of {missing[0]}); identify again")
    z = np.stack([stored.draws[name] for name in problem.names], axis=2)
    found = {**stored.fields, "simulator_file": file}
    return Posterior(problem=problem, campaign=source, loops=loops, z=z, log_prob=stored.log_prob, **found)


@dataclass(frozen=True)
class _Stored:
    """What posterior.nc holds: draws by name and log_prob (chains, draws), how to make its problem again, the rest."""

    draws: dict[str, Array]
    log_prob: Array
    campaign_path: str
    loops: tuple[str, ...]
    scales: Scales
    fingerprint: dict[str, str]
    fields: dict[str, Any]


def _stored(path: Path) -> _Stored:
    """A result as it was written. Raises ResultsError, or anything where the bytes are none of ours."""
    stored, draws, log_prob = _read(path)
    if log_prob.ndim != 2 or any(x.shape != log_prob.shape for x in draws.values()):
        raise ResultsError(f"{path}: damaged (draws of several shapes); identify again")
    if not all(np.isfinite(x).all() for x in draws.values()):
        raise ResultsError(f"{path}: damaged (draws that are no numbers); identify again")
    loops, fingerprint = json.loads(stored["loops"]), dict(json.loads(stored["fingerprint"]))
    if not isinstance(loops, list) or not all(isinstance(name, str) for name in loops):
        raise ResultsError(f"{path}: damaged (no list of loops); identify again")
    kept = {
        "settings": settings_of(json.loads(stored["config"])),
        "walkers": int(stored["walkers"]),
        "thin": int(stored["thin"]),
        "point": _point_of(json.loads(stored["point"])),
        "seed": int(stored["seed"]),
        "converged": bool(stored["converged"]),
        "message": str(stored["message"]),
        "stop": Stop[str(stored["stop"])],
        "versions": dict(json.loads(stored["versions"])),
        "timings": dict(json.loads(stored["timings"])),
        "convergence": tuple(ConvergenceRow(**row) for row in json.loads(stored["convergence"])),
        "simulator_file": str(stored.get("simulator_file", "")),
    }
    scales = Scales(**json.loads(stored["scales"]))
    return _Stored(draws, log_prob, str(stored["campaign_path"]), tuple(loops), scales, fingerprint, kept)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Array], Array]:
    """Attributes, draws by name and log_prob of a result, as they were written. Raises ResultsError where not."""
    import xarray as xr

    whole = path.read_bytes()
    if whole[-len(_SEAL) - 32 : -32] != _SEAL:
        raise ResultsError(f"{path}: damaged, or not a result of this version of bayes-iwan; identify again")
    if hashlib.sha256(whole[: -len(_SEAL) - 32]).digest() != whole[-32:]:
        raise ResultsError(f"{path}: damaged (its checksum does not hold); identify again")
    with xr.open_dataset(path, engine="h5netcdf") as root:
        stored = dict(root.attrs)
    if stored.get("format") != FORMAT:
        raise ResultsError(f"{path}: not a result of this version of bayes-iwan; identify again")
    with xr.open_dataset(path, engine="h5netcdf", group="unconstrained_posterior") as group:
        draws = {str(name): group[name].values for name in group.data_vars}
    with xr.open_dataset(path, engine="h5netcdf", group="sample_stats") as group:
        log_prob = group["lp"].values
    return stored, draws, log_prob


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _same_problem(path: Path, loops: tuple[Loop, ...], stored: _Stored, simulator: Simulator | None) -> Problem:
    problem = make_problem(loops, stored.fields["settings"], simulator, stored.scales)
    now = problem.fingerprint()
    for part in now:
        if stored.fingerprint.get(part) != now[part]:
            raise ResultsError(
                f"{path}: its {part} is not what the campaign and this version give now; "
                "identify again, or give the campaign it was made from"
            )
    return problem
