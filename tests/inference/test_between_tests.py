"""Draws as wide as the tests disagree: nothing is done where they agree, and stretched draws stay on the posterior."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bayes_iwan.inference.solving.jackknife import stretched
from bayes_iwan.sampling.moves.manifold import Manifold

import bayes_iwan as bi
from bayes_iwan.inference import identify
from bayes_iwan.inference.setup.config import settings_of
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.solving.point import most_probable
from bayes_iwan.inference.solving.posterior_draws import approximate_draws, least_squares_of

SIMPLE = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False}}


def solved(problem):
    """An optimum (ndim,) and 300 draws (300, ndim) about it."""
    start = problem.prior.draw(np.random.default_rng(1), 12)
    optimum = most_probable(problem, start)[0][0]
    return optimum, approximate_draws(problem, optimum, 300, (1, 2))


@pytest.fixture(scope="module")
def agreeing(tmp_path_factory):
    """Six tests of a specimen that is the model itself, with the noise of the rig."""
    folder = tmp_path_factory.mktemp("campaign")
    plan = [bi.PlannedTest(f, a, cycles=8) for f in (8.0, 16.0) for a in (0.3, 0.6, 1.0)]
    bi.simulate_campaign(plan, seed=5).write(folder)
    problem = make_problem(bi.read_campaign(folder).loops(n_phase=64, n_harmonics=20), SIMPLE)
    force = problem.predict(solved(problem)[0][None])[0]
    return problem.with_force(force + 3e-3 * np.random.default_rng(2).standard_normal(force.shape))


@pytest.fixture(scope="module")
def disagreeing(agreeing):
    """One test was run on a specimen that is 6 % stiffer."""
    force = agreeing.measured_N.copy()
    force[-1] *= 1.06
    return agreeing.with_force(force)


def test_a_single_test_cannot_disagree(agreeing):
    one = replace(agreeing, loops=agreeing.loops[:1], likelihood=agreeing.likelihood.of_tests([0]))
    z = np.zeros((5, one.ndim))
    out, factors = stretched(one, z[0], z)
    assert out is z and np.all(factors == 1.0)


def test_tests_that_disagree_make_draws_wider(agreeing, disagreeing):
    sizes = []
    for problem in (agreeing, disagreeing):
        optimum, z = solved(problem)
        out, factors = stretched(problem, optimum, z)
        assert out.shape == z.shape and np.all(factors >= 1.0) and np.all(np.diff(factors) >= 0.0)
        own = [problem.names.index(n) for n in ("kp_N_mm", "k1_N_mm", "mean_slip_force_N")]
        sizes.append((factors[-1], np.std(out[:, own], axis=0) / np.std(z[:, own], axis=0)))
    assert sizes[1][0] > 1.3 * sizes[0][0], "a specimen that changed between tests"
    assert np.all(sizes[1][1] > 0.9) and np.max(sizes[1][1]) > 1.3


def test_stretched_draws_are_solutions_and_noise_keeps_its_values(disagreeing):
    """x of each is the stretched x of the draw that it was: found here by finite differences of the residuals alone."""
    optimum, z = solved(disagreeing)
    out, factors = stretched(disagreeing, optimum, z)
    target = least_squares_of(disagreeing, optimum)
    manifold, noise = Manifold(target), target.nuisance.columns
    np.testing.assert_array_equal(out[:, noise], z[:, noise])
    tangent = manifold.places(optimum[None]).tangent[0]

    def seen(z):
        at = z.copy()
        at[:, noise] = target.nuisance.centre
        return target.values(at, manifold.free) @ tangent.T

    before, after = seen(z), seen(out)
    map_, *_ = np.linalg.lstsq(before, after, rcond=None)
    error = np.abs(before @ map_ - after).max(axis=1)
    assert np.mean(error < 1e-3) > 0.9, "one linear map takes nearly all draws"
    np.testing.assert_allclose(np.sort(np.linalg.svd(map_)[1])[-1], factors[-1], rtol=0.02)


def test_a_quick_posterior_is_as_wide_as_the_tests_disagree_unless_told_not_to_be(disagreeing, monkeypatch):
    optimum, z = solved(disagreeing)
    monkeypatch.setattr(identify, "QUICK_DRAWS", len(z))
    monkeypatch.setattr(identify, "approximate_draws", lambda *_: z)
    point = SimpleNamespace(z=optimum, optima=optimum[None], optima_log_prob=np.zeros(1))

    def quick(between_tests):
        settings = settings_of({"sampling": {"between_tests": between_tests}})
        return identify._approximation(SimpleNamespace, disagreeing, point, settings, 1, 0.0)

    wide, narrow = quick(True), quick(False)
    expected, factors = stretched(disagreeing, optimum, z)
    np.testing.assert_array_equal(narrow.z.reshape(z.shape), z)
    assert narrow.stretch == 1.0 and wide.stretch == np.max(factors) > 1.3
    np.testing.assert_allclose(wide.z.reshape(z.shape), expected)
    np.testing.assert_allclose(wide.log_prob.ravel(), disagreeing.log_prob(expected))
