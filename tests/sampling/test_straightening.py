"""The map that makes bent draws straight: what it is to do, and that its Jacobian is the same everywhere."""

import numpy as np
import pytest

from bayes_iwan.sampling.straightening import Straightening

#: of five coordinates, in no order
BLOCKS = (np.array([3, 0]), np.array([4]), np.array([1, 2]))


def bent(n, seed=0):
    """Draws (n, 5) and the standard normal numbers (n, 5) that they are made of: block after block, each with a
    quadratic of the ones before."""
    u = np.random.default_rng(seed).standard_normal((n, 5))
    x = np.empty_like(u)
    x[:, 3], x[:, 0] = 2.0 * u[:, 3] + 1.0, 0.5 * u[:, 0] + u[:, 3] - 4.0
    x[:, 4] = 0.1 * u[:, 4] + u[:, 3] ** 2 - 0.7 * u[:, 3] * u[:, 0]
    x[:, 1] = 3.0 * u[:, 1] + 2.0 * u[:, 4] * u[:, 0]
    x[:, 2] = 0.2 * u[:, 2] - 0.1 * u[:, 1] + u[:, 4] ** 2 + 5.0
    return x, u


@pytest.mark.parametrize(
    "blocks", [BLOCKS, (np.arange(5),), tuple(np.arange(5)[:, None])], ids=["three", "one", "five"]
)
@pytest.mark.parametrize("n", [8, 500])
def test_there_and_back(blocks, n):
    """Also far from the draws, and where there are fewer of them than terms."""
    x, _ = bent(n)
    there = Straightening.fitted(x, blocks)
    for some in (x, 10.0 * x - 3.0):
        np.testing.assert_allclose(there.back(there.straight(some)), some, rtol=1e-6, atol=1e-6)
    u = np.random.default_rng(1).standard_normal((50, 5))
    np.testing.assert_allclose(there.straight(there.back(u)), u, rtol=1e-6, atol=1e-5)


def test_a_quadratic_bend_becomes_straight():
    """The straight coordinates are the numbers that the draws are made of, but for their turn within a block."""
    x, u = bent(40_000)
    there = Straightening.fitted(x, BLOCKS)
    more, made_of = bent(20_000, seed=1)
    found = there.straight(more)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.04)
    np.testing.assert_allclose(np.cov(found.T), np.eye(5), atol=0.06)
    np.testing.assert_allclose(found[:, 4], made_of[:, 4], atol=0.4)  # alone in its block
    products = (made_of[:, :, None] * made_of[:, None]).reshape(len(more), -1)
    np.testing.assert_allclose(found.T @ (products - products.mean(axis=0)) / len(more), 0.0, atol=0.06)
    assert np.abs(np.cov(x[:, 4], u[:, 3] ** 2)[0, 1]) > 1.5  # as it was before


def test_without_products_it_is_the_root_of_the_covariance():
    """In the blocks' order, whatever these are, and as linear far from the draws as among them."""
    x, _ = bent(40_000)
    order = np.concatenate(BLOCKS)
    root = np.linalg.cholesky(np.cov(x[:, order].T))
    more = bent(50, seed=1)[0]
    found = Straightening.fitted(x, BLOCKS, products=False).straight(more)[:, order]
    np.testing.assert_allclose(found, np.linalg.solve(root, (more - x.mean(axis=0))[:, order].T).T, atol=0.05)
    far = Straightening.fitted(x, BLOCKS, products=False).straight(np.array([x[0], 3.0 * x[0] - 2.0 * x[1], x[1]]))
    np.testing.assert_allclose(far[1], 3.0 * far[0] - 2.0 * far[2], rtol=1e-6)


def test_draws_of_one_block_are_only_scaled():
    x = np.random.default_rng(2).standard_normal((100, 3)) @ np.array(
        [[2.0, 0.0, 0.0], [1.0, 0.3, 0.0], [0.0, 5.0, 1.0]]
    )
    u = Straightening.fitted(x, (np.arange(3),)).straight(x)
    np.testing.assert_allclose(u.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(u.T @ u / 100, np.eye(3), atol=1e-9)
    one = Straightening.fitted(x[:, :1], (np.arange(1),)).straight(x[:, :1])
    np.testing.assert_allclose(one[:, 0], (x[:, 0] - x[:, 0].mean()) / x[:, 0].std(), rtol=1e-9)


def test_few_draws_of_unrelated_coordinates_are_not_taken_for_a_bend():
    """A regression of 20 draws on 28 terms would fit them all: coordinates are then straight in the draws alone."""
    x = np.random.default_rng(3).standard_normal((20, 8))
    blocks = (np.arange(6), np.arange(6, 8))
    there = Straightening.fitted(x, blocks)
    more = np.random.default_rng(4).standard_normal((5000, 8))
    assert np.all(np.std(there.straight(more)[:, 6:], axis=0) < 3.0)
    assert np.all(np.std(there.back(more)[:, 6:], axis=0) < 1.6)


@pytest.mark.parametrize("blocks", [BLOCKS, (np.arange(5),)], ids=["three", "one"])
def test_the_jacobian_is_the_same_everywhere(blocks):
    x, _ = bent(400)
    there = Straightening.fitted(x, blocks)
    step = 1e-5 * np.eye(5)
    found = []
    for at in (x[0], x[1], x[2] + 5.0, np.zeros(5), np.full(5, -20.0)):
        slopes = (there.straight(at + step) - there.straight(at - step)) / 2e-5
        found.append(np.linalg.slogdet(slopes)[1])
    expected = -sum(np.log(np.diag(root)).sum() for root in there.roots)
    np.testing.assert_allclose(found, expected, atol=1e-4)
