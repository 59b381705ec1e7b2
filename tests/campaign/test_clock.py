"""A campaign without a clock: rows, no times; the cycle is the unit of time."""

import re

import numpy as np
import pytest

from bayes_iwan import check
from bayes_iwan.campaign import CampaignError, read_campaign, write_campaign
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests, write_tests
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.report.inspection.inspect_page import inspect_to

HEAD = """format = 1

[specimen]
name = "joint"

[channels]
displacement = "displacement_mm"
force = "force_N"
clock = "none"
"""


@pytest.fixture
def clockless(tmp_path):
    """Three levels of six cycles, each with rows of its own."""
    text = HEAD
    for a, rows in ((0.5, 90), (1.0, 140), (2.0, 200)):
        phase = np.arange(6.3 * rows) / rows
        u = a * np.sin(2 * np.pi * phase)
        f = 3.0 * u + 2.0 * np.sin(2 * np.pi * phase + 0.9)
        rowed = "".join(f"{x:.8g},{y:.8g}\n" for x, y in zip(u, f))
        (tmp_path / f"a{a:g}.csv").write_text("displacement_mm,force_N\n" + rowed)
        text += f'\n[[test]]\nfile = "a{a:g}.csv"\namplitude_mm = {a}\n'
    (tmp_path / "campaign.toml").write_text(text)
    return tmp_path


def test_every_cycle_lasts_as_long_whatever_its_rows(clockless):
    campaign = read_campaign(clockless)
    assert not campaign.clock
    assert [loop.frequency_hz for loop in campaign.loops()] == pytest.approx([1.0] * 3, abs=1e-3)


def test_check_prints_no_frequency(clockless):
    said = str(check(clockless))
    assert "Hz" not in said and not re.search(r"\d m?s\b", said)


def test_speed_is_no_parameter_without_a_clock(clockless):
    names = make_problem(read_campaign(clockless).loops()).names
    assert "normal_force_rate" not in names and "normal_force_slope" in names


@pytest.mark.parametrize(
    "change, said",
    [
        ('clock = "row"', r'clock = .row.; write clock = "none"'),
        ('clock = "none"\nsample_rate_hz = 100', "goes with neither an acceleration nor sample_rate_hz"),
    ],
)
def test_a_clock_that_makes_no_sense_is_refused(clockless, change, said):
    toml = clockless / "campaign.toml"
    toml.write_text(toml.read_text().replace('clock = "none"', change))
    with pytest.raises(CampaignError, match=said):
        read_campaign(clockless)


ROWS = "Time (s),Displacement (mm),Force (N)\n"


def recorded(folder, amplitudes=(0.5, 1.0, 2.0), time=""):
    """Files of a rig that counts rows: without times, or with one that goes up by one a row."""
    folder.mkdir()
    for a, rows in zip(amplitudes, (90, 140, 200)):
        phase = np.arange(6.3 * rows) / rows
        u, f = a * np.sin(2 * np.pi * phase), 5.0 * a * np.sin(2 * np.pi * phase + 0.5)
        head = ROWS if time else ROWS.removeprefix("Time (s),")
        lines = [(f"{i}," if time else "") + f"{x:.6f},{y:.5f}\n" for i, (x, y) in enumerate(zip(u, f))]
        (folder / f"a{a:g}.csv").write_text(head + "".join(lines))
    return folder


@pytest.mark.parametrize("time", ["", "rows"])
def test_import_asks_for_a_clock(tmp_path, time):
    folder = recorded(tmp_path / "rows", time=time)
    with pytest.raises(ImportAsks, match="none") as asked:
        import_tests([folder])
    assert [q.option for q in asked.value.questions] == ["--sample-rate"]
    if time:  # what is proposed works as it stands: a rate that nobody stated is none
        assert asked.value.questions[0].placeholder == "none"
    write_tests(import_tests([folder], Recipe(sample_rate_hz="none")), tmp_path / "campaign")
    campaign = read_campaign(tmp_path / "campaign")
    assert not campaign.clock and "frequency_hz" not in (tmp_path / "campaign" / "campaign.toml").read_text()
    assert [x.amplitude_mm for x in campaign.loops()] == pytest.approx([0.5, 1.0, 2.0], rel=1e-3)
    if time:
        tests = import_tests([folder], Recipe(sample_rate_hz=1.0))
        assert [t.loop.frequency_hz for t in tests] == pytest.approx([1 / 90, 1 / 140, 1 / 200], rel=1e-3)


def test_a_campaign_without_a_clock_is_written_as_it_was_read(clockless, tmp_path):
    read = read_campaign(clockless)
    write_campaign(tmp_path / "again", name="joint", description="", tests=read.tests, compress=False)
    again = read_campaign(tmp_path / "again")
    assert not again.clock and [x.file for x in again.tests] == [x.file for x in read.tests]
    for a, b in zip(read.loops(), again.loops()):
        np.testing.assert_allclose(a.force_N, b.force_N, atol=1e-6)


def test_an_acceleration_needs_a_clock(tmp_path):
    (tmp_path / "a.csv").write_text(
        "acc (m/s2),Force (N)\n" + "".join(f"{np.sin(i / 9):.5f},{np.cos(i / 9):.5f}\n" for i in range(400))
    )
    with pytest.raises(CampaignError, match="acceleration, which needs times"):
        import_tests([tmp_path / "a.csv"], Recipe(sample_rate_hz="none"))


def test_a_staircase_without_a_clock_tells_no_frequency(tmp_path):
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(6 * 100) / 100) for a in (0.5, 1.0, 2.0)])
    path = tmp_path / "stairs.csv"
    path.write_text("Displacement (mm),Force (N)\n" + "".join(f"{x:.6f},{4 * x + 1:.5f}\n" for x in u))
    recipe = Recipe(sample_rate_hz="none")
    with pytest.raises(ImportAsks) as asked:
        import_tests([path], recipe)
    tests = import_tests([path], recipe, split=True)
    said = str(asked.value) + " ".join(line for t in tests for line in t.said)
    assert len(tests) == 3 and "Hz" not in said


def test_inspect_prints_no_frequency(clockless, tmp_path):
    text = inspect_to(clockless, tmp_path / "seen")
    page = (tmp_path / "seen" / "inspect.html").read_text(encoding="utf-8")
    assert "Hz" not in text and "Hz" not in re.sub(r"data:[^\"]*", "", page)
