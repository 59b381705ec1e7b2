"""The configuration file: defaults, checks, and messages that name the mend."""

import datetime
import tomllib

import pytest

from bayes_iwan.inference.setup.config import ConfigError, diagnose_settings_of, settings_of
from bayes_iwan.inference.setup.priors import ParameterError
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import ModelSettings, ParameterChange, SamplingSettings


def test_as_many_harmonics_as_phases_can_show_are_taken():
    assert settings_of({"loops": {"n_phase": 102, "n_harmonics": 50}}).loops.n_harmonics == 50
    with pytest.raises(ConfigError, match="101 phases cannot show 50 harmonics; make n_phase at least 102 or"):
        settings_of({"loops": {"n_phase": 101, "n_harmonics": 50}})


def test_defaults_are_filled_in():
    found = settings_of({"sampling": {"walkers": 32}, "model": {"slip": "gamma2"}})
    assert found.sampling == SamplingSettings(walkers=32) and found.sampling.ensembles == 4
    assert found.model == ModelSettings(slip="gamma2") and found.loops.n_phase is None


def test_settings_survive_their_own_tables():
    prior = {"dist": "lognorm", "s": 0.5, "scale": 2.0}
    once = settings_of({"parameters": {"beta": {"fixed": 0.5}, "eta1": {"prior": prior}}, "sampling": {"budget_s": 60}})
    assert settings_of(once.as_dict()) == once == settings_of(once) and once.sampling.budget_s == 60.0
    assert once.as_dict()["parameters"] == {"beta": {"fixed": 0.5}, "eta1": {"prior": prior}}


def test_a_file_is_read(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text('[model]\nslip = "uniform"\n[parameters.beta]\nfixed = 0.5\n', encoding="utf-8")
    got = settings_of(file)
    assert got.model.slip == "uniform" and got.parameters == {"beta": ParameterChange(fixed=0.5)}


@pytest.mark.parametrize(
    "given, says",
    [
        ({"sampeling": {}}, "unknown table 'sampeling'; did you mean 'sampling'"),
        ({"sampling": {"walkrs": 64}}, r"\[sampling\]: unknown key 'walkrs'; did you mean 'walkers'"),
        ({"sampling": {"zzz": 64}}, "there are between_tests, budget_s, draws"),
        ({"sampling": {"walkers": 0}}, "whole number of at least 1, not 0"),
        ({"sampling": {"walkers": 6.5}}, "whole number"),
        ({"sampling": {"ess": "many"}}, "finite positive number, not 'many'"),
        ({"sampling": {"budget_s": float("inf")}}, "positive number"),
        ({"search": {"second_search": 1}}, "true or false"),
        ({"model": {"slip": 3}}, "text in quotes"),
        ({"model": "gamma3"}, r"write \[model\]"),
        ({"parameters": {"beta": 0.5}}, r"\[parameters.beta\] and e.g. fixed = 0.5"),
        ({"loops": {"n_phase": 64}}, "64 phases cannot show 50 harmonics"),
        ({"loops": {"n_phase": 10**4000}}, "whole number of at least 1"),
        ({"sampling": {"ess": 10**400}}, "finite positive number"),
        ({"sampling": {"ess": True}}, "positive number, not True"),
        ({"parameters": {"beta": {"fixed": True}}}, "fixed must be a finite number, not True"),
        ({"parameters": {"beta": {"fixed": datetime.date(2026, 1, 1)}}}, "fixed must be a finite number"),
        ({"parameters": {"beta": {"fixed": {"a": 1}}}}, "fixed must be a finite number"),
        ({"parameters": {"beta": {"fixed": 10**400}}}, "fixed must be a finite number"),
        ({"parameters": {"beta": {"lower": float("nan")}}}, "lower must be a finite number"),
        ({"parameters": {"beta": {"tied": 3}}}, "name of a parameter in quotes"),
        ({"parameters": {"beta": {"tied": "eta1", "fixed": 1.0}}}, "exclude each other"),
        ({"parameters": {"beta": {"prior": "lognorm"}}}, "`dist` must name"),
        ({"parameters": {"beta": {"prior": {"dist": "lognorm", "s": [1]}}}}, "prior s must be a finite number"),
        ({"parameters": [1]}, "parameters must be a table"),
        ({"model": {"embedded": 1}}, "true or false"),
    ],
)
def test_what_is_wrong_is_named(given, says):
    with pytest.raises(ConfigError, match=says):
        settings_of(given)


@pytest.mark.parametrize("text, says", [("[model\n", "not valid TOML"), (None, "cannot be read")])
def test_unreadable_files(tmp_path, text, says):
    file = tmp_path / "c.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError, match=says):
        settings_of(file)


def test_what_a_command_would_not_use_is_refused():
    for given, says in (
        ({"search": {"members": 50}}, r"\[search\] is not used by a diagnosis"),
        ({"loops": {"n_phase": 128}}, r"\[loops\] is not used"),
        ({"parameters": {"noise_scale": {"fixed": 1.0}}}, "takes noise from the records"),
        ({"sampeling": {}}, "did you mean 'sampling'"),
    ):
        with pytest.raises(ConfigError, match=says):
            diagnose_settings_of(given)
    with pytest.raises(ConfigError, match="but a simulator is given"):
        diagnose_settings_of({"model": {"slip": "gamma1"}}, own_simulator=True)
    with pytest.raises(ConfigError, match="since each family has its own"):
        settings_of({"model": {}}, {"model": "since each family has its own"})
    kept = diagnose_settings_of({"model": {"slip": "gamma1"}, "parameters": {"beta": {"fixed": 0.5}}})
    assert kept.as_dict() == {"model": {"slip": "gamma1"}, "parameters": {"beta": {"fixed": 0.5}}}


def test_a_problem_with_nothing_to_fit_is_refused(known):
    loops = known.loops()
    fixed = {n: {"fixed": 1.0} for n in ("kp_N_mm", "force_zero_N", "k1_N_mm", "mean_slip_force_N", "slip_width")}
    model = {"slip": "uniform", "normal_force": "constant", "stiffness": "constant", "embedded": False}
    with pytest.raises(ParameterError, match="every parameter of the model is fixed"):
        make_problem(loops, {"model": model, "parameters": fixed})
    with pytest.raises(ParameterError, match="lies outside"):
        make_problem(loops, {"parameters": {"beta": {"fixed": 1e9}}})


#: what a configuration file may leave out. A default that changes changes everybody's answer, so it is changed here too
DEFAULTS = """
[loops]
n_harmonics = 50
n_blocks = 6
[model]
slip = "gamma3"
normal_force = "hunt_crossley"
stiffness = "saturating"
embedded = true
[likelihood]
kind = "correlated"
[search]
members = 200
evaluations = 20000
second_search = true
reach = 4.0
starts = 12
[sampling]
ensembles = 4
walkers = 16
budget_s = 480.0
max_steps = 200000
r_hat = 1.01
ess = 400.0
taus = 10.0
draws = 4096
between_tests = true
"""


def test_an_empty_configuration_is_one_that_says_every_default():
    tables = tomllib.loads(DEFAULTS)
    assert settings_of(tables) == settings_of(None) == settings_of({})
    left_out = {"loops": {"n_phase": None}, "parameters": {}}
    assert settings_of(None).as_dict() == {
        name: tables.get(name, {}) | left_out.get(name, {}) for name in (*tables, "parameters")
    }
