"""Every move on targets whose draws can be made exactly, and proposals against their own densities."""

import pickle
from functools import lru_cache

import emcee
import numpy as np
import pytest
from scipy import stats

from bayes_iwan.sampling.common.mixture import fit_mixture
from bayes_iwan.sampling.ensemble.moves import DifferentialEvolutionMove, MixtureMove, SnookerMove, StretchMove
from bayes_iwan.sampling.ensemble.proposal import Proposal, fit_proposal
from bayes_iwan.sampling.ensemble.warp import fit_warp


def gaussian(z):
    return -0.5 * (z**2).sum(axis=1)


def banana(z):  # unit normal after z1 -> z1 - z0**2
    return gaussian(np.column_stack([z[:, 0], z[:, 1] - z[:, 0] ** 2, z[:, 2:]]))


def two_modes(z):  # weights 1/4 at -3 and 3/4 at +3 along the first axis
    tail = -0.5 * (z[:, 1:] ** 2).sum(axis=1)
    return tail + np.logaddexp(np.log(0.25) - 0.5 * (z[:, 0] + 3) ** 2, np.log(0.75) - 0.5 * (z[:, 0] - 3) ** 2)


def half_space(z):  # unit normal cut at z0 > 0, z1 > 0
    return np.where((z[:, :2] > 0).all(axis=1), gaussian(z), -np.inf)


def exact(name, n, ndim, rng):
    z = rng.standard_normal((n, ndim))
    if name == "banana":
        z[:, 1] += z[:, 0] ** 2
    elif name == "two_modes":
        z[:, 0] += np.where(rng.random(n) < 0.25, -3, 3)
    elif name == "half_space":
        z[:, :2] = np.abs(z[:, :2])
    return z


TARGETS = {
    "gaussian": (gaussian, 16),
    "banana": (banana, 4),
    "two_modes": (two_modes, 3),
    "half_space": (half_space, 4),
}


@lru_cache
def crude_proposal(name):
    """A proposal fitted to few, biased draws: it must not matter for what is sampled, only for how fast."""
    rng = np.random.default_rng(99)
    return fit_proposal(1.2 * exact(name, 800, TARGETS[name][1], rng) + 0.1, rng)


MOVES = {
    "stretch": lambda name: StretchMove(),
    "differential evolution": lambda name: DifferentialEvolutionMove(jump=0.3),
    "snooker": lambda name: SnookerMove(),
    "independence": lambda name: MixtureMove(crude_proposal(name), independent=1.0),
    "Crank-Nicolson": lambda name: MixtureMove(crude_proposal(name), independent=0.0, rho=(0.3, 0.7)),
    "mixture": lambda name: MixtureMove(crude_proposal(name), independent=0.5),
}


def the_move(move, name, ensembles=2):
    made = MOVES[move](name)
    made.ensembles = ensembles
    return made


def run(move, log_prob, start, steps, seed=7):
    sampler = emcee.EnsembleSampler(len(start), start.shape[1], log_prob, moves=[move], vectorize=True)
    state = emcee.State(start, random_state=np.random.RandomState(seed).get_state())
    draws = np.empty((steps, *start.shape))
    for i, now in enumerate(sampler.sample(state, iterations=steps, store=False)):
        draws[i] = now.coords
    return draws


@pytest.mark.parametrize(
    "name, move",
    [
        *(("gaussian", m) for m in ("stretch", "differential evolution", "snooker", "independence", "mixture")),
        *(("banana", m) for m in ("stretch", "differential evolution", "snooker", "Crank-Nicolson", "mixture")),
        *(("two_modes", m) for m in ("differential evolution", "independence", "mixture")),
        *(("half_space", m) for m in ("stretch", "snooker", "independence", "Crank-Nicolson", "mixture")),
    ],
)
def test_started_in_equilibrium_a_move_stays_there(name, move):
    # Starting from exact draws and looking only at the last state of many independent ensembles gives independent
    # draws, so the test is exact however slowly the move mixes: any wrong factor drifts away within the steps.
    log_prob, ndim = TARGETS[name]
    rng = np.random.default_rng([1, len(name), len(move)])
    walkers = 2 * ndim + 4
    copies = 2000 // walkers
    start = exact(name, copies * walkers, ndim, rng)
    ends = run(the_move(move, name, copies), log_prob, start, 40)[-1]
    judge = exact(name, 20_000, ndim, rng)
    radius, judge_radius = np.linalg.norm(ends, axis=1), np.linalg.norm(judge, axis=1)
    values = [stats.ks_2samp(ends[:, j], judge[:, j]).pvalue for j in range(min(ndim, 4))]
    values.append(stats.ks_2samp(radius, judge_radius).pvalue)
    assert min(values) * len(values) > 1e-3, values
    moved = (ends != start).any(axis=1).mean()
    assert moved > 0.5


def test_a_walker_on_another_is_left_there_by_the_snooker_move_without_a_warning():
    """An exchange or a rescue can put walkers onto each other: a line through both is then none."""
    here = np.ones((1, 4, 3))
    q, factor = SnookerMove().get_proposal(here, here, np.random.RandomState(0))
    np.testing.assert_array_equal(q, here)
    assert not (np.log(0.5) < factor).any()


def test_the_same_test_catches_emcees_own_snooker_move():
    rng = np.random.default_rng(3)
    starts = rng.standard_normal((6, 80, 16))
    ends = np.concatenate([run(emcee.moves.DESnookerMove(), gaussian, z, 40)[-1] for z in starts])
    assert stats.kstest(np.linalg.norm(ends, axis=1), stats.chi(16).cdf).pvalue < 1e-3


@pytest.mark.parametrize("move", ["differential evolution", "snooker", "mixture"])
def test_from_elsewhere_a_move_comes_to_the_mean_and_variance_of_a_16_d_gaussian(move):
    rng = np.random.default_rng(4)
    walkers = 80
    start = 0.3 * rng.standard_normal((2 * walkers, 16)) + 0.5
    draws = run(the_move(move, "gaussian"), gaussian, start, 2000)[500:]
    assert abs(draws.mean()) < 0.03
    assert abs(draws.var() - 1) < 0.03


@pytest.mark.parametrize("move", ["differential evolution", "mixture"])
def test_rungs_draw_from_the_targets_powers_and_exchange_keeps_them(move):
    # exact draws on both rungs, many independent ensembles, only the last states: exact however slow
    rng, ensembles, walkers, ndim = np.random.default_rng(13), 50, 36, 16
    made = the_move(move, "gaussian", ensembles)
    made.powers = (1.0, 0.4)
    start = rng.standard_normal((2 * ensembles * walkers, ndim))
    start[ensembles * walkers :] /= np.sqrt(0.4)
    ends = run(made, gaussian, start, 30)[-1]
    for rung, sd in ((ends[: ensembles * walkers], 1.0), (ends[ensembles * walkers :], np.sqrt(1 / 0.4))):
        radius = np.linalg.norm(rung, axis=1)
        assert stats.kstest(radius, stats.chi(ndim, scale=sd).cdf).pvalue > 1e-3
        assert stats.kstest(rung[:, 0], stats.norm(0, sd).cdf).pvalue > 1e-3


def test_exchange_brings_walkers_across_a_gap_that_the_first_rung_cannot_cross():
    def log_prob(z):
        return -0.5 * ((np.abs(z[:, 0]) - 6.0) / 0.8) ** 2 - 0.5 * z[:, 1] ** 2

    start = np.random.default_rng(14).standard_normal((2 * 2 * 20, 2)) * [0.8, 1.0] + [6.0, 0.0]
    shares = []
    for powers, ensembles in (((1.0,), 4), ((1.0, 0.05), 2)):
        move = DifferentialEvolutionMove(jump=0.0, ensembles=ensembles, powers=powers)
        draws = run(move, log_prob, start, 3000)
        shares.append((draws[1000:, : start.shape[0] // len(powers), 0] < 0).mean())
    assert shares[0] == 0.0 and 0.35 < shares[1] < 0.65


def test_ensembles_never_look_at_each_other():
    rng = np.random.default_rng(5)
    a, b, c = (exact("banana", 12, 4, rng) for _ in range(3))
    for move in (DifferentialEvolutionMove(ensembles=2), SnookerMove(ensembles=2), StretchMove(ensembles=2)):
        one = run(move, banana, np.concatenate([a, b]), 1)[-1]
        two = run(move, banana, np.concatenate([a, c]), 1)[-1]
        np.testing.assert_array_equal(one[:12], two[:12])  # the second half of the first step may differ later


def test_moves_survive_pickling():
    rng = np.random.default_rng(6)
    start = exact("banana", 24, 4, rng)
    for move in (the_move(m, "banana") for m in MOVES):
        again = pickle.loads(pickle.dumps(move))
        # another memory layout may sum in another order: to the last bit but one
        np.testing.assert_allclose(run(again, banana, start, 5), run(move, banana, start, 5), rtol=1e-12, atol=1e-12)


def test_steps_are_in_detailed_balance_with_the_proposals_own_density():
    # Flux between two regions under g itself must be equal both ways: pairs (z, z') and (z', z) look alike.
    rng = np.random.default_rng(8)
    g = fit_proposal(exact("two_modes", 3000, 3, rng), rng)
    z = g.sample(40_000, 1)
    for independent in (0.0, 1.0):
        places, factor = g.step(g.at(z), independent, np.array([0.3, 0.7]), np.random.RandomState(2))
        new = places.z
        there = (z[:, 0] < 0) & (new[:, 0] > 2)
        back = (new[:, 0] < 0) & (z[:, 0] > 2)
        assert abs(there.sum() - back.sum()) < 4 * np.sqrt(there.sum() + back.sum() + 1)
        assert stats.ks_2samp(z[:, 0], new[:, 0]).pvalue > 1e-3
        np.testing.assert_allclose(factor, g.log_density(z) - g.log_density(new), atol=1e-9)


def test_what_a_move_remembers_of_walkers_is_what_it_would_find_anew():
    rng = np.random.default_rng(12)
    g = fit_proposal(exact("two_modes", 3000, 3, rng), rng)
    move, random = MixtureMove(g, ensembles=2), np.random.RandomState(0)
    s = exact("two_modes", 40, 3, rng).reshape(2, 20, 3)
    for _ in range(6):
        q, factor = move.get_proposal(s, s[:, :0], random)
        expected = g.log_density(s.reshape(-1, 3)) - g.log_density(q.reshape(-1, 3))
        np.testing.assert_array_equal(factor.ravel(), expected)
        taken = rng.random((2, 20, 1)) < 0.5
        s = np.where(taken, q, s)
        s[0, :3] += 0.1  # another move has been at these
    assert move._seen is not None


def test_a_proposals_density_is_normalised():
    rng = np.random.default_rng(9)
    z = exact("banana", 4000, 2, rng)
    g = fit_proposal(z, rng)
    grid = np.stack(np.meshgrid(np.linspace(-30, 30, 601), np.linspace(-30, 60, 901), indexing="ij"), axis=-1)
    total = np.exp(g.log_density(grid.reshape(-1, 2))).sum() * 0.1 * 0.1
    assert total == pytest.approx(1, abs=0.01)


def test_compiled_charts_agree_with_their_numpy_reference_and_come_back():
    rng = np.random.default_rng(10)
    z = rng.standard_normal((3000, 6))
    z[:, 1] += z[:, 0] ** 2
    z[:, 4] *= np.exp(0.5 * z[:, 0])
    z[:1000, 2] += 8
    g = fit_proposal(z, rng)
    assert len(g.charts) > 1
    x, squared, log_det = g._stack.standard(z[:100])
    np.testing.assert_allclose(squared, np.sum(x**2, axis=2))
    for k, chart in enumerate(g.charts):
        y, reference = chart.warp.forward(z[:100])
        np.testing.assert_allclose(x[:, k], np.linalg.solve(chart.root, (y - chart.centre).T).T, atol=1e-9)
        np.testing.assert_allclose(log_det[:, k], reference, atol=1e-9)
        np.testing.assert_allclose(g._stack.place(x[:, k], np.full(100, k)), z[:100], atol=1e-9)
        np.testing.assert_allclose(chart.warp.inverse(y)[0], z[:100], atol=1e-9)
    again = Proposal.from_arrays(g.to_arrays())
    np.testing.assert_array_equal(again.log_density(z), g.log_density(z))


def test_the_warps_jacobian_is_its_derivative():
    rng = np.random.default_rng(11)
    z = exact("banana", 2000, 3, rng)
    warp = fit_warp(z, 2, 3)
    h = 1e-6
    for point in z[:5]:
        ahead, behind = (warp.forward(point + sign * h * np.eye(3))[0] for sign in (1, -1))
        _, log_det = np.linalg.slogdet((ahead - behind) / (2 * h))
        assert log_det == pytest.approx(warp.forward(point[None])[1][0], abs=1e-6)


def test_a_bent_sheet_is_straightened():
    rng = np.random.default_rng(12)
    z = rng.standard_normal((6000, 8))
    z[:, 3:] *= 0.01
    z[:, 3] += 0.5 * z[:, 0] ** 2 - 0.3 * z[:, 1] * z[:, 2]
    z[:, 4] += 0.2 * z[:, 0] ** 3
    straight = fit_proposal(z[:4000], rng, charts=3, wide=6, degree=4)
    many = fit_proposal(z[:4000], rng)
    plain = fit_mixture(z[:4000], 12, rng)
    test = z[4000:]
    entropy = -0.5 * 8 * (1 + np.log(2 * np.pi)) - 5 * np.log(0.01)  # the best that any density can score
    assert straight.log_density(test).mean() > entropy - 1.0
    assert straight.log_density(test).mean() > plain.log_density(test).mean() + 1.0
    assert many.log_density(test).mean() > plain.log_density(test).mean() + 0.5
