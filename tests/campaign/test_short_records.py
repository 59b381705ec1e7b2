"""Few cycles: what was before the record, corners under noise, a plateau at its start, and tests of one staircase."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError, Record, average
from bayes_iwan.campaign.folders.inspect import inspect_loop
from bayes_iwan.campaign.loops.between_tests import compared
from bayes_iwan.campaign.loops.checks import check_record


def triangle(phase):
    return 1 - 4 * np.abs((phase + 0.25) % 1 - 0.5)


def sine(phase):
    return np.sin(2 * np.pi * phase)


def plateaus(phase):
    return np.clip(2 * triangle(phase), -1, 1)


def friction(u, slip=50.0, stiffness=90.0, spring=2.0, state=0.0):
    """One slider beside a spring along a motion (n,) that begins with the slider at `state` N."""
    force, z, before = np.empty(u.size), state, u[0]
    for i, x in enumerate(u):
        z, before = min(max(z + stiffness * (x - before), -slip), slip), x
        force[i] = z + spring * x
    return force


def energy(u, f):
    return float(np.sum(0.5 * f * (np.roll(u, -1) - np.roll(u, 1))))


def recorded(wave, cycles, start=0.0, samples=100, noise=0.0, rest=True, amplitude=1.0, state=0.0, seed=0):
    """A record of so many cycles, from rest or from a specimen that moved so before; 1 Hz."""
    rng = np.random.default_rng(seed)
    phase = start + np.arange(round(cycles * samples)) / samples
    fine = start + np.arange((phase.size - 1) * 20 + 1) / (20 * samples)
    before = np.empty(0) if rest else start - 2 + np.arange(2 * 20 * samples) / (20 * samples)
    f = friction(amplitude * wave(np.concatenate([before, fine])), state=state)[before.size :][::20]
    u = amplitude * wave(phase) + noise * rng.standard_normal(phase.size)
    f = f + 50 * noise * rng.standard_normal(phase.size)
    return Record("a.csv", 1.0, amplitude, "fit", {}, np.arange(phase.size) / samples, u, f)


@pytest.mark.parametrize("wave", [sine, triangle, plateaus])
@pytest.mark.parametrize("cycles", [2, 3, 4, 5])
def test_the_first_quarter_cycle_from_rest_is_left_out(wave, cycles):
    checked, loop = check_record(recorded(wave, cycles))
    steady = average(recorded(wave, 8, rest=False))
    expected = energy(steady.displacement_mm, steady.force_N)
    assert energy(loop.displacement_mm, loop.force_N) == pytest.approx(expected, rel=0.015)
    seen = inspect_loop(loop)
    assert seen.energy_mJ.value == pytest.approx(inspect_loop(steady).energy_mJ.value, rel=0.01)
    assert np.ptp(seen.energy_by_cycle_mJ) < 0.02 * expected
    assert loop.amplitude_mm == pytest.approx(1, abs=0.01)
    assert any("run-in" in x or "what was before" in x for x in checked.warnings)


@pytest.mark.parametrize("cycles", [5, 6])
def test_rows_lost_in_few_cycles_are_found_though_the_time_runs_on(cycles):
    """A quarter of a cycle is missing: the frequency would be 5 % too high."""
    whole = recorded(sine, cycles, rest=False, noise=1e-3)
    kept = np.delete(np.arange(whole.time_s.size), np.arange(230, 255))
    lost = replace(
        whole,
        time_s=whole.time_s[: kept.size],
        displacement_mm=whole.displacement_mm[kept],
        force_N=whole.force_N[kept],
    )
    with pytest.raises(CampaignError, match=r"jumps by \+[89]\d° near 2\.\d+ s, but the times do not"):
        check_record(lost)
    check_record(whole)


@pytest.mark.parametrize("cycles", [3, 4, 5])
def test_a_force_whose_size_changes_within_few_cycles_is_said(cycles):
    record = recorded(sine, cycles + 0.3, rest=False)
    steady, _ = check_record(record)
    assert not any("while the drive holds" in w for w in steady.warnings)
    gain = np.where(record.time_s < 0.6 * cycles, 1.0, 2.0)
    switched, _ = check_record(replace(record, force_N=gain * record.force_N))
    assert any("the force's amplitude" in w and "while the drive holds" in w for w in switched.warnings)


def test_without_a_clock_no_mains_are_near_the_drive_s_frequency():
    record = recorded(sine, 6)
    fading = replace(record, force_N=(1 - 0.05 * record.time_s) * record.force_N)
    (with_clock,), (without,) = (
        [w for w in check_record(replace(fading, clock=clock))[0].warnings if "while the drive holds" in w]
        for clock in (True, False)
    )
    assert "or mains interference near" in with_clock and "mains" not in without and "or a gain that drifts" in without


def test_a_specimen_that_moved_before_loses_nothing():
    checked, loop = check_record(recorded(sine, 3, rest=False, noise=1e-3))
    assert loop.n_cycles == 3 and loop.cut.late == 0.0 and not checked.warnings


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.01])
def test_a_triangle_keeps_its_amplitude_under_noise(noise):
    found = [average(recorded(triangle, 4, rest=False, noise=noise, seed=k)).amplitude_mm for k in range(8)]
    assert np.mean(found) == pytest.approx(1, abs=1e-3 + noise)


def test_noise_alone_makes_no_corners():
    assert not any(average(recorded(sine, 4, rest=False, noise=0.02, seed=k)).corners for k in range(20))


@pytest.mark.parametrize("start", [0.25, 0.75])
def test_a_record_that_begins_on_a_plateau_has_its_own_period(start):
    assert average(recorded(plateaus, 4, start=start, rest=False)).frequency_hz == pytest.approx(1, rel=5e-3)


def told(amplitudes, late=None):
    """What the tests of one specimen say of each other, one of them with a force that is late by 40°."""
    records = [recorded(sine, 6, rest=False, amplitude=a, noise=1e-4, seed=k) for k, a in enumerate(amplitudes)]
    records = [Record(f"{k}.csv", *[getattr(r, x) for x in FIELDS]) for k, r in enumerate(records)]
    if late is not None:
        r = records[late]
        f = np.interp(r.time_s - 40 / 360, r.time_s, r.force_N, period=6.0)
        records[late] = Record(r.file, 1.0, r.amplitude_mm, "fit", {}, r.time_s, r.displacement_mm, f)
    return [" ".join(x.warnings) for x in compared(records, [average(r) for r in records])]


FIELDS = ("frequency_hz", "amplitude_mm", "role", "extras", "time_s", "displacement_mm", "force_N")


def test_friction_s_own_bend_of_the_loss_angle_is_no_delay():
    assert not any("lags" in x or "leads" in x for x in told((0.5, 1.0, 1.5, 2.0, 3.0)))
    found = told((0.7, 1.0, 1.5, 2.0, 3.0, 4.0), late=3)
    assert "lags" in found[3] and not any("lags" in x for k, x in enumerate(found) if k != 3)


def test_contacts_that_hardly_slip_at_the_smallest_amplitude_are_no_delay():
    assert not any("lags" in x for x in told((0.4, 1.0, 2.0, 3.0)))


def test_what_is_left_of_estimating_one_frequency_makes_no_test_late():
    """The loss angles of a lead-rubber bearing at five amplitudes: a bend, and frequencies that differ by 2e-5. A plane
    through these said "leads by 47° more than the other tests"."""
    t = np.arange(600) / 100
    off, angles = (2e-6, 4e-6, -2e-5, 0.0, 0.0), np.radians((23.8, 46.8, 53.1, 49.5, 42.3))
    records, loops = [], []
    for k, (amplitude, angle) in enumerate(zip((10.0, 25.0, 50.0, 80.0, 120.0), angles)):
        u, force = amplitude * np.sin(2 * np.pi * t), 50 * np.sin(2 * np.pi * t + angle)
        records.append(Record(f"{k}.csv", 1.0, amplitude, "fit", {}, t, u, force))
        loops.append(replace(average(records[-1]), frequency_hz=1.0 + off[k]))
    assert not any("leads" in w or "lags" in w for x in compared(records, loops) for w in x.warnings)
