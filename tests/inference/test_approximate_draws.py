"""Draws about several optima: each as often as the posterior says, where that is known in closed form."""

import numpy as np
import pytest
from scipy import stats

import bayes_iwan as bi
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.solving.point import most_probable, near_optima
from bayes_iwan.inference.solving.posterior_draws import approximate_draws
from bayes_iwan.models import Parameter, Simulator

ROOT = 2.0  # N/mm, to the half


class Squared(Simulator):
    """A spring of stiffness a², or (s a)² below zero: two values of a fit alike, told apart by the prior, and by s as
    the data leave the steeper side less room."""

    name = "squared"

    def __init__(self, middle, sd, steep=1.0):
        self.prior, self.steep = stats.norm(middle, sd), steep

    def parameters(self, scales):
        return (Parameter("a", "a", "(N/mm)^½", "root of the stiffness", self.prior),)

    def force(self, parameter_values, motion, effects=()):
        a = parameter_values["a"][:, None, None]
        return np.where(a < 0.0, self.steep * a, a) ** 2 * motion.displacement_mm


@pytest.fixture(scope="module")
def loops(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    plan = [bi.PlannedTest(f, a, cycles=8) for f in (8.0, 16.0) for a in (0.5, 1.0)]
    bi.simulate_campaign(plan, seed=5).write(folder)
    return bi.read_campaign(folder).loops(n_phase=64, n_harmonics=20)


@pytest.mark.parametrize(
    ("middle", "sd", "steep", "found"),
    [(0.0, 1.0, 1.0, 2), (0.25, 1.0, 1.0, 2), (-0.4, 1.0, 1.0, 2), (1.0, 0.4, 1.0, 1), (0.0, 1.0, 3.0, 2)],
)
def test_each_optimum_is_drawn_from_as_often_as_its_prior_and_width_say(loops, middle, sd, steep, found):
    problem = make_problem(loops, {}, Squared(middle, sd, steep))
    u = np.array([x.displacement_mm for x in loops])
    problem = problem.with_force(ROOT**2 * u + 0.01 * np.random.default_rng(3).standard_normal(u.shape))
    optima, log_prob, _ = most_probable(problem, problem.prior.draw(np.random.default_rng(1), 24))
    near = near_optima(optima, log_prob)
    assert len(near) == found
    a = problem.parameter_values(approximate_draws(problem, near, 2000, (1, 2)))["a"]
    np.testing.assert_allclose(np.where(a < 0.0, -steep * a, a), ROOT, rtol=0.02)
    prior = stats.norm(middle, sd).pdf
    expected = 1.0 / (1.0 + prior(-ROOT / steep) / (steep * prior(ROOT)))
    assert np.mean(a > 0.0) == pytest.approx(expected, abs=0.04)
