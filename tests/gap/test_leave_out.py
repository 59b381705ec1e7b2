"""Gaps on tests that a fit has not seen."""

import numpy as np
import pytest

from bayes_iwan.effects.along_record import MainsHum
from bayes_iwan.gap.data import gap_data
from bayes_iwan.gap.evidence import extended
from bayes_iwan.gap.leave_out import for_loops, groups_of, refitted


def grouped(kit, tests):
    return groups_of(kit.made_up(kit.specimen_force, tests, cycles=5).loops(**kit.small))


def test_groups_are_frequencies_or_amplitudes_where_there_is_but_one_frequency(kit):
    assert grouped(kit, [(8.0, 0.4), (20.0, 0.4), (8.0, 0.9)]) == ("one frequency left out", [[0, 2], [1]])
    assert grouped(kit, [(8.0, 0.9), (8.0, 0.4)]) == ("one amplitude left out", [[1], [0]])
    assert grouped(kit, [(8.0, 0.9)]) == ("", [])


def test_true_cause_shrinks_the_gap_at_a_frequency_left_out(kit):
    told = kit.diagnosed("channel_delay").explanations[0].unseen
    assert told.by == "one frequency left out"
    assert told.shrink > 0.7 and told.after_N == pytest.approx((1.0 - told.shrink) * told.before_N)
    assert told.low <= told.shrink <= told.high


def test_refit_to_some_tests_stays_near_the_whole_fit(kit):
    found = kit.diagnosed("channel_delay").found
    fit = found.singles["channel_delay"][0]
    again = refitted(fit, gap_data(found.data.loops[:2]))
    at = fit.problem.names.index("channel_delay.delay_s")
    delay = [f.problem.prior.values(f.z[None])["channel_delay.delay_s"][0] for f in (fit, again)]
    sd = np.sqrt(again.covariance[at, at]) * 1.6 * fit.effects[0].strength_value
    assert abs(delay[1] - delay[0]) < 5.0 * sd + 0.1 * abs(delay[0])
    assert again.problem.loops[0].file == found.data.loops[0].file and len(again.problem.loops) == 2


def test_hums_numbers_go_with_their_tests(kit):
    found = kit.diagnosed("channel_delay").found
    files = tuple(x.file for x in found.data.loops)
    problem = extended(found.base.problem, [MainsHum(found.scales, files)])
    few = gap_data(found.data.loops[1:3])
    hums = [n for n in for_loops(problem, few.loops, few).names if n.startswith("mains_hum") and "third" not in n]
    assert hums == [f"mains_hum.{p}[{f}]" for p in ("cosine", "sine") for f in files[1:3]]
