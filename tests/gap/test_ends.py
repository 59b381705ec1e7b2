"""Among sets that are worth all but the same a name must not hang on which of them the search ended in."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.gap.judging.guards import Figures, in_company
from bayes_iwan.gap.searching.ends import OTHERS_MOST, SPREAD, ends_of


def explored(barred=(), **worth):
    """A search that has fitted sets of one-letter effects, worth so many nats ("none" is the base)."""
    fits = {}
    for names, value in worth.items():
        key = frozenset(() if names == "none" else names)
        fits[key] = SimpleNamespace(names=key, effects=tuple(key), value=value)
    return SimpleNamespace(
        fits=fits,
        needed=lambda names: names not in [frozenset(b) for b in barred],
        within_reach=lambda some: some,
        worth=lambda f: f.value,
        worths=lambda some: [f.value for f in some],
    )


def ends(found, chosen, most=4):
    return {"".join(sorted(k)): w for k, w in ends_of(found, found.fits[frozenset(chosen)], most).items()}


def test_a_lone_end_weighs_one():
    assert ends(explored(none=0.0, a=100.0, b=20.0, ab=101.0), "a") == {"a": 1.0}
    assert ends(explored(none=0.0, a=1.0), "") == {"": 1.0}


def test_ends_weigh_by_what_they_are_worth_beside_the_best():
    found = ends(explored(none=0.0, a=50.0, b=45.0, ab=100.0, ac=98.0, bc=104.0), "ab")
    assert list(found) == ["ab", "bc", "ac"]  # the chosen one first, then the likeliest
    assert found["ab"] == pytest.approx(np.exp(-4.0 / SPREAD)) and found["bc"] == 1.0
    assert found["ac"] == pytest.approx(np.exp(-6.0 / SPREAD))


def test_what_leads_on_what_adds_nothing_and_what_was_dropped_is_no_end():
    leads_on = explored(none=0.0, ab=100.0, c=97.0, cd=101.0)
    assert list(ends(leads_on, "ab")) == ["ab", "cd"]
    nothing_added = explored(none=0.0, ab=100.0, c=99.0, cd=100.0)
    assert list(ends(nothing_added, "ab")) == ["ab", "c"]
    assert list(ends(explored(none=0.0, ab=100.0, cd=101.0, barred=["cd"]), "ab")) == ["ab"]
    assert list(ends(explored(none=0.0, ab=100.0, cdefg=120.0), "ab")) == ["ab"]  # more effects than a set may hold


def test_far_ends_and_more_than_a_few_are_left():
    some = {f"a{x}": 100.0 - 0.5 * i for i, x in enumerate("bcdefg")}
    assert len(ends(explored(none=0.0, **some), "ab")) == 1 + OTHERS_MOST
    assert list(ends(explored(none=0.0, ab=100.0, cd=100.0 - 1.01 * SPREAD), "ab")) == ["ab"]


def figures(name, gain=100.0, by_test=0.5, **rivals):
    return Figures(name, gain, gain, {name: 0.0} | rivals, by_test, by_test, by_test, 0.2, 0.1, 0.2, 0.3, 6)


def test_alone_an_end_says_what_it_said():
    chosen = (figures("a"), figures("b", 20.0, 0.1))
    assert in_company(chosen, 0.7, []) == chosen


def test_figures_are_the_weighted_mean_over_the_company():
    """a is in both ends, b in one of them only."""
    chosen = (figures("a", 100.0, 0.5), figures("b", 20.0, 0.3))
    a, b = in_company(chosen, 1.0, [(0.5, (figures("a", 40.0, 0.2), figures("c")))])
    assert a.gain == pytest.approx((100.0 + 0.5 * 40.0) / 1.5) and a.by_test == pytest.approx((0.5 + 0.1) / 1.5)
    assert b.gain == pytest.approx(20.0 / 1.5) and b.by_test == pytest.approx(0.3 / 1.5)
    assert b.rivals == chosen[1].rivals
    assert a.differs == pytest.approx(0.2) and b.differs == pytest.approx(0.2)  # where it is not it cannot differ


def test_what_could_stand_there_as_well_is_in_the_company():
    chosen = (figures("a", 60.0),)
    taken = replace(figures("c", 60.0), rivals={"c": 0.0, "a": -0.5 * SPREAD})
    (near,) = in_company(chosen, 1.0, [(1.0, (taken,))])
    (far,) = in_company(chosen, 1.0, [(1.0, (replace(taken, rivals={"c": 0.0, "a": -2.0 * SPREAD}),))])
    assert near.gain == pytest.approx(60.0) and far.gain == pytest.approx(30.0)
