"""The element model: a finite number of Jenkins elements, updated one by one. It is what others are compared with, not
the fast path.

It has none of the limits of the closed form, Eq. (3), and none of the bookkeeping of the sliders stage. Its only
error is that of a finite number of elements.
"""

import numba as nb
import numpy as np

from bayes_iwan.arrays import Array


@nb.njit(cache=True, error_model="numpy")
def _elements(u, alpha, k, phi, weight, passes, out):
    x = np.zeros(phi.size)
    for _ in range(passes):
        for i in range(u.size):
            limit = alpha[i] / k[i]
            total = 0.0
            for j in range(phi.size):
                e = min(max(u[i] - x[j], -limit * phi[j]), limit * phi[j])
                x[j] = u[i] - e
                total += weight[j] * e
            out[i] = k[i] * total


def element_force(
    displacement_mm: Array, alpha: Array, k_N_mm: Array, slip_force_N: Array, weight: Array, passes: int = 1
) -> Array:
    """Friction force in N, (samples,), of elements that start relaxed at u = 0.

    displacement_mm, alpha, k_N_mm : (samples,); slip_force_N, weight : (elements,), weights summing to one.
    passes : how often the motion is repeated; the last pass is returned (2 for a steady loop).
    """
    u, a, k, phi, w = (
        np.ascontiguousarray(x, dtype=float) for x in (displacement_mm, alpha, k_N_mm, slip_force_N, weight)
    )
    if not (u.shape == a.shape == k.shape and u.ndim == 1):
        raise ValueError(f"displacement, alpha and k must be (samples,): got {u.shape}, {a.shape}, {k.shape}")
    if phi.shape != w.shape or phi.ndim != 1:
        raise ValueError(f"slip forces and weights must be (elements,): got {phi.shape}, {w.shape}")
    out = np.empty_like(u)
    _elements(u, a, k, phi, w, passes, out)
    return out


def equal_probability_sliders(survival, count: int, top_N: float) -> Array:
    """Slip forces (count,) in N that halve `count` equal shares of probability; survival(phi) -> S, scalar draw."""
    phi = np.linspace(0.0, np.sqrt(top_N), 20001) ** 2
    below = 1.0 - survival(phi)
    return np.interp((np.arange(count) + 0.5) / count, below, phi)
