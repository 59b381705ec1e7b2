"""Levenberg–Marquardt from many starts at once, of a cost in nats, to a tenth of a nat or as asked.

Most evaluations of a search from many starts go into digits that nobody asks for and into starts that end nowhere. So a
start ends once its linear model promises next to nothing, and is given up where it falls behind the best, gains too
little to catch up, or runs into another's local optimum. Steps are scaled as Moré's (Numerical Analysis, Lecture Notes
in Mathematics 630, 1978, 105), four dampings at a time; Jacobians are forward differences, and where residuals curve
the one at hand corrects its own steps, since a new one costs as many evaluations as there are variables.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.fitting.least_squares import (
    BatchResiduals,
    Counted,
    LeastSquaresError,
    damped_steps,
    half_square,
    jacobian_of,
)

#: damping factors tried together in every iteration, as multiples of the current one: a Jacobian costs ndim
#: evaluations, so four trial steps are cheap, and the best of four saves whole iterations in curved residuals
LADDER = np.array([1e-2, 1e-1, 1.0, 10.0])
LEAST_DAMPING, MOST_DAMPING = 1e-14, 1e12
#: finite-difference step over max(|x|, 1)
STEP = 1e-6
#: a start has arrived if its linear model promises no more nats than this, or two steps in a row gained no more,
#: unless asked for otherwise
ENOUGH = 0.1
#: a start that is so many nats behind the best one and promises no better is given up, and any after LATE iterations
BEHIND, LATE = 30.0, 20
#: starts nearer than this in every variable, and by no more nats than BEHIND, are at one local optimum: the better one
#: goes on
NEAR = 0.05
#: steps in vain in a row after which a start has arrived where it can; each is damped so much more
IN_VAIN, MORE = 4, 1e3
#: a step that brings less than this share of what the linear model promised is corrected for the residuals' curvature,
#: where the correction is shorter than this share of the step
STRAIGHT, CURVED = 0.75, 0.75
#: a start behind the best is given up, after FEW iterations, if CATCH times what it will gain, its gains falling off as
#: they last did, does not catch up
CATCH, FEW = 3.0, 4


@dataclass(frozen=True)
class Descent:
    """Where each start ended: x (starts, ndim), cost (starts,) half the squared residuals (inf where they were never
    finite), arrived (starts,) False where it was given up or ran out of iterations, evaluations in all."""

    x: Array
    cost: Array
    arrived: NDArray[np.bool_]
    n_evaluations: int

    @property
    def best(self) -> int:
        """Index of the start that ended with the lowest cost."""
        return int(np.argmin(self.cost))


def descend(
    residuals: BatchResiduals,
    starts: Array,
    box: Array,
    iterations: int,
    known: Array | None = None,
    enough: float = ENOUGH,
    give_up: bool = True,
) -> Descent:
    """Lower ½‖residuals(x)‖² from every start, all in lock-step.

    residuals : maps (n, ndim) to (n, m), in units of their noise; a row that is not finite marks an x without a model.
    starts, box : (starts, ndim), clipped into the box (ndim, 2); variables are of the order of one.
    iterations : at most so many steps of each start. known : (m, ndim) the Jacobian at the first start, where it is at
    hand. enough : nats to which an optimum is sought. give_up : whether starts are given up that will not reach the
    best one: where only the best optimum counts.
    Raises LeastSquaresError for starts that are not finite, or residuals of another shape than (n, m).
    """
    lower, upper = box.T
    x = np.clip(np.asarray(starts, dtype=float), lower, upper)
    if not np.isfinite(x).all():
        raise LeastSquaresError("starts must be finite numbers")
    n, ndim = x.shape
    call = Counted(residuals)
    r = call(x)
    cost = half_square(r)
    alive, arrived = np.isfinite(cost), np.zeros(n, dtype=bool)
    damping, column = np.full(n, 1e-3), np.zeros((n, ndim))
    jacobian = np.zeros((n, r.shape[1], ndim))
    stale = np.ones(n, dtype=bool)
    if known is not None:
        jacobian[0], stale[0] = known, False
    idle = np.zeros(n, dtype=np.int64)
    gains = np.full((n, 2), np.inf)  # of the last two steps
    for iteration in range(iterations):
        alive &= ~_twins(x, cost, alive)
        active = np.flatnonzero(alive)
        if active.size == 0:
            break
        renew = active[stale[active]]
        if renew.size:
            h = STEP * np.maximum(np.abs(x[renew]), 1.0)
            jacobian[renew] = jacobian_of(call, x[renew], r[renew], lower, upper, h, central=False)
            stale[renew] = False
        column[active] = np.maximum(column[active], np.linalg.norm(jacobian[active], axis=1))
        d = np.where(column[active] > 0, column[active], 1.0)
        trial, promised, most = damped_steps(
            jacobian[active], r[active], x[active], d, damping[active, None] * LADDER, lower, upper
        )
        there = most <= enough
        behind = cost[active] - cost.min() > BEHIND
        late = behind & ((cost[active] - most - cost.min() > BEHIND) | (iteration >= LATE))
        to_come = CATCH * _to_come(gains[active], iterations - iteration)
        lost = late | ((iteration >= FEW) & (cost[active] - cost.min() > np.maximum(to_come, enough)))
        arrived[active[there]] = True
        done = there | (lost & give_up)
        alive[active[done]] = False
        go = ~done
        active, trial, promised = active[go], trial[go], promised[go]
        if active.size == 0:
            continue

        new_r, new_cost = np.full((*trial.shape[:2], r.shape[1]), np.nan), np.full(promised.shape, np.inf)
        tried = np.ones(promised.shape, dtype=bool)  # of steps that promise the same the most damped one
        tried[:, :-1] = np.abs(np.diff(promised, axis=1)) > 0.2 * enough
        new_r[tried] = call(trial[tried])
        new_cost[tried] = half_square(new_r[tried])
        fell_short = cost[active] - new_cost.min(axis=1) < STRAIGHT * promised.max(axis=1)
        curves = np.flatnonzero(fell_short & np.isfinite(new_cost).any(axis=1))
        if curves.size:
            who = active[curves]
            corrected, short = _corrected(
                jacobian[who], x[who], r[who], trial[curves], new_r[curves], d[go][curves], damping[who, None] * LADDER
            )
            start, rung = np.nonzero(short & np.isfinite(new_cost[curves]))
            if start.size:
                point = np.clip(corrected[start, rung], lower, upper)
                its_r = call(point)
                its_cost = half_square(its_r)
                better = its_cost < new_cost[curves[start], rung]
                to = curves[start[better]], rung[better]
                trial[to], new_r[to], new_cost[to] = point[better], its_r[better], its_cost[better]
        at, pick = np.arange(active.size), np.argmin(new_cost, axis=1)
        gain = cost[active] - new_cost[at, pick]
        won = gain > 0.0
        some, best = active[won], pick[won]
        gains[some] = np.stack([gains[some, 1], gain[won]], axis=1)
        x[some], r[some], cost[some] = trial[won, best], new_r[won, best], new_cost[won, best]
        damping[some] *= LADDER[best]
        damping[active[~won]] *= MORE  # where nothing has moved the Jacobian is as good as it was
        np.clip(damping, LEAST_DAMPING, MOST_DAMPING, out=damping)
        stale[some] = True
        idle[active] = np.where(gain > enough, 0, idle[active] + 1)
        done = idle[active] >= np.where(won, 2, IN_VAIN)
        arrived[active[done]] = True
        alive[active[done]] = False
    return Descent(x, cost, arrived, call.count)


def _corrected(
    jacobian: Array, x: Array, r: Array, trial: Array, new_r: Array, d: Array, damping: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Where the same linear model leads from what it got wrong at trial points (starts, ladder, ndim), and whether each
    of these corrections is short enough to be believed (geodesic acceleration: Transtrum and Sethna, arXiv 1201.5885).
    """
    scaled = jacobian / d[:, None, :]
    turned = np.swapaxes(scaled, 1, 2)
    step = (trial - x[:, None, :]) * d[:, None, :]
    wrong = np.where(np.isfinite(new_r), new_r - r[:, None, :], 0.0) - step @ turned
    ridge = (turned @ scaled)[:, None] + damping[:, :, None, None] * np.eye(x.shape[1])
    back = -np.linalg.solve(ridge, (wrong @ scaled)[..., None])[..., 0]
    short = np.linalg.norm(back, axis=2) <= CURVED * np.linalg.norm(step, axis=2)
    return trial + back / d[:, None, :], short


def _to_come(gains: Array, left: int) -> Array:
    """(n,) what steps will gain in all if they fall off as the last two did; gains (n, 2)."""
    known = np.asarray(np.isfinite(gains).all(axis=1))
    before, last = np.where(known[:, None], gains, 1.0).T
    steps = np.where(last < before, last / np.maximum(before - last, 1e-9 * before), left)
    return np.where(known, last * np.minimum(steps, left), np.inf)


def _twins(x: Array, cost: Array, alive: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(starts,) those that lie at the local optimum of a better one."""
    out = np.zeros(len(x), dtype=bool)
    order = np.argsort(cost)
    for i, one in enumerate(order):
        better = order[:i]
        near = np.max(np.abs(x[better] - x[one]), axis=1, initial=0.0) < NEAR
        out[one] = alive[one] and bool(np.any(near & (cost[one] - cost[better] < BEHIND) & ~out[better]))
    return out
