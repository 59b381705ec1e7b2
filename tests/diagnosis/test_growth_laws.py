"""The exponents of a law: best value and interval read from the gain over a grid of exponents."""

import numpy as np
import pytest

from bayes_iwan.diagnosis.answer.gap_findings import _growth
from bayes_iwan.diagnosis.answer.growth_laws import FALL, LEAST_REACH, LOOSE, _profile

GRID = np.arange(-2.0, 3.01, 0.25)


@pytest.mark.parametrize("at", [-0.9, 0.5, 1.07])
@pytest.mark.parametrize("spare", [1.0, 4.0])
def test_of_a_parabola_vertex_and_interval_are_exact(at, spare):
    """gain = top − c (x − at)²: it has fallen by so much at a distance of √(fall / c)."""
    top, c = 400.0, 20.0
    best, low, high = _profile(GRID, top - c * (GRID - at) ** 2, spare)
    reach = np.sqrt((FALL * spare + LOOSE * top) / c)
    assert best == pytest.approx(at)
    assert (low, high) == pytest.approx((at - reach, at + reach), abs=0.03)


def test_an_exponent_is_never_claimed_more_exactly_than_it_can_be():
    best, low, high = _profile(GRID, 1e6 - 1e6 * np.abs(GRID - 1.0), 1.0)
    assert (best, low, high) == pytest.approx((1.0, 1.0 - LEAST_REACH, 1.0 + LEAST_REACH))


def test_at_the_end_of_the_grid_the_interval_is_open_and_one_exponent_is_none():
    """How much further than the grid it goes is not known, so no exponent is said."""
    best, low, high = _profile(GRID, 100.0 + 5.0 * GRID, 1.0)
    assert best == GRID[-1] and high == np.inf
    assert low == pytest.approx(GRID[-1] - (FALL + LOOSE * 115.0) / 5.0, abs=0.02)
    assert _profile(GRID, 100.0 - 5.0 * GRID, 1.0)[:2] == (GRID[0], -np.inf)
    assert _growth("amplitude", (best, low, high)) == "" != _growth("amplitude", (best, low, best))
    assert _profile(GRID[:1], np.ones(1), 1.0) is None


def test_where_no_exponent_is_better_the_interval_has_no_end():
    assert _profile(GRID, 400.0 - 1e-3 * (GRID - 0.5) ** 2, 1.0) == (0.5, -np.inf, np.inf)
