"""One sampled parameter: its name, unit and prior, and the coordinate in which it is sampled.

A parameter's coordinate z is the standard normal score of its prior: x = F⁻¹(Φ(z)), F the prior's distribution
function cut to the parameter's bounds. So whatever the prior, z is unbounded and of order one. For a log-normal prior
z is the scaled logarithm.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.errors import InputError
from bayes_iwan.screen import on_screen

#: z is cut here: Φ(−z) keeps full relative precision far beyond, but no prior is meant that far out
Z_LIMIT = 8.0


class ParameterError(InputError):
    """A parameter, prior or tie that makes no sense; the message names the parameter and the fix."""


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
    def std(self) -> float: ...
    def support(self) -> tuple[float, float]: ...


@dataclass(frozen=True)
@on_screen
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

    def __post_init__(self) -> None:
        if not hasattr(self.prior, "dist"):
            raise ParameterError(
                f"{self.name}: the prior must be a frozen distribution of scipy.stats, such as stats.norm(0.0, 1.0), "
                f"not {self.prior!r:.60}"
            )

    def __repr__(self) -> str:
        return f"Parameter({self.name}: {self.prior_text()}{self.unit and ' '}{self.unit}, {self.description})"

    @property
    def free(self) -> bool:
        """Whether it is sampled."""
        return self.fixed is None and self.tied is None

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Probability below the lower and above the upper bound."""
        return float(self.prior.cdf(self.lower)), float(self.prior.sf(self.upper))

    @cached_property
    def _form(self) -> tuple[str, tuple[float, ...]]:
        """Name and constants of the prior's closed form, ("", ()) where it has none: scipy's own costs ten times as
        much, and a fit asks for values more often than for anything else."""
        name, args, kwargs = self.prior.dist.name, self.prior.args, dict(self.prior.kwds)
        if name in ("norm", "lognorm"):
            given = dict(zip(("loc", "scale") if name == "norm" else ("s", "loc", "scale"), args)) | kwargs
            parts = given.get("loc", 0.0), given.get("scale", 1.0)
            return name, parts if name == "norm" else (*parts, given["s"])
        if name == "uniform":
            return name, self.prior.support()
        if name == "t" and not args and kwargs.get("df") == 2:
            return name, (kwargs.get("loc", 0.0), kwargs.get("scale", 1.0))
        if name == "beta" and not kwargs and len(args) == 2 and args[0] == 1:
            return name, (args[1],)
        return "", ()

    @property
    def normal(self) -> bool:
        """Is it sampled, with a normal prior that is not cut? Then its value is linear in z."""
        return self.free and self._form[0] == "norm" and self._ends == (0.0, 0.0)

    def value(self, z: Array) -> Array:
        """x(z), elementwise."""
        return self.value_within(np.clip(z, -Z_LIMIT, Z_LIMIT))

    def value_within(self, z: Array) -> Array:
        """The same of z that do not leave ±Z_LIMIT."""
        below, above = self._ends
        inside = 1.0 - below - above
        form, c = self._form
        if form in ("norm", "lognorm"):
            score = z if below == 0.0 and above == 0.0 else _score_within(z, below, above, inside)
            return c[0] + c[1] * (score if form == "norm" else np.exp(c[2] * score))
        if form == "uniform":
            return c[0] + (c[1] - c[0]) * (below + special.ndtr(z) * inside)
        high = above + special.ndtr(-z) * inside
        if form == "beta":
            return 1.0 - high ** (1.0 / c[0])
        low = below + special.ndtr(z) * inside
        if form == "t":
            return c[0] + c[1] * (low - high) / np.sqrt(2.0 * low * high)
        return np.where(low < 0.5, self.prior.ppf(np.minimum(low, 0.5)), self.prior.isf(np.minimum(high, 0.5)))

    def score(self, value: Array) -> Array:
        """z(x), the inverse of :meth:`value`, cut at ±Z_LIMIT."""
        below, above = self._ends
        if self._closed:
            return np.clip(self._score(value)[0], -Z_LIMIT, Z_LIMIT)
        inside = 1.0 - below - above
        low = (self.prior.cdf(value) - below) / inside
        high = (self.prior.sf(value) - above) / inside
        z = np.where(low < 0.5, special.ndtri(np.clip(low, 0.0, 1.0)), -special.ndtri(np.clip(high, 0.0, 1.0)))
        return np.clip(z, -Z_LIMIT, Z_LIMIT)

    def log_density(self, value: Array) -> Array:
        """ln p(x) of the prior cut to the bounds."""
        if self._closed:
            z, log_slope = self._score(value)
            with np.errstate(invalid="ignore"):
                return np.where(np.isfinite(z), -0.5 * (z**2 + np.log(2.0 * np.pi)) + log_slope, -np.inf)
        below, above = self._ends
        inside = (value >= self.lower) & (value <= self.upper)
        return np.where(inside, self.prior.logpdf(value) - np.log(1.0 - below - above), -np.inf)

    @property
    def _closed(self) -> bool:
        return self._form[0] in ("norm", "lognorm") and self._ends == (0.0, 0.0)

    def _score(self, value: Array) -> tuple[Array, Array]:
        """z(x), and ln of its derivative, of a normal or log-normal prior that is not cut."""
        form, c = self._form
        if form == "norm":
            return (value - c[0]) / c[1], np.full(np.shape(value), -np.log(c[1]))
        with np.errstate(divide="ignore"):
            logarithm = np.log(np.maximum(value - c[0], 0.0))
        return (logarithm - np.log(c[1])) / c[2], -logarithm - np.log(c[2])

    def prior_text(self) -> str:
        """The prior in words for tables, e.g. 'lognorm(s=0.7, scale=5.2)'."""
        if self.fixed is not None:
            return f"fixed at {self.fixed:g}"
        if self.tied is not None:
            return f"tied to {self.tied}"
        parts = [f"{a:.4g}" for a in self.prior.args] + [f"{k}={v:.4g}" for k, v in self.prior.kwds.items()]
        cut = "" if self._ends == (0.0, 0.0) else f" within [{self.lower:g}, {self.upper:g}]"
        return f"{self.prior.dist.name}({', '.join(parts)}){cut}"


class Together:
    """Values of several parameters at once: those of normal and log-normal priors, which most have, in one go each,
    since a call costs more than its numbers where draws are few."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._each = tuple(parameters)
        forms = [p._form for p in self._each]
        both = np.array([i for i, (form, _) in enumerate(forms) if form in ("norm", "lognorm")], dtype=np.int64)
        self._log = np.array([i for i in both if forms[i][0] == "lognorm"], dtype=np.int64)
        self._others = tuple(i for i in range(len(forms)) if i not in both)
        ends = np.array([p._ends for p in self._each]).reshape(-1, 2)
        self._cut = both[np.any(ends[both] != 0.0, axis=1)]
        below, above = ends[self._cut].T[:, :, None]
        self._ends = below, above, 1.0 - below - above
        self._shift, self._scale = (np.zeros((len(forms), 1)) for _ in range(2))
        for i in both:
            self._shift[i], self._scale[i] = forms[i][1][:2]
        self._sd = np.array([forms[i][1][2] for i in self._log]).reshape(-1, 1)

    def values_within(self, z: Array) -> Array:
        """(parameters, draws), each row by itself in memory, of z (draws, parameters) that do not leave ±Z_LIMIT; the
        same to the bit as :meth:`Parameter.value_within` of each."""
        score = z.T.copy()
        score[self._cut] = _score_within(score[self._cut], *self._ends)
        score[self._log] = np.exp(self._sd * score[self._log])
        out: Array = self._shift + self._scale * score
        for i in self._others:
            out[i] = self._each[i].value_within(z[:, i])
        return out


def _score_within(z: Array, below: Array | float, above: Array | float, inside: Array | float) -> Array:
    """The uncut normal's score that has as much of it below as z has of what is left between the cuts."""
    low = below + special.ndtr(z) * inside
    lower = low < 0.5
    tail = special.ndtri(np.where(lower, low, above + special.ndtr(-z) * inside))
    return np.where(lower, tail, -tail)


def for_distinct(
    law: Callable[[ParameterValues], Array], names: Iterable[str], parameter_values: ParameterValues
) -> Array:
    """law(parameter_values), (draws, …), asked once of draws that agree, to the bit, in all these parameters, which
    are all that it reads."""
    seen: dict[bytes, int] = {}
    rows = np.stack([parameter_values[n] for n in names], axis=1)
    which = [seen.setdefault(row.tobytes(), len(seen)) for row in rows]
    if len(seen) == len(which):
        return law(parameter_values)
    first = np.unique(which, return_index=True)[1]
    return law({n: v[first] for n, v in parameter_values.items()})[which]
