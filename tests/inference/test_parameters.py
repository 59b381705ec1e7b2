"""Coordinates: z is the prior's normal score, so densities, bounds, ties and Jacobians must be exact."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.setup.config import ConfigError, settings_of
from bayes_iwan.inference.setup.priors import Parameter, ParameterError, Prior, configured
from bayes_iwan.inference.setup.problem import make_problem
from paper_coordinates import PaperCoordinates

PRIORS = {
    "norm": Parameter("x", "x", "-", "", stats.norm(loc=-1.0, scale=0.3)),
    "lognorm": Parameter("x", "x", "-", "", stats.lognorm(s=0.7, scale=5.0)),
    "shifted lognorm": Parameter("x", "x", "-", "", stats.lognorm(s=1.0, loc=1.0, scale=1.5)),
    "cut lognorm": Parameter("x", "x", "-", "", stats.lognorm(s=0.9, scale=2.0), 0.12, 75.0),
    "half normal": Parameter("x", "x", "-", "", stats.norm(), 0.0),
    "uniform": Parameter("x", "x", "-", "", stats.uniform(0, 1), 1e-4, 1 - 1e-4),
    "beta": Parameter("x", "x", "-", "", stats.beta(1, 2)),
    "gamma": Parameter("x", "x", "-", "", stats.gamma(3.0, scale=0.5)),
}


@pytest.mark.parametrize("name", PRIORS)
def test_z_carries_the_priors_density(name):
    """p(x) dx = N(z) dz at every z: the Jacobian of the map is in it exactly."""
    p = PRIORS[name]
    z = np.linspace(-4.0, 4.0, 41)
    h = 1e-5
    slope = (p.value(z + h) - p.value(z - h)) / (2 * h)
    assert np.all(slope > 0)
    np.testing.assert_allclose(p.log_density(p.value(z)) + np.log(slope), stats.norm.logpdf(z), atol=2e-6)


@pytest.mark.parametrize("name", PRIORS)
def test_score_inverts_value_and_bounds_hold(name):
    p = PRIORS[name]
    z = np.linspace(-5.0, 5.0, 31)
    np.testing.assert_allclose(p.score(p.value(z)), z, atol=1e-6)
    x = p.value(np.array([-20.0, -8.0, 8.0, 20.0]))
    assert np.all(np.isfinite(x)) and np.all(x >= p.lower) and np.all(x <= p.upper)


@pytest.mark.parametrize("chosen", [tuple(PRIORS), ("uniform", "beta"), ("norm",), ("cut lognorm",)])
def test_values_together_are_each_one_s_own_to_the_bit(chosen):
    prior = Prior(tuple(replace(PRIORS[n], name=f"p{i}") for i, n in enumerate(chosen)))
    z = np.random.default_rng(3).standard_normal((7, len(chosen))) * 3.0
    values = prior.values(z)
    for i, name in enumerate(chosen):
        np.testing.assert_array_equal(values[f"p{i}"], PRIORS[name].value(z[:, i]))


def test_joint_prior_is_standard_normal_and_ends():
    prior = Prior(tuple(Parameter(n, n, "-", "", stats.norm()) for n in "abc"))
    z = prior.draw(np.random.default_rng(0), 5)
    np.testing.assert_allclose(prior.log_density(z), stats.norm.logpdf(z).sum(axis=1))
    assert prior.log_density(np.array([[0.0, 0.0, 8.5]]))[0] == -np.inf


def test_draws_from_the_prior_have_its_quantiles(problem):
    """Draws through z against the scipy distribution itself, each parameter of the full model."""
    z = problem.prior.draw(np.random.default_rng(1), 4000)
    values = problem.prior.values(z)
    for p in problem.prior.parameters:
        low, high = p.prior.cdf(p.lower), p.prior.cdf(p.upper)
        expected = stats.uniform(low, high - low)
        assert stats.kstest(p.prior.cdf(values[p.name]), expected.cdf).pvalue > 1e-5, p.name


def test_fixed_tied_and_changed(known):
    problem = make_problem(
        known.loops(),
        {
            "parameters": {
                "beta": {"fixed": 0.5},
                "eta3": {"tied": "eta2"},
                "kp_N_mm": {"prior": {"dist": "norm", "loc": 5.45, "scale": 0.1}, "lower": 5.4},
            }
        },
    )
    assert "beta" not in problem.names and "eta3" not in problem.names
    assert problem.ndim == make_problem(known.loops()).ndim - 2
    v = problem.prior.values(problem.prior.draw(np.random.default_rng(0), 500))
    assert np.all(v["beta"] == 0.5) and np.array_equal(v["eta3"], v["eta2"])
    assert v["kp_N_mm"].min() >= 5.4 and v["kp_N_mm"].max() < 6.0
    assert "tied to eta2" in problem.fingerprint()["prior"]


@pytest.mark.parametrize(
    "tables, says",
    [
        ({"kq": {"fixed": 1.0}}, "no such parameter"),
        ({"beta": {"fixd": 1.0}}, "unknown key 'fixd'"),
        ({"beta": {"prior": {"dist": "poisson", "mu": 1.0}}}, "continuous"),
        ({"beta": {"prior": {"dist": "norm", "mean": 1.0}}}, "norm"),
        ({"beta": {"prior": {"dist": "norm", "loc": 0.0, "scale": -1.0}}}, "norm"),
        ({"beta": {"lower": 9.0, "upper": 9.5, "prior": {"dist": "uniform"}}}, "no weight"),
    ],
)
def test_what_is_wrong_is_named(problem, tables, says):
    with pytest.raises((ParameterError, ConfigError), match=says):
        configured(problem.prior.parameters, settings_of({"parameters": tables}).parameters)


def test_a_tie_must_lead_to_a_free_parameter(known):
    with pytest.raises(ParameterError, match="eta9"):
        make_problem(known.loops(), {"parameters": {"eta3": {"tied": "eta9"}}})


@pytest.mark.parametrize("slip", ["gamma1", "gamma2", "gamma3", "uniform", "gaussian", "power_law"])
def test_sampled_values_and_model_numbers_are_inverse(known, slip):
    problem = make_problem(known.loops(), {"model": {"slip": slip}})
    z = problem.prior.draw(np.random.default_rng(2), 200)
    v = problem.prior.values(z)
    again = problem.model.values(problem.model.parameter_values(v))
    for name in problem.names:
        np.testing.assert_allclose(again[name], v[name], rtol=1e-7, err_msg=name)


def test_mixtures_keep_scale_and_order(problem):
    """Σg = 1, the components' means rise, and Σ gᵢtᵢηᵢ is the sampled mean slip force less what further elements, with
    slip forces twice and four times as large, make of it, whatever z."""
    z = problem.prior.draw(np.random.default_rng(3), 500)
    n, v = problem.parameter_values(z), problem.prior.values(z)
    g, t, eta = (np.stack([n[f"{p}{i}{u}"] for i in (1, 2, 3)]) for p, u in (("g", ""), ("t", "_N"), ("eta", "")))
    np.testing.assert_allclose(g.sum(axis=0), 1.0)
    assert np.all(np.diff(t * eta, axis=0) > 0)
    twice, four_times = v["slip_larger2"], v["slip_larger4"]
    ratio = (1.0 + 2.0 * twice + 4.0 * four_times) / (1.0 + twice + four_times)
    np.testing.assert_allclose(ratio * (g * t * eta).sum(axis=0), v["mean_slip_force_N"])


@pytest.fixture(scope="module")
def plain(known):
    """The paper's own model: no embedded model error."""
    return make_problem(known.loops(), {"model": {"embedded": False}})


def test_paper_coordinates_round_trip_and_jacobian(plain, known):
    """ln|det dz/dy| against a determinant by finite differences, at points around the known numbers."""
    map_ = PaperCoordinates(plain)
    assert len(map_.names) == plain.ndim == 19
    rng = np.random.default_rng(4)
    z = known.true_z(plain, discrepancy_odd=0.01) + 0.1 * rng.standard_normal((6, plain.ndim))
    y = map_.y_of(z)
    np.testing.assert_allclose(map_.z_of(y), z, atol=1e-6)
    h = 1e-5
    for i in range(len(y)):
        both = map_.z_of(np.concatenate([y[i] + h * np.eye(19), y[i] - h * np.eye(19)]))
        jacobian = (both[:19] - both[19:]).T / (2 * h)
        assert map_.log_jacobian(y[i : i + 1])[0] == pytest.approx(np.linalg.slogdet(jacobian)[1], abs=1e-4)
    np.testing.assert_allclose(map_.log_prob(y), plain.log_prob(z) + map_.log_jacobian(y), atol=1e-6)


def test_paper_coordinates_refuse_what_is_impossible(plain, known):
    map_ = PaperCoordinates(plain)
    y = map_.y_of(known.true_z(plain))
    swapped, heavy = y.copy(), y.copy()
    t1, t2 = map_.names.index("t1_N"), map_.names.index("t2_N")
    swapped[0, t1] = y[0, t2] + 5.0
    heavy[0, map_.names.index("g1")] = 0.0
    assert map_.log_prob(np.concatenate([swapped, heavy])).tolist() == [-np.inf, -np.inf]
    with pytest.raises(ValueError, match="whole model"):
        PaperCoordinates(make_problem(known.loops(), {"model": {"normal_force": "constant"}}))
