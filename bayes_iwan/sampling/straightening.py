"""A map learnt from draws that makes a posterior nearly a standard normal one, for moves to act in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array

#: a proposal as `emcee.moves.MHMove` takes it
Proposal = Callable[[Array, np.random.RandomState], tuple[Array, Array]]
#: draws that a regression's linear coefficients count as beside its data, all at 0: with few draws it stays a mean. The
#: products count as so many more as there are more of them, so that all of them explain no more than the linear ones
_RIDGE = 100.0


@dataclass(frozen=True)
class Straightening:
    """Coordinates x (n, ndim) by blocks: of each the regression on the straight coordinates of the blocks before is
    taken off, and what is left is scaled to unit covariance. With `products` the regression is quadratic: so curved
    sheets become flat, where there are draws, and what lies beyond them may become far from all else. Without, the map
    is linear.

    blocks : places of each block in x; coefficients : (terms, block) of each; roots : lower triangular (block, block).
    The map's Jacobian is the same everywhere, so the Metropolis–Hastings ratio of a proposal in straight coordinates is
    that in x. A triangular map as of Parno & Marzouk, SIAM/ASA J. Uncertain. Quantif. 6 (2018) 645.
    """

    blocks: tuple[NDArray[np.int64], ...]
    coefficients: tuple[Array, ...]
    roots: tuple[Array, ...]
    products: bool = True

    @classmethod
    def fitted(cls, x: Array, blocks: Sequence[NDArray[np.int64]], products: bool = True) -> Straightening:
        """To draws x (n, ndim)."""
        out, u = cls((), (), (), products), np.empty((len(x), 0))
        for places in blocks:
            terms = _terms(u, products)
            count = 0.5 * (u.shape[1] + 1.0)  # products for each linear term
            ridge = _RIDGE * np.repeat([0.0, 1.0, count], [1, u.shape[1], terms.shape[1] - 1 - u.shape[1]])
            b = np.linalg.solve(terms.T @ terms + np.diag(ridge), terms.T @ x[:, places])
            left = x[:, places] - terms @ b
            scale = left.T @ left / len(x)
            root = np.asarray(np.linalg.cholesky(scale + 1e-12 * np.trace(scale) * np.eye(len(places))))
            out = cls((*out.blocks, places), (*out.coefficients, np.asarray(b)), (*out.roots, root), products)
            u = np.concatenate([u, np.linalg.solve(root, left.T).T], axis=1)
        return out

    def straight(self, x: Array) -> Array:
        """Straight coordinates u (n, ndim) of x, each in its place."""
        u, before = np.empty_like(x), np.empty((len(x), 0))
        for places, b, root in zip(self.blocks, self.coefficients, self.roots):
            u[:, places] = np.linalg.solve(root, (x[:, places] - _terms(before, self.products) @ b).T).T
            before = np.concatenate([before, u[:, places]], axis=1)
        return u

    def back(self, u: Array) -> Array:
        """x (n, ndim) of straight coordinates."""
        x, before = np.empty_like(u), np.empty((len(u), 0))
        for places, b, root in zip(self.blocks, self.coefficients, self.roots):
            x[:, places] = _terms(before, self.products) @ b + u[:, places] @ root.T
            before = np.concatenate([before, u[:, places]], axis=1)
        return x


def _terms(u: Array, products: bool) -> Array:
    """1, u and the products of their pairs, or none of these: (n, terms) of u (n, k)."""
    i, j = _pairs(u.shape[1] if products else 0)
    return np.concatenate([np.ones((len(u), 1)), u, u[:, i] * u[:, j]], axis=1)


_pairs = cache(np.triu_indices)


@dataclass(frozen=True)
class Straightened:
    """A proposal that acts in straight coordinates, as one in x."""

    straightening: Straightening
    proposal: Proposal

    def __call__(self, x: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        u, factor = self.proposal(self.straightening.straight(x), random)
        return self.straightening.back(u), factor
