"""An amplifier's limit is told from a specimen that yields, slides, or is recorded coarsely."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.loops.checks import check_record
from bayes_iwan.campaign.loops.clipping import limits_of_loops, said_of

AMPLITUDES = (0.5, 1.0, 1.5)


def sliding(amplitude, level, stiffness=60.0, spring=0.0, rate=1280.0, frequency=10.0, cycles=10):
    """Force of an element that sticks, then slides at one force, on a sine."""
    t = np.arange(int(cycles * rate / frequency)) / rate
    u = amplitude * np.sin(2 * np.pi * frequency * t)
    z = np.zeros_like(u)
    for i in range(1, u.size):
        z[i] = np.clip(z[i - 1] + stiffness * (u[i] - u[i - 1]), -level, level)
    return t, u, z + spring * u


def campaign_of(record, forces):
    records = []
    for a, (t, u, f) in zip(AMPLITUDES, forces, strict=True):
        r = record(amplitude_mm=a, file=f"a{a:g}.csv", time_s=t)
        records.append(replace(r, displacement_mm=u, force_N=f))
    loops = [check_record(r)[1] for r in records]
    return limits_of_loops(records, loops)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_sliding_at_one_force_is_not_clipped(record, noise):
    rng = np.random.default_rng(0)
    forces = [sliding(a, 5.0) for a in AMPLITUDES]
    assert not campaign_of(record, [(t, u, f + noise * rng.standard_normal(f.size)) for t, u, f in forces])


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_levels_that_differ_with_amplitude_are_a_specimen_s(record, noise):
    """Clipped shapes, each at its own level."""
    rng = np.random.default_rng(0)
    out = []
    for a in AMPLITUDES:
        t, u, f = sliding(a, 5.0, stiffness=20.0, spring=6.0)
        out.append((t, u, np.clip(f, -0.6 * f.max(), 0.6 * f.max()) + noise * rng.standard_normal(f.size)))
    assert not campaign_of(record, out)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_one_level_in_every_test_that_reaches_it_is_clipped(record, noise):
    rng = np.random.default_rng(0)
    out = []
    for a in AMPLITUDES:
        t, u, f = sliding(a, 5.0, stiffness=20.0, spring=6.0)
        out.append((t, u, np.clip(f, -8.5, 8.5) + noise * rng.standard_normal(f.size)))
    found = campaign_of(record, out)
    assert {x.file for x in found} == {"a1.csv", "a1.5.csv"}
    assert all(x.channel == "force" and abs(x.level) == pytest.approx(8.5, abs=0.1) for x in found)


def test_a_force_in_coarse_steps_is_not_clipped(record):
    """A flat top of one recorded value, as a recorder with steps of a fiftieth of the range makes it."""
    out = [(t, u, np.round(f / 0.25) * 0.25) for t, u, f in (sliding(a, 5.05, spring=0.4) for a in AMPLITUDES)]
    assert not campaign_of(record, out)


def test_a_displacement_that_dwells_at_its_ends_is_not_clipped(record):
    out = []
    for a in AMPLITUDES:
        t, u, f = sliding(1.3 * a, 5.0, spring=2.0)
        out.append((t, np.clip(u, -a, a), f))
    assert not [x for x in campaign_of(record, out) if x.channel == "displacement"]


@pytest.mark.parametrize("after", [0.0, 0.005])
def test_one_test_tells_where_noise_stops_or_the_top_outlasts_the_turn(record, after):
    """A loop clipped at half its height, and noise before the amplifier or behind it."""
    rng = np.random.default_rng(1)
    r = record(noise_N=0.002, rate_hz=1273.0)
    level = 0.5 * float(r.force_N.max())
    clipped = np.clip(r.force_N, -level, level) + after * rng.standard_normal(r.force_N.size)
    r = replace(r, force_N=clipped)
    found = limits_of_loops([r], [check_record(r)[1]])
    assert {x.side for x in found} == {1, -1}
    assert all(x.quiet == (after == 0.0) for x in found)


def test_a_top_that_outlasts_the_turn_by_a_fiftieth_of_the_stroke_is_clipped(record):
    """At nine tenths of the height: 8 % of the energy was lost without a word."""
    r = record(rate_hz=610.0)
    force = np.sin((p := 2 * np.pi * (10.0 * r.time_s + 0.37)) + 0.5) + 0.15 * np.sin(3 * (p + 0.5))
    force = np.clip(force, -0.9 * force.max(), 0.9 * force.max())
    r = replace(r, force_N=10 * force + 0.02 * np.random.default_rng(1).standard_normal(force.size))
    assert {x.side for x in limits_of_loops([r], [check_record(r)[1]])} == {1, -1}


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.02, 0.1])
def test_one_loop_that_curves_or_slides_is_not_clipped(record, noise):
    rng = np.random.default_rng(2)
    for force in (sliding(1.0, 5.0)[2], record(n_cycles=10).force_N):
        r = record(time_s=sliding(1.0, 5.0)[0], start=0.0)
        r = replace(r, force_N=force + noise * rng.standard_normal(force.size))
        assert not limits_of_loops([r], [check_record(r)[1]])


def test_a_simulated_slider_under_a_drive_that_wanders_is_not_clipped(record):
    """Its plateau is one number, and its cycles differ: that is no noise."""
    t = np.arange(1280) / 1280.0
    u = (1.0 + 0.01 * np.sin(2 * np.pi * 0.7 * t)) * np.sin(2 * np.pi * 10 * t + 0.05 * np.sin(2 * np.pi * 1.3 * t))
    z = np.zeros_like(u)
    for i in range(1, u.size):
        z[i] = np.clip(z[i - 1] + 60.0 * (u[i] - u[i - 1]), -5.0, 5.0)
    r = replace(record(time_s=t), displacement_mm=u, force_N=z)
    assert not limits_of_loops([r], [check_record(r)[1]])


@pytest.mark.parametrize("angle", [0.1, 0.5, 0.8, 1.2])  # with 0.5 the level ends where the motion turns
@pytest.mark.parametrize("at, lowest", [(0.87, -0.87), (0.95, -1.0)])
def test_an_ellipse_that_is_cut_off_is_clipped(record, angle, at, lowest):
    """5.6 % of the energy was lost without a word."""
    r = record(time_s=np.arange(2000) / 1300.0)
    p = 2 * np.pi * 10.0 * r.time_s
    r = replace(r, displacement_mm=np.sin(p), force_N=np.clip(np.sin(p + angle), lowest, at))
    found = limits_of_loops([r], [check_record(r)[1]])
    assert [x.side for x in found] == ([1, -1] if lowest == -at else [1])


@pytest.mark.parametrize("digits", [2, 9])
@pytest.mark.parametrize("corners", [False, True])
def test_a_slider_alone_is_not_clipped(record, digits, corners):
    t, u, f = sliding(1.0, 5.0, stiffness=60.0)
    if corners:
        u, f = 2 / np.pi * np.arcsin(u), np.zeros_like(f)
        for k in range(1, f.size):
            f[k] = np.clip(f[k - 1] + 40.0 * (u[k] - u[k - 1]), -5.0, 5.0)
    r = replace(record(time_s=t), displacement_mm=u, force_N=np.round(f, digits))
    assert not limits_of_loops([r], [check_record(r)[1]])


def _spring_and_slider(u, spring):
    z = np.zeros_like(u)
    for k in range(1, u.size):
        z[k] = np.clip(z[k - 1] + 60.0 * (u[k] - u[k - 1]), -5.0, 5.0)
    return z + spring * u


@pytest.mark.parametrize("rate", [1000.0, 983.0])
@pytest.mark.parametrize("dwell", [0.0, 0.1, 0.3, 0.6])
@pytest.mark.parametrize("spring", [0.0, 2.0])
def test_nothing_is_said_of_a_triangle_or_trapezoid(record, rate, dwell, spring):
    """One test, no noise: displacement and force stay at their highest values while the drive dwells."""
    t = np.arange(int(2 * rate)) / rate
    u = np.clip((4 * np.abs((5.0 * t + 0.88) % 1.0 - 0.5) - 1) / (1 - dwell), -1, 1)
    r = replace(record(frequency_hz=5.0, time_s=t), displacement_mm=u, force_N=_spring_and_slider(u, spring))
    assert not limits_of_loops([r], [check_record(r)[1]])


@pytest.mark.parametrize("spring", [0.0, 2.0])
@pytest.mark.parametrize("limit", [0.5, 0.8, 0.95])
def test_a_displacement_that_is_clipped_is_said_in_one_line(record, spring, limit):
    """The force goes on while the displacement stays."""
    t = np.arange(2000) / 983.0
    u = np.sin(2 * np.pi * 5.0 * t)
    r = replace(record(frequency_hz=5.0, amplitude_mm=limit, time_s=t), force_N=_spring_and_slider(u, spring))
    r = replace(r, displacement_mm=np.clip(u, -limit, limit))
    (line,) = said_of(limits_of_loops([r], [check_record(r)[1]]))
    assert f"displacement may be clipped at {limit:g} and -{limit:g} mm" in line


@pytest.mark.parametrize("level", [0.72, 0.9, 0.97])
def test_a_code_near_the_force_is_said_to_be_a_limit(record, level):
    """Four times the force, at both ends: as a WAV file's full scale. Found by fuzz_planted.py (seed 17, 727)."""
    p = 2 * np.pi * 5.0 * (t := np.arange(400) / 213.0)
    force = np.sin(p + 0.4)
    force = np.where(np.abs(force) > level, 4 * np.sign(force), force)
    r = replace(record(frequency_hz=5.0, time_s=t), displacement_mm=np.sin(p), force_N=force)
    assert {x.side for x in limits_of_loops([r], [check_record(r)[1]])} == {1, -1}
