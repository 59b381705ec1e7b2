"""The rest that stands beside every model: how large it is, harmonic by harmonic, and what that says of a residual.

The rest is Gaussian and smooth: in harmonic h its variance is a² S_h(ℓ) λ_h of the squared friction level, where a is
its share, S falls with the order as :func:`bayes_iwan.inference.setup.discrepancy.discrepancy_spectrum` says for a
correlation length ℓ, and λ_h says how nature departs from that: a stop that one side meets fills the even harmonics, a
chatter the high ones. Each ln λ_h is normal about 0 and integrated out, so that an effect is judged in the harmonics
that are quiet, whatever fills the others (a scale mixture; West, Biometrika 74 (1987) 646).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.discrepancy import discrepancy_spectrum

#: grid of the rest: RMS share of the friction level, and correlation length in cycles
SHARES = np.geomspace(5e-4, 1.0, 13)
LENGTHS = np.array([0.03, 0.1])
#: shares of the friction level by which the rest may change along the record
ALONG_SHARES = np.array([0.0, 0.004, 0.016, 0.064, 0.256])
#: sd of ln λ, and the grid over which λ is integrated
SPECTRUM_SD = 1.4
LN_SPECTRUM = np.linspace(-4.2, 4.2, 13)
#: rounds in which the harmonics' variances and the parameters follow each other
ROUNDS = 3


@dataclass(frozen=True)
class RestSize:
    """Sizes of the rest: shares a and b (along the record), length ℓ in cycles, λ by harmonic (1 beyond the last)."""

    share: float
    length: float
    along: float
    spectrum: tuple[float, ...] = ()

    def factors(self, count: int) -> Array:
        """λ of the first `count` harmonics, the mean's included."""
        out = np.ones(count)
        out[: len(self.spectrum)] = self.spectrum[:count]
        return out


#: the sizes at which models are fitted first
FIRST = RestSize(0.01, 0.05, 0.004)


@dataclass(frozen=True)
class Rest:
    """How noise and rest add up in rows that are scaled by the noise: variance = 1 + a² S_order(ℓ) λ_order eigen.

    eigen (m,), order (m,) the harmonic, changing (m,) rows of the change along the record, whose share is b instead
    of a and whose λ is 1; rows with eigen = 0 (lines of the mains) carry none.
    """

    eigen: Array
    order: NDArray[np.int64]
    changing: NDArray[np.bool_]

    @cached_property
    def orders(self) -> int:
        """Number of harmonics, the mean's included."""
        return int(self.order.max(initial=0)) + 1

    @cached_property
    def _of_order(self) -> Array:
        """(orders, m) 1 where a row belongs to a harmonic and carries its λ."""
        return np.where(self.changing, 0.0, np.arange(self.orders)[:, None] == self.order)

    def variance(self, size: RestSize) -> Array:
        """(m,) variance of each row."""
        loop = self._shape(size.share, size.length) * size.factors(self.orders)[self.order]
        return 1.0 + np.where(self.changing, self._shape(size.along, LENGTHS[-1]), loop)

    def variances(self, share: Array, length: Array, size: RestSize) -> Array:
        """(draws, m) the same for several a and ℓ, (draws,) each; b and λ are those of `size`."""
        loop = discrepancy_spectrum(share, length, self.orders)[:, self.order] * size.factors(self.orders)[self.order]
        return 1.0 + np.where(self.changing, self._shape(size.along, LENGTHS[-1]), loop * self.eigen)

    def _shape(self, share: float, length: float) -> Array:
        return share**2 * self._unit(length)

    def _unit(self, length: float) -> Array:
        """(m,) the variance of each row at a share of 1."""
        if length not in self._units:
            unit = discrepancy_spectrum(np.ones(1), np.array([length]), self.orders)[0, self.order] * self.eigen
            self._units[length] = unit
        return self._units[length]

    @cached_property
    def _units(self) -> dict[float, Array]:
        return {}

    def spectrum(self, residual: Array, share: float, length: float) -> tuple[Array, float]:
        """Geometric posterior mean of every λ given a residual (m,), and ln ∫ Π p(residual | λ) p(λ) of the rows that
        carry one, without the constants of 2π."""
        shape = np.where(self.changing, 0.0, self._shape(share, length))
        prior = -0.5 * (LN_SPECTRUM / SPECTRUM_SD) ** 2
        prior -= np.logaddexp.reduce(prior)
        variance = 1.0 + shape[:, None] * np.exp(LN_SPECTRUM)
        by_order = prior - 0.5 * self._of_order @ (residual[:, None] ** 2 / variance + np.log(variance))
        whole = np.logaddexp.reduce(by_order, axis=1)
        mean = np.sum(np.exp(by_order - whole[:, None]) * LN_SPECTRUM, axis=1)
        return np.exp(mean), float(whole.sum())


@dataclass(frozen=True)
class Stepped:
    """A linear model's best point at one size of the rest: ln evidence, z and its precision, and the size with the
    harmonics' λ as they were inferred."""

    log_z: float
    z: Array
    precision: Array
    size: RestSize


@dataclass(frozen=True)
class Linear:
    """Residual and Jacobian at an optimum in coordinates in which noise and rest are both diagonal.

    residual (m,), jacobian (m, ndim) in units of the noise. z (ndim,): the point of linearisation.
    """

    residual: Array
    jacobian: Array
    rest: Rest
    z: Array

    def variance(self, size: RestSize) -> Array:
        """(m,) see :meth:`Rest.variance`."""
        return self.rest.variance(size)

    def step(self, size: RestSize) -> tuple[Array, Array, Array]:
        """One Gauss–Newton step from z at a size of the rest: the stepped z, its precision, the residual there."""
        sd = np.sqrt(self.variance(size))
        j, r = self.jacobian / sd[:, None], self.residual / sd
        precision = np.asarray(j.T @ j + np.eye(len(self.z)))
        z = np.asarray(np.linalg.solve(precision, j.T @ (r + j @ self.z)))  # minimise |r − J(z' − z)|² + |z'|²
        return z, precision, self.residual - self.jacobian @ (z - self.z)

    def evidence(self, share: float, length: float, along: float) -> Stepped:
        """ln evidence at one size of the rest by Gauss–Newton steps from z, the harmonics' λ integrated out."""
        size = RestSize(share, length, along)
        for _ in range(ROUNDS):
            z, precision, left = self.step(size)
            factors, log_p = self.rest.spectrum(left, share, length)
            size = RestSize(share, length, along, tuple(factors.tolist()))
        at = self.rest.changing
        variance = self.variance(size)[at]
        log_p -= 0.5 * float(np.sum(left[at] ** 2 / variance + np.log(variance)))
        half_logdet = 0.5 * float(np.linalg.slogdet(precision)[1])
        return Stepped(log_p - 0.5 * float(z @ z) - half_logdet, z, precision, size)
