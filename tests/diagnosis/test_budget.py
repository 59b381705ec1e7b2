"""The budget's arithmetic against closed forms, the rules that refuse a name, and the calibration's promises."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.diagnosis.answer.wording import title
from bayes_iwan.diagnosis.assessment.budget import Gaps, Vague, gaps_of, shares_of, subsets, vagueness
from bayes_iwan.diagnosis.assessment.calibration import (
    Calibration,
    any_of,
    calibration,
    set_probabilities,
)
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.assessment.verdict import (
    beside_unlisted,
    contributing,
    large_enough,
    named_by,
    one_of,
    refused,
    resembled,
    unknown_cause_probability,
)
from bayes_iwan.diagnosis.constants import (
    ALIKE_NATS,
    COARSENED,
    EFFECT_NATS,
    REFUSED,
    SUREST,
    USUAL_GAP,
)
from bayes_iwan.diagnosis.fits.gap_size import Share
from bayes_iwan.diagnosis.search.base_fit import gap_rms_N, newton_nats, quick_gap_N
from bayes_iwan.diagnosis.search.search_result import score


def sets(**values):
    """By set of effects: "a_b" for two, "none" for none."""
    return {frozenset(k.split("_")) if k != "none" else frozenset(): v for k, v in values.items()}


def test_subsets_are_all_of_them_the_empty_one_first():
    assert subsets("ba") == [frozenset(), frozenset("a"), frozenset("b"), frozenset("ab")]
    assert len(subsets("abcd")) == 16


def test_shares_of_effects_that_do_not_overlap_are_their_own_parts():
    found = shares_of("ab", sets(none=1.0, a=0.7, b=0.5, a_b=0.2))
    assert found == pytest.approx({"a": 0.3, "b": 0.5})


def test_what_two_effects_explain_alike_is_halved_and_makes_the_interval_wide():
    """Either removes 0.8 of the gap, both together no more."""
    gap = sets(none=1.0, a=0.2, b=0.2, a_b=0.2)
    assert shares_of("ab", gap) == pytest.approx({"a": 0.4, "b": 0.4})
    of = gaps_of("ab", {k: np.full(4, v**2) for k, v in gap.items()})["a"]
    assert (of.with_all, of.without, of.alone, of.sd) == pytest.approx((0.2, 0.2, 0.2, 0.0))
    assert of.share == pytest.approx(0.4) and of.overlap == pytest.approx(0.4)
    assert (of.measured.low, of.measured.high) == pytest.approx((0.0, 0.8))


def test_a_share_varies_as_its_tests_do():
    """One effect: each test's gap is 1 N, and 0.1 or 0.5 N with it."""
    power = {frozenset(): np.ones(4), frozenset("a"): np.array([0.01, 0.25, 0.01, 0.25])}
    of = gaps_of("a", power)["a"]
    kept = [np.sqrt(np.delete(power[frozenset("a")], t).mean()) for t in range(4)]
    assert of.sd == pytest.approx(np.sqrt(0.75 * np.sum((np.array(kept) - np.mean(kept)) ** 2)))
    assert of.first == of.last == pytest.approx(1.0 - np.sqrt(0.13))
    assert of.measured.high - of.share == pytest.approx(1.645 * of.sd)


def test_the_interval_of_a_share_is_made_of_its_three_parts():
    """What the law's form leaves open, less on held-out tests and what is unexplained, is added to what is chance."""
    fitted, held_out = Gaps(0.3, 0.9, 0.4, 0.05), Gaps(0.5, 0.9, 0.6, 0.02)
    vague = vagueness(fitted, held_out)
    assert fitted.share == pytest.approx(0.6) and held_out.share == pytest.approx(0.4)
    assert (vague.data, vague.overlap) == pytest.approx((1.645 * 0.02, 0.0))
    assert (vague.law_below, vague.law_above) == pytest.approx((0.2, 0.3))
    said = vague.share(fitted.share)
    assert said.low == pytest.approx(0.6 - 0.0329 - 0.2)
    assert said.high == pytest.approx(0.6 + 0.0329 + 0.3)
    assert vagueness(fitted, replace(held_out, without=1.5)).law_below == 0.0  # more on held-out tests
    alone = vagueness(fitted, None)
    assert (alone.data, alone.law_below) == pytest.approx((1.645 * 0.05, 0.3))
    assert Vague(3.0, 0.0, 0.0, 0.0).share(0.5) == Share(0.5, -1.0, 1.0)


PLACE = Figures(
    name="moving_mass",
    gain=60.0,
    alternatives={"moving_mass": 0.0, "free_play": -14.0},
    fitted=0.6,
    alone=0.6,
    held_out=0.6,
    moved=0.05,
    before=0.04,
    tests=6,
)


def test_what_removes_too_little_without_an_unnamed_effect_is_not_named_either():
    """b removes a fifth of the gap beside c, which is not named; alone it removes a hundredth."""
    gap = sets(none=1.0, a=0.5, b=0.99, a_b=0.49)
    sizes = {k: SimpleNamespace(power_N2=np.full(4, v**2)) for k, v in gap.items()}
    figures = [replace(PLACE, name=n, fitted=0.2) for n in "abc"]
    found = SimpleNamespace(figures=figures, models=SimpleNamespace(sizes=sizes, find=lambda keys: None))
    assert large_enough(found, ("a", "b")) == ("a",)
    assert large_enough(found, ("a",)) == ("a",) and large_enough(found, ()) == ()


TESTS = 6


def sets_of(**nats):
    """Probabilities of sets, from how many nats each is behind the best; "" is the base alone, a_b a set of two."""
    return set_probabilities({frozenset(k.split("__")) - {""}: -v for k, v in nats.items()}, TESTS)


def test_scores_count_by_a_power_and_effects_of_one_set_are_all_in_it():
    sets = sets_of(moving_mass=0.0, moving_mass__free_play=20.0, free_play=40.0)
    weight = np.exp(-COARSENED / (COARSENED + TESTS) * np.array([0.0, 20.0, 40.0]))
    assert any_of(sets, {"moving_mass"}) == pytest.approx((weight[0] + weight[1]) / weight.sum())
    assert any_of(sets, {"free_play"}) == pytest.approx((weight[1] + weight[2]) / weight.sum())
    assert any_of(sets, {"moving_mass", "free_play"}) == SUREST and any_of(sets, {"end_stop"}) == 0.0


def test_a_clear_effect_is_named_and_no_evidence_names_nothing():
    assert named_by([PLACE], {frozenset({"moving_mass"}): 0.9, frozenset(): 0.1}) == ("moving_mass",)
    assert named_by([PLACE], {frozenset({"moving_mass"}): 0.4, frozenset(): 0.6}) == ()


SURE = replace(PLACE, gain=500.0, fitted=0.8, alone=0.8, held_out=0.8, alternatives={"moving_mass": 0.0})


def one_set(f):
    """The set of one effect is all but certain."""
    return {frozenset({f.name}): 1.0}


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"tests": 1, "held_out": np.nan}, "one record"),
        ({"held_out": -0.01}, "held-out tests"),
        ({"held_out": 0.0}, "held-out tests"),
        ({"name": "force_clipping", "held_out": 0.0}, "held-out tests"),
        ({"fitted": 0.01}, "too little"),
        ({"before": 0.001, "fitted": 0.5}, "too little"),
        ({"odd": "mass of 9 t is beyond what is possible"}, "9 t"),
        ({"name": "lagging_force"}, "no cause"),
    ],
)
def test_a_name_is_refused_however_probable(change, why):
    f = replace(SURE, **change)
    f = replace(f, alternatives={f.name: 0.0})
    assert refused(SURE) == "" and why in refused(f)
    assert named_by([SURE], one_set(SURE)) == ("moving_mass",) and named_by([f], one_set(f)) == ()
    if f.name != "lagging_force":
        assert contributing([f], one_set(f))[f.name] == REFUSED


def test_a_gap_resembles_what_removes_some_of_it_on_held_out_tests():
    steady = replace(SURE, name="lagging_force", gain=20.0)
    idle = replace(SURE, name="lagging_reading", gain=90.0, held_out=0.0)
    assert resembled([SURE, idle]) is None and resembled([idle, steady, SURE]) is steady
    assert resembled([replace(steady, fitted=-0.019, alone=-0.039)]) is None
    once = replace(idle, held_out=np.nan)
    assert resembled([once, steady]) is once


def test_what_the_best_set_lacks_is_not_probable():
    sets = {frozenset({"moving_mass"}): 0.3, **{frozenset({"end_stop", n}): 0.35 for n in ("free_play", "force_drift")}}
    p = contributing([SURE], sets)
    assert p["moving_mass"] == 0.3 and p["end_stop"] == REFUSED


def test_what_the_record_itself_shows_is_named_from_one_record():
    hum = replace(
        SURE,
        name="mains_interference",
        alternatives={"mains_interference": 0.0},
        tests=1,
        held_out=float("nan"),
    )
    assert refused(hum) == "" and named_by([hum], one_set(hum)) == ("mains_interference",)


def test_one_record_says_one_of_these():
    one = replace(SURE, tests=1, held_out=float("nan"), alternatives={"moving_mass": 0.0, "free_play": -3.0})
    sets = sets_of(moving_mass=0.0, free_play=3.0)
    (said,) = one_of([one], named_by([one], sets), sets, calibration())
    assert set(said.names) == {"moving_mass", "free_play"}


OTHERS = ("viscous_damping", "end_stop", "free_play", "force_lowpass")


@pytest.mark.parametrize(("tied", "named"), [(0, True), (1, False), (2, False), (4, False)])
def test_a_name_needs_a_probability_of_its_own_and_many_are_said_together(tied, named):
    """With so many tied other effects in its place an effect has 1/(1 + tied) of the place's probability."""
    some = (SURE.name, *OTHERS[:tied])
    f, sets = replace(SURE, alternatives=dict.fromkeys(some, 0.0)), {frozenset({n}): 0.999 / len(some) for n in some}
    assert named_by([f], sets) == ((SURE.name,) if named else ())
    said = one_of([f], named_by([f], sets), sets, calibration())
    if named:
        assert said == ()
    else:
        assert set(said[0].names) == set(f.alternatives) and said[0].probability == SUREST


@pytest.mark.parametrize(("p", "named"), [(0.51, True), (0.49, False)])
def test_what_is_more_probable_than_not_is_named(p, named):
    sets = {frozenset({SURE.name}): p, frozenset(): 1.0 - p}
    assert named_by([SURE], sets) == ((SURE.name,) if named else ())


def test_where_an_unlisted_cause_is_likely_only_what_is_sure_is_named():
    assert beside_unlisted(0.8, 0.0) == 0.8 and beside_unlisted(1.0, 1.0) == 1.0 and beside_unlisted(0.0, 0.5) == 0.0
    assert beside_unlisted(0.8, 1.0) == pytest.approx(0.64)
    sets = {frozenset({SURE.name}): 0.6, frozenset(): 0.4}
    assert named_by([SURE], sets) == (SURE.name,) and named_by([SURE], sets, 0.9) == ()
    assert contributing([SURE], sets, 0.9)[SURE.name] == pytest.approx(0.6 * (1.0 - 0.9 * 0.4))
    sure = {frozenset({SURE.name}): 0.97, frozenset(): 0.03}
    assert named_by([SURE], sure, 0.99) == (SURE.name,)


def test_a_form_of_the_base_and_effects_that_cannot_be_told_from_it_are_said_together():
    c, tied = calibration(), dict.fromkeys(("slip_forces_free", *OTHERS), 0.0)
    place, sets = replace(SURE, name="slip_forces_free", alternatives=tied), {frozenset({n}): 0.2 for n in tied}
    (said,) = one_of([place], named_by([place], sets), sets, c)
    assert set(said.names) == set(tied)
    form = {"slip_forces_free": 0.0, "stiffness_law_free": 0.0}
    assert one_of([replace(place, alternatives=form)], (), {frozenset({n}): 0.5 for n in form}, c) == ()
    assert one_of([place], ("slip_forces_free",), sets, c) == ()


def test_what_nothing_of_the_catalogue_fills_is_not_said_to_be_one_of_it():
    c, tied = calibration(), dict.fromkeys((SURE.name, *OTHERS), 0.0)
    sets = {frozenset({n}): 0.2 for n in tied}
    assert one_of([replace(SURE, alternatives={SURE.name: 0.0})], (), one_set(SURE), c) == ()  # one is named or not
    assert one_of([replace(SURE, alternatives=tied)], (), sets, c) != ()
    assert one_of([replace(SURE, alternatives=tied, held_out=-0.1)], (), sets, c) == ()  # nothing on other tests


def test_a_pattern_speaks_for_a_cause_where_it_removes_as_much_as_a_cause_must():
    sure = replace(SURE, name="lagging_force", alternatives={"lagging_force": 0.0})
    assert unknown_cause_probability(0.1, [sure], one_set(sure)) > 0.9
    assert unknown_cause_probability(0.1, [replace(sure, fitted=0.01)], one_set(sure)) == pytest.approx(0.1)
    tiny = replace(sure, fitted=0.2, before=0.004)  # 0.08 % of the friction force
    assert unknown_cause_probability(0.1, [tiny], one_set(sure)) == pytest.approx(0.1)


def test_the_score_of_a_set():
    names = frozenset(("viscous_damping", "channel_delay"))
    assert score(100.0, -7.0, names, 1) == pytest.approx(93.0 - 2.0 * EFFECT_NATS - ALIKE_NATS)


def test_a_gap_in_newtons_counts_by_its_logarithm_down_to_a_sound_specimens():
    half = newton_nats(0.5, USUAL_GAP, 6) - newton_nats(1.0, USUAL_GAP, 6)
    assert half == pytest.approx(2.0 * 6 * np.log(4.0), rel=1e-3)  # as two complex numbers of each test would
    floor = newton_nats(0.0, USUAL_GAP, 6) - newton_nats(USUAL_GAP, USUAL_GAP, 6)
    assert floor == pytest.approx(2.0 * 6 * np.log(2.0))


def test_the_quick_gap_is_nearly_that_of_a_whole_refit(kit):
    found = kit.diagnosed("viscous_damping", "held out").search
    for names in (frozenset(), frozenset({"viscous_damping"})):
        fit = found.fits[names]
        floor = USUAL_GAP * float(np.sqrt(np.mean(found.data.level_N**2)))
        assert quick_gap_N(found.data, fit) == pytest.approx(gap_rms_N(found.data, fit), rel=0.1, abs=0.1 * floor)


def test_a_larger_rest_is_likelier_to_have_a_cause():
    c = calibration()
    p = [c.unknown_cause(share) for share in (0.0005, 0.005, 0.05)]
    assert p[0] < 0.5 < p[2] and p == sorted(p)


def test_saved_constants_are_read_back(tmp_path):
    c = Calibration(1.5, -2.0, 8.0, (0.001, 0.5))
    c.save(tmp_path / "constants.json")
    assert calibration(tmp_path / "constants.json") == c


def test_titles_are_running_text():
    assert title("channel_delay") == "a delay between the channels" and title("end_stop") == "end stop"
    assert title("slip_forces_follows_pressure_bar") == "slip forces that follow pressure_bar"
    assert title("stiffness_follows_temperature_C") == "stiffness that follows temperature_C"


def test_constants_are_few_and_each_has_a_reason():
    import ast
    from pathlib import Path

    import bayes_iwan.diagnosis.constants as constants

    lines = Path(constants.__file__).read_text().splitlines()
    given = [n for n in ast.parse("\n".join(lines)).body if isinstance(n, ast.AnnAssign)]
    assert 0 < len(given) <= 40
    for node in given:
        above = lines[node.lineno - 2]
        assert above.startswith("#:") or ": Final" in above, f"{lines[node.lineno - 1]} has no reason"
