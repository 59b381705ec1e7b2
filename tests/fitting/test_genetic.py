"""Global searches on functions with known optima: many modes, curved valleys, scales from 1 to 1e6."""

import numpy as np
import pytest
from scipy.stats import qmc

from bayes_iwan.fitting.genetic import SearchError, genetic_search

NDIM = 10
BOUNDS = np.tile([-5.12, 4.0], (NDIM, 1))


def first(seed):
    return qmc.scale(qmc.Sobol(NDIM, rng=np.random.default_rng(seed)).random(1024), *BOUNDS.T)


FIRST = first(9)


def rastrigin(x):
    return 10 * x.shape[1] + (x**2 - 10 * np.cos(2 * np.pi * x)).sum(axis=1)


def ellipsoid(x):
    return (10 ** (6 * np.arange(NDIM) / (NDIM - 1)) * (x - 0.3) ** 2).sum(axis=1)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_genetic_search_finds_the_global_one_of_ten_to_the_tenth_modes(seed):
    found = genetic_search(rastrigin, BOUNDS, first(seed), seed=seed, progress=False)
    assert found.objective < 0.5  # the next best mode has 0.995
    np.testing.assert_allclose(found.x, 0, atol=0.1)


def test_an_ill_conditioned_bowl():
    found = genetic_search(ellipsoid, BOUNDS, FIRST, seed=0, max_evaluations=60_000, progress=False)
    assert found.objective < 10.0 and found.n_evaluations <= 60_000  # the first population begins at a million


def test_the_first_population_is_the_best_of_what_was_given():
    found = genetic_search(rastrigin, BOUNDS, FIRST, seed=0, members=50, max_evaluations=1000, progress=False)
    assert found.first.shape == (50, NDIM)
    np.testing.assert_array_equal(rastrigin(found.first), np.sort(rastrigin(FIRST))[:50])


def test_result_tells_its_history_and_keeps_a_sorted_population_in_the_box():
    found = genetic_search(rastrigin, BOUNDS, FIRST, seed=3, max_evaluations=4000, progress=False)
    assert (np.diff(found.best) <= 0).all() and (found.median >= found.best).all()
    assert (np.diff(rastrigin(found.population)) >= 0).all() and found.population.shape == (200, NDIM)
    assert ((found.population >= BOUNDS[:, 0]) & (found.population <= BOUNDS[:, 1])).all()
    assert found.stopped == "evaluations" and found.n_evaluations <= 4000 and found.seed == 3


def test_same_seed_same_result_and_another_seed_another():
    runs = [genetic_search(rastrigin, BOUNDS, FIRST, seed=s, max_evaluations=3000, progress=False) for s in (5, 5, 6)]
    np.testing.assert_array_equal(runs[0].population, runs[1].population)
    assert (runs[0].population != runs[2].population).any()


def test_stops_by_itself_when_nothing_gets_better():
    found = genetic_search(lambda x: np.maximum((x**2).sum(axis=1), 1.0), BOUNDS, FIRST, seed=0, progress=False)
    assert found.stopped == "stall" and found.n_evaluations < 60_000


def test_impossible_regions_are_avoided_and_an_impossible_box_is_refused():
    def half(x):  # NaN and inf alike mean: no model here
        return np.where(x[:, 0] < 0.5, np.nan, np.where(x[:, 1] < 0.5, np.inf, (x**2).sum(axis=1)))

    found = genetic_search(half, BOUNDS, FIRST, seed=0, max_evaluations=20_000, progress=False)
    np.testing.assert_allclose(found.x[:2], 0.5, atol=0.05)
    with pytest.raises(SearchError, match="not finite"):
        genetic_search(lambda x: np.full(len(x), np.inf), BOUNDS, FIRST, seed=0, progress=False)
    with pytest.raises(SearchError, match="bounds"):
        genetic_search(rastrigin, [[0, np.inf]], FIRST[:, :1], seed=0, progress=False)
