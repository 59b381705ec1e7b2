"""Eq. (3) on one branch after a reversal, with the predicate that says where it holds.

At the turning point (u₀, α₀, k₀) every element that slipped last carries s·α₀φ, s the sign of the motion before.
On the branch that follows, elements with φ < φ* = k k₀|u − u₀| / (k α₀ + k₀ α) slip the other way, so with
C(φ) = ∫₀^φ φ̃ and M(φ) = ∫₀^φ f φ̃ df

    F = (k/k₀) F(u₀) − s (α + k α₀/k₀) M(φ*) − s k |u − u₀| (1 − C(φ*)).

With r = α/k and r₀ = α₀/k₀, φ* = |u − u₀| / (r₀ + r). It asks that

(a) φ* grows along the branch, else elements stick again;
(b) every element below φ* was slipping at the turning point;
(c) no element slips on the old way: one that carries s·α₀φ does where r falls so fast that (r₀ − r) φ > |u − u₀|.

F(u₀) it does not give: that is for the sliders stage or the element model (paper-notes).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array


def slip_front(displacement_mm: Array, alpha: Array, k_N_mm: Array) -> Array:
    """φ* in N along a monotone branch whose first sample is the turning point; all arrays (samples,)."""
    u, a, k = (np.asarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm))
    return k * k[0] * np.abs(u - u[0]) / (k * a[0] + k[0] * a)


def branch_holds(
    displacement_mm: Array, alpha: Array, k_N_mm: Array, slipped_to_N: float, largest_N: float = np.inf
) -> NDArray[np.bool_]:
    """Where Eq. (3) holds along the branch, (samples,) bool: up to the first breach of (a), (b) or (c).

    slipped_to_N : the largest φ that was slipping at the turning point (np.inf: all were). Elements beyond it are
        taken to be no nearer to slipping on than those at it, as after a first loading.
    largest_N : the largest φ there is.
    """
    u, a, k = (np.asarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm))
    step, ratio, front = np.diff(u), a / k, slip_front(u, a, k)
    good = np.r_[True, (np.diff(front) >= 0.0) & (step * np.sign(step[0]) > 0.0)]
    good &= (front <= slipped_to_N) | (slipped_to_N >= largest_N)
    loaded = min(slipped_to_N, largest_N)  # elements up to here carry all they can
    good &= (ratio >= ratio[0]) | ((ratio[0] - ratio) * loaded <= np.abs(u - u[0]))
    return np.logical_and.accumulate(good)


def branch_force(
    displacement_mm: Array,
    alpha: Array,
    k_N_mm: Array,
    force_0_N: float,
    cumulative: Callable[[Array], Array],
    first_moment: Callable[[Array], Array],
) -> Array:
    """Friction force (samples,) in N by Eq. (3) on a branch whose first sample is the turning point with force_0_N.

    cumulative, first_moment : C(φ) and M(φ) of the slip-force distribution. Check :func:`branch_holds` first.
    """
    u, a, k = (np.asarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm))
    front = slip_front(u, a, k)
    s = -np.sign(u[-1] - u[0])  # the motion before the turning point
    return (
        k / k[0] * force_0_N
        - s * (a + k / k[0] * a[0]) * first_moment(front)
        - s * k * np.abs(u - u[0]) * (1.0 - cumulative(front))
    )
