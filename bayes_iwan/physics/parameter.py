"""One sampled parameter: its name, unit and prior, and the coordinate in which it is sampled.

A parameter's coordinate z is the standard normal score of its prior: x = F⁻¹(Φ(z)), F the prior's distribution
function cut to the parameter's bounds. So whatever the prior, z is unbounded and of order one. For a log-normal prior
z is the scaled logarithm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from bayes_iwan.arrays import Array

#: z is cut here: Φ(−z) keeps full relative precision far beyond, but no prior is meant that far out
Z_LIMIT = 8.0


class ParameterError(ValueError):
    """A parameter, prior or tie that makes no sense; the message names the parameter and the mend."""


class _Family(Protocol):
    name: str


class Distribution(Protocol):
    """What is asked of a frozen distribution of scipy.stats."""

    @property
    def dist(self) -> _Family: ...
    @property
    def args(self) -> tuple[float, ...]: ...
    @property
    def kwds(self) -> Mapping[str, float]: ...
    def cdf(self, x: ArrayLike) -> Array: ...
    def sf(self, x: ArrayLike) -> Array: ...
    def ppf(self, q: ArrayLike) -> Array: ...
    def isf(self, q: ArrayLike) -> Array: ...
    def logpdf(self, x: ArrayLike) -> Array: ...
    def support(self) -> tuple[float, float]: ...


@dataclass(frozen=True)
class Parameter:
    """One sampled parameter.

    Parameters
    ----------
    name, symbol, unit, description
        as tables show it.
    prior
        frozen scipy.stats distribution of the value.
    lower, upper
        where it is cut (default: its own support).
    fixed
        the value, where it is not sampled.
    tied
        the parameter whose value it has, where it is tied.
    owner
        name of the effect that brought it; empty for those of simulator and noise.

    Examples
    --------
    >>> import numpy as np, bayes_iwan as bi
    >>> from scipy import stats
    >>> k = bi.Parameter("k_N_mm", "k", "N/mm", "stiffness", stats.lognorm(s=0.5, scale=5.0))
    >>> float(k.value(np.array(0.0))), round(float(k.score(np.array(10.0))), 3)  # the median is z = 0
    (5.0, 1.386)
    """

    name: str
    symbol: str
    unit: str
    description: str
    prior: Distribution
    lower: float = -np.inf
    upper: float = np.inf
    fixed: float | None = None
    tied: str | None = None
    owner: str = ""

    @property
    def free(self) -> bool:
        """Whether it is sampled."""
        return self.fixed is None and self.tied is None

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Probability below the lower and above the upper bound."""
        return float(self.prior.cdf(self.lower)), float(self.prior.sf(self.upper))

    @cached_property
    def _support(self) -> tuple[float, float]:
        return self.prior.support()

    def value(self, z: Array) -> Array:
        """x(z), elementwise."""
        z = np.clip(z, -Z_LIMIT, Z_LIMIT)
        below, above = self._ends
        name, (args, kwargs) = self.prior.dist.name, (self.prior.args, self.prior.kwds)
        if below == 0.0 and above == 0.0:  # closed forms of the commonest priors
            if name == "norm":
                return _norm_parts(args, kwargs)[0] + _norm_parts(args, kwargs)[1] * z
            if name == "lognorm":
                s, loc, scale = _lognorm_parts(args, kwargs)
                return loc + scale * np.exp(s * z)
        low = below + special.ndtr(z) * (1.0 - below - above)
        high = above + special.ndtr(-z) * (1.0 - below - above)
        if name in ("norm", "lognorm"):  # scipy's own ppf costs some ten times as much
            score = np.where(low < 0.5, special.ndtri(low), -special.ndtri(high))
            if name == "norm":
                loc, scale = _norm_parts(args, kwargs)
                return loc + scale * score
            s, loc, scale = _lognorm_parts(args, kwargs)
            return loc + scale * np.exp(s * score)
        if name == "uniform":
            start, end = self._support
            return start + (end - start) * low
        if name == "t" and not args and kwargs.get("df") == 2:
            return kwargs.get("loc", 0.0) + kwargs.get("scale", 1.0) * (low - high) / np.sqrt(2.0 * low * high)
        if name == "beta" and not kwargs and len(args) == 2 and args[0] == 1:
            return 1.0 - high ** (1.0 / args[1])
        return np.where(low < 0.5, self.prior.ppf(np.minimum(low, 0.5)), self.prior.isf(np.minimum(high, 0.5)))

    def score(self, value: Array) -> Array:
        """z(x), the inverse of :meth:`value`, cut at ±Z_LIMIT."""
        below, above = self._ends
        inside = 1.0 - below - above
        low = (self.prior.cdf(value) - below) / inside
        high = (self.prior.sf(value) - above) / inside
        z = np.where(low < 0.5, special.ndtri(np.clip(low, 0.0, 1.0)), -special.ndtri(np.clip(high, 0.0, 1.0)))
        return np.clip(z, -Z_LIMIT, Z_LIMIT)

    def log_density(self, value: Array) -> Array:
        """ln p(x) of the prior cut to the bounds."""
        below, above = self._ends
        inside = (value >= self.lower) & (value <= self.upper)
        return np.where(inside, self.prior.logpdf(value) - np.log(1.0 - below - above), -np.inf)

    def prior_text(self) -> str:
        """The prior in words for tables, e.g. 'lognorm(s=0.7, scale=5.2)'."""
        if self.fixed is not None:
            return f"fixed at {self.fixed:g}"
        if self.tied is not None:
            return f"tied to {self.tied}"
        parts = [f"{a:.4g}" for a in self.prior.args] + [f"{k}={v:.4g}" for k, v in self.prior.kwds.items()]
        cut = "" if self._ends == (0.0, 0.0) else f" within [{self.lower:g}, {self.upper:g}]"
        return f"{self.prior.dist.name}({', '.join(parts)}){cut}"


def _norm_parts(args: tuple, kwargs: Mapping[str, float]) -> tuple[float, float]:
    given = dict(zip(("loc", "scale"), args)) | dict(kwargs)
    return given.get("loc", 0.0), given.get("scale", 1.0)


def _lognorm_parts(args: tuple, kwargs: Mapping[str, float]) -> tuple[float, float, float]:
    given = dict(zip(("s", "loc", "scale"), args)) | dict(kwargs)
    return given["s"], given.get("loc", 0.0), given.get("scale", 1.0)
