"""Parameters: closed forms of their priors against SciPy's own quantiles, cut to bounds or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

from bayes_iwan.models import Parameter
from bayes_iwan.models.parameter import Together

PRIORS = [
    (stats.norm(loc=0.3, scale=2.0), (-1.0, 1.5)),
    (stats.norm(0.3, 2.0), (0.8, np.inf)),
    (stats.lognorm(s=0.7, scale=5.2), (3.0, 9.0)),
    (stats.lognorm(0.7, 0.5, 5.2), (1.0, 4.0)),
    (stats.uniform(loc=2.0, scale=3.0), (2.5, 4.0)),
    (stats.t(df=2, loc=0.1, scale=0.4), (-0.5, 3.0)),
    (stats.beta(1, 4), (0.05, 0.6)),
    (stats.beta(2.0, 3.0), (0.2, 0.9)),
    (stats.gamma(a=2.0, scale=1.5), (1.0, 6.0)),
    (stats.t(df=5, scale=0.4), (-0.5, 3.0)),  # as t and beta, but not of the closed form
    (stats.gamma(1, 2), (2.5, 6.0)),
]
Z = np.array([-5.0, -2.2, -0.4, 0.0, 0.7, 2.5, 5.0])


def parameter(prior, ends=(-np.inf, np.inf), name="x"):
    return Parameter(name, "x", "-", "a number", prior, *ends)


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("prior, ends", PRIORS)
def test_value_has_as_much_of_the_prior_below_as_a_normal_has_below_z(prior, ends, cut):
    p = parameter(prior, ends) if cut else parameter(prior)
    low, high = (prior.cdf(ends[0]), prior.cdf(ends[1])) if cut else (0.0, 1.0)
    expected = prior.ppf(low + stats.norm.cdf(Z) * (high - low))
    np.testing.assert_allclose(p.value(Z), expected, rtol=1e-7, atol=1e-9)
    inner = slice(1, -1)  # the tails of a cdf near 1 have lost their digits
    np.testing.assert_allclose(p.score(p.value(Z))[inner], Z[inner], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("prior, ends", PRIORS)
def test_density_within_the_bounds_is_one_in_all_and_none_outside(prior, ends):
    p = parameter(prior, ends)
    top = ends[1] if np.isfinite(ends[1]) else float(prior.ppf(1.0 - 1e-12))
    whole, _ = integrate.quad(lambda x: float(np.exp(p.log_density(np.array(x)))), ends[0], top)
    assert whole == pytest.approx(1.0, rel=1e-6)
    assert p.log_density(np.array(ends[0] - 1e-6)) == -np.inf
    if np.isfinite(ends[1]):
        assert p.log_density(np.array(ends[1] + 1e-6)) == -np.inf


@pytest.mark.parametrize("cut", [False, True])
def test_parameters_together_are_each_alone_to_the_bit(cut):
    several = [parameter(prior, ends) if cut else parameter(prior) for prior, ends in PRIORS]
    z = np.random.default_rng(4).standard_normal((50, len(several)))
    together = Together(several).values_within(z)
    for row, p, column in zip(together, several, z.T):
        np.testing.assert_array_equal(row, p.value_within(column))


def test_prior_in_words():
    p = parameter(stats.lognorm(s=0.7, scale=5.2))
    assert p.prior_text() == "lognorm(s=0.7, scale=5.2)"
    assert replace(p, fixed=3.0).prior_text() == "fixed at 3"
    assert replace(p, tied="y").prior_text() == "tied to y"
    assert replace(p, lower=1.0, upper=9.0).prior_text() == "lognorm(s=0.7, scale=5.2) within [1, 9]"


def test_it_is_sampled_unless_fixed_or_tied_and_linear_in_z_where_its_prior_is_an_uncut_normal():
    p = parameter(stats.norm(loc=0.3, scale=2.0))
    fixed, tied = replace(p, fixed=0.0), replace(p, tied="y")
    assert (p.free, fixed.free, tied.free) == (True, False, False)
    others = (replace(p, lower=-1.0), replace(p, upper=9.0), parameter(stats.lognorm(s=0.7, scale=5.2)))
    assert [x.normal for x in (p, fixed, tied, *others)] == [True, False, False, False, False, False]
