"""Known optima, boxes and failures of the descent from many starts, with scipy's least squares to compare with."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from bayes_iwan.fitting import descent
from bayes_iwan.fitting.descent import BEHIND, ENOUGH, descend
from bayes_iwan.fitting.least_squares import LeastSquaresError

TIME = np.linspace(0.0, 5.0, 100)
NOISE = 0.02
TRUTH = np.array([[0.4, -0.7, 0.1, 0.6]])
BOX = np.tile([-5.0, 5.0], (4, 1))


def decays(z):
    a, p, b, q = np.exp(z).T[:, :, None]
    return a * np.exp(-p * TIME) + b * np.exp(-q * TIME)


def residuals(z):
    data = decays(TRUTH)[0] + NOISE * np.random.default_rng(1).standard_normal(len(TIME))
    return np.concatenate([(data - decays(z)) / NOISE, z], axis=1)


def rosenbrock(x):
    return np.stack([10 * (x[:, 1] - x[:, 0] ** 2), 1 - x[:, 0]], axis=1)


def powell_singular(x):  # its Jacobian is singular at the optimum
    a, b, c, d = x.T
    return np.stack([a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2], axis=1)


@pytest.mark.parametrize("function, ndim, optimum", [(rosenbrock, 2, [1, 1]), (powell_singular, 4, [0, 0, 0, 0])])
def test_known_optima_from_random_starts(function, ndim, optimum):
    starts = np.random.default_rng(0).uniform(-3, 3, (20, ndim))
    found = descend(function, starts, np.tile([-9.0, 9.0], (ndim, 1)), 200, enough=1e-18, give_up=False)
    assert found.cost.min() < 1e-14
    np.testing.assert_allclose(found.x[found.best], optimum, atol=1e-3)
    alone = [descend(function, x[None], np.tile([-9.0, 9.0], (ndim, 1)), 200, enough=1e-18).cost[0] for x in starts]
    assert np.max(alone) < 1e-12  # together, all but one end as twins


def test_ends_where_scipy_does_on_ill_conditioned_data_and_gives_up_what_leads_nowhere():
    starts = np.random.default_rng(3).normal(0.0, 1.0, (8, 4))
    exact = [least_squares(lambda z: residuals(z[None])[0], z, x_scale="jac", xtol=1e-13).cost for z in starts]
    fine, quick = descend(residuals, starts, BOX, 200, enough=1e-9, give_up=False), descend(residuals, starts, BOX, 60)
    np.testing.assert_allclose(fine.cost.min(), np.min(exact), rtol=1e-8)
    assert quick.arrived[quick.best]
    assert np.min(exact) - 1e-6 <= quick.cost.min() <= np.min(exact) + 2.0 * ENOUGH
    assert quick.n_evaluations < 0.7 * fine.n_evaluations


def test_an_optimum_on_the_box_is_found():
    starts = np.random.default_rng(2).uniform([-3, -3], [0.5, 3], (20, 2))
    found = descend(rosenbrock, starts, np.array([[-3, 0.5], [-3, 3.0]]), 200, enough=1e-15, give_up=False)
    np.testing.assert_allclose(found.x[found.best], [0.5, 0.25], atol=1e-6)


def test_a_direction_that_the_residuals_do_not_see_stays_put():
    found = descend(lambda x: np.repeat(x[:, :1] - 2, 3, axis=1), np.array([[4.0, 3.0]]), BOX[:2], 50, enough=1e-15)
    np.testing.assert_allclose(found.x, [[2, 3]], atol=1e-7)


def test_regions_without_a_model_are_walked_around():
    def model(x):  # none for x0 < 0.2
        with np.errstate(invalid="ignore"):
            return np.where(x[:, :1] < 0.2, np.nan, rosenbrock(x))

    for start in ([0.3, 2.0], [2.5, -1.0]):
        found = descend(model, np.array([start]), BOX[:2], 200, enough=1e-15)
        np.testing.assert_allclose(found.x, [[1, 1]], atol=1e-6)


def test_bad_input_is_named():
    with pytest.raises(LeastSquaresError, match="finite"):
        descend(rosenbrock, np.array([[0.0, np.nan]]), BOX[:2], 5)
    with pytest.raises(LeastSquaresError, match="shape"):
        descend(lambda x: x[:, 0], np.zeros((1, 2)), BOX[:2], 5)


def test_starts_with_optima_of_their_own_go_on_where_none_is_given_up():
    def two_valleys(x):
        high = 2.0 * np.sqrt(2.0 * BEHIND)
        return np.stack([x[:, 0] ** 2 - 4.0, np.where(x[:, 0] < 0.0, high, 0.0)], axis=1)

    found = descend(two_valleys, np.array([[2.1], [-3.9]]), np.array([[-5.0, 5.0]]), 60, enough=1e-9, give_up=False)
    assert found.arrived.all()
    np.testing.assert_allclose(found.x[:, 0], [2.0, -2.0], atol=1e-4)


def test_a_jacobian_at_hand_is_not_taken_again():
    start = np.array([[0.0, -0.5, 0.3, 0.2]])
    step = 1e-6 * np.eye(4)
    known = (residuals(start + step) - residuals(start)).T / 1e-6
    alone, helped = (descend(residuals, start, BOX, 60, known=j) for j in (None, known))
    assert helped.n_evaluations == alone.n_evaluations - 4
    np.testing.assert_allclose(helped.x, alone.x, atol=1e-4)


def test_a_start_in_a_hopeless_valley_is_given_up():
    def two_valleys(x):  # at 2 the cost is 0, at -2 it is half the square of `high`
        high = 2.0 * np.sqrt(2.0 * BEHIND)
        return np.stack([x[:, 0] ** 2 - 4.0, np.where(x[:, 0] < 0.0, high, 0.0)], axis=1)

    found = descend(two_valleys, np.array([[2.1], [-3.9]]), np.array([[-5.0, 5.0]]), 40)
    np.testing.assert_allclose(found.x[found.best], 2.0, atol=0.1)
    assert found.best == 0 and found.arrived[0]
    assert found.cost[1] > BEHIND and not found.arrived[1]  # it would have arrived at -2


def test_of_twins_one_goes_on():
    starts = np.array([[0.0, 0.0, 0.0, 0.5], [0.001, 0.0, 0.0, 0.5], [0.0, 0.001, 0.0, 0.5]])
    one, three = (descend(residuals, s, BOX, 60) for s in (starts[:1], starts))
    assert three.n_evaluations < 2.0 * one.n_evaluations
    assert three.cost.min() < one.cost.min() + ENOUGH


def test_a_start_without_a_model_ends_nowhere_and_the_box_holds():
    def model(x):
        return np.where(x[:, :1] > 4.0, np.nan, x - 3.0)

    found = descend(model, np.array([[4.5], [0.0]]), np.array([[-5.0, 2.0]]), 20)
    assert found.x[1, 0] == 2.0 and found.arrived[found.best]
    apart = descend(model, np.array([[4.5], [0.0]]), np.array([[-5.0, 5.0]]), 20)
    assert np.isinf(apart.cost[0]) and not apart.arrived[0]
    np.testing.assert_allclose(apart.x[1], 3.0, atol=0.5)


def bent(x):  # Rosenbrock's valley, in units of a noise that makes it narrow
    return np.stack([200.0 * (x[:, 1] - x[:, 0] ** 2), 10.0 * (1.0 - x[:, 0])], axis=1)


def test_along_a_bent_valley_the_jacobian_at_hand_corrects_its_own_steps(monkeypatch):
    starts, box = np.array([[-1.2, 1.0]]), np.tile([-3.0, 3.0], (2, 1))
    corrected = descend(bent, starts, box, 60)
    monkeypatch.setattr(descent, "STRAIGHT", -np.inf)
    straight = descend(bent, starts, box, 60)
    assert corrected.cost[0] < ENOUGH and corrected.arrived[0]
    assert corrected.n_evaluations < straight.n_evaluations


def test_a_start_that_gains_too_little_to_catch_up_is_given_up(monkeypatch):
    starts = np.random.default_rng(3).normal(0.0, 1.0, (8, 4))
    given_up = descend(residuals, starts, BOX, 60)
    monkeypatch.setattr(descent, "CATCH", np.inf)
    all_on = descend(residuals, starts, BOX, 60)
    assert given_up.n_evaluations < all_on.n_evaluations
    assert given_up.cost.min() < all_on.cost.min() + ENOUGH


def test_gains_to_come_are_a_geometric_series():
    gains = np.array([[4.0, 2.0], [1.0, 0.9], [1.0, 3.0], [np.inf, 1.0]])
    np.testing.assert_allclose(descent._to_come(gains, 5), [2.0, 4.5, 15.0, np.inf])  # 8.1 in all, 4.5 in five steps
