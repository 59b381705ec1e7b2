"""What lags behind a signal by its path, not by time: the periodic solution."""

from __future__ import annotations

import math

import numba as nb

from bayes_iwan.models.kernels.vectors import apart_and_wide

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@_jit
def lagging(signal, path, out):
    """ℓ dz/ds = sgn(dx) − z, ds = |dx|, periodic, into out (draws, loops, samples): between −1 and 1, whatever the
    speed. signal x : (1 or draws, loops, samples), straight between samples, for which each step is exact; path ℓ > 0 :
    (draws,), in the signal's unit."""
    apart_and_wide()
    n = out.shape[2]
    for d in range(out.shape[0]):
        m = d % signal.shape[0]
        for j in range(out.shape[1]):
            x = signal[m, j]
            end, way = 0.0, 0.0  # where a period from z = 0 ends, and how long its way is
            before = x[n - 1]
            for i in range(n):
                s = abs(x[i] - before) / path[d]
                stays = math.exp(-s)
                end = end * stays + (1.0 - stays if x[i] > before else stays - 1.0)
                way += s
                before = x[i]
            at = end / -math.expm1(-way) if way > 0.0 else 0.0
            for i in range(n):
                stays = math.exp(-abs(x[i] - before) / path[d])
                at = at * stays + (1.0 - stays if x[i] > before else stays - 1.0)
                out[d, j, i] = at
                before = x[i]
