"""Gaps on tests that a fit has not seen."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.assessment.indicators import chosen_share, ranked_by_training
from bayes_iwan.diagnosis.constants import EFFECT_NATS
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.held_out_tests import HeldOut, _refit_gaps, for_loops, refitted, share_by_test
from bayes_iwan.diagnosis.search.base_fit import newton_nats, sound_gap_N
from bayes_iwan.effects.along_record import MainsInterference


def test_groups_are_tests_of_one_frequency_or_amplitude(kit):
    loops = kit.made_up(kit.specimen_force, [(8.0, 0.4), (20.0, 0.4), (8.0, 0.9)], cycles=5).loops(**kit.small)
    assert groups_of([x.frequency_hz for x in loops]) == [[0, 2], [1]]
    assert groups_of([x.amplitude_mm for x in loops]) == [[0, 1], [2]]
    assert groups_of([0.61, 0.3, 0.6, 0.66]) == [[1], [0, 2], [3]], "a drive holds its amplitude within a few percent"


def test_true_cause_shrinks_the_gap_at_frequencies_and_amplitudes_left_out(kit):
    found = kit.diagnosed("channel_delay").found
    assert [u.by for u in found.held_out] == ["one frequency held out", "one amplitude held out"]
    late = next(f for f in found.figures if f.name in ("channel_delay", "force_lowpass"))  # tied in these four tests
    assert late.held_out > 0.6


def test_refit_to_some_tests_stays_near_the_whole_fit(kit):
    found = kit.diagnosed("channel_delay").search
    fit = found.fit({"channel_delay"})
    again = refitted(fit, gap_data(found.data.loops[:2]))
    at = fit.problem.names.index("channel_delay.delay_s")
    delay = [f.problem.prior.values(f.z[None])["channel_delay.delay_s"][0] for f in (fit, again)]
    sd = np.sqrt(again.covariance[at, at]) * 1.6 * fit.effects[0].strength_value
    assert abs(delay[1] - delay[0]) < 5.0 * sd + 0.1 * abs(delay[0])
    assert again.problem.loops[0].file == found.data.loops[0].file and len(again.problem.loops) == 2


def test_a_refit_to_the_same_tests_has_the_fit_s_own_evidence(kit):
    """What a steady model misses of changes along the record counts in both: it is what evolving effects are gained
    over."""
    found = kit.diagnosed("channel_delay").search
    fit = found.fit({"channel_delay"})
    missed = found.data.layout(fit.size.between, False).constant
    assert abs(missed) > 10.0, "else nothing is asked"
    _, trained = _refit_gaps((fit, found.data, found.data.part([0])))
    assert trained[0] == pytest.approx(np.max(fit.log_z), abs=0.1 * abs(missed))


def test_hums_numbers_go_with_their_tests(kit):
    found = kit.diagnosed("channel_delay").search
    files = tuple(x.file for x in found.data.loops)
    problem = found.base.problem.with_effects([MainsInterference(found.scales, files)])
    few = gap_data(found.data.loops[1:3])
    hums = [
        n for n in for_loops(problem, few.loops, few).names if n.startswith("mains_interference") and "third" not in n
    ]
    assert hums == [f"mains_interference.{p}[{f}]" for p in ("cosine", "sine") for f in files[1:3]]


def test_shares_test_by_test_count_each_test_alike():
    before, after = np.array([100.0, 1.0, 1.0, -0.1]), np.array([100.0, 0.25, 4.0, -0.2])
    np.testing.assert_allclose(share_by_test(before, after), [0.0, 0.5, -0.5, 0.0])


def test_a_name_is_assessed_by_the_set_that_the_other_tests_would_have_chosen(kit):
    """By hand: of two tests left out, one set is best for the tests that the first is predicted from, the base for the
    second's. There nothing would have been named, so nothing is removed."""
    effects = {"a": (SimpleNamespace(look_alikes=()),)}
    search = SimpleNamespace(data=kit.diagnosed("channel_delay").data, effects=effects)
    sound_N = sound_gap_N(search.data)
    none, a = frozenset(), frozenset("a")
    trained = {
        none: np.array([[0.0, 90.0], [1.0, 1.0], [2.0, 2.0]]),
        a: np.array([[90.0, 0.0], [1.0, 1.0], [2.0, 2.0]]),
    }
    power = {none: np.array([1.0, 1.0]), a: np.array([0.25, 0.25])}
    held_out = HeldOut("one frequency held out", ("x", "y"), power, trained)
    scores = ranked_by_training(search, held_out)
    expected = 90.0 + newton_nats(1.0, sound_N, 2) - EFFECT_NATS
    assert scores[a][0] == pytest.approx(expected)
    assert chosen_share(power, scores, lambda k: "a" in k) == pytest.approx(0.25)  # a half of one, nothing of the other
