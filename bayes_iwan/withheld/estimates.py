"""Shares, means and medians over cases, each with a 95 % interval."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from bayes_iwan.arrays import Array

#: times that cases are drawn again behind an interval
RESAMPLED = 2000


@dataclass(frozen=True)
class Estimate:
    """A figure of merit: value and 95 % interval from `n` cases (nan where there are none).

    `count` is how many of `n` for a share, None for a mean or a median.
    """

    value: float
    low: float
    high: float
    n: int
    count: int | None = None

    def text(self) -> str:
        """As a person reads it: `12 of 20: 60 % (36 to 81 %)`, or `0.95 (0.80 to 1.12), n = 20`."""
        if self.n == 0:
            return "no such case"
        if self.count is not None:
            return f"{self.count} of {self.n}: {_pc(self.value)} % ({_pc(self.low)} to {_pc(self.high)} %)"
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f}), n = {self.n}"

    def brief(self) -> str:
        """The value alone, for a narrow column."""
        return f"{_pc(self.value)} %" if self.count is not None else f"{self.value:.2f}"


def _pc(share: float) -> str:
    return f"{100 * share:.0f}"


def share(hits: Sequence[bool]) -> Estimate:
    """A share with its Clopper–Pearson interval."""
    n, k = len(hits), int(sum(hits))
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0, 0)
    low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return Estimate(k / n, low, high, n, k)


def bootstrap(values: Sequence[float], rng: np.random.Generator, statistic: Callable[..., Array] = np.mean) -> Estimate:
    """A mean (or another statistic with an `axis`) with its percentile bootstrap interval over cases."""
    x = np.asarray(values, dtype=float)
    if x.size == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    again = statistic(x[rng.integers(0, x.size, (RESAMPLED, x.size))], axis=1)
    low, high = np.quantile(again, [0.025, 0.975])
    return Estimate(float(statistic(x, axis=0)), float(low), float(high), int(x.size))


def binned(values: Sequence[float], hits: Sequence[bool], edges: Sequence[float]) -> list[tuple[float, Estimate]]:
    """Share of hits in each bin of `values`: (mean of the values in it, share), empty bins omitted."""
    x, h = np.asarray(values, dtype=float), np.asarray(hits, dtype=bool)
    place = np.digitize(x, edges[1:-1])
    return [(float(x[place == i].mean()), share(h[place == i].tolist())) for i in np.unique(place)]


def findable(values: Sequence[float], hits: Sequence[bool], seed: int = 0) -> dict[float, Estimate]:
    """The value (an effect's size) at which half, and 80 %, are found: a logistic curve in its logarithm.

    Returns {0.5: ..., 0.8: ...}, each with a bootstrap interval; nan where that share is not reached within the
    values tried, or where the answers are all alike.
    """
    x, h = np.log(np.asarray(values, dtype=float)), np.asarray(hits, dtype=float)
    targets = (0.5, 0.8)
    nothing = {t: Estimate(np.nan, np.nan, np.nan, int(x.size)) for t in targets}
    if x.size < 10 or h.min() == h.max():
        return nothing

    def fit(rows: NDArray[np.intp]) -> list[float]:
        xr, hr = x[rows], h[rows]

        def cost(p: Array) -> float:  # a weak prior keeps a separable sample finite
            z = p[0] + np.exp(p[1]) * (xr - x.mean())
            return float(np.sum(np.logaddexp(0, z) - hr * z) + 0.05 * p[0] ** 2 + 0.25 * (p[1] - np.log(2)) ** 2)

        p = optimize.minimize(cost, [0.0, np.log(2.0)], method="BFGS").x
        return [float(np.exp(x.mean() + (np.log(t / (1 - t)) - p[0]) / np.exp(p[1]))) for t in targets]

    rng = np.random.default_rng(seed)
    best = fit(np.arange(x.size))
    again = np.array([fit(rng.integers(0, x.size, x.size)) for _ in range(200)])
    low, high = np.quantile(again, [0.025, 0.975], axis=0)
    inside = [np.exp(x.min()) <= b <= np.exp(x.max()) for b in best]
    return {
        t: Estimate(best[i], float(low[i]), float(high[i]), int(x.size)) if inside[i] else nothing[t]
        for i, t in enumerate(targets)
    }
