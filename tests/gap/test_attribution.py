"""From evidence to probabilities: what tables of evidence make of none, unknown, one effect, two, and look-alikes."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.gap.attribution import IDLE_COST, NOT_EXCLUDED, Calibration, Table, attribute, calibration
from bayes_iwan.gap.evidence import LENGTHS, SHARES
from bayes_iwan.gap.paper_terms import Step, Terms


def needs(share, nats=0.0, depth=300.0):
    """Evidence of a model that needs a smooth misfit of this share: flat above but for the cost of being larger."""
    below = np.minimum(np.log(SHARES / share), 0.0)
    above = np.maximum(np.log(SHARES / share), 0.0)
    return np.repeat((nats - depth * below**2 - 15.0 * above)[:, None], len(LENGTHS), axis=1)


SMALL = 0.001
NAMES = ("alpha", "beta", "gamma")


def table(base, **others):
    """Effects that are not named explain nothing."""
    out = {(): base} | {(n,): base - IDLE_COST for n in NAMES}
    return Table(out | {tuple(k.split("_and_")): v for k, v in others.items()})


def test_no_gap_is_none():
    a = attribute(table(needs(SMALL)))
    assert a.cause == "none" and a.second_cause is None and a.cannot_tell_apart == ()


def test_gap_that_one_effect_closes_is_that_effect():
    a = attribute(table(needs(0.05), beta=needs(SMALL, 60.0)))
    assert a.cause == "beta" and a.probability > 0.8 and a.cannot_tell_apart == ("beta",)


def test_gap_that_nothing_closes_is_unknown():
    a = attribute(table(needs(0.05), beta=needs(0.05, -4.0)))
    assert a.cause == "unknown"


def test_two_effects_that_close_it_alike_cannot_be_told_apart():
    a = attribute(table(needs(0.05), beta=needs(SMALL, 60.0), gamma=needs(SMALL, 59.5)))
    assert a.cause == "beta" and a.cannot_tell_apart == ("beta", "gamma") and a.second_cause is None
    assert a.probabilities["beta"] < 0.8


def test_shape_without_a_cause_that_closes_it_better_is_unknown():
    t = table(needs(0.05), beta=needs(0.015, 60.0))
    assert attribute(t, None, Calibration()).cause == "beta"
    a = attribute(Table(t.log_z, {"drag": needs(SMALL, 90.0), "bump": needs(0.04, 10.0)}), None, Calibration())
    assert a.cause == "unknown" and a.shape == "drag" and a.cannot_tell_apart == ()
    assert set(a.probabilities) == {"none", "unknown", *NAMES}


def test_a_cause_that_is_nearly_as_probable_is_told_beside_none_and_unknown():
    t = table(needs(0.05), beta=needs(0.005, 60.0))
    weights = [attribute(t, None, Calibration(unknown=u)) for u in np.linspace(0.0, 80.0, 41)]
    close = [a for a in weights if a.cause == "unknown" and a.probabilities["beta"] > NOT_EXCLUDED]
    far = [a for a in weights if a.cause == "unknown" and a.probabilities["beta"] < NOT_EXCLUDED]
    assert close and far
    assert all(a.cannot_tell_apart == ("beta",) for a in close) and all(a.cannot_tell_apart == () for a in far)


def test_kinds_of_answers_are_weighed_by_their_best_so_idle_causes_cost_nothing():
    few, many = (Table({(): needs(SMALL)} | {(f"e{i}",): needs(SMALL) - IDLE_COST for i in range(n)}) for n in (2, 40))
    assert attribute(many).probabilities["none"] == pytest.approx(attribute(few).probabilities["none"], abs=0.02)


@pytest.mark.parametrize("first", ["beta", "gamma"])
def test_pair_that_alone_closes_it_names_both_the_larger_first(first):
    t = table(needs(0.1), beta=needs(0.05, 60.0), gamma=needs(0.06, 40.0), beta_and_gamma=needs(SMALL, 400.0))
    sizes = {("beta", "gamma"): {"beta": 1.0, "gamma": 0.5 if first == "beta" else 2.0}}
    a = attribute(t, sizes)
    assert {a.cause, a.second_cause} == {"beta", "gamma"} and a.cause == first
    assert set(a.cannot_tell_apart) == {"beta", "gamma"}


@pytest.mark.parametrize("one", [table(needs(SMALL)), table(needs(0.05), beta=needs(SMALL, 500.0)), table(needs(0.2))])
def test_probabilities_are_probabilities_and_nothing_is_certain(one):
    p = attribute(one).probabilities
    assert set(p) == {"none", "unknown", *NAMES}
    assert sum(p.values()) == pytest.approx(1.0, abs=1e-12)
    assert all(0.0 < v < calibration().sure + 0.05 for v in p.values())


def test_tempering_keeps_the_order_and_flattens_large_differences():
    c = Calibration(temper=0.5, linear=10.0)
    nats = np.array([-1000.0, -100.0, -1.0, 0.0])
    score = c.score(nats, c.temper)
    assert np.all(np.diff(score) > 0) and score[-1] == 0.0
    assert score[2] == pytest.approx(-0.5, rel=0.01) and -40.0 < score[0]


def test_shipped_calibration_can_be_read_and_written(tmp_path):
    c = calibration()
    assert 0 < c.small[0] < c.large[0] and 0 < c.temper <= 1
    c.save(tmp_path / "c.json")
    assert (tmp_path / "c.json").read_text()
    assert np.logaddexp.reduce(c.log_small) == pytest.approx(0.0, abs=1e-12)


def test_named_effect_may_leave_more_where_the_gap_is_larger():
    c = Calibration()
    small, large = (c.log_named(("a",), gap) for gap in (0.001, 0.3))
    assert large[0] > small[0] == pytest.approx(c.small[0], rel=0.01)
    assert small[1] == pytest.approx(c.small[1], rel=0.01) and large[1] == pytest.approx(c.law_spread, rel=0.05)


def test_evidence_is_integrated_over_the_misfits_share():
    """A table that is flat over the share keeps its value under every prior."""
    flat = {(): np.full((len(SHARES), len(LENGTHS)), -3.0), ("a",): np.full((len(SHARES), len(LENGTHS)), 2.0)}
    found = Table(flat, {"shape": np.full((len(SHARES), len(LENGTHS)), 1.0)}).evidence(Calibration())
    for key, value in {(): -3.0, ("unknown",): -3.0, ("a",): 2.0, ("unknown", "shape"): 1.0}.items():
        assert found[key] == pytest.approx(value, abs=1e-9)


def test_terms_of_the_paper_count_for_the_first_taken_in():
    def fit(log_z):
        return SimpleNamespace(log_z=log_z)

    whole = fit(needs(SMALL, 300.0))
    found = SimpleNamespace(
        base=fit(needs(0.1)),
        singles={"one": (fit(needs(0.09, 20.0)),), "two": ()},
        pairs={("one", "two"): whole},
        effects={"one": (None,), "two": (None,)},
        data=SimpleNamespace(unsteady_nats=0.0),
        unlisted={},
    )
    terms = Terms(found.base, (Step("two", whole, 10.0), Step("one", whole, 290.0)), {}, {})
    a = terms.attribution(found)
    assert (a.cause, a.second_cause) == ("two", "one") and a.probability > 0.8
