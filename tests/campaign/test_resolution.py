"""Loops have as many points as their motion's reversals need."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.loops.resolution import MOST_POINTS, POINTS, points_for, reversals

PHASE = 2.0 * np.pi * np.arange(512) / 512


@pytest.mark.parametrize(("third", "expected", "points"), [(0.0, 2, POINTS), (0.05, 2, POINTS), (0.6, 6, MOST_POINTS)])
def test_reversals_are_counted_and_points_chosen_from_them(third, expected, points):
    u = np.sin(PHASE + 0.3) + third * np.sin(3.0 * PHASE + 1.0)
    assert reversals(u) == reversals(-5.0 * u) == expected
    assert points_for([np.sin(PHASE), u], [np.cos(PHASE)] * 2) == points


def test_what_goes_back_by_next_to_nothing_is_no_reversal():
    assert reversals(np.sin(PHASE) + 0.004 * np.sin(40.0 * PHASE)) == 2
    assert reversals(np.sin(PHASE) + 0.02 * np.sin(40.0 * PHASE)) > 10


@pytest.mark.parametrize(("width", "points"), [(0.3, POINTS), (0.1, 256), (0.03, MOST_POINTS)])
def test_a_motion_with_sharp_corners_has_more_points(width, points):
    v = np.tanh(np.cos(PHASE) / width)  # a triangle whose corners are rounded over about this phase
    u = np.cumsum(v - v.mean())
    assert reversals(u) == 2 and points_for([u], [v]) == points


def test_a_campaign_chooses_and_can_be_told(kit):
    def force(frequency, amplitude, samples):
        return np.cos(2.0 * np.pi * np.arange(samples) / samples)

    plain = kit.made_up(force, [(10.0, 0.4)])
    assert plain.loops()[0].displacement_mm.size == POINTS
    assert plain.loops(n_phase=64)[0].displacement_mm.size == 64
    (record,) = plain.tests
    turning = 0.3 * np.sin(3.0 * 2.0 * np.pi * 10.0 * record.time_s + 1.0)
    turned = replace(plain, tests=(replace(record, displacement_mm=record.displacement_mm + turning),))
    assert turned.loops()[0].displacement_mm.size == MOST_POINTS
