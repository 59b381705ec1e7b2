"""Steps along the manifold of a least-squares posterior: their length is set by its curvature, not by its thickness.

Whitened residuals and prior rows F(z) = (r(z) W, z) make a manifold in data space, and −ln p = ½|F|² + const but for
the nuisance parameters, which are held. Where the data say much, the posterior is a thin curved sheet in z, but no thin
thing in data space: seen along the tangents at any place z₀, x = QᵀF with Q from F′(z₀) = QR, it is nearly standard
normal (Zappa, Holmes-Cerf & Goodman, Comm. Pure Appl. Math. 71, 2018, 2609; Au, Graham & Thiery, J. R. Stat. Soc. B 85,
2023, 757). A step from z₀ turns x towards a standard normal ξ,

    x′ = cos a · x + sin a · ξ,

which leaves a standard normal as it is however large the angle a, and finds z′ with QᵀF(z′) = x′ by Broyden's method.
The way back starts from z′, along its own tangents Q′, with ξ′ = (Q′ᵀF(z₀) − cos a · Q′ᵀF(z′)) / sin a. The proposal's
density is that of ξ times |det QᵀF′(z′)|, and of both determinants det Q′ᵀQ cancels, so that a step is accepted with

    p(z′) N(ξ′) |det R| / (p(z₀) N(ξ) |det R′|),

and only if the way back leads to z₀. A candidate is tested first as if the manifold were flat, which takes neither its
Jacobian nor the way back; what passes is tested again, with what remains of the ratio (delayed acceptance: Christen &
Fox, J. Comp. Graph. Stat. 14, 2005, 795). Nothing is approximated but the Jacobian, by forward differences.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numba as nb
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.moves.metropolis import Candidates, LeastSquares, MetropolisMove

#: step of the Jacobian's differences; to what x is met, and within what of z₀ a way back must end
_STEP, TOLERANCE, _SAME = 1e-6, 1e-4, 1e-3
_ITERATIONS = 25  # nearly all that are solved for are found by then
#: an error that would have to fall by more than this in each iteration that remains is given up
_FALLS = 2.15
_LONGEST = 1.0  # step of any coordinate
_LOST = 1e6  # a step that is off by so much does not come back
#: angles of steps, times the move's own scale
_ANGLES = (0.6, 1.4)
#: this share of steps is that much shorter: they lead away from where the manifold curves most
_SHORT, _SHORTER = 0.2, 0.2
#: acceptance that the scale is fitted to, how fast, and within which limits
_ACCEPTANCE, _RATE, LEAST, _MOST = 0.38, 1.5, 0.15, 1.1


@dataclass(frozen=True)
class Places:
    """Places z (n, ndim), nuisance parameters at their centre: F (n, m), Qᵀ (n, free, m), ln|det R| (n,), and the
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
        """Replace these rows."""
        for f in fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)

    def seen(self, values: Array) -> Array:
        """Qᵀ of F (n, m): (n, free)."""
        return _seen(self.tangent, np.arange(len(values)), values)


class Manifold:
    """The graph of a posterior's residuals over its free coordinates, the nuisance parameters at their centre.

    given : coordinates that stay as they are: the manifold is that of the others, given these.
    """

    def __init__(self, target: LeastSquares, given: NDArray[np.int64] | None = None) -> None:
        self.target = target
        self.free = target.free if given is None else np.setdiff1d(target.free, given)

    def places(self, z: Array) -> Places:
        """What there is to know of z (n, ndim); ln|det R| is ∞ where F or F′ is not finite."""
        target, free = self.target, self.free
        n, k = len(z), len(free)
        at = z.copy()
        at[:, target.nuisance.columns] = target.nuisance.centre
        moved = np.repeat(at[:, None], k + 1, axis=1)
        moved[:, np.arange(1, k + 1), free] += _STEP
        out = target.values(moved.reshape(-1, z.shape[1]), free)
        out = out.reshape(n, k + 1, out.shape[1])
        slope = (out[:, 1:] - out[:, :1]) / _STEP  # transposed: (n, free, m)
        sound = np.isfinite(out).all(axis=(1, 2))
        slope[~sound] = 0.0
        square = slope @ slope.transpose(0, 2, 1)
        square[~sound] = np.eye(k)
        root = np.linalg.cholesky(square)
        lower = np.linalg.inv(root)
        log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        return Places(
            at, out[:, 0].copy(), lower @ slope, np.where(sound, log_det, np.inf), lower.transpose(0, 2, 1).copy()
        )

    def reached(self, start: Places, x: Array, tolerance: float = TOLERANCE) -> tuple[Array, NDArray[np.bool_]]:
        """z (n, ndim) where x (n, free), as seen from start, is met, and whether it is (n,); by Broyden's method."""
        free, limit = self.free, self.target.limit
        z, at, back = start.z.copy(), start.seen(start.values), start.back.copy()
        error = np.linalg.norm(at - x, axis=1)
        active = np.flatnonzero(error > tolerance)
        for remaining in reversed(range(_ITERATIONS)):
            if len(active) == 0:
                break
            own = back[active]
            step = np.matmul(own, (x[active] - at[active])[:, :, None])[:, :, 0]
            step *= _LONGEST / np.maximum(_LONGEST, np.max(np.abs(step), axis=1, keepdims=True))
            trial = z[active]
            trial[:, free] += step
            value = _seen(start.tangent, active, self.target.values(trial, free))
            left = np.linalg.norm(value - x[active], axis=1)
            moved = np.matmul(own, (value - at[active])[:, :, None])[:, :, 0]
            curl = np.sum(step * moved, axis=1)
            sound = (left < _LOST) & (np.abs(curl) > 1e-3 * np.sum(step * step, axis=1))
            sound &= np.max(np.abs(trial), axis=1) <= limit
            active, step, moved = active[sound], step[sound], moved[sound]
            turned = np.matmul(step[:, None], own[sound])
            back[active] += ((step - moved) / curl[sound, None])[:, :, None] * turned
            z[active], at[active], error[active] = trial[sound], value[sound], left[sound]
            behind = error[active] > tolerance * _FALLS**remaining
            active = active[(error[active] > tolerance) & ~behind]
        return z, np.asarray(error <= tolerance)

    def followed(self, start: Places, x: Array, parts: int) -> Array:
        """z (n, ndim) at the end of straight ways of x (n, free), as seen from the one place `start`: in so many parts,
        the Jacobian anew for each, which leads further than one; where the manifold turns over, the last place."""
        at, left, z = start.some(np.zeros(len(x), np.int64)), np.arange(len(x)), np.repeat(start.z, len(x), axis=0)
        first, tangent = start.seen(start.values), at.tangent
        for part in range(1, parts + 1):
            if part > 1:
                there = self.places(z[left])
                turn = np.linalg.inv(tangent @ there.tangent.transpose(0, 2, 1))
                at = replace(there, tangent=tangent, back=there.back @ turn)
            found, met = self.reached(at, first + (x[left] - first) * (part / parts))
            left, tangent = left[met], at.tangent[met]
            z[left] = found[met]
        return z


class ManifoldMove(MetropolisMove):
    """A step along the manifold of a least-squares posterior.

    For any user of emcee whose posterior is thin, curved and made of residuals: give the residuals as
    :class:`LeastSquares`; each step takes some tens of their evaluations, as batches over all walkers.

    scale : of the angles; :meth:`adapted` fits it to the share of steps that was accepted.
    """

    def __init__(self, target: LeastSquares, scale: float = 0.3) -> None:
        self.manifold, self.scale = Manifold(target), scale
        self._known: Places | None = None  # where the walkers were at the last step
        self._offered: tuple[NDArray[np.int64], Places] | None = None  # which of them were offered which places

    def __getstate__(self) -> dict[str, object]:
        """Places are not handed on: they follow from where the walkers are."""
        return {"manifold": self.manifold, "scale": self.scale, "_known": None, "_offered": None}

    def adapted(self, accepted: float, target: LeastSquares) -> ManifoldMove:
        """The move for the next steps of a warm-up, of which this share was accepted."""
        scale = self.scale * np.exp(_RATE * (accepted - _ACCEPTANCE))
        return ManifoldMove(target, float(np.clip(scale, LEAST, _MOST)))

    def candidates(self, z: Array, random: np.random.RandomState) -> Candidates:
        manifold, target, n = self.manifold, self.manifold.target, len(z)
        places = self._places_of(z)
        log_total, z, log_prob = target.integrated(z, random, keep=True)
        new_z, new_log_prob, log_ratio = z.copy(), log_prob.copy(), np.full(n, -np.inf)
        angle = self.scale * random.uniform(*_ANGLES, n) * np.where(random.random_sample(n) < _SHORT, _SHORTER, 1.0)
        angle = np.minimum(angle, 0.5 * np.pi)
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        unit, first = random.standard_normal((n, len(manifold.free))), np.log(random.random_sample(n))
        x = places.seen(places.values)
        wanted = cos * x + sin * unit
        reached, met = manifold.reached(places, wanted)
        some = np.flatnonzero(met)
        if len(some) == 0:
            return Candidates(z, log_prob, new_z, new_log_prob, log_ratio)
        total, there_z, there_log_prob = target.integrated(reached[some], random)
        # as if the manifold were flat
        flat = total - log_total[some] + 0.5 * _squares(wanted[some]) - 0.5 * _squares(x[some])
        keep = np.flatnonzero(first[some] < flat)
        some = some[keep]
        total, there_z, there_log_prob, flat = (a[keep] for a in (total, there_z, there_log_prob, flat))
        if len(some) == 0:
            return Candidates(z, log_prob, new_z, new_log_prob, log_ratio)
        there = self.manifold.places(there_z)
        seen, asked = there.seen(there.values), there.seen(places.values[some])
        unit_back = (asked - cos[some] * seen) / sin[some]
        ratio = total - log_total[some] + 0.5 * _squares(unit[some]) - 0.5 * _squares(unit_back)
        ratio += places.log_det[some] - there.log_det
        flat_back = log_total[some] - total + 0.5 * _squares(asked) - 0.5 * _squares(seen)
        ratio += np.minimum(flat_back, 0.0) - np.minimum(flat, 0.0)
        back, met = manifold.reached(there, asked)
        near = np.max(np.abs(back - places.z[some])[:, manifold.free], axis=1, initial=0.0) < _SAME
        new_z[some], new_log_prob[some] = there_z, there_log_prob
        log_ratio[some] = np.where(met & near, ratio, -np.inf)
        self._offered = some, there
        return Candidates(z, log_prob, new_z, new_log_prob, log_ratio)

    def _places_of(self, z: Array) -> Places:
        """The places of walkers at z (n, ndim): those known, those that the last step offered, the others anew."""
        known, free = self._known, self.manifold.free
        if known is None or len(known.z) != len(z):
            self._known = self.manifold.places(z)
            return self._known
        moved = np.any(known.z[:, free] != z[:, free], axis=1)
        if self._offered is not None:
            rows, offered = self._offered
            gone = np.flatnonzero(moved[rows] & np.all(offered.z[:, free] == z[np.ix_(rows, free)], axis=1))
            known.put(rows[gone], offered.some(gone))
            moved[rows[gone]] = False
        others = np.flatnonzero(moved)
        if len(others):
            known.put(others, self.manifold.places(z[others]))
        return known


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _seen(tangent: Array, rows: NDArray[np.int64], values: Array) -> Array:
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
