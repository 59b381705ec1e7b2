"""What lags behind a signal, by time or by its path: periodic solutions, exact for straight pieces."""

import math

import numba as nb

from bayes_iwan.models.kernels.vectors import apart_and_wide

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
#: passes over a period until its end meets its start: one suffices for equal times, a few for others
_PASSES = 25


@_jit
def _period(signal, at, stay_up, lead_up, stay_down, lead_down, out):
    """One period from the value `at` on; returns its end and the time that has passed in relaxation times. The signal
    is straight between samples, for which each step is exact."""
    n = signal.size
    before = signal[n - 1]
    decay = 0.0
    for i in range(n):
        now = signal[i]
        if now > at:
            stay, lead = stay_up, lead_up
        else:
            stay, lead = stay_down, lead_down
        at = now - (now - before) * lead + (at - before) * stay
        decay -= math.log(max(stay, 1e-300))
        out[i] = at
        before = now
    return at, decay


@_jit
def _lead(step):
    """(1 − e^(−x))/x; nought where x is as good as endless, so that what follows at once does not even round."""
    return -math.expm1(-step) / step if step < 1e9 else 0.0


@_jit
def relaxed(signal, step_up, step_down, out):
    """τ dx/dt = signal − x, periodic, into out (draws, loops, samples); signal : (1 or draws, loops, samples), straight
    between samples; step_up, step_down : (draws, loops), a sample's duration over τ where x rises and where it falls.
    """
    apart_and_wide()
    for d in range(out.shape[0]):
        m = d % signal.shape[0]
        for j in range(out.shape[1]):
            up, down = step_up[d, j], step_down[d, j]
            stay_up, stay_down = math.exp(-up), math.exp(-down)
            lead_up, lead_down = _lead(up), _lead(down)
            at = signal[m, j].mean()
            for _ in range(_PASSES):
                end, decay = _period(signal[m, j], at, stay_up, lead_up, stay_down, lead_down, out[d, j])
                off = (end - at) / -math.expm1(-decay)
                at += off
                if not abs(off) > 1e-12:
                    break


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
