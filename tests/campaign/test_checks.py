"""Records that parse but cannot be right."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, read_campaign, write_campaign
from bayes_iwan.campaign.loops.checks import check_record


def campaign(path, tests):
    write_campaign(path, name="n", description="", tests=tests, compress=False)
    return read_campaign(path)


def nine(record, change=lambda r: r, which=None):
    """Nine tests whose force grows with the square root of amplitude, one of them changed."""
    tests = []
    for f in (10.0, 15.0, 20.0):
        for a in (0.3, 0.6, 1.0):
            r = record(frequency_hz=f, amplitude_mm=a, noise_N=0.01, file=f"f{f:g}_a{a:g}.csv")
            r = replace(r, force_N=r.force_N * a**0.5)
            tests.append(change(r) if r.file == which else r)
    return tests


def test_reversed_channel(tmp_path, record):
    r = record()
    with pytest.raises(CampaignError, match=r"test\.csv: .*reversed.*-1"):
        campaign(tmp_path, [replace(r, force_N=-r.force_N)])
    with pytest.raises(CampaignError, match="reversed"):
        campaign(tmp_path, [replace(r, displacement_mm=-r.displacement_mm)])


def test_a_loop_that_dissipates_next_to_nothing_is_not_called_reversed(tmp_path, record):
    # a force 5 mrad late on a spring: negative dissipation, but by a delay and not by a sign
    r = record(force=np.array([0, -4j * np.exp(-0.005j)]))
    (test,) = campaign(tmp_path, [r]).tests
    assert any("delayed" in w for w in test.warnings)


def test_a_late_channel_may_give_out_more_energy_but_not_any_amount(tmp_path, record):
    (test,) = campaign(tmp_path, [record(force=np.array([0, -4j * np.exp(-0.1j)]))]).tests
    assert any("gives out energy" in w and "AC-coupled" in w for w in test.warnings)
    # an angle that no passive specimen has is a delay, and is not called a reversed channel
    with pytest.raises(CampaignError, match=r"late by 34° \(9.5 ms\) and more, a delayed"):
        campaign(tmp_path / "more", [record(force=np.array([0, -4j * np.exp(-0.6j)]))])


def test_a_delay_of_a_slow_test_is_in_seconds(tmp_path, record):
    """A row a second: "5.6e+03 ms"."""
    r = record(force=np.array([0, -4j * np.exp(-0.1j)]))
    slow = replace(r, time_s=1e4 * r.time_s, frequency_hz=1e-4 * r.frequency_hz)
    (test,) = campaign(tmp_path, [slow]).tests
    assert any("late by 5.7° (15.9 s) and more" in w for w in test.warnings)


@pytest.mark.parametrize("which", ["f10_a0.3.csv", "f15_a0.6.csv", "f20_a1.csv"])
@pytest.mark.parametrize("factor", [1e3, 1e-3, 10.0, 0.1, 9.80665])
def test_one_force_in_the_wrong_unit(tmp_path, record, which, factor):
    tests = nine(record, lambda r: replace(r, force_N=r.force_N * factor), which)
    with pytest.raises(CampaignError, match=rf"{which}: the force is about .* times .*force_kN"):
        campaign(tmp_path, tests)


def test_forces_that_amplitude_explains_are_let_through(tmp_path, record):
    tests = [
        replace(r, force_N=r.force_N * r.amplitude_mm**power) for power, r in zip((-0.5, 0.5, 1.0) * 3, nine(record))
    ]
    assert len(campaign(tmp_path, tests).tests) == 9


def test_load_explains_force(tmp_path, record):
    tests = [
        replace(record(file=f"{n:g}.csv", noise_N=0.01), extras={"normal_force_N": n}, force_N=record().force_N * n)
        for n in (1.0, 2.0, 3.0, 4.0, 200.0)
    ]
    assert len(campaign(tmp_path, tests).tests) == 5


def test_wrong_unit_of_one_in_two(tmp_path, record):
    tests = [record(file="a.csv"), replace(record(file="b.csv"), force_N=1e3 * record().force_N)]
    with pytest.raises(CampaignError, match=r"a\.csv or b\.csv: the force"):
        campaign(tmp_path, tests)


@pytest.mark.parametrize("channel", ["displacement", "force"])
def test_clipping_is_said(tmp_path, record, channel):
    r = record(noise_N=0.002, noise_mm=0.0005)
    assert campaign(tmp_path, [r]).tests[0].warnings == ()
    name = {"displacement": "displacement_mm", "force": "force_N"}[channel]
    values = getattr(r, name)
    clipped = replace(r, **{name: np.minimum(values, 0.93 * values.max())})
    (test,) = campaign(tmp_path, [clipped]).tests
    (said,) = (w for w in test.warnings if "clipped" in w)
    # the force's noise stops there, which no specimen makes it do
    sure = "is" if channel == "force" else "may be"
    assert f"{channel} {sure} clipped at {0.93 * values.max():.6g}" in said
    assert said.count("too small") == 1 and f"Raise the {channel} range" in said


def test_coarse_rounding_is_not_clipping(tmp_path, record):
    r = record()
    rounded = replace(r, displacement_mm=np.round(r.displacement_mm / 0.02) * 0.02)
    (said,) = campaign(tmp_path, [rounded]).tests[0].warnings
    assert "the displacement moves in steps of 0.02 mm" in said and "clipped" not in said


@pytest.mark.parametrize(("levels", "said"), [(20, True), (400, True), (2000, False)])
def test_coarse_steps_are_said_of_any_campaign(tmp_path, record, levels, said):
    """100 N in 2 kN went without a word where a folder was not imported."""
    r = record(noise_N=0.01)
    step = float(np.ptp(r.force_N)) / levels
    (test,) = campaign(tmp_path, [replace(r, force_N=step * np.round(r.force_N / step))]).tests
    assert any("the force moves in steps of" in w for w in test.warnings) == said


def test_a_steady_speed_is_no_coarse_step(tmp_path, record):
    """Each sample of a triangle is a step from the one before, whatever its resolution."""
    r = record(frequency_hz=10.0, amplitude_mm=0.4, rate_hz=1000.0)
    triangle = 0.4 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 10.0 * (r.time_s - r.time_s[0])))
    (test,) = campaign(tmp_path, [replace(r, displacement_mm=triangle)]).tests
    assert not any("in steps of" in w for w in test.warnings)


def test_a_force_in_coarse_steps_is_not_frozen(tmp_path, record):
    r = record(noise_N=0.05)
    step = 0.12 * float(np.ptp(r.force_N))
    coarse = replace(r, force_N=step * np.round(r.force_N / step))
    (loop,) = campaign(tmp_path, [coarse]).loops()
    assert not any("off the other cycles" in w for w in loop.record.warnings)
    dead = coarse.force_N.copy()
    dead[700:760] = dead[700]
    with pytest.raises(CampaignError, match="stands still where it moves in other cycles"):
        campaign(tmp_path, [replace(r, force_N=dead)]).loops()


def test_a_displacement_that_drops_out_is_seen_among_five_cycles(tmp_path, record):
    """It was averaged in without a word: 7 % too little energy."""
    r = record(frequency_hz=10.4, n_cycles=6.5, rate_hz=500.0, noise_N=0.05)
    r = replace(r, displacement_mm=np.where((r.time_s > 0.29) & (r.time_s < 0.333), 0.0, r.displacement_mm))
    with pytest.raises(CampaignError, match="displacement stands still where it moves in other cycles"):
        campaign(tmp_path, [r]).loops()


def test_aliased(tmp_path, record):
    with pytest.raises(CampaignError, match=r"test\.csv: 7\.0 samples a cycle.*Sample faster"):
        campaign(tmp_path, [record(rate_hz=70.0)])
    assert campaign(tmp_path, [record(rate_hz=83.0)]).loops()[0].n_cycles == 11


def test_frequency_is_measured_and_compared(tmp_path, record):
    (test,) = campaign(tmp_path, [replace(record(), frequency_hz=10.9)]).tests
    assert test.frequency_hz == 10.9  # within a tenth: the stated value is kept as stated
    with pytest.raises(CampaignError, match=r"shows 10 Hz, campaign\.toml states frequency_hz = 11\.2"):
        campaign(tmp_path, [replace(record(), frequency_hz=11.2)])


def test_a_frequency_counted_in_samples_of_an_irregular_clock_is_said(tmp_path, record):
    # every step between 10 and 25 ms; counted as if all were 10 ms the frequency would be 1.7 times as high
    rng = np.random.default_rng(3)
    time = np.cumsum(np.where(rng.random(4000) < 0.1, 0.010, rng.uniform(0.015, 0.020, 4000)))
    r = record(frequency_hz=0.2, time_s=time)
    counted = 0.2 * np.diff(time).mean() / 0.010
    (test,) = campaign(tmp_path, [replace(r, frequency_hz=counted)]).tests
    assert any("even" in w and "0.2 Hz" in w for w in test.warnings)
    with pytest.raises(CampaignError, match=r"shows 0\.2 Hz"):
        campaign(tmp_path, [replace(r, frequency_hz=2 * counted)])


def test_spikes_are_said(tmp_path, record):
    r = record(noise_N=0.01)
    force = r.force_N.copy()
    force[700] = 60.0
    (test,) = campaign(tmp_path, [replace(r, force_N=force)]).tests
    assert any("1 spike(s) in the force" in w and f"{r.time_s[700]:.6g} s" in w for w in test.warnings)


def test_a_coarsely_rounded_time_column_is_fixed_by_the_sample_rate(folder, toml, record, csv):
    r = record()
    rounded = replace(r, time_s=np.round(r.time_s, 3))  # steps of 0.78 ms written as 0 or 1 ms
    text = csv(rounded)
    with pytest.raises(CampaignError, match="time does not increase"):
        read_campaign(folder(toml, {"test.csv": text}))
    stated = toml.replace("[[test]]", "sample_rate_hz = 1280\n\n[[test]]")
    (test,) = read_campaign(folder(stated, {"test.csv": text})).tests
    np.testing.assert_allclose(test.time_s, r.time_s, atol=1e-12)
    # but not where samples are missing: then the column is what tells
    keep = np.r_[0:700, 760 : r.time_s.size]
    gappy = replace(r, time_s=r.time_s[keep], displacement_mm=r.displacement_mm[keep], force_N=r.force_N[keep])
    (test,) = read_campaign(folder(stated, {"test.csv": csv(gappy)})).tests
    np.testing.assert_allclose(test.time_s, gappy.time_s, atol=1e-9)
    assert any("gap" in w for w in test.warnings)


@pytest.mark.parametrize("end", [False, True])
def test_a_part_of_much_smaller_motion_is_said(record, end):
    """A displacement whose gain was switched: a tenth of the motion is no cycle of the other's."""
    r = record(n_cycles=9.4)
    late = r.time_s > r.time_s[-1] * (0.8 if end else 0.2)
    values = np.where(late == end, 0.1, 1.0) * r.displacement_mm
    checked, _ = check_record(replace(r, displacement_mm=values))
    assert any("is not used" in w and "gain that was switched" in w for w in checked.warnings)
