"""How a discrepancy's variance is spread over harmonics and between tests, against the formulas written out."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.inference.setup.spectrum import MATERN, ODD_EVEN, between_tests, shared_between

COUNT = 12


def test_matern_is_a_share_of_the_level_and_falls_as_it_says():
    share, length = np.array([0.02, 0.3]), np.array([0.05, 0.2])
    found = MATERN.variance({"discrepancy_share": share, "discrepancy_length": length}, COUNT)
    assert found.sum(axis=1) == pytest.approx(share**2)
    for row, cycles in zip(found, length):
        fall = [(1.0 + (2.0 * np.pi * h * cycles) ** 2) ** -2.0 for h in range(COUNT)]
        assert row / row[0] == pytest.approx(fall)


def test_odd_and_even_harmonics_have_shares_of_their_own_and_one_slope():
    values = {"discrepancy_odd": 0.03, "discrepancy_even": 0.004, "discrepancy_slope": 1.7}
    (found,) = ODD_EVEN.variance({k: np.array([v]) for k, v in values.items()}, COUNT)
    assert found[1::2].sum() == pytest.approx(0.03**2) and found[::2].sum() == pytest.approx(0.004**2)
    assert found[3] / found[1] == pytest.approx(3.0**-1.7) and found[4] / found[2] == pytest.approx(2.0**-1.7)
    assert found[0] == pytest.approx(found[2] * 2.0**1.7), "the mean counts as the first of the even ones"
    assert np.all(np.diff(found[1::2]) < 0.0)


def test_tests_are_correlated_by_their_distance_in_logarithms():
    """exp(−½ ln²(f₁/f₂)/ℓ_f² − ½ ln²(A₁/A₂)/ℓ_A²), all but the share that each has alone."""
    one, faster, larger = (
        SimpleNamespace(frequency_hz=f, amplitude_mm=a) for f, a in ((10.0, 0.5), (20.0, 0.5), (10.0, 1.0))
    )
    found = between_tests((one, faster, larger), (1.5, 0.8, 0.1))
    assert np.diag(found) == pytest.approx([1.0, 1.0, 1.0])
    assert found[0, 1] == pytest.approx(0.9 * np.exp(-0.5 * (np.log(2.0) / 1.5) ** 2))
    assert found[0, 2] == pytest.approx(0.9 * np.exp(-0.5 * (np.log(2.0) / 0.8) ** 2))
    assert found[1, 2] == pytest.approx(found[0, 1] * found[0, 2] / 0.9)
    assert shared_between((one,), (faster, one), (1.5, 0.8, 0.1)) == pytest.approx(np.array([[found[0, 1], 0.9]]))
