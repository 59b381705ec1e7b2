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
tabulated once (:mod:`bayes_iwan.models.slip_force`), so nothing is summed over elements. The pieces do not depend on L:
they are followed once for however many tables, and F is linear in L. Holes and elements that
stick again while others slip (α rising or falling fast) are cut like everything else: nothing assumes that slip
spreads from φ = 0. `analyses/jenkins_elements.py` is what tests compare it with.

State in memory: the front piece [0, front] with x = u − q φ is held in scalars; the pieces beyond it lie in a stack
(rows of `st`, top = next to the front) with columns p, m, end, x(end), node. The bottom row is the tail, end = ∞, of
elements that never slipped. What the pieces beyond the front hold, −Σ m ΔL, is Σ w L(end) over their ends, w = m beyond
less m before. Each row's end is a node of a tree, which its rows below are the parents of: whatever was once in the
stack is kept there, for tables to be read along it when the way has been followed.

The functions here call each other, so they stay in one file (numba's cache does not see changes elsewhere).
"""

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.models.kernels.vectors import apart_and_wide

#: pieces kept; when a wild motion makes more, the least important vertex is dropped
MAX_PIECES = 64
#: a table of L covers this many octaves of φ below its top, each by the same power of two of equal cells
OCTAVES = 20
#: what lies this share of r beyond its chord, or less, lies on it
ON_CHORD = 1e-9
#: entries that the front glides over at most before the next look at what lies beyond it
LONGEST = 64
P, M, END, X_END, NODE = range(5)
#: of a node
PLACE, WEIGHT, PARENT = range(3)

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
#: for what allocates nothing: without it numba counts references to every array at every call, 100 ns each time
_part = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, _nrt=False)  # type: ignore[call-overload]
#: a part that becomes its caller's own code: passing on a dozen arrays costs as much as a short stretch of the way
_inner = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, _nrt=False, forceinline=True)  # type: ignore[call-overload]


@_part
def _in_a_row(table, shift, row):
    """A table (cells, 4) in one row of numbers, before it the parabola through 0 for what lies below its octaves."""
    apart_and_wide()
    low, low_slope = table[0, 0], table[0, 1] * (np.int64(1) << (52 - shift))
    row[0], row[1], row[2], row[3] = 0.0, 2.0 * low - low_slope, low_slope - low, 0.0
    for i in range(table.shape[0]):
        for c in range(4):
            row[4 * i + 4 + c] = table[i, c]


@_inner
def _limited_mean(phi, row, scale, shift):
    """L(φ) by the cubic of φ's cell, whose number and the place in it are the bits of φ/top, a double.

    Beyond the top, where S has died out, that is the last cell's end; NaN stays NaN. There is no branch, so a loop
    over φ runs in vectors.
    """
    x = np.float64(phi * scale)
    bits, width, cells = x.view(np.int64), np.int64(1) << shift, row.size // 4 - 1
    i = (bits >> shift) - ((np.int64(1023) << (52 - shift)) - cells - 1)
    place = (bits & (width - 1)) * (1.0 / width)
    place = place if i <= cells else 1.0 + 0.0 * phi
    place = place if i > 0 else x * 2.0**OCTAVES
    c, one, two, three = np.uint64(4 * min(max(i, 0), cells)), np.uint64(1), np.uint64(2), np.uint64(3)
    return row[c] + place * (row[c + one] + place * (row[c + two] + place * row[c + three]))


@_part
def _drop_least(top, st, nodes, row, scale, shift):
    """Drop the vertex whose loss changes x(φ) least (smallest triangle), with new nodes for it and those above it.

    The triangle is taken over L, not φ: where few elements are left a vertex matters little.
    The chord that replaces two pieces stays inside the cone, which is convex.
    """
    least, smallest = 2, np.inf
    for j in range(2, top - 1):  # vertex between piece j and piece j − 1; piece j begins at row j + 1
        before = _limited_mean(st[j + 1, END], row, scale, shift)
        a = _limited_mean(st[j, END], row, scale, shift) - before
        b = _limited_mean(st[j - 1, END], row, scale, shift) - before
        area = abs(a * (st[j - 1, X_END] - st[j + 1, X_END]) - b * (st[j, X_END] - st[j + 1, X_END]))
        if area < smallest:
            least, smallest = j, area
    start, start_x = st[least + 1, END], st[least + 1, X_END]
    width = st[least - 1, END] - start
    slope = (st[least - 1, X_END] - start_x) / width if width > 0.0 else 0.0
    st[least - 1, P], st[least - 1, M] = start_x - slope * start, slope
    _new_node(least - 1, st, nodes)
    for j in range(least, top - 1):
        for column in range(NODE):
            st[j, column] = st[j + 1, column]
        _new_node(j, st, nodes)
    return top - 1


@_inner
def _new_node(j, st, nodes):
    """A node for the end of the piece in row j; how many there are stands in the first one's place."""
    count = np.int64(nodes[0, PLACE])
    nodes[count, PLACE], nodes[count, WEIGHT] = st[j, END], st[j - 1, M] - st[j, M]
    nodes[count, PARENT] = st[j - 1, NODE]
    st[j, NODE] = count
    nodes[0, PLACE] = count + 1


@_part
def _push(top, p, m, end, x_end, st, nodes, row, scale, shift):
    """Stack the piece x = p + m φ that ends at φ = end; returns the number of pieces."""
    if top == MAX_PIECES:
        top = _drop_least(top, st, nodes, row, scale, shift)
    st[top, P], st[top, M], st[top, END], st[top, X_END] = p, m, end, x_end
    _new_node(top, st, nodes)
    return top + 1


@_part
def _cut(top, u, up, down, front, front_x, st, work, nodes, row, scale, shift):
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
        p = work[j, 1] - slope * work[j, 0]
        top = _push(top, p, slope, work[j, 0], work[j, 1], st, nodes, row, scale, shift)
    return top, work[0, 0], work[0, 1]


@_part
def _turning(u, v, i, j):
    """Where between samples i and j = i + 1 the cubic through displacements u and slopes v (mm a sample, of opposite
    signs) turns: the place in (0, 1) and the displacement there."""
    a, b, rise = v[i], v[j], u[j] - u[i]
    cubic, square = 3.0 * (a + b - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * a - b)
    root = math.sqrt(max(square * square - 4.0 * cubic * a, 0.0))
    w = -0.5 * (square + (root if square > 0.0 else -root))
    x = w / cubic if cubic != 0.0 else -1.0
    if not 0.0 < x < 1.0:
        x = a / w if w != 0.0 else -1.0
    if not 0.0 < x < 1.0:
        x = a / (a - b)
    return x, u[i] + x * (a + x * (0.5 * square + x * cubic / 3.0))


@_part
def _way(u, v, closed, begin, at, where, off, stop, turns, last):
    """The displacements to pass, from entry `begin` on: all samples, extremes with their turning points.

    A reversal between two samples would be overlooked by up to an eighth of a second difference, which every force
    after it would feel. So the turning point of the cubic through both samples and their slopes v (samples,), in mm a
    sample, is put in, between two equal samples, too; where slopes are not known (NaN) or do not show the reversal, the
    vertex of the parabola through three samples, if the middle one lies beyond both others. Fills at (displacement),
    where (sample it belongs to), off (samples from there to it; 0 for the sample itself), stop (the entry at which the
    motion no longer goes on in the direction that led here), turns (the number of turning points, their entries, and
    the end of all entries, which is returned), and last (the number of entries that are the last in their direction,
    and these, from the end on).
    """
    n, count, found = u.size, begin, 0
    for i in range(n):
        tau, turn = 0.0, 0.0
        if closed or 0 < i < n - 1:
            former, next_ = i - 1 if i > 0 else n - 1, i + 1 if i < n - 1 else 0
            rise, fall = u[i] - u[former], u[i] - u[next_]
            shown = rise * v[i] > 0.0 and rise * v[next_] < 0.0
            if rise * fall > 0.0 or (fall == 0.0 and shown):
                if shown:
                    tau, turn = _turning(u, v, i, next_)
                elif rise * v[i] < 0.0 and rise * v[former] > 0.0:
                    tau, turn = _turning(u, v, former, i)
                    tau -= 1.0
                else:
                    tau = 0.5 * (rise - fall) / (rise + fall)
                    turn = u[i] + 0.125 * (rise - fall) ** 2 / (rise + fall)
        if tau < 0.0 or tau > 0.0:  # no turning point where u is not a finite number
            found += 1
            turns[found] = count + (tau > 0.0)
            at[turns[found]], where[turns[found]], off[turns[found]] = turn, i, tau
            sample = count + (tau < 0.0)
            count += 1
        else:
            sample = count
        at[sample], where[sample], off[sample] = u[i], i, 0.0
        count += 1
    turns[0], turns[found + 1] = found, count
    end, after, start, found = count, 0.0, at[count - 1] if closed else 0.0, 0
    for e in range(count - 1, begin - 1, -1):
        du = at[e] - (at[e - 1] if e > begin else start)
        if not du * after > 0.0:
            end, found = e + 1, found + 1
            last[found] = e
        stop[e], after = end, du
    last[0] = found
    return count


@_part
def _series(alpha, k, d, j, where, off, turns, begin, normal, stiff):
    """α and k of every entry of loop j; α is NaN where one of them is not positive: a cone turned inside out means
    nothing, no force then.

    At a turning point r = α/k goes on along its own side (|u̇| has a kink), k stays.
    """
    apart_and_wide()
    n = alpha.shape[2]
    for t in range(1, turns[j, 0] + 2):  # between turning points the samples follow one another
        e = turns[j, t]
        shift = np.uint64(begin) - where[j, begin]
        for c in range(np.uint64(begin), np.uint64(e)):
            a, b = alpha[d, j, c - shift], k[d, j, c - shift]
            normal[c], stiff[c] = a if (a > 0.0) & (b > 0.0) else np.nan, b
        begin = e + 1
    for t in range(1, turns[j, 0] + 1):
        e = turns[j, t]
        i, tau = np.int64(where[j, e]), off[j, e]
        along = i - 1 if tau > 0.0 else (i + 1 if i < n - 1 else 0)
        a, b = alpha[d, j, i], k[d, j, i]
        r = a / b if (a > 0.0) & (b > 0.0) else np.nan
        normal[e], stiff[e] = b * (r + abs(tau) * max(r - alpha[d, j, along] / k[d, j, along], -r)), b


@_part
def _run_in(at, stop, last, j, first, normal, stiff):
    """Puts before the entries from `first` on of a closed loop those that a run-in from rest must pass; returns where
    it begins.

    On a branch along which u goes from u₀ to u₁ without turning, the sliders end at the largest u − rφ of its samples
    (where it rises), or at the least u + rφ if they were beyond that: no sample undoes what an earlier one did. Over
    all φ ≥ 0 only corners of the convex hull of the points (r, u) on the side of small r are ever the largest or the
    least, and all of them lie on the near side of the chord from (r₀, u₀) to (r₁, u₁). So a branch leaves out what lies
    before the first and after the last sample on that side, and one pass reaches the steady state exactly, whatever α
    and k do.
    """
    apart_and_wide()
    low = first
    for b in range(1, last[j, 0] + 1):  # branches, the last one first
        e = last[j, b]
        s = last[j, b + 1] if b < last[j, 0] else first
        if e == first:
            break
        top, start, end = low, normal[s] / stiff[s], normal[e] / stiff[e]
        slope = (end - start) / (at[j, e] - at[j, s]) if at[j, e] != at[j, s] else 0.0
        const = (start - slope * at[j, s]) * (1.0 - ON_CHORD)
        slope *= 1.0 - ON_CHORD
        nearest, furthest = np.uint64(e), np.uint64(s)
        for i in range(np.uint64(s + 1), np.uint64(e)):
            near = normal[i] < stiff[i] * (const + slope * at[j, i])
            nearest = min(nearest, i if near else np.uint64(e))  # type: ignore[arg-type]
            furthest = max(furthest, i if near else np.uint64(s))  # type: ignore[arg-type]
        low -= 1
        at[j, low], normal[low], stiff[low] = at[j, e], normal[e], stiff[e]
        if nearest <= furthest:
            low -= np.int64(furthest - nearest) + 1
            shift = nearest - np.uint64(low)
            for i in range(np.uint64(low), np.uint64(low) + furthest + np.uint64(1) - nearest):
                at[j, i], normal[i], stiff[i] = at[j, i + shift], normal[i + shift], stiff[i + shift]
        for i in range(np.uint64(low), np.uint64(top)):
            stop[j, i] = top
    low -= 1
    at[j, low], normal[low], stiff[low], stop[j, low] = at[j, first], normal[first], stiff[first], low + 1
    return low


@_inner
def _glide(at, j, normal, stiff, begin, stop, s, asymmetry, top, st, edge, ends, slope, held):
    """The first entry from `begin` on that the front need not reach by gliding along its piece; `stop` if all do.
    What their forces need goes into ends, slope and held (what is written there beyond the first such entry, or beyond
    `stop`, is written again).

    Until there it slips on as a whole (its end, s(u − p)k/(α(1 ± a) + s m k), moves out), meets no end of a piece, and
    no vertex beyond it leaves the cone: nothing but the front changes. To stop early costs time only, as
    :func:`_follow` takes any step. So nothing is divided, and two lines check all vertices: e/φ at each is linear in
    u, the largest of them convex, so below its chord.
    """
    apart_and_wide()
    p, m, end = st[top - 1, P], s * st[top - 1, M], st[top - 1, END]
    ahead, behind = 1.0 + s * asymmetry, 1.0 - s * asymmetry
    first, last = at[j, begin], at[j, stop - 1]
    high_0 = high_1 = low_0 = low_1 = -np.inf
    for piece in range(1, top):
        x, share = st[piece, X_END], s / (st[piece, END] * (1.0 + 1e-12))
        e_0, e_1 = (first - x) * share, (last - x) * share
        if piece < top - 1:  # that the front stays short of its piece's end says it of the nearest vertex
            high_0, high_1 = max(high_0, e_0), max(high_1, e_1)
        low_0, low_1 = max(low_0, -e_0), max(low_1, -e_1)
    way = last - first if stop > begin + 1 else 1.0
    high_slope = (high_1 - high_0) / way if top > 2 else 0.0
    low_slope = (low_1 - low_0) / way if top > 1 else 0.0
    a, b = np.uint64(begin), np.uint64(begin + (stop - begin + 15) // 16 * 16)  # whole vectors
    node = st[top - 1, NODE]
    reached, over_before, under_before = b, edge, 1.0
    for e in range(a, b):
        over, under = s * (at[j, e] - p) * stiff[e], ahead * normal[e] + m * stiff[e]
        du = at[j, e] - first
        forward = (under > 0.0) & (over * under_before > over_before * under) & (over <= end * under)
        inside = (high_0 + high_slope * du) * stiff[e] <= ahead * normal[e]
        inside &= (low_0 + low_slope * du) * stiff[e] <= behind * normal[e]
        reached = min(reached, b if forward & inside else e)  # type: ignore[arg-type]
        over_before, under_before = over, under
        ends[e], slope[e], held[e] = over / under, s * under, node
    return min(np.int64(reached), stop)


@_inner
def _forces(at, j, first, count, stiff, ends, slope, held, nodes, beyond, parallel, row, scale, shift, force):
    """Force at the entries from `first` on, k ∫ e' S and the parallel spring's: the front, [0, ends] with k e' = slope,
    and what the pieces beyond it hold, by the node held. All at once, since short stretches of a gathering loop cost
    twice as much."""
    apart_and_wide()
    beyond[0] = 0.0
    for i in range(1, np.int64(nodes[0, PLACE])):
        ell = _limited_mean(nodes[i, PLACE], row, scale, shift)
        beyond[i] = beyond[np.int64(nodes[i, PARENT])] + nodes[i, WEIGHT] * ell
    for e in range(np.uint64(first), np.uint64(first + (count - first + 15) // 16 * 16)):  # whole vectors
        ell = _limited_mean(ends[e], row, scale, shift)
        force[e] = slope[e] * ell + stiff[e] * beyond[np.int64(held[e])] + parallel * at[j, e]


@_inner
def _follow(
    at, stop, j, start, first, count, normal, stiff, asymmetry, row, scale, shift, st, work, nodes, ends, slope, held
):  # fmt: skip
    """Follow the way of loop j from rest, entries [start, count); into ends, slope and held at those from `first` on
    what :func:`_forces` reads."""
    st[0, P] = st[0, M] = st[0, X_END] = st[0, NODE] = 0.0  # virgin: x = 0 for every φ, no front, only the tail
    st[0, END], nodes[0, PLACE] = np.inf, 1.0
    top, last, q, edge, step = 1, 0.0, 0.0, 0.0, start
    while step < count:
        now, r = at[j, step], normal[step] / stiff[step]
        du, up, down = now - last, r * (1.0 + asymmetry), r * (1.0 - asymmetry)
        s, glides = 1.0 if du > 0.0 else -1.0, du != 0.0
        if du != 0.0:
            r = up if du > 0.0 else down
            # the front piece is x = last − qφ; it slips on as a whole if its end lies beyond the cone
            if s * (du + q * edge) <= r * edge:
                if edge > 0.0:
                    top = _push(top, last, -q, edge, last - q * edge, st, nodes, row, scale, shift)
            else:
                while s * (now - st[top - 1, X_END]) > r * st[top - 1, END]:
                    top -= 1
            p, m = st[top - 1, P], st[top - 1, M]
            if r + s * m > 1e-9 * r:
                edge = s * (now - p) / (r + s * m)
            else:  # the piece lies along the cone: it slips as a whole
                edge, glides = st[top - 1, END], False
            q = s * r
        beyond = du == 0.0 and (
            q > up or -q > down
        )  # at rest, and the normal force falls below what the front carries?
        for piece in range(1, top):  # or does a vertex beyond the front lie outside the cone?
            e, most = now - st[piece, X_END], st[piece, END] * (1.0 + 1e-12)
            beyond |= e > up * most or -e > down * most
        if beyond:
            top, edge, x = _cut(top, now, up, down, edge, now - q * edge, st, work, nodes, row, scale, shift)
            q, glides = (now - x) / edge if edge > 0.0 else 0.0, False
        m, end = st[top - 1, M], step + 1
        if step >= first:
            ends[step], slope[step], held[step] = edge, (q + m) * stiff[step], st[top - 1, NODE]
        if glides and end < stop[j, step]:
            stretch = min(stop[j, step], end + LONGEST)
            end = _glide(at, j, normal, stiff, end, stretch, s, asymmetry, top, st, edge, ends, slope, held)
            if end > step + 1:
                now, q = at[j, end - 1], s * (1.0 + s * asymmetry) * normal[end - 1] / stiff[end - 1]
                edge = (now - p) / (q + m)
        last, step = now, end


@_jit
def friction(u, slope, alpha, k, asymmetry, closed, tables, phi_top, parallel, out):
    """Friction force of all loops of all draws, plus a parallel spring; and what else is linear in the tables.

    u, slope : (1 or draws, loops, samples), mm and mm a sample, the latter NaN where it is not known; between samples
        α, k and, but for its turning points, u are taken as monotone.
    alpha, k : (draws, loops, samples); relative normal force and stiffness in N/mm.
    out : (draws, tables, loops, samples), N; the spring is added to the first.
    asymmetry : (draws,) in (−1, 1); an element slips at αφ(1 + asymmetry) where u rises, αφ(1 − asymmetry) where it
        falls.
    closed : the loops repeat themselves, else they are records from rest at u = 0. What a cycle does to an element is
        a composition of clips, so a clip, so idempotent: one run-in reaches the steady state, on few samples
        (:func:`_run_in`).
    tables : (draws, tables, cells, 4), phi_top : (draws,), from :mod:`bayes_iwan.models.slip_force`.
    parallel : (draws,) stiffness in N/mm of a spring beside it; zeros for friction alone.
    """
    draws, each, loops, samples = out.shape
    cells, first = tables.shape[2], 2 * samples + 16
    longest = 2 * first + 32
    longest += (88 - longest) % 512  # rows a multiple of 4096 bytes apart would get into each other's way
    shift = 52
    while OCTAVES << (52 - shift) < cells:
        shift -= 1
    at, off, turns = np.zeros((loops, longest)), np.empty((loops, longest)), np.empty((loops, longest), np.int64)
    where, stop = np.empty((loops, longest), np.uint64), np.empty((loops, longest), np.int64)
    last, count = np.empty((loops, longest), np.int64), np.empty(loops, np.int64)
    normal, stiff, force = np.zeros(longest), np.zeros(longest), np.zeros(longest)
    ends, front, held = np.zeros(longest), np.zeros(longest), np.zeros(longest)
    rows, st, work = np.empty((each, 4 * cells + 4)), np.empty((MAX_PIECES, 5)), np.empty((2 * MAX_PIECES + 1, 2))
    nodes, beyond = np.empty((2 * MAX_PIECES * longest, 3)), np.empty(2 * MAX_PIECES * longest)
    for d in range(draws):
        for i in range(each):
            _in_a_row(tables[d, i], shift, rows[i])
        scale = 1.0 / phi_top[d]
        for j in range(loops):
            if d < u.shape[0]:  # one motion for all draws, or one each
                count[j] = _way(
                    u[d, j], slope[d, j], closed, first, at[j], where[j], off[j], stop[j], turns[j], last[j]
                )
            _series(alpha, k, d, j, where, off, turns, first, normal, stiff)
            start = _run_in(at, stop, last, j, first, normal, stiff) if closed else first
            _follow(
                at, stop, j, start, first, count[j], normal, stiff, asymmetry[d], rows[0], scale, shift, st, work,
                nodes, ends, front, held,
            )  # fmt: skip
            for i in range(each):
                spring = parallel[d] if i == 0 else 0.0
                _forces(
                    at, j, first, count[j], stiff, ends, front, held, nodes, beyond, spring, rows[i], scale, shift,
                    force,
                )  # fmt: skip
                begin, c = first, 0
                for t in range(1, turns[j, 0] + 2):
                    e = turns[j, t]
                    for s in range(np.uint64(0), np.uint64(e - begin)):
                        out[d, i, j, np.uint64(c) + s] = force[np.uint64(begin) + s]
                    c += e - begin
                    begin = e + 1


def way(displacement_mm: Array, slope_mm: Array, closed: bool) -> tuple[Array, NDArray[np.int64], Array]:
    """The displacements (entries,) that one loop or record passes, turning points put in.

    Returns them with the sample (entries,) each belongs to and its distance from it in samples, 0 for the sample
    itself. displacement_mm, slope_mm : (samples,), as u and slope of :func:`friction`.
    """
    longest = 2 * len(displacement_mm) + 3
    at, off = np.empty(longest), np.empty(longest)
    where, stop, turns, last = (np.empty(longest, x) for x in (np.uint64, np.int64, np.int64, np.int64))
    u, slope = (np.ascontiguousarray(x, dtype=float) for x in (displacement_mm, slope_mm))
    count = _way(u, slope, closed, 0, at, where, off, stop, turns, last)
    return at[:count], where[:count].astype(np.int64), off[:count]
