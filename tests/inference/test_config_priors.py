"""Priors in a configuration are what `Parameter` takes, too: frozen distributions of scipy.stats."""

import pytest
from scipy import stats

import bayes_iwan as bi


@pytest.mark.parametrize("frozen", [stats.lognorm(0.5, scale=5.0), stats.beta(2, 3, 0.1, scale=2.0), stats.norm(1.0)])
def test_a_frozen_distribution_is_the_table_that_says_the_same(frozen):
    for spec in (frozen, {"prior": frozen}):
        choice = bi.settings_of({"parameters": {"beta": spec}}).parameters["beta"].prior
        again = getattr(stats, choice.dist)(**choice.arguments)
        assert again.ppf([0.1, 0.5, 0.9]) == pytest.approx(frozen.ppf([0.1, 0.5, 0.9]))
