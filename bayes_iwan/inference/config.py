"""The configuration file: what a user may change about an identification, and what is wrong with it, in one line.

[loops]            n_phase, n_harmonics, n_blocks: the phase averaging
[model]            slip, grip, stiffness: the parts of bayes_iwan.physics.Model; embedded: may its form bend a little?
[likelihood]       kind: correlated, unweighted, matern, gaussian or laplace
[parameters.NAME]  prior = {dist = "...", ...}, lower, upper, fixed, tied
[search]           the point estimate
[sampling]         the ensembles and when they have converged
"""

from __future__ import annotations

import difflib
import math
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: every key with its default and what it must be; a default of None means "no limit"
DEFAULTS: dict[str, dict[str, Any]] = {
    "loops": {"n_phase": 128, "n_harmonics": 50, "n_blocks": 6},
    "model": {"slip": "gamma3", "grip": "hunt_crossley", "stiffness": "saturating", "embedded": True},
    "likelihood": {"kind": "correlated"},
    "search": {
        "objective": "eq8",  # what the genetic algorithm minimises: eq8, squared or likelihood
        "members": 200,
        "evaluations": 20_000,
        "second_opinion": True,  # differential evolution on the same objective
        "reach": 4.0,  # the search box is ± so many prior standard deviations
        "starts": 12,  # prior draws that least squares starts from, beside the searches' best members
    },
    "sampling": {
        "ensembles": 4,
        "walkers": 40,  # at least; twice the numbers and two where that is more
        "budget_s": 240.0,
        "max_steps": 200_000,
        "r_hat": 1.01,
        "ess": 400.0,
        "taus": 50.0,
        "draws": 8192,  # draws kept in the posterior
    },
}
CHOICES = {("search", "objective"): ("eq8", "squared", "likelihood")}
_POSITIVE_INT = {
    "n_phase",
    "n_harmonics",
    "n_blocks",
    "members",
    "evaluations",
    "starts",
    "ensembles",
    "walkers",
    "max_steps",
    "draws",
}
_POSITIVE = {"reach", "budget_s", "r_hat", "ess", "taus"}


class ConfigError(ValueError):
    """A configuration that cannot be used; the message names the table, the key and the mend."""


def read_config(path: str | os.PathLike[str]) -> dict[str, dict[str, Any]]:
    """The whole configuration, defaults filled in, from a TOML file. Raises ConfigError."""
    try:
        given = tomllib.loads(Path(path).read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None
    return complete(given, str(path))


def complete(given: Mapping[str, Any] | None = None, where: str = "config") -> dict[str, dict[str, Any]]:
    """`given` checked key by key, with the defaults of all it leaves out. Raises ConfigError.

    The tables [parameters.NAME] are passed on as they are: which names there are depends on the model.
    """
    given = dict(given or {})
    _known(given, {*DEFAULTS, "parameters"}, where, "table")
    out = {table: dict(keys) for table, keys in DEFAULTS.items()}
    for table, keys in given.items():
        if not isinstance(keys, Mapping):
            raise ConfigError(f"{where}: {table} must be a table; write [{table}] and its keys below")
        if table == "parameters":
            for name, entry in keys.items():
                if not isinstance(entry, Mapping):
                    raise ConfigError(f"{where}: write [parameters.{name}] and e.g. fixed = {entry!r} below it")
            continue
        _known(keys, set(DEFAULTS[table]), f"{where} [{table}]", "key")
        for key, value in keys.items():
            out[table][key] = _checked(table, key, value, where)
    phases, harmonics = out["loops"]["n_phase"], out["loops"]["n_harmonics"]
    if phases < 2 * harmonics + 2:
        raise ConfigError(
            f"{where} [loops]: {phases} phases cannot show {harmonics} harmonics; make n_phase at least "
            f"{2 * harmonics + 2} or n_harmonics at most {phases // 2 - 1}"
        )
    out["parameters"] = {name: dict(entry) for name, entry in given.get("parameters", {}).items()}
    return out


def _known(table: Mapping[str, Any], known: set[str], where: str, what: str) -> None:
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            mend = f"did you mean {near[0]!r}?" if near else f"use {', '.join(sorted(known))}"
            raise ConfigError(f"{where}: unknown {what} {key!r}; {mend}")


def _checked(table: str, key: str, value: Any, where: str) -> Any:
    name = f"{where} [{table}] {key}"
    if (table, key) in CHOICES and value not in CHOICES[table, key]:
        raise ConfigError(f"{name} = {value!r} is not known; choose one of {', '.join(CHOICES[table, key])}")
    if value is None and DEFAULTS[table][key] is None:
        return None
    if key in _POSITIVE_INT:
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise ConfigError(f"{name} must be a whole number of at least 1, not {value!r}")
    elif key in _POSITIVE:
        if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and value > 0):
            raise ConfigError(f"{name} must be a positive number, not {value!r}")
        return float(value)
    elif isinstance(DEFAULTS[table][key], bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} must be true or false, not {value!r}")
    elif not isinstance(value, str):
        raise ConfigError(f"{name} must be text in quotes, not {value!r}")
    return value
