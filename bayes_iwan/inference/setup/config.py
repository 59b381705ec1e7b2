"""The configuration file: what a user may change about a run, and what is wrong with it, in one line.

[loops]            n_phase, n_harmonics, n_blocks: the phase averaging
[model]            slip, normal_force, stiffness: the parts of bayes_iwan.models.Model; embedded: may its laws deviate a
little? [likelihood]       kind: correlated, unweighted, matern, gaussian or laplace
[parameters.NAME]  prior = {dist = "...", ...}, lower, upper, fixed, tied
[search]           the point estimate
[sampling]         how the posterior is sampled, and when it has converged

A table or a parameter that a command would not use is refused, not dropped.
"""

import math
import os
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any, TypeVar

from bayes_iwan import former_names
from bayes_iwan.arguments import path_of, shown
from bayes_iwan.campaign.loops.resolution import POINTS
from bayes_iwan.errors import InputError, nearest, not_utf8
from bayes_iwan.inference.setup.settings import (
    DiagnoseSettings,
    IdentifySettings,
    LikelihoodSettings,
    LoopSettings,
    ModelSettings,
    ParameterChange,
    PriorChoice,
    SamplingSettings,
    SearchSettings,
)

S = TypeVar("S")
_TABLES: dict[str, type[Any]] = {
    "loops": LoopSettings,
    "model": ModelSettings,
    "likelihood": LikelihoodSettings,
    "search": SearchSettings,
    "sampling": SamplingSettings,
}
#: the noise's own parameters, which a diagnosis takes from the records
NOISE = ("noise_scale", "noise_N", "discrepancy_share", "discrepancy_length")
#: a whole number beyond this is a slip of the pen, and more than arrays can hold
_LARGEST = 10**9
#: what any function here takes: a TOML file, its tables, or settings already checked
Config = IdentifySettings | Mapping[str, object] | str | os.PathLike[str] | None


class ConfigError(InputError):
    """A configuration that cannot be used; the message names the table, the key and the fix."""


def settings_of(config: Config = None, unused: Mapping[str, str] | None = None) -> IdentifySettings:
    """The settings of an identification, defaults filled in.

    Parameters
    ----------
    config
        a TOML file, its tables as a mapping, settings already checked, or None.
    unused
        tables that this run would not use, each with the reason: they are refused.

    Returns
    -------
    IdentifySettings
        frozen.

    Raises
    ------
    ConfigError
        one line with file, table, key and the fix.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> bi.settings_of({"sampling": {"budget_s": 60}}).sampling.budget_s
    60.0
    >>> bi.settings_of({"sampling": {"walkrs": 60}})
    Traceback (most recent call last):
        ...
    bayes_iwan.inference.setup.config.ConfigError: config [sampling]: unknown key 'walkrs'; did you mean 'walkers'?
    """
    if isinstance(config, IdentifySettings):
        return config
    given, where = _tables(config)
    _known(given, {*_TABLES, "parameters"}, where, "table")
    for table, reason in (unused or {}).items():
        if table in given:
            raise ConfigError(f"{where}: [{table}] is not used here, {reason}; remove it")
    filled = {table: _filled(kind, table, given, where) for table, kind in _TABLES.items()}
    loops = filled["loops"]
    phases = loops.n_phase or POINTS
    if phases < 2 * loops.n_harmonics + 2:
        raise ConfigError(
            f"{where} [loops]: {phases} phases cannot show {loops.n_harmonics} harmonics; make n_phase at least "
            f"{2 * loops.n_harmonics + 2} or n_harmonics at most {phases // 2 - 1}"
        )
    return IdentifySettings(**filled, parameters=_changes(given, where))


def diagnose_settings_of(config: DiagnoseSettings | Config = None, own_simulator: bool = False) -> DiagnoseSettings:
    """The settings of a diagnosis. Raises ConfigError, also for what a diagnosis does not use."""
    if isinstance(config, DiagnoseSettings):
        return config
    given, where = _tables(config)
    _known(given, {*_TABLES, "parameters"}, where, "table")
    for table in given:
        if table not in ("model", "parameters"):
            raise ConfigError(f"{where}: [{table}] is not used by a diagnosis, which has its own; remove it")
    if own_simulator and "model" in given:
        raise ConfigError(f"{where}: [model] chooses parts of the Iwan model, but a simulator is given; leave one out")
    changes = _changes(given, where)
    for name in NOISE:
        if name in changes:
            raise ConfigError(
                f"{where} [parameters.{name}]: a diagnosis takes noise from the records and the discrepancy from its "
                "own grid; remove it"
            )
    model = _filled(ModelSettings, "model", given, where)
    if model.embedded and "embedded" in given.get("model", {}):
        raise ConfigError(
            f"{where} [model]: embedded = true is not used by a diagnosis, whose effects extend the model instead; "
            "remove it"
        )
    return DiagnoseSettings(model, changes)


def _tables(config: Config) -> tuple[dict[str, Any], str]:
    """The tables given, as they are, and where they came from for messages."""
    if config is None:
        return {}, "config"
    if isinstance(config, IdentifySettings):
        return config.as_dict(), "config"
    if isinstance(config, Mapping):
        return dict(config), "config"
    path = path_of(config, "config", "a TOML file's path, a mapping of its tables, or settings of this command")
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig")), str(config)
    except OSError as error:
        raise ConfigError(f"{config}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{config} {not_utf8(error)}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{config}: not valid TOML: {error}") from None
    except (RecursionError, ValueError) as error:  # nested without end; whole numbers of thousands of digits
        raise ConfigError(f"{config}: not a configuration: {str(error).splitlines()[0]}") from None


def _filled(kind: type[S], table: str, given: Mapping[str, object], where: str) -> S:
    """The settings of one table, every key checked."""
    keys = given.get(table, {})
    if not isinstance(keys, Mapping):
        raise ConfigError(f"{where}: {table} must be a table; write [{table}] and its keys below")
    defaults = {f.name: f.default for f in fields(kind)}  # type: ignore[arg-type]
    _known(keys, set(defaults), f"{where} [{table}]", "key")
    return kind(**{key: _checked(table, key, value, defaults[key], where) for key, value in keys.items()})


def _checked(table: str, key: str, value: object, default: object, where: str) -> bool | float | str | None:
    name = f"{where} [{table}] {key}"
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} must be true or false, not {shown(value)}")
    elif isinstance(default, int) or default is None:
        if value is default:  # what is chosen from the data, in a run's own tables
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= _LARGEST:
            raise ConfigError(f"{name} must be a whole number of at least 1, not {shown(value)}")
    elif isinstance(default, float):
        return _number(value, name, least=0.0)
    elif not isinstance(value, str):
        raise ConfigError(f"{name} must be text in quotes, not {shown(value)}")
    return value


def _changes(given: Mapping[str, object], where: str) -> dict[str, ParameterChange]:
    tables = given.get("parameters", {})
    if not isinstance(tables, Mapping):
        raise ConfigError(f"{where}: parameters must be a table; write [parameters.NAME] and its keys below")
    out = {}
    for name, table in tables.items():
        table = {"prior": table} if hasattr(table, "dist") else table
        if not isinstance(table, Mapping):
            raise ConfigError(f"{where}: write [parameters.{name}] and e.g. fixed = {shown(table)} below it")
        at = f"{where} [parameters.{name}]"
        _known(table, {"prior", "lower", "upper", "fixed", "tied"}, at, "key")
        limits = {k: _number(table[k], f"{at} {k}") for k in ("lower", "upper", "fixed") if k in table}
        tied = table.get("tied")
        if tied is not None and not isinstance(tied, str):
            raise ConfigError(f"{at} tied must be the name of a parameter in quotes, not {shown(tied)}")
        if tied is not None and "fixed" in limits:
            raise ConfigError(f"{at}: fixed and tied exclude each other; leave one out")
        out[str(name)] = ParameterChange(_prior(table.get("prior"), at), tied=tied, **limits)
    return out


def _prior(spec: object, at: str) -> PriorChoice | None:
    if spec is None:
        return None
    if hasattr(spec, "dist"):  # a frozen distribution of scipy.stats, as `Parameter` takes it
        frozen: Any = spec
        shapes = [x.strip() for x in (frozen.dist.shapes or "").split(",") if x.strip()]
        spec = {"dist": frozen.dist.name} | dict(zip((*shapes, "loc", "scale"), frozen.args)) | dict(frozen.kwds)
    if not isinstance(spec, Mapping) or not isinstance(spec.get("dist"), str):
        raise ConfigError(
            f"{at} prior: `dist` must name a continuous scipy.stats distribution, "
            f'e.g. prior = {{dist = "lognorm", s = 0.5, scale = 5.0}}'
        )
    return PriorChoice(spec["dist"], {str(k): _number(v, f"{at} prior {k}") for k, v in spec.items() if k != "dist"})


def _number(value: object, name: str, least: float = -math.inf) -> float:
    if not isinstance(value, bool) and isinstance(value, int | float):
        try:
            if math.isfinite(number := float(value)) and number > least:
                return number
        except OverflowError:
            pass
    kind = "finite" if least < 0.0 else "finite positive"
    raise ConfigError(f"{name} must be a {kind} number, not {shown(value)}")


def _known(table: Mapping[str, object], known: Collection[str], where: str, what: str) -> None:
    for key in table:
        if key not in known:
            if said := former_names.renamed(key, former_names.MODEL_PARTS):
                raise ConfigError(f"{where}: {shown(key)} {said}")
            raise ConfigError(f"{where}: unknown {what} {shown(key)}{nearest(key, sorted(known))}")
