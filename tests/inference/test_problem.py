"""One problem: which tests it fits, its batch functions, and problems with drawn loops."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.inference.setup.problem import make_problem


def test_known_numbers_explain_their_loops(problem, known):
    """At the numbers that made the loops the residual is the noise: the misfit of each harmonic is of order one."""
    z = known.true_z(problem)
    rows = problem.likelihood.rows(problem.residual(z), problem.parameter_values(z))[0]
    data = 2 * 51 * len(problem.loops)
    assert 0.8 < np.sum(rows**2) / data < 1.2
    assert problem.log_prob(z)[0] > problem.log_prob(np.zeros((1, problem.ndim)))[0] + 1000


def test_rows_of_a_batch_do_not_depend_on_each_other(problem):
    z = problem.prior.draw(np.random.default_rng(0), 300)
    together = problem.log_prob(z)
    # on some processors the linear algebra multiplies few rows by another kernel, which rounds otherwise
    np.testing.assert_allclose(problem.log_prob(z[17:20]), together[17:20], rtol=1e-14)
    assert np.all(np.isfinite(together))
    np.testing.assert_allclose(problem.goal(z)[5:9], problem.goal(z[5:9]), rtol=1e-14)


def test_outside_the_prior_and_without_a_prediction(problem, monkeypatch):
    z = np.zeros((2, problem.ndim))
    z[1, 3] = 9.0
    assert np.isfinite(problem.log_prob(z)).tolist() == [True, False]
    force = type(problem.model).force
    monkeypatch.setattr(type(problem.model), "force", lambda *a: np.nan * force(*a))
    assert np.all(problem.log_prob(z) == -np.inf) and np.all(problem.goal(z) == np.inf)


def test_held_out_tests_are_not_fitted(known):
    loops = list(known.loops())
    loops[1] = replace(loops[1], role="held-out")
    p = make_problem(loops)
    assert [x.file for x in p.loops] == [x.file for i, x in enumerate(loops) if i != 1]
    with pytest.raises(ValueError, match="held-out"):
        make_problem([replace(x, role="held-out") for x in loops])
    for wrong, name in (([x.record for x in loops], "Record"), ("campaign", "str"), (object(), "object")):
        with pytest.raises(ValueError, match=f"averaged loops are needed, .*, not {name}"):
            make_problem(wrong)


def test_fingerprint_tells_problems_apart(problem, known):
    same = make_problem(known.loops())
    assert same.fingerprint() == problem.fingerprint()
    other_data = make_problem(known.loops(seed=1)).fingerprint()
    other_prior = make_problem(known.loops(), {"parameters": {"beta": {"fixed": 0.5}}}).fingerprint()
    other_model = make_problem(known.loops(), {"model": {"slip": "gamma2"}}).fingerprint()
    mine = problem.fingerprint()
    assert other_data["data"] != mine["data"] and other_data["model"] == mine["model"]
    assert {k for k in mine if other_prior[k] != mine[k]} == {"prior", "names"}
    assert "model" in {k for k in mine if other_model[k] != mine[k]}


def test_drawn_loops_keep_the_problem(problem, known):
    """with_force(model force of z) is a problem whose likelihood is at its height at z, scales and priors the same."""
    z = known.true_z(problem) + 0.1
    drawn = problem.with_force(problem.predict(z)[0])
    assert drawn.prior is problem.prior and drawn.scales is problem.scales
    np.testing.assert_allclose(drawn.residual(z), 0.0, atol=1e-12)
    np.testing.assert_allclose(drawn.likelihood.level, problem.likelihood.level)
    smaller = problem.with_force(0.2 * problem.measured_N)
    np.testing.assert_array_equal(smaller.likelihood.noise_N, problem.likelihood.noise_N)
    replica = problem.with_force(problem.measured_N)
    np.testing.assert_allclose(replica.log_prob(z), problem.log_prob(z), rtol=1e-12)
    assert drawn.fingerprint()["data"] != problem.fingerprint()["data"]
