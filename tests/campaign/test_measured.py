"""Real and shipped campaigns: they read, and what comes out is what their plots show."""

from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign

ROOT = Path(__file__).parents[2]


def dissipated(loop):
    """Energy a cycle in N mm, from the averaged loop."""
    return float(np.mean(loop.force_N * loop.velocity_m_s)) * 1e3 / loop.frequency_hz


def test_rope_spring():
    campaign = read_campaign(ROOT / "data" / "rope_spring")
    loops = campaign.loops()
    assert [(round(p.frequency_hz), round(p.amplitude_mm, 1)) for p in loops] == [
        (f, a) for f in (10, 15, 20) for a in (0.3, 0.6, 1.0)
    ]
    for loop in loops:
        assert loop.record.warnings == () and loop.n_cycles == 38 and len(loop.block_cycle) == 6
        assert loop.frequency_hz == pytest.approx(loop.record.frequency_hz, rel=1e-5)
        # white noise of about 0.6 % of the force, averaged over 38 cycles, is what the harmonics should show
        noise = np.median(loop.force_scatter_N)
        assert 0.004 < noise / np.std(loop.force_N) < 0.008
        n = loop.averager.index.size
        white = noise * np.sqrt(2 / n)
        assert 0.6 < np.median(loop.noise_N[1:9]) / white < 1.5
    # steady: the blocks scatter about their mean as their own noise says they should
    z = [(p.block_harmonics_N - p.harmonics_N)[:, 1:20] / p.block_noise_N[:, 1:20] / np.sqrt(5 / 6) for p in loops]
    assert 0.85 < np.sqrt(np.mean(np.abs(z) ** 2) / 2) < 1.15


@pytest.mark.shared
def test_shipped_copies_are_the_shared_ones(measured):
    for name in ("rope_spring", "rope_spring_accelerometer"):
        theirs, ours = measured(name), read_campaign(ROOT / "data" / name)
        for a, b in zip(theirs.tests, ours.tests, strict=True):
            np.testing.assert_array_equal(a.force_N, b.force_N)
            np.testing.assert_array_equal(a.displacement_mm, b.displacement_mm)


@pytest.mark.shared
def test_microtribometer(measured):
    (loop,) = measured("microtribometer").loops()
    assert any("gap" in w for w in loop.record.warnings)
    assert loop.n_cycles >= 45
    first, last = loop.record.time_s[loop.cut.index[[0, -1]]]
    assert first > 9 and last < 209  # it rests before and after
    assert loop.frequency_hz == pytest.approx(0.25, rel=1e-3)
    # it stands still at both ends: away from the corners the velocity there is small against the stroke's
    held = np.abs(loop.displacement_mm) > 0.985 * loop.amplitude_mm
    assert held.mean() > 0.4
    assert np.median(np.abs(loop.velocity_m_s[held])) < 0.02 * np.abs(loop.velocity_m_s).max()
    # the energy of the averaged loop is that of the record, cycle by cycle
    u, force = loop.record.displacement_mm[loop.cut.index], loop.record.force_N[loop.cut.index]
    work = np.sum((force[1:] + force[:-1]) / 2 * np.diff(u)) / loop.n_cycles
    assert dissipated(loop) == pytest.approx(work, rel=0.01)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["mr_damper_off", "mr_damper_half"])
def test_magnetorheological_damper(name, measured):
    loops = measured(name).loops()
    assert len(loops) == 6
    for loop in loops:
        # ramps at both ends are out: what is left repeats to a thousandth of the stroke
        index = loop.cut.index
        peaks = [
            np.abs(loop.record.displacement_mm[index][np.floor(loop.averager.phase) == c]).max()
            for c in loop.cut.cycles
        ]
        assert np.ptp(peaks) < 0.01 * loop.amplitude_mm
        assert loop.cut.constant and loop.n_cycles >= 3
        assert dissipated(loop) > 0.5 * 4 * loop.amplitude_mm * np.std(loop.force_N)  # a fat loop
        assert np.max(loop.noise_N[1:6]) < 0.02 * np.abs(loop.harmonics_N[1])


@pytest.mark.shared
def test_pneumatic_seal(measured):
    loops = measured("pneumatic_seal").loops()
    assert len(loops) == 7
    for loop in loops:
        assert any("gap" in w for w in loop.record.warnings) and any("irregular" in w for w in loop.record.warnings)
        assert loop.n_cycles >= 7
        assert 18 < loop.amplitude_mm < 22 and 15 < loop.offset_mm < 19
        # triangles: outside the corners each stroke has one speed
        up = (loop.phase < 0.2) | (loop.phase > 0.85)
        assert np.std(loop.velocity_m_s[up]) < 0.1 * np.mean(loop.velocity_m_s[up])
    assert sum(not p.cut.constant for p in loops) >= 5  # driven by hand or by air: the speed wanders
    # pressure raises friction
    friction = {p.extras["pressure_bar"]: dissipated(p) for p in loops}
    assert friction[1.0] < friction[2.0] < friction[4.0] < friction[6.0]
    # the stated frequency of three tests counts samples as if their clock were even; the time column rules
    said = [p.file for p in loops if any("even" in w and "is used" in w for w in p.record.warnings)]
    assert said == ["p2bar.csv", "p4bar.csv", "p6bar.csv"]


@pytest.mark.shared
def test_cycloidal_actuator(measured):
    """Play crossed quickly both ways was refused as a return that spoils energy, its coarse steps as a dead channel."""
    four, forty = measured("cycloidal_actuator").loops()
    assert (four.n_cycles, forty.n_cycles) == (4, 2)
    u, force = four.record.displacement_mm[four.cut.index], four.record.force_N[four.cut.index]
    own = 0.5 * float(np.sum((force[1:] + force[:-1]) * np.diff(u))) / 4
    area = 0.5 * float(np.sum(four.force_N * (np.roll(four.displacement_mm, -1) - np.roll(four.displacement_mm, 1))))
    assert area == pytest.approx(own, rel=0.02)
