"""The studies in `analyses/` at their smallest: that they run from end to end, and that their own parts are right."""

import csv
import json
import pickle
import sys
from importlib import import_module as study
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.campaign import Record
from bayes_iwan.diagnosis.assessment import verdict
from bayes_iwan.inference.identify import QUICK_SEARCH
from bayes_iwan.virtual_rig.faults import FAMILY, OUTSIDE
from bayes_iwan.withheld import true_gaps

ROOT = Path(__file__).parents[2]


def record(f, n=20_000, cycles=30):
    """A parallel spring of 5 N/mm and a Coulomb-like friction of 1 N."""
    t = np.arange(n) / (n / cycles * f)
    u = 0.5 * np.sin(2 * np.pi * f * t)
    friction = np.tanh(np.cos(2 * np.pi * f * t) / 0.1)
    return Record(f"f{f:g}.csv", f, 0.5, "fit", {}, t, u, 5.0 * u + friction + 0.2)


def test_kept_runs_once_and_shares_work_in_order(tmp_path):
    runs = study("runs")
    calls = []

    def work(x):
        calls.append(x)
        return x * x

    jobs = [(tmp_path / "a" / f"{i}.json", work, i) for i in range(3)]
    assert list(runs.each(jobs, 1)) == [0, 1, 4]
    assert list(runs.each(jobs, 1)) == [0, 1, 4]
    assert calls == [0, 1, 2]


@pytest.mark.parametrize("effect", ("channel_delay", "force_highpass", "friction_fade"))
def test_effects_put_into_records_have_the_size_asked_for(effect):
    half_real = study("half_real")
    tests = (record(5.0), record(12.0))
    strength = half_real.strength_for(tests, effect, 0.1)
    assert half_real.size(tests, effect, strength) == pytest.approx(0.1, rel=1e-3)


def test_a_natural_budget_is_unchanged_in_newtons():
    half_real = study("half_real")

    def answer(gap_N, causes, one_of=()):
        some = [{"name": n, "share": v, "share_interval": [v - 0.05, v + 0.05], "tied_with": []} for n, v in causes]
        tied = [{"names": n, "share": v} for n, v in one_of]
        return {"gap": {"before_rms_N": gap_N}, "verdict": {"causes": some, "one_of": tied}}

    natural = answer(2.0, [("fade", 0.4), ("viscous", 0.2), ("play", 0.04), ("mass", 0.3)])
    # twice the gap: 0.2 of it is what 0.4 was, 0.2 is 0.4 instead of 0.2
    found = answer(4.0, [("fade", 0.2), ("viscous", 0.2)], [(["mass", "delay"], 0.14)])
    fade, viscous, play, mass = half_real.budget_kept(found, natural)
    assert fade == {"named": True, "named or in a set": True, "newtons unchanged": True}
    assert viscous == {"named": True, "named or in a set": True, "newtons unchanged": False}
    assert play == {"named": False, "named or in a set": False, "newtons unchanged": True}  # lost, but it was small
    assert mass == {"named": False, "named or in a set": True, "newtons unchanged": True}
    assert not half_real.undone(found, natural) and half_real.undone(answer(1.7, []), natural)


def test_effects_put_into_records_do_what_they_say():
    half_real = study("half_real")
    x = record(5.0)
    inner = slice(2000, -2000)
    late = half_real.changed(x, "channel_delay", 2e-3)
    assert late.force_N[inner] == pytest.approx(np.interp(x.time_s - 2e-3, x.time_s, x.force_N)[inner])
    heavy = half_real.changed(x, "moving_mass", 0.01)
    true = -0.01 * (2 * np.pi * 5.0) ** 2 * x.displacement_mm * 1e-3
    assert (heavy.force_N - x.force_N)[inner] == pytest.approx(true[inner], abs=0.01 * np.abs(true).max())
    ac = half_real.changed(x, "force_highpass", 0.5)
    assert abs(np.mean(ac.force_N[len(ac.force_N) // 2 :])) < 0.02  # 0.2 N before
    lead = half_real.changed(x, "integration_highpass", 0.5)
    late_half = slice(len(x.time_s) // 2, None)
    turn = np.exp(-2j * np.pi * 5.0 * x.time_s[late_half])
    phase = np.angle((turn @ lead.displacement_mm[late_half]) / (turn @ x.displacement_mm[late_half]))
    assert phase == pytest.approx(np.arctan(0.5 / 5.0), rel=0.03)
    faded = half_real.changed(x, "friction_fade", 0.3)
    friction = faded.force_N - 0.2 - 5.0 * x.displacement_mm
    assert np.abs(friction[-700:]).max() == pytest.approx(1.0 - 0.3 * (1.0 - np.exp(-4.0)), abs=0.02)
    with pytest.raises(ValueError, match="no effect 'magic'"):
        half_real.changed(x, "magic", 1.0)


def test_plan_puts_into_a_source_only_what_means_something_there():
    half_real = study("half_real")
    cases = half_real.plan(48, 0)
    assert len(cases) == 48 and half_real.plan(20, 0) == cases[:20]
    assert all(source.startswith("damper") for source, effect, _ in cases if effect == "moving_mass")
    assert all(source != "microtribometer" for source, effect, _ in cases if effect == "friction_fade")
    assert {effect for _, effect, _ in cases} == set(half_real.EFFECTS)
    assert all(half_real.SIZES[0] <= size <= half_real.SIZES[1] for *_, size in cases)


def test_a_half_real_answer_is_right_where_what_was_added_is_named_or_moves_another_force():
    assessed = study("half_real").assessed

    def answer(effect, *together, gap=1.0, along=0.2, suspects=(), **strengths):
        return {
            "effect": effect,
            "gap": {"before_rms_N": gap, "along_record_rms_N": along},
            "verdict": {
                "causes": [{"name": n, "share": 0.2, "tied_with": []} for n in strengths],
                "one_of": [{"names": list(together), "share": 0.2}] if together else [],
                "suspects": [{"name": n, "share": 0.6} for n in suspects],
            },
            # a number that stays as it is, known to a tenth: only the force that is moved tells
            "effects": [
                {"name": n, "moved_share": 0.1 * v, "parameters": {"x": {"mean": -3.0, "sd": 0.3}}}
                for n, v in strengths.items()
            ],
        }

    natural = answer("", channel_delay=1.0)
    assert assessed(answer("moving_mass", channel_delay=1.0, moving_mass=2.0), natural)["named"]
    little = assessed(answer("channel_delay", channel_delay=1.1), natural)
    assert not little["named"] and little["named, or named as before"]
    assert assessed(answer("channel_delay", channel_delay=2.0), natural)["named"]
    assert not assessed(answer("moving_mass", moving_mass=2.0), natural)["natural causes still named"]
    among = assessed(answer("moving_mass", "moving_mass", "channel_delay"), natural)
    assert not among["named"] and among["named or in the set"] and among["natural causes still named"]
    assert "named, visible ones" not in among  # as much is missed without it
    for seen in ({"gap": 1.2}, {"along": 0.3}):
        assert assessed(answer("moving_mass", moving_mass=2.0, **seen), natural)["named, visible ones"]
        assert not assessed(answer("moving_mass", **seen), natural)["named or in the set, visible ones"]
    suspected = assessed(answer("moving_mass", suspects=("moving_mass",)), natural)
    assert suspected["named, in the set or suspected"] and not suspected["named or in the set"]


@pytest.fixture(scope="module")
def kept(kit):
    """A study's case of a diagnosed campaign, through a pickle, and the diagnosis."""

    def made(effect, kind):
        d = kit.diagnosed(effect)
        given = [{"name": effect, "size": 0.12, "visible_share": 0.9, "share": 0.9}] if effect else []
        case = study("study_cases").Case(f"0_{kind}.pickle", kind, "", {"effects": given}, d.found, 1.0)
        return pickle.loads(pickle.dumps(case)), d

    return made


def test_true_shares_of_what_is_named_and_of_all_faults():
    """Two faults whose gaps add in squares, 3 and 4 N: without the first 4 of 5 N are left, which is a fifth less."""
    gap_N = {frozenset(k): v for k, v in {"": 0.0, "a": 3.0, "b": 4.0, "ab": 5.0}.items()}
    assert true_gaps.removed(gap_N, frozenset("a")) == pytest.approx({"a": 0.2})
    assert true_gaps.removed(gap_N, frozenset("b")) == pytest.approx({"b": 0.4})
    assert true_gaps.removed(gap_N, frozenset("ab")) == pytest.approx({"a": 0.4, "b": 0.6})
    assert true_gaps.removed({}, "a") == {"a": 0.0}
    assert true_gaps.by_set(true_gaps.by_name(gap_N)) == {frozenset(k): v for k, v in gap_N.items()}


@pytest.mark.parametrize(("effect", "kind"), [("viscous_damping", "single"), (None, "none")])
def test_a_study_says_what_ships(kept, effect, kind, monkeypatch):
    cases_of, (case, d) = study("study_cases"), kept(effect, kind)
    c = study("calibrate_diagnosis").calibration()
    a = cases_of.answer(case.assessed(), c)
    assert a.named == {*d.verdict.names} and a.unknown == d.verdict.probabilities["unknown"]
    assert a.probabilities == {n: d.verdict.probabilities[n] for n in a.probabilities}
    assert a.shares == {x.name: x.share for x in d.verdict.causes}
    found = cases_of.counts(case, a)
    assert found["false names, all cases"] == (False, 1)
    assert found["singles named" if effect else "alarms, sound"] == (bool(effect), 1)
    monkeypatch.setattr(verdict, "PROBABLE", 1.0)
    assert cases_of.answer(case, c).named == frozenset()  # whatever the package would not name


def test_constants_are_fitted_to_what_is_left_with_families_left_out(monkeypatch):
    calibrate, cases_of = study("calibrate_diagnosis"), study("study_cases")
    gap = SimpleNamespace(all=SimpleNamespace(resolved_share=0.05))
    found = SimpleNamespace(models=SimpleNamespace(sizes={frozenset(): gap}))

    def case(i):
        kind = ("single", "none", "outside")[i % 3]
        name = {"single": "moving_mass", "outside": "rocking"}.get(kind)
        effects = [{"name": name, "size": 0.05, "visible_share": 0.9}] if name else []
        return cases_of.Case(f"{kind}.pickle", kind, "cycle" * (i % 3 == 2), {"effects": effects}, found, 1.0)

    def answer(case, c):
        named, left = case.true - case.foreign, 0.05 if case.foreign else 0.002
        return cases_of.Answer(named, named, dict.fromkeys(named, 0.9), c.unknown_cause(left), left)

    monkeypatch.setattr(calibrate, "answer", answer)
    cases = [case(i) for i in range(60)]
    c = calibrate.fitted(cases, calibrate.answers(cases, [calibrate.calibration()] * len(cases)))
    assert c.unexplained > 0.0
    for constants in ([c] * len(cases), calibrate.held_out_in_turn(cases)):
        given = calibrate.answers(cases, constants)
        found = cases_of.summed([cases_of.counts(case, a) for case, a in zip(cases, given)])
        assert found["singles named"] == (20.0, 20.0)
        assert found["false names, all cases"] == (0.0, 60.0)
        assert found["alarms, sound"] == (0.0, 20.0)
        assert found["foreign flagged"] == (20.0, 20.0)


def test_an_ablation_changes_one_thing_and_puts_it_back(kept, tmp_path, monkeypatch):
    ablate = study("ablate_diagnosis")
    for effect, kind in (("viscous_damping", "single"), (None, "none")):
        (tmp_path / f"0_{len(kind)}.pickle").write_bytes(pickle.dumps(kept(effect, kind)[0]))
    some = {k: v for k, v in ablate.switched_off().items() if "places" in k or "held" in k or "whole" in k}
    monkeypatch.setattr(ablate, "switched_off", lambda: some | {"PROBABLE 1": [(ablate.verdict, "PROBABLE", 1.0)]})
    files = [str(x) for x in tmp_path.glob("*.pickle")]
    monkeypatch.setattr(sys, "argv", ["ablate_diagnosis.py", "assessment", *files, "--out", str(tmp_path / "a.csv")])
    ablate.main()
    rows = {r["without"]: r for r in csv.DictReader((tmp_path / "a.csv").open())}
    assert rows["nothing"]["right change"] == "+0.0 (+0.0 to +0.0)" and rows["nothing"]["right"] == "1.0"
    assert rows["PROBABLE 1"]["right"] == "0.0" and ablate.verdict.PROBABLE < 1.0
    assert len(rows) == len(some) + 2 == 5


def test_draws_of_a_study_hold_every_foreign_kind_and_the_own_model():
    draws = study("study_draws")
    kinds = draws.plan(1, 1)
    assert {f for k, f in kinds if k == "outside"} == set(OUTSIDE)
    assert len(set(FAMILY.values())) >= 12 and draws.plan(1, 1) == kinds
    own = draws.own_model(np.random.default_rng(0))
    assert own["truth"]["effects"] == [] and max(r.amplitude_mm for r in own["records"]) > 0.4


def test_uniform_ranks_pass_and_bent_ones_do_not():
    sbc = study("sbc")
    rng = np.random.default_rng(1)
    flat = sbc.uniformity(rng.integers(0, sbc.RANKED + 1, 400))
    bent = sbc.uniformity((sbc.RANKED * rng.beta(2, 2, 400)).astype(int))
    assert min(flat.values()) > 0.01
    assert max(bent.values()) < 0.01


@pytest.mark.usefixtures("few_quick_walkers")
@pytest.mark.parametrize("way", [["--budget", "1"], ["--from-truth"]])
def test_simulation_based_calibration_runs(tmp_path, monkeypatch, way):
    monkeypatch.chdir(ROOT)
    model = ["--likelihoods", "gaussian", "--slip", "uniform", "--tests", "0", "8"]
    monkeypatch.setattr(sys, "argv", ["sbc.py", "--draws", "1", *model, *way, "--out", str(tmp_path)])
    monkeypatch.setattr(study("sbc"), "SearchSettings", lambda: QUICK_SEARCH)
    study("sbc").main()
    result = json.loads((tmp_path / "sbc.json").read_text())["likelihoods"]["gaussian"]
    assert set(result["ranks"]) >= {"kp_N_mm", "k1_N_mm", "mean_slip_force_N", "noise_N", "energy[f10_a0.3]"}
    assert all(len(ranks) == 1 and 0 <= ranks[0] <= 63 for ranks in result["ranks"].values())
    assert (tmp_path / "sbc.png").stat().st_size > 5000


@pytest.mark.usefixtures("small_design", "few_quick_walkers")
def test_coverage_on_the_rig_runs(tmp_path, monkeypatch):
    ways = ["--kind", "exact", "--forms", "plain", "--draws", "sampled", "quick"]
    asked = ["coverage_rig.py", "--cases", "1", "--budget", "1", "--out", str(tmp_path), *ways]
    monkeypatch.setattr(sys, "argv", asked)
    study("coverage_rig").main()
    tables = json.loads((tmp_path / "coverage.json").read_text())["tables"]
    assert len(tables) == 4  # each also as drawn
    for table in tables.values():
        assert set(table["all"]["held"]["energy"]) <= set(range(101)) and table["median_width"]["kp_N_mm"] > 0.0
    assert (tmp_path / "coverage_exact_plain_sampled.png").stat().st_size > 5000
