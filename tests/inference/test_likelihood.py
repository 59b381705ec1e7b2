"""The objective as printed, its likelihoods, and what they may not do: create information out of a finer grid."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.results.predictions import shown_noise
from bayes_iwan.inference.setup import discrepancy, likelihood
from bayes_iwan.inference.setup.discrepancy import Correlated, on_phases
from bayes_iwan.inference.setup.likelihood import KINDS, make_likelihood
from bayes_iwan.inference.setup.loop_error import (
    beyond_noise_N2,
    friction_level_N,
    goal_function,
    harmonics_of,
    paper_weights,
)
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.spectrum import between_tests, discrepancy_spectrum
from bayes_iwan.inference.solving.point import laplace_scale


def test_weights_of_eq_9():
    """0.2 + √(1 − (u/A)²): 1.2 in mid-stroke, 0.2 at its ends, 0.8 at u = 0.8 A; not NaN beyond A."""
    w = paper_weights(np.array([[0.0, 0.4, 0.5, -0.5, 0.51]]), np.array([0.5]))
    np.testing.assert_allclose(w[0], [1.2, 0.8, 0.2, 0.2, 0.2])


def test_goal_of_eq_8_by_hand():
    """1/(A n) Σ w |r| of two tests of three points."""
    u = np.array([[0.0, 0.3, 0.5], [0.0, 0.0, -2.0]])
    r = np.array([[[0.1, -0.2, 0.3], [1.0, -1.0, 2.0]]])
    expected = (1.2 * 0.1 + 1.0 * 0.2 + 0.2 * 0.3) / (0.5 * 3) + (1.2 + 1.2 + 0.2 * 2.0) / (2.0 * 3)
    assert goal_function(r, u, np.array([0.5, 2.0]))[0] == pytest.approx(expected)


def test_noise_is_taken_off_but_no_more_than_there_is():
    residual, noise = np.array([4.0, 1.0]), np.array([1.0, 2.0])
    assert beyond_noise_N2(residual, noise) == pytest.approx([3.0, -1.0])
    assert beyond_noise_N2(residual, 10.0 * noise).sum() == pytest.approx(0.0)


def hand_written_goal(problem, residual, squared):
    """Eq. (8) with Eq. (9), point by point: Σ_tests 1/(A n) Σ_i (0.2 + √(1 − (u_i/A)²)) |r_i| or r_i²."""
    total = 0.0
    for loop, row in zip(problem.loops, residual):
        a, n = loop.amplitude_mm, len(loop.phase)
        for u, r in zip(loop.displacement_mm, row):
            w = 0.2 + np.sqrt(max(1.0 - (u / a) ** 2, 0.0))
            total += w * (r * r if squared else abs(r)) / (a * n)
    return total


@pytest.mark.parametrize("kind", ["laplace", "gaussian"])
def test_minimising_the_goal_is_maximum_likelihood(problem, kind):
    """Several tests, one of them with few harmonics: with the scale at its own best, ln L = constant − N ln Eq. (8)
    (Laplace), or half of that (Gaussian, squares)."""
    few = replace(problem.loops[1], noise_N=np.where(np.arange(51) > 4, np.inf, problem.loops[1].noise_N))
    loops = (problem.loops[0], few, *problem.loops[2:])
    like = make_problem(loops, {"likelihood": {"kind": kind}}).likelihood
    r = 0.1 * np.random.default_rng(0).standard_normal((5, 4, 128)) * np.geomspace(0.1, 10.0, 5)[:, None, None]
    scale = np.geomspace(1e-3, 3.0, 4001)
    best = [np.max(like.log_likelihood(np.repeat(x[None], len(scale), 0), {"noise_N": scale})) for x in r]
    goal = [hand_written_goal(problem, x, kind == "gaussian") for x in r]
    n = 3 * 101 + 9
    power = n if kind == "laplace" else 0.5 * n
    np.testing.assert_allclose(np.diff(best), np.diff(-power * np.log(goal)), rtol=1e-3)


def test_short_correlation_tends_to_the_squared_form_of_eq_8(problem):
    """Discrepancies uncorrelated along the loop and between tests, far above the noise: −2 ln L differs between
    residuals by Eq. (8) with squares, times one constant for all tests."""
    like = make_problem(problem.loops).likelihood
    assert isinstance(like, Correlated)
    alone = replace(like, between=(0.8, 0.5, 1.0))
    angle = 2.0 * np.pi * np.arange(128)[:, None] / 128 * np.arange(1, 9)
    rng = np.random.default_rng(5)
    r = np.stack([np.cos(angle + rng.uniform(0, 7, 8)) @ rng.standard_normal(8) for _ in range(24)])  # harmonics 1 to 8
    r = 0.05 * r.reshape(6, 4, 128)
    r -= np.sum(r * like.root_weights, axis=2, keepdims=True) / np.sum(like.root_weights, axis=1)[:, None]
    share = 30.0  # so that noise, floors included, is nothing
    # odd and even orders alike: 26 and 25 of them
    odd, even = share * np.sqrt([25 / 51, 26 / 51])
    parameter_values = {"noise_scale": 1.0, "discrepancy_odd": odd, "discrepancy_even": even, "discrepancy_slope": 0.0}
    got = -2.0 * alone.log_likelihood(r, {k: np.full(6, v) for k, v in parameter_values.items()})
    goal = np.array([hand_written_goal(problem, x, True) for x in r])
    # Σ_h |e_h|² = 2 mean(e²), e² = w r² / mean w; the variance of each of the 51 orders is (share slip)² A / (ℓ 51)
    w = paper_weights(problem.motion.displacement_mm[0], problem.motion.amplitude_mm).mean()
    s = problem.scales
    factor = 2.0 / w * s.length_mm * 51 / (share * s.slip_N) ** 2
    np.testing.assert_allclose(np.diff(got), factor * np.diff(goal), rtol=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_parts_sum_up(problem, known, kind):
    """Pointwise terms sum to ln L; half the squared rows differ as −ln L does while the noise stays."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = np.repeat(known.true_z(p, noise_scale=1.2, discrepancy_odd=0.01), 4, axis=0)
    physical = [i for i, n in enumerate(p.names) if n not in p.noise_names]
    z[:, physical] += 0.02 * np.random.default_rng(1).standard_normal((4, len(physical)))
    total = p.log_likelihood(z)
    np.testing.assert_allclose(p.pointwise(z).sum(axis=1), total, rtol=1e-9)
    if kind != "laplace":
        rows = p.likelihood.rows(p.residual(z), p.parameter_values(z))
        np.testing.assert_allclose(np.diff(-0.5 * (rows**2).sum(axis=1)), np.diff(total), rtol=1e-6)


def test_parts_sum_up_where_one_test_alone_resolves_a_harmonic(problem, known):
    few = replace(problem.loops[1], noise_N=np.where(np.arange(51) > 4, np.inf, problem.loops[1].noise_N))
    p = make_problem((problem.loops[0], few))
    z = known.true_z(p) + np.array([[0.0], [0.02]])
    assert p.pointwise(z).shape == (2, 51 + 5)
    np.testing.assert_allclose(p.pointwise(z).sum(axis=1), p.log_likelihood(z), rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_tests_does_not_matter(problem, known, kind):
    """Of tests one resolves few harmonics, the first or the last, as where frequencies differ at one rate."""
    few = replace(problem.loops[0], noise_N=np.where(np.arange(51) > 4, np.inf, problem.loops[0].noise_N))
    first, last = (few, *problem.loops[1:3]), (*problem.loops[1:3], few)
    found = []
    for loops in (first, last):
        p = make_problem(loops, {"likelihood": {"kind": kind}}, scales=problem.scales)
        z = known.true_z(p) + np.array([[0.0], [0.02]])
        found.append(p.log_likelihood(z))
        np.testing.assert_allclose(p.pointwise(z).sum(axis=1), found[-1], rtol=1e-9)
    np.testing.assert_allclose(*found, rtol=1e-9)


@pytest.mark.parametrize("kind", ["gaussian", "laplace"])
def test_noise_means_the_same_of_some_tests_and_of_others(problem, known, kind):
    """The density of one test is the whole's over that of the others; noise carried over to it is as large as its
    own."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = known.true_z(p)
    values, residual = p.parameter_values(z), p.residual(z)
    points = p.likelihood.pointwise(residual, values).reshape(len(p.loops), -1).sum(axis=1)
    for t in range(len(p.loops)):
        kept = [i for i in range(len(p.loops)) if i != t]
        others = p.likelihood.of_tests(kept)
        alone = p.log_likelihood(z) - others.log_likelihood(residual[:, kept], values)
        np.testing.assert_allclose(alone, points[t], rtol=1e-9)
        many = {n: np.repeat(x, 500) for n, x in values.items()}
        none = np.zeros((500, *residual.shape[1:]))
        carried = others.carried_over(none[:, kept], many, [p.loops[t]], np.random.default_rng(1))
        own = p.likelihood.replicate(none, many, np.random.default_rng(2))[:, [t]]
        assert np.std(carried) == pytest.approx(np.std(own), rel=0.03)


def test_pointwise_densities_are_those_of_scipy(problem, known):
    """Laplace of scale b/v and Gaussian of variance σ²/v, v = w/A over its mean, each point weighing (2H + 1)/n."""
    r = problem.residual(known.true_z(problem))
    w = paper_weights(problem.motion.displacement_mm[0], problem.motion.amplitude_mm)
    w /= problem.motion.amplitude_mm[:, None]
    w /= stats.gmean(w, axis=None)
    b = {"noise_N": np.array([0.03])}
    densities = {"laplace": stats.laplace(scale=0.03 / w), "gaussian": stats.norm(scale=0.03 / np.sqrt(w))}
    for kind, density in densities.items():
        like = make_likelihood(kind, problem.loops, problem.scales)
        expected = 101 / 128 * density.logpdf(r[0])
        np.testing.assert_allclose(like.pointwise(r, b).reshape(r.shape[1:]), expected, rtol=1e-9)


@pytest.mark.parametrize("kind", ["correlated", "unweighted", "matern"])
def test_correlated_is_a_multivariate_normal(problem, kind):
    """Against scipy's, with the covariance of all tests' harmonics written out, harmonic by harmonic; weighted, it is
    that of √(w/w̄)·(residual − its mean by √w), and of the mean."""
    like = make_problem(problem.loops, {"likelihood": {"kind": kind}}).likelihood
    assert isinstance(like, Correlated)
    angle = 2.0 * np.pi * np.arange(128) / 128 * np.arange(31)[:, None]
    rng = np.random.default_rng(2)
    r = 0.05 * (rng.standard_normal((4, 31)) @ np.cos(angle) + rng.standard_normal((4, 31)) @ np.sin(angle))
    if kind == "matern":
        parameter_values = {"discrepancy_share": np.array([0.02]), "discrepancy_length": np.array([0.1])}
        spectrum = discrepancy_spectrum(np.array([0.02]), np.array([0.1]), 51)[0]
    else:
        parameter_values = {k: np.array([v]) for k, v in (("odd", 0.02), ("even", 0.01), ("slope", 1.5))}
        parameter_values = {f"discrepancy_{k}": v for k, v in parameter_values.items()}
        order = np.maximum(np.arange(51), 1)
        fall = order**-1.5 * np.where(order % 2 == 1, 0.02**2, 0.01**2)
        fall[0] = 0.01**2
        odd = np.arange(51) % 2 == 1
        spectrum = fall / np.where(odd, np.sum(order[odd] ** -1.5), np.sum(order[~odd] ** -1.5))
    parameter_values["noise_scale"] = np.array([1.3])
    amplitude = problem.motion.amplitude_mm
    if kind == "correlated":
        root = np.sqrt(paper_weights(problem.motion.displacement_mm[0], amplitude))
        root /= np.sqrt(np.mean(root**2, axis=1, keepdims=True))
        mean = np.sum(root * r, axis=1) / np.sum(root, axis=1)
        c = harmonics_of(root * (r - mean[:, None]), 51)
        c[:, 0] = mean
        size = problem.scales.slip_N * np.sqrt(amplitude / max(amplitude))
    else:
        c, size = harmonics_of(r, 51), friction_level_N(problem.loops)
    near = np.outer(size, size) * between_tests(problem.loops, like.between)
    noise = np.exp(like.rotation[3])  # (H, tests): of the records, floors included
    total = 0.0
    for h in range(51):
        cov = 1.3**2 * np.diag(noise[h] ** 2) + spectrum[h] * near
        total += stats.multivariate_normal.logpdf(c[:, h].real, cov=cov)
        total += stats.multivariate_normal.logpdf(c[:, h].imag, cov=cov) if h else 0.0
    assert like.log_likelihood(r[None], parameter_values)[0] == pytest.approx(total, rel=1e-9)


def test_correlated_noise_is_that_of_the_records(problem):
    """White noise of 0.02 N over n samples averaged: each part of a harmonic errs by 0.02 √(2/n) N."""
    expected = 0.02 * np.sqrt(2.0 / (128 * problem.loops[0].n_cycles))
    got = np.exp(problem.likelihood.rotation[3])[1:]
    assert np.median(got) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_replicates_follow_the_likelihood(problem, known, kind):
    """The mean of −ln p over replicates is the entropy that the noise model has by formula."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = np.repeat(known.true_z(p, noise_scale=1.2, discrepancy_odd=0.02), 400, axis=0)
    n, force = p.parameter_values(z), p.predict(z)
    r = p.likelihood.replicate(force, n, np.random.default_rng(3)) - force
    got = -p.likelihood.log_likelihood(r, n)
    if isinstance(p.likelihood, Correlated):
        variance = p.likelihood._variance({k: v[:1] for k, v in n.items()})[:, 0]
        degrees = np.where(np.arange(51) == 0, 1.0, 2.0)[:, None]
        log_noise = p.likelihood.rotation[3]
        entropy = np.sum(0.5 * degrees * (np.log(2 * np.pi * variance) + 1.0 + 2.0 * log_noise))
    else:
        w = paper_weights(p.motion.displacement_mm[0], p.motion.amplitude_mm)
        w /= p.motion.amplitude_mm[:, None]
        w /= stats.gmean(w, axis=None)
        entropy = np.sum(
            101
            / 128
            * (np.log(2 * 0.02 / w) + 1 if kind == "laplace" else 0.5 * np.log(2 * np.pi * np.e * 0.02**2 / w))
        )
    assert np.mean(got) == pytest.approx(entropy, abs=4 * np.std(got) / np.sqrt(len(got)))


@pytest.mark.parametrize("kind", KINDS)
def test_no_draws_have_no_rows(problem, kind):
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    assert p.rows(np.empty((0, p.ndim))).shape == (0, p.rows(np.zeros((1, p.ndim))).shape[1])


@pytest.mark.parametrize("kind", KINDS)
def test_a_finer_phase_grid_is_no_more_information(known, kind):
    """Laplace widths of all numbers at 128 and 256 phases of one and the same record agree within 3 %."""
    widths = []
    for n_phase in (128, 256):
        p = make_problem(known.loops(n_phase=n_phase), {"likelihood": {"kind": kind}})
        z = known.true_z(p, discrepancy_odd=0.01)[0]
        widths.append(np.sqrt(np.sum(laplace_scale(p, z) ** 2, axis=1)))
    np.testing.assert_allclose(widths[1], widths[0], rtol=0.03)


@pytest.mark.parametrize("kind", ["correlated", "gaussian", "laplace"])
def test_weights_of_another_size_are_no_more_information(problem, known, kind, monkeypatch):
    """Eq. (9) times any constant gives the same likelihood."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = known.true_z(p)
    before = p.log_likelihood(z)
    for room in (likelihood, discrepancy):
        monkeypatch.setattr(room, "paper_weights", lambda u, a: 10.0 * paper_weights(u, a))
    after = make_problem(problem.loops, {"likelihood": {"kind": kind}}).log_likelihood(z)
    np.testing.assert_allclose(after, before, rtol=1e-12)


def test_harmonics_that_sampling_cannot_resolve_do_not_count(problem):
    """A loop whose noise is infinite above harmonic 10 says nothing there: its residuals may be anything."""
    loops = tuple(
        replace(x, noise_N=np.where(np.arange(51) > 10, np.inf, x.noise_N)) if k == 1 else x
        for k, x in enumerate(problem.loops)
    )
    p = make_problem(loops)
    parameter_values = {p.name: p.value(np.zeros(1)) for p in p.likelihood.parameters}
    r = 0.01 * np.random.default_rng(4).standard_normal((1, 4, 128))
    odd = r.copy()
    odd[0, 1] += np.cos(2 * np.pi * 20 * np.arange(128) / 128)
    assert p.likelihood.log_likelihood(odd, parameter_values) == pytest.approx(
        p.likelihood.log_likelihood(r, parameter_values)
    )
    assert p.likelihood.pointwise(r, parameter_values).shape == (1, 4 * 51 - 40)
    odd[0, 0] += np.cos(2 * np.pi * 20 * np.arange(128) / 128)
    assert p.likelihood.log_likelihood(odd, parameter_values) < p.likelihood.log_likelihood(r, parameter_values) - 1000


def test_replicates_have_no_noise_where_there_are_no_data(problem, known):
    """Harmonics that a loop's sampling cannot resolve stay the model's own; all others err as the records say."""
    loops = tuple(
        replace(x, noise_N=np.where(np.arange(51) > 10, np.inf, x.noise_N)) if k == 1 else x
        for k, x in enumerate(problem.loops)
    )
    p = make_problem(loops)
    z = np.repeat(known.true_z(p, noise_scale=1.0, discrepancy_odd=1e-5, discrepancy_even=1e-5), 400, axis=0)
    force = p.predict(z)
    c = harmonics_of(p.likelihood.replicate(force, p.parameter_values(z), np.random.default_rng(7)) - force, 51)
    assert np.max(np.abs(c[:, 1, 11:])) < 1e-12
    for t, top in ((0, 51), (1, 11)):
        noise = np.exp(p.likelihood.rotation[3])[1:top, t]
        np.testing.assert_allclose(c[:, t, 1:top].real.std(axis=0), noise, rtol=0.2)


@pytest.mark.parametrize("kind", ["gaussian", "laplace"])
def test_replicates_of_few_harmonics_err_as_much_as_measured_loops(problem, known, kind):
    """noise_N is how far measured loops, which have their few harmonics alone, are off; so are replicates of these."""
    few = np.where(np.arange(51) > 16, np.inf, problem.loops[0].noise_N)
    p = make_problem([replace(x, noise_N=few) for x in problem.loops], {"likelihood": {"kind": kind}})
    z = np.repeat(known.true_z(p), 400, axis=0)
    n, force = p.parameter_values(z), p.predict(z)
    error = shown_noise(p.likelihood.replicate(force, n, np.random.default_rng(3)) - force, p.loops)
    weighted = p.likelihood.weights * np.abs(error) if kind == "laplace" else np.sqrt(p.likelihood.weights) * error
    size = np.mean(np.abs(weighted)) if kind == "laplace" else np.std(weighted)
    assert size == pytest.approx(n["noise_N"][0], rel=0.05)


def test_unknown_likelihood_is_named(problem):
    with pytest.raises(ValueError, match=r"likelihood.kind = 'student'.*correlated, unweighted, matern, gaussian"):
        make_problem(problem.loops, {"likelihood": {"kind": "student"}})


def test_harmonics_on_the_phases_of_a_loop():
    """A mean of 2 and a first harmonic of 3 − 4i are 2 + 3 cos + 4 sin, of a second loop −1 + 5 cos."""
    parts = np.array([[[2.0, 3.0], [-1.0, 5.0]], [[0.0, -4.0], [0.0, 0.0]]])
    phase = 2.0 * np.pi * np.arange(16) / 16
    expected = [2.0 + 3.0 * np.cos(phase) + 4.0 * np.sin(phase), -1.0 + 5.0 * np.cos(phase)]
    np.testing.assert_allclose(on_phases(parts, 16), expected, atol=1e-12)
