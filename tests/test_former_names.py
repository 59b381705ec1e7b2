"""Names of before: stored files are read, and what a user wrote gets one line with the new name."""

import hashlib
import json
import re
from pathlib import Path

import h5netcdf
import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan import former_names
from bayes_iwan.comparison.families import compare_families
from bayes_iwan.diagnosis.answer.saved_fits import read_fits
from bayes_iwan.effects.catalogue import load_effects
from bayes_iwan.export.json_file import read as read_exported
from bayes_iwan.inference.results.netcdf import SEAL, read_netcdf
from bayes_iwan.inference.results.run_files import write
from bayes_iwan.models.user_file import load_simulator
from bayes_iwan.withheld.answers import read_answer
from bayes_iwan.withheld.truths import read_truth

DATA = Path(__file__).parents[1] / "data"
NOW = {now: before for before, now in former_names.PARAMETERS.items()}


def as_before(text):
    """A text with the parameters' names of before."""
    return re.sub(rf"(?<![\w.])({'|'.join(map(re.escape, NOW))})(?!\w)", lambda found: NOW[found[1]], text)


@pytest.fixture(scope="module")
def run(tmp_path_factory, few_quick_walkers):
    """A quick run's folder and its posterior, with all parameters that have another name now."""
    campaign, out = tmp_path_factory.mktemp("campaign"), tmp_path_factory.mktemp("run")
    bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(campaign)
    config = {"search": {"members": 20, "evaluations": 100, "second_search": False, "starts": 2}}
    posterior = bi.identify(campaign, quick=True, seed=1, progress=False, config=config)
    write(posterior, out)
    return out, posterior


def test_a_posterior_of_before_is_read_with_the_names_of_now(run, tmp_path):
    folder, posterior = run
    path = tmp_path / "posterior.nc"
    path.write_bytes((folder / "posterior.nc").read_bytes()[: -len(SEAL) - 32])
    with h5netcdf.File(path, "a") as file:
        for name in ("config", "fingerprint", "convergence"):
            file.attrs[name] = as_before(file.attrs[name]).replace('"normal_force":', '"grip":')
        group = file["unconstrained_posterior"]._h5group
        for name in list(group):
            if name in NOW:
                group.move(name, NOW[name])
    whole = path.read_bytes()
    path.write_bytes(whole + SEAL + hashlib.sha256(whole).digest())
    assert b"grip_rate" in whole
    stored = read_netcdf(path)
    assert set(posterior.names) == set(stored.draws) and "normal_force_corner" in stored.draws
    again = bi.load(tmp_path, posterior.campaign.path)
    assert again.names == posterior.names and again.settings == posterior.settings
    np.testing.assert_array_equal(again.z, posterior.z)


def test_an_exported_model_of_before_is_read(run, tmp_path):
    _, posterior = run
    path = posterior.export("json", tmp_path, draws=3) / "isolator.json"
    new = read_exported(path)
    stored = json.loads(as_before(path.read_text(encoding="utf-8")))
    stored["model"]["grip"] = stored["model"].pop("normal_force")
    path.write_text(json.dumps(stored), encoding="utf-8")
    old = read_exported(path)
    assert old.model == new.model and old.names == new.names and sorted(old.values) == sorted(new.values)
    motion = bi.sine_motion(frequency_hz=10.0, amplitude_mm=0.5)
    np.testing.assert_array_equal(old.force(motion), new.force(motion))


def fit_of(effects, names):
    n = len(names)
    return {
        "effects": effects, "names": names, "z": [0.1] * n, "covariance": np.eye(n).tolist(), "share": 0.01,
        "length": 0.05, "along": 0.004, "spectrum": [], "along_spectrum": [], "between": [1.0, 1.0, 0.1],
    }  # fmt: skip


def test_fits_of_before_are_read_with_the_names_of_now(tmp_path):
    effects = [
        {"class": "MainsHum60", "name": "mains_hum", "strength_value": 0.1},
        {"class": "BentStiffness", "name": "cubic_stiffness", "strength_value": 2.0},
    ]
    names = ["kp_N_mm", "grip_slope", "cubic_stiffness.bend", "mains_hum.third_cosine"]
    stored = {
        "schema": 5,
        "scales": dict.fromkeys(("length_mm", "speed_m_s", "force_N", "slip_N", "soft_N_mm", "stiff_N_mm"), 1.0),
        "config": {"model": {"grip": "constant"}, "parameters": {"grip_slope": {"fixed": 0.1}}},
        "effects_file": None,
        "simulator_file": None,
        "fits": {"base": fit_of([], names[:2]), "cubic_stiffness+mains_hum": fit_of(effects, names)},
    }
    (tmp_path / "fits.json").write_text(json.dumps(stored))
    found = read_fits(tmp_path / "fits.json")
    fit = found.fits[frozenset({"cubic_stiffness", "mains_interference"})]
    assert fit.names == ("kp_N_mm", "normal_force_slope", "cubic_stiffness.knee", "mains_interference.third_cosine")
    assert [e["class"] for e in fit.effects] == ["MainsInterference60", "TrilinearStiffness"]
    assert found.settings.model.normal_force == "constant" and set(found.settings.parameters) == {"normal_force_slope"}


@pytest.mark.parametrize("file", ["withheld/answers.json", "withheld/answers_first.json", "withheld_2/answers.json"])
def test_answers_that_are_shipped_are_read(file):
    stored = json.loads((DATA / file).read_text())
    answers = stored.get("answers", stored)
    assert len(answers) >= 30
    for name, answer in answers.items():
        read, verdict = read_answer(name, answer), answer["verdict"]
        assert read.unknown_cause == bool(
            verdict.get("unknown_cause", verdict.get("unknown_rest", verdict["cause"] == "unknown"))
        )
        assert "unknown_cause" in read.probabilities and not {"mains_hum", "unknown_rest"} & set(read.probabilities)
        assert read.names <= set(read.probabilities)


def test_a_diagnosis_of_schema_2_has_the_keys_of_schema_3():
    before = {
        "verdict": {"unknown_rest": True, "causes": [{"name": "mains_hum", "cannot_tell_apart": ["force_drift"]}]},
        "probabilities": {"unknown_rest": 0.9, "mains_hum": 0.7},
        "rest": {"share": 0.4, "looks_like": "even_force"},
        "effects": [{"name": "mains_hum", "rivals": {"mains_hum": 0.0}}],
        "sentences": ["The rest of it."],
    }
    now = {
        "verdict": {"unknown_cause": True, "causes": [{"name": "mains_interference", "tied_with": ["force_drift"]}]},
        "probabilities": {"unknown_cause": 0.9, "mains_interference": 0.7},
        "unexplained": {"share": 0.4, "resembles": "even_force"},
        "effects": [{"name": "mains_interference", "alternatives": {"mains_interference": 0.0}}],
        "sentences": ["The rest of it."],
    }
    assert former_names.diagnosis_of(before) == now == former_names.diagnosis_of(now)


def test_a_truth_of_before_has_the_effects_of_now():
    truth = read_truth("case_01", {"kind": "mains_hum", "raw_share": 0.1})
    assert [c.name for c in truth.causes] == ["mains_interference"] and truth.causes[0].listed


def test_every_name_of_before_leads_to_one_that_exists():
    from bayes_iwan.effects import catalogue
    from bayes_iwan.models import Model
    from bayes_iwan.models.embedded_error import NAMES

    scales = bi.Scales(1.0, 0.1, 5.0, 1.2, 6.0, 20.0)
    model = Model(scales.reference, embedded=True)
    parameters = {p.name for p in model.parameters(scales)} | set(model.names) | set(NAMES)
    assert set(former_names.PARAMETERS.values()) <= parameters
    kinds = [k for some in catalogue.variants((), model).values() for k in some]
    assert set(former_names.EFFECT_CLASSES.values()) <= {k.__name__ for k in kinds}
    own = {p.name for kind in kinds for p in kind(scales, ("a.csv",), 1.0).parameters}
    assert set(former_names._EFFECT_PARAMETERS.values()) <= own
    for names in (former_names.PARAMETERS, former_names.DIAGNOSIS, former_names.EFFECTS):
        assert not names.keys() & set(names.values())  # reading twice changes nothing more


@pytest.mark.parametrize(
    "config, said",
    [
        ({"model": {"grip": "constant"}}, "config [model]: 'grip' is called \"normal_force\" now; rename it"),
        ({"parameters": {"grip_rate": {"fixed": 0.0}}}, 'grip_rate is called "normal_force_rate" now; rename it'),
    ],
)
def test_a_configuration_with_a_name_of_before_is_refused_in_one_line(run, config, said):
    with pytest.raises(ValueError, match=re.escape(said) + "$"):
        bi.make_problem(run[1].loops, config)


def test_a_family_of_before_is_refused_in_one_line(run):
    with pytest.raises(ValueError, match=r'^constant_grip is called "constant_normal_force" now; rename it$'):
        compare_families(run[1].loops, ["constant_grip"])


def test_a_users_effect_or_simulator_with_a_name_of_before_is_refused_in_one_line(tmp_path):
    effect, simulator = tmp_path / "effect.py", tmp_path / "simulator.py"
    effect.write_text(
        "import bayes_iwan as bi\nclass Late(bi.Effect):\n    def grip(self, alpha, m, v): return alpha\n"
    )
    simulator.write_text("import bayes_iwan as bi\nclass Mine(bi.Simulator):\n    stations = frozenset()\n")
    with pytest.raises(ValueError, match=r'Late\.grip is called "normal_force" now; rename it$'):
        load_effects(effect)
    with pytest.raises(ValueError, match=r'Mine\.stations is called "stages" now; rename it$'):
        load_simulator(simulator)
