"""What the drive did is never laid on the specimen: a virtual drive fault of each kind, from record to diagnosis.

Staircases, steps of frequency, sweeps and drifts are refused before any diagnosis (tests/rig/test_drive.py has all of
them); here it is seen that a diagnosis refuses them too, and what it says of drives that are kept.
"""

from dataclasses import replace

import pytest

from bayes_iwan.campaign import CampaignError, read_campaign, write_campaign
from bayes_iwan.campaign.corners import CORNERS_GAP
from bayes_iwan.gap.budget import Kind
from bayes_iwan.gap.diagnosis import diagnose_folder, diagnose_loops
from bayes_iwan.rig import drive as dr
from bayes_iwan.rig.simulate import Setup, with_noise
from bayes_iwan.rig.specimen import paper_specimen

SETUP = with_noise(Setup(), 0.005, 1.5, 1.0)
TESTS = [(f, a) for f in (8.0, 20.0) for a in (0.4, 0.9)]


def record(drive, file="drive.csv", seed=0):
    return dr.simulate_drive(paper_specimen(), drive, setup=SETUP, seed=seed, file=file)


def records(wave=dr.sine, change=lambda record, k: record):
    """Four tests of a sound specimen; change(record, number) as the recorder spoils it."""
    out = []
    for k, (f, a) in enumerate(TESTS):
        one = record(dr.steady(f, a, cycles=20, wave=wave), f"f{f:g}_a{a:g}.csv", int(f))
        half = float(one.displacement_mm.max() - one.displacement_mm.min()) / 2
        out.append(change(replace(one, amplitude_mm=half), k))
    return out


def campaign(path, some):
    write_campaign(path, name="n", description="", tests=some, compress=False)
    return read_campaign(path)


def diagnosed(kit, path, some):
    read = campaign(path, some)
    return diagnose_loops(read, read.loops(**kit.small), seed=1, quick=True, settings=kit.settings)


@pytest.mark.parametrize(
    "drive",
    [
        dr.staircase(10, (0.3, 0.5, 0.7, 0.9, 1.1)),
        dr.stepped_frequency((8, 10, 12), 0.7),
        dr.sweep(5, 25, 0.7),
        dr.drifting_amplitude(10, 0.7),
    ],
    ids=lambda d: d.name,
)
def test_what_is_no_single_test_is_not_diagnosed(tmp_path, drive):
    write_campaign(tmp_path, name="n", description="", tests=[record(drive)], compress=False)
    with pytest.raises(CampaignError, match=r"staircase of|sweeps in frequency|drifts in amplitude"):
        diagnose_folder(tmp_path, quick=True, progress=False)


@pytest.mark.parametrize("wave", [dr.triangle, dr.trapezoid])
def test_a_drive_with_corners_is_told_to_be_the_drive_s(kit, tmp_path, wave):
    read = campaign(tmp_path / "seen", records(wave))
    assert all(any("has corners" in w for w in test.warnings) for test in read.tests)
    found = diagnosed(kit, tmp_path / "c", records(wave))
    assert 0.01 < found.before.all.share < CORNERS_GAP  # what there is to be blamed on someone
    assert found.verdict.kind is Kind.DRIVE and found.verdict.cause == "drive"
    assert found.verdict.causes == () and not found.verdict.unknown_rest and found.next_test is None
    said = " ".join(found.sentences())
    assert "cannot be told" in said and "sines" in said and "f8_a0.4.csv" in said
    answer = found.to_dict()
    assert answer["verdict"]["kind"] == "drive" and len(answer["verdict"]["cornered_drives"]) == 4


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1, 0.2])
def test_a_distorted_sine_needs_no_cause(kit, tmp_path, share):
    found = diagnosed(kit, tmp_path, records(dr.distorted(share)))
    assert found.verdict.kind is Kind.NONE and found.before.all.share < 0.005
    assert found.verdict.cornered == ()


def test_lost_rows_need_no_cause(kit, tmp_path):
    some = records(change=lambda one, k: dr.dropped_samples(one, 20, k))
    read = campaign(tmp_path / "seen", some)
    assert all(any("phase" in w or "frequency drifts" in w for w in test.warnings) for test in read.tests)
    found = diagnosed(kit, tmp_path / "c", some)
    assert found.verdict.kind is Kind.NONE, found.sentences()


def test_a_missed_trigger_is_refused_or_needs_no_cause(kit, tmp_path):
    def missed(one, k, block=440):
        return dr.missed_trigger(one, block=block, which=1 if block == 440 else 3)

    with pytest.raises(CampaignError, match="rows are missing"):
        campaign(tmp_path / "refused", records(change=missed))
    # half a block of 328 samples is 1.025 cycles at 8 Hz, which is said; at 20 Hz it would be 2.56 cycles
    some = [missed(one, 0, 328) if one.frequency_hz == 8.0 else one for one in records()]
    read = campaign(tmp_path / "said", some)
    assert any("jumps by" in w for test in read.tests for w in test.warnings)
    found = diagnosed(kit, tmp_path / "c", some)
    assert found.verdict.kind is Kind.NONE, found.sentences()


def test_a_real_cause_under_corners_is_still_named_with_the_drive_beside_it(kit, tmp_path):
    """A gap above what corners make: the diagnosis stands, and says how much of it may be the drive's."""
    late = records(  # the displacement is a sample late
        dr.triangle,
        lambda one, k: replace(
            one, time_s=one.time_s[1:], force_N=one.force_N[1:], displacement_mm=one.displacement_mm[:-1]
        ),
    )
    found = diagnosed(kit, tmp_path, late)
    assert found.before.all.share > CORNERS_GAP and found.verdict.kind is not Kind.DRIVE
    assert any("may be the channels'" in s for s in found.sentences())
