"""Walkers that are led to a posterior: all over it, in each of its parts as often as it weighs."""

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.sampling.annealing import annealed, guess_about
from bayes_iwan.sampling.blocks import Density, Places, advanced
from bayes_iwan.sampling.plan import SamplingError


def density_of(function, ndim):
    every = np.arange(ndim)
    return Density(lambda x, _: function(x)[:, None], every, every[:0], tuple(every[:, None]))


def led(density, optima, roots, count=2048, late=lambda: False, seed=1):
    """What β was, and where the walkers are in the end."""

    def advance(at, moves, steps, between, stage):
        out, _ = advanced((between, moves, steps), (at, (seed, stage)))
        return Places(out.x[-1], out.drawn[-1], out.log_prob[-1])

    steps = list(annealed(density, guess_about(density, optima, roots), count, (seed,), advance, late))
    return [beta for beta, _ in steps], steps[-1][1]


def two_parts(x):
    """A narrow part at −1 with a quarter of the weight, and one with heavy tails at 2 with the rest."""
    narrow = stats.norm(-1.0, 0.02).logpdf(x[:, 0]) + stats.norm(0.0, 0.05).logpdf(x[:, 1])
    heavy = stats.t(3, 2.0, 0.1).logpdf(x[:, 0]) + stats.norm(0.5, 0.2).logpdf(x[:, 1])
    return np.logaddexp(np.log(0.25) + narrow, np.log(0.75) + heavy)


def test_each_part_has_its_share_of_the_walkers_whatever_the_normal_approximations_say():
    optima, roots = np.array([[-1.0, 0.0], [2.0, 0.5]]), np.array([np.diag([0.02, 0.05]), np.diag([0.1, 0.2])])
    betas, at = led(density_of(two_parts, 2), optima, roots)
    left = at.x[:, 0] < 0.0
    assert left.mean() == pytest.approx(0.25, abs=0.03)
    np.testing.assert_allclose(at.x[left].std(axis=0), [0.02, 0.05], rtol=0.12)
    assert np.quantile(at.x[~left, 0], 0.95) - 2.0 == pytest.approx(0.1 * stats.t(3).ppf(0.95), rel=0.15)
    np.testing.assert_allclose(at.log_prob, two_parts(at.x), rtol=1e-9)
    assert betas[-1] == 1.0 and len(betas) > 1 and np.all(np.diff(betas) > 0.0)


def test_a_bent_sheet_is_filled_though_its_normal_approximation_is_a_third_of_it():
    """y ~ N(x² / 2, 0.05), x ~ N(0, 1), but with a precision at the optimum as if x had a third of its width."""

    def sheet(x):
        return -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - 0.5 * x[:, 0] ** 2) / 0.05) ** 2

    _, at = led(density_of(sheet, 2), np.zeros((1, 2)), np.diag([1 / 3, 0.05])[None])
    np.testing.assert_allclose([at.x[:, 0].mean(), at.x[:, 0].std()], [0.0, 1.0], atol=0.1)
    assert at.x[:, 1].mean() == pytest.approx(0.5, abs=0.07)


def test_in_many_dimensions_moments_are_right_and_each_step_leaves_half_of_the_walkers():
    ndim, rng = 12, np.random.default_rng(0)
    a = rng.standard_normal((ndim, ndim))
    covariance = 0.01 * (a @ a.T + np.eye(ndim))
    inverse, mean = np.linalg.inv(covariance), rng.standard_normal(ndim)
    density = density_of(lambda x: -0.5 * np.einsum("ni,ij,nj->n", x - mean, inverse, x - mean), ndim)
    betas, at = led(density, mean[None], np.linalg.cholesky(covariance)[None])
    assert 3 <= len(betas) <= 12
    white = np.linalg.solve(np.linalg.cholesky(covariance), (at.x - mean).T)
    np.testing.assert_allclose(white.mean(axis=1), 0.0, atol=0.15)
    np.testing.assert_allclose(white.var(axis=1), 1.0, atol=0.25)


def test_where_time_is_up_the_posterior_is_reached_in_one_step():
    betas, at = led(density_of(two_parts, 2), np.array([[2.0, 0.5]]), np.diag([0.1, 0.2])[None], 64, lambda: True)
    assert betas == [1.0] and np.isfinite(at.log_prob).all()


def test_an_impossible_optimum_is_none_and_none_at_all_is_said():
    def half(x):
        return np.where(np.abs(x[:, 0]) < 0.01, 0.0, -np.inf)

    _, at = led(density_of(half, 1), np.array([[0.0], [5.0]]), np.eye(1)[None], 256)
    assert np.abs(at.x).max() < 0.01 and np.isfinite(at.log_prob).all()
    with pytest.raises(SamplingError, match="none of the 1 starts has a finite log-probability"):
        led(density_of(half, 1), np.array([[5.0]]), np.eye(1)[None], 16)
