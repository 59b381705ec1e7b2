"""The misfit on tests that were not fitted: what is missed on the others is carried over where it hangs together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.setup.discrepancy import ELSEWHERE, FIRST_ALONE, MEASURED_BETWEEN
from bayes_iwan.inference.setup.likelihood import make_likelihood
from bayes_iwan.inference.setup.loop_error import paper_weights
from bayes_iwan.inference.setup.problem import make_problem

DRAWS = 4000


@pytest.fixture(scope="module")
def drawn(problem, known):
    """By likelihood: what is drawn of the last test, harmonics (draws, 51), where the first three miss 0.05 N along
    the velocity; and the numbers behind it."""

    def of(kind, last=None, missed=0.05):
        loops = [*problem.loops[:3], problem.loops[3] if last is None else last]
        p = make_problem(loops[:3], {"likelihood": {"kind": kind}})
        z = known.true_z(p, discrepancy_odd=0.03, discrepancy_even=0.01, discrepancy_share=0.03)
        values = {k: np.repeat(v, DRAWS) for k, v in p.parameter_values(z).items()}
        phase = 2.0 * np.pi * np.arange(128) / 128
        residual = np.broadcast_to(missed * np.sin(phase), (DRAWS, 3, 128))
        got = p.likelihood.carried_over(residual, values, loops[3:], np.random.default_rng(4))
        return p.likelihood, values, loops, np.fft.rfft(got[:, 0]) / 64

    return of


def test_the_first_harmonic_is_that_of_the_joint_distribution_given_what_the_others_miss(drawn):
    """The formulas of a conditioned normal distribution, written out for the unweighted form."""
    likelihood, values, loops, got = drawn("unweighted")
    whole = make_likelihood("unweighted", loops, None)
    f, a = (np.log([getattr(x, n) for x in loops]) for n in ("frequency_hz", "amplitude_mm"))
    length_f, length_a, alone = MEASURED_BETWEEN
    alone *= FIRST_ALONE
    together = np.exp(
        -0.5 * np.subtract.outer(f, f) ** 2 / length_f**2 - 0.5 * np.subtract.outer(a, a) ** 2 / length_a**2
    )
    power = likelihood.spectrum.variance({k: v[:1] for k, v in values.items()}, likelihood.used)[0, 1]
    level = whole.level
    covariance = power * np.outer(level, level) * ((1.0 - alone) * together + alone * np.eye(4))
    noise = np.append(np.exp(likelihood.rotation[3][1]), whole.noise_N[3, 1])
    covariance += np.diag(noise**2)
    weight = np.linalg.solve(covariance[:3, :3], covariance[:3, 3])
    left = covariance[3, 3] - weight @ covariance[:3, 3]
    sine = -0.05  # imaginary part of the first harmonic of 0.05·sin
    assert got[:, 1].imag.mean() == pytest.approx(sine * weight.sum(), abs=5.0 * np.sqrt(left / DRAWS))
    assert got[:, 1].real.mean() == pytest.approx(0.0, abs=5.0 * np.sqrt(left / DRAWS))
    assert np.var(got[:, 1].imag) == pytest.approx(left, rel=0.12)
    assert np.var(got[:, 1].real) == pytest.approx(left, rel=0.12)


@pytest.mark.parametrize("kind", ["correlated", "unweighted", "matern"])
def test_what_is_missed_near_by_moves_and_narrows_and_far_away_does_nothing(problem, drawn, kind):
    near = drawn(kind)[3][:, 1]
    far = drawn(kind, replace(problem.loops[3], frequency_hz=1e6))[3][:, 1]
    assert near.imag.mean() < -0.02 < -0.003 < far.imag.mean() < 0.003
    assert near.std() < 0.9 * far.std()


def test_higher_harmonics_are_drawn_anew_and_larger_than_those_of_fitted_tests(drawn):
    _, values, loops, got = drawn("unweighted")
    there = make_likelihood("unweighted", loops[3:], None)
    again = there.replicate(np.zeros((DRAWS, 1, 128)), values, np.random.default_rng(5))
    replicated = np.fft.rfft(again[:, 0]) / 64
    assert np.var(got[:, 3]) / np.var(replicated[:, 3]) == pytest.approx(ELSEWHERE, rel=0.1)


@pytest.mark.parametrize("kind", ["gaussian", "laplace"])
def test_independent_errors_carry_nothing_over(problem, known, kind):
    p = make_problem(problem.loops[:3], {"likelihood": {"kind": kind}})
    values = {k: np.repeat(v, DRAWS) for k, v in p.parameter_values(known.true_z(p)).items()}
    residual = np.full((DRAWS, 3, 128), 0.5)
    got = p.likelihood.carried_over(residual, values, problem.loops[3:], np.random.default_rng(6))
    amplitude = problem.motion.amplitude_mm
    w = paper_weights(problem.motion.displacement_mm[0], amplitude) / amplitude[:, None]
    v = w[3:] / stats.gmean(w[:3], axis=None)  # noise_N is of the first three
    size = values["noise_N"][0] * (np.sqrt(0.5 * np.pi) / v if kind == "laplace" else 1.0 / np.sqrt(v))
    np.testing.assert_allclose(got.std(axis=0), size, rtol=0.1)
    np.testing.assert_allclose(got.mean(axis=0) / size, 0.0, atol=0.1)
