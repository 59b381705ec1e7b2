"""Periodic drives that are no sine are tests like any other; few cycles are counted; staircases become tests."""

import shlex
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import sawtooth

from bayes_iwan import cli
from bayes_iwan.campaign import CampaignError, Record
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests
from bayes_iwan.campaign.loops.averaging import average
from bayes_iwan.campaign.loops.checks import check_record
from bayes_iwan.campaign.timing.displacement_drift import straight_drift, without_drift
from bayes_iwan.campaign.timing.drive import split_levels
from bayes_iwan.campaign.timing.period import short_period, whole_period

TAU = 2 * np.pi
RATE, BASE = 500.0, 2.0


def multisine(*orders):
    return lambda p: sum(np.sin(TAU * k * p + k * k) for k in orders)


WAVES = {
    "multisine 1 2 3 5": multisine(1, 2, 3, 5),
    "no fundamental": multisine(3, 4, 5),
    "sparse": multisine(5, 7, 11),
    "narrow 7 8 9": multisine(7, 8, 9),  # like a tone that beats: 12 % from one crossing to the next
    "narrow 3 4": multisine(3, 4),
    "swings little for a while": multisine(9, 10),  # which was a pause
    "strong third": lambda p: np.sin(TAU * p) + 2.0 * np.sin(3 * TAU * p + 0.3),
    "third 0.6": lambda p: np.sin(TAU * p) + 0.6 * np.sin(3 * TAU * p),
    "second": lambda p: np.sin(TAU * p) + 0.8 * np.sin(2 * TAU * p + 1.0),
    "triangle": lambda p: sawtooth(TAU * p, 0.5),
    "trapezoid": lambda p: np.clip(1.8 * sawtooth(TAU * p + np.pi / 2, 0.5), -1.0, 1.0),
}


def slider(u, stiffness=40.0, slip=12.0):
    """Force of one elastic slider beside a spring, N."""
    out, force = np.empty(u.size), 0.0
    for k, du in enumerate(np.diff(u, prepend=u[0])):
        force = float(np.clip(force + stiffness * du, -slip, slip))
        out[k] = force
    return out + 5.0 * u


def recorded(wave, cycles, noise=0.002):
    """A record of so many periods after one that was not recorded, and its amplitude."""
    n, skip = round(cycles * RATE / BASE), round(RATE / BASE)
    u = wave(BASE * np.arange(-skip, n) / RATE)
    u = u / (np.ptp(u) / 2)
    force = slider(u)[skip:]
    rng = np.random.default_rng(0)
    u = u[skip:] + noise * rng.standard_normal(n)
    return Record("a.csv", BASE, 1.0, "fit", {}, np.arange(n) / RATE, u, force + 20 * noise * rng.standard_normal(n))


@pytest.mark.parametrize("value", [0.9, 3.0])
def test_a_spike_makes_no_two_cycles_of_one(value):
    """Found by fuzz_planted.py (seed 1, 1147): a bit that flipped gave half the frequency and twice the energy."""
    record = recorded(lambda p: np.sin(TAU * p), 11.4)
    record.displacement_mm[1880] = value * -np.sign(record.displacement_mm[1880])
    _, loop = check_record(record)
    assert loop.frequency_hz == pytest.approx(BASE, rel=1e-3)


@pytest.mark.parametrize("orders", [(1, 2, 3, 5, 7), (1, 2, 4, 8)])
def test_a_multisine_is_imported_with_its_amplitude(tmp_path, orders):
    """Its name had the amplitude of eight harmonics, which the test's own check then contradicted."""
    phase, time = np.random.default_rng(0).uniform(0.0, TAU, 9), np.arange(2200) / 1000.0
    u = sum(np.sin(TAU * 5.0 * k * time + phase[k]) for k in orders)
    u /= np.ptp(u) / 2
    path = tmp_path / "a.csv"
    rows = (f"{t:.4f},{x:.5f},{f:.4f}" for t, x, f in zip(time, u, slider(u)))
    path.write_text("time_s,disp_mm,force_N\n" + "\n".join(rows) + "\n")
    (test,) = import_tests([path])
    assert test.record.amplitude_mm == pytest.approx(1.0, rel=0.01)
    assert test.loop.frequency_hz == pytest.approx(5.0, rel=1e-3)


@pytest.mark.parametrize("name", WAVES)
def test_a_periodic_drive_is_a_test(name):
    record, loop = check_record(recorded(WAVES[name], 12.0))
    assert loop.frequency_hz == pytest.approx(BASE, rel=2e-4) and loop.n_cycles >= 10
    n = round(RATE / BASE)
    whole = slice(record.time_s.size % n + n, None)
    u, force = record.displacement_mm[whole], record.force_N[whole]
    energy = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(u))) / ((u.size - 1) / n)
    found = float(np.mean(loop.force_N * loop.velocity_m_s)) * 1e3 / loop.frequency_hz
    assert found == pytest.approx(energy, rel=0.02)
    assert not any(x in w for w in record.warnings for x in ("phase wanders", "frequency drifts", "amplitude varies"))


@pytest.mark.parametrize("cycles", [2, 3, 4])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_cycles_cut_at_the_crossings_are_counted(cycles, noise):
    _, loop = check_record(recorded(lambda p: np.sin(TAU * p), cycles, noise))
    assert loop.n_cycles == cycles and loop.frequency_hz == pytest.approx(BASE, rel=1e-3)


@pytest.mark.parametrize("cycles", [2, 3, 4, 7, 10])
@pytest.mark.parametrize("one_speed", [False, True])
def test_a_staircase_gives_a_test_a_level(cycles, one_speed):
    u = []
    for size in (0.5, 1.0, 1.5, 2.0, 3.0):
        n = round(100 * (size if one_speed else 1.0))
        u.append(size * np.sin(TAU * np.arange(cycles * n) / n))
    u = np.concatenate(u)
    record = Record("s.csv", 1.0, 1.0, "fit", {}, np.arange(u.size) / 10.0, u, slider(u))
    pieces, dropped = split_levels(record)
    assert [p.amplitude_mm for p in pieces] == pytest.approx([0.5, 1.0, 1.5, 2.0, 3.0], rel=0.01) and not dropped


@pytest.mark.parametrize("cycles, pause_s", [(2, 0.0), (3, 0.5), (4, 1.7), (3, 0.08), (4, 0.04), (2, 0.1)])
def test_a_staircase_of_small_levels_and_with_pauses_between_them(cycles, pause_s):
    """Five levels from a fifth of the largest on were a drift; pauses were a sweep in frequency."""
    rng = np.random.default_rng(1)
    sizes = (0.2, 0.4, 0.6, 0.8, 1.0)
    parts = [[a * np.sin(TAU * np.arange(cycles * 100) / 100), np.zeros(round(500 * pause_s))] for a in sizes]
    u = np.concatenate([x for part in parts for x in part])
    noisy = u + 2e-4 * rng.standard_normal(u.size)
    pieces, _ = split_levels(Record("s.csv", 1.0, 1.0, "fit", {}, np.arange(u.size) / 500.0, noisy, slider(u)))
    assert [p.amplitude_mm for p in pieces] == pytest.approx(sizes, rel=0.01)
    assert [p.frequency_hz for p in pieces] == pytest.approx([5.0] * 5, rel=0.02)
    assert all(len(p.time_s) >= (cycles - 1) * 99 for p in pieces)


@pytest.mark.parametrize(
    "cycles, pause_s, clock", [(2.5, 0.0, True), (2.5, 0.3, False), (2.25, 0.0, False), (3.25, 0.3, True)]
)
def test_levels_that_start_anew_are_split_by_amplitude(tmp_path, cycles, pause_s, clock):
    """Where they ended within a cycle, every third cycle was longer: a sweep in frequency."""
    sizes = (0.2, 0.4, 0.6, 0.8, 1.0)
    parts = [[a * np.sin(TAU * np.arange(round(100 * cycles)) / 100), np.zeros(round(500 * pause_s))] for a in sizes]
    u = np.concatenate([x for part in parts for x in part])
    path = tmp_path / "a.csv"
    table = np.column_stack([u, slider(u)])
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header="disp_mm,force_N", comments="")
    recipe = Recipe(sample_rate_hz=500.0 if clock else "none")
    with pytest.raises(ImportAsks, match=r"a staircase of 5 levels .*--split"):
        import_tests([path], recipe)
    tests = import_tests([path], recipe, split=True)
    assert [t.loop.amplitude_mm for t in tests] == pytest.approx(sizes, rel=0.005)
    assert not clock or [t.loop.frequency_hz for t in tests] == pytest.approx([5.0] * 5, rel=1e-3)


def test_levels_of_less_than_two_cycles_are_refused_at_once(tmp_path):
    """--split was proposed, and then refused."""
    u = np.concatenate([a * np.sin(TAU * np.arange(150) / 100) for a in (0.4, 0.7, 1.0)])
    path = tmp_path / "a.csv"
    np.savetxt(path, np.column_stack([u, slider(u)]), delimiter=",", header="disp_mm,force_N", comments="")
    with pytest.raises(CampaignError, match=r"none of 3 levels can be used.* at least two are needed"):
        import_tests([path], Recipe(sample_rate_hz=500.0))


@pytest.mark.parametrize("amplitudes", [0.0, 0.9, 2.0, 6.0, -3.0])
def test_a_straight_drift_is_taken_off(amplitudes):
    record = recorded(lambda p: np.sin(TAU * p), 20.3)
    line = amplitudes * record.time_s / record.time_s[-1]
    level, _, said = without_drift(record.time_s, record.displacement_mm + line)
    assert bool(said) == (amplitudes != 0.0)
    np.testing.assert_allclose(level - level.mean(), record.displacement_mm - record.displacement_mm.mean(), atol=0.01)


def columns(path, **values):
    rows = zip(*values.values())
    path.write_text(",".join(values) + "\n" + "".join(",".join(f"{x:.7g}" for x in row) + "\n" for row in rows))
    return str(path)


def test_all_that_is_missing_is_asked_at_once(tmp_path, capsys, monkeypatch):
    """One message with the complete command; with the blanks filled in, that command works, and so does --ask."""
    r = recorded(lambda p: np.sin(TAU * p), 9.3)
    file = columns(tmp_path / "run 1.csv", ai0=r.displacement_mm, ai1=r.force_N)
    with pytest.raises(ImportAsks) as caught:
        import_tests([file])
    asked = {(q.option, q.role) for q in caught.value.questions}
    assert asked == {
        ("--force", ""), ("--displacement", ""), ("--unit", "force"), ("--unit", "displacement"), ("--sample-rate", "")
    }  # fmt: skip
    assert cli.main(["import", file, "--dry-run"]) == 2
    command = capsys.readouterr().err.strip().partition("Run: ")[2]
    assert command.startswith(f'bayes-iwan import "{file}" --dry-run ') and "'" not in command
    assert cli.main(shlex.split(command)[1:]) == 2 and "'<hz>' is not a number" in capsys.readouterr().err
    answers = {"force": "ai1", "displacement": "ai0", "force=": "N", "displacement=": "mm", "rate": "500 Hz"}
    replies = [answers[{"--sample-rate": "rate"}.get(q.option, q.option[2:] if not q.role else q.role + "=")]
               for q in caught.value.questions]  # fmt: skip
    wrong = {"500 Hz": "fast", "mm": "metre per yard", "N": "mm", "ai0": "ai7"}  # are said, and asked again
    for right, first in wrong.items():
        replies.insert(replies.index(right), first)
    given = list(replies)
    monkeypatch.setattr("builtins.input", lambda prompt: replies.pop(0))
    assert cli.main(["import", file, "--dry-run", "--ask"]) == 0
    out = capsys.readouterr().out
    assert "--sample-rate: 'fast' is not a number" in out and "found: 2 Hz" in out
    assert "unit mm is no unit of force" in out and "no channel 'ai7' (displacement) among" in out
    (again,) = (line for line in out.splitlines() if "This asks no more" in line)
    assert cli.main(shlex.split(again.partition(": ")[2])[1:]) == 0
    assert "found: 2 Hz" in capsys.readouterr().out
    replies[:] = [*given[:5], ""]  # what was answered before somebody stops is in the command that is proposed
    assert cli.main(["import", file, "--dry-run", "--ask"]) == 2
    assert '--force ai1 --unit "force=N"' in capsys.readouterr().err
    assert cli.main(["import", file, "--dry-run"]) == 2, "what was answered once is no answer for the next command"


def test_an_example_of_a_sensitivity_is_no_answer(tmp_path, capsys):
    """The proposed command could be pasted as it stood: forces of somebody else's transducer."""
    r = recorded(lambda p: np.sin(TAU * p), 9.3)
    file = columns(tmp_path / "a.csv", t_s=r.time_s, x_mm=r.displacement_mm, F_V=r.force_N * 9.55e-3)
    assert cli.main(["import", file, "--dry-run"]) == 2
    command = capsys.readouterr().err.strip().partition("Run: ")[2]
    assert command.endswith('--sensitivity "force=<9.55 mV/N>"')
    assert cli.main(shlex.split(command)[1:]) == 2
    assert '"force=<9.55 mV/N>" is an example; write what is right' in capsys.readouterr().err
    with pytest.raises(CampaignError, match="is an example"):
        import_tests([file], Recipe(sensitivities={"force": "<9.55 mV/N>"}))


def test_a_sawtooth_is_no_integer_that_overflowed(tmp_path):
    r = recorded(lambda p: sawtooth(TAU * p), 9.3)
    file = columns(tmp_path / "a.csv", t_s=r.time_s, x_mm=r.displacement_mm, F_N=r.force_N)
    with pytest.raises(ValueError, match=r"^a.csv: 'x' jumps \d+ times .*a sawtooth, which no drive follows"):
        import_tests([file])


@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("share", [0.004, 0.008, 0.024, 0.1])
def test_a_jump_to_one_side_or_both_is_right_or_refused(share, both):
    """A flank of two samples gave 1.1 mm for 1 mm, two of three an energy 9 % off."""
    places, jumps = [0, share / 2, 0.5 - share / 2, 0.5 + share / 2, 1 - share / 2, 1], [0, 1, 0.8, -1, -0.8, 0]
    wave = (lambda p: np.interp(p % 1, places, jumps)) if both else (lambda p: sawtooth(TAU * p, 1 - share))
    record = recorded(wave, 12.3, noise=0.0)
    if share < 0.02:
        with pytest.raises(CampaignError, match=r"jumps faster than .* amplitude of 1.1\d* where samples show 1 mm"):
            check_record(record)
        return
    loop = average(check_record(record)[0], n_phase=512)
    u, force = (x[250 : 250 * 11 + 1] for x in (record.displacement_mm, record.force_N))
    energy = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(u))) / 10
    assert loop.amplitude_mm == pytest.approx(1.0, rel=0.005)
    area = 0.5 * float(np.sum(loop.force_N * (np.roll(loop.displacement_mm, -1) - np.roll(loop.displacement_mm, 1))))
    assert area == pytest.approx(energy, rel=0.012)


def test_a_channel_a_file_and_held_out_tests(tmp_path, capsys):
    r, s = (recorded(WAVES["third 0.6"], n) for n in (9.3, 8.3))
    for name, x in (("a", r), ("b", s)):
        (tmp_path / f"{name}_disp.txt").write_text("\n".join(f"{v:.6f}" for v in x.displacement_mm) + "\n")
        (tmp_path / f"{name}_load.txt").write_text("\n".join(f"{v:.6f}" for v in x.force_N) + "\n")
    recipe = Recipe(units={"displacement": "mm", "force": "N"}, sample_rate_hz=RATE)
    first, second = import_tests([tmp_path], recipe, held_out=["b_*"])
    np.testing.assert_allclose(first.record.force_N, r.force_N, atol=1e-6)
    np.testing.assert_allclose(second.record.displacement_mm, s.displacement_mm, atol=1e-6)
    assert (first.record.role, second.record.role) == ("fit", "held-out")


@pytest.mark.parametrize(("said", "newtons"), [("9,55 mV/N", 1.0), ("9.55 mV/N", 1.0)])
def test_a_decimal_comma_in_a_sensitivity(tmp_path, said, newtons):
    r = recorded(lambda p: np.sin(TAU * p), 9.3)
    file = columns(tmp_path / "a.csv", t_s=r.time_s, x_mm=r.displacement_mm, F_V=r.force_N * 9.55e-3)
    (test,) = import_tests([file], Recipe(sensitivities={"force": said}))
    np.testing.assert_allclose(test.record.force_N, newtons * r.force_N, rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="is the comma"):
        import_tests([file], Recipe(sensitivities={"force": "1,000 mV/N"}))


def test_a_force_that_beats_is_said(record):
    """4 % over nine cycles changes the energy by a percent, whatever the beat's length."""
    for beats in (0.7, 2.3, 4.6):
        r = record(n_cycles=9.4, noise_N=0.002)
        beat = 1.0 + 0.04 * np.sin(2 * np.pi * beats * np.linspace(0, 1, r.time_s.size) + 1.0)
        checked, _ = check_record(replace(r, force_N=r.force_N * beat))
        assert any("the force's amplitude" in w for w in checked.warnings), beats
    assert check_record(record(n_cycles=9.4, noise_N=0.05))[0].warnings == ()


def test_a_drive_that_beats_is_no_longer_period_without_a_word(tmp_path):
    t = np.arange(800) / 400.0
    u = (1.0 + 0.35 * np.sin(np.pi * 7.0 * t)) * np.sin(2 * np.pi * 7.0 * t)
    file = tmp_path / "a.csv"
    np.savetxt(file, np.column_stack([t, u, slider(u)]), delimiter=",", header="time_s,disp_mm,force_N", comments="")
    (test,) = import_tests([file])
    assert any("crosses its middle 2 times" in w for w in test.record.warnings)


def test_damaged_times_have_no_drift():
    """A gap so long that its cycles are no finite number."""
    time = np.arange(2000) / 1000.0
    time[1500:] += 3e307
    with np.errstate(all="ignore"):
        assert straight_drift(time, np.sin(20.0 * np.pi * np.arange(2000) / 1000.0)) == (0.0, 0.0)


@pytest.mark.parametrize(("harmonics", "fine"), [((1, 30), True), ((29, 31), True), ((1, 60), False)])
def test_a_multisine_of_high_harmonics_is_right_or_refused(harmonics, fine):
    """Its amplitude was 5 to 46 % too small, its levels a staircase."""
    time = np.arange(4.3 * 3000) / 3000
    u = sum(np.sin(TAU * h * time + h) for h in harmonics) / 2
    r = Record("a.csv", 1.0, 1.0 if fine else 0.5, "fit", {}, time, u, 20 * np.tanh(9 * u) + 4 * u)
    if fine:
        loop = check_record(r)[1]
        assert loop.amplitude_mm == pytest.approx(np.ptp(u) / 2, rel=0.005)
        assert loop.frequency_hz == pytest.approx(1.0, rel=1e-4)
        return
    with pytest.raises(CampaignError, match=r"% of the displacement is lost in averaging.* below 50 times its base"):
        check_record(r)


def test_a_cycle_as_long_as_its_record_has_no_period_and_no_traceback():
    time = np.arange(64) / 64
    assert short_period(time, np.sin(TAU * time), np.array([0.0, 0.97]), np.empty(0)) is None


@pytest.mark.parametrize("late", [1e9, 1e300])
def test_one_time_that_is_far_too_late_costs_no_more_than_its_cycle(late):
    """Found by fuzz.py (seed 17, import json 504): a traceback, or all memory."""
    t = np.arange(400) / 200.0
    t[-1] = late
    u = np.sin(2 * np.pi * 5.0 * np.arange(400) / 200.0)
    assert whole_period(t, u, t[:-1:40]) is None
