"""The joint prior of named parameters, and what a configuration changes of it.

A parameter's coordinate z is the standard normal score of its prior: x = F⁻¹(Φ(z)), F the prior's distribution
function cut to the parameter's bounds. So whatever the prior, z is unbounded, of order one, and the prior's density
over z is the standard normal: the Jacobian of the map is part of it exactly. For a log-normal prior z is the scaled
logarithm. Least squares sees the prior as rows of residuals, z itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats

from bayes_iwan import former_names
from bayes_iwan.arrays import Array
from bayes_iwan.errors import nearest
from bayes_iwan.inference.setup.settings import ParameterChange, PriorChoice
from bayes_iwan.models.parameter import Z_LIMIT, Distribution, Parameter, ParameterError, Together
from bayes_iwan.screen import Listed, on_screen


@dataclass(frozen=True)
@on_screen
class Prior:
    """The joint prior: independent over the parameters, standard normal over the free coordinates z (draws, free)."""

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        names = [p.name for p in self.parameters]
        if len(set(names)) != len(names):
            raise ParameterError(f"parameter names repeat: {sorted(n for n in names if names.count(n) > 1)}")
        for p in self.parameters:
            if p.tied is not None and (p.tied not in names or not self[p.tied].free):
                raise ParameterError(
                    f"{p.name} is tied to {p.tied!r}, which is not a free parameter{nearest(p.tied, self.names)}"
                )

    def __getitem__(self, name: str) -> Parameter:
        return next(p for p in self.parameters if p.name == name)

    @cached_property
    def free(self) -> tuple[Parameter, ...]:
        return Listed(p for p in self.parameters if p.free)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of z's columns."""
        return Listed(p.name for p in self.free)

    @cached_property
    def _together(self) -> Together:
        return Together(self.free)

    def values(self, z: Array) -> dict[str, Array]:
        """Every parameter's value (draws,) by name, fixed and tied ones included; z (draws, free)."""
        z = np.clip(np.atleast_2d(z), -Z_LIMIT, Z_LIMIT)
        out = dict(zip(self.names, self._together.values_within(z)))
        for p in self.parameters:
            if p.fixed is not None:
                out[p.name] = np.full(len(z), p.fixed)
        for p in self.parameters:
            if p.tied is not None:
                out[p.name] = out[p.tied]
        return out

    def scores(self, values: Mapping[str, Array]) -> Array:
        """z (draws, free) from values by name."""
        return np.stack([p.score(np.atleast_1d(np.asarray(values[p.name], float))) for p in self.free], axis=1)

    def log_density(self, z: Array) -> Array:
        """ln p(z), (draws,): −∞ beyond ±Z_LIMIT."""
        z = np.atleast_2d(z)
        out = -0.5 * np.sum(z * z, axis=1) - 0.5 * z.shape[1] * np.log(2.0 * np.pi)
        return np.where(np.all(np.abs(z) <= Z_LIMIT, axis=1), out, -np.inf)

    def draw(self, rng: np.random.Generator, draws: int) -> Array:
        """z (draws, free) from the prior."""
        return np.clip(rng.standard_normal((draws, len(self.free))), -Z_LIMIT, Z_LIMIT)


def configured(parameters: Sequence[Parameter], changes: Mapping[str, ParameterChange]) -> tuple[Parameter, ...]:
    """Parameters with a user's changes by name. Raises ParameterError naming the parameter and what is wrong."""
    by_name = {p.name: p for p in Prior(tuple(parameters)).parameters}  # which refuses names that repeat
    for name, change in changes.items():
        if name not in by_name:
            if said := former_names.renamed(name, former_names.PARAMETERS):
                raise ParameterError(f"[parameters.{name}]: {name} {said}")
            raise ParameterError(f"[parameters.{name}]: no such parameter{nearest(name, by_name)}")
        new = by_name[name]
        if change.prior is not None:
            new = replace(new, prior=_frozen(name, change.prior), lower=-np.inf, upper=np.inf)
        new = replace(
            new,
            lower=new.lower if change.lower is None else change.lower,
            upper=new.upper if change.upper is None else change.upper,
            fixed=change.fixed,
            tied=change.tied,
        )
        if new.free and not new.prior.cdf(new.upper) - new.prior.cdf(new.lower) > 1e-12:
            raise ParameterError(f"[parameters.{name}]: the prior has no weight within [{new.lower:g}, {new.upper:g}]")
        if new.fixed is not None and not new.lower <= new.fixed <= new.upper:
            raise ParameterError(
                f"[parameters.{name}]: fixed = {new.fixed:g} lies outside [{new.lower:g}, {new.upper:g}]; "
                "choose a value within, or move lower and upper"
            )
        by_name[name] = new
    return tuple(by_name.values())


def _frozen(name: str, choice: PriorChoice) -> Distribution:
    dist = getattr(stats, choice.dist, None)
    if not isinstance(dist, stats.rv_continuous):
        known = [n for n in dir(stats) if isinstance(getattr(stats, n), stats.rv_continuous)]
        example = ', e.g. prior = {dist = "lognorm", s = 0.5, scale = 5.0}'
        raise ParameterError(
            f"[parameters.{name}] prior: {choice.dist!r} is no continuous distribution of scipy.stats"
            + nearest(choice.dist, known, example)
        )
    takes = [*(x.strip() for x in (dist.shapes or "").split(",") if x.strip()), "loc", "scale"]
    for argument in choice.arguments:
        if argument not in takes:
            raise ParameterError(
                f"[parameters.{name}] prior {choice.dist}: it takes no {argument!r}{nearest(argument, takes)}"
            )
    try:
        frozen = dist(**choice.arguments)
        if not np.isfinite(frozen.ppf(0.5)):
            raise ValueError("its median is not finite")
    except (TypeError, ValueError) as error:
        raise ParameterError(f"[parameters.{name}] prior {choice.dist}: {error}") from None
    return frozen
