"""Where the gap is, in sentences: from statistics that are written down here, as a reader would say it."""

import numpy as np
import pytest

from bayes_iwan.diagnosis.answer.gap_findings import where_sentences
from bayes_iwan.diagnosis.answer.growth_laws import GrowthLaw
from bayes_iwan.diagnosis.answer.localisation import Statistic, Where


def statistic(kind, name, gap_N=0.1, share=0.5, time=0.5, significant=True, spread=0.1):
    return Statistic(kind, name, gap_N, gap_N * (1 - spread), gap_N * (1 + spread), share, time, 0.01, significant)


def sentences(*some, laws=(), clock=True, f=(10.0, 20.0), a=(0.5, 1.0), change=None):
    """Those of two tests with these statistics, beside some that are no finding; the last sentence, which says what all
    findings are, left out."""
    quiet = [statistic("parity", "odd", significant=False), statistic("parity", "even", significant=False)]
    quiet.append(statistic("mean", "mean force", significant=False))
    kinds = {x.kind for x in some}
    none, change = np.zeros((2, 8)), np.zeros((2, 3)) if change is None else np.array(change)
    w = Where(
        ("t0.csv", "t1.csv"), np.array(f), np.array(a), (*some, *(x for x in quiet if x.kind not in kinds)), laws, 40,
        none, none, none, none, none, None, change, clock,
    )  # fmt: skip
    *said, last = where_sentences(w)
    assert last == "Each finding is significant at 5 %, corrected for 40 statistics." if said else "Nothing" in last
    return said


def grows(*sizes, kind="frequency", spread=0.01):
    return [statistic(kind, f"{10 * (i + 1)} Hz", x, spread=spread) for i, x in enumerate(sizes)]


def test_without_any_finding_it_is_said_that_nothing_stands_out():
    assert sentences(statistic("test", "t0.csv", significant=False)) == []


def test_the_worst_test_is_named_and_how_many_miss():
    tests = [statistic("test", "t0.csv", 0.1), statistic("test", "t1.csv", 0.4)]
    (said,) = sentences(*tests)
    assert said.startswith("All averaged loops miss more") and "at 20 Hz and 1 mm (0.4 N RMS)" in said
    (said,) = sentences(
        statistic("test", "t0.csv", 0.3), statistic("test", "t1.csv", 0.1, significant=False), clock=False
    )
    assert said.startswith("1 of 2 loops miss") and "is at 0.5 mm (0.3 N RMS)" in said


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        ((0.1, 0.2, 0.4), "The gap grows with frequency, from 0.1 N at 10 Hz to 0.4 N at 30 Hz."),
        ((0.4, 0.2, 0.1), "The gap falls with frequency, from 0.4 N at 10 Hz to 0.1 N at 30 Hz."),
        ((0.2, 0.4, 0.1), "The gap is largest at 20 Hz (0.4 N) and smallest at 30 Hz (0.1 N)."),
        ((0.20, 0.22, 0.21), "The gap does not depend on frequency: 0.2 N to 0.22 N."),
        ((0.2, 0.3), "The gap grows with frequency, from 0.2 N at 10 Hz to 0.3 N at 20 Hz."),
    ],
)
def test_how_the_gap_goes_with_frequency(sizes, said):
    assert sentences(*grows(*sizes)) == [said]


def test_intervals_that_overlap_tell_no_growth_and_one_frequency_none():
    assert sentences(*grows(0.2, 0.3, spread=0.3)) == ["The gap does not depend on frequency: 0.2 N to 0.3 N."]
    assert sentences(*grows(0.3)) == []


def law(order=1, part="quadrature", force=0.2, f=(1.0, 0.8, 1.2), a=None, gain=100.0):
    return GrowthLaw(order, part, force, 0.01, f, a, gain, 0.001)


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (law(), "up to 0.2 N is missing at the test frequency, in phase with velocity: the specimen acts more "
         "dissipative than the model; it grows in proportion to frequency (power 1.00, 0.80 to 1.20)."),
        (law(part="in phase", force=-0.2, f=(2.02, 1.9, 2.1)), "in phase with displacement: the specimen acts softer "
         "than the model; it grows with frequency squared (power 2.02, 1.90 to 2.10)."),
        (law(order=3, f=(0.0, -0.1, 0.1), a=(3.0, 2.9, 3.1)), "at the third harmonic, in phase with velocity; it does "
         "not depend on frequency (power 0.00, -0.10 to 0.10) and grows with amplitude cubed"),
        (law(order=4, f=(1.5, 1.3, 1.7)), "at the 4th harmonic, in phase with velocity; it goes with frequency to the "
         "power 1.5 (1.3 to 1.7)."),
        (law(f=(1.0, -0.5, 2.5)), "is missing at the test frequency, in phase with velocity."),
        (law(f=(-1.0, -1.1, -0.9)), "it falls as 1/frequency (power -1.00"),
    ],
)  # fmt: skip
def test_a_law_says_how_much_where_and_how_it_grows(one, said):
    """Force and signs: measured above the model in phase with velocity dissipates more."""
    (found,) = sentences(laws=(one,))
    assert said in found and found.startswith("After a refit of the model's own parameters, up to")


def test_a_laws_force_is_that_of_the_test_where_it_is_largest():
    """c (f/f₀)^a, f₀ the largest: 0.2 N at 20 Hz that falls as 1/f is 0.4 N at 10 Hz."""
    (said,) = sentences(laws=(law(f=(-1.0, -1.1, -0.9), a=(0.0, -0.1, 0.1)),))
    assert "up to 0.4 N is missing" in said


def test_further_laws_are_said_where_they_explain_a_hundredth_of_the_first():
    said = sentences(laws=(law(), law(order=3, gain=1.1), law(order=5, gain=0.9)))
    assert len(said) == 2 and said[1].startswith("Besides, up to")


def test_harmonics_and_parts_of_the_loop_that_hold_much_of_the_gap():
    parts = [
        statistic("in phase", "1", share=0.2), statistic("in phase", "2", share=0.09), statistic("quadrature", "1"),
        statistic("parity", "odd"), statistic("parity", "even", share=0.31),
        statistic("region", "near the upper end", share=0.6, time=0.2),
        statistic("region", "rising", share=0.6, time=0.5),
    ]  # fmt: skip
    harmonic, even, region = sentences(*parts)
    assert harmonic == (
        "Of the residual's power, 50 % at the test frequency in phase with velocity and 20 % at the test frequency in "
        "phase with displacement."
    )
    assert even.startswith("31 % of the residual is in even harmonics")
    assert region == "Along the loop the gap is concentrated: 60 % of it in 20 % of the time (near the upper end)."
    assert sentences(statistic("region", "rising", share=0.5)) == ["The gap is spread evenly over the loop."]


def test_what_changes_along_the_record_and_what_the_records_hold_besides():
    some = [
        statistic("trend", "t0.csv"), statistic("trend", "t1.csv", significant=False), statistic("record", "mean"),
        statistic("record", "quadrature"), statistic("record", "odd harmonics", 0.05, share=0.3),
        statistic("mean", "mean force", 0.25), statistic("mains", "50 Hz", 0.02),
    ]  # fmt: skip
    record, mean, mains = sentences(*some, change=[[0.3, 0.0, -0.12], [5.0, 5.0, 5.0]])
    assert record == (
        "The loops change along the record in 1 of 2 tests: the mean force grows by 0.3 N, the test frequency's part "
        "in phase with velocity falls by 0.12 N and odd harmonics change by 50 mN RMS from the first cycles to the "
        "last. No steady model follows that."
    )
    assert "mean forces differ by 0.25 N RMS" in mean and "mains interference at 50 Hz of 20 mN RMS" in mains
