"""The sliders stage: friction force of infinitely many Jenkins elements, without discretising them.

All elements share the stiffness k(t); element φ slips at the force α(t)·φ. Its spring deflection is
``e(φ) = u − x(φ)``, x being the slider's position, and one step of motion is

    e(φ) ← clip(e(φ) + du, −r φ, +r φ),        r = α / k

(or, with friction that depends on the direction, between −r(1 − a) φ and r(1 + a) φ).

Whatever the motion, x stays a *continuous, piecewise linear* function of φ with few pieces: one step moves e up or
down and cuts it with a cone. So the state is a stack of pieces x = p + m φ, as the Preisach model's memory is a
staircase, and the force follows from integration by parts (e(0) = 0):

    F = k ∫ e(φ) φ̃(φ) dφ = k ∫ e'(φ) S(φ) dφ = −k Σ_pieces m ΔL,      L(φ) = ∫₀^φ S = E[min(Φ, φ)],

where S is the survival function of the slip-force distribution, Eq. (10). L is one smooth function per draw,
tabulated once (:mod:`bayes_iwan.physics.slip_force`), so nothing is summed over elements. Holes and elements that
stick again while others slip (α rising or falling fast) are cut like everything else: nothing assumes that slip
spreads from φ = 0. :mod:`bayes_iwan.physics.elements` is the judge of it in the tests.

State in memory: the front piece [0, front] with x = u − q φ is held in scalars; the pieces beyond it lie in a stack
(rows of `st`, top = next to the front) with columns p, m, end, x(end), L(end), rest, where rest = −Σ m ΔL of all
pieces beyond `end`. The bottom row is the tail, end = ∞, of elements that never slipped.

The functions here call each other, so they stay in one file (numba's cache does not see changes elsewhere).
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array

#: pieces kept; when a wild motion makes more, the least important vertex is dropped
MAX_PIECES = 64
#: a table of L covers this many octaves of φ below its top, each by the same power of two of equal cells
OCTAVES = 20
#: even samples walked from rest, with both ends of the stroke, before a closed loop
RUNIN_SAMPLES = 16
P, M, END, X_END, L_END, REST = range(6)

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@_jit
def _limited_mean(phi, table, scale, shift):
    """L(φ) by the cubic of φ's cell; the cell's number and the place in it are the bits of φ/top, a double.

    Below the lowest octave L is a parabola through 0, beyond the top S has died out. NaN gives NaN.
    """
    x = np.float64(phi * scale)
    cells = table.shape[0]
    bits = x.view(np.int64)
    i = (bits >> shift) - ((np.int64(1023) << (52 - shift)) - cells)
    if i < 0:
        y, value, slope = x * 2.0**OCTAVES, table[0, 0], table[0, 1] * (np.int64(1) << (52 - shift))
        return y * (2.0 * value - slope + y * (slope - value))
    if i >= cells:
        last = cells - 1
        return table[last, 0] + table[last, 1] + table[last, 2] + table[last, 3] + 0.0 * phi
    one = np.int64(1) << shift
    w = (bits & (one - 1)) * (1.0 / one)
    return table[i, 0] + w * (table[i, 1] + w * (table[i, 2] + w * table[i, 3]))


@_jit
def _drop_least(top, st):
    """Drop the vertex whose loss changes x(φ) least (smallest triangle), and mend the sums above it.

    The triangle is taken over L, not φ: where few elements are left a vertex matters little.
    The chord that replaces two pieces stays inside the cone, which is convex.
    """
    least, smallest = 2, np.inf
    for j in range(2, top - 1):  # vertex between piece j and piece j − 1; piece j begins at row j + 1
        a, b = st[j, L_END] - st[j + 1, L_END], st[j - 1, L_END] - st[j + 1, L_END]
        area = abs(a * (st[j - 1, X_END] - st[j + 1, X_END]) - b * (st[j, X_END] - st[j + 1, X_END]))
        if area < smallest:
            least, smallest = j, area
    start, start_x = st[least + 1, END], st[least + 1, X_END]
    width = st[least - 1, END] - start
    slope = (st[least - 1, X_END] - start_x) / width if width > 0.0 else 0.0
    st[least - 1, P], st[least - 1, M] = start_x - slope * start, slope
    for j in range(least, top - 1):
        for column in range(6):
            st[j, column] = st[j + 1, column]
        st[j, REST] = st[j - 1, REST] - st[j - 1, M] * (st[j - 1, L_END] - st[j, L_END])
    return top - 1


@_jit
def _push(top, p, m, end, x_end, ell, st):
    """Stack the piece x = p + m φ that ends at φ = end; returns the number of pieces."""
    if top == MAX_PIECES:
        top = _drop_least(top, st)
    st[top, P], st[top, M], st[top, END], st[top, X_END], st[top, L_END] = p, m, end, x_end, ell
    st[top, REST] = st[top - 1, REST] - st[top - 1, M] * (st[top - 1, L_END] - ell)
    return top + 1


@_jit
def _cut(top, u, up, down, front, front_x, st, work, table, scale, shift):
    """Cut the whole polyline with the cone −down·φ ≤ e ≤ up·φ: the general case, where more than the front slips.

    Rare (entered only when a vertex beyond the front lies outside the cone), so it may be slow.
    Returns the number of stacked pieces and the new front vertex.
    """
    count = 0
    last_side, last_phi, last_e = 0, 0.0, 0.0
    for j in range(top, 0, -1):  # vertices from small φ to large; row j − 1 of the stack begins there
        phi = front if j == top else st[j, END]
        x = front_x if j == top else st[j, X_END]
        e = u - x
        side = 1 if e > up * phi else (-1 if e < -down * phi else 0)
        for s in (last_side, side):  # leave the old side of the cone, then meet the new one
            r = up if s > 0 else down
            if s != 0 and last_side != side:
                a, b = s * last_e - r * last_phi, s * e - r * phi
                at = last_phi + (phi - last_phi) * (a / (a - b))
                work[count, 0], work[count, 1] = at, u - s * r * at
                count += 1
        if side == 0:
            work[count, 0], work[count, 1] = phi, x
            count += 1
        last_side, last_phi, last_e = side, phi, e
    if last_side != 0:  # beyond the last vertex e is constant: it enters the cone later
        work[count, 0], work[count, 1] = last_side * last_e / (up if last_side > 0 else down), u - last_e
        count += 1
    st[0, P] = st[0, X_END] = work[count - 1, 1]
    top = 1
    for j in range(count - 1, 0, -1):  # from the tail to the front
        width = work[j, 0] - work[j - 1, 0]
        slope = (work[j, 1] - work[j - 1, 1]) / width if width > 0.0 else 0.0
        ell = _limited_mean(work[j, 0], table, scale, shift)
        top = _push(top, work[j, 1] - slope * work[j, 0], slope, work[j, 0], work[j, 1], ell, st)
    return top, work[0, 0], work[0, 1]


@_jit
def _way(u, closed, at, where, off):
    """The displacements to pass: a run-in from rest if the loop is closed, then all samples; extremes with their
    turning points.

    A reversal between two samples would be missed by up to an eighth of a second difference, which every force after
    it would feel. So the vertex of the parabola through the three samples is put in, before or after the middle one.
    Fills at (displacement), where (sample it belongs to), off (samples from there to it; 0 for the sample itself).
    Returns how many there are and how many of them belong to the run-in.
    """
    n, count, first = u.size, 0, 0
    high, low = np.argmax(u), np.argmin(u)
    for step in range(-n if closed else 0, n):
        i = step % n
        if step < 0 and i != high and i != low and i % max(1, n // RUNIN_SAMPLES) != 0:
            continue
        tau, turn = 0.0, 0.0
        if closed or 0 < i < n - 1:
            rise, fall = u[i] - u[i - 1 if i > 0 else n - 1], u[i] - u[i + 1 if i < n - 1 else 0]
            if rise * fall > 0.0:
                tau = 0.5 * (rise - fall) / (rise + fall)
                turn = u[i] + 0.125 * (rise - fall) ** 2 / (rise + fall)
        if step == 0:
            first = count
        if tau < 0.0:
            at[count], where[count], off[count] = turn, i, tau
            count += 1
        at[count], where[count], off[count] = u[i], i, 0.0
        count += 1
        if tau > 0.0:
            at[count], where[count], off[count] = turn, i, tau
            count += 1
    return count, first


@_jit
def _loop(at, where, off, first, alpha, k, asymmetry, table, phi_top, parallel, out):
    """Follow one way from rest; the force at its samples from entry `first` on goes into out."""
    st, work = np.empty((MAX_PIECES, 6)), np.empty((2 * MAX_PIECES + 1, 2))
    shift, scale = 52, 1.0 / phi_top
    while OCTAVES << (52 - shift) < table.shape[0]:
        shift -= 1
    st[0, P] = st[0, M] = st[0, X_END] = st[0, REST] = 0.0  # virgin: x = 0 for every φ, no front, only the tail
    st[0, END] = np.inf
    st[0, L_END] = _limited_mean(2.0 * phi_top, table, scale, shift)
    top, last, q, front = 1, 0.0, 0.0, 0.0
    for step in range(at.size):
        now, i, tau = at[step], where[step], off[step]
        du, r = now - last, alpha[i] / k[i]
        if not r > 0.0:  # a cone turned inside out has no meaning: no force then
            r = np.nan
        if tau != 0.0:  # r goes on along its own side: at the turning point |u̇| has a kink
            j = i - 1 if tau > 0.0 else (i + 1 if i < alpha.size - 1 else 0)
            r += abs(tau) * max(r - alpha[j] / k[j], -r)
        up, down = r * (1.0 + asymmetry), r * (1.0 - asymmetry)
        if du != 0.0:
            s = 1.0 if du > 0.0 else -1.0
            r = up if du > 0.0 else down
            # the front piece is x = last − qφ; it slips on as a whole if its end lies beyond the cone
            if s * (du + q * front) <= r * front:
                if front > 0.0:
                    ell = _limited_mean(front, table, scale, shift)
                    top = _push(top, last, -q, front, last - q * front, ell, st)
            else:
                while s * (now - st[top - 1, X_END]) > r * st[top - 1, END]:
                    top -= 1
            p, m = st[top - 1, P], st[top - 1, M]
            if r + s * m > 1e-9 * r:
                front = s * (now - p) / (r + s * m)
            else:  # the piece lies along the cone: it slips as a whole
                front = st[top - 1, END]
            q = s * r
        beyond = du == 0.0 and (q > up or -q > down)  # at rest, and the grip falls below what the front carries?
        for j in range(1, top):  # or does a vertex beyond the front lie outside the cone?
            e, limit = now - st[j, X_END], st[j, END] * (1.0 + 1e-12)
            beyond |= e > up * limit or -e > down * limit
        if beyond:
            top, front, x = _cut(top, now, up, down, front, now - q * front, st, work, table, scale, shift)
            q = (now - x) / front if front > 0.0 else 0.0
        last = now
        if step >= first and tau == 0.0:
            ell = _limited_mean(front, table, scale, shift)
            inner = q * ell - st[top - 1, M] * (st[top - 1, L_END] - ell) + st[top - 1, REST]
            out[i] = k[i] * inner + parallel * now


@_jit
def friction(u, alpha, k, asymmetry, closed, tables, phi_top, parallel, out):
    """Friction force of all loops of all draws, plus a parallel spring.

    u : (1 or draws, loops, samples), mm; between samples α, k and, but for its turning points, u are taken as monotone.
    alpha, k, out : (draws, loops, samples); relative normal force and stiffness in N/mm; out in N.
    asymmetry : (draws,) in (−1, 1); an element slips at αφ(1 + asymmetry) where u rises, αφ(1 − asymmetry) where it
        falls.
    closed : the loops repeat themselves, else they are records from rest at u = 0. What a cycle does to an element is
        a composition of clips, so a clip, so idempotent: one run-in reaches the steady state, on a few samples.
    tables : (draws, cells, 4), phi_top : (draws,), from :mod:`bayes_iwan.physics.slip_force`.
    parallel : (draws,) stiffness in N/mm of a spring beside it; zeros for friction alone.
    """
    longest = 4 * out.shape[2]
    at, where, off = np.empty(longest), np.empty(longest, np.int64), np.empty(longest)
    count = first = 0
    for j in range(out.shape[1]):
        for d in range(out.shape[0]):
            if d < u.shape[0]:  # one motion for all draws, or one each
                count, first = _way(u[d, j], closed, at, where, off)
            _loop(
                at[:count],
                where[:count],
                off[:count],
                first,
                alpha[d, j],
                k[d, j],
                asymmetry[d],
                tables[d],
                phi_top[d],
                parallel[d],
                out[d, j],
            )


def way(displacement_mm: Array, closed: bool) -> tuple[Array, NDArray[np.int64], Array]:
    """The displacements (entries,) that one loop or record passes, turning points put in, without any run-in.

    Returns them with the sample (entries,) each belongs to and its distance from it in samples, 0 for the sample
    itself. displacement_mm : (samples,).
    """
    longest = 4 * len(displacement_mm)
    at, where, off = np.empty(longest), np.empty(longest, np.int64), np.empty(longest)
    count, first = _way(np.ascontiguousarray(displacement_mm, dtype=float), closed, at, where, off)
    return at[first:count], where[first:count], off[first:count]
