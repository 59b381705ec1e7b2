"""What tests could have shown, and which would show more."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.campaign.recording.limits import RigLimits
from bayes_iwan.diagnosis import diagnosis
from bayes_iwan.diagnosis.answer import next_test as next_test_module
from bayes_iwan.diagnosis.answer.next_test import TESTABLE_NATS, next_test, plans_of, visible_nats
from bayes_iwan.diagnosis.assessment.budget import Kind
from bayes_iwan.diagnosis.assessment.calibration import coarsening
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.models import sine_motion

CHOSEN = ("viscous_damping", "moving_mass", "rig_compliance", "friction_fade")


@pytest.fixture(scope="module")
def nats(kit):
    """Expected nats of some effects at two frequencies and at one of them."""
    found = kit.diagnosed(None).search
    effects = {n: found.effects[n] for n in CHOSEN}
    one = gap_data(found.data.loops[:2])
    base = fit_base(one, kit.settings, found.scales, np.random.default_rng(2))
    return visible_nats(found.data, found.base, effects), visible_nats(one, base, effects)


def test_effects_with_a_shape_of_their_own_could_have_been_seen(nats):
    both, _ = nats
    for name in ("viscous_damping", "moving_mass", "friction_fade"):
        assert both[name] > TESTABLE_NATS
    assert both["rig_compliance"] < both["viscous_damping"]


def test_one_frequency_cannot_show_a_mass(nats):
    both, one = nats
    assert one["moving_mass"] < 0.2 * both["moving_mass"]


def test_next_test_separates_two_models_within_reach(kit):
    found = kit.diagnosed("channel_delay").search
    delay, base = found.fit({"channel_delay"}), found.base
    plan = next_test(found.data, delay, base, ("channel_delay", "none"), ["bench action"], RigLimits())
    f, a = [x.frequency_hz for x in found.data.loops], [x.amplitude_mm for x in found.data.loops]
    # nothing is stated of the rig: the range measured, to three digits
    assert 0.995 * min(f) <= plan.frequency_hz <= 1.005 * max(f)
    assert 0.995 * min(a) <= plan.amplitude_mm <= 1.005 * max(a)
    assert plan.expected_log_odds > 0.3 and plan.bench == "" and plan.cycles >= 20
    assert plan.separates == ("channel_delay", "none")


class WithoutForce:
    """A problem that has no force at higher frequencies than one."""

    def __init__(self, problem, most_hz):
        self.problem, self.most_hz = problem, most_hz

    def __getattr__(self, name):
        return getattr(self.problem, name)

    def force(self, values, motion):
        there = (motion.frequency_hz <= self.most_hz)[:, None]
        return np.where(there, self.problem.force(values, motion), np.nan)


def test_a_test_in_which_a_model_has_no_force_is_not_proposed(kit, monkeypatch):
    found = kit.diagnosed("channel_delay").search
    monkeypatch.setattr(next_test_module, "quick_gap_N", lambda *given: 0.0)
    delay, asked = found.fit({"channel_delay"}), (("channel_delay", "none"), ["do this"], RigLimits())
    best = next_test(found.data, delay, found.base, *asked)
    lower = replace(found.base, problem=WithoutForce(found.base.problem, 0.9 * best.frequency_hz))
    other = next_test(found.data, delay, lower, *asked)
    assert other.frequency_hz < best.frequency_hz and 0.0 < other.expected_log_odds < best.expected_log_odds
    none = next_test(found.data, delay, replace(found.base, problem=WithoutForce(found.base.problem, 0.0)), *asked)
    assert none.expected_log_odds == 0.0 and none.bench == "do this"


def test_the_odds_of_a_further_test_count_as_those_of_the_tests_do(kit):
    """By the power with which scores of one test more do."""
    found = kit.diagnosed("channel_delay").search
    asked = found.data, found.fit({"channel_delay"}), found.base, ("channel_delay", "none"), [""], RigLimits()
    plan = next_test(*asked)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(next_test_module, "coarsening", lambda tests: float(tests))
        assert next_test(*asked).expected_log_odds == pytest.approx(
            plan.expected_log_odds / coarsening(found.data.tests + 1) * (found.data.tests + 1)
        )


def test_what_the_slip_forces_imitate_is_not_testable(kit):
    assert "rig_compliance" in kit.diagnosed(None).not_testable


def test_where_no_test_separates_the_bench_is_named(kit):
    found = kit.diagnosed("channel_delay").search
    actions = ["do this", "", "do that", "do this"]
    plan = next_test(found.data, found.base, found.base, ("a", "b"), actions, RigLimits())
    assert plan.expected_log_odds == 0.0 and plan.bench == "do this; or do that"


def test_a_test_that_was_run_is_not_proposed(kit):
    found = kit.diagnosed("channel_delay").search
    asked = found.data, found.fit({"channel_delay"}), found.base, ("channel_delay", "none")
    weak = RigLimits(1e-6, None, None)  # the gentlest test that was run is all that remains
    assert next_test(*asked, ["turn it round", ""], weak).bench == "turn it round"
    assert "rig" in next_test(*asked, [""], weak).bench


def test_a_plan_keeps_to_what_the_rig_can_do(kit):
    found = kit.diagnosed("channel_delay").search
    f, a = [x.frequency_hz for x in found.data.loops], [x.amplitude_mm for x in found.data.loops]
    wide = np.array(plans_of(found.data, found.base, RigLimits(1e6, 2.0 * max(a), (0.5 * min(f), 2.0 * max(f)))))
    assert wide[:, 0].max() == pytest.approx(2.0 * max(f)) and wide[:, 1].max() == pytest.approx(2.0 * max(a))
    assert wide[:, 0].min() == pytest.approx(0.5 * min(f)) and wide[:, 1].min() == pytest.approx(0.5 * min(a))
    force = max(float(np.abs(x.force_N).max()) for x in found.data.loops)
    weak = plans_of(found.data, found.base, RigLimits(0.5 * force, 2.0 * max(a), None))
    assert 0 < len(weak) < len(wide)
    motion = sine_motion(frequency_hz=[p[0] for p in weak], amplitude_mm=[p[1] for p in weak])
    base = found.base.problem
    assert np.abs(base.force(base.parameter_values(found.base.z[None]), motion)).max() < 0.52 * force
    (only,) = plans_of(found.data, found.base, RigLimits(1e-6, None, None))
    assert only[1] == min(a)


def test_where_all_tests_are_alike_smaller_and_slower_ones_are_planned(kit):
    found = kit.diagnosed("channel_delay").search
    loop = found.data.loops[-1]
    one = gap_data([loop])
    plans = np.array(plans_of(one, found.base, RigLimits()))
    assert plans[:, 0].min() == pytest.approx(0.5 * loop.frequency_hz) and plans[:, 0].max() <= loop.frequency_hz + 1e-9
    assert plans[:, 1].min() == pytest.approx(0.5 * loop.amplitude_mm) and plans[:, 1].max() <= loop.amplitude_mm + 1e-9
    stated = plans_of(one, found.base, RigLimits(frequency_hz=(1.0, 2.0)))
    assert {a for _, a in stated} == {loop.amplitude_mm}  # what is stated of the rig is all that is run


def test_two_models_that_both_miss_much_promise_less(kit, monkeypatch):
    found = kit.diagnosed("channel_delay").search
    asked = found.data, found.fit({"channel_delay"}), found.base, ("channel_delay", "none"), [], RigLimits()
    odds = next_test(*asked).expected_log_odds
    monkeypatch.setattr(next_test_module, "quick_gap_N", lambda data, fit: 0.5 * float(np.median(data.level_N)))
    assert 0.0 < next_test(*asked).expected_log_odds < 0.1 * odds


def test_rivals_are_compared_beside_all_that_was_chosen(monkeypatch):
    fits = {frozenset("ab"): "chosen", frozenset("cb"): "rival", frozenset("b"): "without"}
    place = Figures("a", 50.0, {"a": 0.0, "c": -2.0}, 0.4, 0.4, 0.4, moved=0.1, before=0.1, tests=4)
    search = SimpleNamespace(chosen=("a", "b"), fit=lambda names: fits[frozenset(names)], effects={})
    found = SimpleNamespace(search=search, figures=(place,))
    constants = SimpleNamespace(apart=30.0)
    monkeypatch.setattr(diagnosis, "next_test", lambda data, *asked: asked[:3])
    campaign = SimpleNamespace(limits=None)
    verdict = SimpleNamespace(kind=Kind.EXPLAINED, one_of=(), names=("a",), probabilities={"a": 0.99})
    assert diagnosis._next(None, found, verdict, constants, campaign) == ("chosen", "rival", ("a", "c"))
    found.figures, verdict.probabilities = (replace(place, alternatives={"a": 0.0}),), {"a": 0.8}
    assert diagnosis._next(None, found, verdict, constants, campaign) == ("chosen", "without", ("a", "none"))
    verdict.names = ()
    for change in ({"odd": "it is too slow"}, {"held_out": 0.0}, {"fitted": 1e-3}):  # what no sentence says
        found.figures, verdict.one_of, verdict.probabilities = (replace(place, **change),), (), {"a": 0.25}
        assert diagnosis._next(None, found, verdict, constants, campaign) is None
        verdict.one_of = (SimpleNamespace(names=("a", "c")),)
        assert diagnosis._next(None, found, verdict, constants, campaign) == ("chosen", "rival", ("a", "c"))
