"""Predictions at conditions that no test had are marked, or refused where they mean nothing."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.errors import InputError
from bayes_iwan.inference.results.predictions import (
    Extrapolation,
    Prediction,
    predicted_at,
    replicated,
    residual_size,
    shown_noise,
)


@pytest.fixture(scope="module")
def predict(problem, known):
    """Tests of 0.3 to 1 mm and 10 to 20 Hz, to 126 mm/s."""
    z = known.true_z(problem)
    return lambda f, a: predicted_at(problem, z, f, a, 64)


def test_what_was_tested_is_predicted_without_a_word(predict):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = predict(np.array([10.0, 15.0, 20.0]), 0.6)
    assert found.extrapolated == ("", "", "") and found.force_N.shape == (1, 3, 64)
    assert "extrapolated" not in repr(found)


@pytest.mark.parametrize(
    ("f", "a", "said"),
    [
        (10.0, 1.5, "amplitude 1.5 mm, tested 0.3 to 1 mm"),
        (10.0, 0.1, "amplitude 0.1 mm, tested 0.3 to 1 mm"),
        (25.0, 1.0, "peak speed 157 mm/s, tested 18.8 to 126 mm/s"),
        (40.0, 0.4, "frequency 40 Hz, tested 10 to 20 Hz"),
    ],
)
def test_extrapolation_is_said_and_stays_with_the_prediction(predict, f, a, said):
    with pytest.warns(Extrapolation, match=said):
        found = predict(f, np.array([0.5, a]))
    assert said in found.extrapolated[1] and said in " ".join(repr(found).split())


@pytest.mark.parametrize(
    ("f", "a", "silent"),
    [
        (10.0, 0.3 / 1.04, True), (10.0, 0.3 / 1.06, False), (10.0, 1.04, True), (10.0, 1.06, False),
        (20.0 * 1.04, 1.0, True), (20.0 * 1.06, 1.0, False), (10.0 / 1.4, 0.5, True), (10.0 / 1.6, 0.5, False),
        (20.0 * 1.4, 0.5, True), (20.0 * 1.6, 0.5, False),
    ],
)  # fmt: skip
def test_a_twentieth_beyond_amplitudes_and_speeds_and_half_beyond_frequencies_is_tested(predict, f, a, silent):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Extrapolation)
        assert (predict(f, a).extrapolated == ("",)) == silent


def test_motions_that_are_small_and_slow_are_extrapolated_and_not_refused(predict):
    with pytest.warns(Extrapolation, match="frequency 0.02 Hz"):
        found = predict(0.02, 0.02)
    assert np.all(np.isfinite(found.force_N)) and "peak speed" not in found.extrapolated[0]


def test_bands_are_central_quantiles_of_the_draws():
    draws = np.linspace(0.0, 10.0, 1001)[:, None, None] * np.ones((1, 1, 2))
    none = np.zeros((1, 2))
    found = Prediction(np.array([10.0]), np.array([1.0]), none, draws, Units(), ("",))
    for level, ends in ((0.9, (0.5, 5.0, 9.5)), (0.5, (2.5, 5.0, 7.5))):
        assert [x[0, 0] for x in found.band(level)] == pytest.approx(ends)
    assert repr(found).startswith("10 Hz, 1 mm: ±4.5 N (90 %")


@pytest.mark.parametrize(
    ("f", "a", "said"),
    [
        (10.0, 500.0, r"10 Hz and 500 mm \(amplitude 500 mm\) are beyond 5 times what was tested"),
        (10.0, -0.5, "amplitude_mm = -0.5: it must be a positive number"),
        (0.0, 0.5, "frequency_hz = 0: it must be a positive number"),
        (10.0, float("nan"), "amplitude_mm = nan: it must be a positive number"),
        (0.5, 15.0, r"are frequency_hz and amplitude_mm exchanged\?"),
        (500.0, 0.5, r"peak speed 1\.57e\+03 mm/s"),
    ],
)
def test_what_means_nothing_is_refused(predict, f, a, said):
    with pytest.raises(InputError, match=said):
        predict(f, a)


def test_noise_that_is_shown_has_no_mean_and_no_harmonic_that_was_not_resolved():
    """A loop whose noise is known for harmonics 0 to 5 alone: of a mean and harmonics 1, 5 and 7 two are kept."""
    turn = 2.0 * np.pi * np.arange(64) / 64
    kept = 0.4 * np.cos(turn + 1.0) + 0.2 * np.sin(5.0 * turn)
    loops = [SimpleNamespace(noise_N=np.full(6, 0.1)), SimpleNamespace(noise_N=np.array([0.1, 0.1, *4 * [np.nan]]))]
    found = shown_noise(np.tile(kept + 3.0 + 0.3 * np.cos(7.0 * turn), (2, 2, 1)), loops)
    assert found[:, 0] == pytest.approx(np.tile(kept, (2, 1)))
    assert found[:, 1] == pytest.approx(np.tile(0.4 * np.cos(turn + 1.0), (2, 1)))


def test_residual_and_gap_of_a_known_misfit(problem, known):
    """Half the square of each harmonic that is missed, the mean left aside, less what the noise of the mean loop is."""
    z = known.true_z(problem)
    missed = 0.3 * np.sin(3.0 * problem.loops[0].phase * 2.0 * np.pi) + 0.1 * np.cos(
        4.0 * problem.loops[0].phase * 2.0 * np.pi
    )
    off = problem.with_force(problem.predict(z)[0] + missed + 0.5)
    found = residual_size(off, np.repeat(z, 3, axis=0))
    power = 0.5 * (0.3**2 + 0.1**2)
    noise = np.mean([np.nansum(np.where(np.isfinite(x.noise_N), x.noise_N, 0.0)[1:] ** 2) for x in problem.loops])
    friction = problem.friction_force(problem.parameter_values(z))[0]
    level = np.sqrt(np.mean(friction**2))
    assert found.rms_N == pytest.approx(np.sqrt(power)) and noise > 1e-4 * power
    assert found.gap_N == pytest.approx(np.sqrt(power - noise))
    assert found.share == pytest.approx(np.sqrt(power) / level, rel=1e-3)
    assert found.gap_share / found.share == pytest.approx(found.gap_N / found.rms_N)


def test_means_of_new_measurements_wander_as_those_of_the_tests_did(problem, known):
    """Student's t with a degree of freedom less than there are tests, as wide as their means lie from the median."""
    z, tests = known.true_z(problem), len(problem.loops)
    apart = np.array([0.3, -0.2, 0.1, -0.4, 0.2, 0.25, -0.3, 0.1, 0.15])[:tests]
    off = problem.with_force(problem.predict(z)[0] + apart[:, None])
    values = {k: np.repeat(v, 4000) for k, v in off.parameter_values(z).items()}
    force = np.repeat(off.predict(z), 4000, axis=0)
    found = replicated(off, force, values, np.random.default_rng(1)).mean(axis=-1) - force.mean(axis=-1)
    allowed = off.likelihood.mean_error_N
    scale = allowed * np.sqrt((1.0 + 1.0 / tests) * np.sum((apart / allowed) ** 2) / (tests - 1))
    for column, width in zip(found.T, scale):
        assert stats.kstest(column / width, stats.t(tests - 1).cdf).pvalue > 1e-4
