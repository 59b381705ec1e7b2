"""Deviations of the model's functions: a base function times a short series, or its exponential.

Three functions of the Iwan model are assumptions of form: the slip forces are a gamma mixture (Eq. 10), the stiffness
follows the normal force by Eq. (12), the normal force follows the motion by Eq. (11). Each deviation here multiplies
one of them, and is the base function where all coefficients are zero. With the exponential the product is positive
whatever they are.

Slip forces: their density is multiplied by exp(Σ c_k π_k(p)) / Z, where p = F(φ) is the share of elements that slip
earlier and π_k the orthonormal Legendre polynomials on [0, 1]: Neyman's smooth alternatives (Skandinavisk
Aktuarietidskrift 20, 1937, 150). The sliders need only the survival function, which becomes G(S(φ)) with one and the
same G for all φ, so no quantile is ever inverted.

The first order of the same is multiplied by 1 + Σ c_k b_k(p) (:func:`linear_deviations`): the friction force is linear
in the density, so it is in these c_k too, which a posterior can then be integrated over in closed form.
Where the factor is negative the product is no density: the family's form is far from the truth there. Further elements
with slip forces twice and four times as large, few and of either sign, let the tail beyond what a campaign drives be
heavier or lighter than the family's.
"""

import math
from functools import cache

import numba as nb
import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.models.kernels.sliders import OCTAVES
from bayes_iwan.models.kernels.vectors import apart_and_wide

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})

#: cells of p on which the deviating distribution is tabulated: of prior draws the cubics' error is below 2e-6 of the
#: mean slip force on the median and 2e-4 at most (tests/models/test_embedded.py)
_P_CELLS = 64
_GAUSS, _WEIGHTS = legendre.leggauss(3)


def deviation_basis(order: int, p: Array) -> Array:
    """(order, …) orthonormal Legendre polynomials π_1 … π_order on [0, 1] at p (…): mean 0 and mean square 1."""
    x = 2.0 * np.asarray(p, float) - 1.0
    return np.stack([math.sqrt(2 * k + 1.0) * legendre.Legendre.basis(k)(x) for k in range(1, order + 1)])


@cache
def _cells_basis(order: int) -> tuple[Array, Array]:
    """The basis at the Gauss points of all cells of p, (order, 3 cells), and at their ends, (order, cells + 1)."""
    ends = np.linspace(0.0, 1.0, _P_CELLS + 1)
    inside = (ends[:-1, None] + 0.5 * (1.0 + _GAUSS) / _P_CELLS).ravel()
    return deviation_basis(order, inside), deviation_basis(order, ends)


def _distribution(coefficients: Array) -> tuple[Array, Array]:
    """(draws, cells + 1) share of elements beyond the ends of equal cells of p, and its slope per cell."""
    inside, ends = _cells_basis(coefficients.shape[1])
    area = np.exp(coefficients @ inside).reshape(-1, _P_CELLS, len(_GAUSS)) @ (0.5 * _WEIGHTS / _P_CELLS)
    value = np.zeros((len(coefficients), _P_CELLS + 1))
    value[:, :-1] = np.cumsum(area[:, ::-1], axis=1)[:, ::-1]
    slope = -np.exp(coefficients @ ends) / _P_CELLS
    return value / value[:, :1], slope / value[:, :1]


@_jit
def _deviating_tables(
    tables: Array, top: Array, width: Array, value: Array, slope: Array, deviates: NDArray[np.bool_], out: Array
) -> None:
    """Deviating tables into out: the deviating survival at the cells' ends and middles, integrated by Simpson's rule.

    The share of elements beyond the quantile p is read from Hermite cubics over equal cells of p. Where each place lies
    among them is worked out in vectors; reading cannot be.
    """
    draws, cells = tables.shape[:2]
    parts = value.shape[1] - 1
    cubic = np.empty((parts, 4))
    cell, place, above = np.empty(2 * cells, np.uint64), np.empty(2 * cells), np.empty(2 * cells)
    for d in range(draws):
        if not deviates[d]:
            out[d] = tables[d]
            continue
        for i in range(parts):
            rise = value[d, i + 1] - value[d, i]
            cubic[i, 0], cubic[i, 1] = value[d, i], slope[d, i]
            cubic[i, 2] = 3.0 * rise - 2.0 * slope[d, i] - slope[d, i + 1]
            cubic[i, 3] = slope[d, i] + slope[d, i + 1] - 2.0 * rise
        most = parts * (1.0 - 1e-15)
        for j in range(cells):
            per_h = 1.0 / (width[j] * top[d])
            c1, c2, c3 = tables[d, j, 1] * per_h, 2.0 * tables[d, j, 2] * per_h, 3.0 * tables[d, j, 3] * per_h
            for k in range(2):  # the middle, then the end
                p = 1.0 - (c1 + c2 + c3 if k == 1 else c1 + 0.5 * c2 + 0.25 * c3)
                at = p * parts
                at = at if at > 0.0 else 0.0
                at = at if at < most else most
                cell[2 * j + k] = np.uint64(at)
                place[2 * j + k] = at - math.floor(at) + 0.0 * p  # NaN stays NaN
        for j in range(2 * cells):
            i, w = cell[j], place[j]
            above[j] = cubic[i, 0] + w * (cubic[i, 1] + w * (cubic[i, 2] + w * cubic[i, 3]))
        # below the table's lowest node nearly all elements hold, whatever the deviation
        held = tables[d, 0, 1] / (width[0] * top[d])
        at = (1.0 - held) * parts
        at = min(at, most) if at > 0.0 else 0.0  # 0 where it is NaN
        i, w = int(at), at - math.floor(at) + 0.0 * held
        start = cubic[i, 0] + w * (cubic[i, 1] + w * (cubic[i, 2] + w * cubic[i, 3]))
        limited = tables[d, 0, 0] * (1.0 + start) / (1.0 + held)
        for j in range(cells):
            h = width[j] * top[d]
            middle, end = above[2 * j], above[2 * j + 1]
            rise = h * (start + 4.0 * middle + end) / 6.0
            out[d, j, 0], out[d, j, 1] = limited, h * start
            out[d, j, 2] = 3.0 * rise - h * (2.0 * start + end)
            out[d, j, 3] = h * (start + end) - 2.0 * rise
            limited += rise
            start = end


@_jit
def _places(table: Array, top: float, width: Array, x: Array) -> None:
    """2p − 1 at the ends and middles of a table's cells (cells, 4), into x (2 cells + 1,)."""
    for j in range(len(width)):
        per_h = 1.0 / (width[j] * top)
        c1, c2, c3 = table[j, 1] * per_h, 2.0 * table[j, 2] * per_h, 3.0 * table[j, 3] * per_h
        x[2 * j], x[2 * j + 1], x[2 * j + 2] = c1, c1 + 0.5 * c2 + 0.25 * c3, c1 + c2 + c3
    for i in range(len(x)):
        x[i] = min(max(1.0 - 2.0 * x[i], -1.0), 1.0) + 0.0 * x[i]  # NaN stays NaN


@_jit
def _next_order(k: int, x: Array, former: Array, own: Array, beyond: Array) -> None:
    """∫ π_k over (p, 1), (P_{k−1}(x) − P_{k+1}(x)) / (2 √(2k + 1)), into beyond; P_{k−1} and P_k become P_k and P_{k+1}
    by Legendre's recurrence."""
    scale, one, two = 0.5 / math.sqrt(2.0 * k + 1.0), (2.0 * k + 1.0) / (k + 1.0), k / (k + 1.0)
    for i in range(len(x)):
        following = one * x[i] * own[i] - two * former[i]
        beyond[i] = scale * (former[i] - following)
        former[i], own[i] = own[i], following


@_jit
def _integrated(beyond: Array, top: float, width: Array, out: Array) -> None:
    """The table (cells, 4) of the survival `beyond` at the cells' ends and middles, by Simpson's rule."""
    limited = 0.0
    for j in range(len(width)):
        h = width[j] * top
        start, middle, end = beyond[2 * j], beyond[2 * j + 1], beyond[2 * j + 2]
        rise = h * (start + 4.0 * middle + end) / 6.0
        out[j, 0], out[j, 1] = limited, h * start
        out[j, 2] = 3.0 * rise - h * (2.0 * start + end)
        out[j, 3] = h * (start + end) - 2.0 * rise
        limited += rise


@_jit
def _basis_tables(tables: Array, top: Array, width: Array, out: Array, order: int) -> None:
    """Tables of the density times b_k, k = 1 … order, into out (draws, 1 + terms, cells, 4) from its second on: of each
    π_{k+1} so much of the first's is taken off that the mean stays."""
    apart_and_wide()
    draws, cells = tables.shape[:2]
    places, first = 2 * cells + 1, np.empty((cells, 4))
    x, former, own, beyond = np.empty(places), np.empty(places), np.empty(places), np.empty(places)
    for d in range(draws):
        _places(tables[d], top[d], width, x)
        former[:], own[:] = 1.0, x
        for k in range(1, order + 2):
            _next_order(k, x, former, own, beyond)
            _integrated(beyond, top[d], width, first if k == 1 else out[d, k - 1])
        for k in range(1, order + 1):
            share = out[d, k, -1].sum() / first[-1].sum()
            for j in range(cells):
                for i in range(4):
                    out[d, k, j, i] -= share * first[j, i]


@_jit
def _add_deviation(tables: Array, top: Array, width: Array, coefficients: Array, out: Array) -> None:
    """Σ c_k times the density times b_k, coefficients (draws, order), added to out (draws, cells, 4): at once, which
    costs a fraction of one table each."""
    apart_and_wide()
    draws, cells = tables.shape[:2]
    places, first, change = 2 * cells + 1, np.empty((cells, 4)), np.empty((cells, 4))
    x, former, own, beyond = np.empty(places), np.empty(places), np.empty(places), np.empty(places)
    whole = np.empty(places)
    for d in range(draws):
        _places(tables[d], top[d], width, x)
        former[:], own[:], whole[:] = 1.0, x, 0.0
        for k in range(1, coefficients.shape[1] + 2):
            _next_order(k, x, former, own, beyond)
            if k == 1:
                _integrated(beyond, top[d], width, first)
            else:
                whole += coefficients[d, k - 2] * beyond
        _integrated(whole, top[d], width, change)
        out[d] += change - change[-1].sum() / first[-1].sum() * first


@cache
def cell_width(cells: int) -> Array:
    """(cells,) widths of a slip-force table's cells in shares of its top; cells is OCTAVES times a power of two."""
    return np.repeat(np.ldexp(1.0, np.arange(OCTAVES) - OCTAVES), cells // OCTAVES) / (cells // OCTAVES)


def deviating(tables: Array, top: Array, coefficients: Array) -> Array:
    """A slip-force table whose density is multiplied by exp(Σ c_k π_k(F)) / Z.

    tables : (draws, cells, 4), top : (draws,) N, from a slip-force family's `table`; the deviating table has the same
    top.
    coefficients : (draws, order), dimensionless; a draw with all of them zero keeps its table bit for bit. Order 1
        moves the mean, order 2 the spread; size 0.3 changes the density by about that share.
    """
    out = np.empty_like(tables)
    value, slope = _distribution(coefficients)
    width, deviates = cell_width(tables.shape[1]), np.any(coefficients != 0.0, axis=1)
    _deviating_tables(tables, top, width, value, slope, deviates, out)
    return out


def limited(tables: Array, top: Array, share: Array) -> Array:
    """A slip-force table (draws, cells, 4) whose largest slip forces, those of a share of the elements (draws,), all
    stand at the least of them: L(min(φ, φ_s)) with S(φ_s) the share. A share of zero keeps the table bit for bit."""
    out = tables.copy()
    width = cell_width(tables.shape[1])
    for d in np.flatnonzero(share):
        per_h = 1.0 / (width * top[d])
        held = tables[d, :, 1] * per_h  # S at the cells' starts
        j = max(int(np.count_nonzero(held > share[d])) - 1, 0)
        c0, c1, c2, c3 = tables[d, j]
        less = c1 - share[d] / per_h[j]  # 3 c3 w² + 2 c2 w + less = 0
        root = math.sqrt(max(c2 * c2 - 3.0 * c3 * less, 0.0))
        w = 0.0 if root <= c2 else min(max(less / (root - c2), 0.0), 1.0)  # NaN is passed on
        rise = w * (c1 + w * (c2 + w * c3))
        # the end lies within the cell: its cubic takes L there and no slope beyond
        out[d, j] = c0, c1, 3.0 * rise - 2.0 * c1, c1 - 2.0 * rise
        out[d, j + 1 :] = 0.0
        out[d, j + 1 :, 0] = c0 + rise
    return out


def linear_deviations(tables: Array, top: Array, order: int, octaves: int = 0) -> Array:
    """What a density f is changed by for each c_k, as tables.

    For k = 1 … order f times b_k(F) = π_{k+1} − r_k π_1, which keeps its integral and its mean. Polynomials of F leave
    a tail that is thin in the family thin, so the next, as many as octaves, are the densities f_s of slip forces s = 2,
    4, … times as large: further elements.

    tables : (draws, cells, 4), top : (draws,) N, from a slip-force family's `table`. Returns the table itself and
    these, (draws, 1 + order + octaves, cells, 4), with the same top. The table plus Σ c_k of the others is that of the
    deviating density.
    """
    draws, cells, _ = tables.shape
    out = np.empty((draws, 1 + order + octaves, cells, 4))
    out[:, 0] = tables
    for k in range(octaves):
        _larger(tables, k + 1, out[:, 1 + order + k])
    _basis_tables(tables, top, cell_width(cells), out, order)
    return out


def with_deviations(tables: Array, top: Array, coefficients: Array, further: Array) -> Array:
    """The table plus Σ c_k of what :func:`linear_deviations` gives, coefficients (draws, order) and further (draws,
    octaves), (draws, cells, 4), without each of them."""
    out, larger = tables.copy(), np.empty_like(tables)
    for k, share in enumerate(further.T):
        _larger(tables, k + 1, larger)
        out += share[:, None, None] * larger
    _add_deviation(tables, top, cell_width(tables.shape[1]), np.ascontiguousarray(coefficients), out)
    return out


def _larger(tables: Array, octaves: int, out: Array) -> None:
    """The table of slip forces 2^octaves times as large, into out (draws, cells, 4).

    Of slip forces s times as large the integral of the survival is s L(φ/s), so an octave of their table is twice the
    one below it; below the lowest node nearly all elements hold.
    """
    cells = tables.shape[1]
    width, below = cell_width(cells), octaves * cells // OCTAVES
    start = (2.0**-OCTAVES + np.cumsum(width) - width)[:below]
    held = np.stack([start, width[:below], 0.0 * start, 0.0 * start], axis=1)
    np.multiply(tables[:, :1, :1] * 2.0**OCTAVES, held, out=out[:, :below])
    np.multiply(tables[:, :-below], 2.0**octaves, out=out[:, below:])


def deviating_stiffness(k: Array, alpha: Array, exponent: Array, growth: Array) -> Array:
    """k(α)·exp(a ln α + ½ b ln²α), N/mm: at rest (α = 1) k is what it was; d ln k / d ln α grows by a + b ln α.

    k, alpha : (draws, loops, samples); exponent a, growth b : (draws, 1, 1).
    """
    x = np.log(alpha)
    return k * np.exp(x * (exponent + 0.5 * growth * x))


def deviating_normal_force(alpha: Array, basis: Array, coefficients: Array) -> Array:
    """α·exp(Σ c_i b_i(u, u̇)); alpha (draws, loops, samples), basis (terms, 1 or draws, loops, samples),
    coefficients (draws, terms)."""
    exponent = np.zeros(alpha.shape)
    for term, c in zip(basis, coefficients.T):
        exponent += c[:, None, None] * term
    return alpha * np.exp(exponent)
