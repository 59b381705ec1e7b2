"""Where independent proposals come from: the branches of a posterior, their shares, and what a draw weighs.

Whether branches overlap is found by solving for one's draws with the other's map. One that is all within another is
left out; where two overlap in part, each draw is solved for by both, and weighed by what both propose there.

Before anything counts, proposals learn in rounds (adaptive importance sampling: Cappé et al., Stat. Comput. 18, 2008,
447; Cornuet et al. 2012), until a draw is worth enough or the rounds are used up; then they are frozen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.held import HeldFunction, log_mean_exp
from bayes_iwan.sampling.independent.branches import BLOCK, Branch, Drawn, Optimum
from bayes_iwan.sampling.independent.residual_map import Known, Residuals
from bayes_iwan.threads import side_by_side

_DEPTH = 12.0  # optima so many nats below the best are left out
#: draws of each round: of every branch in the first one, then of all of them by their shares, each this share at least
_ROUNDS, _LEAST_LEARNT = (128, 256, 512, 512, 512, 512), 0.1
_GOOD, _LEAST_WORTH = 0.3, 0.02  # what a draw is worth: where rounds end, and where proposals do not fit
_MISSED = 10.0  # nats, and half a nat a number, by which the draws' best may lie below the best optimum
_NEGLIGIBLE = 1e-3  # share of the weight
_LEAST_SHARE = 0.05  # of the proposals, that a branch gets
_CHECKED = 24  # draws of a branch that another branch's map is asked for
_WITHIN = 0.95  # share of them that are reached if one branch is all within another


class Source:
    """The branches and their shares: where proposals come from, and what they weigh."""

    def __init__(self, branches: Sequence[Branch], best: float) -> None:
        self.branches, self.best = list(branches), best  # best: ln p at the best optimum
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
        return cls([Branch(residuals, held_log_prob, o, held, limit) for o in near], optima[0].log_prob)

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
                    drawn = self.branches[k].draw(chances.some(rows[own]))
                    z[own], log_p[own] = drawn.z, drawn.log_prob
                    log_w[own] = drawn.log_total - self._mixture(k, drawn)
            return z, log_p, log_w

        z, log_p, log_w = zip(*side_by_side(block, n, BLOCK))
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

    def pilot(self, seed: int, beside: int = 0) -> bool:
        """Leave out branches that are not needed, share the proposals between the others and let them learn; False
        where all this does not fit. beside : as for :meth:`_apart`."""
        kept, shares = list(range(len(self.branches))), np.ones(len(self.branches))
        touching: set[tuple[int, int]] = set()
        worth = 0.0
        for i, count in enumerate(_ROUNDS):
            log_w = {}
            for k, share in zip(kept, shares):
                n = count if i == 0 else round(count * max(share, _LEAST_LEARNT))
                log_w[k] = self.branches[k].try_round(n, np.random.default_rng([seed, 21, i, k]))
                self.branches[k].learn()
            mass = self._masses(kept)
            if not mass.any():
                return False
            kept = [kept[j] for j in np.argsort(-mass) if mass[j] > _NEGLIGIBLE * mass.sum()]
            if i <= 1:
                kept, touching = self._apart(kept, seed, beside)
            shares, worth = _shared([log_w[k] for k in kept])
            if i >= 2 and worth > _GOOD:
                break
        best = max(self.branches[k].best_tried() for k in kept)
        if worth < _LEAST_WORTH or best < self.best - _MISSED - 0.5 * self.ndim:
            return False
        heavy = [self.branches[k].high_weight() for k in kept]
        for branch in self.branches:
            branch.forget()
        overlaps = {(kept.index(j), kept.index(k)) for j, k in touching if {j, k} <= set(kept)}
        self._keep(np.array(kept), shares, overlaps, heavy)
        return True

    def _masses(self, which: Sequence[int]) -> Array:
        """What posterior the draws of these branches have found (branches,), up to a factor."""
        mass = np.array([log_mean_exp(self.branches[k].tried()[2][None])[0][0] for k in which])
        return np.exp(mass - mass.max()) if np.isfinite(mass).any() else np.zeros(len(which))

    def _apart(self, kept: Sequence[int], seed: int, beside: int) -> tuple[list[int], set[tuple[int, int]]]:
        """The branches that are not all within one before them, and pairs of them that overlap. Those come first whose
        draws are worth most of the whole's: of two that find the same, the one that draws it better.

        A posterior that folds over is reached from either side of its fold, but near it a map proposes hardly anything:
        `beside` branches are kept although they are within another.
        """
        out: list[int] = []
        touching = set()
        worth, spare = {}, beside
        for k in kept:
            log_w = self.branches[k].tried()[2]
            top = log_w.max()
            first, second = (np.mean(np.exp(power * (log_w - top))) for power in (1, 2))
            worth[k] = top + 3.0 * np.log(first) - np.log(second)
        for k in sorted(kept, key=lambda k: -worth[k]):
            z, _, log_w = self.branches[k].tried()
            weight = np.exp(log_w - log_w.max())
            some = np.random.default_rng([seed, 22, k]).choice(len(z), _CHECKED, p=weight / weight.sum())
            reached = {j: float(np.mean(np.isfinite(self.branches[j].log_density(z[some])))) for j in out}
            within = max(reached.values(), default=0.0) >= _WITHIN
            if not within or spare > 0:
                spare -= within
                touching |= {(j, k) for j, share in reached.items() if share > 0.0}
                out.append(k)
        return out, touching

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
        } | {f"{name} {i}": x for i, b in enumerate(self.branches) for name, x in b.map.known.arrays().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Be as the pilot of an earlier run had left it."""
        overlaps = {(int(j), int(k)) for j, k in state["overlaps"]}
        self._keep(np.asarray(state["kept"], np.int64), state["shares"], overlaps, [float(x) for x in state["heavy"]])
        for i, branch in enumerate(self.branches):
            branch.centre, branch.root = state["centre"][i], state["root"][i]
            branch.map.known = Known(**{name: state[f"{name} {i}"] for name in ("z", "x", "slope")})

    @property
    def evaluations(self) -> int:
        return sum(b.map.n_evaluations for b in self.branches)


def _shared(log_w: Sequence[Array]) -> tuple[Array, float]:
    """Of draws of each branch with these weights (n,): the shares that make the most of them, each _LEAST_SHARE at
    least, and what a draw of all is worth then."""
    top = max(float(x.max()) for x in log_w)
    first, second = (np.array([np.mean(np.exp(power * (x - top))) for x in log_w]) for power in (1, 2))
    shares = np.maximum(np.sqrt(second) / np.sqrt(second).sum(), _LEAST_SHARE)
    shares /= shares.sum()
    return shares, float(first.sum() ** 2 / np.sum(second / shares))
