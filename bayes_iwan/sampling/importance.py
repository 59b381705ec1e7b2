"""Sampling a least-squares posterior by importance: draws are solved for one by one, none is a step from the last.

Proposals come from residual maps (see :mod:`.residual_map`), one for each branch of the posterior, and are weighed by
the ratio of posterior to proposal density. Nothing is adapted, there is no burn-in, and a proposal costs what it costs,
some 150 evaluations; where the maps fit, one in three is worth an independent draw.

Numbers that are held in a map, those of the noise, cost no prediction. They are integrated out by importance sampling
at each proposed place, and one of their draws is kept: the weight is an unbiased estimate, so nothing is approximated
(importance sampling squared: Tran et al. 2013).

Several chains, each with proposals of its own, take the place of the ensembles. A chain is its proposals in the order
in which they came, each as often as its weight says (systematic resampling), so a heavy one is a chain that stands
still, and R-hat, effective sizes and autocorrelation times mean what they always do.

It is tried first and given up (None) where it does not fit: where draws of a pilot are not met, or too few of them, or
of those after it, carry the weight. Whether branches overlap is found by solving for one's draws with the other's map.
One that is all within another is left out; where two overlap in part, each draw is solved for by both, and weighed by
what both propose there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln
from tqdm.auto import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.convergence import convergence_of
from bayes_iwan.sampling.ensembles import BatchFunction, Chains, Stop
from bayes_iwan.sampling.residual_map import ResidualMap, Residuals, Solved

HeldFunction = Callable[[Array, Array], Array]

#: the t distribution in the map's coordinates: degrees of freedom, and its scale over the normal's
_NU, _WIDER = 12.0, 1.03
#: that of the held numbers, and how many of its draws the integral over them takes
_HELD_NU, _HELD_WIDER, _HELD_DRAWS = 6.0, 1.2, 64
_PILOT = 128  # draws of each branch
_LEAST_WORTH = 0.04  # of a pilot's draws, as a share, that its weights are worth
_LEAST_MET = 0.95  # of them that the map must lead to: what is not met is not drawn
_BATCH = 128  # proposals of a chain that are solved for together
_FIRST_CHECK = 256
_GIVE_UP, _GIVE_UP_SHARE = 768, 0.25  # steps at which the least effective size must be this share of its target
_CHECKED = 24  # draws of a branch that another branch's map is asked for
_WITHIN = 0.95  # share of them that are reached if one branch is all within another
_SAME = 1e-2  # places nearer than this are one place
_DEPTH = 12.0  # optima so many nats below the best are left out
_NEGLIGIBLE = 1e-3  # share of the weight


@dataclass(frozen=True)
class Optimum:
    """A maximum z (ndim,) of the posterior, W (k, m) that whitens the residuals there, and the lower triangular root of
    the held numbers' covariance."""

    z: Array
    log_prob: float
    whiten: Array
    held_root: Array


class Branch:
    """One optimum's proposals: their map, the t distribution of its coordinates, and that of the held numbers."""

    def __init__(
        self, residuals: Residuals, held_log_prob: HeldFunction, optimum: Optimum, held: NDArray[np.int64], limit: float
    ) -> None:
        self.map, self.held, self.limit = ResidualMap(residuals, optimum.whiten, optimum.z, held), held, limit
        self.held_log_prob = held_log_prob
        self.held_root = _HELD_WIDER * optimum.held_root

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
        """Proposals z (n, ndim), their log_prob (n,), the logarithms of the posterior with the held numbers integrated
        out (n,), −∞ where there is no such place, and of the proposal's density (n,)."""
        unit = _t_draws(rng, (n, len(self.map.free)), _NU)
        place = self.map.place(_WIDER * unit, self.limit)
        log_g = self._log_density(place)
        there = place.met & np.isfinite(place.log_det)
        z, count = place.z, _HELD_DRAWS if len(self.held) else 1
        unit = _t_draws(rng, (n, count, len(self.held)), _HELD_NU)
        held = self.map.optimum[self.held] + unit @ self.held_root.T
        log_h = _t_log_density(unit, _HELD_NU) - np.log(np.diag(self.held_root)).sum()
        chance = rng.random(n)
        log_p, log_total = np.full(n, -np.inf), np.full(n, -np.inf)
        some = np.flatnonzero(there)
        if len(some):
            level = self.held_log_prob(z[some], held[some])
            log_each = level - log_h[some]
            log_total[some], cumulative = _log_mean_exp(log_each)
            pick = (cumulative < chance[some, None]).sum(axis=1).clip(max=count - 1)
            z[some[:, None], self.held] = held[some, pick]
            log_p[some] = level[np.arange(len(some)), pick]
        return z, log_p, log_total, log_g

    def log_density(self, z: Array) -> Array:
        """ln of the proposal's density (n,) at any places z (n, ndim); −∞ where this branch's map does not lead to."""
        there = self.map.coordinates(z)
        out = np.full(len(z), -np.inf)
        some = np.flatnonzero(there.met & np.isfinite(there.log_det))
        again = self.map.place(there.x[some], self.limit)
        near = again.met & (np.max(np.abs(again.z - there.z[some]), axis=1, initial=0.0) < _SAME)
        out[some[near]] = self._log_density(there)[some[near]]
        return out

    def _log_density(self, place: Solved) -> Array:
        return _t_log_density(place.x / _WIDER, _NU) - len(self.map.free) * np.log(_WIDER) + place.log_det


def _t_draws(rng: np.random.Generator, shape: tuple[int, ...], nu: float) -> Array:
    """Standard t draws over the last axis."""
    unit = rng.standard_normal(shape)
    return unit / np.sqrt(rng.chisquare(nu, shape[:-1]) / nu)[..., None]


def _t_log_density(unit: Array, nu: float) -> Array:
    """(…,) of standard t draws (…, ndim)."""
    ndim = unit.shape[-1]
    norm = gammaln(0.5 * (nu + ndim)) - gammaln(0.5 * nu) - 0.5 * ndim * np.log(nu * np.pi)
    return norm - 0.5 * (nu + ndim) * np.log1p(np.sum(unit * unit, axis=-1) / nu)


def _log_mean_exp(x: Array) -> tuple[Array, Array]:
    """(n,) logarithm of the mean of e^x (n, count), and the terms' shares added up (n, count); −∞ where all are."""
    top = np.max(x, axis=1, keepdims=True)
    part = np.exp(x - np.where(np.isfinite(top), top, 0.0))
    total = part.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (top + np.log(total / x.shape[1]))[:, 0], np.nan_to_num(np.cumsum(part, axis=1) / total, nan=1.0)


class _Source:
    """The branches and their shares: where proposals come from, and what they weigh."""

    def __init__(self, branches: Sequence[Branch]) -> None:
        self.branches = list(branches)
        self.shares = np.full(len(self.branches), 1.0 / len(self.branches))
        self.overlaps: set[tuple[int, int]] = set()  # of two branches, the one of more weight first
        self.heavy: list[float] = []  # logarithm of the weight that few draws of each branch reach

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """z (n, ndim), log_prob (n,) and the logarithm of their weights (n,), −∞ for none."""
        which = rng.choice(len(self.branches), size=n, p=self.shares)
        z, log_p, log_w = np.empty((n, len(self.branches[0].map.optimum))), np.empty(n), np.empty(n)
        for k, branch in enumerate(self.branches):
            rows = np.flatnonzero(which == k)
            if len(rows):
                z[rows], log_p[rows], log_total, log_g = branch.draw(len(rows), rng)
                log_w[rows] = log_total - self._mixture(k, z[rows], log_total, log_g)
        return z, log_p, log_w

    def _mixture(self, k: int, z: Array, log_total: Array, log_g: Array) -> Array:
        """ln of the density (n,) with which any branch proposes draws z (n, ndim) of branch k, its own being log_g.

        Branches that overlap are asked for every draw, the others for those that weigh more than nearly all of the
        pilot did: a draw far out on its own branch may lie in the midst of another.
        """
        there = np.isfinite(log_total)
        out = np.where(there, log_g + np.log(self.shares[k]), 0.0)
        heavy = np.zeros(len(z), bool)
        heavy[there] = log_total[there] - log_g[there] > self.heavy[k]
        for j in range(len(self.branches)):
            if j != k and (asked := there if {(j, k), (k, j)} & self.overlaps else heavy).any():
                other = self.branches[j].log_density(z[asked]) + np.log(self.shares[j])
                out[asked] = np.logaddexp(out[asked], other)
        return out

    def pilot(self, seed: int) -> bool:
        """Leave out branches that are not needed, and share the proposals between the others; False where all this
        does not fit."""
        found = [b.draw(_PILOT, np.random.default_rng([seed, 21, k])) for k, b in enumerate(self.branches)]
        log_w = [
            np.where(np.isfinite(total), total - np.maximum(log_g, -1e300), -np.inf) for _, _, total, log_g in found
        ]
        top = max(float(w.max()) for w in log_w)
        if not np.isfinite(top):
            return False
        weights = [np.exp(w - top) for w in log_w]
        mass = np.array([w.mean() for w in weights])
        kept = [int(k) for k in np.argsort(-mass) if mass[k] > _NEGLIGIBLE * mass.sum()]
        touching = set()
        for k in list(kept):
            for j in kept[: kept.index(k)]:
                some = np.random.default_rng([seed, 22, k]).choice(_PILOT, _CHECKED, p=weights[k] / weights[k].sum())
                share = np.mean(np.isfinite(self.branches[j].log_density(found[k][0][some])))
                if share >= _WITHIN:
                    kept.remove(k)
                    break
                if share > 0.0:
                    touching.add((j, k))
        if min(np.mean(np.isfinite(found[k][2])) for k in kept) < _LEAST_MET:
            return False
        if min(weights[k].sum() ** 2 / np.sum(weights[k] ** 2) for k in kept) < _LEAST_WORTH * _PILOT:
            return False
        self.shares = np.maximum(mass[kept] / mass[kept].sum(), 0.05)
        self.shares /= self.shares.sum()
        self.branches = [self.branches[k] for k in kept]
        self.heavy = [float(np.quantile(log_w[k], 0.95)) for k in kept]
        self.overlaps = {(kept.index(j), kept.index(k)) for j, k in touching if {j, k} <= set(kept)}
        return True

    @property
    def evaluations(self) -> int:
        return sum(b.map.n_evaluations for b in self.branches)


def sample_independently(
    residuals: Residuals,
    held_log_prob: HeldFunction,
    optima: Sequence[Optimum],
    held: NDArray[np.int64],
    *,
    limit: float,
    names: Sequence[str],
    seed: int,
    quantities: BatchFunction | None = None,
    quantity_names: Sequence[str] = (),
    n_chains: int = 4,
    budget_s: float | None = None,
    max_steps: int = 200_000,
    target_r_hat: float = 1.01,
    target_ess: float = 400.0,
    chain_taus: float = 50.0,
    progress: bool = True,
) -> Chains | None:
    """Draw from a posterior until converged or the budget is used up; None where this way does not fit.

    Parameters
    ----------
    residuals : z (n, ndim) → r (n, k). With W of the optimum −½|r W|² − ½|z|² is ln p but for what depends on the held
        numbers alone; the nearer, the better.
    held_log_prob : z (n, ndim), held numbers (n, count, held) → ln p (n, count) of z with these in place of its own.
    optima : maxima of ln p, best first. held : the coordinates that scale the residuals (the noise's).
    limit : z lies within ±limit.
    n_chains and all others : as for :func:`bayes_iwan.sampling.ensembles.sample`; a chain is an ensemble of one walker.

    The same seed gives the same draws. Ctrl-C ends the run with the draws that are there.
    """
    began = time.monotonic()
    names, quantity_names = tuple(names), tuple(quantity_names)
    near = [o for o in optima if o.log_prob > optima[0].log_prob - _DEPTH]
    source = _Source([Branch(residuals, held_log_prob, o, held, limit) for o in near])
    if not source.pilot(seed):
        return None
    rng = np.random.default_rng([seed, 23])
    chains = [_Chain(float(rng.random()), len(names), len(quantity_names)) for _ in range(n_chains)]
    next_check = _FIRST_CHECK
    stop: Stop | None = None
    said, short, result = "", "no draws yet", None
    with tqdm(disable=None if progress else True, unit="step") as bar:
        bar.set_description("sampling")
        try:
            while stop is None:
                count = min(_BATCH, max(max_steps, 8) - chains[0].length)
                fresh = source.draw(n_chains * count, rng)  # solved for together, and dealt out
                named = _evaluated(quantities, fresh[0], len(quantity_names))
                for chain, *new in zip(chains, *(np.split(x, n_chains) for x in (*fresh, named))):
                    chain.append(*new)
                bar.update(count)
                steps = chains[0].length
                late = budget_s is not None and time.monotonic() - began > budget_s
                if steps >= next_check or late or steps >= max_steps:
                    together = np.stack([chain.resampled()[1] for chain in chains])
                    result = convergence_of(together[:, :, None], names + quantity_names)
                    short = result.shortfall(target_r_hat, target_ess, chain_taus)
                    next_check = int(1.15 * steps)
                    bar.set_postfix_str(f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}")
                    if not short:
                        stop, said = Stop.CONVERGED, "converged"
                    elif steps >= _GIVE_UP and result.least_ess < _GIVE_UP_SHARE * target_ess:
                        return None
                    elif steps >= max_steps:
                        stop, said = Stop.STEPS, f"stopped at {max_steps} steps"
                    elif late:
                        stop, said = Stop.BUDGET, f"stopped at the time budget of {budget_s:g} s"
        except KeyboardInterrupt:
            stop, said = Stop.INTERRUPTED, "interrupted"
    kept = [chain.resampled() for chain in chains]
    draws, levels = np.stack([x for _, x in kept]), np.stack([chain.log_prob[i] for chain, (i, _) in zip(chains, kept)])
    if stop is Stop.INTERRUPTED and draws.shape[1] >= 8:
        result = convergence_of(draws[:, :, None], names + quantity_names)
        short = result.shortfall(target_r_hat, target_ess, chain_taus)
    different = [len(np.unique(i)) / max(1, len(i)) for i, _ in kept]
    return Chains(
        names=names,
        quantity_names=quantity_names,
        draws=draws[:, :, None, : len(names)],
        log_prob=levels[:, :, None],
        quantities=draws[:, :, None, len(names) :],
        thin=1,
        n_steps=draws.shape[1],
        n_evaluations=source.evaluations,
        acceptance=float(np.mean(different)),
        convergence=result,
        converged=not short,
        message=said if not short else f"not converged: {said}; {short}",
        stop=stop,
        seed=seed,
        seconds=time.monotonic() - began,
        proposal=None,
    )


class _Chain:
    """Proposals in their order: numbers and quantities (n, …), log_prob and log weight (n,); offset : of resampling."""

    def __init__(self, offset: float, ndim: int, others: int) -> None:
        self.offset = offset
        self.values, self.log_prob, self.log_weight = np.empty((0, ndim + others)), np.empty(0), np.empty(0)

    @property
    def length(self) -> int:
        return len(self.log_prob)

    def append(self, z: Array, log_prob: Array, log_weight: Array, others: Array) -> None:
        self.values = np.concatenate([self.values, np.concatenate([z, others], axis=1)])
        self.log_prob = np.concatenate([self.log_prob, log_prob])
        self.log_weight = np.concatenate([self.log_weight, log_weight])

    def resampled(self) -> tuple[NDArray[np.int64], Array]:
        """Which proposals (n,), each as often as its weight says, in their order, and their values (n, …); none as
        long as none has any weight."""
        top = self.log_weight.max(initial=-np.inf)
        if not np.isfinite(top):
            return np.empty(0, np.int64), self.values[:0]
        share = np.cumsum(np.exp(self.log_weight - top))
        at = (np.arange(self.length) + self.offset) / self.length * share[-1]
        which = np.searchsorted(share, at).astype(np.int64)
        return which, self.values[which]


def _evaluated(quantities: BatchFunction | None, z: Array, count: int) -> Array:
    """(n, count)"""
    return np.empty((len(z), 0)) if quantities is None else np.asarray(quantities(z), dtype=float).reshape(-1, count)
