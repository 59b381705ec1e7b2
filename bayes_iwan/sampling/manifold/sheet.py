"""Markov chains on the graph of a least-squares posterior, whose step is set by its curvature, not by its thickness.

Whitened residuals and prior rows F(z) = (r(z) W, z) make a manifold in data space, and −ln p =
½|F|² + const but for the numbers that W depends on, those of the noise, which are held. Where the data say much, the
posterior is a thin bent sheet in z, but no thin thing in data space: seen along the tangents at any place z₀, x = QᵀF
with Q from F′(z₀) = QR, it is nearly standard normal (Zappa, Holmes-Cerf & Goodman, Comm. Pure Appl. Math. 71, 2018,
2609; Au, Graham & Thiery, J. R. Stat. Soc. B 85, 2023, 757). A step from z₀ turns x towards a standard normal ξ,

    x′ = cos a · x + sin a · ξ,

which leaves a standard normal as it is however large the angle a, and finds z′ with QᵀF(z′) = x′ by Broyden's method.
The way back starts from z′, along its own tangents Q′, with ξ′ = (Q′ᵀF(z₀) − cos a · Q′ᵀF(z′)) / sin a. The proposal's
density is that of ξ times |det QᵀF′(z′)|, and of both determinants det Q′ᵀQ cancels, so that a step is accepted with

    p(z′) N(ξ′) |det R| / (p(z₀) N(ξ) |det R′|),

and only if the way back leads to z₀. A proposal is judged first as if the sheet were flat, which takes neither its
Jacobian nor the way back; what passes is judged again, with the rest of the ratio (delayed acceptance: Christen & Fox,
J. Comp. Graph. Stat. 14, 2005, 795). Numbers that are held are integrated out (see `common.held`). Nothing is
approximated but the Jacobian, by forward differences.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, fields

import numba as nb
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.held import Held, HeldFunction

Rows = Callable[[Array], Array]

#: step of the Jacobian's differences; to what x is met, and within what of z₀ a way back must end
_STEP, _TOLERANCE, _SAME = 1e-6, 1e-4, 1e-3
_ITERATIONS = 25  # nearly all that are solved for are found by then
#: an error that has to fall by more than this in each iteration that is left is not going to: few of those that are met
#: in the end are ever so far behind, and most of the others are by the tenth
_FALLS = 2.15
_LONGEST = 1.0  # step of any coordinate
_LOST = 1e6  # a step that is off by so much has left for good
#: angles of steps, times the chains' own scale
_ANGLES = (0.6, 1.4)
#: this share of steps is that much shorter: from where the sheet bends most, no longer ones lead away
_SHORT, _SHORTER = 0.2, 0.2


@dataclass(frozen=True)
class Places:
    """Places z (n, ndim), held numbers as at the sheet's centre: F (n, m), Qᵀ (n, free, m), ln|det R| (n,), and the
    inverse of R = QᵀF′ (n, free, free)."""

    z: Array
    values: Array
    tangent: Array
    log_det: Array
    back: Array

    def some(self, rows: NDArray[np.int64]) -> Places:
        """Some of them."""
        return Places(*(getattr(self, f.name)[rows] for f in fields(self)))

    def put(self, rows: NDArray[np.int64], other: Places) -> None:
        """Have these rows replaced."""
        for f in fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)

    def seen(self, values: Array) -> Array:
        """Qᵀ of F (n, m): (n, free)."""
        return _seen(self.tangent, np.arange(len(values)), values)


@dataclass
class Walkers:
    """Where chains stand: z (n, ndim), ln p there (n,), and its integral over the held numbers as estimated (n,)."""

    z: Array
    log_prob: Array
    log_total: Array


class Sheet:
    """The graph of the rows with the held numbers at their centre.

    rows : z (n, ndim) → r W (n, k) with W of z's own held numbers; log_prob : z (n, ndim), held numbers (n, count,
    held) → ln p (n, count); limit : z lies within ±limit; still : coordinates that stay as they are given: the sheet is
    one of the others, given these.
    """

    def __init__(
        self,
        rows: Rows,
        log_prob: HeldFunction,
        held: Held,
        ndim: int,
        limit: float,
        still: NDArray[np.int64] | None = None,
    ) -> None:
        self._rows, self.log_prob, self.held, self.limit = rows, log_prob, held, limit
        given = held.columns if still is None else np.concatenate([held.columns, still])
        self.free = np.setdiff1d(np.arange(ndim), given)
        self.n_evaluations, self._ndim = 0, ndim

    def given(self, still: NDArray[np.int64]) -> Sheet:
        """The sheet of the others, given these coordinates."""
        return Sheet(self._rows, self.log_prob, self.held, self._ndim, self.limit, still)

    def counting(self) -> Sheet:
        """The same sheet with evaluations counted from none: threads and processes count their own."""
        out = copy.copy(self)
        out.n_evaluations = 0
        return out

    def values(self, z: Array) -> Array:
        """F (n, m) at z (n, ndim)."""
        self.n_evaluations += len(z)
        with np.errstate(all="ignore"):
            return np.concatenate([self._rows(z), z[:, self.free]], axis=1)

    def places(self, z: Array) -> Places:
        """What there is to know of z (n, ndim); ln|det R| is ∞ where F or F′ is not finite."""
        n, k = len(z), len(self.free)
        at = z.copy()
        at[:, self.held.columns] = self.held.centre
        moved = np.repeat(at[:, None], k + 1, axis=1)
        moved[:, np.arange(1, k + 1), self.free] += _STEP
        out = self.values(moved.reshape(-1, z.shape[1]))
        out = out.reshape(n, k + 1, out.shape[1])
        slope = (out[:, 1:] - out[:, :1]) / _STEP  # transposed: (n, free, m)
        sound = np.isfinite(out).all(axis=(1, 2))
        slope[~sound] = 0.0
        square = slope @ slope.transpose(0, 2, 1)
        square[~sound] = np.eye(k)
        root = np.linalg.cholesky(square)
        lower = np.linalg.inv(root)
        log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        return Places(at, out[:, 0], lower @ slope, np.where(sound, log_det, np.inf), lower.transpose(0, 2, 1).copy())

    def reached(self, start: Places, x: Array, tolerance: float = _TOLERANCE) -> tuple[Array, NDArray[np.bool_]]:
        """z (n, ndim) where x (n, free), as seen from start, is met, and whether it is (n,); by Broyden's method."""
        z, at, back = start.z.copy(), start.seen(start.values), start.back.copy()
        error = np.linalg.norm(at - x, axis=1)
        active = np.flatnonzero(error > tolerance)
        for left_over in reversed(range(_ITERATIONS)):
            if len(active) == 0:
                break
            own = back[active]
            step = np.matmul(own, (x[active] - at[active])[:, :, None])[:, :, 0]
            step *= _LONGEST / np.maximum(_LONGEST, np.max(np.abs(step), axis=1, keepdims=True))
            trial = z[active]
            trial[:, self.free] += step
            value = _seen(start.tangent, active, self.values(trial))
            left = np.linalg.norm(value - x[active], axis=1)
            moved = np.matmul(own, (value - at[active])[:, :, None])[:, :, 0]
            curl = np.sum(step * moved, axis=1)
            sound = (left < _LOST) & (np.abs(curl) > 1e-3 * np.sum(step * step, axis=1))
            sound &= np.max(np.abs(trial), axis=1) <= self.limit
            active, step, moved = active[sound], step[sound], moved[sound]
            turned = np.matmul(step[:, None], own[sound])
            back[active] += ((step - moved) / curl[sound, None])[:, :, None] * turned
            z[active], at[active], error[active] = trial[sound], value[sound], left[sound]
            behind = error[active] > tolerance * _FALLS**left_over
            active = active[(error[active] > tolerance) & ~behind]
        return z, np.asarray(error <= tolerance)

    def begin(self, z: Array, rng: np.random.Generator) -> Walkers:
        """Chains that begin at z (n, ndim), with held numbers of their own."""
        total, z, log_prob = self.held.integrated(self.log_prob, z, self.held.chances(len(z), rng), rng.random(len(z)))
        return Walkers(z, log_prob, total)

    def refresh(self, walkers: Walkers, rng: np.random.Generator) -> None:
        """Draw the held numbers anew, but for the walkers' own, of which they may take others."""
        chances, pick = self.held.chances(len(walkers.z), rng), rng.random(len(walkers.z))
        walkers.log_total, walkers.z, walkers.log_prob = self.held.integrated(
            self.log_prob, walkers.z, chances, pick, keep=True
        )

    def step(self, walkers: Walkers, places: Places, scale: float, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Take a step from where the walkers are, their `places`, which is changed with them; who went (n,)."""
        n, went = len(walkers.z), np.zeros(len(walkers.z), bool)
        angle = scale * rng.uniform(*_ANGLES, n) * np.where(rng.random(n) < _SHORT, _SHORTER, 1.0)
        angle = np.minimum(angle, 0.5 * np.pi)
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        unit, held, chance = rng.standard_normal((n, len(self.free))), self.held.chances(n, rng), rng.random(n)
        first, second = np.log(rng.random((2, n)))
        x = places.seen(places.values)
        wanted = cos * x + sin * unit
        z, met = self.reached(places, wanted)
        some = np.flatnonzero(met)
        if len(some) == 0:
            return went
        total, z, log_prob = self.held.integrated(self.log_prob, z[some], held[some], chance[some])
        # as if the sheet were flat
        flat = total - walkers.log_total[some] + 0.5 * _squares(wanted[some]) - 0.5 * _squares(x[some])
        keep = np.flatnonzero(first[some] < flat)
        if len(keep) == 0:
            return went
        some, total, z, log_prob, flat = some[keep], total[keep], z[keep], log_prob[keep], flat[keep]
        there = self.places(z)
        seen, asked = there.seen(there.values), there.seen(places.values[some])
        unit_back = (asked - cos[some] * seen) / sin[some]
        ratio = total - walkers.log_total[some] + 0.5 * _squares(unit[some]) - 0.5 * _squares(unit_back)
        ratio += places.log_det[some] - there.log_det
        flat_back = walkers.log_total[some] - total + 0.5 * _squares(asked) - 0.5 * _squares(seen)
        keep = np.flatnonzero(second[some] < ratio + np.minimum(flat_back, 0.0) - np.minimum(flat, 0.0))
        there = there.some(keep)
        back, met = self.reached(there, asked[keep])
        near = np.max(np.abs(back - places.z[some[keep]])[:, self.free], axis=1, initial=0.0) < _SAME
        same = np.flatnonzero(met & near)
        gone, keep = some[keep[same]], keep[same]
        walkers.z[gone], walkers.log_prob[gone], walkers.log_total[gone] = z[keep], log_prob[keep], total[keep]
        places.put(gone, there.some(same))
        went[gone] = True
        return went

    def advance(
        self, walkers: Walkers, steps: int, scale: float, rng: np.random.Generator
    ) -> tuple[Array, Array, float]:
        """Take so many steps: where the walkers are after each, z (steps, n, ndim) and ln p (steps, n), and the share
        of steps that were accepted."""
        places = self.places(walkers.z)
        z, log_prob, went = np.empty((steps, *walkers.z.shape)), np.empty((steps, len(walkers.z))), 0.0
        for i in range(steps):
            self.refresh(walkers, rng)
            went += float(np.mean(self.step(walkers, places, scale, rng))) / steps
            z[i], log_prob[i] = walkers.z, walkers.log_prob
        return z, log_prob, went


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _seen(tangent, rows, values):
    """tangent[rows] @ values: (n, free) of tangents (…, free, m) and values (n, m), the tangents of some rows not
    copied, which would take longer than the product."""
    out = np.empty((len(rows), tangent.shape[1]))
    for i in range(len(rows)):
        for k in range(tangent.shape[1]):
            total = 0.0
            for j in range(values.shape[1]):
                total += tangent[rows[i], k, j] * values[i, j]
            out[i, k] = total
    return out


def _squares(x: Array) -> Array:
    return np.asarray(np.sum(x * x, axis=1))
