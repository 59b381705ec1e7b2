"""Which specimens are unusual: every one ranked by a robust distance from the others over all quantities.

Each quantity of each specimen is taken on its population's scale, from the median of all, over their robust spread
(median absolute deviation), its own error counted. The distance allows for quantities that go together. What stands out
is decided by the false discovery rate (Benjamini & Hochberg 1995), not by Bonferroni's bound: of those named, one in
twenty is expected to be named by chance. A spread of few specimens is uncertain, so that no deviation would be far
enough: what the spreads of all quantities have in common lends them degrees of freedom (moderated t: Smyth 2004,
doi:10.2202/1544-6115.1027). What each setting finds is counted by analyses/unusual_specimens.py.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special, stats

from bayes_iwan.arrays import Array
from bayes_iwan.inference.results.population import Population
from bayes_iwan.screen import on_screen

#: share of the named that may be so by chance
FALSE_SHARE = 0.05
#: a robust spread from few specimens is uncertain: median absolute deviations of n have the scatter of about 0.37 n
#: squares (their efficiency for normal values)
_EFFICIENCY = 0.37
#: quantities from which their variances say what they have in common
FEWEST_QUANTITIES = 4


@dataclass(frozen=True, kw_only=True)
@on_screen
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
    score, centre, chance, error = np.full((4, len(names), len(populations)), np.nan)
    for q, p in enumerate(populations.values()):
        rows = [names.index(n) for n in p.names]
        centre[rows, q], error[rows, q] = p.centre, p.error
        score[rows, q], chance[rows, q] = _robust(p.centre, p.error)
    # of two ways to see it: robust scores, from which several unusual specimens cannot hide, and distances from the
    # others' mean, for which few specimens suffice
    out = _discovered(np.minimum(2.0 * np.fmin(chance, _moderated(centre, error)), 1.0))
    distance = _distances(score)
    found = []
    for i, name in enumerate(names):
        scores = {q: float(score[i, k]) for k, q in enumerate(populations) if np.isfinite(score[i, k])}
        notable = tuple(q for k, q in enumerate(populations) if out[i, k])
        found.append(Unusual(name=name, distance=float(distance[i]), scores=scores, notable=notable))
    return tuple(sorted(found, key=lambda x: -x.distance))


def _robust(centre: Array, error: Array) -> tuple[Array, Array]:
    """Robust scores (specimens,) of one quantity, and the chance of one as large in size."""
    n = len(centre)
    away = centre - np.median(centre)
    spread = stats.median_abs_deviation(centre, scale="normal") * n / max(n - 0.8, 1.0)
    between = max(spread**2 - float(np.median(error)) ** 2, 0.0)
    score = away / np.sqrt(np.maximum(between + error**2, 1e-300))
    return score, 2.0 * stats.t.sf(np.abs(score), max(2.0 * _EFFICIENCY * n - 1.0, 1.0))


def _moderated(centre: Array, error: Array) -> Array:
    """Chance (specimens, quantities) of a distance from the others' mean as large as each value's; NaN where there is
    no value. The others' variance is shrunk towards what the variances of all quantities have in common; a specimen
    that is less well known than they are may be so much further off."""
    out = np.full_like(centre, np.nan)
    for i, own in enumerate(centre):
        others = np.delete(centre, i, axis=0)
        n = np.count_nonzero(np.isfinite(others), axis=0)
        free = n - 1.0
        used = np.isfinite(own) & (free >= 1.0)
        if not used.any():
            continue
        some, n, free = others[:, used], n[used], free[used]
        mean, variance = np.nanmean(some, axis=0), np.maximum(np.nanvar(some, axis=0, ddof=1), 1e-300)
        usual, lent = _common_variance(variance, free)
        lent = min(lent, float(free.min()))  # quantities go together, so they lend less than they would alone
        shrunk = (lent * usual + free * variance) / (lent + free)
        usual_error = np.nanmean(np.delete(error, i, axis=0)[:, used] ** 2, axis=0)
        less_known = np.maximum(error[i, used] ** 2 - usual_error, 0.0)
        t = np.abs(own[used] - mean) / np.sqrt(shrunk * (1.0 + 1.0 / n) + less_known)
        out[i, used] = 2.0 * stats.t.sf(t, lent + free)
    return out


def _common_variance(variance: Array, free: Array) -> tuple[float, float]:
    """Scale and degrees of freedom of the scaled inverse chi-squared distribution of which variances (quantities,)
    with so many degrees of freedom are; 0 of them from fewer than FEWEST_QUANTITIES."""
    if variance.size < FEWEST_QUANTITIES:
        return 1.0, 0.0
    logs = np.log(variance) - special.digamma(free / 2.0) + np.log(free / 2.0)
    beyond = float(np.var(logs, ddof=1) - np.mean(special.polygamma(1, free / 2.0)))
    if beyond <= 0.0:
        return float(np.exp(np.mean(logs))), np.inf
    half = float(optimize.brentq(lambda x: float(special.polygamma(1, x)) - beyond, 1e-6, 1e8))
    return float(np.exp(np.mean(logs) + special.digamma(half) - np.log(half))), 2.0 * half


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
