"""What the drive did is never laid on the specimen: a virtual drive fault of each kind, from record to diagnosis.

Staircases, steps of frequency, sweeps and drifts are refused before any diagnosis (tests/virtual_rig/test_drive.py has
all of them); here it is seen that a diagnosis refuses them too, and what it says of drives that are kept.
"""

from dataclasses import replace

import drives as dr
import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, Record, read_campaign, write_campaign
from bayes_iwan.campaign.timing.corners import CORNERS_GAP
from bayes_iwan.diagnosis.answer.saved_fits import loops_of
from bayes_iwan.diagnosis.assessment.budget import Kind
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.verdict import verdict_of
from bayes_iwan.diagnosis.diagnosis import diagnose_campaign, diagnose_loops
from bayes_iwan.files import finite
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.virtual_rig.simulate import Setup, with_noise
from bayes_iwan.virtual_rig.specimen import paper_specimen

SETUP = with_noise(Setup(), 0.005, 1.5, 1.0)
TESTS = [(f, a) for f in (8.0, 20.0) for a in (0.4, 0.9)]


def record(drive, file="drive.csv", seed=0):
    return dr.simulate_drive(paper_specimen(), drive, setup=SETUP, seed=seed, file=file)


def records(wave=dr.sine, change=lambda record, k: record, tests=TESTS):
    """Tests of a sound specimen; change(record, number) as the recorder spoils it."""
    out = []
    for k, (f, a) in enumerate(tests):
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
        diagnose_campaign(tmp_path, quick=True, progress=False)


#: fewer tests where the search for a cause runs at length: there is a gap
CORNERED = {"triangle": (dr.triangle, TESTS[1:]), "trapezoid": (dr.trapezoid, TESTS)}


@pytest.fixture(scope="module", params=CORNERED)
def cornered(kit, request, tmp_path_factory):
    wave, tests = CORNERED[request.param]
    return diagnosed(kit, tmp_path_factory.mktemp(request.param), records(wave, tests=tests))


def test_what_a_drive_with_corners_leaves_is_what_it_was(cornered, reference):
    reference(finite(cornered.to_dict()))


def test_a_drive_with_corners_is_told_to_be_the_drive_s(cornered):
    files = [test.file for test in cornered.campaign.tests]
    assert all(any("has corners" in w for w in test.warnings) for test in cornered.campaign.tests)
    assert 0.01 < cornered.before.all.share < CORNERS_GAP  # what there is to be blamed on someone
    assert cornered.verdict.kind is Kind.DRIVE and cornered.verdict.cause == "drive"
    assert cornered.verdict.causes == () and not cornered.verdict.unknown_cause and cornered.next_test is None
    said = " ".join(cornered.sentences())
    assert "cannot be found" in said and "sines" in said and files[0] in said
    answer = cornered.to_dict()
    assert answer["verdict"]["kind"] == "drive" and answer["verdict"]["cornered_drives"] == files


def test_a_gap_above_what_corners_make_is_assessed_with_the_drive_beside_it(cornered, monkeypatch):
    """As if the channels were sampled ten times as fast: what they may have made is less than the gap."""
    monkeypatch.setattr("bayes_iwan.campaign.loops.averaging.CORNERS_GAP", 0.01)
    verdict = verdict_of(cornered.found, calibration())
    assert verdict.kind is not Kind.DRIVE and "drive" not in verdict.probabilities
    if verdict.kind is Kind.UNKNOWN:
        said = " ".join(replace(cornered, verdict=verdict).sentences())
        assert "Up to 1 % of the friction force may be the channels'" in said


def test_a_sharp_triangle_is_followed_by_as_many_points_as_it_needs(kit, tmp_path):
    """Quasi-static tests: no filter rounds the corners, and a sound specimen leaves no gap to blame on them."""
    model = Model(kit.reference, slip="gamma2")
    turn = np.arange(4096) / 4096
    shape = 2 / np.pi * np.arcsin(np.sin(2 * np.pi * turn))
    speed = 4 * np.where(np.abs(turn - 0.5) < 0.25, -1.0, 1.0) * 1e-3  # m a cycle of 1 mm

    def record(hz, amplitude):
        motion = replace(
            sine_motion(frequency_hz=hz, amplitude_mm=amplitude, samples=4096),
            displacement_mm=amplitude * shape[None, None],
            velocity_m_s=amplitude * hz * speed[None, None],
            acceleration_m_s2=np.zeros((1, 1, 4096)),
        )
        force = model.force(kit.parameter_values(model), motion)[0, 0]
        cycles = np.arange(4 * 120 + 1) / 120
        noise = 0.002 * np.random.default_rng(int(100 * amplitude)).standard_normal(cycles.size)
        u, f = (np.interp(cycles % 1.0, np.append(turn, 1.0), np.append(x, x[0])) for x in (amplitude * shape, force))
        return Record(f"a{amplitude}_f{hz}.csv", hz, amplitude, "fit", {}, cycles / hz, u, f + noise)

    read = campaign(tmp_path, [record(hz, a) for hz in (0.01, 0.02) for a in (0.3, 0.6, 0.9)])
    loops = loops_of(read)
    assert {x.phase.size for x in loops} == {256} and all(x.sharp and not x.corners_gap for x in loops)
    found = diagnose_loops(read, loops, seed=1, quick=True, settings=kit.settings)
    assert found.verdict.kind is Kind.NONE and found.before.all.resolved_share < 0.003


@pytest.mark.parametrize("share", [0.05, 0.2])
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


def test_a_lost_trigger_is_refused_or_needs_no_cause(kit, tmp_path):
    def missed(one, k, block=440):
        return dr.lost_trigger(one, block=block, which=1 if block == 440 else 3)

    with pytest.raises(CampaignError, match="rows are missing"):
        campaign(tmp_path / "refused", records(change=missed))
    # half a block of 328 samples is 1.025 cycles at 8 Hz, which is said; at 20 Hz it would be 2.56 cycles
    some = [missed(one, 0, 328) if one.frequency_hz == 8.0 else one for one in records()]
    read = campaign(tmp_path / "said", some)
    assert any("jumps by" in w for test in read.tests for w in test.warnings)
    found = diagnosed(kit, tmp_path / "c", some)
    assert found.verdict.kind is Kind.NONE, found.sentences()
