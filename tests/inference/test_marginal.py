"""What the force is linear in integrated out: the integral and what is drawn, against the joint posterior."""

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan.inference.setup.marginal import Marginal
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import SamplingSettings
from bayes_iwan.inference.solving import posterior_draws
from bayes_iwan.inference.solving.point import most_probable
from bayes_iwan.models.embedded_error import SLIP_NAMES
from bayes_iwan.sampling.blocks import generator

FLAT = {"dist": "uniform", "loc": -0.1, "scale": 0.2}
SIMPLE = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant"}}


@pytest.fixture(scope="module")
def loops(made_up_campaign):
    return bi.read_campaign(made_up_campaign).loops(n_phase=64, n_harmonics=12)


@pytest.fixture(scope="module")
def marginal(loops):
    return Marginal(make_problem(loops, SIMPLE))


def near(problem, n, sd=0.02):
    """z (n, ndim) about the best of some prior draws."""
    z = problem.prior.draw(np.random.default_rng(0), 400)
    best = most_probable(problem, z[np.argsort(-problem.log_prob(z))[:6]])[0][0]
    return best + sd * np.random.default_rng(1).standard_normal((n, problem.ndim))


def test_what_is_drawn_and_what_is_walked_in_make_up_all_coordinates(marginal):
    names = marginal.problem.names
    assert tuple(names[i] for i in marginal.drawn) == (*SLIP_NAMES, "kp_N_mm", "force_zero_N")
    assert sorted([*marginal.drawn, *marginal.walked]) == list(range(len(names)))
    first, others, noise = ([names[marginal.walked[i]] for i in block] for block in marginal.blocks)
    assert set(first) == {"eta1", "mean_slip_force_N", "k1_N_mm"} and "stiffness_exponent" in others
    assert noise == ["noise_scale", "discrepancy_odd", "discrepancy_even", "discrepancy_slope"]


def difference(marginal, z, shift):
    """ln p(x) − ln p(x, c) + ln p(c | x) of z (n, ndim), at c so many of its standard deviations off its mean."""
    at = z.copy()
    at[:, marginal.drawn] = 0.0
    level, mean, root = marginal._integrated(at)
    unit = np.full(mean.shape, shift)
    c = mean + np.linalg.solve(root.transpose(0, 2, 1), unit[:, :, None])[:, :, 0]
    at[:, marginal.drawn], ratio = marginal._scores(c)
    conditional = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) - 0.5 * np.sum(unit**2, axis=1)
    value = {q.name: q.value(at[:, i]) for q, i in zip(marginal._parameters, marginal.drawn) if not q.normal}
    # the joint density is that of z, the ratio's of the values
    by_value = sum(marginal.problem.prior[n].log_density(v) for n, v in value.items())
    places = [i for q, i in zip(marginal._parameters, marginal.drawn) if not q.normal]
    by_value = by_value + 0.5 * np.sum(at[:, places] ** 2, axis=1)
    return level + ratio + conditional - marginal.problem.log_prob(at) - by_value


def test_the_integral_is_that_of_the_joint_density(marginal):
    """At every c the same, for the joint density is the product, whatever the priors are: the density of c, of which
    one changes a value by its scale."""
    z = near(marginal.problem, 8, sd=1e-3)
    found = np.concatenate([difference(marginal, z, shift) for shift in (0.0, 1.0, -2.0)])
    scales = [scale for q, scale in zip(marginal._parameters, marginal._scale) if not q.normal]
    assert len(scales) == 2 and np.ptp(found) < 1e-5
    assert found[0] == pytest.approx(np.sum(np.log(scales)), abs=1e-4)


def test_draws_given_the_others_have_the_conditional_mean_and_covariance(marginal):
    x = np.tile(near(marginal.problem, 1)[:, marginal.walked], (4000, 1))
    found = marginal(x, generator((1,)))
    z = np.zeros((1, marginal.problem.ndim))
    z[:, marginal.walked] = x[:1]
    level, mean, root = marginal._integrated(z)
    c = np.stack([
        f if q.normal else (q.value(f) - q.value(np.zeros(1))) / scale
        for q, scale, f in zip(marginal._parameters, marginal._scale, found[:, 1:].T)
    ], axis=1)  # fmt: skip
    unit = (c - mean) @ root[0]
    np.testing.assert_allclose(found[:, 0], level + marginal._scores(c)[1], atol=1e-6)
    np.testing.assert_allclose(unit.mean(axis=0), 0.0, atol=0.08)
    np.testing.assert_allclose(np.cov(unit.T), np.eye(len(marginal.drawn)), atol=0.12)


@pytest.mark.parametrize(
    "config", [{"model": {"embedded": False}}, {"likelihood": {"kind": "laplace"}}], ids=["plain", "not normal"]
)
def test_nothing_is_integrated_out_where_that_is_not_exact(loops, config):
    problem = make_problem(loops, {"model": {**SIMPLE["model"], **config.get("model", {})}} | {
        k: v for k, v in config.items() if k != "model"
    })  # fmt: skip
    marginal = Marginal(problem)
    assert len(marginal.drawn) == 0 and len(marginal.walked) == problem.ndim
    z = near(problem, 3)
    np.testing.assert_array_equal(marginal(z, generator((1,)))[:, 0], problem.log_prob(z))


def test_a_deviation_of_another_prior_is_walked_in_and_the_others_are_drawn(loops):
    given = {"slip_deviation3": {"fixed": 0.05}, "slip_deviation2": {"prior": FLAT}}
    problem = make_problem(loops, {**SIMPLE, "parameters": given})
    marginal = Marginal(problem)
    drawn = [problem.names[i] for i in marginal.drawn]
    assert drawn == [*(n for n in SLIP_NAMES if n not in given), "kp_N_mm", "force_zero_N"]
    found = np.concatenate([difference(marginal, near(problem, 4, sd=0.002), shift) for shift in (0.0, 1.0)])
    assert np.ptp(found) < 1e-5


def test_numbers_of_the_density_are_judged_by_r_hat_alone(loops, monkeypatch):
    """Its mean, stiffnesses and noise are not among them."""
    plans = []
    monkeypatch.setattr(posterior_draws, "sample", lambda density, optima, roots, plan, **rest: plans.append(plan))
    problem = make_problem(loops, {})
    posterior_draws.sampled(problem, np.zeros((1, problem.ndim)), SamplingSettings(), posterior_draws.Run(1))
    found = plans[0].by_r_hat
    assert {"eta1", "share_1", "slip_ratio_21", "slip_deviation12", "slip_tail4", "g3", "t2_N"} <= found
    assert not found & {"mean_slip_force_N", "kp_N_mm", "k1_N_mm", "noise_scale", "normal_force_slope"}
