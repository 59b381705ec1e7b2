"""Levenberg–Marquardt from many starts at once, through one batch function.

The forward model takes many parameter vectors at a time, so the cheapest way to fit from many starts is to
advance them all in lock-step: one batch call for all their Jacobians, one for all their trial steps. Nothing
here knows what the residuals mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError

BatchResiduals = Callable[[Array], Array]

#: damping factors tried together in every iteration, as multiples of the current one: a Jacobian costs ndim
#: evaluations, so four trial steps are cheap, and the best of four saves whole iterations in curved residuals
LADDER = np.array([1e-2, 1e-1, 1.0, 10.0])
LEAST_DAMPING, MOST_DAMPING = 1e-14, 1e12
#: relative change of x, and cosine between the residual and any free column of the Jacobian, below which a start has
#: converged
TOLERANCE = 1e-9
#: finite-difference step over max(|x|, a typical change of it)
STEP = 1e-6
#: most rows in one call
CHUNK = 4096

CONVERGED_COST = 1
CONVERGED_STEP = 2
CONVERGED_GRADIENT = 3
OUT_OF_ITERATIONS = 0
BAD_START = -1


class LeastSquaresError(InputError):
    """The starts, bounds or residuals cannot be used."""


@dataclass(frozen=True)
class LeastSquaresFit:
    """Where each start of `least_squares_batch` ended. Arrays are in the order of the starts.

    cost is half the sum of squared residuals (inf for a start whose residuals were not finite), jacobian the
    central-difference derivative ∂residuals/∂x at x, at_bound marks variables that ended on a bound, status is
    one of the constants of this module: CONVERGED_COST (the cost falls no further), CONVERGED_STEP (x moves
    no further), CONVERGED_GRADIENT (the projected gradient vanishes), OUT_OF_ITERATIONS, BAD_START.
    """

    x: Array  # (starts, ndim)
    cost: Array  # (starts,)
    residuals: Array  # (starts, m)
    jacobian: Array  # (starts, m, ndim)
    at_bound: NDArray[np.bool_]  # (starts, ndim)
    status: NDArray[np.int64]  # (starts,)
    n_evaluations: int

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(starts,) True where a convergence criterion was met."""
        return self.status > 0

    @property
    def best(self) -> int:
        """Index of the start that ended with the lowest cost."""
        return int(np.argmin(self.cost))

    def covariance(self) -> Array:
        """(ndim, ndim) covariance (JᵀJ)⁺ at the best optimum.

        It is right when the residuals are in units of their noise. Numbers on a bound and directions that the
        residuals do not see (singular values below 1e-10 of the largest) are omitted: variance 0.
        """
        jacobian = np.where(self.at_bound[self.best], 0.0, self.jacobian[self.best])
        _, s, vt = np.linalg.svd(jacobian, full_matrices=False)
        inverse = np.where(s > 1e-10 * s.max(initial=0.0), 1.0 / np.where(s > 0, s, 1.0), 0.0)
        return (vt.T * inverse**2) @ vt


def least_squares_batch(
    residuals: BatchResiduals,
    starts: ArrayLike,
    bounds: ArrayLike | None = None,
    *,
    max_iterations: int = 200,
    ftol: float = TOLERANCE,
) -> LeastSquaresFit:
    """Minimise ½‖residuals(x)‖² within box bounds from every start, all starts in lock-step.

    Parameters
    ----------
    residuals
        maps (n, ndim) to (n, m); rows must not depend on each other. A row that is not finite marks
        an x where the model does not exist; such trial steps are refused.
    starts
        (starts, ndim) or (ndim,); clipped into the bounds.
    bounds
        (ndim, 2) lower and upper, ±inf allowed; None for no bounds.
    ftol
        relative change of the cost below which a start has converged.

    Raises
    ------
    LeastSquaresError
        shapes do not fit, or `residuals` returns another shape than (n, m).

    Method: Marquardt's scaled steps (Moré 1978) by QR and SVD of each Jacobian, so that weakly determined
    directions keep their digits; four damping factors are tried in one call; bounds by projection, with the
    variables held that sit on a bound and are pushed outwards. Jacobians are forward differences while
    descending and central ones at the end and where forward ones no longer find a way down.
    """
    x, lower, upper = _check(starts, bounds)
    scale = np.minimum(1.0, upper - lower)  # a typical change of each variable
    call = Counted(residuals)
    n_starts, ndim = x.shape

    def h(at: Array, central: bool) -> Array:  # steps that balance truncation and rounding
        return (STEP ** (2 / 3) if central else STEP) * np.maximum(np.abs(at), scale)

    r = call(x).copy()
    cost = half_square(r)
    status = np.where(np.isfinite(cost), OUT_OF_ITERATIONS, BAD_START).astype(np.int64)
    damping = np.full(n_starts, 1e-3)
    column = np.zeros((n_starts, ndim))  # Marquardt's scaling: largest column norm so far
    central = np.zeros(n_starts, dtype=bool)
    failures = np.zeros(n_starts, dtype=np.int64)
    jacobian = np.zeros((n_starts, r.shape[1], ndim))
    stale = np.ones(n_starts, dtype=bool)
    last_central = np.zeros(n_starts, dtype=bool)  # whether the Jacobian held is a central one at x
    for _ in range(max_iterations):
        active = np.flatnonzero(status == OUT_OF_ITERATIONS)
        if active.size == 0:
            break
        renew = active[stale[active]]
        for want_central in (False, True):
            some = renew[central[renew] == want_central]
            if some.size:
                steps = h(x[some], want_central)
                jacobian[some] = jacobian_of(call, x[some], r[some], lower, upper, steps, want_central)
                last_central[some] = want_central
        stale[active] = False
        norms = np.linalg.norm(jacobian[active], axis=1)
        column[active] = np.maximum(column[active], norms)
        d = np.where(column[active] > 0, column[active], 1.0)

        gradient = np.einsum("smj,sm->sj", jacobian[active], r[active])
        held = ((x[active] <= lower) & (gradient > 0)) | ((x[active] >= upper) & (gradient < 0))
        free_gradient = np.where(held, 0.0, np.abs(gradient))
        cosine = free_gradient / np.maximum(norms * np.sqrt(2 * cost[active])[:, None], 1e-300)
        flat = (cosine.max(axis=1) < TOLERANCE) | (cost[active] == 0)
        status[active[flat]] = CONVERGED_GRADIENT

        lam = damping[active, None] * LADDER
        trial_x, predicted, _ = damped_steps(jacobian[active], r[active], x[active], d, lam, lower, upper)
        trial_r = call(trial_x.reshape(-1, ndim)).reshape(active.size, len(LADDER), -1)
        trial_cost = half_square(trial_r)
        pick = np.argmin(np.where(np.isfinite(trial_cost), trial_cost, np.inf), axis=1)
        rows = np.arange(active.size)
        new_cost = trial_cost[rows, pick]
        new_x = trial_x[rows, pick]
        gain = cost[active] - new_cost
        better = (gain > 0) & ~flat

        small_gain = gain <= ftol * cost[active]
        small_promise = predicted.max(axis=1) <= ftol * cost[active]
        moved = np.max(np.abs(new_x - x[active]) / np.maximum(np.abs(x[active]), scale), axis=1)
        won = active[better]
        x[won], r[won], cost[won] = new_x[better], trial_r[rows, pick][better], new_cost[better]
        damping[won] *= LADDER[pick[better]]
        stale[won] = True
        lost = active[~better & ~flat]
        damping[lost] *= 1e3
        np.clip(damping, LEAST_DAMPING, MOST_DAMPING, out=damping)

        # Forward differences have an error of the order of the step: before calling a start converged, and
        # after a miss, go on with central ones.
        tiny = better & ((small_gain & small_promise) | (moved < TOLERANCE))
        miss = ~better & ~flat
        failures[active] = np.where(miss | tiny, failures[active] + 1, 0)
        first = (miss | tiny) & ~last_central[active]
        central[active[first]] = True
        stale[active[first]] = True
        damping[active[first & miss]] /= 1e3
        settled = tiny & ~first & (failures[active] >= 2)
        status[active[settled]] = np.where(moved[settled] < TOLERANCE, CONVERGED_STEP, CONVERGED_COST)
        hopeless = miss & ~first & (small_promise | (failures[active] >= 6))
        status[active[hopeless]] = np.where(small_promise[hopeless], CONVERGED_COST, CONVERGED_STEP)

    good = np.flatnonzero(np.isfinite(cost))
    left = good[~last_central[good] | stale[good]]
    if left.size:
        jacobian[left] = jacobian_of(call, x[left], r[left], lower, upper, h(x[left], True), True)
    return LeastSquaresFit(
        x=x,
        cost=cost,
        residuals=r,
        jacobian=jacobian,
        at_bound=(x <= lower) | (x >= upper),
        status=status,
        n_evaluations=call.count,
    )


class Counted:
    """The residual function in pieces of at most CHUNK rows, its shape checked, its rows counted."""

    def __init__(self, function: BatchResiduals) -> None:
        self.function, self.count = function, 0

    def __call__(self, x: Array) -> Array:
        parts = []
        for begin in range(0, len(x), CHUNK):
            part = x[begin : begin + CHUNK]
            out = np.asarray(self.function(part), dtype=float)
            if out.ndim != 2 or len(out) != len(part):
                raise LeastSquaresError(
                    f"residuals(x) returned shape {out.shape} for x of shape {part.shape}; it must be (n, m)"
                )
            parts.append(out)
        self.count += len(x)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _check(starts: ArrayLike, bounds: ArrayLike | None) -> tuple[Array, Array, Array]:
    x = np.array(starts, dtype=float, ndmin=2)
    ndim = x.shape[1]
    if x.ndim != 2 or x.size == 0 or not np.isfinite(x).all():
        raise LeastSquaresError(f"starts must be finite numbers of shape (starts, ndim), not {x.shape}")
    box = np.tile([-np.inf, np.inf], (ndim, 1)) if bounds is None else np.asarray(bounds, dtype=float)
    if box.shape != (ndim, 2) or not (box[:, 0] < box[:, 1]).all():
        raise LeastSquaresError(f"bounds must be ({ndim}, 2) with lower < upper, not {box.shape}")
    return np.clip(x, box[:, 0], box[:, 1]), box[:, 0], box[:, 1]


def half_square(r: Array) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        cost = 0.5 * np.einsum("...m,...m->...", r, r)
    return np.where(np.isfinite(cost), cost, np.inf)


def jacobian_of(call: Counted, x: Array, r: Array, lower: Array, upper: Array, h: Array, central: bool) -> Array:
    """(n, m, ndim) finite-difference derivative with steps h (n, ndim).

    One-sided at a bound and beside an x without finite residuals; 0 where neither side has any.
    """
    n, ndim = x.shape
    eye = np.eye(ndim)
    up = np.where(x + h <= upper, h, 0.0)
    down = np.where(x - h >= lower, h, 0.0)
    if not central:
        down = np.where(up > 0, 0.0, down)
    plus = x[:, None, :] + up[:, :, None] * eye
    minus = x[:, None, :] - down[:, :, None] * eye
    if central:
        both = call(np.concatenate([plus, minus]).reshape(-1, ndim)).reshape(2, n, ndim, -1)
        r_plus, r_minus = both[0], both[1]
    else:
        aside = call(np.where(up[:, :, None] > 0, plus, minus).reshape(-1, ndim)).reshape(n, ndim, -1)
        here = np.broadcast_to(r[:, None, :], aside.shape)
        r_plus = np.where(up[:, :, None] > 0, aside, here)
        r_minus = np.where(up[:, :, None] > 0, here, aside)
    x_plus, x_minus = np.einsum("njj->nj", plus), np.einsum("njj->nj", minus)
    bad_plus = ~np.isfinite(r_plus).all(axis=2)
    bad_minus = ~np.isfinite(r_minus).all(axis=2)
    width = np.where(bad_plus, x, x_plus) - np.where(bad_minus, x, x_minus)
    r_plus = np.where(bad_plus[:, :, None], r[:, None, :], r_plus)
    r_minus = np.where(bad_minus[:, :, None], r[:, None, :], r_minus)
    slope = (r_plus - r_minus) / np.where(width == 0, 1.0, width)[:, :, None]
    slope[width == 0] = 0.0
    jacobian = np.moveaxis(slope, 1, 2)
    blocked = np.flatnonzero((width == 0).any(axis=1))
    if blocked.size and not central:
        jacobian[blocked] = jacobian_of(call, x[blocked], r[blocked], lower, upper, h[blocked], True)
    return jacobian


def damped_steps(
    jacobian: Array, r: Array, x: Array, d: Array, lam: Array, lower: Array, upper: Array
) -> tuple[Array, Array, Array]:
    """Steps from each x (n, ndim) at several dampings lam (n, ladder) in the scale d (n, ndim) of its variables:
    (n, ladder, ndim) points in the box, (n, ladder) gains they promise, and (n,) what the linear model without
    damping or box promises."""
    ndim = x.shape[1]
    stacked = np.concatenate([jacobian / d[:, None, :], r[:, :, None]], axis=2)
    if stacked.shape[1] <= ndim:  # fewer residuals than variables: rows of zeros change nothing
        stacked = np.pad(stacked, ((0, 0), (0, ndim + 1 - stacked.shape[1]), (0, 0)))
    triangle = _triangle(stacked)
    small, rhs = triangle[:, :ndim, :ndim], triangle[:, :ndim, ndim]
    u, s, vt = np.linalg.svd(small)
    factor = s[:, None, :] / (s[:, None, :] ** 2 + lam[:, :, None])
    p = -(factor * np.einsum("nji,nj->ni", u, rhs)[:, None, :]) @ vt

    least, most = ((lower - x) * d)[:, None, :], ((upper - x) * d)[:, None, :]
    fixed = np.zeros(p.shape, dtype=bool)
    for _ in range(ndim):  # fix what leaves the box on its side of it and solve again for the others
        out = ~fixed & ((p < least) | (p > most))
        again = np.nonzero(out.any(axis=2))
        if again[0].size == 0:
            break
        fixed |= out
        p = np.clip(p, least, most)
        p[again] = _damped_free(small[again[0]], rhs[again[0]], lam[again], p[again], fixed[again])
    trial = np.clip(x[:, None, :] + p / d[:, None, :], lower, upper)
    linear = (trial - x[:, None, :]) @ np.swapaxes(jacobian, 1, 2)
    predicted = -(linear @ r[:, :, None])[..., 0] - 0.5 * np.einsum("nlm,nlm->nl", linear, linear)
    return trial, predicted, 0.5 * np.einsum("ni,ni->n", rhs, rhs)


def _triangle(matrix: Array) -> Array:
    """R of QR for tall matrices (n, m, k): from the Gram matrix where its digits suffice, which costs a tenth."""
    size = np.maximum(np.linalg.norm(matrix, axis=1), 1e-140)  # squares stay above 0
    gram = np.swapaxes(matrix, 1, 2) @ matrix / (size[:, :, None] * size[:, None, :])
    try:
        lower = np.linalg.cholesky(gram)
        if np.min(np.diagonal(lower, axis1=1, axis2=2)) > 1e-6:
            return np.swapaxes(lower, 1, 2) * size[:, None, :]
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _damped_free(small: Array, rhs: Array, lam: Array, p: Array, fixed: NDArray[np.bool_]) -> Array:
    """Minimise ‖small·p + rhs‖² + lam·‖p‖² over the variables that are not fixed; all arrays (k, ...)."""
    ndim = p.shape[1]
    held = np.where(fixed, p, 0.0)
    target = -(rhs + (small @ held[:, :, None])[..., 0])
    free = np.where(fixed[:, None, :], 0.0, small)
    ridge = np.sqrt(lam)[:, None, None] * np.eye(ndim)
    ridge = np.where(fixed[:, None, :], np.eye(ndim), ridge)  # a fixed number's own equation: change 0
    system = np.concatenate([free, ridge], axis=1)
    q, triangle = np.linalg.qr(system)
    change = np.linalg.solve(triangle, np.swapaxes(q[:, :ndim], 1, 2) @ target[:, :, None])[..., 0]
    return np.where(fixed, held, change)
