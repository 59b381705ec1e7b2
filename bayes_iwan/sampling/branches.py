"""Proposals for a least-squares posterior, one distribution for each branch of it, and their weights.

A branch is what its optimum's residual map leads to (see :mod:`.residual_map`). In the map's coordinates the posterior
is nearly standard normal; a pilot of weighed draws says what its mean and covariance there really are, and the
proposals are a t distribution of these. Numbers that are held in a map, those of the noise, cost no prediction: they
are integrated out by importance sampling at each proposed place, and one of their draws is kept. The weight is then an
unbiased estimate, so nothing is approximated (importance sampling squared: Tran et al. 2013).

Whether branches overlap is found by solving for one's draws with the other's map. One that is all within another is
left out; where two overlap in part, each draw is solved for by both, and weighed by what both propose there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import gammaln

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.residual_map import ResidualMap, Residuals, Solved
from bayes_iwan.threads import side_by_side

HeldFunction = Callable[[Array, Array], Array]

#: the t distribution in the map's coordinates: degrees of freedom, and its scale over the posterior's there
_NU, _WIDER = 12.0, 1.05
#: that of the held numbers, and how many of its draws the integral over them takes
_HELD_NU, _HELD_WIDER, _HELD_DRAWS = 6.0, 1.2, 64
_PILOT = 128  # draws of each branch
_LEARN = 640  # further ones of all branches that the proposals learn from, by the branches' shares
_PRIOR_DRAWS = 50.0  # how many draws the map's own standard normal counts for beside them
_LEAST_WORTH = 0.04  # of a pilot's draws, as a share, that its weights are worth
_LEAST_MET = 0.95  # of them that the map must lead to: what is not met is not drawn
_CHECKED = 24  # draws of a branch that another branch's map is asked for
_WITHIN = 0.95  # share of them that are reached if one branch is all within another
_SAME = 1e-2  # places nearer than this are one place
_DEPTH = 12.0  # optima so many nats below the best are left out
_NEGLIGIBLE = 1e-3  # share of the weight
_BLOCK = 128  # proposals that are solved for together, on one thread


@dataclass(frozen=True)
class Optimum:
    """A maximum z (ndim,) of the posterior, W (k, m) that whitens the residuals there, and the lower triangular root of
    the held numbers' covariance."""

    z: Array
    log_prob: float
    whiten: Array
    held_root: Array


@dataclass(frozen=True)
class Drawn:
    """Proposals: z (n, ndim), x (n, free) in the map's coordinates, log_prob (n,), the logarithm of the posterior with
    the held numbers integrated out (n,), −∞ where there is no such place, ln|det ∂x/∂z| (n,)."""

    z: Array
    x: Array
    log_prob: Array
    log_total: Array
    log_det: Array


@dataclass(frozen=True)
class _Chances:
    """Random numbers of n proposals: unit (n, free) and held (n, count, held) t draws, chance (n,)."""

    unit: Array
    held: Array
    chance: Array


class Branch:
    """One optimum's proposals: their map, the t distribution of its coordinates, and that of the held numbers."""

    def __init__(
        self, residuals: Residuals, held_log_prob: HeldFunction, optimum: Optimum, held: NDArray[np.int64], limit: float
    ) -> None:
        self.map, self.held, self.limit = ResidualMap(residuals, optimum.whiten, optimum.z, held), held, limit
        self.held_log_prob = held_log_prob
        self.held_root = _HELD_WIDER * optimum.held_root
        self.centre, self.root = np.zeros(len(self.map.free)), _WIDER * np.eye(len(self.map.free))

    def chances(self, n: int, rng: np.random.Generator) -> _Chances:
        count = _HELD_DRAWS if len(self.held) else 1
        unit, held = _t_draws(rng, (n, len(self.map.free)), _NU), _t_draws(rng, (n, count, len(self.held)), _HELD_NU)
        return _Chances(unit, held, rng.random(n))

    def draw(self, chances: _Chances) -> Drawn:
        """The proposals that these random numbers lead to."""
        place = self.map.place(self.centre + chances.unit @ self.root.T, self.limit)
        there = place.met & np.isfinite(place.log_det)
        z, count = place.z, chances.held.shape[1]
        held = self.map.optimum[self.held] + chances.held @ self.held_root.T
        log_h = _t_log_density(chances.held, _HELD_NU) - np.log(np.diag(self.held_root)).sum()
        log_p, log_total = np.full(len(z), -np.inf), np.full(len(z), -np.inf)
        some = np.flatnonzero(there)
        if len(some):
            level = self.held_log_prob(z[some], held[some])
            log_total[some], cumulative = _log_mean_exp(level - log_h[some])
            pick = (cumulative < chances.chance[some, None]).sum(axis=1).clip(max=count - 1)
            z[some[:, None], self.held] = held[some, pick]
            log_p[some] = level[np.arange(len(some)), pick]
        return Drawn(z, place.x, log_p, log_total, place.log_det)

    def log_density(self, z: Array) -> Array:
        """ln of the proposal's density (n,) at any places z (n, ndim); −∞ where this branch's map does not lead to."""
        there = self.map.coordinates(z)
        out = np.full(len(z), -np.inf)
        some = np.flatnonzero(there.met & np.isfinite(there.log_det))
        again = self.map.place(there.x[some], self.limit)
        near = again.met & (np.max(np.abs(again.z - there.z[some]), axis=1, initial=0.0) < _SAME)
        out[some[near]] = self.log_density_at(there)[some[near]]
        return out

    def log_density_at(self, place: Solved | Drawn) -> Array:
        """The same (n,) where the map's coordinates are known."""
        unit = solve_triangular(self.root, (place.x - self.centre).T, lower=True).T
        return _t_log_density(unit, _NU) - np.log(np.diag(self.root)).sum() + place.log_det

    def learn(self, x: Array, log_weight: Array) -> None:
        """Take mean and covariance in the map's coordinates from weighed draws x (n, free), the standard normal's
        counted in; single heavy weights are cut (Ionides, J. Comp. Graph. Stat. 17, 2008, 295)."""
        weight = np.exp(log_weight - log_weight.max())
        weight = np.minimum(weight, np.sqrt(len(weight)) * weight.mean())
        weight /= weight.sum()
        worth = 1.0 / np.sum(weight**2)
        share = worth / (worth + _PRIOR_DRAWS)
        self.centre = share * (weight @ x)
        apart = x - self.centre
        covariance = share * (apart.T * weight) @ apart + (1.0 - share) * np.eye(x.shape[1])
        self.root = _WIDER * np.linalg.cholesky(covariance)


class Source:
    """The branches and their shares: where proposals come from, and what they weigh."""

    def __init__(self, branches: Sequence[Branch]) -> None:
        self.branches = list(branches)
        self.shares = np.full(len(self.branches), 1.0 / len(self.branches))
        self.kept = np.arange(len(self.branches))
        self.overlaps: set[tuple[int, int]] = set()  # of two branches, the one of more weight first
        self.heavy: list[float] = []  # logarithm of the weight that few draws of each branch reach

    @classmethod
    def of(
        cls,
        residuals: Residuals,
        held_log_prob: HeldFunction,
        optima: Sequence[Optimum],
        held: NDArray[np.int64],
        limit: float,
    ) -> Source:
        """One branch for each optimum that is not too far below the first."""
        near = [o for o in optima if o.log_prob > optima[0].log_prob - _DEPTH]
        return cls([Branch(residuals, held_log_prob, o, held, limit) for o in near])

    @property
    def ndim(self) -> int:
        return len(self.branches[0].map.optimum)

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """z (n, ndim), log_prob (n,) and the logarithm of their weights (n,), −∞ for none."""
        which = rng.choice(len(self.branches), size=n, p=self.shares)
        chances = self.branches[0].chances(n, rng)

        def block(part: slice) -> tuple[Array, Array, Array]:
            rows = np.arange(part.start, part.stop)
            z, log_p, log_w = np.empty((len(rows), self.ndim)), np.empty(len(rows)), np.empty(len(rows))
            for k in range(len(self.branches)):
                own = np.flatnonzero(which[rows] == k)
                if len(own):
                    drawn = self.branches[k].draw(_some(chances, rows[own]))
                    z[own], log_p[own] = drawn.z, drawn.log_prob
                    log_w[own] = drawn.log_total - self._mixture(k, drawn)
            return z, log_p, log_w

        z, log_p, log_w = zip(*side_by_side(block, n, _BLOCK))
        return np.concatenate(z), np.concatenate(log_p), np.concatenate(log_w)

    def _mixture(self, k: int, drawn: Drawn) -> Array:
        """ln of the density (n,) with which any branch proposes draws of branch k.

        Branches that overlap are asked for every draw, the others for those that weigh more than nearly all of the
        pilot did: a draw far out on its own branch may lie in the midst of another.
        """
        there = np.isfinite(drawn.log_total)
        log_g = self.branches[k].log_density_at(drawn)
        out = np.where(there, log_g + np.log(self.shares[k]), 0.0)
        heavy = np.zeros(len(there), bool)
        heavy[there] = drawn.log_total[there] - log_g[there] > self.heavy[k]
        for j in range(len(self.branches)):
            if j != k and (asked := there if {(j, k), (k, j)} & self.overlaps else heavy).any():
                other = self.branches[j].log_density(drawn.z[asked]) + np.log(self.shares[j])
                out[asked] = np.logaddexp(out[asked], other)
        return out

    def _alone(self, k: int, n: int, seed: int, stage: int) -> tuple[Drawn, Array]:
        """n draws of branch k, and the logarithm of their weights (n,) beside the branch's own density."""
        branch = self.branches[k]
        chances = branch.chances(n, np.random.default_rng([seed, stage, k]))
        parts = side_by_side(lambda part: branch.draw(_some(chances, np.arange(part.start, part.stop))), n, _BLOCK)
        fields = ("z", "x", "log_prob", "log_total", "log_det")
        drawn = Drawn(*(np.concatenate([getattr(p, name) for p in parts]) for name in fields))
        return drawn, self._weights(k, drawn)

    def _weights(self, k: int, drawn: Drawn) -> Array:
        there = np.isfinite(drawn.log_total)
        out = np.full(len(there), -np.inf)
        out[there] = drawn.log_total[there] - self.branches[k].log_density_at(drawn)[there]
        return out

    def pilot(self, seed: int) -> bool:
        """Leave out branches that are not needed, share the proposals between the others and let them learn; False
        where all this does not fit."""
        found = [self._alone(k, _PILOT, seed, 21) for k in range(len(self.branches))]
        top = max(float(w.max()) for _, w in found)
        if not np.isfinite(top):
            return False
        weights = [np.exp(w - top) for _, w in found]
        mass = np.array([w.mean() for w in weights])
        kept = [int(k) for k in np.argsort(-mass) if mass[k] > _NEGLIGIBLE * mass.sum()]
        touching = set()
        for k in list(kept):
            for j in kept[: kept.index(k)]:
                some = np.random.default_rng([seed, 22, k]).choice(_PILOT, _CHECKED, p=weights[k] / weights[k].sum())
                share = np.mean(np.isfinite(self.branches[j].log_density(found[k][0].z[some])))
                if share >= _WITHIN:
                    kept.remove(k)
                    break
                if share > 0.0:
                    touching.add((j, k))
        if min(np.mean(np.isfinite(found[k][1])) for k in kept) < _LEAST_MET:
            return False
        if min(weights[k].sum() ** 2 / np.sum(weights[k] ** 2) for k in kept) < _LEAST_WORTH * _PILOT:
            return False
        shares = mass[kept] / mass[kept].sum()
        heavy = []
        for k, share in zip(kept, shares):
            more, log_w = self._alone(k, round(_LEARN * max(share, 0.25)), seed, 24)
            x, log_w = np.concatenate([found[k][0].x, more.x]), np.concatenate([found[k][1], log_w])
            self.branches[k].learn(x[np.isfinite(log_w)], log_w[np.isfinite(log_w)])
            heavy.append(float(np.quantile(self._weights(k, more), 0.95)))
        overlaps = {(kept.index(j), kept.index(k)) for j, k in touching if {j, k} <= set(kept)}
        self._keep(np.array(kept), np.maximum(shares, 0.05), overlaps, heavy)
        return True

    def _keep(self, kept: NDArray[np.int64], shares: Array, overlaps: set[tuple[int, int]], heavy: list[float]) -> None:
        self.branches, self.kept = [self.branches[k] for k in kept], kept
        self.shares, self.overlaps, self.heavy = shares / shares.sum(), overlaps, heavy

    def state(self) -> dict[str, Array]:
        """What a pilot found, for a checkpoint."""
        pairs = np.array(sorted(self.overlaps), dtype=np.int64).reshape(-1, 2)
        return {
            "kept": self.kept,
            "shares": self.shares,
            "overlaps": pairs,
            "heavy": np.array(self.heavy),
            "centre": np.stack([b.centre for b in self.branches]),
            "root": np.stack([b.root for b in self.branches]),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Be as the pilot of an earlier run had left it."""
        overlaps = {(int(j), int(k)) for j, k in state["overlaps"]}
        self._keep(np.asarray(state["kept"], np.int64), state["shares"], overlaps, [float(x) for x in state["heavy"]])
        for branch, centre, root in zip(self.branches, state["centre"], state["root"]):
            branch.centre, branch.root = centre, root

    @property
    def evaluations(self) -> int:
        return sum(b.map.n_evaluations for b in self.branches)


def _some(chances: _Chances, rows: NDArray[np.int64]) -> _Chances:
    return _Chances(chances.unit[rows], chances.held[rows], chances.chance[rows])


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
