"""A population drawn with known mean and spread is found again, as often as the intervals say."""

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.results.population import SpecimenDraws, population


def drawn(rng, n, middle, spread, error, prior=(0.0, 3.0)):
    """Exact posteriors of n specimens, each with its own error, under a normal prior of its logarithm (mean, sd)."""
    out = []
    for i in range(n):
        true = middle + spread * rng.standard_normal()
        sd = error * rng.uniform(0.5, 1.5)
        seen = true + sd * rng.standard_normal()
        precision = 1 / sd**2 + 1 / prior[1] ** 2
        at = (seen / sd**2 + prior[0] / prior[1] ** 2) / precision
        draws = at + rng.standard_normal(400) / np.sqrt(precision)
        before = prior[0] + prior[1] * rng.standard_normal(1000)
        out.append(SpecimenDraws(f"s{i:02d}", np.exp(draws), np.exp(before)))
    return out


@pytest.mark.parametrize(
    "n, spread, error, prior",
    [(12, 0.10, 0.03, (0.0, 3.0)), (12, 0.05, 0.10, (0.0, 3.0)), (20, 0.15, 0.15, (1.0, 0.4))],
    ids=["well seen", "hardly seen", "prior as narrow as the population"],
)
def test_intervals_cover(n, spread, error, prior):
    """Typical value and spread within their 90 % intervals in as many of 60 populations as they should."""
    hits = np.zeros(2, int)
    for k in range(60):
        found = population(drawn(np.random.default_rng([n, k]), n, 1.5, spread, error, prior))
        assert found.relative
        for j, (true, (_, low, high)) in enumerate(((np.exp(1.5), found.typical), (spread, found.spread))):
            hits[j] += low <= true <= high
    low, high = stats.binom.ppf([0.001, 0.999], 60, 0.9)
    # a flat prior on the spread errs to the wide side where it is hardly seen: covering too often is not refused
    assert low <= hits[0] and low <= hits[1], hits
    assert hits[0] <= high, hits


def test_the_prior_of_each_specimen_does_not_pull_the_population():
    """All priors centred far below: unweighted draws would put the typical value there."""
    rng = np.random.default_rng(3)
    specimens = drawn(rng, 40, 1.5, 0.1, 0.4, (0.5, 0.5))
    plain = np.mean([np.mean(np.log(s.draws)) for s in specimens])
    found = population(specimens)
    assert plain < 1.2
    assert found.typical[1] < np.exp(1.5) < found.typical[2]


def test_a_specimen_that_stands_out_is_named_and_others_are_not():
    rng = np.random.default_rng(4)
    specimens = drawn(rng, 15, 1.5, 0.05, 0.02)
    assert population(specimens).outliers() == ()
    odd = specimens[6]
    specimens[6] = SpecimenDraws("odd", 1.6 * odd.draws, odd.prior)
    found = population(specimens)
    assert found.outliers() == ("odd",)
    low, high = found.next_specimen
    assert low < np.exp(1.5) < high


def test_a_quantity_of_either_sign_and_too_few_specimens():
    rng = np.random.default_rng(5)
    some = [
        SpecimenDraws(str(i), v + 0.1 * rng.standard_normal(300), rng.standard_normal(500))
        for i, v in enumerate((-0.1, 0.0, 0.2, 0.1))
    ]
    found = population(some)
    assert not found.relative and found.typical[1] < 0.05 < found.typical[2]
    assert population(some[:2]) is None
    assert population([SpecimenDraws("c", np.ones(10), np.ones(10))] * 4) is None


def test_draws_too_far_apart_for_doubles_have_no_population():
    far = [SpecimenDraws(str(i), np.array([-1.0, 1.0, 2.0]) * 1e300, np.array([-1e300, 1e300])) for i in range(3)]
    with np.errstate(all="ignore"):
        assert population(far) is None
