"""Scales of a campaign against loops whose friction, springs and energies are known by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.inference.setup.loop_scales import scales_of

PHASE = 2.0 * np.pi * np.arange(512) / 512


def loop(amplitude_mm, spring_N_mm, friction_N, hz=10.0):
    """A spring beside Coulomb friction."""
    force = spring_N_mm * amplitude_mm * np.sin(PHASE) + friction_N * np.sign(np.cos(PHASE))
    speed = 2e-3 * np.pi * hz * amplitude_mm * np.cos(PHASE)
    displacement = amplitude_mm * np.sin(PHASE)
    return SimpleNamespace(amplitude_mm=amplitude_mm, displacement_mm=displacement, velocity_m_s=speed, force_N=force)


def test_scales_are_the_largest_motion_and_the_friction_and_stiffness_that_loops_show():
    """Energy 4 μ A, so slip μ; the secant of the largest; the smallest one's says how stiff contacts are that stick."""
    loops = [loop(0.5, 6.0, 0.4), loop(2.0, 3.0, 0.4), loop(1.0, 5.0, 0.4, hz=25.0)]
    found = scales_of(loops)
    assert found.length_mm == 2.0 and found.speed_m_s == pytest.approx(2e-3 * np.pi * 25.0 * 1.0)
    assert found.force_N == pytest.approx(np.std(loops[1].force_N))
    assert found.slip_N == pytest.approx(0.4, rel=1e-3)
    assert found.soft_N_mm == pytest.approx(np.ptp(loops[1].force_N) / 4.0)
    assert found.stiff_N_mm == pytest.approx(1.5 * np.ptp(loops[0].force_N) / 1.0)


def test_a_large_friction_over_a_small_stroke_says_how_stiff_contacts_are():
    """After a reversal the force falls by twice the slip force within a fraction of the stroke: at least 4 μ / A."""
    found = scales_of([loop(0.9, 0.1, 3.0), loop(1.0, 0.1, 3.0)])
    assert found.stiff_N_mm == pytest.approx(4.0 * found.slip_N / 1.0) and found.slip_N == pytest.approx(3.0, rel=1e-3)


def test_loops_that_lose_nothing_or_gain_have_a_friction_of_a_thousandth():
    for sign in (0.0, -1.0):
        loops = [loop(1.0, 4.0, sign * 0.5), loop(0.5, 4.0, sign * 0.5)]
        assert scales_of(loops).slip_N == pytest.approx(1e-3 * np.std(loops[0].force_N))
