"""Cycles are cut from the displacement itself: frequency, run-in, gaps, shapes."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, average


def triangle(cycles):
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * cycles))


@pytest.mark.parametrize("rate", [1280.0, 1000.0 / 3, 83.7])
@pytest.mark.parametrize("frequency", [10.0, 9.87, 10.23])
def test_true_frequency_from_a_noisy_sine(record, rate, frequency):
    r = record(frequency_hz=frequency, rate_hz=rate, n_cycles=40.3, noise_mm=0.005, noise_N=0.02, offset_mm=-3.0)
    loop = average(replace(r, frequency_hz=10.0))
    # Cramer-Rao: sd(f) = sqrt(6 / n) sigma / (pi A T), here below 2e-4 Hz at the slowest rate
    sd = np.sqrt(6 / r.time_s.size) * 0.005 / (np.pi * r.time_s[-1])
    assert abs(loop.frequency_hz - frequency) < 5 * sd
    assert loop.offset_mm == pytest.approx(-3.0, abs=0.003)
    assert loop.amplitude_mm == pytest.approx(1.0, abs=0.004)
    assert loop.cut.constant


@pytest.mark.parametrize(
    "shape",
    [
        lambda c: np.sin(2 * np.pi * c),
        lambda c: np.sin(2 * np.pi * c) + 0.15 * np.sin(6 * np.pi * c + 1) + 0.08 * np.cos(4 * np.pi * c),
        triangle,
        lambda c: np.clip(1.6 * triangle(c), -1, 1),  # a triangle with holds at both ends
    ],
)
def test_shapes_of_motion(record, shape):
    r = record(n_cycles=20.3, noise_N=0.01)
    rng = np.random.default_rng(1)
    exact = shape(10 * r.time_s + 0.37)
    r = replace(r, displacement_mm=7 + exact + 1e-3 * rng.normal(size=exact.size))
    loop = average(r)
    assert loop.frequency_hz == pytest.approx(10, rel=1e-4)
    assert loop.n_cycles == 19
    fine = shape(np.arange(4096) / 4096)
    assert loop.amplitude_mm == pytest.approx(np.ptp(fine) / 2, rel=1e-3)
    assert loop.offset_mm == pytest.approx(7, abs=1e-3)  # the mean of each of these shapes is 0
    assert loop.displacement_mm[0] == pytest.approx(0, abs=0.002) and loop.velocity_m_s[0] > 0
    assert np.mean(loop.displacement_mm) == pytest.approx(0, abs=1e-5)
    # the averaged displacement is the shape, moved to begin at its own upward crossing
    origin = np.argmin(np.abs(fine) + 9 * (np.gradient(fine) <= 0)) / 4096
    np.testing.assert_allclose(loop.displacement_mm, shape(loop.phase + origin), atol=0.002)


def test_derivatives_of_a_distorted_sine(record):
    omega = 2 * np.pi * 10
    r = record(n_cycles=30.2)
    rng = np.random.default_rng(2)
    x = omega * r.time_s
    u = np.sin(x) + 0.05 * np.sin(3 * x) + 0.01 * np.sin(5 * x)  # odd in time: its middle is at phase 0
    loop = average(replace(r, displacement_mm=u + 1e-3 * rng.normal(size=u.size)))
    p = 2 * np.pi * loop.phase
    v = omega * (np.cos(p) + 0.15 * np.cos(3 * p) + 0.05 * np.cos(5 * p)) * 1e-3
    a = -(omega**2) * (np.sin(p) + 0.45 * np.sin(3 * p) + 0.25 * np.sin(5 * p)) * 1e-3
    assert np.std(loop.velocity_m_s - v) < 1e-3 * np.std(v)
    assert np.std(loop.acceleration_m_s2 - a) < 3e-3 * np.std(a)  # differences of samples would be off by 500 %


def test_velocity_of_a_triangle_does_not_ring(record):
    r = record(n_cycles=30.2)
    loop = average(replace(r, displacement_mm=triangle(10 * r.time_s)))
    away = np.abs((loop.phase % 0.5) - 0.25) > 0.06  # from the corners
    v = loop.velocity_m_s[away]
    np.testing.assert_allclose(np.abs(v), 4 * 10 * 1e-3, rtol=0.01)


def test_a_partial_first_cycle_is_dropped(record):
    for start in (0.001, 0.37, 0.999):
        loop = average(record(start=start, n_cycles=10.0))
        assert loop.n_cycles in (8, 9, 10)  # 10: cut at a crossing
        first = loop.record.time_s[loop.cut.index[0]]
        assert (10 * first + start) % 1 == pytest.approx(0, abs=1 / 128 + 1e-6)


def test_displacement_run_in_and_run_out_are_dropped(record):
    r = record(n_cycles=20.0, start=0.0, noise_mm=1e-3)
    cycles = 10 * r.time_s
    ramp = np.clip(cycles / 3, 0, 1) * np.clip((20 - cycles) / 2, 0, 1)
    loop = average(replace(r, displacement_mm=r.displacement_mm * ramp))
    kept = cycles[loop.cut.index]
    assert 2.9 < kept[0] < 4.1 and 16.9 < kept[-1] < 18.1
    assert loop.amplitude_mm == pytest.approx(1, rel=0.002)


def test_rest_before_and_after(record):
    r = record(n_cycles=30.0, start=0.0, noise_mm=1e-4)
    moving = (r.time_s > 0.8) & (r.time_s < 2.5)
    loop = average(replace(r, displacement_mm=np.where(moving, r.displacement_mm, 0)))
    kept = r.time_s[loop.cut.index]
    assert kept[0] > 0.79 and kept[-1] < 2.51 and loop.n_cycles >= 15
    assert loop.frequency_hz == pytest.approx(10, rel=1e-4)


@pytest.mark.parametrize("n_cycles", [6.3, 12.3, 40.3])
def test_a_virgin_first_loop_is_run_in(record, n_cycles):
    r = record(n_cycles=n_cycles, noise_N=0.01)
    early = np.exp(-np.maximum(r.time_s * 10 - 0.63, 0) / 0.15)  # gone by the second whole cycle
    loop = average(replace(r, force_N=r.force_N * (1 + 0.5 * early)))
    assert loop.cut.run_in == 1


@pytest.mark.parametrize("time_constant", [10, 20, 100])
def test_fade_is_not_run_in(record, time_constant):
    r = record(n_cycles=40.3, noise_N=0.01)
    fade = 1 - 0.08 * (1 - np.exp(-r.time_s * 10 / time_constant))
    loop = average(replace(r, force_N=r.force_N * fade))
    assert loop.cut.run_in == 0
    # and it shows in the blocks, far above their noise
    size = np.abs(loop.block_harmonics_N[:, 1])
    cycles = [np.arange(b - 3, b + 3.5) + 0.63 for b in loop.block_cycle]
    expected = [4 * np.mean(1 - 0.08 * (1 - np.exp(-c / time_constant))) for c in cycles]
    np.testing.assert_allclose(size, expected, atol=0.02)
    assert size[0] - size[-1] > 10 * loop.block_noise_N[0, 1]


def test_a_speed_that_wanders_is_followed(record, force_harmonics):
    r = record(n_cycles=30.3)
    phase = 10 * r.time_s + 0.3 * np.sin(2 * np.pi * r.time_s / 1.3)
    u = triangle(phase)
    force = sum((c * np.exp(2j * np.pi * h * phase)).real for h, c in enumerate(force_harmonics))
    loop = average(replace(r, displacement_mm=u, force_N=force))
    assert not loop.cut.constant
    np.testing.assert_allclose(loop.harmonics_N[:6], force_harmonics, atol=0.02)


def test_noise_in_the_displacement_does_not_free_the_phase(record):
    # slow wander of the measured displacement alone: the force keeps time, so the phase must too
    r = record(n_cycles=30.3, noise_N=0.005)
    rng = np.random.default_rng(5)
    wander = np.interp(r.time_s, np.linspace(0, r.time_s[-1], 45), 0.02 * rng.normal(size=45))
    assert average(replace(r, displacement_mm=r.displacement_mm + wander)).cut.constant


@pytest.mark.parametrize("noise", [0.1, 0.2])
def test_heavy_noise_does_not_split_cycles(record, noise):
    loop = average(record(n_cycles=40.3, noise_mm=noise))
    assert loop.n_cycles == 39 and loop.frequency_hz == pytest.approx(10, abs=0.003)
    assert loop.amplitude_mm == pytest.approx(1, abs=0.03)


def test_a_creeping_middle_does_not_bend_the_phase(record, force_harmonics):
    r = record(n_cycles=40.3, start=0.0)
    creep = 0.3 * r.time_s / r.time_s[-1]
    loop = average(replace(r, displacement_mm=r.displacement_mm + creep, force_N=r.force_N + 2 * creep))
    assert loop.cut.constant and loop.frequency_hz == pytest.approx(10, rel=1e-5)
    # a drift leaks into every harmonic as 0.6 N / (2 pi h 40), no more
    np.testing.assert_allclose(loop.harmonics_N[1:6], force_harmonics[1:], atol=0.02)


def test_irregular_steps_and_short_gaps_need_no_interpolation(record, force_harmonics):
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.4e-3, 1.2e-3, 5000))
    time = time[np.sort(rng.permutation(5000)[:4000])]  # and every fifth sample lost
    r = record(time_s=time, start=0.0)
    loop = average(r, n_harmonics=20)
    np.testing.assert_allclose(loop.harmonics_N[:6], force_harmonics, atol=1e-6)
    np.testing.assert_allclose(loop.harmonics_N[6:], 0, atol=1e-6)


def test_a_long_gap_costs_the_cycles_it_falls_in(record, force_harmonics):
    r = record(n_cycles=20.3, start=0.0)
    keep = (r.time_s < 0.72) | (r.time_s > 0.97)  # from cycle 7 into cycle 9
    r = record(time_s=r.time_s[keep], start=0.0)
    loop = average(r)
    assert loop.cut.gap_cycles == 3 and loop.n_cycles == 19 - 3
    whole = 10 * r.time_s[loop.cut.index]
    assert not ((whole > 7.001) & (whole < 9.999)).any()
    np.testing.assert_allclose(loop.harmonics_N[:6], force_harmonics, atol=1e-6)
    assert loop.frequency_hz == pytest.approx(10, rel=1e-6)
    # blocks know which cycle they stand for: 1 is the first whole one here
    assert loop.block_cycle[0] < 3 and loop.block_cycle[-1] == pytest.approx(17.0, abs=1.1)


def test_a_gap_inside_one_cycle(record, force_harmonics):
    r = record(n_cycles=20.3, start=0.0)
    for length, lost in ((0.05, 0), (0.3, 1)):
        keep = (r.time_s < 0.71) | (r.time_s > 0.71 + 0.1 * length)
        loop = average(record(time_s=r.time_s[keep], start=0.0))
        assert loop.cut.gap_cycles == lost and loop.n_cycles == 19 - lost
        np.testing.assert_allclose(loop.harmonics_N[:6], force_harmonics, atol=1e-6)


@pytest.mark.parametrize("n_cycles", [0.4, 1.4, 1.9])
def test_too_few_cycles(record, n_cycles):
    with pytest.raises(CampaignError, match=r"test\.csv: .*at least two are needed"):
        average(record(n_cycles=n_cycles, start=0.5))


@pytest.mark.parametrize("n_cycles, start", [(2.0, 0.25), (2.0, 0.6), (2.2, 0.5), (2.4, 0.1)])
def test_two_cycles_are_counted_wherever_the_record_begins(record, force_harmonics, n_cycles, start):
    loop = average(record(n_cycles=n_cycles, start=start))
    assert loop.n_cycles == 2
    np.testing.assert_allclose(loop.harmonics_N[:6], force_harmonics, atol=2e-3)


def test_two_cycles_are_enough(record, force_harmonics):
    loop = average(record(n_cycles=2.8, start=0.5, noise_N=0.02))
    assert loop.n_cycles == 2
    assert np.abs(loop.harmonics_N[1]) == pytest.approx(4, abs=0.01)
    assert (loop.noise_N > 0).all() and np.isfinite(loop.noise_N[:14]).all()
