"""Predictions at conditions that no test had are marked, or refused where they mean nothing."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.inference.results.predictions import Extrapolation, PredictionError, predicted_at, resolved


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
    assert said in found.extrapolated[1] and said in repr(found)


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
    with pytest.raises(PredictionError, match=said):
        predict(f, a)


def test_noise_that_is_shown_has_no_mean_and_no_harmonic_that_was_not_resolved():
    """A loop whose noise is known for harmonics 0 to 5 alone: of a mean and harmonics 1, 5 and 7 two are kept."""
    turn = 2.0 * np.pi * np.arange(64) / 64
    kept = 0.4 * np.cos(turn + 1.0) + 0.2 * np.sin(5.0 * turn)
    loops = [SimpleNamespace(noise_N=np.full(6, 0.1)), SimpleNamespace(noise_N=np.array([0.1, 0.1, np.nan]))]
    found = resolved(np.tile(kept + 3.0 + 0.3 * np.cos(7.0 * turn), (2, 2, 1)), loops)
    assert found[:, 0] == pytest.approx(np.tile(kept, (2, 1)))
    assert found[:, 1] == pytest.approx(np.tile(0.4 * np.cos(turn + 1.0), (2, 1)))
