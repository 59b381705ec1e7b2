"""A change of coordinates that straightens a curved posterior: a triangular polynomial map fitted to draws.

Weakly determined parameters leave a posterior that is a thin curved sheet: wide in a few directions, and in the others
thin and bent along with these. In principal axes, widest first, the map takes from each coordinate its regression on
the wide ones before it and divides by a regression of its scatter:

    y_i = (p_i - f_i(p_<i)) / s(h_i(p_<i)),   p = (z - mean)·axes / sd

with f and h polynomials in p/sqrt(1 + (p/3)²) of at most the first `wide` coordinates. The scale s(h) is a rational
function close to exp(h) that needs no exponential, [(1 + h/16)/(1 - h/16)]⁸ with h held within ±3. It is exactly
invertible and its Jacobian is the product of the scales (a Knothe–Rosenblatt map, cf. Parno & Marzouk 2018). In y such
a posterior is close to a round one, which a mixture of a few t distributions fits well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array

KNEE = 3.0  # beyond so many standard deviations the polynomials level off instead of running away
MOST_SPREAD = 3.0  # |h| at most: the scatter may vary by so many e-folds either way
SPREAD_ORDER = 4  # half the power of the rational function that stands for the exponential


@dataclass(frozen=True)
class Warp:
    """z <-> y. shift, spread: the coefficients of f and h, (ndim, features), on the monomials of `wide` variables."""

    mean: Array  # (ndim,)
    axes: Array  # (ndim, ndim), orthonormal columns, widest direction first
    sd: Array  # (ndim,)
    wide: int
    degree: int
    shift: Array
    spread: Array

    @cached_property
    def _plan(self) -> list[list[NDArray[np.int64]]]:
        return monomial_plan(self.wide, self.degree)

    def forward(self, z: Array) -> tuple[Array, Array]:
        """y (n, ndim) and ln|dy/dz| (n,) of z (n, ndim)."""
        p = (((z - self.mean) @ self.axes) / self.sd).T
        features = np.ones((1, len(z)))
        for j in range(self.wide):
            features = _extend(features, self._plan[j], p[j])
        scale = _scale(self.spread @ features)
        y = (p - self.shift @ features) / scale
        return y.T, -np.log(scale).sum(axis=0) - np.log(self.sd).sum()

    def inverse(self, y: Array) -> tuple[Array, Array]:
        """z (n, ndim) and ln|dy/dz| (n,) at it, of y (n, ndim)."""
        y = y.T
        p = np.empty_like(y)
        log_det = np.full(y.shape[1], -np.log(self.sd).sum())
        features = np.ones((1, y.shape[1]))
        for i in [*range(self.wide), slice(self.wide, None)]:
            k = len(features)
            scale = _scale(self.spread[i, :k] @ features)
            p[i] = y[i] * scale + self.shift[i, :k] @ features
            if isinstance(i, slice):
                log_det -= np.log(scale).sum(axis=0)
            else:
                log_det -= np.log(scale)
                features = _extend(features, self._plan[i], p[i])
        return self.mean + (p.T * self.sd) @ self.axes.T, log_det


def fit_warp(z: Array, wide: int, degree: int, weights: Array | None = None, *, ridge: float = 1e-4) -> Warp:
    """The map for draws z (n, ndim) of weights (n,): ridge regressions on monomials of `wide` principal coordinates.

    degree 0 (or wide 0) gives the whitening by principal axes alone. Few draws are held back from wild shapes by a
    ridge that has the weight of two draws.
    """
    n, ndim = z.shape
    total = float(n) if weights is None else float(weights.sum())
    w = np.full(n, 1.0 / n) if weights is None else weights / total
    mean = w @ z
    off = z - mean
    values, axes = np.linalg.eigh((off * w[:, None]).T @ off)
    order = np.argsort(values)[::-1]
    sd = np.sqrt(np.maximum(values[order], 1e-24 * values.max() + 1e-300))
    axes = axes[:, order]
    p = ((off @ axes) / sd).T
    wide = min(wide if degree > 0 else 0, ndim - 1)
    plan = monomial_plan(wide, degree)
    features = np.ones((1, n))
    blocks = [1]  # features known before coordinate i
    low = [0]  # degree of each monomial
    for j in range(wide):
        features = _extend(features, plan[j], p[j])
        for parents in plan[j]:
            low += [low[t] + 1 for t in parents]
        blocks.append(len(features))
    few = np.flatnonzero(np.array(low) <= min(2, degree))  # the logarithm of the scatter is noisy: low degree
    size = np.sqrt(features**2 @ w) + 1e-300
    unit = features / size[:, None]
    weighed = unit * w
    gram = weighed @ unit.T  # one Gram matrix serves all coordinates: earlier ones use its upper left corner
    gram[np.arange(1, len(gram)), np.arange(1, len(gram))] += ridge + 2.0 / total
    right = weighed @ p.T
    calm = gram[np.ix_(few, few)] + 1e-2 * np.diag(np.arange(len(few)) > 0)
    shift = np.zeros((ndim, len(features)))
    spread = np.zeros((ndim, len(features)))
    for i in [*range(wide), slice(wide, None)]:
        k = blocks[i] if isinstance(i, int) else len(features)
        f = np.linalg.solve(gram[:k, :k], right[:k, i].reshape(k, -1)).T
        rest = np.atleast_2d(p[i]) - f @ unit[:k]
        variance = np.maximum(rest**2 @ w, 1e-300)[:, None]
        known = few[few < k]
        log_rest = np.log(rest**2 + 1e-3 * variance)
        h = 0.5 * np.linalg.solve(calm[: len(known), : len(known)], weighed[known] @ log_rest.T).T
        scaled = rest / _scale(h @ unit[known])
        h[:, 0] += 0.5 * np.log(np.maximum(scaled**2 @ w, 1e-300))
        shift[i, :k] = f / size[:k]
        spread[i, known] = h / size[known]
    return Warp(mean, axes, sd, wide, degree, shift, spread)


def monomials(wide: int, degree: int) -> int:
    """How many monomials of at most `degree` there are in `wide` variables."""
    return comb(wide + degree, degree)


def monomial_plan(wide: int, degree: int) -> list[list[NDArray[np.int64]]]:
    """For each coordinate j and power, the earlier monomials that x_j multiplies to give the next ones, in order.

    Monomials are ordered by the last coordinate in them, so those of the first i coordinates come first.
    """
    degrees = [0]
    plan = []
    for _ in range(wide):
        frontier = np.arange(len(degrees))
        steps = []
        for _ in range(degree):
            parents = np.array([t for t in frontier if degrees[t] < degree], dtype=np.int64)
            frontier = np.arange(len(degrees), len(degrees) + len(parents))
            degrees += [degrees[t] + 1 for t in parents]
            steps.append(parents)
        plan.append(steps)
    return plan


def _extend(features: Array, steps: list[NDArray[np.int64]], p: Array) -> Array:
    x = p / np.sqrt(1.0 + (p / KNEE) ** 2)
    for parents in steps:
        features = np.concatenate([features, features[parents] * x])
    return features


def _scale(h: Array) -> Array:
    bounded = h / np.sqrt(1.0 + (h / MOST_SPREAD) ** 2) / (4.0 * SPREAD_ORDER)
    return ((1.0 + bounded) / (1.0 - bounded)) ** (2 * SPREAD_ORDER)
