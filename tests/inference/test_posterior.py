"""A posterior's draws in the orders in which they are asked for, with numbers that say where they stand."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.inference.results.posterior import Posterior


def posterior(chains=3, walkers=2, steps=5, ndim=4):
    """z of chain c, walker w, step s and column i is 1000 c + 100 w + 10 s + i; walkers one after the other."""
    c, w, s, i = np.meshgrid(*map(np.arange, (chains, walkers, steps, ndim)), indexing="ij")
    z = (1000 * c + 100 * w + 10 * s + i).reshape(chains, walkers * steps, ndim).astype(float)
    return SimpleNamespace(z=z, walkers=walkers, ndim=ndim)


def test_diagnostics_take_values_by_chain_step_and_walker():
    one = posterior()
    found = Posterior.by_steps(one, Posterior.flat_z(one)[:, 0])
    assert found.shape == (3, 5, 2) and found[2, 4, 1] == 2140.0 and found[0, 3, 0] == 30.0
    assert np.all(np.diff(found, axis=1) == 10.0) and np.all(np.diff(found, axis=2) == 100.0)


@pytest.mark.parametrize("most", [None, 30, 31, 7])
def test_draws_are_all_or_some_that_lie_evenly_from_the_first_to_the_last(most):
    one = posterior()
    every, some = Posterior.flat_z(one), Posterior.flat_z(one, most)
    assert every.shape == (30, 4) and len(some) == min(most or 30, 30)
    np.testing.assert_array_equal(some[[0, -1]], every[[0, -1]])
    places = [int(np.flatnonzero(np.all(every == row, axis=1))[0]) for row in some]
    assert np.ptp(np.diff(places)) <= 1 and np.min(np.diff(places)) >= 1
