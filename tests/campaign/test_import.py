"""From files of a data-acquisition system to a campaign: scaled, named, checked, and equal to the truth."""

import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan import cli
from bayes_iwan.campaign import CampaignError, average, read_campaign
from bayes_iwan.campaign.importing import Layout, Recipe, import_tests, read_recipe, unit_texts, write_tests

DATA = Path(__file__).parents[2] / "data"
G = 9.80665


@pytest.fixture
def table(tmp_path):
    """table(name, {column: values}) writes a CSV file."""

    def write(name, columns):
        rows = "".join(",".join(f"{x:.10g}" for x in row) + "\n" for row in zip(*columns.values()))
        (tmp_path / name).write_text(",".join(columns) + "\n" + rows, encoding="utf-8")
        return tmp_path / name

    return write


@pytest.fixture
def volts(record):
    """A record of the paper's rig: an accelerometer of 105 mV/g and a force transducer of 9.55 mV/N, in volts."""

    def make(**changed):
        r = record(noise_N=0.002, **changed)
        w = 2 * np.pi * r.frequency_hz
        acceleration_g = -(w**2) * r.displacement_mm * 1e-3 / G
        return r, acceleration_g * 0.105 + 0.01, r.force_N * 9.55e-3

    return make


RIG = Recipe(
    channels={"acceleration": "ai0", "force": "ai1"},
    sensitivities={"acceleration": "105 mV/g", "force": "9.55 mV/N"},
    sample_rate_hz=1280,
)


def same_loop(loop, truth, share=1e-4, per_hz=1e-5):
    np.testing.assert_allclose(loop.displacement_mm, truth.displacement_mm, atol=share * truth.amplitude_mm)
    np.testing.assert_allclose(loop.force_N, truth.force_N, atol=share * np.abs(truth.force_N).max())
    assert loop.frequency_hz == pytest.approx(truth.frequency_hz, rel=per_hz)


@pytest.mark.parametrize("kind", ["csv", "tdms", "mat"])
def test_the_papers_rig_end_to_end(tmp_path, volts, table, kind):
    """Volts in a file, a campaign, its loops: equal to the loops of the motion and force that made the volts."""
    truths, files = [], []
    for f, a in ((10.0, 0.3), (15.0, 1.0)):
        r, v0, v1 = volts(frequency_hz=f, amplitude_mm=a, n_cycles=40.3)
        name = f"f{f:g}_a{a:g}.{kind}"
        if kind == "csv":
            table(name, {"ai0": v0, "ai1": v1})
        elif kind == "tdms":
            nptdms = pytest.importorskip("nptdms")
            with nptdms.TdmsWriter(tmp_path / name) as writer:
                said = {"unit_string": "V", "wf_increment": 1 / 1280}
                writer.write_segment([nptdms.ChannelObject("g", n, x, said) for n, x in (("ai0", v0), ("ai1", v1))])
        else:
            import scipy.io

            scipy.io.savemat(tmp_path / name, {"ai0": v0, "ai1": v1})
        files.append(tmp_path / name)
        truths.append(average(r))
    recipe = replace(RIG, sample_rate_hz=None) if kind == "tdms" else RIG
    write_tests(import_tests(files, recipe), tmp_path / "campaign")
    campaign = read_campaign(tmp_path / "campaign")
    text = (tmp_path / "campaign" / "campaign.toml").read_text()
    assert 'acceleration = "acceleration_m_s2"' in text and "sample_rate_hz = 1280" in text
    assert [(t.frequency_hz, round(t.amplitude_mm, 3)) for t in campaign.tests] == [(10.0, 0.3), (15.0, 1.0)]
    assert not any(t.warnings for t in campaign.tests)
    for loop, truth in zip(campaign.loops(), truths):
        same_loop(loop, truth)


def test_shipped_tests_survive_the_way_through_volts(tmp_path, table):
    """rope_spring as volts of a displacement sensor: the campaign's loops are the shipped ones, and their numbers."""
    shipped = read_campaign(DATA / "rope_spring")
    shipped = replace(shipped, tests=shipped.tests[::4])
    files = [
        table(t.file.removesuffix(".csv.gz") + ".txt", {"Weg": t.displacement_mm * 2.0, "Kraft": t.force_N * 9.55e-3})
        for t in shipped.tests
    ]
    recipe = Recipe(sensitivities={"displacement": "2 V/mm", "force": "9.55 mV/N"}, sample_rate_hz=1280)
    write_tests(import_tests(files, recipe), tmp_path / "campaign")
    back = read_campaign(tmp_path / "campaign")
    for loop, truth in zip(back.loops(), shipped.loops(), strict=True):
        same_loop(loop, truth, 1e-6)
        assert loop.record.frequency_hz == pytest.approx(truth.record.frequency_hz, rel=1e-3)


@pytest.mark.parametrize(
    ("unit", "per_N"),
    [("N", 1.0), ("kN", 1e-3), ("mN", 1e3), ("lbf", 1 / 4.4482216152605), ("lb", 1 / 4.4482216152605),
     ("kgf", 1 / G), ("kp", 1 / G), ("daN", 0.1), ("Newton", 1.0)],
)  # fmt: skip
def test_units_of_force(table, record, unit, per_N):
    r = record()
    path = table(
        "a.csv", {"time [ms]": r.time_s * 1e3, "Weg [in]": r.displacement_mm / 25.4, f"F [{unit}]": r.force_N * per_N}
    )
    (test,) = import_tests([path])
    np.testing.assert_allclose(test.record.force_N, r.force_N, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(test.record.displacement_mm, r.displacement_mm, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(test.record.time_s, r.time_s, atol=1e-9)


@pytest.mark.parametrize("unit", ["g", "m/s²", "m/s2", "m/s^2", "mm/s²", "in/s^2", "G"])
def test_units_of_acceleration(table, record, unit):
    r = record()
    size = {"g": G, "G": G, "mm/s²": 1e-3, "in/s^2": 0.0254}.get(unit, 1.0)
    a = -((2 * np.pi * 10) ** 2) * r.displacement_mm * 1e-3
    (test,) = import_tests([table("a.csv", {"t [s]": r.time_s, f"Beschl. [{unit}]": a / size, "Kraft [N]": r.force_N})])
    assert test.loop.amplitude_mm == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("angle", "per_mrad", "torque", "per_Nm"),
    [("deg", 0.18 / np.pi, "N·m", 1.0), ("°", 0.18 / np.pi, "Nm", 1.0), ("rad", 1e-3, "N.m", 1.0),
     ("degrees", 0.18 / np.pi, "in-lb", 1 / 0.1129848290276167), ("mrad", 1.0, "kN m", 1e-3)],
)  # fmt: skip
def test_torque_over_angle(tmp_path, table, record, angle, per_mrad, torque, per_Nm):
    r = record(amplitude_mm=20.0)
    motion, moment = r.displacement_mm * per_mrad, r.force_N * per_Nm
    path = table("a.csv", {"t [s]": r.time_s, f"Winkel [{angle}]": motion, f"Drehmoment [{torque}]": moment})
    write_tests(import_tests([path]), tmp_path / "c")
    campaign = read_campaign(tmp_path / "c")
    assert (campaign.units.displacement, campaign.units.force) == ("mrad", "N·m")
    assert "amplitude_mrad = 20.0" in (tmp_path / "c" / "campaign.toml").read_text()
    np.testing.assert_allclose(campaign.tests[0].displacement_mm, r.displacement_mm, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(campaign.tests[0].force_N, r.force_N, rtol=1e-7, atol=1e-7)


def test_pressure_over_stroke(table, record):
    r = record()
    path = table("a.csv", {"t [s]": r.time_s, "Hub [mm]": r.displacement_mm, "Druck [psi]": r.force_N})
    (test,) = import_tests([path])
    assert test.record.units.force == "kPa"
    np.testing.assert_allclose(test.record.force_N, r.force_N * 6.894757293168361, rtol=1e-7)


def test_gain_reverse_and_the_inverse_sensitivity(table, record):
    r = record()
    path = table("a.csv", {"x_mm": r.displacement_mm, "force [V]": r.force_N * -0.02 * 10, "t_s": r.time_s})
    for value in ("20 mV/N", "50 N/V"):
        (test,) = import_tests([path], Recipe(sensitivities={"force": value}, gains={"force": 10}, reverse=("force",)))
        np.testing.assert_allclose(test.record.force_N, r.force_N, rtol=1e-8, atol=1e-9)
    with pytest.raises(CampaignError, match=r"reversed.*--reverse force"):
        import_tests([path], Recipe(sensitivities={"force": "20 mV/N"}))


def test_gaps_are_bridged_by_time(table, record):
    r = record()
    force = r.force_N.copy()
    force[300:305] = np.nan
    (test,) = import_tests([table("a.csv", {"x [mm]": r.displacement_mm, "F [N]": force})], Recipe(sample_rate_hz=1280))
    assert test.record.time_s.size == r.time_s.size - 5
    assert any("5 sample(s) without a number" in line for line in test.said)
    assert any("gap" in line for line in test.record.warnings)
    assert test.loop.frequency_hz == pytest.approx(10.0, rel=1e-5)


def test_channels_are_asked_for_where_they_cannot_be_told(table, record):
    r = record()
    x, f = r.displacement_mm, r.force_N
    path = table("a.csv", {"t [s]": r.time_s, "ai1": x, "ai2": f})
    with pytest.raises(CampaignError, match=r"No channel is known as force among 1: t \(s\), 2: ai1, 3: ai2.*--force"):
        import_tests([path])
    with pytest.raises(
        CampaignError,
        match=r"a\.csv: 'ai1' \(displacement\) states no .*--unit \"displacement=<UNIT>\" --unit \"force=<UNIT>\"$",
    ):
        import_tests([path], Recipe(channels={"displacement": "ai1", "force": "ai2"}))
    both = Recipe(channels={"displacement": "2", "force": "AI2"}, units={"displacement": "mm", "force": "N"})
    (test,) = import_tests([path], both)
    np.testing.assert_allclose(test.record.force_N, f, rtol=1e-8, atol=1e-9)
    with pytest.raises(CampaignError, match=r"no channel 'ai3' \(force\).*did you mean 'ai2'"):
        import_tests([path], Recipe(channels={"displacement": "ai1", "force": "ai3"}))
    with pytest.raises(CampaignError, match="named as displacement and as force"):
        import_tests([path], Recipe(channels={"displacement": "ai1", "force": "ai1"}))
    path = table("b.csv", {"t [s]": r.time_s, "x [mm]": x, "F1 [N]": f, "F2 [N]": f})
    with pytest.raises(CampaignError, match="Which channel is the force: F1 \\(N\\), F2 \\(N\\)"):
        import_tests([path])
    (test,) = import_tests([path], Recipe(channels={"force": "F2"}))
    path = table("c.csv", {"t [s]": r.time_s, "x [mm]": x, "acc [g]": x, "F [N]": f})
    (test,) = import_tests([path])
    assert "displacement_mm" in test.columns and any("--acceleration NAME" in line for line in test.said)


@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        (Recipe(), r"'Kraft' \(force\) is in V: of what transducer\? Say it with --sensitivity \"force="),
        (Recipe(sensitivities={"force": "9.55"}), "no number with a unit"),
        (Recipe(sensitivities={"force": "9.55 mV/mm"}), "gives no force"),
        (Recipe(sensitivities={"force": "9.55 mV/N", "displacement": "1 V/mm"}), "in mm already"),
        (Recipe(units={"force": "kNewtonne"}), "unit 'kNewtonne' is not known"),
        (Recipe(units={"force": "s"}), "s is no unit of force; there are N, N·m, kPa"),
    ],
)
def test_units_that_make_no_sense(table, record, recipe, words):
    r = record()
    path = table("a.csv", {"t [s]": r.time_s, "Weg [mm]": r.displacement_mm, "Kraft [V]": r.force_N})
    with pytest.raises(CampaignError, match=words) as caught:
        import_tests([path], recipe)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("a.csv")


def test_sample_rates(table, record):
    r = record()
    path = table("a.csv", {"Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N})
    with pytest.raises(CampaignError, match=r"neither a time channel .* nor a sample rate"):
        import_tests([path])
    rounded = table("b.csv", {"t [s]": np.round(r.time_s, 3), "Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N})
    with pytest.raises(CampaignError, match=r"rounded too far.*--sample-rate"):
        import_tests([rounded])
    (test,) = import_tests([rounded], Recipe(sample_rate_hz=1280))
    np.testing.assert_allclose(test.record.time_s, r.time_s, atol=1e-9)


def one_gap(k):
    return (k > 2000) & (k < 2317)


@pytest.mark.parametrize(("decimals", "lost"), [(7, one_gap), (4, one_gap), (7, lambda k: (k > 99) & (k % 21 == 0))])
def test_rows_that_are_lost_do_not_make_a_stated_sample_rate_wrong(table, record, decimals, lost):
    r = record(rate_hz=2560.0, n_cycles=20.3, noise_N=0.002)
    kept = ~lost(np.arange(r.time_s.size))
    columns = {"t [s]": r.time_s.round(decimals), "Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N}
    path = table("a.csv", {name: x[kept] for name, x in columns.items()})
    (test,) = import_tests([path], Recipe(sample_rate_hz=2560))
    np.testing.assert_allclose(test.record.time_s, r.time_s[kept] - r.time_s[0], atol=10.0**-decimals)
    with pytest.raises(CampaignError, match="2000 samples a second as you say"):
        import_tests([path], Recipe(sample_rate_hz=2000))


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (lambda t: t[::-1], "runs backwards: .* turn their order round"),
        (lambda t: np.random.default_rng(0).permutation(t), "is in no order: .*Export the recording again"),
        (np.zeros_like, "does not move"),
        (lambda t: t - 0.1 * (t > 0.3), "does not increase at sample"),
    ],
    ids=["backwards", "shuffled", "still", "jumps back"],
)
def test_a_time_that_is_in_no_order_is_said_to_be(table, record, order, words):
    r = record(noise_N=0.002)
    path = table("a.csv", {"t [s]": order(r.time_s), "Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N})
    for recipe in (Recipe(), Recipe(sample_rate_hz=1280)):  # a rate does not pass over it
        with pytest.raises(CampaignError, match=f"^a.csv: the time 't' {words}.*--time none --sample-rate HZ"):
            import_tests([path], recipe)
    (test,) = import_tests([path], Recipe(channels={"time": "none"}, sample_rate_hz=1280))
    np.testing.assert_allclose(test.record.time_s, r.time_s, atol=1e-9)


def test_a_time_that_repeats_beside_a_stated_rate_is_said(table, record):
    r = record(noise_N=0.002)
    time = np.where(np.arange(r.time_s.size) == 200, r.time_s[199], r.time_s)
    path = table("a.csv", {"t [s]": time, "Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N})
    (test,) = import_tests([path], Recipe(sample_rate_hz=1280))
    assert any("repeats 1 time(s): a row written twice, or lost?" in w for w in test.record.warnings)


def test_a_clock_in_milliseconds_since_1970_named_seconds(tmp_path, record):
    r = record(noise_N=0.002)
    rows = zip(r.time_s, r.displacement_mm, r.force_N)
    lines = [f"{1.7e12 + 1e3 * t:.3f},{u:.8f},{f:.8f}" for t, u, f in rows]
    file = tmp_path / "epoch.csv"
    file.write_text("\n".join(["time_s,displacement_mm,force_N", *lines, ""]))
    with pytest.raises(CampaignError, match=r"milliseconds since 1970\? Say --unit time=ms"):
        import_tests([file])
    (test,) = import_tests([file], Recipe(units={"time": "ms"}))
    assert test.record.frequency_hz == pytest.approx(r.frequency_hz, rel=1e-3)


def test_bad_channels(table, record):
    r = record()
    n = r.time_s.size
    for name, columns, words in (
        ("zeros.csv", {"Weg [mm]": r.displacement_mm, "Kraft [N]": np.zeros(n)}, "'Kraft' stays at 0 N"),
        ("dead.csv", {"Weg [mm]": np.full(n, 0.3), "Kraft [N]": r.force_N}, "'Weg' stays at 0.3 mm"),
        (
            "gone.csv",
            {"Weg [mm]": r.displacement_mm, "Kraft [N]": np.r_[np.full(n // 2, 1.0), np.full(n - n // 2, np.nan)]},
            "stays at 1",
        ),
        ("noise.csv", {"Weg [mm]": r.displacement_mm[:200], "Kraft [N]": r.force_N[:200]}, "at least two are needed"),
    ):
        with pytest.raises(CampaignError, match=words):
            import_tests([table(name, columns)], Recipe(sample_rate_hz=1280))


def test_files_that_do_not_go_together(tmp_path, table, record, volts):
    r = record()
    one = table("a.csv", {"Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N})
    torque = table("b.csv", {"Winkel [deg]": r.displacement_mm, "Moment [Nm]": r.force_N})
    rate = Recipe(sample_rate_hz=1280)
    with pytest.raises(CampaignError, match="a campaign holds one kind of record"):
        import_tests([one, torque], rate)
    (tmp_path / "other").mkdir()
    again = (tmp_path / "other" / "a.csv").write_bytes(one.read_bytes()) and tmp_path / "other" / "a.csv"
    with pytest.raises(CampaignError, match="two recordings would be called a"):
        import_tests([one, again], rate)
    with pytest.raises(CampaignError, match="not found"):
        import_tests([tmp_path / "none.tdms"], rate)
    with pytest.raises(CampaignError, match="no files"):
        import_tests([], rate)
    tests = import_tests([one], rate)
    write_tests(tests, tmp_path / "c")
    with pytest.raises(CampaignError, match="is a campaign already"):
        write_tests(tests, tmp_path / "c")
    with pytest.raises(CampaignError, match=r"would be written over"):
        write_tests(tests, tmp_path)


def test_names_with_spaces_and_accents(tmp_path, table, record):
    r = record()
    folder = tmp_path / "Été Nº 1"
    folder.mkdir()
    path = table("Été Nº 1/Versuch è 10 Hz.csv", {"Weg über Grund [mm]": r.displacement_mm, "Kraft é [N]": r.force_N})
    write_tests(import_tests([path], Recipe(sample_rate_hz=1280)), tmp_path / "Kampagne ü")
    campaign = read_campaign(tmp_path / "Kampagne ü")
    assert campaign.name == "Kampagne ü" and campaign.tests[0].file == "Versuch è 10 Hz.csv"


def test_recipe_file_and_what_is_said_over_it(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        'sample_rate_hz = 1280\nreverse = ["force"]\n[channels]\nacceleration = 1\nforce = "ai1"\n'
        '[sensitivities]\nacceleration = "105 mV/g"\nforce = "9.55 mV/N"\n[gains]\nforce = 10\n'
        '[text]\nseparator = ";"\n[specimen]\nname = "isolator 7"\n'
    )
    recipe = read_recipe(path)
    assert recipe.channels == {"acceleration": "1", "force": "ai1"} and recipe.gains == {"force": 10}
    assert recipe.layout == Layout(separator=";") and recipe.specimen == {"name": "isolator 7"}
    said = Recipe(channels={"displacement": "x"}, sample_rate_hz=2000, layout=Layout(decimal=","))
    merged = said.over(recipe)
    assert merged.channels == {"displacement": "x", "force": "ai1"} and merged.sample_rate_hz == 2000
    assert merged.layout == Layout(";", ",", None) and merged.reverse == ("force",)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sample_rat_hz = 1280", "unknown key 'sample_rat_hz'; did you mean 'sample_rate_hz'"),
        ("[channels]\nfroce = 'ai1'", "unknown key 'froce'; did you mean 'force'"),
        ("[gains]\nforce = 0", "gain of force must be a number other than 0"),
        ("[gains]\nforce = 'x'", "gain of force must be a number"),
        ("reverse = 'force'", "reverse must be a list"),
        ("reverse = ['time']", "unknown key 'time'"),
        ("sample_rate_hz = -1", "must be a number between"),
        ("channels = 3", r"must be a table \[channels\]"),
        ("[units]\nforce = 3", "must be text in quotes"),
        ("[text]\nheader_line = 'x'", "unknown key 'header_line'"),
        ("[channels]\ndisplacement = 'a'\nacceleration = 'b'", "not both"),
        ("a = ", "not valid TOML"),
    ],
)
def test_faults_in_a_recipe(tmp_path, text, words):
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(CampaignError, match=words) as caught:
        read_recipe(tmp_path / "r.toml")
    assert "\n" not in str(caught.value)
    with pytest.raises(CampaignError, match="not found; a recipe is a TOML file"):
        read_recipe(tmp_path / "none.toml")


def test_units_in_names():
    for name, expected in {
        "Force [kN]": ("Force", "kN"), "Weg in mm": ("Weg", "mm"), "Kraft / N": ("Kraft", "N"),
        "force_N": ("force", "N"), "time_s": ("time", "s"), "acc_m_s2": ("acc", "m/s2"),
        "torque_N_m": ("torque", "N*m"), "F (Sensor 2)": ("F (Sensor 2)", ""), "x/y": ("x/y", ""),
        "a_g": ("a", "g"), "run_2": ("run_2", ""), "plain": ("plain", ""), "both(1)": ("both(1)", ""),
    }.items():  # fmt: skip
        assert unit_texts.split_name(name) == expected, name
    for text in ("t", "F", "x", "Kraft", "time", "disp"):
        assert not unit_texts.is_unit(text), text
    for text in ("s", "mm", "[N]", "(V)", "m/s²", "-", "", "°", "kN", "g", "bar", "Nm"):
        assert unit_texts.is_unit(text), text


def test_the_command(tmp_path, capsys, volts, table):
    r, v0, v1 = volts(n_cycles=40.3)
    path = str(table("f10.csv", {"ai0": v0, "ai1": -v1}))
    said = [
        "--acceleration",
        "ai0",
        "--force",
        "ai1",
        "--sensitivity",
        "acceleration=105 mV/g",
        "--sample-rate",
        "1280",
    ]
    said += ["--sensitivity", "force = 9.55 mV/N", "--reverse", "force", "--name", "isolator 7"]
    out = tmp_path / "c"
    assert cli.main(["import", path, *said, "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "acceleration: 'ai0' (no unit: taken for V, 105 mV/g)" in text and "reversed" in text
    assert "found: 10 Hz" in text and "nothing was written" in text and not out.exists()
    assert cli.main(["import", path, *said, "--out", str(out)]) == 0
    assert "1 test(s) are in" in capsys.readouterr().out
    campaign = read_campaign(out)
    assert campaign.name == "isolator 7"
    same_loop(campaign.loops()[0], average(r), 1e-3)
    for wrong, words in (
        (["import", path, "--gain", "force=1,000", "--dry-run"], "is the comma in"),
        (["import", path, "--unit", "force", "--dry-run"], "--unit force: write it as ROLE=VALUE"),
        (["import", path, "--unit", "froce=N", "--dry-run"], "did you mean 'force'"),
        (["import", path, "--gain", "force=x", "--dry-run"], "'x' is not a number"),
        (["import", path, "--reverse", "forc", "--dry-run"], "did you mean 'force'"),
        (["import", path, *said, "--out", str(out)], "is a campaign already"),
    ):
        assert cli.main(wrong) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and words in err, err


PEAK = """
import re, sys
from pathlib import Path
from bayes_iwan.campaign import read_campaign
from bayes_iwan.campaign.importing import import_tests, write_tests
folder = Path(sys.argv[1])
def peak():  # of this program alone: getrusage would tell the larger of it and of the process that started it
    return 1024 * int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])
peaks = []
for name in ("short.txt", "long.txt"):
    write_tests(import_tests([folder / name]), folder / f"of {name}")
    peaks.append(peak())
    read_campaign(folder / f"of {name}").loops()
    peaks.append(peak())
print(peaks[2] - peaks[1], peaks[3] - peaks[1])
"""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="no /proc to read the peak of memory from")
def test_memory_to_import_a_long_file(tmp_path, record):
    """Beyond what a short file takes, memory stays under ten times the file: imported, and read as a campaign."""
    for name, n in (("short.txt", 20_000), ("long.txt", 150_000)):
        t = np.arange(n) / 12_800.0
        r = record(time_s=t, noise_N=0.01)
        columns, head = np.column_stack([t, r.displacement_mm, r.force_N]), "t [s]\tx [mm]\tF [N]"
        np.savetxt(tmp_path / name, columns, fmt="%.9g", delimiter="\t", header=head, comments="")
    done = subprocess.run([sys.executable, "-c", PEAK, str(tmp_path)], capture_output=True, text=True, check=True)
    imported, read = (float(x) / (tmp_path / "long.txt").stat().st_size for x in done.stdout.split())
    print(f"memory over file size: {imported:.1f} imported, {read:.1f} read")
    assert 0.5 < imported < 10 and 0.5 < read < 10, (imported, read)  # the table alone is 0.7 of the file


@pytest.mark.parametrize("accelerometer", [False, True])
def test_a_staircase_is_split_into_tests(tmp_path, capsys, table, record, accelerometer):
    low, high = record(n_cycles=25, start=0.0, amplitude_mm=0.3), record(n_cycles=25, start=0.0, amplitude_mm=0.9)
    x, f = (np.concatenate([getattr(r, name) for r in (low, high)]) for name in ("displacement_mm", "force_N"))
    a = -((2 * np.pi * 10) ** 2) * x * 1e-3
    motion = {"acc [m/s²]": a} if accelerometer else {"x [mm]": x}
    path = str(table("steps.csv", motion | {"F [N]": f}))
    said = ["import", path, "--sample-rate", "1280", "--out", str(tmp_path / "c")]
    assert cli.main(said) == 2 and "--split" in capsys.readouterr().err
    assert cli.main([*said, "--split"]) == 0
    said = capsys.readouterr().out
    assert "found in steps_1.csv: " in said and "found in steps_2.csv: " in said
    campaign = read_campaign(tmp_path / "c")
    assert [t.amplitude_mm for t in campaign.tests] == pytest.approx([0.3, 0.9], rel=0.01)
    # an acceleration is integrated over the step between the levels, which leaves a slow tail
    same_loop(campaign.loops()[1], average(high), *((5e-3, 1e-4) if accelerometer else ()))


def test_the_sample_recordings(tmp_path, monkeypatch, capsys):
    """The files of analyses/sample_recordings.py become the shipped campaigns again, by the commands it names."""
    pytest.importorskip("nptdms")
    script = Path(__file__).parents[2] / "analyses" / "sample_recordings.py"
    monkeypatch.setattr(sys, "argv", [str(script), "--out", str(tmp_path)])
    runpy.run_path(str(script), run_name="__main__")
    rig = ["--sensitivity", "acceleration=105 mV/g", "--sensitivity", "force=9.55 mV/N"]
    assert cli.main(["import", str(tmp_path / "rope_spring.tdms"), *rig, "--out", str(tmp_path / "c")]) == 0
    for loop, truth in zip(
        read_campaign(tmp_path / "c").loops(), read_campaign(DATA / "rope_spring_accelerometer").loops(), strict=True
    ):
        same_loop(loop, truth, 1e-5)
        assert (loop.record.frequency_hz, loop.record.amplitude_mm) == (
            truth.record.frequency_hz,
            truth.record.amplitude_mm,
        )
    assert cli.main(["import", str(tmp_path / "Versuch 10 Hz.csv"), "--out", str(tmp_path / "d")]) == 0
    assert "semicolons, decimal ,, cp1252, numbers from line 6" in capsys.readouterr().out
    same_loop(read_campaign(tmp_path / "d").loops()[0], read_campaign(DATA / "rope_spring").loops()[1])


@pytest.mark.parametrize("name, per_s, said", [("Time", 1 / 60, True), ("Time (min)", 1 / 60, False), ("t", 1, True)])
def test_a_time_without_a_unit_says_what_it_is_taken_for(table, record, name, per_s, said):
    """Minutes passed for seconds: 600 Hz for 10 without a word."""
    r = record(noise_N=0.002)
    path = table("a.csv", {name: per_s * r.time_s, "u (mm)": r.displacement_mm, "F (N)": r.force_N})
    (test,) = import_tests([path])
    assert [w for w in test.record.warnings if "taken for s" in w] == (
        [f'{name!r} states no unit and is taken for s: else say --unit "time=min"'] if said else []
    )
    (test,) = import_tests([path], Recipe(units={"time": "min" if per_s < 1 else "s"}))
    assert test.loop.frequency_hz == pytest.approx(10, rel=1e-4)
    assert not any("taken for s" in w for w in test.record.warnings)


def test_what_each_file_lacks_stands_under_its_own_name(tmp_path, record):
    """All of it was said of the first file."""
    r = record()
    table = np.column_stack([r.time_s, r.displacement_mm, r.force_N])
    for name, header in (("u1", "Time (s),Disp,Force (N)"), ("u2", "Time (s),Disp (mm),Force")):
        np.savetxt(tmp_path / f"{name}.csv", table, fmt="%.6f", delimiter=",", header=header, comments="")
    with pytest.raises(CampaignError) as asked:
        import_tests([tmp_path / "u1.csv", tmp_path / "u2.csv"])
    of_first, of_second = str(asked.value).split("In u2.csv: ")
    assert of_first.startswith("u1.csv: ") and "'Disp'" in of_first and "Force" not in of_first
    assert of_second.startswith("'Force' (force) states no unit") and '"force=<UNIT>"' in of_second


def test_what_full_scale_of_a_wav_file_is_needs_a_number(tmp_path, record):
    """A force of 17 N was read as 0.85 N: "N" was the natural answer, and meant that full scale is 1 N."""
    from scipy.io import wavfile

    r = record()
    samples = np.column_stack([r.displacement_mm / 2, r.force_N / 20]) * 2**15
    wavfile.write(tmp_path / "a.wav", 1280, samples.astype("int16"))
    named = {"displacement": "1", "force": "2"}
    with pytest.raises(CampaignError, match='--unit "displacement=<50 mm>" --unit "force=<50 N>"'):
        import_tests([tmp_path / "a.wav"], Recipe(channels=named))
    with pytest.raises(CampaignError, match='say what that is with its number, --unit "force=50 N" where'):
        import_tests([tmp_path / "a.wav"], Recipe(channels=named, units={"displacement": "2 mm", "force": "N"}))
    of_cell = Recipe(channels=named, units={"displacement": "2 mm"}, sensitivities={"force": "100 mV/N"})
    with pytest.raises(CampaignError, match='--unit "force=50 V" where it is 50 V'):
        import_tests([tmp_path / "a.wav"], of_cell)
    (test,) = import_tests([tmp_path / "a.wav"], replace(of_cell, units={"displacement": "2 mm", "force": "2 V"}))
    np.testing.assert_allclose(test.record.force_N, r.force_N, atol=20 / 2**15)
    recipe = Recipe(channels=named, units={"displacement": "2 mm", "force": "20 N"})
    (test,) = import_tests([tmp_path / "a.wav"], recipe)
    np.testing.assert_allclose(test.record.force_N, r.force_N, atol=20 / 2**15)


@pytest.mark.parametrize("cut", [0, 1000])
def test_a_wav_file_that_ends_early_is_said(tmp_path, record, cut):
    from scipy.io import wavfile

    r = record(noise_N=0.002)
    samples = np.column_stack([r.displacement_mm, r.force_N]) / 100
    wavfile.write(tmp_path / "a.wav", 1280, samples.astype("float32"))
    raw = (tmp_path / "a.wav").read_bytes()
    (tmp_path / "a.wav").write_bytes(raw[: len(raw) - cut])
    recipe = Recipe(channels={"displacement": "1", "force": "2"}, units={"displacement": "100 mm", "force": "100 N"})
    (test,) = import_tests([tmp_path / "a.wav"], recipe)
    assert any("ends before its samples do" in w for w in test.record.warnings) == bool(cut)


def test_a_folder_of_folders_says_which_and_the_command_for_one_and_for_all(
    tmp_path, monkeypatch, capsys, table, record
):
    """The commands that it names are run."""
    from bayes_iwan.cli import main

    monkeypatch.chdir(tmp_path)
    r = record()
    for name in ("a 1", "b"):
        (tmp_path / "rig" / name).mkdir(parents=True)
        table(f"rig/{name}/x.csv", {"time_s": r.time_s, "disp_mm": r.displacement_mm, "force_N": r.force_N})
    for command in ("import", "check", "identify"):
        assert main([command, "rig"]) == 2
        said = capsys.readouterr().err
        assert "rig: folders of recordings: a 1, b. Import each specimen: " in said
        assert 'bayes-iwan import "rig/a 1" --out "rig-campaigns/a 1"; then all: bayes-iwan batch "rig-camp' in said
    assert main(["import", "rig/a 1", "--out", "rig-campaigns/a 1"]) == 0
    for command in ("import", "check", "identify"):
        assert main([command, "rig-campaigns"]) == 2
        said = capsys.readouterr().err
        assert (
            'a folder of campaigns: a 1. One of them: bayes-iwan check "rig-campaigns/a 1"; all: bayes-iwan b' in said
        )


def test_two_kinds_of_record_and_a_folder_that_cannot_be_written(table, record, tmp_path, capsys):
    r = record(n_cycles=20.3)
    rest = {"t [s]": r.time_s, "Kraft [N]": r.force_N}
    a = table("a.csv", {"Weg [mm]": r.displacement_mm, **rest})
    b = table("b.csv", {"acc [m/s²]": -1e-3 * (2 * np.pi * 10) ** 2 * r.displacement_mm, **rest})
    with pytest.raises(CampaignError, match="one kind of record: import each kind into a campaign of its own"):
        import_tests([a, b])
    (tmp_path / "file").write_text("")
    assert cli.main(["import", str(a), "--out", str(tmp_path / "file" / "x")]) == 2
    said = capsys.readouterr().err
    assert "name a folder that can be written to" in said and str(tmp_path / "file") in said


def test_levels_are_listed_below_their_file(table, record, capsys):
    r = record(n_cycles=40.3)
    size = np.where(r.time_s < r.time_s[-1] / 2, 1.0, 0.5)
    path = table("a.csv", {"t [s]": r.time_s, "Weg [mm]": size * r.displacement_mm, "Kraft [N]": size * r.force_N})
    assert cli.main(["import", str(path), "--split", "--dry-run"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert all(x.startswith("    ") for x in said[1:-1]) and "    found in a_2.csv" in "\n".join(said)


@pytest.mark.parametrize("unit", ["s", "ms"])
def test_an_acceleration_beyond_all_shakers_is_said(table, record, tmp_path, unit):
    """Seconds in a column that is named milliseconds: 10 kHz at 1 mm."""
    r = record(n_cycles=20.3)
    path = table("a.csv", {f"t ({unit})": r.time_s, "Weg [mm]": r.displacement_mm, "Kraft [N]": r.force_N})
    tests = import_tests([path])
    write_tests(tests, tmp_path / "c")
    for warnings in (tests[0].record.warnings, read_campaign(tmp_path / "c").tests[0].warnings):
        assert any("is an acceleration of 4e+05 g, more than shakers reach" in x for x in warnings) == (unit == "ms")
