"""The whole diagnosis: what it must not depend on, what it writes, and what outlives the process."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign, write_campaign
from bayes_iwan.effects.base import EffectError
from bayes_iwan.effects.catalogue import NAMES
from bayes_iwan.gap.data import gap_data
from bayes_iwan.gap.diagnosis import BASES, _finite, diagnose_loops, write_json
from bayes_iwan.gap.gap_size import gap_size
from bayes_iwan.gap.residuals import residual_of
from bayes_iwan.gap.saved_fits import LOOPS, find_shrink, stored_fits
from bayes_iwan.gap.words import sentences
from bayes_iwan.physics import Model, sine_motion


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
    return diagnose_loops(campaign, campaign.loops(**kit.small), seed=1, quick=True, config=kit.config)


def test_held_out_forces_change_nothing_of_fit_and_verdict(viscous, altered):
    """And so two runs with one seed are the same to the bit."""
    assert viscous.attribution.probabilities == altered.attribution.probabilities
    assert viscous.attribution.cause == altered.attribution.cause
    np.testing.assert_array_equal(viscous.found.base.z, altered.found.base.z)
    for name, fits in viscous.found.singles.items():
        for a, b in zip(fits, altered.found.singles[name], strict=True):
            np.testing.assert_array_equal(a.z, b.z)
            np.testing.assert_array_equal(a.log_z, b.log_z)
    assert viscous.found.pairs.keys() == altered.found.pairs.keys()
    a, b = viscous.as_dict(), altered.as_dict()
    for d in (a, b):
        for effect in d["effects"]:
            for key in [k for k in effect if "held_out" in k]:
                del effect[key]
        del d["gap"]["held_out"]
        d["sentences"] = d["sentences"][0], d["sentences"][2]
    assert _finite(a) == _finite(b)


def test_gap_on_held_out_tests_is_judged_there(viscous, altered):
    told = viscous.explanations[0].unseen
    assert told.by == "held-out tests" and told.shrink > 0.7 and told.low <= told.shrink <= told.high
    assert altered.explanations[0].unseen.shrink < 0.3  # a gain error is nothing that damping explains


def strict(value):
    """Round trip through strict JSON: no NaN, no infinity."""
    return json.loads(json.dumps(_finite(value), allow_nan=False))


@pytest.mark.parametrize("effect, plan", [("viscous_damping", "held out"), (None, "grid")])
def test_json_has_every_key_and_only_numbers_that_are_numbers(effect, plan, kit):
    d = strict(kit.diagnosed(effect, plan).as_dict())
    assert {
        "schema",
        "seed",
        "quick",
        "campaign",
        "base",
        "verdict",
        "probabilities",
        "gap",
        "where",
        "effects",
        "next_test",
        "expected_nats",
        "cannot_be_seen",
        "sentences",
    } <= set(d)
    assert set(d["verdict"]) == {"cause", "probability", "cannot_tell_apart", "second_cause", "not_testable"}
    assert set(d["probabilities"]) == {"none", "unknown", *NAMES}
    assert sum(d["probabilities"].values()) == pytest.approx(1.0, abs=1e-9)
    assert d["probabilities"][d["verdict"]["cause"]] == d["verdict"]["probability"] == max(d["probabilities"].values())
    gap = d["gap"]
    assert {
        "before_rms_N",
        "after_rms_N",
        "noise_rms_N",
        "before_share",
        "after_share",
        "shrink",
        "shrink_interval",
        "ceiling_shrink",
        "held_out",
    } <= set(gap)
    assert 0 <= gap["before_interval_N"][0] <= gap["before_rms_N"] <= gap["before_interval_N"][1]
    assert 0.0 <= gap["ceiling_shrink"] <= 1.0
    if effect is None:
        assert gap["shrink"] == 0.0 and gap["after_rms_N"] == gap["before_rms_N"] and gap["held_out"] is None
    else:
        assert gap["shrink"] > 0.8 and gap["ceiling_shrink"] > 0.8 and gap["after_share"] < 0.2 * gap["before_share"]
        held = gap["held_out"]
        assert set(held) == {"tests", "by", "before_rms_N", "after_rms_N", "shrink", "shrink_interval"}
        assert held["tests"] and held["shrink"] > 0.8
        assert held["shrink"] == d["effects"][0]["shrink_held_out"]
    assert {"tests", "regions", "harmonics"} <= set(d["where"])
    for e in d["effects"]:
        assert {
            "name",
            "with",
            "parameters",
            "log_evidence",
            "gap_after_rms_N",
            "shrink",
            "shrink_interval",
            "shrink_expected",
            "shrink_held_out",
            "held_out_by",
            "moved",
        } <= set(e)
        assert e["shrink_expected"] == e["shrink"]  # none of these has numbers of single records
        for number in e["parameters"].values():
            assert set(number) == {"mean", "sd", "q05", "q95", "unit"} and number["q05"] <= number["q95"]
    assert all(s.endswith(".") and "nan" not in s.lower().split() for s in d["sentences"])
    assert set(d["verdict"]["not_testable"]) <= set(NAMES) - {d["verdict"]["cause"]}


def test_verdict_names_the_cause_and_its_shrink(viscous):
    e = viscous.as_dict()["effects"][0]
    assert e["name"] == "viscous_damping" and e["shrink"] > 0.8 and e["gap_after_rms_N"] < 0.01
    assert e["shrink_interval"][0] <= e["shrink"] <= e["shrink_interval"][1]


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
    fits = {x.names[0]: x.fit for x in viscous.explanations}
    write_json(path / "fits.json", stored_fits(viscous.found.base, fits, viscous.found.scales, viscous.config, None))
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
    data = gap_data(read_campaign(further).loops(**LOOPS))
    before = gap_size(residual_of(data, viscous.found.base))
    after = gap_size(residual_of(data, viscous.explanations[0].fit), friction_N=before.friction_N)
    live = 1.0 - after.all.rms_N / before.all.rms_N
    assert find_shrink(folder, further, "viscous_damping") == pytest.approx(live, abs=1e-9)
    assert live > 0.7


def test_stored_fits_of_other_causes(folder, further, tmp_path):
    assert find_shrink(folder, further, "end_stop") is None
    stored = json.loads((folder / "fits.json").read_text())
    stored["with"]["viscous_damping"]["effects"][0] |= {"class": "Gone", "name": "gone"}
    (tmp_path / "fits.json").write_text(json.dumps(stored))
    with pytest.raises(EffectError, match="'gone', which is not in the catalogue"):
        find_shrink(tmp_path, further, "viscous_damping")


# ---- from a base that lacks the paper's terms


@pytest.fixture(scope="module")
def classical(kit):
    """A specimen of one gamma with varying normal force, diagnosed from the classical Iwan model."""
    model = Model(kit.reference, slip="gamma1", grip="hunt_crossley_no_speed", stiffness="constant")
    true = {
        "kp_N_mm": 5.5,
        "force_zero_N": 0.0,
        "k1_N_mm": 14.0,
        "t1_N": 0.6,
        "eta1": 2.0,
        "g1": 1.0,
        "grip_slope": 0.35,
        "beta": 0.8,
    }
    numbers = {n: np.array([v]) for n, v in true.items()}

    def force(amplitude, frequency, samples):
        return model.force(numbers, sine_motion(amplitude, frequency, samples))[0, 0]

    campaign = kit.made_up(force, [(8.0, 0.4), (20.0, 0.9)], noise_N=0.01)
    config = {"model": {**BASES["classical"], "slip": "gamma1"}}
    found = diagnose_loops(campaign, campaign.loops(n_phase=36, n_harmonics=12), quick=True, config=config)
    return SimpleNamespace(found=found, answer=strict(found.as_dict()), true=true)


def test_classical_base_names_the_term_that_it_lacks(classical):
    d = classical.answer
    assert d["verdict"]["cause"] == "varying_normal_force" and d["verdict"]["probability"] > 0.8
    assert d["terms"][0]["name"] == "varying_normal_force"
    assert d["terms"][0]["log_evidence_gain"] > 8 and d["terms"][-1]["shrink_from_base"] > 0.8
    slope = d["effects"][0]["parameters"]["slope"]
    scale = classical.found.found.scales.length_mm / 0.9  # the kit's reference length is 0.9 mm
    assert slope["mean"] == pytest.approx(0.35 * scale**0.8, abs=4 * slope["sd"] + 0.05)


def test_what_remains_beyond_the_terms_is_diagnosed_on_top_of_them(classical):
    beyond = classical.answer["beyond"]
    assert beyond["verdict"]["cause"] == "none"
    assert beyond["gap"]["before_rms_N"] < 0.3 * classical.answer["gap"]["before_rms_N"]
    assert any("varying normal force" in s for s in classical.answer["sentences"])
    assert "varying_normal_force" in classical.found.about()


def test_bases_are_models(kit):
    assert list(BASES) == ["generalized", "no_speed", "classical"]
    for table in BASES.values():
        Model(kit.reference, **table)


def test_nothing_is_called_settled_that_cannot_be_excluded(kit):
    d = kit.diagnosed(None).as_dict() | {"next_test": None}
    for apart, words in (([], "No further test is needed"), (["force_drift"], "settle whether it is force drift")):
        d["verdict"] = d["verdict"] | {"cannot_tell_apart": apart}
        assert words in sentences(d)[2]
