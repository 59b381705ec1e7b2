"""The objective as printed, its likelihoods, and what they may not do: create information out of a finer grid."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference import likelihood
from bayes_iwan.inference.likelihood import (
    Correlated,
    between_tests,
    discrepancy_spectrum,
    goal_function,
    harmonics_of,
    make_likelihood,
    paper_weights,
)
from bayes_iwan.inference.point import laplace_scale
from bayes_iwan.inference.problem import make_problem

ONE_TEST = ((10.0, 1.0),)


def test_weights_of_eq_9():
    """0.2 + √(1 − (u/A)²): 1.2 in mid-stroke, 0.2 at its ends, 0.8 at u = 0.8 A; not NaN beyond A."""
    w = paper_weights(np.array([[0.0, 0.4, 0.5, -0.5, 0.51]]), np.array([0.5]))
    np.testing.assert_allclose(w[0], [1.2, 0.8, 0.2, 0.2, 0.2])


def test_goal_of_eq_8_by_hand():
    """1/(A n) Σ w |r| of two tests of three points, and the squared form of the text."""
    u = np.array([[0.0, 0.3, 0.5], [0.0, 0.0, -2.0]])
    r = np.array([[[0.1, -0.2, 0.3], [1.0, -1.0, 2.0]]])
    expected = (1.2 * 0.1 + 1.0 * 0.2 + 0.2 * 0.3) / (0.5 * 3) + (1.2 + 1.2 + 0.2 * 2.0) / (2.0 * 3)
    assert goal_function(r, u, np.array([0.5, 2.0]))[0] == pytest.approx(expected)
    squared = (1.2 * 0.01 + 1.0 * 0.04 + 0.2 * 0.09) / (0.5 * 3) + (1.2 + 1.2 + 0.2 * 4.0) / (2.0 * 3)
    assert goal_function(r, u, np.array([0.5, 2.0]), squared=True)[0] == pytest.approx(squared)


@pytest.mark.parametrize("kind", ["laplace", "gaussian"])
def test_minimising_the_goal_is_maximum_likelihood(known, kind):
    """With the scale at its own best, ln L = constant − N ln goal (Laplace), or half of that (Gaussian, squared)."""
    problem = make_problem(known.loops(tests=ONE_TEST), {"likelihood": {"kind": kind}})
    like, n = problem.likelihood, 2 * 50 + 1
    r = 0.1 * np.random.default_rng(0).standard_normal((5, 1, 128)) * np.geomspace(0.1, 10.0, 5)[:, None, None]
    scale = np.geomspace(1e-3, 3.0, 4001)
    best = [np.max(like.log_likelihood(np.repeat(x[None], len(scale), 0), {"noise_N": scale})) for x in r]
    goal = goal_function(r, problem.motion.displacement_mm[0], problem.motion.amplitude_mm, kind == "gaussian")
    power = n if kind == "laplace" else 0.5 * n
    np.testing.assert_allclose(np.diff(best), np.diff(-power * np.log(goal)), rtol=1e-3)


@pytest.mark.parametrize("kind", ["gaussian", "laplace", "correlated"])
def test_parts_sum_up(problem, known, kind):
    """Pointwise terms sum to ln L; half the squared rows differ as −ln L does while the noise stays."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = np.repeat(known.true_z(p, noise_scale=1.2, discrepancy_share=0.01), 4, axis=0)
    physical = [i for i, n in enumerate(p.names) if n not in {q.name for q in p.likelihood.parameters}]
    z[:, physical] += 0.02 * np.random.default_rng(1).standard_normal((4, len(physical)))
    total = p.log_likelihood(z)
    np.testing.assert_allclose(p.pointwise(z).sum(axis=1), total, rtol=1e-9)
    if kind != "laplace":
        rows = p.likelihood.rows(p.residual(z), p.numbers(z))
        np.testing.assert_allclose(np.diff(-0.5 * (rows**2).sum(axis=1)), np.diff(total), rtol=1e-6)


def test_pointwise_densities_are_those_of_scipy(problem, known):
    """Laplace of scale b/w and Gaussian of variance σ²/w, w scaled to mean one, each point weighing (2H + 1)/n."""
    r = problem.residual(known.true_z(problem))
    w = paper_weights(problem.motion.displacement_mm[0], problem.motion.amplitude_mm)
    w /= w.mean(axis=1, keepdims=True)
    b = {"noise_N": np.array([0.03])}
    densities = {"laplace": stats.laplace(scale=0.03 / w), "gaussian": stats.norm(scale=0.03 / np.sqrt(w))}
    for kind, density in densities.items():
        like = make_likelihood(kind, problem.loops, problem.scales)
        expected = 101 / 128 * density.logpdf(r[0])
        np.testing.assert_allclose(like.pointwise(r, b).reshape(r.shape[1:]), expected, rtol=1e-9)


def test_correlated_is_a_multivariate_normal(problem):
    """Against scipy's, with the covariance of all tests' harmonics written out, harmonic by harmonic."""
    like = problem.likelihood
    assert isinstance(like, Correlated)
    r = 0.05 * np.random.default_rng(2).standard_normal((1, len(problem.loops), 128))
    share, length = np.array([0.02]), np.array([0.1])
    numbers = {"noise_scale": np.array([1.3]), "discrepancy_share": share, "discrepancy_length": length}
    spectrum = discrepancy_spectrum(share, length, 51)[0]
    near = like.level[:, None] * like.level * between_tests(problem.loops, like.BETWEEN)
    noise = np.exp(like.rotation[3])  # (H, tests): of the records, floors included
    c = harmonics_of(r[0], 51)
    total = 0.0
    for h in range(51):
        cov = 1.3**2 * np.diag(noise[h] ** 2) + spectrum[h] * near
        total += stats.multivariate_normal.logpdf(c[:, h].real, cov=cov)
        total += stats.multivariate_normal.logpdf(c[:, h].imag, cov=cov) if h else 0.0
    assert like.log_likelihood(r, numbers)[0] == pytest.approx(total, rel=1e-9)


def test_correlated_noise_is_that_of_the_records(problem):
    """White noise of 0.02 N over n samples averaged: each part of a harmonic errs by 0.02 √(2/n) N."""
    expected = 0.02 * np.sqrt(2.0 / (128 * problem.loops[0].n_cycles))
    got = np.exp(problem.likelihood.rotation[3])[1:]
    assert np.median(got) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("kind", ["gaussian", "laplace", "correlated"])
def test_replicates_follow_the_likelihood(problem, known, kind):
    """The mean of −ln p over replicates is the entropy that the noise model has by formula."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = np.repeat(known.true_z(p, noise_scale=1.2, discrepancy_share=0.02), 400, axis=0)
    n, force = p.numbers(z), p.predict(z)
    r = p.likelihood.replicate(force, n, np.random.default_rng(3)) - force
    got = -p.likelihood.log_likelihood(r, n)
    if kind == "correlated":
        variance = p.likelihood._whitened(r[:1], {k: v[:1] for k, v in n.items()})[1][:, 0]
        degrees = np.where(np.arange(51) == 0, 1.0, 2.0)[:, None]
        log_noise = p.likelihood.rotation[3]
        entropy = np.sum(0.5 * degrees * (np.log(2 * np.pi * variance) + 1.0 + 2.0 * log_noise))
    else:
        w = paper_weights(p.motion.displacement_mm[0], p.motion.amplitude_mm)
        w /= w.mean(axis=1, keepdims=True)
        entropy = np.sum(
            101
            / 128
            * (np.log(2 * 0.02 / w) + 1 if kind == "laplace" else 0.5 * np.log(2 * np.pi * np.e * 0.02**2 / w))
        )
    assert np.mean(got) == pytest.approx(entropy, abs=4 * np.std(got) / np.sqrt(len(got)))


@pytest.mark.parametrize("kind", ["gaussian", "laplace", "correlated"])
def test_a_finer_phase_grid_is_no_more_information(known, kind):
    """Laplace widths of all numbers at 128 and 256 phases of one and the same record agree within 3 %."""
    widths = []
    for n_phase in (128, 256):
        p = make_problem(known.loops(n_phase=n_phase), {"likelihood": {"kind": kind}})
        z = known.true_z(p, discrepancy_share=0.01)[0]
        widths.append(np.sqrt(np.sum(laplace_scale(p, z) ** 2, axis=1)))
    np.testing.assert_allclose(widths[1], widths[0], rtol=0.03)


@pytest.mark.parametrize("kind", ["gaussian", "laplace"])
def test_weights_of_another_size_are_no_more_information(problem, known, kind, monkeypatch):
    """Eq. (9) times any constant gives the same likelihood."""
    p = make_problem(problem.loops, {"likelihood": {"kind": kind}})
    z = known.true_z(p)
    before = p.log_likelihood(z)
    monkeypatch.setattr(likelihood, "paper_weights", lambda u, a: 10.0 * paper_weights(u, a))
    after = make_problem(problem.loops, {"likelihood": {"kind": kind}}).log_likelihood(z)
    np.testing.assert_allclose(after, before, rtol=1e-12)


def test_harmonics_that_sampling_cannot_resolve_do_not_count(problem):
    """A loop whose noise is infinite above harmonic 10 says nothing there: its residuals may be anything."""
    loops = tuple(
        replace(x, noise_N=np.where(np.arange(51) > 10, np.inf, x.noise_N)) if k == 1 else x
        for k, x in enumerate(problem.loops)
    )
    p = make_problem(loops)
    numbers = {
        k: np.array([v]) for k, v in (("noise_scale", 1.0), ("discrepancy_share", 0.01), ("discrepancy_length", 0.06))
    }
    r = 0.01 * np.random.default_rng(4).standard_normal((1, 4, 128))
    odd = r.copy()
    odd[0, 1] += np.cos(2 * np.pi * 20 * np.arange(128) / 128)
    assert p.likelihood.log_likelihood(odd, numbers) == pytest.approx(p.likelihood.log_likelihood(r, numbers))
    assert p.likelihood.pointwise(r, numbers).shape == (1, 4 * 51 - 40)
    odd[0, 0] += np.cos(2 * np.pi * 20 * np.arange(128) / 128)
    assert p.likelihood.log_likelihood(odd, numbers) < p.likelihood.log_likelihood(r, numbers) - 1000


def test_replicates_have_no_noise_where_there_are_no_data(problem, known):
    """Harmonics that a loop's sampling cannot resolve stay the model's own; all others err as the records say."""
    loops = tuple(
        replace(x, noise_N=np.where(np.arange(51) > 10, np.inf, x.noise_N)) if k == 1 else x
        for k, x in enumerate(problem.loops)
    )
    p = make_problem(loops)
    z = np.repeat(known.true_z(p, noise_scale=1.0, discrepancy_share=1e-5), 400, axis=0)
    force = p.predict(z)
    c = harmonics_of(p.likelihood.replicate(force, p.numbers(z), np.random.default_rng(7)) - force, 51)
    assert np.max(np.abs(c[:, 1, 11:])) < 1e-12
    for t, top in ((0, 51), (1, 11)):
        noise = np.exp(p.likelihood.rotation[3])[1:top, t]
        np.testing.assert_allclose(c[:, t, 1:top].real.std(axis=0), noise, rtol=0.2)


def test_unknown_likelihood_is_named(problem):
    with pytest.raises(ValueError, match=r"likelihood.kind = 'student'.*correlated, gaussian, laplace"):
        make_problem(problem.loops, {"likelihood": {"kind": "student"}})
