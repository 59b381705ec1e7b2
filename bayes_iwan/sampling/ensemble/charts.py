"""Compiled evaluation of many charts at many points: what a step of the sampler needs of a proposal.

The same map as `warp.Warp` followed by the standardising of a t distribution, for all charts in one pass over the
points: some 0.5 µs a chart and point, where numpy needs a hundred small calls. `warp.py` is the reference.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.ensemble.warp import KNEE, MOST_SPREAD, SPREAD_ORDER, Warp, monomial_plan
from bayes_iwan.threads import over_draws

BLOCK = 32  # points that are worked on together


class ChartStack:
    """The numbers of several warps and their t distributions in arrays of equal shape, lower degrees filled with 0."""

    def __init__(self, warps: tuple[Warp, ...], centres: Array, roots: Array) -> None:
        self.wide = max(w.wide for w in warps)
        degree = max(w.degree if w.wide else 0 for w in warps)
        ndim = len(warps[0].mean)
        plan = monomial_plan(self.wide, degree)
        parents = [np.concatenate(steps) if steps else np.empty(0, np.int64) for steps in plan]
        self.parent = np.concatenate([np.zeros(1, np.int64), *parents]).astype(np.int64)
        self.known = np.cumsum([1, *(len(p) for p in parents)]).astype(np.int64)  # monomials of the first i numbers
        keys = _exponents(self.wide, plan)
        place = {key: t for t, key in enumerate(keys)}
        shape = (len(warps), len(keys), ndim)
        self.shift, self.spread = np.zeros(shape), np.zeros(shape)
        for b, w in enumerate(warps):
            keys = _exponents(w.wide, monomial_plan(w.wide, w.degree))
            own = [place[key + (0,) * (self.wide - w.wide)] for key in keys]
            self.shift[b, own], self.spread[b, own] = w.shift.T, w.spread.T
        used = np.flatnonzero((self.spread != 0).any(axis=(0, 2)))
        self.spread_used = used.astype(np.int64)  # the scatter's polynomials are of low degree: skip their zeros
        self.mean = np.stack([w.mean for w in warps])
        self.whiten = np.stack([w.axes / w.sd for w in warps])
        self.colour = np.stack([(w.axes * w.sd).T for w in warps])
        self.log_sd = np.array([np.log(w.sd).sum() for w in warps])
        self.centre, self.root = np.ascontiguousarray(centres), np.ascontiguousarray(roots)
        self.unroot_t = np.ascontiguousarray(np.swapaxes(np.linalg.inv(roots), 1, 2))

    def standard(self, z: Array) -> tuple[Array, Array, Array]:
        """Standardised coordinates (n, charts, ndim) of z (n, ndim) in every chart, their squares' sums (n, charts),
        and ln|dy/dz| (n, charts). A point's numbers do not depend on the others it is given with."""
        x = np.empty((len(z), *self.mean.shape))
        squared, log_det = np.empty(x.shape[:2]), np.empty(x.shape[:2])
        z = np.ascontiguousarray(z)

        def some(part: slice) -> None:
            _forward(
                z[part], self.wide, self.parent, self.known, self.shift, self.spread, self.spread_used, self.mean,
                self.whiten, self.log_sd, self.centre, self.unroot_t, x[part], squared[part], log_det[part],
            )  # fmt: skip

        over_draws(some, len(z), self.shift[..., 0].size)
        return x, squared, log_det

    def place(self, x: Array, chart: NDArray[np.int64]) -> Array:
        """z (n, ndim) of the standardised coordinates x (n, ndim), each row in its own chart."""
        z = np.empty_like(x)
        _inverse(
            np.ascontiguousarray(x), chart, self.wide, self.parent, self.known, self.shift, self.spread,
            self.spread_used, self.mean, self.colour, self.centre, self.root, z,
        )  # fmt: skip
        return z


def _exponents(wide: int, plan: list[list[NDArray[np.int64]]]) -> list[tuple[int, ...]]:
    """The exponents of each monomial, in the plan's order."""
    keys = [(0,) * wide]
    for j, steps in enumerate(plan):
        for parents in steps:
            keys += [(*keys[t][:j], keys[t][j] + 1, *keys[t][j + 1 :]) for t in parents]
    return keys


@njit(inline="always")
def _ratio(h):
    bounded = h / np.sqrt(1.0 + (h / MOST_SPREAD) ** 2) / (4.0 * SPREAD_ORDER)
    return (1.0 + bounded) / (1.0 - bounded)


@njit(inline="always")
def _power(ratio):
    square = ratio * ratio
    fourth = square * square
    return fourth * fourth  # ratio to the power 2 * SPREAD_ORDER


@njit(inline="always")
def _add(total, factor, values):
    for r in range(BLOCK):
        total[r] += factor * values[r]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _forward(
    z, wide, parent, known, shift, spread, spread_used, mean, whiten, log_sd, centre, unroot_t, x, squared, log_det
):  # fmt: skip
    # Points are taken in blocks that fit the nearest cache, with the points of a block along the innermost loops.
    n, ndim = z.shape
    charts, monomials, _ = shift.shape
    feature = np.empty((monomials, BLOCK))
    p, f, h = np.empty((ndim, BLOCK)), np.empty((ndim, BLOCK)), np.empty((ndim, BLOCK))
    off, u, product, out = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty((ndim, BLOCK))
    for begin in range(0, n, BLOCK):
        size = min(BLOCK, n - begin)
        for b in range(charts):
            p[:] = 0.0
            off[:] = 0.0
            for i in range(ndim):
                for r in range(size):
                    off[r] = z[begin + r, i] - mean[b, i]
                for j in range(ndim):
                    _add(p[j], whiten[b, i, j], off)
            feature[0] = 1.0
            for j in range(wide):
                for r in range(BLOCK):
                    u[r] = p[j, r] / np.sqrt(1.0 + (p[j, r] / KNEE) ** 2)
                for t in range(known[j], known[j + 1]):
                    source = parent[t]
                    for r in range(BLOCK):
                        feature[t, r] = feature[source, r] * u[r]
            f[:] = 0.0
            h[:] = 0.0
            for i in range(ndim):
                for t in range(monomials):
                    if shift[b, t, i] != 0.0:
                        _add(f[i], shift[b, t, i], feature[t])
                for t in spread_used:
                    if spread[b, t, i] != 0.0:
                        _add(h[i], spread[b, t, i], feature[t])
            product[:] = 1.0
            out[:] = 0.0
            for i in range(ndim):
                for r in range(BLOCK):
                    ratio = _ratio(h[i, r])
                    product[r] *= ratio
                    u[r] = (p[i, r] - f[i, r]) / _power(ratio) - centre[b, i]
                for j in range(i, ndim):
                    _add(out[j], unroot_t[b, i, j], u)
            for r in range(size):
                log_det[begin + r, b] = -log_sd[b] - 2 * SPREAD_ORDER * np.log(product[r])
                total = 0.0
                for i in range(ndim):
                    x[begin + r, b, i] = out[i, r]
                    total += out[i, r] * out[i, r]
                squared[begin + r, b] = total


@njit(cache=True, nogil=True, fastmath={"contract"})
def _inverse(
    x, chart, wide, parent, known, shift, spread, spread_used, mean, colour, centre, root, z
):  # fmt: skip
    n, ndim = x.shape
    monomials = shift.shape[1]
    feature = np.empty(monomials)
    y, f, h = np.empty(ndim), np.empty(ndim), np.empty(ndim)
    for row in range(n):
        b = chart[row]
        for i in range(ndim):
            value = centre[b, i]
            for j in range(i + 1):
                value += root[b, i, j] * x[row, j]
            y[i] = value
        f[:] = 0.0
        h[:] = 0.0
        feature[0] = 1.0
        # Add each block of monomials to all f and h as soon as it is known; coordinate i is complete before it
        # is used, because coefficients of later blocks are 0 there.
        next_spread = 0
        for i in range(wide + 1):
            begin = known[i - 1] if i > 0 else 0
            for t in range(begin, known[i]):
                for j in range(ndim):
                    f[j] += shift[b, t, j] * feature[t]
                if next_spread < len(spread_used) and spread_used[next_spread] == t:
                    next_spread += 1
                    for j in range(ndim):
                        h[j] += spread[b, t, j] * feature[t]
            if i < wide:
                p = y[i] * _power(_ratio(h[i])) + f[i]
                u = p / np.sqrt(1.0 + (p / KNEE) ** 2)
                for t in range(known[i], known[i + 1]):
                    feature[t] = feature[parent[t]] * u
        z[row] = mean[b]
        for i in range(ndim):
            p = y[i] * _power(_ratio(h[i])) + f[i]
            for j in range(ndim):
                z[row, j] += p * colour[b, i, j]
