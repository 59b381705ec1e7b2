"""The discrepancy beside every model: its variance, its harmonics' own sizes, and evidence with them integrated out."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import integrate, stats

from bayes_iwan.diagnosis.constants import LARGE_DISCREPANCY, SPECTRUM_SD
from bayes_iwan.diagnosis.fits.discrepancy_size import (
    BETWEEN,
    LENGTHS,
    LN_SPECTRUM,
    Discrepancy,
    DiscrepancySize,
    Linear,
)
from bayes_iwan.inference.setup.spectrum import discrepancy_spectrum


def toy(orders: int, rows: int = 30, changing: bool = True) -> Linear:
    """A linear model with Gaussian noise: residual at an arbitrary point of linearisation."""
    rng = np.random.default_rng(5)
    jacobian, z = 3.0 * rng.standard_normal((rows, 4)), rng.standard_normal(4)
    late = np.arange(rows) >= (24 if changing else rows)
    discrepancy = Discrepancy(rng.uniform(0.0, 400.0, rows), rng.integers(0, orders, rows), late)
    return Linear(rng.standard_normal(rows), jacobian, discrepancy, z)


def by_hand(discrepancy: Discrepancy, size: DiscrepancySize) -> np.ndarray:
    out = []
    for eigen, order, late in zip(discrepancy.eigen, discrepancy.order, discrepancy.changing):
        share, length = (size.along, LENGTHS[-1]) if late else (size.share, size.length)
        spectrum = discrepancy_spectrum(np.array([share]), np.array([length]), discrepancy.orders)[0]
        factors = size.along_spectrum if late else size.spectrum
        own = factors[order] if order < len(factors) else 1.0
        out.append(1.0 + spectrum[order] * own * eigen)
    return np.array(out)


def gaussian_log_z(linear: Linear, size: DiscrepancySize) -> float:
    """ln evidence of a linear model with a standard normal prior, without the constants of 2π, and the size's prior."""
    data = linear.residual + linear.jacobian @ linear.z  # what a model at z = 0 misses
    covariance = np.diag(by_hand(linear.discrepancy, size)) + linear.jacobian @ linear.jacobian.T
    prior = stats.cauchy(scale=LARGE_DISCREPANCY)
    unlikely = float(prior.logpdf(size.share) - prior.logpdf(0.0))
    log_p = float(stats.multivariate_normal(cov=covariance).logpdf(data))
    return log_p + 0.5 * len(data) * np.log(2.0 * np.pi) + unlikely


@pytest.mark.parametrize("spectrum", [(), (0.1, 3.0), (0.5, 2.0, 7.0, 1.0, 0.01, 4.0)])
def test_variance_is_noise_and_discrepancy_row_by_row(spectrum):
    along = spectrum[::-1]
    discrepancy, size = toy(6).discrepancy, DiscrepancySize(0.02, 0.1, 0.05, spectrum, along)
    np.testing.assert_allclose(discrepancy.variance(size), by_hand(discrepancy, size), rtol=1e-12)
    several = discrepancy.variances(np.array([0.02, 0.4]), np.array([0.1, 0.03]), size)
    np.testing.assert_allclose(several[0], by_hand(discrepancy, size), rtol=1e-12)
    np.testing.assert_allclose(
        several[1], by_hand(discrepancy, DiscrepancySize(0.4, 0.03, 0.05, spectrum, along)), rtol=1e-12
    )


@pytest.mark.parametrize("size", [DiscrepancySize(5e-4, 0.03, 0.0), DiscrepancySize(0.4, 0.1, 0.05, (2.0, 0.1, 1.0))])
def test_the_precision_of_a_linear_model(size):
    linear = toy(6)
    variance = by_hand(linear.discrepancy, size)
    by_rows = linear.jacobian.T @ (linear.jacobian / variance[:, None]) + np.eye(4)
    np.testing.assert_allclose(linear.precision(size), by_rows)


@pytest.mark.parametrize("changing", [False, True])
def test_a_harmonics_size_is_integrated_out(changing):
    """Of loops, and of what changes along the record by a share of 0.3."""
    discrepancy, rng = toy(3, changing=changing).discrepancy, np.random.default_rng(1)
    residual = 2.0 * rng.standard_normal(30)
    found, log_p = (
        x[1] for x in discrepancy.spectrum(np.stack([0.5 * residual, residual]), ((0.4, 0.1, 0.2), (0.1, 0.03, 0.3)))
    )
    exact = 0.0
    assert len(found) == (6 if changing else 3)
    for place, lambda_ in enumerate(found):
        at = (discrepancy.order == place % 3) & (discrepancy.changing == (place >= 3))
        shape = by_hand(discrepancy, DiscrepancySize(0.1, 0.03, 0.3))[at] - 1.0

        def density(x, at=at, shape=shape):
            prior = stats.norm.pdf(x, scale=SPECTRUM_SD)
            return prior * np.prod(stats.norm.pdf(residual[at], scale=np.sqrt(1.0 + np.exp(x) * shape)))

        whole = integrate.quad(density, -9.0, 9.0, epsabs=0.0)[0]
        mean = integrate.quad(lambda x, d=density: x * d(x), -9.0, 9.0, epsabs=1e-9 * whole)[0] / whole
        exact += np.log(whole) + 0.5 * at.sum() * np.log(2.0 * np.pi)
        assert np.log(lambda_) == pytest.approx(mean, abs=0.05)
    assert log_p == pytest.approx(exact, abs=0.05)


def test_evidence_has_every_harmonics_size_integrated_out():
    linear = toy(2, rows=24, changing=False)
    prior = stats.norm.pdf(LN_SPECTRUM, scale=SPECTRUM_SD)
    prior /= prior.sum()
    exact = np.logaddexp.reduce(
        [
            gaussian_log_z(linear, DiscrepancySize(0.05, 0.03, 0.0, tuple(np.exp(LN_SPECTRUM[[i, k]]))))
            + np.log(prior[i] * prior[k])
            for i, k in product(range(len(LN_SPECTRUM)), repeat=2)
        ]
    )
    assert linear.evidence(((0.05, 0.03, 0.0),)).log_z[0] == pytest.approx(exact, abs=0.3)


def test_without_a_discrepancy_evidence_is_exact():
    linear = toy(6, changing=False)
    none = replace(linear, discrepancy=replace(linear.discrepancy, eigen=np.zeros(30)))
    found = none.evidence(((0.05, 0.03, 0.0),))
    assert found.log_z[0] == pytest.approx(gaussian_log_z(none, DiscrepancySize(0.05, 0.03, 0.0)), rel=1e-9)


def test_a_quiet_harmonic_is_assessed_by_its_own_discrepancy():
    """A large discrepancy in one harmonic must not hide what an effect does in another."""
    rng = np.random.default_rng(3)
    order = np.repeat([1, 2], 20)
    eigen = np.full(40, 1e6)
    loud = np.where(order == 1, 30.0, 1.0) * rng.standard_normal(40)
    signature = np.where(order == 2, 4.0, 0.0)[:, None] * np.ones((40, 1))
    discrepancy = Discrepancy(eigen, order, np.zeros(40, dtype=bool))
    with_effect = Linear(loud + signature[:, 0], signature, discrepancy, np.zeros(1))
    without = Linear(loud + signature[:, 0], 1e-9 * signature, discrepancy, np.zeros(1))
    sizes = tuple((float(a), 0.03, 0.0) for a in np.geomspace(1e-3, 0.1, 9))
    gain = max(with_effect.evidence(sizes).log_z) - max(without.evidence(sizes).log_z)
    assert gain > 10.0
    found = without.evidence(((0.03, 0.03, 0.0),)).sizes[0].factors(3)
    assert found[1] > 5.0 * found[2]


def test_what_changes_along_the_record_is_assessed_by_its_own_harmonic():
    """Loops that swell for no known cause must not hide a drift of the mean."""
    rng = np.random.default_rng(4)
    order, late = np.repeat([0, 1], 20), np.ones(40, dtype=bool)
    swelling = np.where(order == 1, 30.0, 1.0) * rng.standard_normal(40)
    drift = np.where(order == 0, 4.0, 0.0)[:, None]
    discrepancy = Discrepancy(np.full(40, 1e6), order, late)
    sizes = tuple((0.0, 0.1, float(b)) for b in np.geomspace(1e-3, 0.3, 9))
    known, unknown = (
        max(Linear(swelling + drift[:, 0], signature, discrepancy, np.zeros(1)).evidence(sizes).log_z)
        for signature in (drift, 1e-9 * drift)
    )
    assert known - unknown > 10.0


def test_a_mean_that_changes_along_the_record_is_one_row_a_contrast(kit):
    layout = kit.diagnosed(None).search.data.layout(BETWEEN[0], evolving=False)
    assert layout.turning.sum() < layout.trend.sum()
    assert not layout.turning[..., 0].any()  # a mean has no imaginary part
