"""The one place that meets ArviZ, 0.2x (`InferenceData`) and 1.x (`DataTree`) alike.

Everything else of the package takes plain arrays. Chains are our ensembles: each ensemble's walkers, one after the
other along the draws, make one chain, because only ensembles are independent of each other.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayes_iwan.arrays import Array
from bayes_iwan.files import replacing

with warnings.catch_warnings():
    # 0.23 announces 1.0 with a FutureWarning at import; which of the two is there is this module's affair.
    warnings.simplefilter("ignore", FutureWarning)
    import arviz as az

Group = Mapping[str, ArrayLike]

_GROUPS = (
    "posterior",
    "prior",
    "posterior_predictive",
    "prior_predictive",
    "log_likelihood",
    "sample_stats",
    "observed_data",
    "constant_data",
)
_NO_DRAWS = ("observed_data", "constant_data")


class ArvizError(ValueError):
    """Arrays that do not make an inference result, or a file that holds none."""


@dataclass(frozen=True)
class Loo:
    """Leave-one-out cross-validation by Pareto-smoothed importance sampling (Vehtari, Gelman & Gabry 2017).

    elpd is the expected log predictive density with its standard error se; p the effective number of parameters;
    pareto_k (observations,), above 0.7 where the importance weights cannot be trusted; pointwise (observations,).
    """

    elpd: float
    se: float
    p: float
    pareto_k: Array
    pointwise: Array

    @property
    def n_bad(self) -> int:
        """Observations whose Pareto k exceeds 0.7."""
        return int(np.sum(self.pareto_k > 0.7))


def ensembles_as_chains(draws: Array) -> Array:
    """(ensembles, stored, walkers, ...) to (chain, draw, ...): chains are ensembles, in the order of the steps."""
    return draws.reshape(draws.shape[0], draws.shape[1] * draws.shape[2], *draws.shape[3:])


def to_arviz(
    posterior: Group,
    *,
    prior: Group | None = None,
    posterior_predictive: Group | None = None,
    prior_predictive: Group | None = None,
    log_likelihood: Group | None = None,
    sample_stats: Group | None = None,
    observed_data: Group | None = None,
    constant_data: Group | None = None,
    dims: Mapping[str, list[str]] | None = None,
    coords: Mapping[str, ArrayLike] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> Any:
    """ArviZ's own object (`InferenceData` or `DataTree`) of named arrays.

    Arrays with draws are (chain, draw, ...), observed and constant data are as they are. dims names the further
    dimensions of an array, coords their values. attrs (texts and numbers) go with the posterior.
    """
    given = dict(
        posterior=posterior,
        prior=prior,
        posterior_predictive=posterior_predictive,
        prior_predictive=prior_predictive,
        log_likelihood=log_likelihood,
        sample_stats=sample_stats,
        observed_data=observed_data,
        constant_data=constant_data,
    )
    groups = {g: {k: np.asarray(v) for k, v in values.items()} for g, values in given.items() if values}
    if "posterior" not in groups:
        raise ArvizError("the posterior holds no arrays")
    for group, values in groups.items():
        for name, value in values.items():
            if group not in _NO_DRAWS and value.ndim < 2:
                raise ArvizError(f"{group}/{name} has shape {value.shape}; it must be (chain, draw, ...)")
    settings: dict[str, Any] = {"dims": dict(dims or {}), "coords": dict(coords or {})}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about chains longer than draws and the like: shapes were checked above
        named: dict[str, Any] = {**groups, **settings}
        tree = az.from_dict(groups, **settings) if _is_tree() else az.from_dict(**named)
    if attrs:
        tree["posterior"].attrs.update(attrs)
    return tree


def groups_of(tree: Any) -> tuple[str, ...]:
    """The names of the groups that are there."""
    return tuple(g for g in _GROUPS if (g in tree.children if _is_tree() else g in tree.groups()))


def arrays(tree: Any, group: str = "posterior") -> dict[str, Array]:
    """The named arrays of a group."""
    if group not in groups_of(tree):
        raise ArvizError(f"there is no group {group!r}; there are {', '.join(groups_of(tree))}")
    data = tree[group]
    return {str(name): np.asarray(data[name].values) for name in data.data_vars}


def attributes(tree: Any) -> dict[str, Any]:
    """The attributes that `to_arviz` was given, among those that ArviZ adds."""
    return dict(tree["posterior"].attrs)


def save_netcdf(tree: Any, path: Path) -> None:
    """Write to `path`, whole or not at all (:mod:`bayes_iwan.files`), through h5netcdf."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        tree.to_netcdf(str(temporary), engine="h5netcdf")


def load(path: Path) -> Any:
    """What `save_netcdf` wrote, read into memory and the file closed again."""
    path = Path(path)
    if not path.is_file():
        raise ArvizError(f"{path}: there is no such file")
    try:
        if _is_tree():
            import xarray

            with xarray.open_datatree(path, engine="h5netcdf") as opened:
                return opened.load()
        with az.rcparams.rc_context({"data.load": "eager"}):
            return az.from_netcdf(str(path), engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        raise ArvizError(f"{path}: not a result that can be read ({error})") from None


def summary(tree: Any, names: list[str] | None = None) -> dict[str, dict[str, float]]:
    """ArviZ's own R-hat and effective sample sizes by variable (the worst entry of an array): a check on ours."""
    posterior = arrays(tree)
    out = {}
    for name in names or list(posterior):
        x = posterior[name]
        columns = np.moveaxis(x.reshape(*x.shape[:2], -1), 2, 0)
        out[name] = {
            "r_hat": max(_scalar(az.rhat(c)) for c in columns),
            "ess_bulk": min(_scalar(az.ess(c, method="bulk")) for c in columns),
            "ess_tail": min(_scalar(az.ess(c, method="tail", prob=(0.05, 0.95))) for c in columns),
        }
    return out


def loo(tree: Any, variable: str | None = None) -> Loo:
    """PSIS-LOO of a variable of the log_likelihood group, one observation an entry of its further dimensions."""
    if "log_likelihood" not in groups_of(tree):
        raise ArvizError("the result holds no pointwise log-likelihood, which leave-one-out needs")
    result = _loo(tree, variable)
    k = np.asarray(getattr(result, "pareto_k"), dtype=float).ravel()  # noqa: B009 - names differ by version
    elpd = result.elpd if hasattr(result, "elpd") else result.elpd_loo
    p = result.p if hasattr(result, "p") else result.p_loo
    pointwise = result.elpd_i if hasattr(result, "elpd_i") else result.loo_i
    return Loo(float(elpd), float(result.se), float(p), k, np.asarray(pointwise, dtype=float).ravel())


def compare(trees: Mapping[str, Any], variable: str | None = None) -> list[dict[str, Any]]:
    """Models from best to worst by PSIS-LOO: name, elpd, se, p, and the difference to the best with its own se.

    The difference's standard error is of the pointwise differences: models that err alike are told apart by less
    than their own errors. All must have been fitted to the same observations.
    """
    found = {name: loo(tree, variable) for name, tree in trees.items()}
    if len({x.pointwise.shape for x in found.values()}) > 1:
        raise ArvizError("the models were fitted to different observations and cannot be compared")
    order = sorted(found, key=lambda name: -found[name].elpd)
    best = found[order[0]]
    rows = []
    for name in order:
        own = found[name]
        difference = own.pointwise - best.pointwise
        rows.append(
            {
                "name": name,
                "elpd": own.elpd,
                "se": own.se,
                "p": own.p,
                "elpd_difference": float(difference.sum()),
                "se_difference": float(np.sqrt(len(difference) * difference.var())),
                "n_bad_k": own.n_bad,
            }
        )
    return rows


def _is_tree() -> bool:
    return int(az.__version__.split(".")[0]) >= 1


def _loo(tree: Any, variable: str | None) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # high Pareto k is in the result, for the caller to report
        return az.loo(tree, pointwise=True, var_name=variable)


def _scalar(value: Any) -> float:
    return float(np.asarray(value).ravel()[0])
