"""Every proposal by itself, in a plain emcee sampler: walkers that begin as independent draws of a known distribution
remain such draws, and where a proposal's factor is wrong they do not."""

import pickle

import emcee
import numpy as np
import pytest
from emcee.moves import DESnookerMove, MHMove
from scipy import stats

from bayes_iwan.sampling.proposals import _WHOLE, Differences, Independent, Mixture, Snooker, learnt_moves
from bayes_iwan.sampling.straightening import Straightened, Straightening

NDIM, WALKERS, NU = 6, 4000, 8.0
ROOT = np.tril(np.random.default_rng(11).standard_normal((NDIM, NDIM))) + 2.0 * np.eye(NDIM)
EVERY = np.arange(NDIM)
BLOCKS = (EVERY[:2], EVERY[2:])


class Normal:
    """Correlated; `unit` maps draws to independent standard normal numbers."""

    def draw(self, n, rng):
        return rng.standard_normal((n, NDIM)) @ ROOT.T

    def unit(self, x):
        return np.linalg.solve(ROOT, x.T).T

    def log_prob(self, x):
        return -0.5 * np.sum(self.unit(x) ** 2, axis=1)


class Banana(Normal):
    """x2 follows x0² and x3 the product x0 x1, to within 0.3 and 0.2."""

    def draw(self, n, rng):
        x = rng.standard_normal((n, NDIM))
        x[:, 2], x[:, 3] = 0.3 * x[:, 2] + x[:, 0] ** 2, 0.2 * x[:, 3] + x[:, 0] * x[:, 1]
        return x

    def unit(self, x):
        u = x.copy()
        u[:, 2], u[:, 3] = (x[:, 2] - x[:, 0] ** 2) / 0.3, (x[:, 3] - x[:, 0] * x[:, 1]) / 0.2
        return u


class Tailed(Normal):
    """Multivariate t."""

    def draw(self, n, rng):
        return super().draw(n, rng) / np.sqrt(rng.chisquare(NU, n) / NU)[:, None]

    def unit(self, x):
        u = super().unit(x)
        square = np.sum(u * u, axis=1)
        as_normal = stats.chi2.isf(stats.f.sf(square / NDIM, NDIM, NU), NDIM)
        return u * np.sqrt(as_normal / square)[:, None]

    def log_prob(self, x):
        return -0.5 * (NU + NDIM) * np.log1p(np.sum(super().unit(x) ** 2, axis=1) / NU)


def archive(of):
    """Draws to learn from that are few, too narrow and beside the distribution: it is a proposal's factor that must
    make up for it."""
    x = of.draw(800, np.random.default_rng(5))
    near = np.argsort(np.sum((of.unit(x) - 0.4) ** 2, axis=1))[:400]
    return x[np.sort(near)]


def walked(moves, log_prob, x, steps, seed=1):
    """The last places of walkers (n, ndim) that began at x, by emcee; and the share accepted."""
    sampler = emcee.EnsembleSampler(*x.shape, log_prob, moves=moves, vectorize=True)
    state = emcee.State(x, log_prob=log_prob(x), random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    return sampler.get_last_sample().coords, float(np.mean(sampler.acceptance_fraction))


def least_p(u):
    """Of numbers u (n, ndim): the least p value of each being standard normal and of |u|², and of each's square being
    uncorrelated with every other, times how many these are."""
    p = [stats.kstest(column, "norm").pvalue for column in u.T]
    p += [stats.kstest(np.sum(u * u, axis=1), stats.chi2(u.shape[1]).cdf).pvalue]
    p += [stats.spearmanr(a, b).pvalue for i, a in enumerate(u.T) for b in u.T[:i]]
    p += [stats.spearmanr(a**2, b).pvalue for i, a in enumerate(u.T) for j, b in enumerate(u.T) if i != j]
    return len(p) * min(p)


def independent(x):
    """Of all coordinates, from mixtures of two blocks."""
    return Independent([(p, Mixture.fitted(x[:, p], 3, np.random.RandomState(2))) for p in BLOCKS])


def second_block(x):
    return Independent([(BLOCKS[1], Mixture.fitted(x[:, BLOCKS[1]], 2, np.random.RandomState(2)))])


def straightened(make, products=True):
    def made(x):
        straightening = Straightening.fitted(x, BLOCKS, products)
        return Straightened(straightening, make(straightening.straight(x)))

    return made


def left(proposal, of, steps=30):
    """Least p value of walkers that began as draws; the share accepted."""
    ends, accepted = walked([MHMove(proposal)], of.log_prob, of.draw(WALKERS, np.random.default_rng(3)), steps)
    return least_p(of.unit(ends)), accepted


@pytest.mark.parametrize("of", [Normal(), Banana(), Tailed()], ids=["normal", "banana", "t"])
@pytest.mark.parametrize("make", [independent, second_block, Differences, Snooker], ids=lambda f: f.__name__)
@pytest.mark.parametrize("straight", [None, False, True], ids=["plain", "linear", "straight"])
def test_walkers_remain_draws_of_the_distribution(of, make, straight):
    proposal = (make if straight is None else straightened(make, straight))(archive(of))
    p, accepted = left(proposal, of)
    assert p > 0.01 and accepted > (0.3 if straight else 0.08)


class Wrong:
    """A proposal whose factor is so many times what it must be."""

    def __init__(self, proposal, times):
        self.proposal, self.times = proposal, times

    def __call__(self, x, random):
        new, factor = self.proposal(x, random)
        return new, self.times * factor


@pytest.mark.parametrize(
    ("make", "times"),
    [(independent, 0.0), (independent, 0.8), (second_block, 0.8), (Snooker, 0.8), (Snooker, 1.2)],
)
def test_a_wrong_factor_would_be_seen(make, times):
    """So the test above would see it."""
    for way in (make, straightened(make)):
        assert left(Wrong(way(archive(Normal())), times), Normal())[0] < 1e-6


def test_coordinates_that_are_no_straight_ones_would_be_seen():
    """A map that stretches some places more than others needs its Jacobian in the factor; this one has none."""

    class Bent(Straightening):
        def straight(self, x):
            return np.arcsinh(x)

        def back(self, u):
            return np.sinh(u)

    x = archive(Normal())
    assert left(Straightened(Bent((), (), ()), Differences(np.arcsinh(x))), Normal())[0] < 1e-6


@pytest.mark.parametrize("make", [Differences, Snooker], ids=lambda f: f.__name__)
def test_a_normal_distribution_of_sixteen_dimensions_keeps_its_variance(make):
    """Where `emcee.moves.DESnookerMove` of 3.1.6 does not."""
    rng = np.random.default_rng(0)
    start, known = rng.standard_normal((4000, 16)), rng.standard_normal((500, 16))

    def log_prob(x):
        return -0.5 * np.sum(x * x, axis=1)

    ends, accepted = walked([MHMove(make(known))], log_prob, start, 60)
    assert accepted > 0.1 and least_p(ends) > 0.01
    theirs, _ = walked([DESnookerMove()], log_prob, start[:400], 200)
    assert np.mean(np.var(theirs, axis=0)) < 0.7


def test_a_walker_at_a_known_draw_stays_there_in_snookers_step_and_nothing_is_nan():
    one = np.array([[1.0, 2.0]])
    new, factor = Snooker(np.repeat(one, 3, axis=0))(np.array([[1.0, 2.0], [0.0, 0.0]]), np.random.RandomState(0))
    np.testing.assert_array_equal(new, [[1.0, 2.0], [0.0, 0.0]])  # between like draws there is no difference either
    np.testing.assert_array_equal(factor, 0.0)


def test_whole_differences_lead_from_mode_to_mode():
    def two(x):
        tail = -0.5 * np.sum(x[:, 1:] ** 2, axis=1)
        sides = (np.log(w) - 0.5 * ((x[:, 0] - at) / 0.3) ** 2 for w, at in ((0.25, -5.0), (0.75, 5.0)))
        return tail + np.logaddexp(*sides)

    x = np.random.default_rng(0).standard_normal((2000, 3))
    x[:, 0] = np.where(np.arange(2000) < 1000, -5.0, 5.0) + 0.3 * x[:, 0]  # not the shares that they should have
    ends, _ = walked([MHMove(Differences(x[::10]))], two, x, 400)
    assert np.mean(ends[:, 0] < 0.0) == pytest.approx(0.25, abs=0.04)


def test_learnt_moves_lead_from_one_point_to_a_curved_distribution():
    """From few draws of a wrong one; ten moves, whose shares are all."""
    of = Banana()
    moves = learnt_moves(archive(of), BLOCKS, np.random.RandomState(4))
    assert len(moves) == 10 and sum(share for _, share in moves) == pytest.approx(1.0)
    ends, accepted = walked(moves, of.log_prob, np.zeros((WALKERS, NDIM)), 600)
    assert accepted > 0.25 and least_p(of.unit(ends)) > 0.01
    assert np.mean(ends[:, 2]) == pytest.approx(1.0, abs=0.1)  # E x0²
    assert np.cov(ends[:, 0] ** 2, ends[:, 2])[0, 1] == pytest.approx(2.0, abs=0.3)  # Var x0²


def test_one_coordinate_in_one_block_will_do():
    rng = np.random.default_rng(6)
    moves = learnt_moves(2.0 * rng.standard_normal((60, 1)), (np.arange(1),), np.random.RandomState(4))
    ends, accepted = walked(moves, lambda x: -0.5 * x[:, 0] ** 2, rng.standard_normal((WALKERS, 1)), 40)
    assert accepted > 0.3 and stats.kstest(ends[:, 0], "norm").pvalue > 0.01


def test_moves_travel_to_other_processes_and_draw_the_same_there():
    moves = learnt_moves(archive(Banana()), BLOCKS, np.random.RandomState(4))
    x = Banana().draw(50, np.random.default_rng(0))
    here, there = (walked(m, Banana().log_prob, x, 5)[0] for m in (moves, pickle.loads(pickle.dumps(moves))))
    np.testing.assert_array_equal(there, here)


# ---- mixtures


def test_a_mixture_finds_two_far_clusters():
    rng = np.random.default_rng(7)
    scale = np.array([[1.0, 0.6], [0.6, 2.0]])
    x = np.concatenate(
        [
            rng.multivariate_normal([-20.0, 3.0], scale, 3000),
            rng.multivariate_normal([15.0, -4.0], [[0.5, 0.0], [0.0, 0.5]], 1000),
        ]
    )
    found = Mixture.fitted(x, 2, np.random.RandomState(0))
    order = np.argsort(found.centres[:, 0])
    np.testing.assert_allclose(found.weights[order], [0.75, 0.25], atol=1e-3)
    np.testing.assert_allclose(found.centres[order], [[-20.0, 3.0], [15.0, -4.0]], atol=0.1)
    counts = np.array([3000.0, 1000.0])[:, None, None]
    own = counts * np.array([scale, 0.5 * np.eye(2)]) + _WHOLE * np.cov(x.T)  # of all draws, as if so many were its own
    got = found.roots[order] @ found.roots[order].transpose(0, 2, 1)
    np.testing.assert_allclose(got, own / (counts + _WHOLE), atol=0.15)


def test_a_mixtures_density_is_that_of_its_draws():
    rng = np.random.RandomState(1)
    x = np.random.default_rng(1).standard_normal((400, 2)) @ np.array([[2.0, 0.0], [1.0, 0.4]])
    x[:100] += 6.0
    mixture = Mixture.fitted(x, 3, rng)
    parts = [stats.multivariate_t(c, r @ r.T, df=12.0) for c, r in zip(mixture.centres, mixture.roots)]
    at = 5.0 * np.random.default_rng(2).standard_normal((200, 2))
    expected = np.log(sum(w * part.pdf(at) for w, part in zip(mixture.weights, parts)))
    np.testing.assert_allclose(mixture.log_density(at), expected, rtol=1e-10)
    axis = np.linspace(-60.0, 60.0, 1201)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert np.sum(np.exp(mixture.log_density(grid))) * 0.01 == pytest.approx(1.0, abs=1e-3)
    drawn = mixture.draw(20_000, rng)
    for along in (np.array([1.0, 0.0]), np.array([0.6, -0.8])):  # along any line it is a mixture of t as well

        def cdf(s, along=along):
            spread = np.linalg.norm(along @ mixture.roots, axis=1)
            return sum(
                w * stats.t.cdf((s - m) / d, 12.0) for w, m, d in zip(mixture.weights, mixture.centres @ along, spread)
            )

        assert stats.kstest(drawn @ along, cdf).pvalue > 0.01


def test_more_components_than_clusters_and_hardly_more_draws_than_components_will_do():
    x = np.random.default_rng(3).standard_normal((26, 9))
    mixture = Mixture.fitted(x, 24, np.random.RandomState(0))
    assert np.isfinite(mixture.log_density(x)).all() and mixture.weights.sum() == pytest.approx(1.0)
    assert np.isfinite(mixture.draw(100, np.random.RandomState(0))).all()
