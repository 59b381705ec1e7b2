"""posterior.nc: an identification as groups that ArviZ reads, written whole under a checksum, and read back."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_iwan import former_names
from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.files import seen_from, write_whole
from bayes_iwan.fitting.genetic import GlobalOptimum
from bayes_iwan.inference.results.posterior import ConvergenceRow, Posterior
from bayes_iwan.inference.results.predictions import replicated
from bayes_iwan.inference.setup.config import settings_of
from bayes_iwan.inference.setup.quantities import sampled_and_derived
from bayes_iwan.inference.solving.point import Point
from bayes_iwan.models import Scales
from bayes_iwan.sampling.chains import Stop

if TYPE_CHECKING:
    import xarray

FORMAT = 4
#: what stands behind posterior.nc's own end (HDF5 does not look there), before the SHA-256 of all before it
SEAL = b"bayes_iwan sha256 "
#: groups that are looked at but not gone on from: seven digits are enough
_SHOWN = ("posterior", "prior", "posterior_predictive", "prior_predictive", "log_likelihood")
#: what a posterior says of its run in one value each
PLAIN = {
    "seed": int, "walkers": int, "thin": int, "stretch": float, "converged": bool, "message": str, "simulator_file": str
}  # fmt: skip
PREDICTIVE_DRAWS = 200
POINTWISE_DRAWS = 1000


class ResultsError(InputError):
    """A folder of results that cannot be read back; the message says why."""


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
        xr.Dataset(attrs=_attributes(posterior, path.parent)).dump_to_store(H5NetCDFStore(file, mode="w"))
        for group, dataset in groups(posterior).items():
            few = {"dtype": "f4"} if group in _SHOWN else {}
            packed = {name: {"zlib": True, "complevel": 4, "shuffle": True, **few} for name in dataset.data_vars}
            dataset.dump_to_store(H5NetCDFStore(file, group=group, mode="a"), encoding=packed)
    whole = buffer.getvalue()  # a damaged byte makes HDF5's reader wrong, slow or dead: it shall not see one
    write_whole(path, whole + SEAL + hashlib.sha256(whole).digest())


def groups(posterior: Posterior) -> dict[str, xarray.Dataset]:
    """The groups of posterior.nc by name."""
    import xarray as xr

    problem, loops = posterior.problem, posterior.problem.loops
    chains, draws, _ = posterior.z.shape
    files = [x.file for x in loops]

    def over_draws(variables: Mapping[str, tuple[str, Array]], n_chains: int = chains) -> xarray.Dataset:
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
    again = some_draws(replicated(problem, force, problem.parameter_values(z), rng))
    force = some_draws(force)
    prior_z = problem.prior.draw(rng, 1000)
    few = prior_z[:PREDICTIVE_DRAWS]
    prior_force = problem.predict(few)
    prior_replicated = problem.likelihood.replicate(prior_force, problem.parameter_values(few), rng)[None]
    prior_force = prior_force[None]
    each = np.linspace(0, draws - 1, min(draws, POINTWISE_DRAWS // chains)).round().astype(int)
    point_log = problem.pointwise(posterior.z[:, each].reshape(-1, problem.ndim))

    def of_loops(names: str, *along: str) -> dict[str, tuple[tuple[str, ...], Array]]:
        return {n: (("test", *along), np.array([getattr(x, n) for x in loops], float)) for n in names.split()}

    constant = of_loops("displacement_mm velocity_m_s acceleration_m_s2 force_scatter_N", "phase")
    constant |= of_loops("noise_N", "harmonic") | of_loops("frequency_hz amplitude_mm offset_mm n_cycles")
    harmonics = np.stack([x.harmonics_N for x in loops])
    parts = {"real": harmonics.real, "imag": harmonics.imag}
    observed = {f"harmonics_{part}_N": (("test", "harmonic"), x) for part, x in parts.items()}
    return {
        "posterior": over_draws({n: (q.unit, q.values) for n, q in posterior.quantities().items()}),
        "unconstrained_posterior": over_draws({n: ("-", posterior.z[..., i]) for i, n in enumerate(problem.names)}),
        "sample_stats": over_draws({"lp": ("-", posterior.log_prob)}),
        "prior": over_draws({n: (q.unit, q.values) for n, q in sampled_and_derived(problem, prior_z).items()}, 1),
        "prior_predictive": xr.Dataset({"force_N": (dims, prior_replicated), "model_N": (dims, prior_force)}, at),
        "posterior_predictive": xr.Dataset({"force_N": (dims, again), "model_N": (dims, force)}, {**at, "draw": some}),
        "log_likelihood": xr.Dataset(
            {"data": (("chain", "draw", "datum"), point_log.reshape(chains, len(each), -1))}, {"draw": each}
        ),
        "observed_data": xr.Dataset(of_loops("force_N", "phase") | observed, at),
        "constant_data": xr.Dataset(constant, at),
    }


def to_arviz(posterior: Posterior) -> Any:
    """The groups of posterior.nc as ArviZ's own object: `InferenceData` up to 0.23, xarray's `DataTree` from 1.0."""
    import warnings

    import xarray as xr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 0.23 announces 1.0 at import
        import arviz as az
    by_name = groups(posterior)
    if int(az.__version__.split(".")[0]) >= 1:
        return xr.DataTree.from_dict(by_name)
    return az.InferenceData(**by_name, warn_on_custom_groups=False)


def _attributes(posterior: Posterior, folder: Path) -> dict[str, object]:
    campaign, problem = posterior.campaign, posterior.problem
    plain = {name: getattr(posterior, name) for name in PLAIN} | {"converged": int(posterior.converged)}
    texts = {
        "loops": [x.file for x in posterior.loops],
        "scales": asdict(problem.scales),
        "config": posterior.settings.as_dict(),
        "versions": dict(posterior.versions),
        "timings": dict(posterior.timings),
        "convergence": [asdict(row) for row in posterior.convergence],
        "fingerprint": problem.fingerprint(),
        "point": _plain_point(posterior.point),
    }
    if posterior.simulator_file:
        plain["simulator_file"] = seen_from(folder, posterior.simulator_file)
    where = {"campaign_name": "", "campaign_relative": ""}
    if campaign is not None:
        where = {"campaign_name": campaign.name, "campaign_relative": seen_from(folder, campaign.path)}
    out: dict[str, object] = {"format": FORMAT, "stop": posterior.stop.name, **plain, **where}
    return out | {name: json.dumps(value, default=np.ndarray.tolist) for name, value in texts.items()}


def _plain_point(point: Point) -> dict[str, Any]:
    """A point's fields, without the populations of its searches."""
    plain = asdict(point)
    for search in plain["searches"]:
        del search["first"], search["population"]
    return plain


def _point_of(plain: Mapping[str, Any]) -> Point:
    def search(stored: Mapping[str, Any]) -> GlobalOptimum:
        arrays = {k: np.array(stored[k]) for k in ("x", "best", "median")}
        none = np.empty((0, len(stored["x"])))
        return GlobalOptimum(**{**stored, **arrays}, first=none, population=none)

    arrays = {k: np.array(plain[k]) for k in ("goal_z", "z", "optima", "optima_log_prob", "each_z", "each_log_prob")}
    return Point(**{**plain, **arrays, "searches": tuple(search(x) for x in plain["searches"])})


# ---- read back


@dataclass(frozen=True)
class Stored:
    """What posterior.nc holds: draws by name and log_prob (chains, draws), how to make its problem again, and what
    :class:`bayes_iwan.inference.results.posterior.Posterior` says of a run, by its fields."""

    draws: dict[str, Array]
    log_prob: Array
    campaign: str  # as seen from the folder; of an older one, which names no such place, where it was
    loops: tuple[str, ...]
    scales: Scales
    fingerprint: dict[str, str]
    run: dict[str, Any]


def read_netcdf(path: Path) -> Stored:
    """A result as it was written. Raises ResultsError, or anything where the bytes are none of ours."""
    read, draws, log_prob = _read(path)
    stored: dict[str, Any] = {"stretch": 1.0, "simulator_file": "", "campaign_relative": ""} | read  # of an older one
    if log_prob.ndim != 2 or any(x.shape != log_prob.shape for x in draws.values()):
        raise ResultsError(f"{path}: damaged (draws of several shapes); identify again")
    if not all(np.isfinite(x).all() for x in draws.values()):
        raise ResultsError(f"{path}: damaged (draws that are no numbers); identify again")
    loops = json.loads(stored["loops"])
    fingerprint = {k: former_names.parameters_in(v) for k, v in json.loads(stored["fingerprint"]).items()}
    if not isinstance(loops, list) or not all(isinstance(name, str) for name in loops):
        raise ResultsError(f"{path}: damaged (no list of loops); identify again")
    return Stored(
        draws={former_names.parameters_in(name): x for name, x in draws.items()},
        log_prob=log_prob,
        campaign=str(stored["campaign_relative"] or stored.get("campaign_path", "")),
        loops=tuple(loops),
        scales=Scales(**json.loads(stored["scales"])),
        fingerprint=fingerprint,
        run={
            **{name: kind(stored[name]) for name, kind in PLAIN.items()},
            **{name: dict(json.loads(stored[name])) for name in ("versions", "timings")},
            "settings": settings_of(former_names.config_of(json.loads(stored["config"]))),
            "point": _point_of(json.loads(stored["point"])),
            "stop": Stop[str(stored["stop"])],
            "convergence": tuple(_row(row) for row in json.loads(stored["convergence"])),
        },
    )


def _row(stored: Mapping[str, Any]) -> ConvergenceRow:
    row = ConvergenceRow(**stored)
    return replace(row, name=former_names.parameters_in(row.name))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Array], Array]:
    """Attributes, draws by name and log_prob of a result, as they were written. Raises ResultsError where not."""
    import xarray as xr

    whole = path.read_bytes()
    if whole[-len(SEAL) - 32 : -32] != SEAL:
        raise ResultsError(f"{path}: damaged, or not a result of this version of bayes-iwan; identify again")
    if hashlib.sha256(whole[: -len(SEAL) - 32]).digest() != whole[-32:]:
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
