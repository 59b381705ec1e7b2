"""The page of `bayes-iwan inspect`, and the same in the terminal."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan import cli
from bayes_iwan.campaign import read_campaign, write_campaign
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.report.inspection.inspect_page import inspect_to

from .layout import cut_elements

pytestmark = pytest.mark.usefixtures("no_figure_files")

ROOT = Path(__file__).parents[2]


def test_a_sound_campaign(tmp_path, capsys, figure_files):
    assert cli.main(["inspect", str(ROOT / "data" / "rope_spring"), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "f10_a0.3" in said and "inspect.html" in said and "90 %" in said
    page = (tmp_path / "inspect.html").read_text()
    for words in ("Nothing stands in the way", "Loops less the straight part", "Across frequency", "Symbols", "Noise"):
        assert words in page
    assert page.count("<figure>") == 7
    names = {p.name for p in (tmp_path / "figures").iterdir()}
    drawn = {"loops", "friction", "overlays", "trends", "noise", "drift", "drive"}
    assert names == {f"inspect_{n}.{e}" for n in drawn for e in ("png", "pdf")}


@pytest.mark.usefixtures("no_pictures")
def test_remarks_come_first_and_are_those_of_check(tmp_path, capsys):
    campaign = read_campaign(ROOT / "data" / "rope_spring")
    test = campaign.tests[0]
    hum = 0.2 * np.sin(2 * np.pi * 50.1 * test.time_s)
    offset = replace(test, force_N=test.force_N + 100.0 + hum)
    write_campaign(tmp_path / "c", name="odd", description="", tests=[offset, campaign.tests[1]])
    text = inspect_to(tmp_path / "c", tmp_path / "out")
    assert "mains in the force" in text and "static load" in text
    page = (tmp_path / "out" / "inspect.html").read_text()
    assert page.index("remark(s) on the records") < page.rindex("Energy, stiffness and damping</h2>")
    assert cli.main(["check", str(tmp_path / "c")]) == 0
    checked = capsys.readouterr().out
    assert "mains in the force" in checked and "static load" in checked


def test_other_quantities_keep_their_units(tmp_path):
    campaign = read_campaign(ROOT / "data" / "rope_spring")
    units = Units("mrad", "N·m")
    tests = [replace(t, units=units) for t in campaign.tests[:2]]
    write_campaign(tmp_path / "c", name="joint", description="", tests=tests)
    text = inspect_to(tmp_path / "c")
    assert "N·m/mrad" in text and "N/mm" not in text


@pytest.mark.usefixtures("no_pictures")
def test_an_accelerometer_s_response_is_stated(tmp_path):
    campaign = tmp_path / "campaign"
    shutil.copytree(ROOT / "data" / "rope_spring_accelerometer", campaign)
    head, *tests = (campaign / "campaign.toml").read_text(encoding="utf-8").split("[[test]]")
    (campaign / "campaign.toml").write_text("[[test]]".join([head, *tests[:2]]), encoding="utf-8")
    text = inspect_to(campaign, tmp_path)
    for said in (text, (tmp_path / "inspect.html").read_text()):
        assert "amplitude 1 and phase 0" in said and "integrated twice" in said


@pytest.mark.usefixtures("no_pictures")
def test_the_widest_table_fits_a_screen_of_1280_px(chromium, tmp_path):
    """Energies of seven digits with their intervals, and ten columns."""
    campaign = read_campaign(ROOT / "data" / "rope_spring")
    large = [replace(t, force_N=1e4 * t.force_N) for t in campaign.tests[:2]]
    write_campaign(tmp_path / "large", name="large", description="", tests=large)
    inspect_to(tmp_path / "large", tmp_path)
    assert cut_elements(tmp_path / "inspect.html", chromium, (1280,), scrolled=1280) == {"1280": []}
