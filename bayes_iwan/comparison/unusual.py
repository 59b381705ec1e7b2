"""Which specimens are unusual: every one ranked by a robust distance from the others over all quantities.

Each quantity of each specimen is taken on its population's scale, from the median of all, over their robust spread
(median absolute deviation), its own error counted. The distance allows for quantities that go together. What stands out
is decided by the false discovery rate (Benjamini & Hochberg 1995), not by Bonferroni's bound: of those named, one in
twenty is expected to be named by chance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.inference.results.population import Population

#: share of the named that may be so by chance
FALSE_SHARE = 0.05
#: a robust spread from few specimens is uncertain: median absolute deviations of n have the scatter of about 0.37 n
#: squares (their efficiency for normal values)
_EFFICIENCY = 0.37


@dataclass(frozen=True, kw_only=True)
class Unusual:
    """One specimen. distance : robust, 1 for a usual one; scores : robust standard deviations from the median, by
    quantity; notable : the quantities in which it stands out."""

    name: str
    distance: float
    scores: Mapping[str, float]
    notable: tuple[str, ...]


def rank_unusual(populations: Mapping[str, Population]) -> tuple[Unusual, ...]:
    """Every specimen, the most unusual first."""
    names = list(dict.fromkeys(n for p in populations.values() for n in p.names))
    if not names:
        return ()
    score = np.full((len(names), len(populations)), np.nan)
    chance = np.full_like(score, np.nan)
    for q, p in enumerate(populations.values()):
        rows = [names.index(n) for n in p.names]
        score[rows, q], chance[rows, q] = _scores(p.centre, p.error)
    out = _discovered(chance)
    distance = _distances(score)
    found = [
        Unusual(
            name=name,
            distance=float(distance[i]),
            scores={q: float(score[i, k]) for k, q in enumerate(populations) if np.isfinite(score[i, k])},
            notable=tuple(q for k, q in enumerate(populations) if out[i, k]),
        )
        for i, name in enumerate(names)
    ]
    return tuple(sorted(found, key=lambda x: -x.distance))


def _scores(centre: Array, error: Array) -> tuple[Array, Array]:
    """Robust scores (specimens,) of one quantity, and the chance of one as large.

    The chance is twice the smaller of two: of the robust score, which several unusual specimens cannot hide from, and
    of the distance from the others' mean over their standard deviation, which few specimens suffice for.
    """
    n = len(centre)
    away = centre - np.median(centre)
    spread = stats.median_abs_deviation(centre, scale="normal") * n / max(n - 0.8, 1.0)
    between = max(spread**2 - float(np.median(error)) ** 2, 0.0)
    score = away / np.sqrt(np.maximum(between + error**2, 1e-300))
    robust = stats.t.sf(np.abs(score), max(2.0 * _EFFICIENCY * n - 1.0, 1.0))
    others = (centre.sum() - centre) / (n - 1)
    square = (np.sum(centre**2) - centre**2) / (n - 1) - others**2
    variance = np.maximum(square * (n - 1) / (n - 2), 0.0) + 1e-300
    plain = stats.t.sf(np.abs(centre - others) / np.sqrt(variance * (1.0 + 1.0 / (n - 1))), n - 2)
    return score, np.minimum(4.0 * np.minimum(robust, plain), 1.0)


def _discovered(chance: Array) -> NDArray[np.bool_]:
    """Which of all chances are named at a false discovery rate of FALSE_SHARE."""
    flat = np.sort(chance[np.isfinite(chance)])
    below = np.flatnonzero(flat <= FALSE_SHARE * np.arange(1, len(flat) + 1) / max(len(flat), 1))
    return chance <= (flat[below[-1]] if len(below) else -1.0)


def _distances(score: Array) -> Array:
    """Robust Mahalanobis distance (specimens,), of median one, with scores that are missing omitted."""
    filled = np.where(np.isfinite(score), score, 0.0)
    n, m = filled.shape
    kept = np.clip(filled, -2.5, 2.5)
    sd = np.maximum(np.sqrt(np.mean(kept**2, axis=0)), 1e-9)
    together = (kept / sd).T @ (kept / sd) / n
    alone = m / (m + n)  # shrinks what few specimens say of how quantities go together
    together = (1.0 - alone) * together + alone * np.eye(m)
    square = np.einsum("ij,ij->i", filled, np.linalg.solve(together, filled.T).T)
    usual = np.median(square)
    return np.sqrt(square / usual) if usual > 0.0 else np.sqrt(square)
