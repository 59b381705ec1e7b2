"""The budget's arithmetic against closed forms, and the calibration's promises."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.effects.catalogue import variants
from bayes_iwan.gap.judging import verdict
from bayes_iwan.gap.judging.budget import (
    NAMED,
    OWN_PROBABILITY,
    Share,
    along_shares,
    rest_without_name,
    shapley,
    subsets,
)
from bayes_iwan.gap.judging.calibration import (
    EFFECT_FIGURES,
    LEAST_TESTS,
    REST_FIGURES,
    SUREST,
    Calibration,
    calibration,
    effect_figures,
    from_json,
    rest_figures,
)
from bayes_iwan.gap.judging.guards import UNJUDGED, Figures, borne_out, companion
from bayes_iwan.gap.judging.verdict import falls_short, helping, made_by, named_by, one_of
from bayes_iwan.gap.judging.weighing import LEAST_ALONG, _removing
from bayes_iwan.gap.searching.base import USUAL_GAP, gap_rms_N, newton_nats, quick_gap_N
from bayes_iwan.gap.telling.words import title


def test_subsets_are_all_of_them_the_empty_one_first():
    assert subsets("ba") == [frozenset(), frozenset("a"), frozenset("b"), frozenset("ab")]
    assert len(subsets("abcd")) == 16


def test_shapley_of_an_additive_game_is_each_players_own_part():
    part = {"a": 0.3, "b": 0.5, "c": 0.1}
    found = shapley(part, lambda s: np.array(sum(part[n] for n in s)))
    for name, value in part.items():
        assert found[name] == pytest.approx(value)


def test_shapley_shares_what_overlaps_and_sums_to_the_whole():
    """Two players that achieve the same, alone or together, share it; a third that adds nothing gets nothing."""
    found = shapley("abc", lambda s: np.array(0.8 if s & {"a", "b"} else 0.0))
    assert found["a"] == pytest.approx(0.4) and found["b"] == pytest.approx(0.4)
    assert found["c"] == pytest.approx(0.0, abs=1e-12)


def test_shapley_of_three_by_the_orders_written_out():
    """The mean over the six orders, by hand, for v = |s|² and a bonus for a with b."""

    def value(s):
        return np.array(len(s) ** 2 + 2.0 * ({"a", "b"} <= s))

    orders = ["abc", "acb", "bac", "bca", "cab", "cba"]
    by_hand = {n: 0.0 for n in "abc"}
    for order in orders:
        for i, n in enumerate(order):
            by_hand[n] += float(value(frozenset(order[: i + 1])) - value(frozenset(order[:i]))) / 6.0
    found = shapley("abc", value)
    for n in "abc":
        assert found[n] == pytest.approx(by_hand[n])


PLACE = Figures("a", 20.0, 10.0, {"a": 0.0, "b": -4.0}, 0.5, 0.4, 0.4, 1.0, 0.5, 0.03, 0.04, 6)


@pytest.mark.parametrize(
    "change",
    [{"gain": 80.0}, {"fitted": 0.9}, {"by_test": 0.9}, {"differs": 0.1}],
    ids=lambda c: next(iter(c)),
)
def test_better_figures_never_make_a_cause_less_probable(change):
    c = calibration()
    assert c.contributes(replace(PLACE, **change)) >= c.contributes(PLACE)
    assert 1.0 - SUREST <= c.contributes(PLACE) <= SUREST


def test_what_no_test_left_out_can_judge_counts_less():
    c, fit_alone = calibration(), replace(PLACE, by_test=PLACE.fitted, unseen=PLACE.fitted)
    unjudged = c.contributes(replace(fit_alone, judged=False))
    assert unjudged == pytest.approx(c.contributes(replace(fit_alone, by_test=UNJUDGED * PLACE.fitted)))
    assert unjudged < c.contributes(fit_alone)


def test_evidence_between_rivals_counts_as_far_as_the_gap_bears_it_out():
    assert borne_out(-200.0, 0.01, False) == pytest.approx(-6.0)  # a hundredth of the gap: six nats
    assert borne_out(-4.0, 0.5, False) == -4.0 and borne_out(-200.0, -0.1, False) == 0.0
    assert borne_out(3.0, 0.0, True) == 0.0 and borne_out(3.0, 0.0, False) == 3.0
    assert borne_out(9.0, 0.0, True) == 9.0


@pytest.mark.parametrize(
    ("rival", "both", "expected"),
    [
        ("moving_mass", 95.0, True),  # the delay gains 45 of its 50 nats beside the mass: both act
        ("moving_mass", 60.0, False),  # it gains 10: the mass stands in for it
        ("moving_mass", None, False),  # not known
        ("force_lowpass", 95.0, False),  # a look-alike stays a rival
    ],
)
def test_a_rival_beside_which_an_effect_still_gains_is_a_companion(rival, both, expected, kit):
    """Evidence by hand: base 0, delay 50, the rival alone 50."""

    def fit(nats, *names):
        return SimpleNamespace(log_evidence=nats, names=frozenset(names))

    fits = {} if both is None else {frozenset({"channel_delay", rival}): fit(both, "channel_delay", rival)}
    effects = {n: tuple(k(kit.scales, ("a.csv",)) for k in kinds) for n, kinds in variants().items()}
    search = SimpleNamespace(fits=fits, effects=effects)
    assert companion(search, fit(50.0, "channel_delay"), fit(0.0), fit(50.0, rival), rival) is expected


def test_a_share_s_interval_widens_by_an_independent_error():
    wide = Share(0.5, 0.4, 0.6).widened(0.1)
    assert wide.high - 0.5 == pytest.approx(np.hypot(0.1, 1.645 * 0.1)) and 0.5 - wide.low == pytest.approx(
        wide.high - 0.5
    )
    assert Share(0.95, 0.9, 1.0).widened(0.1).high == 1.0


def test_nature_s_law_puts_a_small_share_off_by_a_part_of_it_only():
    c = calibration()
    assert c.law_sd(0.9) == c.law_sd(0.6) == c.law
    assert c.law_sd(0.1) == pytest.approx(0.1 * c.law_of_share) and c.law_sd(-0.1) == 0.0


def test_no_evidence_names_nothing():
    weak = Figures("a", 3.0, 0.5, {"a": 0.0, "b": -0.5}, 0.05, -0.2, -0.2, 4.0, 0.002, 0.002, 0.002, 6)
    assert calibration().contributes(weak) < 0.5


def test_rivals_share_their_places_probability():
    shares = calibration().among(PLACE)
    assert sum(shares.values()) == pytest.approx(1.0) and shares["a"] > shares["b"] > 0.0


CLEAR = replace(PLACE, name="moving_mass", gain=300.0, fitted=0.6, by_test=0.6, differs=0.0)
OTHERS = ("viscous_damping", "end_stop", "free_play", "force_lowpass")


@pytest.mark.parametrize(("tied", "named"), [(0, True), (1, True), (2, True), (3, False), (4, False)])
def test_a_name_needs_a_probability_of_its_own_and_many_are_said_together(tied, named):
    """With so many tied rivals in its place an effect has 1/(1 + tied) of the place's probability, 0.99."""
    c = calibration()
    f = replace(CLEAR, rivals=dict.fromkeys((CLEAR.name, *OTHERS[:tied]), 0.0))
    assert (c.contributes(f) / (1 + tied) >= OWN_PROBABILITY) is named
    assert named_by([f], c) == ((CLEAR.name,) if named else ())
    said = one_of([f], named_by([f], c), c)
    if named:
        assert said == ()
    else:
        assert set(said[0].names) == set(f.rivals) and said[0].probability == pytest.approx(c.contributes(f))
        assert said[0].share == f.fitted


def test_a_form_of_the_base_and_effects_that_cannot_be_told_from_it_are_said_together():
    """A single record often fits other slip forces as well as what was done to it; alone, or beside a pattern without a
    cause, they are no set of causes."""
    c, tied = calibration(), dict.fromkeys(("slip_forces_free", *OTHERS), 0.0)
    place = replace(CLEAR, name="slip_forces_free", rivals=tied)
    (said,) = one_of([place], named_by([place], c), c)
    assert set(said.names) == set(tied) and said.probability == pytest.approx(c.contributes(place))
    assert one_of([replace(place, rivals={"slip_forces_free": 0.0, "stiffness_law_free": 0.0})], (), c) == ()
    assert one_of([place], ("slip_forces_free",), c) == ()


def test_several_are_said_together_where_one_of_them_probably_contributes():
    c, tied = calibration(), dict.fromkeys((CLEAR.name, *OTHERS), 0.0)
    some = [replace(CLEAR, rivals=tied, gain=g, by_test=0.1, fitted=0.1, differs=1.0) for g in np.geomspace(0.1, 300)]
    said = [bool(one_of([f], (), c)) for f in some]
    assert said == [c.contributes(f) >= NAMED for f in some] and len(set(said)) == 2


def test_what_does_not_hold_on_tests_left_out_needs_more_for_its_name():
    c = calibration()
    holds = replace(CLEAR, rivals={CLEAR.name: 0.0}, gain=5.0, fitted=0.3, by_test=0.3)
    assert named_by([holds], c) == (CLEAR.name,)
    idle = replace(holds, by_test=-0.1)
    assert named_by([idle], c) == ()
    assert named_by([replace(idle, gain=200.0)], c) == (CLEAR.name,)


def test_evidence_counts_more_beside_a_gap_that_no_sound_specimen_has():
    """The same nats, once where the gap is as large as a sound specimen's, once ten times that."""
    sound, large = (effect_figures(replace(CLEAR, gap=k * USUAL_GAP))[0] for k in (1.0, 10.0))
    assert large / sound == pytest.approx(np.log(11.0) / np.log(2.0))


def test_evidence_counts_by_test_but_a_single_record_no_more_than_a_few():
    def evidence(gain, tests):
        return effect_figures(replace(CLEAR, gain=gain, tests=tests))[0]

    assert evidence(20.0, 14) < evidence(20.0, 7) == pytest.approx(evidence(40.0, 14))
    assert evidence(20.0, 1) == evidence(20.0, LEAST_TESTS)


def test_what_nothing_of_the_catalogue_fills_is_not_said_to_be_one_of_it():
    c = calibration()
    tied = dict.fromkeys((CLEAR.name, *OTHERS), 0.0)
    assert one_of([replace(CLEAR, rivals={**tied, "break_away": 9.0})], (), c) == ()  # a pattern without a cause
    assert one_of([replace(CLEAR, rivals=tied, gain=1.0, by_test=0.0, fitted=0.03)], (), c) == ()  # nothing there
    assert one_of([replace(CLEAR, rivals={CLEAR.name: 0.0})], (), c) == ()  # one alone is named or not


def _sized(**rms_N):
    """Gap sizes by set of effects, "a_b" for two: (all, along) in N, at a friction force of 1 N."""
    return {
        frozenset(k.split("_")) if k != "none" else frozenset(): SimpleNamespace(
            all=SimpleNamespace(rms_N=whole, share=whole), along=SimpleNamespace(rms_N=along, share=along)
        )
        for k, (whole, along) in rms_N.items()
    }


@pytest.mark.parametrize(("evolving", "kept"), [((), ("a",)), (("b",), ("a", "b"))])
def test_what_changes_along_the_record_is_judged_there(evolving, kept):
    """b removes nine tenths of what changes along the record, a hundredth of the gap."""
    sizes = _sized(none=(0.1, 0.01), a=(0.05, 0.01), b=(0.099, 0.001), a_b=(0.0495, 0.001))
    assert _removing(("a", "b"), evolving, sizes) == kept
    quiet = _sized(none=(0.1, 5e-4), a=(0.05, 5e-4), b=(0.099, 5e-5), a_b=(0.0495, 5e-5))
    assert _removing(("a", "b"), evolving, quiet) == ("a",)  # less changes than anything is named for


def test_an_effect_falls_short_of_its_share_unless_it_acts_along_the_record():
    assert falls_short("moving_mass", 0.01, 0.0, 0.1) and not falls_short("moving_mass", 0.03, 0.0, 0.1)
    assert not falls_short("friction_fade", 0.01, LEAST_ALONG, 0.1)
    assert not falls_short("force_drift", -0.05, 0.9, 0.1)  # so near two fits come to the least gap
    assert falls_short("friction_fade", -0.12, 0.9, 0.1)  # it makes the whole gap larger


def test_the_least_helpful_goes_and_the_rest_is_judged_anew():
    """Beside `a` both others take nothing; without `b`, `c` is worth its name."""
    share = {
        frozenset("abc"): {"a": 0.5, "b": -0.02, "c": 0.0},
        frozenset("ac"): {"a": 0.4, "c": 0.1},
        frozenset("bc"): {"b": -0.5, "c": -0.6},
        frozenset("b"): {"b": -0.3},
    }
    asked = []

    def made(names):
        asked.append(set(names))
        return share[frozenset(names)], {}

    assert helping("abc", made, 0.1) == ("a", "c") and asked == [set("abc"), set("ac")]
    assert helping("bc", made, 0.1) == ()
    assert helping("", made, 0.1) == ()


def test_what_a_cause_makes_is_the_less_of_what_is_put_in_and_what_is_told(monkeypatch):
    """Put in, `b` takes a tenth of the gap; as it is told, the mean with what goes when it is taken out, nothing."""
    put_in = {"a": Share(0.5, 0.4, 0.6), "b": Share(0.1, 0.0, 0.2)}
    monkeypatch.setattr(verdict, "shares", lambda names, sizes: put_in)
    found = SimpleNamespace(
        sizes=dict.fromkeys(subsets("ab")),
        told_shares=lambda names: {"a": Share(0.6, 0.5, 0.7), "b": Share(0.0, -0.1, 0.1)},
        along=lambda names: {"b": 0.3},
    )
    assert made_by(found, ("a", "b")) == ({"a": 0.5, "b": 0.0}, {"b": 0.3})


def test_a_pattern_speaks_for_a_cause_where_it_removes_as_much_as_a_cause_must():
    c = calibration()
    sure = replace(PLACE, gain=300.0, by_test=0.6, name="lagging_force", rivals={"lagging_force": 0.0})
    assert rest_without_name(0.1, [sure], c) > 0.9
    little = replace(sure, fitted=0.01, before=0.05)
    assert rest_without_name(0.1, [little], c) == pytest.approx(0.1)
    tiny = replace(sure, fitted=0.2, before=0.004)  # 0.08 % of the friction force
    assert rest_without_name(0.1, [tiny], c) == pytest.approx(0.1)


def test_shares_of_what_changes_along_the_record_sum_to_what_is_removed():
    along = {frozenset(k): v for k, v in {"": 0.01, "a": 0.004, "b": 0.01, "ab": 0.003}.items()}
    found = along_shares("ab", along)
    assert sum(found.values()) == pytest.approx(0.7) and found["a"] == pytest.approx(0.65)
    assert along_shares("a", {frozenset(): 0.0, frozenset("a"): 0.0}) == {"a": 0.0}


def test_a_gap_in_newtons_counts_by_its_logarithm_down_to_a_sound_specimens(kit):
    data = kit.diagnosed("viscous_damping", "held out").data
    level = float(np.sqrt(np.mean(data.level_N**2)))
    half = newton_nats(data, 0.5 * level) - newton_nats(data, level)
    # as two complex numbers of each test would
    assert half == pytest.approx(2.0 * data.tests * np.log(4.0), rel=1e-3)
    floor = newton_nats(data, 0.0) - newton_nats(data, USUAL_GAP * level)
    assert floor == pytest.approx(2.0 * data.tests * np.log(2.0))


def test_the_quick_gap_is_nearly_that_of_a_whole_refit(kit):
    found = kit.diagnosed("viscous_damping", "held out").search
    for names in (frozenset(), frozenset({"viscous_damping"})):
        fit = found.fits[names]
        floor = USUAL_GAP * float(np.sqrt(np.mean(found.data.level_N**2)))
        assert quick_gap_N(found.data, fit) == pytest.approx(gap_rms_N(found.data, fit), rel=0.1, abs=0.1 * floor)


def test_a_larger_rest_is_likelier_to_have_a_cause():
    c = calibration()
    p = [c.unknown_rest(rest_figures(share, 1.0)) for share in (0.0005, 0.005, 0.05)]
    assert p[0] < 0.5 < p[2] and p == sorted(p)
    assert c.unknown_rest(rest_figures(0.004, 800.0)) >= c.unknown_rest(rest_figures(0.004, 1.0))


def test_shipped_constants_have_one_sign_and_one_weight_for_each_figure():
    c = calibration()
    assert len(c.effect) == len(EFFECT_FIGURES) == len(effect_figures(PLACE))
    assert len(c.rest) == len(REST_FIGURES)
    assert min(c.effect) >= 0.0 and min(c.rest) >= 0.0


def test_saved_constants_are_read_back(tmp_path):
    import json

    c = Calibration((1.0, 1.0, 2.0, 0.5), -1.5, (1.0, 0.5), -2.0, 0.3, 8.0, (0.001, 0.5), 0.05, 0.5)
    c.save(tmp_path / "constants.json")
    assert from_json(json.loads((tmp_path / "constants.json").read_text())) == c


def test_titles_are_running_text():
    assert title("channel_delay") == "a delay between the channels" and title("end_stop") == "end stop"
    assert title("slip_forces_follows_pressure_bar") == "slip forces that follow pressure_bar"
    assert title("stiffness_follows_temperature_C") == "stiffness that follows temperature_C"
