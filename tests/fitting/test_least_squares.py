"""Known optima, bounds and failures of the lock-step Levenberg–Marquardt, with scipy's to compare with."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from bayes_iwan.fitting.least_squares import LeastSquaresError, least_squares_batch

TIME = np.linspace(0, 5, 100)


def rosenbrock(x):
    return np.stack([10 * (x[:, 1] - x[:, 0] ** 2), 1 - x[:, 0]], axis=1)


def powell_singular(x):  # its Jacobian is singular at the optimum
    a, b, c, d = x.T
    return np.stack([a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2], axis=1)


def decays(x):  # sums of two exponentials: ill-conditioned
    return x[:, :1] * np.exp(-x[:, 1:2] * TIME) + x[:, 2:3] * np.exp(-x[:, 3:4] * TIME)


@pytest.mark.parametrize("function, ndim, optimum", [(rosenbrock, 2, [1, 1]), (powell_singular, 4, [0, 0, 0, 0])])
def test_known_optima_from_random_starts(function, ndim, optimum):
    starts = np.random.default_rng(0).uniform(-3, 3, (20, ndim))
    fit = least_squares_batch(function, starts)
    assert fit.converged.all()
    np.testing.assert_allclose(fit.x, np.tile(optimum, (20, 1)), atol=1e-4)


def test_agrees_with_scipy_on_noisy_ill_conditioned_data_and_gives_its_covariance():
    rng = np.random.default_rng(1)
    truth = np.array([[2.0, 0.5, 1.0, 1.5]])
    noise = 1e-3
    data = decays(truth)[0] + noise * rng.standard_normal(len(TIME))

    def residuals(x):
        return (data - decays(x)) / noise

    bounds = np.array([[0, 10], [0, 1], [0, 10], [1, 10.0]])
    starts = rng.uniform([0.5, 0.1, 0.5, 1.1], [4, 0.9, 4, 5], (12, 4))
    fit = least_squares_batch(residuals, starts, bounds)
    reference = least_squares(lambda x: residuals(x[None])[0], truth[0], bounds=bounds.T, x_scale="jac", xtol=1e-12)
    assert np.mean(fit.cost < reference.cost * (1 + 1e-6)) > 0.7
    np.testing.assert_allclose(fit.x[fit.best], reference.x, rtol=1e-4)
    np.testing.assert_allclose(fit.covariance(), np.linalg.inv(reference.jac.T @ reference.jac), rtol=2e-3)
    assert np.abs((fit.x[fit.best] - truth[0]) / np.sqrt(np.diag(fit.covariance()))).max() < 4


def test_optimum_on_a_bound_is_found_and_marked():
    starts = np.random.default_rng(2).uniform([-3, -3], [0.5, 3], (20, 2))
    fit = least_squares_batch(rosenbrock, starts, [[-3, 0.5], [-3, 3]])
    assert fit.converged.all()
    np.testing.assert_allclose(fit.x, np.tile([0.5, 0.25], (20, 1)), atol=1e-5)
    assert fit.at_bound[:, 0].all() and not fit.at_bound[:, 1].any()
    assert fit.covariance()[0, 0] == 0 and fit.covariance()[1, 1] > 0


def test_direction_that_the_residuals_do_not_see_stays_put():
    fit = least_squares_batch(lambda x: np.repeat(x[:, :1] - 2, 3, axis=1), [[5.0, 7.0]])
    np.testing.assert_allclose(fit.x, [[2, 7]], atol=1e-8)
    assert fit.covariance()[1, 1] == 0


def test_regions_without_a_model_are_walked_around_and_bad_starts_reported():
    def residuals(x):  # no model for x0 < 0.2
        with np.errstate(invalid="ignore"):
            return np.where(x[:, :1] < 0.2, np.nan, rosenbrock(x))

    fit = least_squares_batch(residuals, [[0.3, 2.0], [2.5, -1.0], [-1.0, 0.0]])
    np.testing.assert_allclose(fit.x[:2], [[1, 1], [1, 1]], atol=1e-6)
    assert list(fit.converged) == [True, True, False] and fit.cost[2] == np.inf and fit.best != 2


def test_starts_do_not_depend_on_their_neighbours():
    starts = np.random.default_rng(3).uniform(-3, 3, (7, 2))
    together = least_squares_batch(rosenbrock, starts)
    alone = [least_squares_batch(rosenbrock, s).x[0] for s in starts]
    np.testing.assert_allclose(together.x, alone, atol=1e-7)


@pytest.mark.parametrize(
    "starts, bounds, words",
    [([[0.0, np.nan]], None, "finite"), ([[0.0, 0.0]], [[0, 1]], "bounds"), ([[0.0, 0.0]], [[1, 0], [0, 1]], "bounds")],
)
def test_bad_input_is_named(starts, bounds, words):
    with pytest.raises(LeastSquaresError, match=words):
        least_squares_batch(rosenbrock, starts, bounds)


def test_wrong_shape_of_residuals_is_named():
    with pytest.raises(LeastSquaresError, match="shape"):
        least_squares_batch(lambda x: x[:, 0], [[0.0, 0.0]])
