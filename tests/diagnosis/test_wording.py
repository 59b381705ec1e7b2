"""Numbers and names in running text, as a reader would write them."""

import math

import pytest

from bayes_iwan.diagnosis.answer.wording import (
    few,
    force,
    interval,
    listed,
    odds,
    percent,
    physics_of_pattern,
    plain,
    probability,
    strength,
    title,
    value_of,
)


@pytest.mark.parametrize(
    ("newton", "said"),
    [
        (999.0, "999 N"), (999.6, "1 kN"), (1001.0, "1 kN"), (2.5e6, "2,500 kN"), (999e3, "999 kN"), (1.0, "1 N"),
        (0.1, "0.1 N"), (0.0994, "99.4 mN"), (-0.002, "-2 mN"), (0.0, "0 N"), (None, "–"), (math.nan, "–"),
    ],
)  # fmt: skip
def test_forces_have_three_digits_and_the_unit_in_which_they_are_short(newton, said):
    assert force(newton) == said


@pytest.mark.parametrize(
    ("share", "said"),
    [
        (0.0994, "9.9 %"), (0.0996, "10 %"), (0.0011, "0.11 %"), (0.0009, "0.09 %"), (0.00009, "0 %"),
        (1.0, "100 %"), (-0.25, "-25 %"), (0.0, "0 %"), (None, "–"), (math.nan, "–"),
    ],
)  # fmt: skip
def test_shares_have_two_digits_below_a_tenth(share, said):
    assert percent(share) == said


def test_numbers_have_no_exponent():
    assert [plain(x) for x in (1.2345e-5, 123456.0, 2.0, 0.0, None, math.nan)] == [
        "0.0000123", "123000", "2", "0", "–", "–",
    ]  # fmt: skip
    assert plain(0.123456, 4) == "0.1235" and plain(math.inf) == "inf"


def test_odds_probabilities_and_intervals():
    assert odds(math.log(20.0)) == "20 : 1" and odds(math.log(990.0)) == "990 : 1"
    assert odds(math.log(1010.0)) == "over 1000 : 1"
    assert probability(0.956) == "0.96"
    assert interval((0.1, 0.25), percent) == "10 % to 25 %" and interval(None, percent) == interval((), percent) == "–"


def test_names_are_listed_and_some_of_many_are_counted():
    assert listed(["end_stop"]) == "end stop" and listed(["a", "b", "c"], "or") == "a, b or c"
    assert few(list("abc")) == "a, b or c" and few(list("abcd")) == "a, b, c or 1 other"
    assert few(list("abcde"), "and") == "a, b, c and 2 others"
    assert title("slip_forces_follows_pressure_bar") == "slip forces that follow pressure_bar"
    assert title("stiffness_follows_pressure_bar") == "stiffness that follows pressure_bar"


def test_a_parameter_is_said_by_its_unit_or_else_by_its_name():
    assert value_of("k_N_mm", 1.357, 0.092, "N/mm") == " of 1.36 ± 0.09 N/mm"
    assert value_of("drop[f10.csv]", 0.3, 0.11, "-") == " (drop 0.3 ± 0.1)"
    assert strength({"x": (2.0, 0.5, "s"), "y": (1.0, 0.1, "s")}) == " of 2 ± 0.5 s" and strength({}) == ""


def test_only_patterns_without_a_cause_have_physics_of_their_own():
    assert physics_of_pattern(None) is physics_of_pattern("viscous_damping") is None
    assert "speed" in str(physics_of_pattern("speed_squared"))
