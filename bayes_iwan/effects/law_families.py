"""Functions of one parameter that contain the classic laws of a kind and what lies between them."""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.models import Motion
from bayes_iwan.models.kernels import pointwise
from bayes_iwan.models.parameter import Distribution

#: Gauss–Legendre points and weights (they sum to one) of an average over a block of cycles
_POINTS, _WEIGHTS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]), np.array([5.0, 8.0, 5.0]) / 18.0


@cache
def about(value: float, sd: float) -> Distribution:
    """A normal prior of a parameter that changes a law's form, with the classical law in its middle."""
    return stats.norm(loc=value, scale=sd)


@cache
def lognormal(median: float, spread: float) -> Distribution:
    """A log-normal prior: its median, ×/÷ e^spread at one standard deviation."""
    return stats.lognorm(s=spread, scale=median)


def falling(x: Array, tail: Array) -> Array:
    """(1 + q x)^(−1/q), x ≥ 0: e^(−x) at q → 0, 1/(1 + x) at q = 1, all but logarithmic for large q; for q < 0 it
    reaches zero at x = 1/|q| (Tsallis' q-exponential)."""
    return _by_draw(pointwise.falling, x, tail)


def growing(x: Array, power: Array) -> Array:
    """((1 + x)^q − 1)/q, x ≥ 0: ln(1 + x) at q → 0, x at q = 1, saturating for q < 0 (Box and Cox)."""
    return _by_draw(pointwise.growing, x, power)


def power_of(x: Array, exponent: Array) -> Array:
    """|x|^p, 0 at x = 0."""
    return _by_draw(pointwise.power, x, exponent)


def _by_draw(law: Callable[[Array, Array, Array], None], x: Array, number: Array) -> Array:
    """A compiled law of samples x (1 or draws, …), or (…) for all draws, and each draw's number (draws or 1, 1, …)."""
    x = x.reshape((1,) * (number.ndim - x.ndim) + x.shape)
    draws = max(len(x), len(number))
    out = np.empty((draws, *x.shape[1:]))
    numbers = np.ascontiguousarray(np.broadcast_to(number.reshape(-1), draws))
    law(np.ascontiguousarray(x).reshape(len(x), -1), numbers, out.reshape(draws, -1))
    return out


def over_block(motion: Motion, law: Callable[[Array], Array]) -> Array:
    """The average of a law of the cycle number over the cycles of each loop: law takes (loops,) or more axes before."""
    return sum(w * law(np.maximum(motion.cycle + 0.5 * x * motion.span_cycles, 0.0)) for x, w in zip(_POINTS, _WEIGHTS))


def decay_over_block(motion: Motion, per_cycle: Array) -> Array:
    """The average of exp(−r n) over the cycles of each loop, exactly; r = per_cycle (…, loops)."""
    half = np.minimum(0.5 * motion.span_cycles, motion.cycle)  # no cycle before the record's first
    first, width = motion.cycle - half, per_cycle * np.maximum(2.0 * half, 1e-9)
    return np.exp(-per_cycle * first) * -np.expm1(-width) / width


#: what a slow change takes within the records, as it is reported
LOST = "lost_in_records"


def lost_within(left: Array, blocks: Motion) -> dict[str, tuple[Array, str]]:
    """Of what a slow change leaves in each block of cycles, (draws, blocks, 1): the share that is lost from the first
    block of a record to its last, on the mean over the tests of several blocks, (draws,); negative where what has faded
    before the first block is over is regained within the record. Nothing where no test has several."""
    lost = []
    for test in np.unique(blocks.test):
        at = np.flatnonzero(blocks.test == test)
        at = at[np.argsort(blocks.cycle[at])]
        if at.size > 1:
            lost.append(1.0 - left[:, at[-1], 0] / left[:, at[0], 0])
    return {LOST: (np.mean(lost, axis=0), "-")} if lost else {}
