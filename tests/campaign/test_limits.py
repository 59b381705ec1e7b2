"""What the rig can do, as campaign.toml states it."""

import pytest

from bayes_iwan.campaign import CampaignError, read_campaign
from bayes_iwan.campaign.recording.limits import RigLimits, limits_of
from bayes_iwan.campaign.recording.units import Units


def test_limits_are_read_in_their_units():
    stated = {"force_kN": 0.5, "amplitude_in": 0.1, "frequency_hz": [2, 40.0]}
    assert limits_of(stated, Units("mm", "N")) == RigLimits(500.0, pytest.approx(2.54), (2.0, 40.0))
    assert limits_of({"force_N_m": 3.0}, Units("mrad", "N·m")) == RigLimits(3.0)


def test_what_is_not_stated_is_what_was_measured():
    assert RigLimits().of_tests([5.0, 20.0], [0.3, 0.9], 7.0) == RigLimits(7.0, 0.9, (5.0, 20.0))
    assert RigLimits(9.0, 2.0, (1.0, 50.0)).of_tests([5.0], [0.3], 7.0) == RigLimits(9.0, 2.0, (1.0, 50.0))


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"frequency_hz": [20.0, 5.0]}, "the lowest comes first"),
        ({"frequency_hz": 20.0}, "a pair"),
        ({"frequency_hz": [0.0, 5.0]}, "must be positive"),
        ({"force_N": "much"}, "force_N must be a finite number"),
        ({"force_mm": 3.0}, "does not say a unit"),
        ({"amplitude_mm": float("inf")}, "finite number"),
        ({"amplitude_mm": 1.0, "amplitude_in": 1.0}, "keep one"),
        ({"stroke": 3.0}, "unknown key"),
    ],
)
def test_bad_limits_are_one_clear_message(stated, message):
    with pytest.raises(CampaignError, match=message) as caught:
        limits_of(stated, Units("mm", "N"))
    assert str(caught.value).startswith("campaign.toml [rig]")


def test_a_campaign_carries_them(made_up_campaign, tmp_path):
    assert read_campaign(made_up_campaign).limits == RigLimits()
    for file in made_up_campaign.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with (tmp_path / "campaign.toml").open("a") as toml:
        toml.write("\n[rig]\nforce_N = 50.0\nfrequency_hz = [1.0, 30.0]\n")
    assert read_campaign(tmp_path).limits == RigLimits(50.0, None, (1.0, 30.0))
