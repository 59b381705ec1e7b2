"""The distribution of the elements' slip forces φ at rest (α = 1), by family.

A family turns its parameters into what the sliders stage needs: for each draw a table of the limited mean
L(φ) = E[min(Φ, φ)] = ∫₀^φ S, with S the survival function, as cubics over cells that are equal within each octave of φ
(so a gamma component a thousand times smaller than another is still resolved). Gamma mixtures (Eq. 10) take L from one
table of the unit gamma over (η^¼, x^¼), blended along η^¼, so no incomplete gamma function is evaluated per draw.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numba as nb
import numpy as np
from scipy import special

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.models.kernels.sliders import OCTAVES
from bayes_iwan.models.kernels.vectors import apart_and_wide

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


#: cells an octave: gamma mixtures, and families with a kink in S or a width of their own
CELLS, FINE_CELLS = 16, 64
#: shapes η that the unit-gamma table covers; beyond them the table, and so the force, is NaN
ETA_MIN, ETA_MAX = 0.1, 80.0
_ROWS, _COLUMNS = 160, 128
_ROW_AT = np.linspace(ETA_MIN**0.25, ETA_MAX**0.25, _ROWS)
_REACH = 3.4  # the unit gamma's survival at (√η + 3.4)² is below 1e-7
_COLUMN_STEP = math.sqrt(math.sqrt(ETA_MAX) + _REACH) / (_COLUMNS - 1)


@dataclass(frozen=True)
class _Nodes:
    """Ends of the table's cells in shares of its top, (OCTAVES * cells + 1,), their widths and two powers."""

    at: Array
    width: Array
    root: Array
    inverse: Array


@cache
def _nodes(cells: int) -> _Nodes:
    octave, place = np.divmod(np.arange(OCTAVES * cells + 1), cells)
    at = np.ldexp(1.0 + place / cells, octave - OCTAVES)
    return _Nodes(at, np.diff(at), at**0.25, at**-0.75)


class SlipForce(Protocol):
    """A family of slip-force distributions; `names` are the parameters it reads, in order, `units` their units."""

    @property
    def name(self) -> str: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def units(self) -> tuple[str, ...]: ...

    def table(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        """Coefficients (draws, cells, 4) of L's cubics in N, and the φ (draws,) in N where S has died out."""

    def survival(self, phi: Array, parameter_values: ParameterValues) -> Array:
        """S(φ) = P(Φ > φ), shape (draws, n); phi in N, (n,) or (draws, n)."""

    def density(self, phi: Array, parameter_values: ParameterValues) -> Array:
        """Density φ̃(φ) in 1/N, shape (draws, len(phi))."""

    def mean(self, parameter_values: ParameterValues) -> Array:
        """Mean slip force in N, shape (draws,)."""


@cache
def _unit_gamma() -> Array:
    """(η^¼ rows, 2, x^¼ columns): L(x) of the unit gamma, and its derivative per column step."""
    eta = (_ROW_AT**4)[:, None]
    s = np.arange(_COLUMNS) * _COLUMN_STEP
    x = s**4
    upper = special.gammaincc(eta, x)  # Q on its own: 1 − P would lose the tail
    return np.stack([x * upper + eta * special.gammainc(eta + 1.0, x), 4.0 * s**3 * upper * _COLUMN_STEP], axis=1)


@_jit
def _cubics(limited: Array, survival: Array, width: Array, top: float, out: Array) -> None:
    """One draw's Hermite cubics (cells, 4) from L and S at its (cells + 1,) nodes; width (cells,) in shares of top."""
    apart_and_wide()
    for j in range(width.size):
        h = width[j] * top
        rise = limited[j + 1] - limited[j]
        slope, slope_1 = h * survival[j], h * survival[j + 1]
        out[j, 0], out[j, 1] = limited[j], slope
        out[j, 2], out[j, 3] = 3.0 * rise - 2.0 * slope - slope_1, slope + slope_1 - 2.0 * rise


@_jit
def _all_cubics(limited: Array, survival: Array, width: Array, top: Array, out: Array) -> None:
    """:func:`_cubics` of all draws."""
    for d in range(out.shape[0]):
        _cubics(limited[d], survival[d], width, top[d], out[d])


def _closed_form(
    limited: Callable[[Array], Array], survival: Callable[[Array], Array], top: Array
) -> tuple[Array, Array]:
    """A table from closed forms limited(φ), survival(φ), with φ (draws, nodes)."""
    nodes = _nodes(FINE_CELLS)
    out = np.empty((len(top), len(nodes.width), 4))
    with np.errstate(all="ignore"):  # a draw with values that make no sense gets NaN, not a warning
        phi = nodes.at * top[:, None]
        _all_cubics(limited(phi), survival(phi), nodes.width, top, out)
    return out, top


@_jit
def _gamma_tables(
    t: Array, eta: Array, g: Array, unit: Array, row_0: float, row_step: float, column_step: float, reach: float,
    root: Array, inverse: Array, width: Array, limited: Array, survival: Array, top: Array, out: Array,
) -> None:  # fmt: skip
    """Tables of mixtures: blend the unit table along η^¼ (cubic), read it along (φ/t)^¼ (Hermite), one draw at a time.

    What lies at the nodes goes through `limited` and `survival`, (cells + 1,). Where each node lies in the unit table,
    the cubics and their values are worked out in vectors, one after the other.
    """
    apart_and_wide()
    draws, components = t.shape
    nodes, columns = root.size, unit.shape[2]
    value, slope, square, cube = np.empty(columns), np.empty(columns), np.empty(columns), np.empty(columns)
    cell, place = np.empty(nodes, np.uint64), np.empty(nodes)
    for d in range(draws):
        top[d] = 0.0
        for i in range(components):
            end = t[d, i] * (math.sqrt(eta[d, i]) + reach) ** 2
            if not end <= top[d]:  # so that NaN is passed on
                top[d] = end
        for j in range(nodes):
            limited[j] = survival[j] = 0.0
        for i in range(components):
            at = (math.sqrt(math.sqrt(eta[d, i])) - row_0) / row_step
            if not (0.0 < t[d, i] < math.inf and -1e-9 <= at <= unit.shape[0] - 1 + 1e-9):
                limited[:] = math.nan
                break
            first = min(max(int(at) - 1, 0), unit.shape[0] - 4)
            w = at - first
            a = -(w - 1.0) * (w - 2.0) * (w - 3.0) / 6.0
            b = w * (w - 2.0) * (w - 3.0) / 2.0
            c = -w * (w - 1.0) * (w - 3.0) / 2.0
            e = w * (w - 1.0) * (w - 2.0) / 6.0
            last = min(int(math.sqrt(math.sqrt(eta[d, i]) + reach) / column_step) + 1, columns - 1)
            r0, r1, r2, r3 = unit[first], unit[first + 1], unit[first + 2], unit[first + 3]
            for j in range(last + 1):
                value[j] = a * r0[0, j] + b * r1[0, j] + c * r2[0, j] + e * r3[0, j]
                slope[j] = a * r0[1, j] + b * r1[1, j] + c * r2[1, j] + e * r3[1, j]
            for p in range(last):
                rise = value[p + 1] - value[p]
                square[p] = 3.0 * rise - 2.0 * slope[p] - slope[p + 1]
                cube[p] = slope[p] + slope[p + 1] - 2.0 * rise
            slope[last] = square[last] = cube[last] = 0.0  # S has died out
            stride = math.sqrt(math.sqrt(top[d] / t[d, i])) / column_step
            value_scale = g[d, i] * t[d, i]
            slope_scale = g[d, i] / (4.0 * column_step**4 * stride**3)
            for j in range(nodes):
                s = min(root[j] * stride, float(last))
                p = max(int(s), 0)  # NaN is no number of a cell
                cell[j], place[j] = p, s - p
            for j in range(nodes):
                q, w = cell[j], place[j]
                c1, c2, c3 = slope[q], square[q], cube[q]
                limited[j] += value_scale * (value[q] + w * (c1 + w * (c2 + w * c3)))
                survival[j] += slope_scale * inverse[j] * (c1 + w * (2.0 * c2 + w * 3.0 * c3))
        _cubics(limited, survival, width, top[d], out[d])


@dataclass(frozen=True)
class Gammas:
    """Mixture of gamma densities, Eq. (10): scales t (N), shapes η, weights g with Σg = 1."""

    components: int = 3

    @property
    def name(self) -> str:
        return f"gamma{self.components}"

    @property
    def names(self) -> tuple[str, ...]:
        each = range(1, self.components + 1)
        return (*(f"t{i}_N" for i in each), *(f"eta{i}" for i in each), *(f"g{i}" for i in each))

    @property
    def units(self) -> tuple[str, ...]:
        return ("N",) * self.components + ("-",) * (2 * self.components)

    def _arrays(self, parameter_values: ParameterValues) -> tuple[Array, Array, Array]:
        each = range(1, self.components + 1)
        t, eta, g = (
            np.array([parameter_values[f"{p}{i}{u}"] for i in each], dtype=float).T.copy()
            for p, u in (("t", "_N"), ("eta", ""), ("g", ""))
        )
        return t, eta, g

    def table(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        t, eta, g = self._arrays(parameter_values)
        nodes = _nodes(CELLS)
        limited, survival = np.empty(len(nodes.at)), np.empty(len(nodes.at))
        top, out = np.empty(len(t)), np.empty((len(t), len(nodes.width), 4))
        _gamma_tables(
            t, eta, g, _unit_gamma(), _ROW_AT[0], _ROW_AT[1] - _ROW_AT[0], _COLUMN_STEP, _REACH, nodes.root,
            nodes.inverse, nodes.width, limited, survival, top, out,
        )  # fmt: skip
        return out, top

    def survival(self, phi: Array, parameter_values: ParameterValues) -> Array:
        t, eta, g = (a[:, :, None] for a in self._arrays(parameter_values))
        return np.sum(g * special.gammaincc(eta, np.asarray(phi)[..., None, :] / t), axis=1)

    def density(self, phi: Array, parameter_values: ParameterValues) -> Array:
        t, eta, g = (a[:, :, None] for a in self._arrays(parameter_values))
        x = np.asarray(phi) / t
        return np.sum(g * np.exp(special.xlogy(eta - 1.0, x) - x - special.gammaln(eta)) / t, axis=1)

    def mean(self, parameter_values: ParameterValues) -> Array:
        t, eta, g = self._arrays(parameter_values)
        return np.sum(g * t * eta, axis=1)


@dataclass(frozen=True)
class Uniform:
    """Uniform between mean·(1 − width) and mean·(1 + width), 0 < width ≤ 1 (Iwan 1966; width = 1 starts at zero)."""

    name = "uniform"
    names = ("slip_mean_N", "slip_width")
    units = ("N", "-")

    @staticmethod
    def _ends(parameter_values: ParameterValues) -> tuple[Array, Array]:
        mean, width = parameter_values["slip_mean_N"][:, None], parameter_values["slip_width"][:, None]
        return mean * (1.0 - width), mean * (1.0 + width)

    def survival(self, phi: Array, parameter_values: ParameterValues) -> Array:
        low, high = self._ends(parameter_values)
        return np.clip((high - phi) / (high - low), 0.0, 1.0)

    def density(self, phi: Array, parameter_values: ParameterValues) -> Array:
        low, high = self._ends(parameter_values)
        return np.where((phi >= low) & (phi <= high), 1.0 / (high - low), 0.0)

    def mean(self, parameter_values: ParameterValues) -> Array:
        return parameter_values["slip_mean_N"]

    def table(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        low, high = self._ends(parameter_values)

        def limited(phi: Array) -> Array:
            inside = np.clip(phi, low, high)
            return np.minimum(phi, low) + ((high - low) ** 2 - (high - inside) ** 2) / (2.0 * (high - low))

        return _closed_form(limited, lambda phi: self.survival(phi, parameter_values), high[:, 0].copy())


@dataclass(frozen=True)
class Gaussian:
    """Normal density cut off below zero and renormalised; parameters are those of the uncut normal."""

    name = "gaussian"
    names = ("slip_centre_N", "slip_sd_N")
    units = ("N", "N")

    @staticmethod
    def _scaled(phi: Array, parameter_values: ParameterValues) -> tuple[Array, Array, Array]:
        centre, sd = parameter_values["slip_centre_N"][:, None], parameter_values["slip_sd_N"][:, None]
        return (phi - centre) / sd, sd, special.ndtr(centre / sd)

    def survival(self, phi: Array, parameter_values: ParameterValues) -> Array:
        z, _, kept = self._scaled(phi, parameter_values)
        return special.ndtr(-z) / kept

    def density(self, phi: Array, parameter_values: ParameterValues) -> Array:
        z, sd, kept = self._scaled(phi, parameter_values)
        return np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * sd * kept)

    def mean(self, parameter_values: ParameterValues) -> Array:
        far = (parameter_values["slip_centre_N"] + 40.0 * parameter_values["slip_sd_N"])[:, None]
        return self._limited(far, parameter_values)[:, 0]

    def _limited(self, phi: Array, parameter_values: ParameterValues) -> Array:
        def partial(z: Array) -> Array:  # ∫ survival of the unit normal up to z, less a constant
            return z * special.ndtr(-z) - np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)

        z, sd, kept = self._scaled(phi, parameter_values)
        zero = self._scaled(np.zeros((1, 1)), parameter_values)[0]
        return sd * (partial(z) - partial(zero)) / kept

    def table(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        top = np.maximum(parameter_values["slip_centre_N"], 0.0) + 6.5 * parameter_values["slip_sd_N"]
        return _closed_form(
            lambda phi: self._limited(phi, parameter_values), lambda phi: self.survival(phi, parameter_values), top
        )


@dataclass(frozen=True)
class PowerLaw:
    """Segalman's density (J. Appl. Mech. 72, 2005): ∝ φ^χ up to φ_max, χ > −1 (singular at the origin for χ < 0),
    and a share `slip_end_share` of elements that all slip at φ_max."""

    name = "power_law"
    names = ("slip_max_N", "slip_chi", "slip_end_share")
    units = ("N", "-", "-")

    @staticmethod
    def _columns(parameter_values: ParameterValues) -> tuple[Array, Array, Array]:
        top, chi, share = (parameter_values[n][:, None] for n in PowerLaw.names)
        return top, chi + 1.0, share

    def survival(self, phi: Array, parameter_values: ParameterValues) -> Array:
        top, power, share = self._columns(parameter_values)
        return np.where(phi < top, 1.0 - (1.0 - share) * np.minimum(np.asarray(phi) / top, 1.0) ** power, 0.0)

    def density(self, phi: Array, parameter_values: ParameterValues) -> Array:
        """The continuous part only; the share at φ_max has no density."""
        top, power, share = self._columns(parameter_values)
        x = np.maximum(np.asarray(phi) / top, 1e-12)
        return np.where(x < 1.0, (1.0 - share) * power * x ** (power - 1.0) / top, 0.0)

    def mean(self, parameter_values: ParameterValues) -> Array:
        top, power, share = (a[:, 0] for a in self._columns(parameter_values))
        return top * (1.0 - (1.0 - share) / (power + 1.0))

    def table(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        top, power, share = self._columns(parameter_values)

        def limited(phi: Array) -> Array:
            return phi - (1.0 - share) * top * np.minimum(phi / top, 1.0) ** (power + 1.0) / (power + 1.0)

        def survival(phi: Array) -> Array:  # one-sided at φ_max: the last node belongs to the table's inside
            return 1.0 - (1.0 - share) * np.minimum(phi / top, 1.0) ** power

        return _closed_form(limited, survival, top[:, 0].copy())


_ALL: tuple[SlipForce, ...] = (Gammas(1), Gammas(2), Gammas(3), Uniform(), Gaussian(), PowerLaw())
FAMILIES: dict[str, SlipForce] = {family.name: family for family in _ALL}
