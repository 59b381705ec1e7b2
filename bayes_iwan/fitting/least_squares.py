"""Damped Gauss–Newton steps from many places at once, through one batch function.

The forward model takes many parameter vectors at a time, so the cheapest way to fit from many starts is to advance them
all in lock-step: one batch call for all their Jacobians, one for all their trial steps. Nothing here knows what the
residuals mean.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError

BatchResiduals = Callable[[Array], Array]

#: most rows in one call
CHUNK = 4096


class LeastSquaresError(InputError):
    """The starts, bounds or residuals cannot be used."""


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
