"""Means of a record and their drift: measured, said, and taken off alike for every command."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.loops.averaging import average
from bayes_iwan.campaign.loops.between_tests import compared
from bayes_iwan.campaign.loops.checks import check_record
from bayes_iwan.campaign.loops.steadiness import cycles_of


def drifting(record, drift_mm, slope_N_mm=0.0, bend=0.0, **more):
    """A sound record whose displacement drifts by so much over its length, with a force that follows or not."""
    r = record(noise_N=0.003, noise_mm=0.0003, n_cycles=20.3, **more)
    x = np.linspace(-0.5, 0.5, r.time_s.size)
    path = drift_mm * (x + bend * (x**2 - 1 / 12))
    return replace(r, displacement_mm=r.displacement_mm + path, force_N=r.force_N + slope_N_mm * path)


@pytest.mark.parametrize("drift, bend", [(0.1, 0.0), (0.9, 0.0), (3.0, 0.0), (0.3, 1.5)])
def test_a_drift_of_the_displacement_is_taken_off_and_said(record, drift, bend):
    """Three amplitudes of drift leave no crossing of a middle: the line goes before cycles are counted."""
    sound, _ = check_record(record(noise_N=0.003, noise_mm=0.0003, n_cycles=20.3))
    kept, loop = check_record(drifting(record, drift, bend=bend))
    assert loop.amplitude_mm == pytest.approx(1.0, abs=0.004) and loop.n_cycles >= 19
    assert np.abs(kept.displacement_mm - kept.displacement_mm.mean() - sound.displacement_mm).max() < 0.03
    (said,) = (w for w in kept.warnings if "mean displacement drifts" in w)
    assert "does not tell" in said and "taken off" in said and sound.warnings == ()
    np.testing.assert_array_equal(kept.force_N, sound.force_N)


def test_a_force_that_follows_the_drift_as_a_spring_loses_its_share(record):
    kept, _ = check_record(drifting(record, 0.9, slope_N_mm=0.9))
    (said,) = (w for w in kept.warnings if "mean displacement drifts" in w)
    assert "follows by 0.9" in said and "the specimen moved" in said
    sound, _ = check_record(record(noise_N=0.003, noise_mm=0.0003, n_cycles=20.3))
    assert np.abs(kept.force_N - sound.force_N).max() < 0.05


def test_a_drift_of_the_force_alone_is_left_in_and_tied(record):
    r = record(noise_N=0.003, noise_mm=0.0003, n_cycles=20.3)
    kept, _ = check_record(replace(r, force_N=r.force_N + np.linspace(0, 0.5, r.time_s.size)))
    (said,) = (w for w in kept.warnings if "mean force drifts" in w)
    assert "zero, or a load that relaxes" in said and "`diagnose` searches for it" in said


def test_noise_is_no_drift(record):
    kept, _ = check_record(record(noise_N=0.02, noise_mm=0.01, n_cycles=20.3))
    assert kept.warnings == ()


def levels_of(record, means):
    places = [(f, a) for f in (8.0, 10.0, 13.0) for a in (0.4, 0.9)]
    out = []
    for (f, a), mean in zip(places, means, strict=True):
        r = record(frequency_hz=f, amplitude_mm=a, noise_N=0.003, noise_mm=0.0003, file=f"f{f:g}_a{a:g}.csv")
        out.append(check_record(replace(r, force_N=r.force_N + mean)))
    return [r for r, _ in out], [loop for _, loop in out]


def test_means_that_contradict_each_other_are_taken_off(record):
    records, loops = levels_of(record, [5.0, 5.0, 0.0, 5.0, 0.0, 5.0])
    kept = compared(records, loops)
    means = [check_record(r)[1].harmonics_N[0].real for r in kept]
    assert np.ptp(means) < 0.01
    assert all(r.mean_force_error_N > 1.0 and any("taken off" in w for w in r.warnings) for r in kept)
    assert check_record(kept[0])[1].noise_N[0] > 1.0, "what is left of the mean counts for little"


def test_of_a_mean_at_the_median_nothing_is_taken_off_and_without_a_clock_no_frequency_is_named(record):
    records, loops = (x[:5] for x in levels_of(record, [5.0, 5.0, 0.0, 4.0, 0.0, 5.0]))
    loops = [replace(x, record=replace(x.record, clock=False)) for x in loops]
    assert "nothing of it is taken off" in " ".join(w for r in compared(records, loops) for w in r.warnings)
    (said,) = {w.partition("in a way that ")[2] for r in compared(records, loops) for w in r.warnings}
    assert said.startswith("amplitude does not explain")


@pytest.mark.parametrize("means", [[0.0] * 6, [125.0] * 6, [0.1, 0.4, 0.1, 0.4, 0.1, 0.4]])
def test_means_that_a_specimen_can_have_stay(record, means):
    """None, one and the same, or what amplitude explains."""
    records, loops = levels_of(record, means)
    for before, after in zip(records, compared(records, loops)):
        np.testing.assert_array_equal(before.force_N, after.force_N)
        assert after.mean_force_error_N == 0.0


@pytest.mark.parametrize("cycles", [2.3, 2.85, 3.4])
@pytest.mark.parametrize("drift", [0.2, -0.45])
def test_a_drift_under_two_or_three_cycles_is_taken_off_and_said(record, cycles, drift):
    """It was neither: the energy came out up to 14 % off without a word."""
    r = record(noise_N=0.003, noise_mm=0.0003, n_cycles=cycles, start=0.7)
    _, sound = check_record(r)
    kept, loop = check_record(replace(r, displacement_mm=r.displacement_mm + np.linspace(0, drift, r.time_s.size)))
    energy = [np.mean(x.force_N * x.velocity_m_s) / x.frequency_hz for x in (loop, sound)]
    assert energy[0] == pytest.approx(energy[1], rel=0.005)
    assert any("mean displacement drifts" in w for w in kept.warnings)


def test_noise_of_few_cycles_is_no_drift(record):
    for seed in range(30):
        kept, _ = check_record(record(noise_N=0.02, noise_mm=0.01, n_cycles=2.4, seed=seed))
        assert not any("mean displacement" in w for w in kept.warnings)


@pytest.mark.parametrize("order", [6, 7])
def test_cycles_are_compared_by_harmonics_that_their_samples_resolve(record, order):
    """The strongest harmonic may be one that 16 samples a cycle do not resolve. Found by fuzz.py (seed 18)."""
    p = 2 * np.pi * 5.0 * (t := np.arange(480) / 80.0)
    r = replace(
        record(frequency_hz=5.0, time_s=t), displacement_mm=0.8 * np.sin(p) + np.sin(order * p), force_N=np.sin(p)
    )
    assert cycles_of(average(r)).displacement_shapes.shape[1] == 13
