"""The rig's records: the measuring chain, sizes of effects, planned campaigns, random cases."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign
from bayes_iwan.virtual_rig import cases, sizing
from bayes_iwan.virtual_rig.fault import Fault
from bayes_iwan.virtual_rig.fault_chain import first_order
from bayes_iwan.virtual_rig.faults import CATALOGUE, KINDS, OUTSIDE, acting, complete, drawn
from bayes_iwan.virtual_rig.planning import simulate_campaign
from bayes_iwan.virtual_rig.sensors import Chain, Sensors, coloured_noise, measure
from bayes_iwan.virtual_rig.simulate import PlannedTest, Setup, VirtualRig
from bayes_iwan.virtual_rig.specimen import RigError, draw_specimen, paper_specimen

PLAN = (PlannedTest(10.0, 0.3, cycles=12), PlannedTest(20.0, 0.8, cycles=12))


@pytest.fixture(scope="module")
def rig():
    return VirtualRig(paper_specimen(seed=1))


@pytest.fixture(scope="module")
def sound(rig):
    return sizing.surroundings(rig, PLAN)


# ---- the measuring chain, on a pure sine

RATE = 25600.0
FINE = np.arange(-2.0, 2.1, 1 / RATE)
SAMPLES = np.arange(2560) / 1280.0
HZ = 10.0


def chained(chain, sensors=None, clean=True, force=None, seed=0):
    x = np.sin(2 * np.pi * HZ * FINE)
    return measure(
        FINE, x, 2.0 * x if force is None else force, SAMPLES, sensors or Sensors(), chain,
        np.random.default_rng(seed), clean,
    )  # fmt: skip


def phasor(y, hz=HZ):
    return 2 * np.mean(y * np.exp(-2j * np.pi * hz * SAMPLES))


def test_sound_chain_keeps_the_two_channels_together():
    u, f = chained(Chain())
    assert phasor(f) / phasor(u) == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("delay_s", [4e-4, -4e-4])
def test_delay_turns_the_force_and_is_positive_when_it_comes_late(delay_s):
    u, f = chained(Chain(delay_s=delay_s))
    assert np.angle(phasor(f) / phasor(u)) == pytest.approx(-2 * np.pi * HZ * delay_s, rel=1e-3)


def test_first_order_corners():
    for field, high, corner, index, expected in (
        ("force_filters", True, 0.8, 1, 1 / (1 - 1j * 0.8 / HZ)),
        ("force_filters", False, 60.0, 1, 1 / (1 + 1j * HZ / 60.0)),
        ("displacement_filters", True, 0.5, 0, 1 / (1 - 1j * 0.5 / HZ)),
    ):
        changed, sound = chained(Chain(**{field: (first_order(corner, high),)})), chained(Chain())
        assert phasor(changed[index]) / phasor(sound[index]) == pytest.approx(expected, rel=2e-3)


def faulty(name, law="", **parameter_values):
    return chained(acting((Fault(name, parameter_values, law),)).chain)


@pytest.mark.parametrize("law", ["pure", "all_pass", "second_order"])
def test_delays_agree_at_low_frequencies(law):
    u, f = faulty("channel_delay", law, delay_s=3e-4)
    assert np.angle(phasor(f) / phasor(u)) == pytest.approx(-2 * np.pi * HZ * 3e-4, rel=5e-3)


def test_mass_drift_mains_and_clipping():
    sound = chained(Chain())[1]
    mass = faulty("moving_mass", m_kg=0.05)[1]
    assert abs(phasor(mass)) == pytest.approx(2.0 - 0.05e-3 * (2 * np.pi * HZ) ** 2, rel=1e-3)
    soft = faulty("moving_mass", "soft_mount", m_kg=0.05, mount_hz=30.0, ratio=0.1)[1]
    swing = 1 / (1 - (HZ / 30.0) ** 2 + 0.2j * HZ / 30.0)
    seen = (phasor(soft) - phasor(sound)) / (phasor(mass) - phasor(sound))
    assert seen == pytest.approx(swing, rel=5e-3)
    drift = faulty("force_drift", rate_N_s=0.3)[1] - sound
    assert np.polyfit(SAMPLES, drift, 1)[0] == pytest.approx(0.3, rel=1e-3)
    for law, third in (("sine", 0.0), ("harmonics", 0.35)):
        hum = faulty("mains_interference", law, amplitude_N=0.2, frequency_hz=60.0)[1] - sound
        spectrum, lines = np.abs(np.fft.rfft(hum * np.hanning(hum.size))), np.fft.rfftfreq(2560, 1 / 1280)
        assert lines[spectrum.argmax()] == pytest.approx(60.0, abs=0.5)
        at_third = spectrum[np.abs(lines - 180.0) < 3].max() / spectrum.max()
        assert at_third == pytest.approx(third, abs=0.1)
    clipped = faulty("force_clipping", limit_N=1.5)[1]
    assert 1.5 < clipped.max() < 1.65  # the anti-alias filter rings a little at the corner
    one = faulty("force_clipping", "one_side", limit_N=1.5)[1]
    assert one.max() < 1.65 and one.min() < -1.9


def test_reading_lags_at_reversals_by_up_to_its_width():
    u, sound = chained(Chain(reading_lag_mm=0.05))[0], chained(Chain())[0]
    assert np.abs(u - sound).max() == pytest.approx(0.025 * 0.5, rel=0.1)  # half the mean of widths up to 0.05
    rising = np.gradient(sound) > 1e-3
    assert (sound - u)[rising & (np.abs(sound) < 0.5)].min() > 0


def test_noise_has_its_rms_and_colour_and_steps_are_kept():
    noise = coloured_noise(np.random.default_rng(0), 200_000, 0.02, 0.3, 0.2)
    assert noise.std() == pytest.approx(0.02, rel=0.05)
    lag_one = np.corrcoef(noise[1:], noise[:-1])[0, 1]
    assert 0.3 < lag_one < 0.6
    slow = noise.reshape(-1, 1000).mean(axis=1).std() / (0.02 / np.sqrt(1000))
    assert slow > 3  # white noise gives 1
    sensors = Sensors(force_noise_N=0.01, displacement_noise_mm=1e-4, force_step_N=0.003)
    noisy = chained(Chain(), sensors, clean=False)[1]
    assert (noisy - chained(Chain())[1]).std() == pytest.approx(0.01, rel=0.3)
    np.testing.assert_allclose(noisy / 0.003, np.round(noisy / 0.003), atol=1e-6)


# ---- whole tests


def test_record_has_the_wanted_motion_and_follows_from_the_seed(rig):
    a, b, other = (replace(rig, seed=seed).run(PLAN[1]) for seed in (5, 5, 6))
    np.testing.assert_array_equal(a.force_N, b.force_N)
    assert np.abs(other.force_N - a.force_N).max() > 0.1  # starts elsewhere in the cycle
    assert 0.5 * np.ptp(a.displacement_mm) == pytest.approx(0.8, rel=0.015)
    assert abs(a.displacement_mm.max() + a.displacement_mm.min()) < 0.01
    assert abs(a.true_frequency_hz / 20.0 - 1) <= 0.003 and a.true_frequency_hz != 20.0
    assert len(a.time_s) == round(12 / 20 * 1280)
    # distortion is there, and small
    turn = 2j * np.pi * a.true_frequency_hz * a.time_s
    second = abs(np.mean(a.displacement_mm * np.exp(-2 * turn))) / abs(np.mean(a.displacement_mm * np.exp(-turn)))
    assert 0.003 < second < 0.02  # of 0.01 asked of the drive, the specimen's own apart


def test_run_in_is_over_when_the_record_starts(rig):
    r = replace(rig, setup=Setup(frequency_error=0)).run(PlannedTest(10.0, 0.6, cycles=20), clean=True)
    cycles = r.force_N.reshape(20, 128)
    assert np.abs(cycles[0] - cycles[-1]).max() < 0.02 * np.abs(cycles).max()


@pytest.mark.parametrize(
    "name", ["viscous_damping", "rig_compliance", "integration_highpass", "force_drift", "end_stop"]
)
def test_size_asked_for_is_the_size_at_full_fidelity(rig, sound, name):
    effect = sizing.size_fault(name, 0.08, rig, PLAN, np.random.default_rng(1), sound=sound)
    assert effect.size == pytest.approx(0.08, rel=0.021)
    changed, base = (replace(rig, faults=faults).run_all(PLAN, clean=True) for faults in ((effect,), ()))
    friction = sizing.friction_of_runs_N(base, rig.specimen.parallel_N_mm)
    assert sizing.force_change_N(changed, base) / friction == pytest.approx(0.08, rel=0.06)


EVERY_LAW = [(name, law.name) for name, kind in sorted(KINDS.items()) for law in kind.laws]


@pytest.mark.parametrize(("name", "law"), EVERY_LAW)
def test_every_law_changes_the_force_and_more_so_when_stronger(rig, sound, name, law):
    others = drawn(name, law, sound[0], np.random.default_rng(3))
    sizes = [
        sizing.fault_size(rig, PLAN, complete(name, law, others, sound[0], strength), sound=sound)
        for strength in (0.02, 0.2)
    ]
    assert 0 < sizes[0] < 0.35 * sizes[1]


def test_delay_has_the_size_that_its_phase_gives(rig, sound):
    """At equal displacement a delay τ changes the force by about ωτ times its RMS."""
    effect = Fault("channel_delay", {"delay_s": 2e-4})
    found = sizing.fault_size(rig, PLAN, effect, sound=sound) * sound[0].friction_rms_N
    rates = [np.gradient(r.force_N, r.time_s) * 2e-4 for r in sound[1]]
    assert found == pytest.approx(np.sqrt(np.mean([np.mean(r**2) for r in rates])), rel=0.05)


def test_visible_share_of_what_a_specimen_can_and_cannot_imitate(rig, sound):
    names = ("rig_compliance", "mains_interference", "moving_mass")
    faults = [complete(n, "", drawn(n, "", sound[0], np.random.default_rng(5)), sound[0], 0.1) for n in names]
    wide = tuple(PlannedTest(f, a, cycles=12) for f in (10.0, 20.0) for a in (0.3, 0.8))
    soft, hum, mass = (sizing.shares_left(rig, wide, (one,))[0].visible for one in faults)
    assert soft < 0.1 and hum > 0.85 and soft < mass < 1
    # at one frequency a mass is a spring: nothing of it is left
    alone = tuple(PlannedTest(15.0, a, cycles=12) for a in (0.3, 0.8))
    (single,) = sizing.shares_left(rig, alone, faults[2:])
    assert single.visible < 0.2 * mass and single.share == pytest.approx(1.0)


def test_effect_too_weak_for_the_specimen_is_refused(rig, sound):
    with pytest.raises(RigError, match="at most"):
        sizing.size_fault("normal_force_lag", 0.9, rig, PLAN, np.random.default_rng(0), sound=sound)


def test_planned_campaign_is_written_and_read_back(tmp_path):
    campaign = simulate_campaign(PLAN, fault="viscous_damping", size=0.1, noise=0.004, seed=2)
    campaign.write(tmp_path / "plan")
    loops = read_campaign(tmp_path / "plan").loops()
    assert [round(loop.amplitude_mm, 2) for loop in loops] == pytest.approx([0.3, 0.8], rel=0.02)
    assert campaign.faults[0].size == pytest.approx(0.1, rel=0.03)
    noise = 0.004 * campaign.friction_rms_N
    assert 0.3 * noise < np.median(loops[0].force_scatter_N) < 3 * noise
    with pytest.raises(RigError, match="at least one test"):
        simulate_campaign(())


# ---- random cases


def test_random_specimens_are_sensible_and_various():
    rng = np.random.default_rng(0)
    drawn = [draw_specimen(rng, (0.25, 0.8), 0.08) for _ in range(60)]
    assert len({s.family for s in drawn}) == 7
    for s in drawn:
        assert s.stiffness_share.sum() == pytest.approx(1.0)
        assert 0.35 < s.slip_share_N.sum() < 3.0 and 8 <= s.contact_N_mm <= 25 and 3 <= s.parallel_N_mm <= 9
        assert np.all(s.slip_share_N > 0)


def test_designs_stay_within_their_ranges():
    rng = np.random.default_rng(1)
    single = held = 0
    for _ in range(300):
        tests, sealed = cases.draw_design(rng)
        frequencies, amplitudes = {t.frequency_hz for t in tests}, {t.amplitude_mm for t in tests}
        assert len(tests) == len(frequencies) * len(amplitudes) and 1 <= len(frequencies) <= 4
        assert 2 <= len(amplitudes) <= 4 and all(5 <= f <= 30 for f in frequencies)
        assert all(0.2 <= a <= 1.2 for a in amplitudes) and 20 <= tests[0].cycles <= 60
        given = {(t.frequency_hz, t.amplitude_mm) for t in tests}
        assert sealed and not given & {(t.frequency_hz, t.amplitude_mm) for t in sealed}
        single += len(frequencies) == 1
        held += any(t.role == "held-out" for t in tests)
    assert 20 < single < 90 and 25 < held < 130


def test_shares_of_a_gap_sum_to_one_and_follow_the_sizes(rig, sound):
    faults = tuple(
        sizing.size_fault(n, size, rig, PLAN, np.random.default_rng(1), sound=sound)
        for n, size in (("mains_interference", 0.09), ("rocking", 0.03))
    )
    hum, rocking = sizing.shares_left(rig, PLAN, faults)
    assert hum.share + rocking.share == pytest.approx(1.0) == hum.share_of_square + rocking.share_of_square
    # two changes that have nothing in common add in squares
    a, b = hum.size * hum.visible, rocking.size * rocking.visible
    assert hum.share_of_square == pytest.approx(a**2 / (a**2 + b**2), abs=0.02)
    whole = np.hypot(a, b)
    assert hum.share == pytest.approx(0.5 * ((whole - b) + a) / whole, abs=0.02)


@pytest.mark.parametrize(("kind", "known", "unknown"), [("triple", 3, 0), ("known_beside_outside", 1, 1)])
def test_kinds_of_cases_have_their_faults_by_laws_that_were_not_left_out(monkeypatch, kind, known, unknown):
    monkeypatch.setattr(cases, "draw_design", lambda rng: (PLAN, PLAN[:1]))
    left = [f"{name}:{law.name}" for name in CATALOGUE for law in KINDS[name].laws[2:]]
    case = cases.draw_case(
        np.random.default_rng(4), kind, laws="other", excluded_laws=left, excluded_outside=OUTSIDE[:-2]
    )
    listed = [f for f in case.faults if KINDS[f.name].listed]
    assert len(listed) == known and len(case.faults) == known + unknown
    assert all(f.law == KINDS[f.name].laws[1].name for f in listed)
    assert all(f.name in OUTSIDE[-2:] for f in case.faults if f not in listed)
    assert sum(f.share for f in case.faults) == pytest.approx(1.0)
    truth = case.truth("case_1")
    assert [e["law"] for e in truth["effects"]] == [f.law for f in case.faults]


def test_drawn_case_is_reproducible_and_has_what_it_says(monkeypatch):
    monkeypatch.setattr(cases, "draw_design", lambda rng: (PLAN, PLAN[:1]))
    a, b = (cases.draw_case(np.random.default_rng(8), faults=["rig_compliance"]) for _ in range(2))
    assert a.faults == b.faults and a.seed == b.seed
    assert 0.0195 < a.faults[0].size < 0.123 and a.faults[0].law in ("linear", "stiffening", "hertz")
    np.testing.assert_array_equal(*(x.rig.run(x.tests[0]).force_N for x in (a, b)))
    assert a.setup.sensors.force_noise_N == pytest.approx(a.noise_share * a.friction_rms_N)
    with pytest.raises(RigError, match="no kind"):
        cases.draw_case(np.random.default_rng(0), "several")
