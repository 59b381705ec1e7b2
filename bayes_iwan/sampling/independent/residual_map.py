"""Coordinates in which a least-squares posterior is nearly normal: its residuals, seen along the optimum's tangents.

Whitened residuals and prior rows F(z) = (r(z) W, z), −ln p = ½|F|² + const, hardly bend as a curve in data space, even
where z itself bends by hundreds of its standard deviations. With Q from the QR factors of F's Jacobian at an optimum,
x = QᵀF(z) is as long as z, and a standard normal x gives z a distribution close to the posterior, of known density

    q(z) = N(QᵀF(z); 0, I) · |det Qᵀ F′(z)|

("randomise, then optimise": Bardsley, Solonen, Haario & Laine, SIAM J. Sci. Comput. 36, 2014, A1895). z is found from
x by Broyden's method, so that most steps cost one evaluation, from the known place that is nearest: the optimum, or one
that was solved for before. From the optimum alone a solution takes some 60 steps, from the best of a few hundred known
places six. Numbers that scale the residuals (those of the noise) are held where the optimum has them; the map is one of
the other numbers. Any residuals make a map whose density is known, so they may be those of a coarser model.

A map belongs to one branch: the places that are reached from its optimum. An x that no place answers is told as such.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array

Residuals = Callable[[Array], Array]

#: step of the Jacobian's differences; x is met to within TOLERANCE of its standard deviation
_STEP, TOLERANCE = 1e-6, 1e-3
#: steps at most from the optimum alone, and from known places; who has not got there by then rarely does, and would
#: cost more than all others
_ITERATIONS = (200, 60)
_LEAST_PART = 1e-4
_LONGEST = 1.0  # step of any coordinate
_SLOW = 3.0  # a step that is off its promise by more than this many times its length asks for a fresh Jacobian
_TUBE = 1.0  # by how much of x a step may be off its promise, on the way
_SAME = 1e-2  # places nearer than this are one place
_TOGETHER = 512  # rows evaluated at a time


@dataclass(frozen=True)
class Solved:
    """Places z (n, ndim), held numbers as at the optimum, the x (n, free) that they have, ∂x/∂z (n, free, free), the
    logarithm of its determinant (n,), −∞ where the map turns over, and whether the x asked for was met."""

    z: Array
    x: Array
    slope: Array
    log_det: Array
    met: NDArray[np.bool_]

    def some(self, rows: NDArray[np.int64]) -> Solved:
        """Some of them."""
        return Solved(self.z[rows], self.x[rows], self.slope[rows], self.log_det[rows], self.met[rows])


@dataclass(frozen=True)
class Known:
    """Places where solutions start: z (k, ndim), x (k, free), ∂x/∂z (k, free, free)."""

    z: Array
    x: Array
    slope: Array

    def arrays(self) -> dict[str, Array]:
        """What :class:`Known` is made of."""
        return {"z": self.z, "x": self.x, "slope": self.slope}

    @cached_property
    def back(self) -> Array:
        """∂z/∂x (k, free, free)"""
        return np.asarray(np.linalg.inv(self.slope))

    def nearest(self, x: Array) -> NDArray[np.int64]:
        """For each x (n, free) the place from which the tangent's step to it is shortest in z (n,): where the map bends
        strongly, as where z runs far for little x, a tangent leads nowhere."""
        step = np.matmul(x[None] - self.x[:, None], self.back.transpose(0, 2, 1))  # (k, n, free)
        return np.asarray(np.argmin(np.einsum("kni,kni->kn", step, step), axis=0))


class ResidualMap:
    """x ↔ z of one optimum.

    residuals : z (n, ndim) → r (n, k); whiten : W (k, m); held : the coordinates that keep the optimum's values.
    """

    def __init__(self, residuals: Residuals, whiten: Array, optimum: Array, held: NDArray[np.int64]) -> None:
        self._residuals, self.optimum = residuals, optimum
        self.free = np.setdiff1d(np.arange(len(optimum)), held)
        self.n_evaluations, self._lock = 0, threading.Lock()
        _, slope = self._jacobian(optimum[None], residuals)
        q, r = np.linalg.qr(np.concatenate([whiten.T @ slope[0], np.eye(len(self.free))]))
        sign = np.where(np.diag(r) < 0.0, -1.0, 1.0)
        q, r = q * sign, r * sign[:, None]
        self._of_residual, self._of_z = whiten @ q[: whiten.shape[1]], q[whiten.shape[1] :]
        self._optimum = Known(optimum[None], self.values(optimum[None]), r[None])
        self.known = self._optimum

    def remember(self, z: Array, x: Array, slope: Array) -> None:
        """Start from these places (k, ndim), their x and ∂x/∂z, too, and from none of those of before."""
        own = self._optimum
        self.known = Known(*(np.concatenate(pair) for pair in ((own.z, z), (own.x, x), (own.slope, slope))))

    def values(self, z: Array) -> Array:
        """QᵀF (n, free) at z (n, ndim)."""
        with self._lock:
            self.n_evaluations += len(z)
        parts = [self._values(z[i : i + _TOGETHER]) for i in range(0, len(z), _TOGETHER)]
        return np.concatenate(parts) if parts else np.empty((0, len(self.free)))

    def _values(self, z: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._residuals(z) @ self._of_residual + z[:, self.free] @ self._of_z

    def place(self, x: Array, limit: float) -> Solved:
        """Where each x (n, free) is met, within ±limit."""
        start = self.known.nearest(x)
        z, at, slope = self.known.z[start], self.known.x[start], self.known.slope[start]
        met = self._solve(z, at, slope, x, limit)
        return Solved(z, at, slope, _log_det(slope), met)

    def leads_to(self, place: Solved, limit: float) -> NDArray[np.bool_]:
        """Are these places (n,) where their own x leads?"""
        start = self.known.nearest(place.x)
        z, at, slope = self.known.z[start], self.known.x[start], self.known.slope[start]
        met = self._solve(z, at, slope, place.x, limit, last=False)
        return np.asarray(met & (np.max(np.abs(z - place.z), axis=1, initial=0.0) < _SAME))

    def coordinates(self, z: Array) -> Solved:
        """x of given places z (n, ndim), whatever their held numbers."""
        at_optimum = np.tile(self.optimum, (len(z), 1))
        at_optimum[:, self.free] = z[:, self.free]
        x, slope = self._jacobian(at_optimum, self.values)
        return Solved(at_optimum, x, slope, _log_det(slope), np.asarray(np.isfinite(x).all(axis=1)))

    def scale(self, z: Array) -> Array:
        """∂z/∂x (n, free, free) at places z (n, ndim), with held numbers as at the optimum."""
        there = np.tile(self.optimum, (len(z), 1))
        there[:, self.free] = z[:, self.free]
        return np.asarray(np.linalg.inv(self._jacobian(there, self.values)[1]))

    def _jacobian(self, z: Array, function: Residuals) -> tuple[Array, Array]:
        """A function (n, m) of places, and its forward differences (n, m, free)."""
        n, k = len(z), len(self.free)
        moved = np.repeat(z[:, None], k + 1, axis=1)
        moved[:, np.arange(1, k + 1), self.free] += _STEP
        out = function(moved.reshape(-1, z.shape[1])).reshape(n, k + 1, -1)
        return out[:, 0], (out[:, 1:] - out[:, :1]).transpose(0, 2, 1) / _STEP

    def _solve(
        self, z: Array, at: Array, slope: Array, wanted: Array, limit: float, last: bool = True
    ) -> NDArray[np.bool_]:
        """Move z (n, ndim) and with it `at`, its QᵀF, and `slope`, QᵀF′, to where `at` is `wanted`; who got there.

        last : take the slope there, too.
        """
        n = len(z)
        error = np.linalg.norm(at - wanted, axis=1)
        part, fresh = np.ones(n), np.ones(n, bool)  # of the whole step; is the Jacobian that of this very place?
        active = np.flatnonzero(error > TOLERANCE)
        for _ in range(_ITERATIONS[len(self.known.z) > 1]):
            if len(active) == 0:
                break
            step = _solved(slope[active], (wanted - at)[active])
            step *= part[active, None] * _LONGEST / np.maximum(_LONGEST, np.max(np.abs(step), axis=1, keepdims=True))
            trial = z[active]
            trial[:, self.free] = np.clip(trial[:, self.free] + step, -limit, limit)
            step = trial[:, self.free] - z[np.ix_(active, self.free)]
            value = self.values(trial)
            left = np.linalg.norm(value - wanted[active], axis=1)
            promised = np.matmul(slope[active], step[..., None])[..., 0]
            miss = value - at[active] - promised
            off, long = np.linalg.norm(miss, axis=1), np.linalg.norm(promised, axis=1)
            # a step along a bent sheet may leave the sheet a little: the next one leads back
            better = (left < 0.999 * error[active]) | ((off < _TUBE) & (error[active] > 2.0 * _TUBE))
            gone, s = active[better], step[better]
            curl = s / np.maximum(np.sum(s * s, axis=1), 1e-300)[:, None]
            slope[gone] += miss[better][:, :, None] * curl[:, None, :]
            z[gone], at[gone], error[gone] = trial[better], value[better], left[better]
            stays = active[~better]
            part[stays[fresh[stays]]] *= 0.4
            part[gone] = np.minimum(1.0, part[gone] * np.where(off[better] < 0.5 * _TUBE, 2.0, 1.0))
            ask = active[(~better & ~fresh[active]) | (better & (off > _SLOW * long))]
            fresh[gone] = False
            active = active[(error[active] > TOLERANCE) & (part[active] > _LEAST_PART)]
            ask = np.intersect1d(ask, active)
            if len(ask):
                at[ask], slope[ask] = self._jacobian(z[ask], self.values)
                fresh[ask] = True
        met: NDArray[np.bool_] = np.asarray(error <= TOLERANCE)
        if last and met.any():
            at[met], slope[met] = self._jacobian(z[met], self.values)
        return met


def _solved(matrix: Array, right: Array) -> Array:
    """Solutions (n, k); a singular matrix gives steps of NaN, which are not taken."""
    try:
        return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        out = np.full(right.shape, np.nan)
        for i in np.flatnonzero(np.abs(np.linalg.det(matrix)) > 0.0):
            out[i] = np.linalg.solve(matrix[i], right[i])
        return out


def _log_det(slope: Array) -> Array:
    sign, value = np.linalg.slogdet(slope)
    return np.where(sign > 0.0, value, -np.inf)
