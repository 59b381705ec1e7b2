"""Proposals learnt from draws of a warm-up, for emcee's Metropolis–Hastings move.

For any user of emcee who has draws of a posterior, x (n, ndim), however few: each of these is a function that
`emcee.moves.MHMove` takes, so that walkers stay independent of each other::

    moves = [(MHMove(Differences(x)), 0.6), (MHMove(Snooker(x)), 0.4)]
    sampler = emcee.EnsembleSampler(n_walkers, ndim, log_prob, moves=moves)

or all of them, in coordinates in which the draws are nearly standard normal: :func:`learnt_moves`.

They return new places and the logarithm of q(back) / q(forth), by which a step is accepted together with the ratio of
the posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from emcee.moves import MHMove
from numpy.typing import NDArray
from scipy.special import gammaln

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.straightening import Proposal, Straightened, Straightening

#: degrees of freedom of the mixture: tails heavier than the posterior's keep a walker from being stuck in them
_NU = 12.0
#: steps of expectation and maximisation, and draws that the whole covariance counts as in each component's: of few
#: draws in many dimensions its own is too narrow somewhere
_STEPS, _WHOLE = 25, 60.0
#: lengths of steps along a difference over the usual one, at least; steps along the whole difference, which lead from
#: mode to mode, have a share of their own
_SHORTEST, _WHOLE_STEPS = 0.1, 0.1
#: shares of the coordinates that a difference moves, each as often
_MOVED = 1 / 3, 2 / 3, 1.0
_SNOOKER = 1.7  # factor of the projected difference
#: components of each block's mixture
COMPONENTS = 8
#: of steps that are independent proposals of all coordinates, of one block, along differences, and snooker's
_SHARES = 0.4, 0.2, 0.2, 0.2


@dataclass(frozen=True)
class Differences:
    """Steps along the difference of two known draws (n, ndim): differential evolution with a frozen archive (ter Braak
    & Vrugt, Stat. Comput. 18, 2008, 435), of many lengths and in some of the coordinates (Vrugt et al., Int. J.
    Nonlinear Sci. Numer. Simul. 10, 2009, 273), which serves curved posteriors."""

    known: Array

    def __call__(self, x: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        n, ndim = x.shape
        first, second = _two(len(self.known), n, random)
        moved = random.random_sample((n, ndim)) < np.asarray(_MOVED)[random.randint(len(_MOVED), size=n), None]
        moved[np.arange(n), random.randint(ndim, size=n)] = True
        length = 2.38 / np.sqrt(2.0 * moved.sum(axis=1)) * np.exp(np.log(_SHORTEST) * random.random_sample(n))
        length = np.where(random.random_sample(n) < _WHOLE_STEPS, 1.0, length)
        return x + length[:, None] * moved * (self.known[first] - self.known[second]), np.zeros(n)


@dataclass(frozen=True)
class Snooker:
    """Steps along the line to a known draw, by the projected difference of two more (the same paper).

    `emcee.moves.DESnookerMove` of 3.1.6 divides by the root of the line's length and halves the exponent, so that a
    unit normal of 16 dimensions comes out with a variance of 0.57; this one is right.
    """

    known: Array

    def __call__(self, x: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        n, ndim = x.shape
        at = self.known[random.randint(len(self.known), size=n)]
        first, second = _two(len(self.known), n, random)
        length = np.linalg.norm(x - at, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):  # a walker that stands at that draw has no line
            unit = (x - at) / length[:, None]
            step = _SNOOKER * np.sum(unit * (self.known[first] - self.known[second]), axis=1)
            new = x + step[:, None] * unit
            factor = (ndim - 1.0) * (np.log(np.linalg.norm(new - at, axis=1)) - np.log(length))
        still = ~np.isfinite(factor)
        new[still], factor[still] = x[still], 0.0
        return new, factor


def _two(of: int, n: int, random: np.random.RandomState) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Two different numbers below `of`, n times."""
    first = np.asarray(random.randint(of, size=n), np.int64)
    return first, (first + random.randint(1, of, size=n)) % of


@dataclass(frozen=True)
class Mixture:
    """Independent proposals from a mixture of t distributions: weights (k,), centres (k, ndim), lower triangular roots
    (k, ndim, ndim) of their scales and the inverse roots (Tierney, Ann. Stat. 22, 1994, 1701)."""

    weights: Array
    centres: Array
    roots: Array
    inverse: Array

    @classmethod
    def of(cls, weights: Array, centres: Array, roots: Array) -> Mixture:
        return cls(weights, centres, roots, np.asarray(np.linalg.inv(roots)))

    @classmethod
    def fitted(cls, x: Array, components: int, random: np.random.RandomState) -> Mixture:
        """To draws x (n, ndim), by expectation and maximisation of a normal mixture (Dempster, Laird & Rubin, J. R.
        Stat. Soc. B 39, 1977, 1)."""
        n, ndim = x.shape
        whole = np.cov(x.T).reshape(ndim, ndim)
        root = np.linalg.cholesky(whole + 1e-12 * np.trace(whole) / ndim * np.eye(ndim))
        unit = np.linalg.solve(root, (x - x.mean(axis=0)).T).T
        weights, centres = np.full(components, 1.0 / components), unit[random.choice(n, components, replace=False)]
        scales = np.tile(np.eye(ndim), (components, 1, 1))
        for _ in range(_STEPS):
            now = cls.of(weights, centres, np.asarray(np.linalg.cholesky(scales)))
            level = now.log_terms(unit, np.inf)
            share = np.exp(level - np.logaddexp.reduce(level, axis=1, keepdims=True))
            count = share.sum(axis=0) + 1e-9
            weights, centres = count / count.sum(), share.T @ unit / count[:, None]
            for k in range(components):
                apart = unit - centres[k]
                scales[k] = ((apart.T * share[:, k]) @ apart + _WHOLE * np.eye(ndim)) / (count[k] + _WHOLE)
        return cls.of(weights, x.mean(axis=0) + centres @ root.T, root @ np.linalg.cholesky(scales))

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """(n, ndim)"""
        which = random.choice(len(self.weights), size=n, p=self.weights)
        unit = random.standard_normal((n, self.centres.shape[1])) / np.sqrt(random.chisquare(_NU, n) / _NU)[:, None]
        return np.asarray(self.centres[which] + np.einsum("nij,nj->ni", self.roots[which], unit))

    def log_density(self, x: Array) -> Array:
        """(n,) at x (n, ndim)."""
        return np.asarray(np.logaddexp.reduce(self.log_terms(x, _NU), axis=1))

    def log_terms(self, x: Array, nu: float) -> Array:
        """ln of each component's part (n, k) of the density at x (n, ndim); nu infinite: normal."""
        ndim = x.shape[1]
        unit = (x[None] - self.centres[:, None]) @ self.inverse.transpose(0, 2, 1)
        square = np.einsum("knd,knd->nk", unit, unit)
        level = np.log(self.weights) + np.sum(np.log(np.diagonal(self.inverse, axis1=1, axis2=2)), axis=1)
        if np.isinf(nu):
            return np.asarray(level - 0.5 * ndim * np.log(2.0 * np.pi) - 0.5 * square)
        norm = gammaln(0.5 * (nu + ndim)) - gammaln(0.5 * nu) - 0.5 * ndim * np.log(nu * np.pi)
        return np.asarray(level + norm - 0.5 * (nu + ndim) * np.log1p(square / nu))


@dataclass(frozen=True)
class Independent:
    """Independent proposals for some coordinates: each mixture for those in its places."""

    parts: Sequence[tuple[NDArray[np.int64], Mixture]]

    def __call__(self, x: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        new, factor = x.copy(), np.zeros(len(x))
        for places, mixture in self.parts:
            new[:, places] = mixture.draw(len(x), random)
            factor += mixture.log_density(x[:, places]) - mixture.log_density(new[:, places])
        return new, factor


def learnt_moves(
    x: Array, blocks: Sequence[NDArray[np.int64]], random: np.random.RandomState
) -> list[tuple[MHMove, float]]:
    """Moves with their weights from draws x (n, ndim): independent proposals of all coordinates and of each block,
    steps along differences and snooker's; all of them in linear coordinates, and all of them in straight ones. Straight
    ones follow curved sheets, but only as far as the draws reach: by them alone, parts of a posterior that few walkers
    have been in yet are hardly ever proposed (time to convergence: `analyses/guide/measured.md`).

    blocks : places of the coordinates, those first that others follow, each in one of them.
    """
    out = []
    for products in (False, True):
        straightening = Straightening.fitted(x, blocks, products)
        u = straightening.straight(x)
        parts = [(p, Mixture.fitted(u[:, p], COMPONENTS, random)) for p in blocks]
        proposals: list[tuple[Proposal, float]] = [(Independent(parts), _SHARES[0])]
        proposals += [(Independent([part]), _SHARES[1] / len(parts)) for part in parts]
        proposals += [(Differences(u), _SHARES[2]), (Snooker(u), _SHARES[3])]
        out += [(MHMove(Straightened(straightening, p)), 0.5 * share) for p, share in proposals]
    return out
