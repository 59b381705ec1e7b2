"""The discrepancy that stands beside every model: how large it is, harmonic by harmonic, and what that says of a
residual.

The discrepancy is Gaussian and smooth: in harmonic h its variance is a² S_h(ℓ) λ_h of the squared friction level, where
a is its share, S falls with the order as :func:`bayes_iwan.inference.setup.discrepancy.discrepancy_spectrum` says for a
correlation length ℓ, and λ_h says how nature departs from that: a stop that one side meets fills the even harmonics, a
chatter the high ones. Each ln λ_h is normal about 0 and integrated out, so that an effect is assessed in the harmonics
that are quiet, whatever fills the others (a scale mixture; West, Biometrika 74 (1987) 646). How alike it is in tests of
other frequencies and amplitudes is inferred as well, from among BETWEEN: where the discrepancy is the same at every
frequency, as a groove's is, what differs between these is seen far below it. What changes along the
record is a discrepancy of its own share b, with a λ of its own for every harmonic of its contrasts: a mean force that
drifts is assessed beside means that wander, however much the loops swell for which no cause is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba as nb
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.constants import LARGE_DISCREPANCY, SPECTRUM_SD
from bayes_iwan.inference.setup.spectrum import discrepancy_spectrum
from bayes_iwan.screen import on_screen

#: lengths of the discrepancy's correlation in ln f and ln A, and the share each test has to itself
Between = tuple[float, float, float]
#: grid of the discrepancy: RMS share of the friction level, and correlation length in cycles
SHARES = np.geomspace(5e-4, 1.0, 13)
LENGTHS = np.array([0.03, 0.1])
#: ways in which the discrepancy of different tests may be correlated: of 37 those without which most evidence would be
#: lost on sound and faulty cases of the rig (`analyses/discrepancy_between_tests.py`)
BETWEEN: tuple[Between, ...] = (
    (0.8, 0.5, 0.3),
    (3.0, 0.25, 0.03),
    (0.8, 0.5, 0.03),
    (0.4, 2.0, 0.1),
    (3.0, 2.0, 0.03),
    (0.8, 0.5, 1.0),
)
#: shares of the friction level by which the discrepancy may change along the record
ALONG_SHARES = np.array([0.0, 0.004, 0.016, 0.064, 0.256])
#: the grid over which λ is integrated
LN_SPECTRUM = np.linspace(-4.2, 4.2, 13)
#: rounds in which the harmonics' variances and the parameters follow each other
ROUNDS = 3


@dataclass(frozen=True)
@on_screen
class DiscrepancySize:
    """Sizes of the discrepancy: shares a and b (along the record), length ℓ in cycles, λ by harmonic (1 beyond the
    last), of the loops and of their changes along the record; between : how it is correlated between tests."""

    share: float
    length: float
    along: float
    spectrum: tuple[float, ...] = ()
    along_spectrum: tuple[float, ...] = ()
    between: Between = BETWEEN[0]

    def factors(self, count: int) -> Array:
        """λ of the loops' first `count` harmonics, the mean's included."""
        return _padded(self.spectrum, count)


def _padded(factors: tuple[float, ...], count: int) -> Array:
    """(count,) the first λ, 1 where there are none."""
    out = np.ones(count)
    out[: len(factors)] = factors[:count]
    return out


#: shares a, lengths ℓ and shares b, in threes
Sizes = tuple[tuple[float, float, float], ...]
#: the sizes at which models are fitted first
FIRST = DiscrepancySize(0.01, 0.05, 0.004)


@dataclass(frozen=True)
class _Table:
    """Of several sizes: variances of the discrepancy at λ = 1 (sizes, m); of every value of λ, precisions of the rows
    (sizes, m, values) and what each λ costs before its residuals are seen (sizes, lambdas, values), in ln."""

    shape: Array
    precision: Array
    cost: Array


@dataclass(frozen=True)
@on_screen
class Discrepancy:
    """How noise and discrepancy add up in rows that are scaled by the noise: variance = 1 + a² S_order(ℓ) λ_order
    eigen.

    eigen (m,), order (m,) the harmonic, changing (m,) rows of the change along the record, whose share is b instead
    of a and which have λ of their own; rows with eigen = 0 (lines of the mains) carry none. between : how the
    discrepancy of different tests is correlated in these rows.
    """

    eigen: Array
    order: NDArray[np.int64]
    changing: NDArray[np.bool_]
    between: Between = BETWEEN[0]

    @cached_property
    def orders(self) -> int:
        """Number of harmonics, the mean's included."""
        return int(self.order.max(initial=0)) + 1

    @cached_property
    def which(self) -> NDArray[np.int64]:
        """(m,) the λ of each row: those of the loops' harmonics first, then those of their changes along the record."""
        return self.order + np.where(self.changing, self.orders, 0)

    @cached_property
    def lambdas(self) -> int:
        """Number of λ."""
        return int(self.which.max(initial=0)) + 1

    def factors(self, size: DiscrepancySize) -> Array:
        """(lambdas,) a size's λ."""
        return np.r_[size.factors(self.orders), _padded(size.along_spectrum, self.lambdas - self.orders)]

    def variance(self, size: DiscrepancySize) -> Array:
        """(m,) variance of each row."""
        return 1.0 + self._shape(size.share, size.length, size.along) * self.factors(size)[self.which]

    def variances(self, share: Array, length: Array, size: DiscrepancySize) -> Array:
        """(draws, m) the same for several a and ℓ, (draws,) each; b and λ are those of `size`."""
        unit = discrepancy_spectrum(share, length, self.orders)[:, self.order] * self.eigen
        shape = np.where(self.changing, self._shape(0.0, LENGTHS[0], size.along), unit)
        return 1.0 + shape * self.factors(size)[self.which]

    def _shape(self, share: float, length: float, along: float) -> Array:
        """(m,) variance of the discrepancy at λ = 1."""
        return np.where(self.changing, along**2 * self._unit(LENGTHS[-1]), share**2 * self._unit(length))

    def _unit(self, length: float) -> Array:
        """(m,) the variance of each row at a share of 1."""
        if length not in self._units:
            unit = discrepancy_spectrum(np.ones(1), np.array([length]), self.orders)[0, self.order] * self.eigen
            self._units[length] = unit
        return self._units[length]

    @cached_property
    def _units(self) -> dict[float, Array]:
        return {}

    def __reduce__(self) -> tuple[type[Discrepancy], tuple[object, ...]]:
        # without its tables, which are soon made again
        return Discrepancy, (self.eigen, self.order, self.changing, self.between)

    def spectrum(self, residual: Array, sizes: Sizes) -> tuple[Array, Array]:
        """Geometric posterior mean of every λ, (sizes, lambdas), given the residuals at several sizes (sizes, m), and
        ln ∫ Π p(residual | λ) p(λ), (sizes,), without the constants of 2π."""
        table = self.table(sizes)
        cost = np.zeros_like(table.cost)
        _by_order(np.ascontiguousarray(residual**2), table.precision, self.which, cost)
        by_order = table.cost - 0.5 * cost
        whole = np.logaddexp.reduce(by_order, axis=2)
        mean = np.exp(by_order - whole[:, :, None]) @ LN_SPECTRUM
        return np.exp(mean), whole.sum(axis=1)

    def table(self, sizes: Sizes) -> _Table:
        """What is the same for every residual at these sizes."""
        if sizes not in self._tables:
            shape = np.stack([self._shape(*size) for size in sizes])
            variance = 1.0 + shape[:, :, None] * np.exp(LN_SPECTRUM)
            prior = -0.5 * (LN_SPECTRUM / SPECTRUM_SD) ** 2
            prior -= np.logaddexp.reduce(prior)
            by_order = prior - 0.5 * (np.arange(self.lambdas)[:, None] == self.which).astype(float) @ np.log(variance)
            self._tables[sizes] = _Table(shape, 1.0 / variance, by_order)
        return self._tables[sizes]

    @cached_property
    def _tables(self) -> dict[Sizes, _Table]:
        return {}


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _by_order(square: Array, precision: Array, order: NDArray[np.int64], out: Array) -> None:
    """Squares (sizes, m) times precisions (sizes, m, values), added up by order into `out` (sizes, orders, values)."""
    sizes, rows, values = precision.shape
    for s in range(sizes):
        for m in range(rows):
            for v in range(values):
                out[s, order[m], v] += square[s, m] * precision[s, m, v]


def normal_equations(jacobian: Array, residual: Array, z: Array) -> tuple[Array, Array]:
    """Those of a Gauss–Newton step d that lowers |r − J d|² + |z + d|²: b = Jᵀr − z (ndim,) and P = JᵀJ + 1; d = P⁻¹b,
    the sum falls by b·d."""
    return jacobian.T @ residual - z, jacobian.T @ jacobian + np.eye(len(z))


@dataclass(frozen=True)
class Stepped:
    """A linear model's best points at several sizes of the discrepancy: ln evidence (sizes,), z (sizes, ndim) and its
    precision (sizes, ndim, ndim), and the sizes with the harmonics' λ as they were inferred."""

    log_z: Array
    z: Array
    precision: Array
    sizes: tuple[DiscrepancySize, ...]


@dataclass(frozen=True)
@on_screen
class Linear:
    """Residual and Jacobian at an optimum in coordinates in which noise and discrepancy are both diagonal.

    residual (m,), jacobian (m, ndim) in units of the noise. z (ndim,): the point of linearisation.
    """

    residual: Array
    jacobian: Array
    discrepancy: Discrepancy
    z: Array

    def variance(self, size: DiscrepancySize) -> Array:
        """(m,) see :meth:`Discrepancy.variance`."""
        return self.discrepancy.variance(size)

    def precision(self, size: DiscrepancySize) -> Array:
        """(ndim, ndim) that of z at a size of the discrepancy."""
        j = self.jacobian / np.sqrt(self.variance(size))[:, None]
        return np.asarray(j.T @ j + np.eye(len(self.z)))

    def evidence(self, sizes: Sizes) -> Stepped:
        """ln evidence at sizes of the discrepancy by Gauss–Newton steps from z, the harmonics' λ integrated out."""
        discrepancy, n = self.discrepancy, len(self.z)
        shape, turned = discrepancy.table(sizes).shape, self.jacobian.T
        target = self.residual + self.jacobian @ self.z  # minimise |r − J(z' − z)|² + |z'|²
        factors = np.ones((len(sizes), discrepancy.lambdas))
        left = self.residual
        for turn in range(ROUNDS):
            if turn:
                factors, _ = discrepancy.spectrum(left, sizes)
            variance = 1.0 + shape * factors[:, discrepancy.which]
            weighted = turned / variance[:, None, :]
            precision = weighted @ self.jacobian + np.eye(n)
            z = np.asarray(np.linalg.solve(precision, (weighted @ target)[:, :, None])[:, :, 0])
            left = self.residual - (z - self.z) @ turned
        return self.at(left, z, sizes, precision)

    def at(self, residual: Array, z: Array, sizes: Sizes, precision: Array) -> Stepped:
        """ln evidence at each size, the size's own prior in it, of what is left (sizes, m) or (1, m) at z (sizes, ndim)
        or (1, ndim), with the precision (sizes, ndim, ndim) of z; -inf where what is left is not finite."""
        discrepancy = self.discrepancy
        finite = np.asarray(np.all(np.isfinite(residual), axis=1))
        left = np.broadcast_to(np.where(finite[:, None], residual, 0.0), (len(sizes), residual.shape[1]))
        factors, log_p = discrepancy.spectrum(left, sizes)
        log_p -= np.log1p((np.array([share for share, _, _ in sizes]) / LARGE_DISCREPANCY) ** 2)
        log_z = log_p - 0.5 * np.sum(z * z, axis=1) - 0.5 * np.linalg.slogdet(precision)[1]
        split = discrepancy.orders
        found = (
            DiscrepancySize(*size, tuple(f[:split].tolist()), tuple(f[split:].tolist()), discrepancy.between)
            for size, f in zip(sizes, factors)
        )
        return Stepped(
            np.where(finite, log_z, -np.inf), np.broadcast_to(z, (len(sizes), z.shape[1])), precision, tuple(found)
        )
