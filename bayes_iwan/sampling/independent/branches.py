"""Proposals for one branch of a least-squares posterior, and how they learn where it lies.

A branch is what its optimum's residual map leads to (see :mod:`.residual_map`). In the map's coordinates the posterior
is nearly standard normal; rounds of weighed draws say what its mean and covariance there really are, and the proposals
are a t distribution of these. Numbers that are held in a map, those of the noise, are integrated out at each proposed
place (see `common.held`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.held import Held, HeldFunction, log_t, t_draws
from bayes_iwan.sampling.independent.residual_map import ResidualMap, Residuals, Solved
from bayes_iwan.threads import side_by_side

#: the t distribution in the map's coordinates: degrees of freedom, and its scale over the posterior's there
_NU, _WIDER = 12.0, 1.05
_HELD_DRAWS = 128  # of the held numbers, that the integral over them takes
_PRIOR_DRAWS = 20.0  # how many draws the map's own standard normal counts for beside those that are learnt from
_KNOWN = 400  # of the places found in the rounds, those that solutions start from
BLOCK = 128  # proposals that are solved for together, on one thread


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
    """Proposals: z (n, ndim), x (n, free) in the map's coordinates, ∂x/∂z (n, free, free), log_prob (n,), the logarithm
    of the posterior with the held numbers integrated out (n,), −∞ where there is no such place, ln|det ∂x/∂z| (n,)."""

    z: Array
    x: Array
    slope: Array
    log_prob: Array
    log_total: Array
    log_det: Array


@dataclass(frozen=True)
class Chances:
    """Random numbers of n proposals: unit (n, free) and held (n, count, held) t draws, chance (n,)."""

    unit: Array
    held: Array
    chance: Array

    def some(self, rows: NDArray[np.int64]) -> Chances:
        """Those of some proposals."""
        return Chances(self.unit[rows], self.held[rows], self.chance[rows])


class Branch:
    """One optimum's proposals: their map, the t distribution of its coordinates, and that of the held numbers."""

    def __init__(
        self, residuals: Residuals, held_log_prob: HeldFunction, optimum: Optimum, held: NDArray[np.int64], limit: float
    ) -> None:
        self.map, self.held, self.limit = ResidualMap(residuals, optimum.whiten, optimum.z, held), held, limit
        self.held_log_prob = held_log_prob
        self.noise = Held(held, optimum.z[held], optimum.held_root, _HELD_DRAWS)
        self.centre, self.root = np.zeros(len(self.map.free)), _WIDER * np.eye(len(self.map.free))
        self._tried: list[_Round] = []

    def chances(self, n: int, rng: np.random.Generator) -> Chances:
        unit, held = t_draws(rng, (n, len(self.map.free)), _NU), self.noise.chances(n, rng)
        return Chances(unit, held, rng.random(n))

    def log_prob(self, z: Array) -> Array:
        """ln of the posterior (n,) at z (n, ndim), held numbers as they are."""
        return self.held_log_prob(z, z[:, None, self.held])[:, 0]

    def draw(self, chances: Chances) -> Drawn:
        """The proposals that these random numbers lead to."""
        place = self.map.place(self.centre + chances.unit @ self.root.T, self.limit)
        there = place.met & np.isfinite(place.log_det)
        z = place.z
        log_p, log_total = np.full(len(z), -np.inf), np.full(len(z), -np.inf)
        some = np.flatnonzero(there)
        if len(some):
            log_total[some], z[some], log_p[some] = self.noise.integrated(
                self.held_log_prob, z[some], chances.held[some], chances.chance[some]
            )
        return Drawn(z, place.x, place.slope, log_p, log_total, place.log_det)

    def log_density(self, z: Array) -> Array:
        """ln of the proposal's density (n,) at any places z (n, ndim); −∞ where this branch's map does not lead to."""
        there = self.map.coordinates(z)
        out = np.full(len(z), -np.inf)
        some = np.flatnonzero(there.met & np.isfinite(there.log_det))
        led = some[self.map.leads_to(there.some(some), self.limit)]
        out[led] = self.log_density_at(there)[led]
        return out

    def log_density_at(self, place: Solved | Drawn) -> Array:
        """The same (n,) where the map's coordinates are known."""
        return log_t(place.x, self.centre, self.root, _NU) + place.log_det

    def log_weight(self, drawn: Drawn) -> Array:
        """Logarithm of the weights (n,) of this branch's own draws beside its own density, −∞ for none."""
        there = np.isfinite(drawn.log_total)
        out = np.full(len(there), -np.inf)
        out[there] = drawn.log_total[there] - self.log_density_at(drawn)[there]
        return out

    def try_round(self, n: int, rng: np.random.Generator) -> Array:
        """Draw n more, to be learnt from; the logarithm of their weights (n,)."""
        chances = self.chances(n, rng)
        parts = side_by_side(lambda part: self.draw(chances.some(np.arange(part.start, part.stop))), n, BLOCK)
        drawn = Drawn(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Drawn)))
        self._tried.append(_Round(drawn, self.centre, self.root))
        return self.log_weight(drawn)

    def tried(self) -> tuple[Array, Array, Array]:
        """z (n, ndim), x (n, free) and the logarithm of the weights (n,), −∞ for none, of all rounds' draws together,
        each beside the mixture of all rounds' proposals (deterministic mixture: Cornuet et al., Scand. J. Stat. 39,
        2012, 798)."""
        z, x, log_total, log_det = (
            np.concatenate([getattr(r.drawn, name) for r in self._tried]) for name in ("z", "x", "log_total", "log_det")
        )
        there = np.isfinite(log_total)
        log_w = np.full(len(x), -np.inf)
        log_w[there] = log_total[there] - log_det[there]
        shares = [len(r.drawn.x) / len(x) for r in self._tried]
        log_g = [np.log(p) + log_t(x[there], r.centre, r.root, _NU) for p, r in zip(shares, self._tried)]
        log_w[there] -= np.logaddexp.reduce(log_g, axis=0)
        return z, x, log_w

    def learn(self) -> None:
        """Take mean and covariance in the map's coordinates from all rounds' draws, the standard normal's counted in;
        single heavy weights are cut (Ionides, J. Comp. Graph. Stat. 17, 2008, 295). Solutions start from the latest
        places from now on."""
        z, x, slope, log_total = (
            np.concatenate([getattr(r.drawn, name) for r in self._tried]) for name in ("z", "x", "slope", "log_total")
        )
        z[:, self.held] = self.map.optimum[self.held]
        met = np.flatnonzero(np.isfinite(log_total))[-_KNOWN:]
        self.map.remember(z[met], x[met], slope[met])
        _, x, log_w = self.tried()
        there = np.isfinite(log_w)
        if not there.any():
            return
        x, weight = x[there], np.exp(log_w[there] - log_w[there].max())
        weight = np.minimum(weight, np.sqrt(len(weight)) * weight.mean())
        weight /= weight.sum()
        worth = 1.0 / np.sum(weight**2)
        share = worth / (worth + _PRIOR_DRAWS)
        self.centre = share * (weight @ x)
        apart = x - self.centre
        covariance = share * (apart.T * weight) @ apart + (1.0 - share) * np.eye(x.shape[1])
        self.root = _WIDER * np.linalg.cholesky(covariance)

    def best_tried(self) -> float:
        """ln p of the best draw."""
        return max(float(r.drawn.log_prob.max()) for r in self._tried)

    def high_weight(self) -> float:
        """Logarithm of the weight that one in twenty draws of the last round reaches beside the present density."""
        return float(np.quantile(self.log_weight(self._tried[-1].drawn), 0.95))

    def forget(self) -> None:
        """Let go of the rounds' draws: the proposals stay as they are."""
        self._tried.clear()


@dataclass(frozen=True)
class _Round:
    """Draws, and the proposals that they came from."""

    drawn: Drawn
    centre: Array
    root: Array
