"""Between-test variance and reach: against textbook formulas and against full refits without a test."""

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.setup.discrepancy import on_phases
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.solving import intervals
from bayes_iwan.inference.solving.bent import bent_form
from bayes_iwan.inference.solving.intervals import (
    BEYOND,
    CORRELATED,
    ROUGH_FREEDOM,
    ROUGHNESS,
    USUAL_FREEDOM,
    Widening,
    _form,
    between_draws,
    freedom_of,
    reach_of,
    shared,
    widenings,
)
from bayes_iwan.inference.solving.jackknife import jackknife_variance, left_out_optima
from bayes_iwan.inference.solving.point import most_probable
from bayes_iwan.physics import Model
from bayes_iwan.physics.laws.embedded import NAMES, TILT_NAMES

SIMPLE = {"model": {"slip": "gamma1", "grip": "constant", "stiffness": "constant"}}


@pytest.fixture(scope="module")
def simple(known):
    """A problem of few numbers, whose model is off: it made no such loops."""
    problem = make_problem(known.loops(), SIMPLE)
    optima, _, _ = most_probable(problem, problem.prior.draw(np.random.default_rng(0), 6))
    return problem, optima[0]


def test_jackknife_of_a_mean_is_its_textbook_variance():
    x = np.random.default_rng(1).normal(size=(7, 3))
    without = (x.sum(axis=0) - x) / 6
    np.testing.assert_allclose(jackknife_variance(without), x.var(axis=0, ddof=1) / 7)


def test_left_out_optima_are_those_of_a_refit(simple):
    problem, z = simple
    found = left_out_optima(problem, z, iterations=12)
    noise = [problem.names.index(p.name) for p in problem.likelihood.parameters]
    for t in (0, 2):
        others = [i for i in range(4) if i != t]
        at = problem.prior.values(z)
        values = {p.name: {"fixed": float(at[p.name][0])} for p in problem.likelihood.parameters}
        loops = tuple(problem.loops[i] for i in others)
        refit = make_problem(loops, SIMPLE | {"parameters": values}, scales=problem.scales)
        refit = type(refit)(loops, refit.scales, refit.model, refit.prior, problem.likelihood.of_tests(others))
        start = np.delete(z, noise)[None]
        optimum = most_probable(refit, start)[0][0]
        np.testing.assert_allclose(np.delete(found[t], noise), optimum, atol=0.01)
        assert np.max(np.abs(np.delete(found[t] - z, noise))) > 0.01  # the tests do disagree


def test_interval_without_additions_is_the_draws_own():
    x = np.random.default_rng(2).lognormal(size=20_000)
    for relative in (True, False):
        low, high = Widening(float("nan"), 0.0, 1, relative, "").interval(x)
        np.testing.assert_allclose([low, high], np.quantile(x, [0.05, 0.95]), rtol=1e-6)


def test_interval_of_between_test_variance_alone_is_students():
    """Draws that all agree: ± t(T − 1) standard deviations between tests."""
    low, high = Widening(0.2, 0.0, 3, False, "").interval(np.full(50, 5.0))
    np.testing.assert_allclose([low, high], 5.0 + 0.2 * stats.t.ppf([0.05, 0.95], 3), rtol=1e-9)


def test_draws_between_tests_have_the_jackknifes_covariance():
    rng = np.random.default_rng(3)
    without = rng.normal(size=(5, 2, 3))
    x = between_draws(without, AMPLITUDES_MM, 40_000, rng)
    factor = BEYOND * shared(AMPLITUDES_MM)
    np.testing.assert_allclose(x.var(axis=0), factor**2 * jackknife_variance(without), rtol=0.05)
    assert not between_draws(without[:1], [0.3], 4, rng).any()


#: five tests: three of one amplitude, two of another
AMPLITUDES_MM = (0.3, 0.9, 0.3, 0.9, 0.303)


def test_jackknife_of_a_mean_over_tests_that_share_their_misfit_is_made_up_for():
    """Means of five numbers, those of one amplitude correlated: simulated, the jackknife's variance times the factor's
    square is the mean's variance; for tests of as many amplitudes there is nothing to make up for."""
    rng = np.random.default_rng(5)
    same = np.abs(np.subtract.outer(AMPLITUDES_MM, AMPLITUDES_MM)) < 0.1
    root = np.linalg.cholesky(CORRELATED * same + (1.0 - CORRELATED) * np.eye(5))
    x = rng.standard_normal((200_000, 5)) @ root.T
    without = np.stack([np.delete(x, t, axis=1).mean(axis=1) for t in range(5)])
    stated = shared(AMPLITUDES_MM) ** 2 * jackknife_variance(without).mean()
    assert stated == pytest.approx(x.mean(axis=1).var(), rel=0.02)
    assert shared([0.1, 0.2, 0.3]) == 1.0 and shared([0.3]) == 1.0 and shared([0.3, 0.3]) > 2.0


def test_a_variance_between_correlated_tests_has_the_freedom_of_fewer_independent_ones():
    """Of a variance told by ν degrees of freedom the relative variance is 2/ν."""
    rng, draws, amplitudes = np.random.default_rng(4), 200_000, [0.3, 0.6, 0.9] * 4
    of_amplitude = {a: rng.normal(size=draws) for a in set(amplitudes)}
    x = [CORRELATED**0.5 * of_amplitude[a] + (1 - CORRELATED) ** 0.5 * rng.normal(size=draws) for a in amplitudes]
    variance = np.var(x, axis=0)
    assert freedom_of(amplitudes) == pytest.approx(2.0 * variance.mean() ** 2 / variance.var(), rel=0.03)
    assert freedom_of([0.1, 0.2, 0.3, 0.4]) == pytest.approx(3.0) and freedom_of([0.3]) == 0.0
    assert freedom_of([0.2, 0.2, 0.2]) == pytest.approx(2.0)  # all of one: only what differs within it


def test_variances_add_and_students_quantiles_follow_welch_and_satterthwaite():
    x = 10.0 + stats.norm.ppf((np.arange(9999) + 0.5) / 9999)
    low, high = Widening(1.5, 2.0, 3, False, "").interval(x)
    total, freedom = 1.0 + 1.5**2 + 2.0**2, 7.25**2 / (1.5**4 / 3 + 2.0**4 / ROUGH_FREEDOM)
    np.testing.assert_allclose([low, high], 10.0 + np.sqrt(total) * stats.t.ppf([0.05, 0.95], freedom), atol=0.01)


@pytest.mark.parametrize(("seen_sd", "tests"), [(0.3, 3), (0.05, 9), (float("nan"), 1)])
def test_what_few_tests_show_is_moderated_by_what_is_usual(seen_sd, tests):
    """The posterior variance of scaled inverse chi-squared draws: degrees of freedom add, variances are weighed by
    them; a single test shows nothing."""
    widening = Widening(seen_sd, 0.0, tests - 1, False, "", usual_sd=0.1)
    freedom = tests - 1 + USUAL_FREEDOM
    expected = (np.nan_to_num((tests - 1) * seen_sd**2) + USUAL_FREEDOM * 0.1**2) / freedom
    low, high = widening.interval(np.full(50, 5.0))
    np.testing.assert_allclose([low, high], 5.0 + np.sqrt(expected) * stats.t.ppf([0.05, 0.95], freedom), rtol=1e-9)
    assert widening.alone().interval(np.array([1.0, 2.0])) == pytest.approx((1.05, 1.95))


def test_reach_is_what_amplitudes_and_band_allow(simple):
    problem, z = simple
    reach = reach_of(problem, z)
    order = [np.max(np.nonzero(np.isfinite(x.noise_N))) for x in problem.loops]
    step = min(x.amplitude_mm * (1 - np.cos(np.pi / h)) for x, h in zip(problem.loops, order))
    k1 = problem.parameter_values(z[None])["k1_N_mm"][0]
    assert reach.lowest_N == pytest.approx(0.5 * k1 * step) and reach.highest_N == pytest.approx(k1 * 1.0, rel=1e-3)
    # beside the quarter of elements that slip first
    parameter_values = problem.parameter_values(z[None])
    phi = np.linspace(0.0, reach.highest_N, 20_001)
    quartile = np.interp(0.25, 1.0 - problem.model.slip_family.survival(phi, parameter_values)[0], phi)
    assert reach.part == pytest.approx(reach.lowest_N / quartile, rel=1e-2)


def test_every_quantity_is_widened_and_the_low_tail_most(simple):
    problem, z = simple
    found = widenings(problem, z)
    assert {"kp_N_mm", "k1_N_mm", "mean_slip_force_N", "slip_force_q05_N"} <= set(found)
    freedom = freedom_of([x.amplitude_mm for x in problem.loops])
    assert all(np.isfinite(w.between_sd) and w.freedom == freedom for w in found.values())
    assert found["slip_force_q05_N"].rough_sd > found["slip_force_q50_N"].rough_sd
    assert found["kp_N_mm"].rough_sd == 0.0 and found["kp_N_mm"].reach == ""


@pytest.mark.parametrize("coarse", [1.0, 60.0])
def test_what_lies_below_the_finest_step_is_said_to_be_extrapolated(simple, coarse, monkeypatch):
    """Steps of so many times their size."""
    problem, z = simple
    monkeypatch.setattr(intervals, "_step_mm", lambda loop, finest=intervals._step_mm: coarse * finest(loop))
    reach, found, at = reach_of(problem, z), widenings(problem, z), quantities(problem, z[None])
    below = [n for n in found if n.startswith("slip_force_q") and at[n].values[0] < reach.lowest_N]
    if reach.part > 0.12:
        below.append("k1_N_mm")
    assert {n for n, w in found.items() if "no step under" in w.reach} == set(below)
    assert bool(below) == (coarse > 1.0)


def test_a_quantile_of_the_slip_forces_moves_by_what_no_family_has(simple):
    problem, z = simple
    found, reach = widenings(problem, z)["slip_force_q75_N"], reach_of(problem, z)
    parameter_values = problem.parameter_values(z[None])
    phi = np.linspace(0.0, reach.highest_N, 20_001)
    below = 1.0 - problem.model.slip_family.survival(phi, parameter_values)[0]
    middle, other = np.interp([0.75, 0.75 - ROUGHNESS], below, phi)
    assert found.rough_sd == pytest.approx(np.log(middle / other), rel=1e-2)


@pytest.mark.parametrize("other", [2.0, 0.4])
def test_two_forms_are_averaged_as_a_mixture_of_two_normals(other):
    """Centre and variance of a mixture: w·δ, and the mean variance plus w(1 − w)·δ²."""
    w, sd, apart = 0.3, 1.0, 1.5
    x = 10.0 + stats.norm.ppf((np.arange(9999) + 0.5) / 9999)
    widening = Widening(0.0, 0.0, 3, False, "", _form(w, 10.0, 10.0 + apart, sd, other))
    total = np.sqrt((1.0 - w) * sd**2 + w * other**2 + w * (1.0 - w) * apart**2)
    np.testing.assert_allclose(widening.interval(x), 10.0 + w * apart + total * stats.norm.ppf([0.05, 0.95]), atol=0.01)
    assert widening.centre(x) == pytest.approx(10.0 + w * apart)
    assert widening.alone().interval(x) == pytest.approx(tuple(np.quantile(x, [0.05, 0.95])), abs=1e-3)


@pytest.mark.parametrize("relative", [False, True])
def test_plain_draws_beside_a_likelier_narrower_form_count_as_far_as_it_is_wide(relative):
    """All weight on a form ten times as narrow: a plain median two of its own sd off leaves a tenth of that."""
    x = 3.0 + 0.2 * 2.0 + 0.2 * stats.norm.ppf((np.arange(9999) + 0.5) / 9999)
    widening = Widening(0.0, 0.0, 3, relative, "", _form(1.0, 3.0, 2.5, 0.2, 0.02))
    back = np.exp if relative else np.asarray
    assert widening.centre(back(x)) == pytest.approx(back(2.54), rel=1e-4)
    np.testing.assert_allclose(widening.interval(back(x)), back(2.54 + 0.02 * stats.norm.ppf([0.05, 0.95])), rtol=1e-4)


def test_a_form_that_says_nothing_finite_moves_nothing():
    widening = Widening(0.0, 0.0, 3, False, "", _form(1.0, 2.0, np.nan, 1.0, 1.0))
    assert widening.centre(np.array([1.0, 2.0, 3.0])) == 2.0
    # what the plain form holds, the bent moves
    constant = Widening(0.0, 0.0, 3, False, "", _form(1.0, 1.0, 1.5, 0.0, 0.2))
    low, high = constant.interval(np.full(9, 1.0))
    assert (low, high) == pytest.approx((1.5 - 0.329, 1.5 + 0.329), abs=1e-3)


def with_noise(problem, force_N, seed):
    """The same problem on other loops, with noise as the records' repeatability says."""
    rng = np.random.default_rng(seed)
    noise = np.array([np.where(np.isfinite(x.noise_N), x.noise_N, 0.0) for x in problem.loops])
    parts = rng.standard_normal((2, *noise.shape)) * noise
    return problem.with_force(force_N + on_phases(parts, force_N.shape[-1]))


@pytest.mark.parametrize("tilt", [0.0, 0.25])
def test_a_bent_specimen_is_told_from_a_straight_one(simple, tilt):
    """Loops of slip forces that are no gamma's: the bent form is the likely one, and moves kp towards the truth."""
    problem, z = simple
    model = Model(problem.scales.reference, "gamma1", "constant", "constant", embedded=True)
    values = {k: v for k, v in problem.parameter_values(z[None]).items()}
    truth = values | {name: np.zeros(1) for name in NAMES} | {TILT_NAMES[1]: np.full(1, tilt)}
    made = with_noise(problem, model.force(truth, problem.motion)[0], 4)
    optimum = most_probable(made, z[None])[0][0]
    bent, found = bent_form(made, optimum), widenings(made, optimum)
    kp = truth["kp_N_mm"][0]
    plain = made.parameter_values(optimum[None])["kp_N_mm"]
    if tilt:
        assert bent.weight > 0.99
        assert abs(found["kp_N_mm"].centre(plain) / kp - 1.0) < 0.5 * abs(plain[0] / kp - 1.0)
    else:
        assert bent.weight < 0.5
        assert abs(found["kp_N_mm"].centre(plain) / kp - 1.0) < 1e-3


def test_only_a_plain_iwan_model_has_a_bent_form(simple):
    problem, z = simple
    bent = bent_form(problem, z)
    assert bent.problem.ndim == problem.ndim + len(NAMES)
    assert bent_form(bent.problem, bent.z) is None
