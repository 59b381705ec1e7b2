"""A campaign without a clock: rows, no times; the cycle is the unit of time."""

import re

import numpy as np
import pytest

from bayes_iwan import check
from bayes_iwan.campaign import CampaignError, read_campaign
from bayes_iwan.inference.setup.problem import make_problem

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
