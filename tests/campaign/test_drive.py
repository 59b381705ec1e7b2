"""The drive is assessed before anything is averaged: steady drives pass, whatever their rate and noise."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.importing import import_tests
from bayes_iwan.campaign.timing.drive import assess_drive, split_levels


def test_run_in_and_run_out_are_no_staircase(record):
    r = record(n_cycles=30.3)
    ramp = np.clip(r.time_s / 0.35, 0.3, 1) * np.clip((r.time_s[-1] - r.time_s) / 0.25, 0, 1)
    assert assess_drive(r.time_s, ramp * r.displacement_mm).kind == "steady"
    assert len(split_levels(replace(r, displacement_mm=ramp * r.displacement_mm))[0]) == 1


@pytest.mark.parametrize("rate", [83.0, 1280.0])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_steady_sines_are_steady(record, rate, noise):
    for seed in range(5):
        r = record(rate_hz=rate, n_cycles=25.3, noise_mm=noise, seed=seed)
        assert assess_drive(r.time_s, r.displacement_mm).kind == "steady"


@pytest.mark.parametrize("depth", [0.05, 0.2])
@pytest.mark.parametrize("beats", [2, 3, 5])
def test_a_beat_is_no_staircase_of_its_highs_and_lows(record, depth, beats):
    r = record(n_cycles=120.3)
    swing = 1.0 + depth * np.sin(2.0 * np.pi * beats * r.time_s / r.time_s[-1])
    assert assess_drive(r.time_s, swing * r.displacement_mm).kind == "drift"


@pytest.mark.parametrize("steps", [2, 5, 12, 20])
@pytest.mark.parametrize("cycles", [3, 10])
def test_a_staircase_of_many_levels_is_one(steps, cycles):
    time = np.arange(steps * cycles * 100) / 1000.0
    size = np.repeat(np.linspace(0.3, 1.0, steps), cycles * 100)
    found = assess_drive(time, size * np.sin(20.0 * np.pi * time))
    assert found.kind == "levels" and len(found.levels) == steps


@pytest.mark.parametrize("low, high, duration_s", [(5, 40, 20), (5, 50, 30), (50, 5, 30), (5, 80, 10), (5, 6, 60)])
@pytest.mark.parametrize("one_speed", [False, True])
def test_a_sweep_is_no_staircase_however_fast(low, high, duration_s, one_speed):
    time = np.arange(duration_s * 2560) / 2560.0
    rate = low + (high - low) * time / duration_s
    u = 0.6 * np.sin(2 * np.pi * (low + rate) / 2 * time) * (min(low, high) / rate if one_speed else 1.0)
    u += 0.001 * np.random.default_rng(1).standard_normal(u.size)
    assert assess_drive(time, u).kind == "drift"


@pytest.mark.parametrize("cycles", [5, 40])
def test_levels_that_a_controller_approaches_within_a_cycle_are_a_staircase(cycles):
    time, k = np.arange(8 * cycles * 100) / 1000.0, np.repeat(np.arange(8), cycles * 100)
    since = (np.arange(time.size) % (cycles * 100)) / 100
    size = 0.5 * 1.06 ** (k - np.where(k > 0, np.exp(-since / 0.7), 0.0))
    found = assess_drive(time, size * np.sin(20.0 * np.pi * time))
    assert found.kind == "levels" and len(found.levels) == 8


@pytest.mark.parametrize("frequency", [lambda a: 1.0, lambda a: 1.0 / a], ids=["one frequency", "one speed"])
def test_two_cycles_a_level_are_a_test_a_level_without_a_word_of_gaps(tmp_path, frequency):
    """As many rows a cycle at each: the band that crossings are fitted in holds two levels."""
    sizes, rows = (0.25, 0.5, 1.0, 1.5, 2.0), 100
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(2 * rows) / rows) for a in sizes])
    step = np.repeat([1.0 / (rows * frequency(a)) for a in sizes], 2 * rows)
    u += 2e-4 * np.random.default_rng(1).standard_normal(u.size)
    time = np.cumsum(step)
    assert assess_drive(time, u).kind == "levels"
    table = "".join(f"{t:.5f},{x:.5f},{20 * np.tanh(3 * x) + 4 * x:.4f}\n" for t, x in zip(time, u))
    (tmp_path / "a.csv").write_text("Time [s],Displacement [mm],Force [N]\n" + table)
    tests = import_tests([tmp_path / "a.csv"], split=True)
    assert [t.record.amplitude_mm for t in tests] == list(sizes)
    assert [t.record.frequency_hz for t in tests] == pytest.approx([frequency(a) for a in sizes], rel=1e-3)
    assert not any("gap" in x or "irregular" in x for t in tests for x in t.record.warnings)


def test_levels_of_two_cycles_that_begin_within_a_swing_are_right_or_said(tmp_path):
    """A cycle that began at the level before made an amplitude 2 % too small."""
    sizes, rows, start = (0.58, 0.7, 0.83, 1.0, 0.83, 0.7, 0.58, 0.49), 180, 0.25
    u = np.concatenate([a * np.sin(2 * np.pi * (start + np.arange(2 * rows) / rows)) for a in sizes])
    table = "".join(f"{k / 900:.5f},{x:.5f},{20 * np.tanh(3 * x) + 4 * x:.4f}\n" for k, x in enumerate(u))
    (tmp_path / "a.csv").write_text("Time [s],Displacement [mm],Force [N]\n" + table)
    tests = import_tests([tmp_path / "a.csv"], split=True)
    off = [min(abs(t.loop.amplitude_mm / a - 1) for a in sizes) for t in tests]
    assert len(tests) > 2 and max(off) > 0.01
    assert all("the drive's amplitude" in " ".join(t.record.warnings) for t, x in zip(tests, off) if x > 0.01)
