"""The whole diagnosis: what it must not depend on, what it writes, and what outlives the process."""

import json
import subprocess
import sys
from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from bayes_iwan.campaign import CampaignError, read_campaign, write_campaign
from bayes_iwan.diagnosis import diagnosis
from bayes_iwan.diagnosis.answer.diagnosis_json import to_dict, write_answer
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS, SavedFitsError, find_shares, read_fits, rebuilt
from bayes_iwan.diagnosis.answer.wording import strength
from bayes_iwan.diagnosis.assessment.budget import Kind
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.verdict import verdict_of
from bayes_iwan.diagnosis.diagnosis import BASES, _next, _parameters, diagnose_campaign, diagnose_loops, in_cycles
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.evidence import base_problem, fit_model, in_newtons
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.effects.base import EffectError
from bayes_iwan.effects.catalogue import NAMES
from bayes_iwan.effects.friction import FrictionFade
from bayes_iwan.files import finite, write_json
from bayes_iwan.inference.identify import identify_problem
from bayes_iwan.inference.setup.config import ConfigError
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.problem import iwan_model, make_problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models import Model


@pytest.fixture(scope="module")
def viscous(kit):
    return kit.diagnosed("viscous_damping", "held out")


@pytest.fixture(scope="module")
def altered(kit):
    """The same campaign and seed, but for the force of the held-out record."""
    virtual = kit.rig_records("viscous_damping", "held out")
    campaign = kit.campaign_of(virtual)
    tests = tuple(r if r.role == "fit" else replace(r, force_N=1.5 * r.force_N + 0.3) for r in campaign.tests)
    campaign = replace(campaign, tests=tests)
    return diagnose_loops(campaign, campaign.loops(**kit.small), seed=1, quick=True, settings=kit.settings)


def test_held_out_forces_change_nothing_of_fit_and_verdict(viscous, altered):
    """And so two runs with one seed are the same to the bit."""
    assert viscous.verdict.probabilities == altered.verdict.probabilities
    assert viscous.search.chosen == altered.search.chosen
    assert viscous.search.fits.keys() == altered.search.fits.keys()
    for key, fit in viscous.search.fits.items():
        np.testing.assert_array_equal(fit.z, altered.search.fits[key].z)
        np.testing.assert_array_equal(fit.log_z, altered.search.fits[key].log_z)
    for one, other in zip(viscous.verdict.causes, altered.verdict.causes, strict=True):
        assert one.share == other.share and one.figures == other.figures


def test_share_on_held_out_tests_is_assessed_there(viscous, altered):
    told = viscous.verdict.causes[0]
    assert told.held_out_by == "held-out tests" and told.held_out.value > 0.6
    assert told.held_out.low <= told.held_out.value <= told.held_out.high
    assert altered.verdict.causes[0].held_out.value < 0.3  # a gain error is nothing that damping explains


def strict(value):
    """Round trip through strict JSON: no NaN, no infinity."""
    return json.loads(json.dumps(finite(value), allow_nan=False))


@pytest.mark.parametrize("effect, plan", [("viscous_damping", "held out"), (None, "grid")])
def test_json_is_schema_3_and_holds_only_numbers_that_are_numbers(effect, plan, kit):
    d = strict(to_dict(kit.diagnosed(effect, plan)))
    assert d["schema"] == 3
    v = d["verdict"]
    assert v["kind"] in ("none", "explained", "partly_explained", "unknown") and isinstance(v["unknown_cause"], bool)
    assert set(d["probabilities"]) >= {"none", "unknown_cause", *NAMES}
    assert all(0.0 <= p <= 1.0 for p in d["probabilities"].values())
    for c in v["causes"]:
        assert {"name", "law", "probability", "share", "share_interval", "share_held_out", "tied_with"} <= set(c)
        assert c["share_interval"][0] <= c["share"] <= c["share_interval"][1]
        vague, left = c["share_vague"], c["gaps"]
        off = np.sqrt(vague["data"] ** 2 + vague["overlap"] ** 2 + vague["law_above"] ** 2)
        assert c["share_interval"][1] == pytest.approx(min(c["share"] + off, 1.0))
        assert left["on"] == c["held_out_by"] and 0.0 <= left["with_all"] <= min(left["without"], left["alone"]) + 1e-9
        assert c["share_held_out"] == pytest.approx(0.5 * (1 - left["alone"] + left["without"] - left["with_all"]))
        assert c["probability"] == d["probabilities"][c["name"]]
    assert sum(c["share"] for c in v["causes"]) + d["unexplained"]["share"] == pytest.approx(1.0, abs=1e-6)
    assert v["cause"] == (v["causes"][0]["name"] if v["causes"] else "none")
    gap = d["gap"]
    assert 0 <= gap["before_interval_N"][0] <= gap["before_rms_N"] <= gap["before_interval_N"][1]
    assert 0.0 <= gap["ceiling_shrink"] <= 1.0
    if effect is None:
        assert v["kind"] == "none" and v["causes"] == [] and gap["after_rms_N"] == gap["before_rms_N"]
    else:
        assert v["causes"][0]["share"] > 0.7 and gap["after_share"] < 0.3 * gap["before_share"]
        assert v["causes"][0]["share_held_out"] > 0.6
    assert {"tests", "regions", "harmonics"} <= set(d["where"])
    for e in d["effects"]:
        for number in e["parameters"].values():
            assert set(number) == {"mean", "sd", "q05", "q95", "unit"} and number["q05"] <= number["q95"]
    assert all(s.rstrip().endswith(".") and "nan" not in s.lower().split() for s in d["sentences"])
    assert not set(v["not_testable"]) & {c["name"] for c in v["causes"]}


def test_the_answers_sentence_names_the_cause_with_its_number_and_shares(viscous):
    sentence = to_dict(viscous)["sentences"][1]
    c = viscous.verdict.causes[0]
    assert not any("one frequency and one amplitude" in s for s in to_dict(viscous)["sentences"])
    assert "iscous damping" in sentence and "±" in sentence and "on held-out tests" in sentence
    assert f"{100 * c.share.value:.0f} %" in sentence


def test_a_gap_without_a_name_has_suspects(viscous):
    """Where no set but the base is probable the dashpot's gap is unknown; alone in the model it would remove it."""
    verdict = verdict_of(replace(viscous.found, sets={frozenset(): 1.0}), calibration())
    # no effect contributes: then it is none or an unknown cause
    assert verdict.probabilities["none"] + verdict.probabilities["unknown"] == pytest.approx(1.0)
    sure = viscous.verdict.probabilities
    assert sure["none"] + max(sure["viscous_damping"], sure["unknown"]) <= 1.0
    assert verdict.kind is Kind.UNKNOWN and viscous.verdict.suspects == ()
    shares = {x.name: x.share for x in verdict.suspects}
    left_N = residual_power_N(viscous, "viscous_damping") / residual_power_N(viscous)
    assert shares["viscous_damping"] == pytest.approx(1.0 - left_N, abs=0.05) and min(shares.values()) >= 0.5
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    said = to_dict(replace(viscous, verdict=verdict))
    assert said["verdict"]["suspects"][0]["name"] in shares
    assert any("viscous damping (by " in s for s in said["sentences"])


def test_beside_a_cause_that_explains_little_the_rest_has_suspects_but_not_the_named(viscous):
    """As if the dashpot, which is named, removed only a third of the gap."""
    found, named = viscous.found, frozenset({"viscous_damping"})
    sizes = dict(found.models.sizes)
    base = sizes[frozenset()]
    less = replace(base.all, rms_N=0.67 * base.all.rms_N)
    tests = tuple(replace(t, rms_N=0.67 * t.rms_N) for t in base.tests)
    sizes |= {
        k: replace(base, all=less, tests=tests, power_N2=0.45 * base.power_N2, plausible=0.45 * base.plausible)
        for k in sizes
        if named <= k
    }
    models = copy(found.models)
    models.sizes = sizes
    sure = replace(found, models=models, sets={named: 1.0})  # else the unexplained part could be all of it
    verdict = verdict_of(sure, replace(calibration(), unexplained_bias=50.0))
    assert verdict.kind is Kind.PARTLY and verdict.names == ("viscous_damping",)
    shares = {x.name: x.share for x in verdict.suspects}
    assert shares and min(shares.values()) >= 0.5 and "viscous_damping" not in shares
    assert any(
        s.startswith("Each of these would reduce the gap")
        for s in to_dict(replace(viscous, verdict=verdict))["sentences"]
    )


def test_one_record_is_said_to_show_nothing(kit):
    virtual = kit.rig_records("viscous_damping")
    campaign = replace(kit.campaign_of(virtual), tests=kit.campaign_of(virtual).tests[-1:])
    flagged = replace(calibration(), unexplained_bias=50.0)
    loops = campaign.loops(**kit.small)
    found = diagnose_loops(campaign, loops, seed=1, quick=True, settings=kit.settings, constants=flagged)
    assert not any(f.has_held_out for f in found.found.figures)
    assert any("There is one test" in s for s in found.sentences())


def test_of_two_slow_changes_of_one_record_each_is_credited_with_what_the_other_leaves(kit):
    """Friction falls by a quarter while the zero drifts by a seventh of it: neither hides the other."""
    n, loop = 40, kit.specimen_force(10.0, 0.9, 128)

    def extra(time, test):
        return (0.6 - 0.25 * np.tile(loop, n)) * time / time[-1]

    campaign = kit.made_up(kit.specimen_force, [(10.0, 0.9)], cycles=n, noise_N=0.02, extra=extra)
    (told,) = campaign.loops(**kit.small)
    assert told.noise_N[0] < 1e-3  # the drift itself is none
    found = diagnose_loops(campaign, (told,), seed=1, quick=True, settings=kit.settings)
    assert found.verdict.names == ("force_drift",)  # the record itself shows a drift; why friction falls it does not
    figures = {f.name: f for f in found.found.figures}
    drift = figures.pop("force_drift")
    (friction,) = (f for f in figures.values() if f.name in ("friction_fade", "normal_force_lag", "spring_softening"))
    assert friction.name in ("friction_fade", "normal_force_lag")  # a slow state's start is a fade as well
    assert drift.removes > 0.2 and friction.removes > 0.2


def test_a_fade_is_told_as_what_is_lost_within_the_records(kit):
    """A quarter of the force is lost along the record, evenly: so much less as its first and last blocks are means."""
    n, loop = 40, kit.specimen_force(10.0, 0.9, 128)

    def extra(time, test):
        return -0.25 * np.tile(loop, n) * time / time[-1]

    loops = kit.made_up(kit.specimen_force, [(10.0, 0.9)], cycles=n, noise_N=0.02, extra=extra).loops(**kit.small)
    data, scales = gap_data(loops), scales_of(loops)
    problem = base_problem(data, kit.settings, scales).with_effects([FrictionFade(scales)])
    fit = fit_model(data, problem, np.zeros((1, problem.ndim)))
    told = _parameters(fit, data, np.random.default_rng(0))["friction_fade"]
    name, lost = next(iter(told.items()))
    first, last = (1.0 - 0.25 * loops[0].block_cycle[i] / n for i in (0, -1))
    assert name == "lost_in_records" and lost.unit == "-"
    assert lost.mean == pytest.approx(1.0 - last / first, abs=3.0 * lost.sd) and lost.sd < 0.1 * lost.mean
    assert told["drop"].sd > 2.0 * lost.sd, "what it comes to in the end is extrapolated"


@pytest.mark.parametrize(
    "lost, said", [(0.05, " (lost in records 0.05 ± 0.01)"), (-0.03, " (regained in records 0.03 ± 0.01)")]
)
def test_what_is_regained_is_not_called_a_negative_loss(lost, said):
    assert strength({"lost_in_records": (lost, 0.01, "-")}) == said


WHERE_ROUNDING_DECIDES = {
    "loops": ("bayes_iwan.campaign.folders.folder.average", lambda campaign, loops, kit: campaign.loops(**kit.small)),
    "search": (
        "bayes_iwan.diagnosis.diagnosis.searched",
        lambda campaign, loops, kit: diagnose_loops(campaign, loops, quick=True, settings=kit.settings),
    ),
    "optimum": (
        "bayes_iwan.inference.identify.find_point",
        lambda campaign, loops, kit: identify_problem(make_problem(loops), 1, quick=True, progress=False),
    ),
}


@pytest.mark.parametrize("called, run", WHERE_ROUNDING_DECIDES.values(), ids=WHERE_ROUNDING_DECIDES)
def test_linear_algebra_has_one_thread_where_rounding_decides(called, run, kit, monkeypatch):
    """With more a long record's sums are rounded otherwise, and a search may end elsewhere: the tribometer's did."""
    campaign = kit.campaign_of(kit.rig_records("viscous_damping"))
    loops = campaign.loops(**kit.small)

    def looked(*given, **more):
        raise LookupError(*(x["num_threads"] for x in threadpool_info() if x["user_api"] == "blas"))

    monkeypatch.setattr(called, looked)
    with threadpool_limits(limits=2, user_api="blas"), pytest.raises(LookupError) as seen:
        run(campaign, loops, kit)
    assert set(seen.value.args) == {1}


def residual_power_N(found, *names):
    fit = in_newtons(found.data, found.search.fits[frozenset(names)])
    return float(np.sqrt(gap_power_N2(residual_of(found.data, fit)).mean()))


def test_numbers_that_are_not_finite_become_null(tmp_path):
    write_json(tmp_path / "new" / "x.json", {"a": np.float64("nan"), "b": (np.inf, np.int64(2)), 3: np.bool_(True)})
    assert json.loads((tmp_path / "new" / "x.json").read_text()) == {"a": None, "b": [None, 2], "3": True}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["x.json"]


def test_nothing_to_fit_is_said(kit):
    campaign = kit.made_up(kit.specimen_force, [(10.0, 0.4)], roles={0: "held-out"})
    with pytest.raises(ValueError, match="no test is left to fit"):
        diagnose_loops(campaign, campaign.loops(**kit.small))


# ---- fits that outlive the process


@pytest.fixture(scope="module")
def folder(viscous, tmp_path_factory):
    path = tmp_path_factory.mktemp("diagnosis")
    write_answer(viscous, path)
    return path


@pytest.fixture(scope="module")
def further(kit, tmp_path_factory):
    """Tests that the diagnosis has not seen, as a campaign folder."""
    path = tmp_path_factory.mktemp("further")
    records = [
        replace(r, role="fit") for r in kit.rig_records("viscous_damping", "held out").records if r.role == "held-out"
    ]
    write_campaign(path, name="further", description="", tests=records)
    return path


def test_stored_fits_predict_as_the_live_ones_do(viscous, folder, further):
    """In a process of their own, as they are used: there they outlive this one."""
    data, live = gap_data(read_campaign(further).loops(**LOOPS)), viscous.found.models.nearest
    stored, named = read_fits(folder / "fits.json"), frozenset(viscous.verdict.names)
    gap = {}
    for names, one in stored.fits.items():
        now, then = (residual_of(data, f, refitted=False) for f in (rebuilt(stored, one, data), live[names]))
        np.testing.assert_allclose(now.value, then.value, atol=1e-9)
        gap[names] = float(np.sqrt(max(gap_power_N2(then).mean(), 0.0)))
    code = (
        "import sys, json; from pathlib import Path; from bayes_iwan.diagnosis.answer.saved_fits import find_shares; "
        "print(json.dumps(find_shares(*map(Path, sys.argv[1:]))))"
    )
    out = subprocess.run([sys.executable, "-c", code, folder, further], capture_output=True, text=True, check=True)
    parts = json.loads(out.stdout)
    whole = sum(parts.values())
    assert whole == pytest.approx(1.0 - gap[named] / gap[frozenset()], abs=1e-9)
    assert whole > 0.6 and set(parts) == set(named)


def test_stored_fits_that_cannot_be_used_are_refused_in_one_line(folder, further, tmp_path):
    with pytest.raises(SavedFitsError, match=r"fits\.json: cannot be read"):
        find_shares(tmp_path, further)
    (tmp_path / "fits.json").write_text('{"schema": 2, "scales"')
    with pytest.raises(SavedFitsError, match="damaged"):
        find_shares(tmp_path, further)
    stored = json.loads((folder / "fits.json").read_text())
    for other in (stored | {"schema": 1}, {k: v for k, v in stored.items() if k != "schema"}, []):
        (tmp_path / "fits.json").write_text(json.dumps(other))
        with pytest.raises(SavedFitsError, match="not fits of this version"):
            find_shares(tmp_path, further)
    stored["fits"]["viscous_damping"]["effects"][0] |= {"class": "Gone", "name": "gone"}
    (tmp_path / "fits.json").write_text(json.dumps(stored))
    with pytest.raises(EffectError, match="'gone', which is not in the catalogue"):
        find_shares(tmp_path, further)
    stored["effects_file"] = "/tmp/some.py"
    (tmp_path / "fits.json").write_text(json.dumps(stored))
    with pytest.raises(SavedFitsError, match="not run unasked"):
        find_shares(tmp_path, further)


# ---- from a base that lacks the paper's terms


@pytest.fixture(scope="module")
def classical(kit):
    """A specimen of one gamma with varying normal force, diagnosed from the classical Iwan model."""
    model = Model(kit.reference, slip="gamma1", normal_force="hunt_crossley_no_speed", stiffness="constant")
    true = {
        "kp_N_mm": 5.5,
        "force_zero_N": 0.0,
        "k1_N_mm": 14.0,
        "t1_N": 0.6,
        "eta1": 2.0,
        "g1": 1.0,
        "normal_force_slope": 0.35,
        "beta": 0.8,
    }
    force = kit.force_of(model, {n: np.array([v]) for n, v in true.items()})
    campaign = kit.made_up(force, [(8.0, 0.4), (20.0, 0.9)], noise_N=0.01)
    settings = DiagnoseSettings(replace(BASES["classical"], slip="gamma1"))
    found = diagnose_loops(campaign, campaign.loops(n_phase=36, n_harmonics=12), quick=True, settings=settings)
    return SimpleNamespace(found=found, answer=strict(to_dict(found)), true=true)


def test_classical_base_names_the_term_that_it_lacks(classical):
    d = classical.answer
    assert "varying_normal_force" in {c["name"] for c in d["verdict"]["causes"]}
    cause = next(c for c in d["verdict"]["causes"] if c["name"] == "varying_normal_force")
    assert cause["share"] > 0.6 and cause["probability"] > 0.8
    slope = next(e for e in d["effects"] if e["name"] == "varying_normal_force")["parameters"]["slope"]
    scale = classical.found.search.scales.length_mm / 0.9  # the kit's reference length is 0.9 mm
    assert slope["mean"] == pytest.approx(0.35 * scale**0.8, abs=4 * slope["sd"] + 0.05)
    assert "varying_normal_force" in classical.found.search.effects


def test_bases_are_models(kit):
    assert list(BASES) == ["generalized", "no_speed", "classical"]
    terms = [set(iwan_model(kit.scales, parts).names) for parts in BASES.values()]
    assert terms[0] > terms[1] > terms[2]


@pytest.mark.parametrize("given", [{"simulator": "own.py"}, {"config": DiagnoseSettings()}])
def test_a_base_beside_another_choice_of_a_model_is_refused_before_anything_is_read(given):
    with pytest.raises(ConfigError, match=f"base classical and {next(iter(given))} both choose a model"):
        diagnose_campaign("nowhere", base="classical", **given)
    for allowed in ({"base": "classical"}, given):
        with pytest.raises(CampaignError, match="nowhere"):
            diagnose_campaign("nowhere", **allowed)


def test_the_next_test_is_between_a_cause_and_what_explains_the_data_nearly_as_well(monkeypatch):
    """Of the effect that moves most; where no other one comes near, between it and none while that is in question."""
    monkeypatch.setattr(diagnosis, "next_test", lambda data, *fits_and_pair: fits_and_pair[:3])
    monkeypatch.setattr(diagnosis, "refused", lambda figures: "")
    search = SimpleNamespace(chosen=("drag", "play"), effects={}, fit=lambda names: "+".join(sorted(names)))
    fits = {frozenset(x): "+".join(x) for x in (("drag",), ("play",), ("drag", "play"))}
    far = -2.0 * calibration().apart
    near = {"lag": 0.5 * far * 0.9, "play": 0.0, "mass": -0.1, "wave": far}

    def planned(drag, play, sure=0.5):
        figures = [SimpleNamespace(name=n, moved=m, odd=False, alternatives=a) for n, m, a in (drag, play)]
        found = SimpleNamespace(
            search=search, figures=figures, asked=frozenset(search.chosen), models=SimpleNamespace(fits=fits)
        )
        names = ("drag", "play")
        verdict = SimpleNamespace(kind=Kind.EXPLAINED, one_of=(), names=names, probabilities=dict.fromkeys(names, sure))
        return _next(None, found, verdict, calibration(), SimpleNamespace(limits=None))

    two = (("drag", 1.0, {}), ("play", 2.0, near))
    assert planned(*two) == ("drag+play", "drag+mass", ("play", "mass"))
    assert planned(("drag", 3.0, {"wave": far}), two[1]) == ("drag+play", "play", ("drag", "none"))
    assert planned(("drag", 3.0, {}), two[1], sure=0.95)[2] == ("play", "mass")
    assert planned(("drag", 3.0, {}), ("play", 2.0, {}), sure=0.95) is None


def test_without_a_clock_numbers_are_in_cycles(kit):
    assert [in_cycles(u) for u in ("s", "s/m", "N/mm", "-", "")] == ["cycles", "cycles/m", "N/mm", "-", ""]
    found = kit.diagnosed("viscous_damping", "held out")
    records = tuple(replace(x, record=replace(x.record, clock=False)) for x in found.data.loops)
    data, rng = SimpleNamespace(loops=records, block_motion=found.data.block_motion), np.random.default_rng(1)
    said = _parameters(found.fit, data, rng)["viscous_damping"]["c_N_s_mm"]
    assert (found.parameters["viscous_damping"]["c_N_s_mm"].unit, said.unit) == ("N·s/mm", "N·cycles/mm")
