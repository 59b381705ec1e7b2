"""The configuration file: defaults, checks, and messages that name the mend."""

import pytest

from bayes_iwan.inference import config
from bayes_iwan.inference.config import ConfigError, complete, read_config


def test_defaults_are_filled_in_and_not_shared():
    first = complete({"sampling": {"walkers": 32}, "model": {"slip": "gamma2"}})
    assert first["sampling"]["walkers"] == 32 and first["sampling"]["ensembles"] == 4
    assert first["model"] == {"slip": "gamma2", "grip": "hunt_crossley", "stiffness": "saturating", "embedded": True}
    first["loops"]["n_phase"] = 7
    assert complete()["loops"]["n_phase"] == 128 == config.DEFAULTS["loops"]["n_phase"]


def test_completing_twice_changes_nothing():
    once = complete({"parameters": {"beta": {"fixed": 0.5}}, "sampling": {"budget_s": 60}})
    assert complete(once) == once and once["sampling"]["budget_s"] == 60.0


def test_a_file_is_read(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text('[model]\nslip = "uniform"\n[parameters.beta]\nfixed = 0.5\n', encoding="utf-8")
    got = read_config(file)
    assert got["model"]["slip"] == "uniform" and got["parameters"] == {"beta": {"fixed": 0.5}}


@pytest.mark.parametrize(
    "given, says",
    [
        ({"sampeling": {}}, "unknown table 'sampeling'; did you mean 'sampling'"),
        ({"sampling": {"walkrs": 64}}, r"\[sampling\]: unknown key 'walkrs'; did you mean 'walkers'"),
        ({"sampling": {"zzz": 64}}, "use budget_s, draws, ensembles"),
        ({"sampling": {"walkers": 0}}, "whole number of at least 1, not 0"),
        ({"sampling": {"walkers": 6.5}}, "whole number"),
        ({"sampling": {"ess": "many"}}, "positive number, not 'many'"),
        ({"sampling": {"budget_s": float("inf")}}, "positive number"),
        ({"search": {"objective": "eq9"}}, "choose one of eq8, squared, likelihood"),
        ({"search": {"second_opinion": 1}}, "true or false"),
        ({"model": {"slip": 3}}, "text in quotes"),
        ({"model": "gamma3"}, r"write \[model\]"),
        ({"parameters": {"beta": 0.5}}, r"\[parameters.beta\] and e.g. fixed = 0.5"),
        ({"loops": {"n_phase": 64}}, "64 phases cannot show 50 harmonics"),
    ],
)
def test_what_is_wrong_is_named(given, says):
    with pytest.raises(ConfigError, match=says):
        complete(given)


@pytest.mark.parametrize("text, says", [("[model\n", "not valid TOML"), (None, "cannot be read")])
def test_unreadable_files(tmp_path, text, says):
    file = tmp_path / "c.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError, match=says):
        read_config(file)
