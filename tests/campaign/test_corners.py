"""Triangles and trapezoids are kept whole: amplitude, motion and velocity, not rounded at their corners."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sawtooth, sosfiltfilt

from bayes_iwan.campaign import Record, average
from bayes_iwan.campaign.loops.checks import check_record


def triangle(cycles):
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * cycles))


def trapezoid(cycles):
    return np.clip(1.6 * triangle(cycles), -1, 1)


def skewed(cycles):
    """Up in three tenths of the cycle, down in seven; crosses its mean upward at 0."""
    x = (cycles + 0.15) % 1
    return np.where(x < 0.3, x / 0.3, (1 - x) / 0.7) * 2 - 1


@pytest.mark.parametrize("cut, sharp", [(None, True), (0.5, False)])
def test_corners_that_no_filter_rounds_leave_no_gap_to_the_channels(record, cut, sharp):
    """A filter of the channels, at half the Nyquist frequency, rounds the corners, and then it may round the force."""
    r = record(n_cycles=20.3, rate_hz=1280.0, noise_N=0.01)
    u = triangle(10 * r.time_s + 0.37) + 1e-4 * np.random.default_rng(1).normal(size=r.time_s.size)
    u = u if cut is None else sosfiltfilt(butter(2, cut, output="sos"), u)
    loop = average(replace(r, displacement_mm=u))
    assert loop.corners and loop.sharp == sharp
    assert (loop.corners_gap == 0.0) == sharp


@pytest.mark.parametrize("shape", [triangle, trapezoid, skewed])
@pytest.mark.parametrize("rate", [1280.0, 837.0, 3333.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_corners_are_kept(record, shape, rate, noise):
    r = record(n_cycles=20.3, rate_hz=rate, noise_N=0.01)
    rng = np.random.default_rng(1)
    u = 7 + shape(10 * r.time_s + 0.37) + noise * rng.normal(size=r.time_s.size)
    loop = average(replace(r, displacement_mm=u))
    assert loop.amplitude_mm == pytest.approx(1, abs=3e-4 + 0.3 * noise)
    np.testing.assert_allclose(loop.displacement_mm, shape(loop.phase), atol=5e-4 + noise)
    # each piece has its own speed, up to the corners; the ones next to a grid point may lie on either side of it
    h = 1e-6
    ahead, behind = ((shape(loop.phase + s * 2e-3 + h) - shape(loop.phase + s * 2e-3)) / h * 0.01 for s in (1, -1))
    away = np.abs(ahead - behind) < 1e-6
    assert away.mean() > 0.9
    assert np.abs(loop.velocity_m_s - ahead)[away].max() < (0.002 + 20 * noise) * np.abs(ahead).max()


def test_rounded_corners_are_left_to_harmonics(record):
    r = record(n_cycles=20.3, noise_N=0.01)
    orders = np.arange(1, 60, 2)
    size = 8 / np.pi**2 / orders**2 * (-1.0) ** ((orders - 1) // 2) * np.exp(-((orders / 12) ** 2))
    u = sum(a * np.sin(2 * np.pi * k * (10 * r.time_s + 0.37)) for a, k in zip(size, orders))
    loop = average(replace(r, displacement_mm=u))
    fine = sum(a * np.sin(2 * np.pi * k * np.arange(4096) / 4096) for a, k in zip(size, orders))
    assert loop.amplitude_mm == pytest.approx(np.ptp(fine) / 2, rel=1e-3)
    exact = sum(a * np.sin(2 * np.pi * k * loop.phase) for a, k in zip(size, orders))
    np.testing.assert_allclose(loop.displacement_mm, exact, atol=2e-3)


@pytest.mark.parametrize("seed", range(8))
def test_a_nearly_elastic_loop_of_a_triangle_is_not_late_but_a_late_one_is(seed):
    """The grid's velocity at a corner made 1.5° of delay of none in 7 of 150 such loops."""
    rng = np.random.default_rng(seed)
    per, width = int(rng.integers(60, 200)), float(rng.uniform(0.3, 0.7))
    p = 2 * np.pi * (np.arange(int(per * 9.3)) + rng.uniform()) / per
    for late, wanted in ((0.0, False), (0.05, True)):
        u, force = (sawtooth(p - x, width) for x in (0.0, late))
        noise = 1e-4 * rng.standard_normal((2, p.size))
        record = Record(
            "a.csv", 500 / per, 1.0, "fit", {}, np.arange(p.size) / 500, u + noise[0], 30 * force + noise[1]
        )
        said = " ".join(check_record(record)[0].warnings)
        assert ("is late" in said) == wanted


def test_a_specimen_that_hardens_under_a_triangle_does_not_jump(record):
    """Three cycles from rest of a bilinear specimen that is harder after its first: the loop has the first cycle's
    later part, samples of whole cycles only. Their energies differ, and the record was refused."""
    phase = np.arange(480) / 160
    u, force, slide = triangle(phase), np.zeros(480), 0.0
    for i in range(1, 480):
        slide = float(np.clip(slide + u[i] - u[i - 1], -0.5, 0.5))
        force[i] = 30 * slide * (0.85 if phase[i] < 1 else 1.0)
    r = replace(record(n_cycles=3), time_s=phase, displacement_mm=u, force_N=force, frequency_hz=1.0, clock=False)
    loop = average(check_record(r)[0])
    assert loop.corners and loop.cut.late > 0
