"""What the drive did is never laid on the specimen: virtual drive faults are split, refused or said."""

from dataclasses import replace

import drives as dr
import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, average, read_campaign, write_campaign
from bayes_iwan.campaign.timing.drive import split_levels
from bayes_iwan.virtual_rig.simulate import Setup, with_noise
from bayes_iwan.virtual_rig.specimen import RigError, paper_specimen

SPECIMEN = paper_specimen()
SETUP = with_noise(Setup(), 0.005, 1.5, 1.0)
LEVELS = (0.3, 0.5, 0.7, 0.9, 1.1)


def run(drive, seed=0):
    return dr.simulate_drive(SPECIMEN, drive, setup=SETUP, seed=seed)


def read(path, *records):
    write_campaign(path, name="n", description="", tests=records, compress=False)
    return read_campaign(path)


def test_a_steady_sine_is_one_test_without_a_word(tmp_path):
    (test,) = read(tmp_path, run(dr.steady(10, 0.7))).tests
    assert test.warnings == ()


@pytest.mark.parametrize("levels", [LEVELS, LEVELS[::-1], (0.7, 0.3, 0.7), (0.6, 0.7)])
def test_a_staircase_of_amplitudes_is_refused_and_split(tmp_path, levels):
    record = run(dr.staircase(10, levels))
    with pytest.raises(CampaignError, match=rf"staircase of {len(levels)} levels .* mm.*--split"):
        read(tmp_path, record)
    pieces, _ = split_levels(record)
    assert [p.file for p in pieces] == [f"drive_{k + 1}.csv" for k in range(len(levels))]
    compliance = 1 - pieces[0].amplitude_mm / levels[0]  # the shaker yields by a few per cent
    assert 0 < compliance < 0.05
    for piece, loop, level in zip(pieces, read(tmp_path / "split", *pieces).loops(), levels):
        assert piece.amplitude_mm == pytest.approx(level, rel=0.04) and piece.frequency_hz == pytest.approx(
            10, rel=1e-3
        )
        assert loop.n_cycles >= 17
        # each piece's loop is that of a test of its own
        alone = average(run(dr.steady(10, level, cycles=20)))
        assert np.abs(loop.harmonics_N[1:6] - alone.harmonics_N[1:6]).max() < 0.01 * np.abs(alone.harmonics_N[1])


def test_steps_of_frequency_are_split(tmp_path):
    record = run(dr.stepped_frequency((8, 10, 12), 0.7))
    with pytest.raises(CampaignError, match=r"staircase of 3 levels \(8, 10, 12 Hz\)"):
        read(tmp_path, record)
    pieces, _ = split_levels(record)
    assert [p.frequency_hz for p in pieces] == pytest.approx([8, 10, 12], rel=1e-3)
    assert len(read(tmp_path / "split", *pieces).tests) == 3


@pytest.mark.parametrize(("first", "last"), [(0.8, 1.2), (1.2, 0.8), (0.93, 1.07)])
def test_a_drifting_amplitude_is_refused(tmp_path, first, last):
    record = run(dr.drifting_amplitude(10, 0.7, first, last))
    with pytest.raises(CampaignError, match="drifts in amplitude"):
        read(tmp_path, record)
    with pytest.raises(CampaignError, match="drifts in amplitude"):
        split_levels(record)


@pytest.mark.parametrize(("first", "last"), [(5, 25), (25, 5), (9, 11)])
def test_a_sweep_is_refused_as_a_sweep(tmp_path, first, last):
    with pytest.raises(CampaignError, match=r"sweeps in frequency, from .* Hz"):
        read(tmp_path, run(dr.sweep(first, last, 0.7)))


def test_what_the_rig_cannot_run():
    with pytest.raises(RigError, match="two cycles"):
        run(dr.steady(10, 0.7, cycles=1))
    with pytest.raises(RigError, match="no block"):
        dr.lost_trigger(run(dr.steady(10, 0.7)), which=100)


@pytest.mark.parametrize("wave", [dr.triangle, dr.trapezoid, *(dr.distorted(s) for s in (0.01, 0.05, 0.1, 0.2))])
def test_any_periodic_drive_is_kept_whole(tmp_path, wave):
    """The averaged displacement is the recorded one, sample for sample, with all the harmonics that it has."""
    record = run(dr.steady(10, 0.7, wave=wave))
    low, high = np.percentile(record.displacement_mm, [0.1, 99.9])
    record = replace(record, amplitude_mm=float(high - low) / 2)
    (loop,) = read(tmp_path, record).loops()
    # what filtered channels make of a corner would be laid on the specimen: that much is said, and of corners alone
    (*said,) = (w for w in loop.record.warnings if any(x in w for x in ("drive", "corners", "phase", "frequency")))
    assert ["has corners" in w for w in said] == [True] * (wave in (dr.triangle, dr.trapezoid))
    assert loop.amplitude_mm == pytest.approx((high - low) / 2, rel=5e-3)
    phase = loop.averager.phase - loop.averager.shift
    measured = record.displacement_mm[loop.averager.index] - loop.offset_mm
    seen = np.interp(phase, loop.phase, loop.displacement_mm, period=1.0)
    assert np.sqrt(np.mean((seen - measured) ** 2)) < 2.5e-3 * loop.amplitude_mm


@pytest.mark.parametrize("seed", range(3))
def test_rows_lost_without_a_trace_in_the_time_are_seen(tmp_path, seed):
    record = run(dr.steady(10, 0.7), seed)
    with pytest.raises(CampaignError, match=r"phase of both channels jumps by .*rows are missing"):
        read(tmp_path / "missed", dr.lost_trigger(record, 440))
    (test,) = read(tmp_path / "nearly", dr.lost_trigger(record)).tests  # 17° short of two whole cycles
    assert any("jumps by" in w for w in test.warnings)
    (test,) = read(tmp_path / "dropped", dr.dropped_samples(record, 20, seed)).tests
    assert any("lost rows" in w or "rows lost" in w for w in test.warnings)
