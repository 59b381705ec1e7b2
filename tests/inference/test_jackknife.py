"""Draws as wide as the tests disagree: the jackknife's closed form, nothing where they agree, loops kept."""

from dataclasses import replace

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.solving.jackknife import between_tests, stretched, without_each_test
from bayes_iwan.inference.solving.point import laplace_scale, most_probable

SIMPLE = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False}}


def drawn(problem, n=2000):
    """(n, ndim) about the optimum, by the normal approximation."""
    start = problem.prior.draw(np.random.default_rng(1), 12)
    optimum = most_probable(problem, start)[0][0]
    root = laplace_scale(problem, optimum)
    return optimum + np.random.default_rng(2).standard_normal((n, root.shape[1])) @ root.T


@pytest.fixture(scope="module")
def agreeing(tmp_path_factory):
    """Six tests of a specimen that is the model itself, with the noise of the rig."""
    folder = tmp_path_factory.mktemp("campaign")
    plan = [bi.PlannedTest(f, a, cycles=8) for f in (8.0, 16.0) for a in (0.3, 0.6, 1.0)]
    bi.simulate_campaign(plan, seed=5).write(folder)
    problem = make_problem(bi.read_campaign(folder).loops(n_phase=64, n_harmonics=20), SIMPLE)
    force = problem.predict(drawn(problem, 1))[0]
    return problem.with_force(force + 3e-3 * np.random.default_rng(2).standard_normal(force.shape))


@pytest.fixture(scope="module")
def disagreeing(agreeing):
    """One test was run on a specimen that is 6 % stiffer."""
    force = agreeing.measured_N.copy()
    force[-1] *= 1.06
    return agreeing.with_force(force)


def test_of_a_mean_it_is_the_square_of_its_standard_error():
    """Tests y_t = θ + noise of unit variance, flat prior: θ ~ N(ȳ, 1/T), and the jackknife's variance is s²/T."""
    rng = np.random.default_rng(4)
    y = np.array([0.3, -1.2, 2.5, 0.9, -0.4])
    theta = y.mean() + rng.standard_normal(400_000) / np.sqrt(len(y))
    level = -0.5 * (y - theta[:, None]) ** 2
    found = between_tests(theta[:, None], level)
    assert found.shape == (1, 1)
    assert found[0, 0] == pytest.approx(np.var(y, ddof=1) / len(y), rel=0.02)


def test_what_a_test_adds_is_the_whole_less_the_others(disagreeing):
    z = drawn(disagreeing, 3)
    kept = replace(
        disagreeing, loops=disagreeing.loops[1:], likelihood=disagreeing.likelihood.of_tests(range(1, 6))
    )  # fmt: skip
    found = without_each_test(disagreeing, z)
    assert found.shape == (3, 6)
    np.testing.assert_allclose(found[:, 0], disagreeing.log_likelihood(z) - kept.log_likelihood(z), rtol=1e-9)


def test_a_single_test_cannot_disagree(agreeing):
    one = replace(agreeing, loops=agreeing.loops[:1], likelihood=agreeing.likelihood.of_tests([0]))
    z = np.zeros((5, one.ndim))
    out, factor = stretched(one, z, 1)
    assert out is z and factor == 1.0


def test_tests_that_disagree_make_draws_wider(agreeing, disagreeing):
    found = []
    for problem in (agreeing, disagreeing):
        z = drawn(problem)
        out, factor = stretched(problem, z, 1)
        own = [problem.names.index(n) for n in ("kp_N_mm", "k1_N_mm", "mean_slip_force_N")]
        found.append((factor, np.std(out[:, own], axis=0) / np.std(z[:, own], axis=0)))
    assert found[1][0] > 1.3 * found[0][0], "a specimen that changed between tests"
    assert np.all(found[1][1] > 0.9) and np.max(found[1][1]) > 1.3


def test_loops_stay_near_the_measured_ones_and_the_same_seed_gives_the_same(disagreeing):
    """With the deviations integrated out, which are drawn anew for each place."""
    loops, model = disagreeing.loops, SIMPLE["model"] | {"embedded": True}
    problem = make_problem(loops, {"model": model}).with_force(disagreeing.measured_N)
    z = drawn(problem, 800)
    z = z[np.isfinite(problem.log_prob(z))]
    out, factor = stretched(problem, z, 1)
    again, _ = stretched(problem, z, 1)
    other, _ = stretched(problem, z, 2)
    np.testing.assert_array_equal(out, again)
    assert factor > 1.2 and not np.array_equal(out, other)
    before, after = (np.sqrt(np.mean(problem.residual(x) ** 2, axis=(1, 2))) for x in (z, out))
    assert np.median(after) < 1.2 * np.median(before)


def test_a_quick_posterior_is_as_wide_as_the_tests_disagree_unless_told_not_to_be(disagreeing, few_walkers):
    def quick(wide):
        config = SIMPLE | {"sampling": {"between_tests": wide}}
        return bi.identify_problem(disagreeing, 1, config=config, quick=True, progress=False)

    wide, narrow = quick(True), quick(False)
    assert narrow.stretch == 1.0 and wide.stretch > 1.3
    expected, factor = stretched(disagreeing, narrow.z.reshape(-1, disagreeing.ndim), 1)
    assert wide.stretch == factor
    np.testing.assert_array_equal(wide.z.reshape(expected.shape), expected)
    np.testing.assert_allclose(wide.log_prob.ravel(), disagreeing.log_prob(expected))
