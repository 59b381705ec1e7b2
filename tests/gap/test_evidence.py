"""Evidence: Laplace's approximation where it is exact, and one scale for steady and evolving models."""

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.gap.evidence import LENGTHS, SHARES, Linear, Rows, _distinct, _grid, extended, fit_model
from bayes_iwan.inference.discrepancy import discrepancy_spectrum


@pytest.fixture
def toy():
    """A linear model with Gaussian noise: residual at an arbitrary point of linearisation."""
    rng = np.random.default_rng(5)
    m, n = 30, 4
    jacobian, z = 3.0 * rng.standard_normal((m, n)), rng.standard_normal(n)
    return Linear(rng.standard_normal(m), jacobian, rng.uniform(0.0, 400.0, m), rng.integers(0, 6, m), z)


@pytest.mark.parametrize("share, length", [(5e-4, 0.03), (0.02, 0.1), (0.4, 0.03)])
def test_linear_gaussian_evidence_is_exact(toy, share, length):
    data = toy.residual + toy.jacobian @ toy.z  # what a model at z = 0 misses
    spectrum = discrepancy_spectrum(np.array([share]), np.array([length]), 6)[0]
    covariance = np.diag(1.0 + spectrum[toy.order] * toy.eigen) + toy.jacobian @ toy.jacobian.T
    exact = stats.multivariate_normal(cov=covariance).logpdf(data) + 0.5 * len(data) * np.log(2.0 * np.pi)
    log_z, (z, precision) = toy.evidence(share, length)
    assert log_z == pytest.approx(exact, rel=1e-9)
    prior_side = np.linalg.inv(precision) @ toy.jacobian.T @ (data / (1.0 + spectrum[toy.order] * toy.eigen))
    np.testing.assert_allclose(z, prior_side, rtol=1e-8)


def test_grid_holds_every_point_and_finds_the_best(toy):
    log_z, z, covariance, (i, k) = _grid(toy)
    assert log_z.shape == (len(SHARES), len(LENGTHS)) and log_z[i, k] == log_z.max()
    for a, share in enumerate(SHARES):
        assert log_z[a, 1] == toy.evidence(share, LENGTHS[1])[0]
    best, precision = toy.evidence(SHARES[i], LENGTHS[k])[1]
    np.testing.assert_array_equal(z, best)
    np.testing.assert_allclose(covariance @ precision, np.eye(4), atol=1e-9)


def test_integral_over_the_discrepancy(kit):
    fit = kit.diagnosed(None).found.base
    whole = fit.log_evidence(np.full(len(SHARES), -np.log(len(SHARES))))
    assert whole == pytest.approx(np.log(np.mean(np.exp(fit.log_z - fit.log_z.max()))) + fit.log_z.max())
    assert fit.log_evidence(np.where(np.arange(len(SHARES)) == 2, 0.0, -np.inf)) == pytest.approx(
        np.logaddexp.reduce(fit.log_z[2]) - np.log(len(LENGTHS))
    )


def test_distinct_optima_best_first():
    x = np.array([[0.0, 0.0], [0.1, 0.0], [1.0, 0.0], [0.0, 5.0]])
    np.testing.assert_array_equal(_distinct(x, np.array([1.0, 2.0, 3.0, 99.0])), x[[0, 2]])


@pytest.mark.parametrize("name", ["friction_fade", "force_drift", "mains_hum"])
def test_idle_evolving_effect_costs_what_the_steady_model_pays(name, kit):
    """A steady model misses all trends and lines; an evolving one that is switched off misses the same."""
    found = kit.diagnosed(None).found
    effect = found.effects[name][0]
    problem = extended(found.base.problem, [effect])
    rows, steady = Rows(found.data, problem), Rows(found.data, found.base.problem)
    z = np.zeros((1, problem.ndim))
    z[0, [problem.names.index(n) for n in found.base.problem.names]] = found.base.z
    if not effect.signed and effect.strength_name in problem.names:
        z[0, problem.names.index(effect.strength_name)] = -8.0  # a thousandth of the typical
    idle, base = rows.residual(z)[0], steady.residual(found.base.z[None])[0]
    np.testing.assert_allclose(idle[: len(base)], base, atol=0.5)
    assert rows.constant == 0.0
    assert -0.5 * np.sum(idle[len(base) :] ** 2) == pytest.approx(steady.constant, rel=0.03)


@pytest.mark.parametrize("name, most", [("friction_fade", 12.0), ("force_drift", 12.0)])
def test_evolving_effect_that_is_not_there_loses_a_few_nats(name, most, kit):
    found = kit.diagnosed(None).found
    effect = found.effects[name][0]
    problem = extended(found.base.problem, [effect])
    start = np.zeros((1, problem.ndim))
    start[0, [problem.names.index(n) for n in found.base.problem.names]] = found.base.z
    start[0, problem.names.index(effect.strength_name)] = 0.0 if effect.signed else -1.6
    fit = fit_model(found.data, problem, start, iterations=20)
    assert -most < fit.log_z.max() - found.base.log_z.max() < 2.0
