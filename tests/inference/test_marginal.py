"""What the force is linear in integrated out: the integral and what is drawn, against the joint posterior."""

import numpy as np
import pytest
from scipy import special, stats

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


def own_y(y, root, own):
    """L⁻¹b with another last element of L."""
    return np.concatenate([y[:, :-1], y[:, -1:] * root[:, -1, -1:] / own[:, -1, -1:]], axis=1)


def difference(marginal, z, shift):
    """ln p(x) − ln p(x, c) + ln p(c | x) of z (n, ndim), at c so many of its standard deviations off its mean."""
    at = z.copy()
    at[:, marginal.drawn] = 0.0
    each, y, root = marginal._integrated(at)
    c, _ = marginal._given(np.zeros(len(z), dtype=int), y, root, np.full(y.shape, shift))
    conditional = each.copy()
    for k, precision in enumerate(marginal._last[0]):  # of each normal density of what is drawn last
        own = root.copy()
        own[:, -1, -1] = np.sqrt(root[:, -1, -1] ** 2 - 1.0 + precision)
        mean = np.linalg.solve(own.transpose(0, 2, 1), own_y(y, root, own)[:, :, None])[:, :, 0]
        unit = np.einsum("nij,ni->nj", own, c - mean)
        conditional[:, k] += np.log(np.diagonal(own, axis1=1, axis2=2)).sum(axis=1) - 0.5 * np.sum(unit**2, axis=1)
    at[:, marginal.drawn], ratio = marginal._scores(c)
    value = {q.name: q.value(at[:, i]) for q, i in zip(marginal._parameters, marginal.drawn) if not q.normal}
    # the joint density is that of z, the ratio's of the values
    by_value = sum(marginal.problem.prior[n].log_density(v) for n, v in value.items())
    places = [i for q, i in zip(marginal._parameters, marginal.drawn) if not q.normal]
    by_value = by_value + 0.5 * np.sum(at[:, places] ** 2, axis=1)
    found = np.logaddexp.reduce(conditional, axis=1) + ratio + marginal._prior_ratio(at)
    return found - marginal.problem.log_prob(marginal.joined(at, 1)) - by_value


@pytest.mark.parametrize("slip", ["gamma1", "uniform", "gaussian", "power_law"])
def test_the_integral_is_that_of_the_joint_density(loops, slip):
    """At every c the same, for the joint density is the product, whatever the priors and the family are: the density of
    c, of which one changes a value by its scale."""
    marginal = Marginal(make_problem(loops, {"model": SIMPLE["model"] | {"slip": slip}}))
    z = near(marginal.problem, 8, sd=1e-3)
    found = np.concatenate([difference(marginal, z, shift) for shift in (0.0, 1.0, -2.0)])
    scales = [scale for q, scale in zip(marginal._parameters, marginal._scale) if not q.normal]
    assert len(scales) == 2 and np.ptp(found) < 1e-5
    assert found[0] == pytest.approx(np.sum(np.log(scales)), abs=1e-4)


def test_draws_given_the_others_have_the_conditional_mean_and_covariance(marginal):
    x = np.tile(marginal.density.apart(near(marginal.problem, 1)), (4000, 1))
    found = marginal(x, generator((1,)))
    z = np.zeros((1, marginal.problem.ndim))
    z[:, marginal.walked] = x[:1]
    each, y, root = marginal._integrated(z)
    c = np.stack([
        f if q.normal else (q.value(f) - q.value(np.zeros(1))) / scale
        for q, scale, f in zip(marginal._parameters, marginal._scale, found[:, 1:].T)
    ], axis=1)  # fmt: skip
    precision = marginal._last[0]
    means = np.concatenate([marginal._given(np.array([k]), y, root, 0.0 * y)[0] for k in range(len(precision))])
    unit = (c - means[0]) @ root[0]
    at = np.tile(z, (len(x), 1))
    at[:, marginal.drawn] = found[:, 1:]
    level = np.logaddexp.reduce(each, axis=1)
    np.testing.assert_allclose(found[:, 0], level + marginal._scores(c)[1] + marginal._prior_ratio(at), atol=1e-6)
    others = unit[:, :-1]  # what is drawn last given, the others are the same for each of its normal densities
    np.testing.assert_allclose(others.mean(axis=0), 0.0, atol=0.08)
    np.testing.assert_allclose(np.cov(others.T), np.eye(others.shape[1]), atol=0.12)
    weight, last = np.exp(each[0] - level), means[:, -1]
    variance = 1.0 / (root[0, -1, -1] ** 2 - 1.0 + precision)
    mean = weight @ last
    sd = np.sqrt(weight @ (variance + (last - mean) ** 2))
    assert c[:, -1].mean() == pytest.approx(mean, abs=0.08 * sd) and c[:, -1].std() == pytest.approx(sd, rel=0.06)


def test_a_stiffness_is_drawn_where_it_can_be_and_counts_by_how_much_of_it_that_is(marginal):
    """Of a spring whose stiffness may as well be nothing: the estimates' mean is that of draws by the whole normal
    density, of which those below zero count nothing, and varies less."""
    d, n = len(marginal.drawn), 40000
    spring, scale = marginal._parameters[-2], marginal._scale[-2]
    sd = 0.5 * spring.value(np.zeros(1))[0] / scale  # half its median
    root = np.tile(np.eye(d), (n, 1, 1))
    root[:, -2, -2] = 1.0 / sd
    root[:, -1, -2] = 0.3 / sd  # what the zero has to do with it
    y = np.zeros((n, d))
    y[:, -2] = (-spring.value(np.zeros(1))[0] / scale + 0.5 * sd) / sd
    chosen, unit = np.zeros(n, dtype=int) + len(marginal._last[0]) - 1, np.random.default_rng(5).standard_normal((n, d))
    c, share = marginal._given(chosen, y, root, unit)
    z, ratio = marginal._scores(c)
    assert spring.value(z[:, -2]).min() > 0.0
    ours = np.exp(share + ratio)
    own = root.copy()
    own[:, -1, -1] = np.sqrt(marginal._last[0][-1])
    plain = np.linalg.solve(own.transpose(0, 2, 1), (y + unit)[:, :, None])[:, :, 0]
    with np.errstate(invalid="ignore"):
        theirs = np.nan_to_num(np.exp(marginal._scores(plain)[1]))
    assert 0.2 < np.mean(theirs == 0.0) < 0.5
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.04) and ours.std() < theirs.std()


def test_a_zero_of_which_loops_tell_nothing_has_its_prior(marginal):
    """The mixture of normal densities is all but the t distribution, so the estimate of the integral hardly varies."""
    d = len(marginal.drawn)
    n = 20000
    y, root = np.zeros((n, d)), np.tile(np.eye(d), (n, 1, 1))
    rng = np.random.default_rng(3)
    precision, log_weight = marginal._last
    assert np.logaddexp.reduce(log_weight) == pytest.approx(0.0, abs=1e-12)
    chosen = rng.choice(len(precision), n, p=np.exp(log_weight))
    c, _ = marginal._given(chosen, y, root, rng.standard_normal((n, d)))
    zero = marginal._parameters[-1]
    value = zero.value(np.zeros(1)) + marginal._scale[-1] * c[:, -1]
    assert stats.kstest(value, zero.prior.cdf).pvalue > 0.01
    at = np.zeros((7, d))
    at[:, -1] = [0.0, 0.5, 1.0, 3.0, 10.0, 100.0, -100.0]
    found = marginal._scores(at)[1]
    assert np.ptp(found) < 0.05


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


def test_walkers_move_in_what_loops_tell_and_the_whole_is_what_is_reported(marginal):
    """k(1) of all elements is that of the family's own that hold beyond a sixteenth of their mean, over their share,
    times what further elements add; the mean slip force that of the family's own times what these add."""
    problem, density = marginal.problem, marginal.density
    z = near(problem, 5, sd=0.3)
    x = density.apart(z)
    np.testing.assert_allclose(density.whole(x, z[:, marginal.drawn]), z, atol=1e-12)
    whole, own = problem.prior.values(z), problem.prior.values(marginal.joined(z, -1))
    two, four = (whole[f"slip_larger{s}"] for s in (2, 4))
    held = special.gammaincc(whole["eta1"], whole["eta1"] / 16.0)
    np.testing.assert_allclose(own["k1_N_mm"] / held * (1.0 + two + four), whole["k1_N_mm"])
    np.testing.assert_allclose(own["mean_slip_force_N"] * (1.0 + 2.0 * two + 4.0 * four), whole["mean_slip_force_N"])
    others = [i for i, n in enumerate(problem.names) if n not in ("k1_N_mm", "mean_slip_force_N")]
    np.testing.assert_array_equal(marginal.joined(z, -1)[:, others], z[:, others])


@pytest.mark.parametrize("name", ["k1_N_mm", "mean_slip_force_N", "slip_larger2"])
def test_further_elements_are_walked_in_where_what_they_add_to_is_fixed(loops, name):
    """The force is not linear in them then; all else is drawn as before."""
    fixed = {"slip_larger2": 0.02}.get(name, 0.5)
    problem = make_problem(loops, {**SIMPLE, "parameters": {name: {"fixed": fixed}}})
    marginal = Marginal(problem)
    drawn = {problem.names[i] for i in marginal.drawn}
    assert drawn == {*SLIP_NAMES[:-2], "kp_N_mm", "force_zero_N"}
    z = near(problem, 4, sd=0.002)
    np.testing.assert_array_equal(marginal.joined(z, 1), z)
    found = np.concatenate([difference(marginal, z, shift) for shift in (0.0, 1.0)])
    assert np.ptp(found) < 1e-5


def test_numbers_of_the_density_are_judged_by_r_hat_alone(loops, monkeypatch):
    """Its mean, stiffnesses and noise are not among them."""
    plans = []
    monkeypatch.setattr(posterior_draws, "sample", lambda density, optima, roots, plan, **rest: plans.append(plan))
    problem = make_problem(loops, {})
    posterior_draws.sampled(problem, np.zeros((1, problem.ndim)), SamplingSettings(), posterior_draws.Run(1))
    found = plans[0].by_r_hat
    assert {"eta1", "share_1", "slip_ratio_21", "slip_deviation12", "slip_larger4", "g3", "t2_N"} <= found
    assert not found & {"mean_slip_force_N", "kp_N_mm", "k1_N_mm", "noise_scale", "normal_force_slope"}
