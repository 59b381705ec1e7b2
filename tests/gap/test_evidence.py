"""Evidence: Laplace's approximation where it is exact, and one scale for steady and evolving models."""

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.gap.evidence import LENGTHS, SHARES, Linear, Rest, Rows, _distinct, _grid, extended, fit_model
from bayes_iwan.inference.discrepancy import discrepancy_spectrum


@pytest.fixture
def toy():
    """A linear model with Gaussian noise: residual at an arbitrary point of linearisation."""
    rng = np.random.default_rng(5)
    m, n = 30, 4
    jacobian, z = 3.0 * rng.standard_normal((m, n)), rng.standard_normal(n)
    rest = Rest(rng.uniform(0.0, 400.0, m), rng.integers(0, 6, m), np.arange(m) >= 24)
    return Linear(rng.standard_normal(m), jacobian, rest, z)


@pytest.mark.parametrize("share, length, along", [(5e-4, 0.03, 0.0), (0.02, 0.1, 0.05), (0.4, 0.03, 0.01)])
def test_linear_gaussian_evidence_is_exact(toy, share, length, along):
    data = toy.residual + toy.jacobian @ toy.z  # what a model at z = 0 misses
    loops = discrepancy_spectrum(np.array([share]), np.array([length]), 6)[0][toy.rest.order]
    change = discrepancy_spectrum(np.array([along]), LENGTHS[-1:], 6)[0][toy.rest.order]
    variance = 1.0 + np.where(toy.rest.changing, change, loops) * toy.rest.eigen
    covariance = np.diag(variance) + toy.jacobian @ toy.jacobian.T
    exact = stats.multivariate_normal(cov=covariance).logpdf(data) + 0.5 * len(data) * np.log(2.0 * np.pi)
    log_z, (z, precision) = toy.evidence(share, length, along)
    assert log_z == pytest.approx(exact, rel=1e-9)
    prior_side = np.linalg.inv(precision) @ toy.jacobian.T @ (data / variance)
    np.testing.assert_allclose(z, prior_side, rtol=1e-8)


def test_grid_finds_the_best_point_and_averages_over_the_change_along_the_record(toy):
    grid = _grid(toy)
    assert grid.log_z.shape == (len(SHARES), len(LENGTHS))
    share, length, along = grid.best
    one = np.array([[toy.evidence(a, b, along)[0] for b in LENGTHS] for a in SHARES])
    np.testing.assert_allclose(np.ptp(grid.log_z - one), 0.0, atol=1e-9)  # the average is one constant
    assert toy.evidence(share, length, along)[0] == one.max()
    np.testing.assert_array_equal(grid.z, toy.evidence(share, length, along)[1][0])


def test_evidence_is_the_mean_over_the_grid_and_the_rest_has_its_size(kit):
    fit = kit.diagnosed(None).search.base
    assert fit.log_evidence == pytest.approx(np.log(np.mean(np.exp(fit.log_z - fit.log_z.max()))) + fit.log_z.max())
    middle, low, high = fit.rest_share
    assert SHARES[0] <= low < middle < high <= SHARES[-1] and middle < 0.01


def test_distinct_optima_best_first():
    x = np.array([[0.0, 0.0], [0.1, 0.0], [1.0, 0.0], [0.0, 5.0]])
    np.testing.assert_array_equal(_distinct(x, np.array([1.0, 2.0, 3.0, 99.0])), x[[0, 2]])


@pytest.mark.parametrize("name", ["friction_fade", "force_drift", "mains_hum"])
def test_idle_evolving_effect_costs_what_the_steady_model_pays(name, kit):
    """A steady model misses all trends and lines; an evolving one that is switched off misses the same."""
    found = kit.diagnosed(None).search
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
    assert 0.5 * np.sum(idle[len(base) :] ** 2) == pytest.approx(steady.missed(0.0), rel=0.03)


@pytest.mark.parametrize("name, most", [("friction_fade", 12.0), ("force_drift", 12.0)])
def test_evolving_effect_that_is_not_there_loses_a_few_nats(name, most, kit):
    found = kit.diagnosed(None).search
    effect = found.effects[name][0]
    problem = extended(found.base.problem, [effect])
    start = np.zeros((1, problem.ndim))
    start[0, [problem.names.index(n) for n in found.base.problem.names]] = found.base.z
    start[0, problem.names.index(effect.strength_name)] = 0.0 if effect.signed else -1.6
    fit = fit_model(found.data, problem, start, iterations=20)
    assert -most < fit.log_evidence - found.base.log_evidence < 2.0
