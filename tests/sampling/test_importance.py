"""Draws by importance from residual maps, on posteriors whose moments a grid gives."""

from dataclasses import replace

import numba as nb
import numpy as np
import pytest

from bayes_iwan.sampling.common.chains import Stop
from bayes_iwan.sampling.common.checkpoint import CheckpointError
from bayes_iwan.sampling.common.held import log_mean_exp
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.independent import importance
from bayes_iwan.sampling.independent.branches import Optimum
from bayes_iwan.sampling.independent.importance import sample_independently
from bayes_iwan.sampling.independent.residual_map import ResidualMap
from bayes_iwan.sampling.independent.source import Source
from bayes_iwan.sampling.independent.weights import untrusted

NONE = np.empty(0, dtype=np.int64)


def drawn(residuals, optima, **options):
    """Draws of exp(−½|r(z)|² − ½|z|²) with nothing held, (n, ndim), and the chains."""

    def log_prob(z):
        return -0.5 * np.sum(residuals(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1)

    k = residuals(np.atleast_2d(optima[0])).shape[1]
    peaks = [
        Optimum(np.array(z, float), float(log_prob(np.atleast_2d(z))[0]), np.eye(k), np.empty((0, 0))) for z in optima
    ]
    peaks.sort(key=lambda o: -o.log_prob)
    chains = sample_independently(
        residuals,
        lambda z, held: log_prob(z)[:, None],
        peaks,
        NONE,
        Plan(tuple(f"z{i}" for i in range(len(optima[0]))), **{"seed": 3, "progress": False, **options}),
        limit=7.0,
    )
    return chains, None if chains is None else chains.flat()


def grid_moments(residuals, functions):
    """Means of functions of z (n, 2) under the posterior, by a fine grid."""
    axis = np.linspace(-6.0, 6.0, 1501)
    z = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    log_p = -0.5 * np.sum(residuals(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1)
    p = np.exp(log_p - log_p.max())
    return [float(np.sum(p * f(z)) / p.sum()) for f in functions]


def test_a_linear_model_is_drawn_exactly():
    matrix = np.array([[2.0, 1.0], [0.0, 30.0]])
    mean = np.linalg.solve(matrix.T @ matrix + np.eye(2), matrix.T @ np.array([1.0, 9.0]))
    chains, z = drawn(lambda z: z @ matrix.T - np.array([1.0, 9.0]), [mean], target_ess=1500)
    assert chains.converged and chains.convergence.worst_r_hat < 1.01
    covariance = np.linalg.inv(matrix.T @ matrix + np.eye(2))
    assert np.all(np.abs(z.mean(axis=0) - mean) < 4.0 * np.sqrt(np.diag(covariance) / 1500))
    np.testing.assert_allclose(np.cov(z.T), covariance, rtol=0.15, atol=1e-3)


def test_a_thin_bent_sheet_is_drawn_with_few_proposals():
    """z1 = z0² to within 0.01: a hundred times thinner than long."""

    def residuals(z):
        return np.stack([100.0 * (z[:, 1] - z[:, 0] ** 2), 0.5 * (z[:, 0] - 0.3)], axis=1)

    chains, z = drawn(residuals, [[0.05, 0.0025]])
    assert chains.converged and chains.n_steps < 4000
    wanted = grid_moments(residuals, [lambda z: z[:, 0], lambda z: z[:, 0] ** 2, lambda z: (z[:, 1] < 0.1) * 1.0])
    found = [z[:, 0].mean(), np.mean(z[:, 0] ** 2), np.mean(z[:, 1] < 0.1)]
    np.testing.assert_allclose(found, wanted, atol=0.08)
    assert np.max(np.abs(z[:, 1] - z[:, 0] ** 2)) < 0.06


def test_two_modes_get_their_shares():
    def residuals(z):
        return np.stack([4.0 * (z[:, 0] ** 2 - 1.0), 0.7 * (z[:, 0] - 0.5), z[:, 1] - z[:, 0]], axis=1)

    chains, z = drawn(residuals, [[0.97, 0.5], [-0.95, -0.5]])
    assert chains.converged
    (right,) = grid_moments(residuals, [lambda z: (z[:, 0] > 0.0) * 1.0])
    assert 0.6 < right < 0.9
    assert np.mean(z[:, 0] > 0.0) == pytest.approx(right, abs=0.07)


def test_an_optimum_of_the_same_mode_given_twice_changes_nothing():
    def residuals(z):
        return np.stack([6.0 * (z[:, 1] - 0.3 * z[:, 0] ** 3), z[:, 0]], axis=1)

    _, once = drawn(residuals, [[0.0, 0.0]], target_ess=1000)
    _, twice = drawn(residuals, [[0.0, 0.0], [0.4, 0.02]], target_ess=1000)
    np.testing.assert_allclose(once.std(axis=0), twice.std(axis=0), rtol=0.12)
    wanted = grid_moments(residuals, [lambda z: z[:, 0] ** 2])[0] ** 0.5
    assert twice[:, 0].std() == pytest.approx(wanted, rel=0.1)


def test_held_noise_is_integrated_out():
    """Ten residuals of z0 with scale exp(z1): the joint posterior's moments by a grid."""
    y = np.random.default_rng(0).standard_normal(10) * 0.5 + 0.8

    def log_prob(z):
        scale = np.exp(z[..., 1])
        squares = np.sum((y - z[..., :1]) ** 2, axis=-1)
        return -10.0 * z[..., 1] - 0.5 * squares / scale**2 - 0.5 * np.sum(z * z, axis=-1)

    def held_log_prob(z, held):
        every = np.repeat(z[:, None], held.shape[1], axis=1)
        every[:, :, 1] = held[:, :, 0]
        return log_prob(every)

    axis = np.linspace(-3.0, 3.0, 1201)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1)
    p = np.exp(log_prob(grid) - log_prob(grid).max())
    moments = [np.sum(p * f) / p.sum() for f in (grid[..., 0], grid[..., 1], grid[..., 0] ** 2, grid[..., 1] ** 2)]
    best = grid.reshape(-1, 2)[np.argmax(p)]
    optimum = Optimum(best, float(log_prob(best)), np.exp(-best[1]) * np.eye(10), np.array([[0.22]]))
    chains = sample_independently(
        lambda z: z[:, :1] - y,
        held_log_prob,
        [optimum],
        np.array([1]),
        Plan(("mean", "log scale"), 1, target_ess=2000, progress=False),
        limit=7.0,
    )
    assert chains is not None and chains.converged
    z = chains.flat()
    found = [z[:, 0].mean(), z[:, 1].mean(), np.mean(z[:, 0] ** 2), np.mean(z[:, 1] ** 2)]
    np.testing.assert_allclose(found, moments, atol=0.02)
    np.testing.assert_allclose(chains.log_prob.ravel(), log_prob(z), rtol=1e-9)


def test_where_no_map_fits_nothing_is_drawn():
    """A plateau with a needle: the optimum's map says nothing of the rest."""

    def residuals(z):
        return np.stack([np.where(np.linalg.norm(z, axis=1) < 1e-3, 0.0, 40.0 + 30.0 * np.sin(40.0 * z[:, 0]))], axis=1)

    assert drawn(residuals, [[0.0, 0.0]])[0] is None


def test_the_same_seed_gives_the_same_draws_and_the_budget_ends_a_run():
    def residuals(z):
        return np.stack([10.0 * (z[:, 1] - z[:, 0] ** 2)], axis=1)

    one, two = (drawn(residuals, [[0.0, 0.0]])[1] for _ in range(2))
    np.testing.assert_array_equal(one, two)
    chains, _ = drawn(residuals, [[0.0, 0.0]], budget_s=0.0, target_ess=1e9)
    assert chains.stop is Stop.BUDGET and not chains.converged and "time budget" in chains.message


def test_a_map_leads_back_to_where_it_came_from():
    def residuals(z):
        return np.stack([5.0 * (z[:, 1] - z[:, 0] ** 2), z[:, 0] - z[:, 2], 2.0 * np.sinh(z[:, 2])], axis=1)

    place = ResidualMap(residuals, np.eye(3), np.zeros(3), NONE)
    x = np.random.default_rng(2).standard_normal((50, 3))
    there = place.place(x, 7.0)
    assert np.mean(there.met) > 0.9
    back = place.coordinates(there.z[there.met])
    np.testing.assert_allclose(back.x, x[there.met], atol=2e-3)
    step = 1e-5  # the density is that of the change of coordinates: by central differences
    z = there.z[there.met][0]
    slope = [
        (place.coordinates((z + step * e)[None]).x - place.coordinates((z - step * e)[None]).x)[0] for e in np.eye(3)
    ]
    assert back.log_det[0] == pytest.approx(np.log(np.linalg.det(np.array(slope) / (2.0 * step))), abs=1e-3)


def bent(z):
    return np.stack([40.0 * (z[:, 1] - z[:, 0] ** 2), 0.5 * (z[:, 0] - 0.3)], axis=1)


def test_a_run_that_goes_on_draws_what_an_uninterrupted_one_does(tmp_path):
    """Stopped by the clock after a block, killed in the middle of writing one, resumed: the same to the bit."""
    whole, _ = drawn(bent, [[0.05, 0.0025]], target_ess=1500)
    assert whole.n_steps >= 512
    file = tmp_path / "chains.ckpt"
    cut, _ = drawn(bent, [[0.05, 0.0025]], target_ess=1500, checkpoint=file, max_steps=256)
    assert cut.n_steps == 256
    file.write_bytes(file.read_bytes()[:-100])  # the last block is lost, the one before is not
    shorter, _ = drawn(bent, [[0.05, 0.0025]], target_ess=1500, checkpoint=file, resume=True, max_steps=128)
    assert shorter.n_steps == 128
    again, _ = drawn(bent, [[0.05, 0.0025]], target_ess=1500, checkpoint=file, resume=True)
    np.testing.assert_array_equal(again.draws, whole.draws)
    np.testing.assert_array_equal(again.log_prob, whole.log_prob)
    assert again.message == whole.message
    with pytest.raises(CheckpointError, match="seed was 3, is 4"):
        drawn(bent, [[0.05, 0.0025]], checkpoint=file, resume=True, seed=4)


@pytest.mark.parametrize(("height", "radius"), [(300.0, 0.05), (100.0, 0.08)])
def test_proposals_that_are_worth_too_little_are_given_up_however_many_there_are(height, radius, monkeypatch, tmp_path):
    """A needle in a normal: either a proposal is worth a hundredth, or enough of them are but their weights' tail is
    too long. No checkpoint is left. With more patience more and more are drawn."""

    def held_log_prob(z, held):
        needle = np.log1p(height * (np.linalg.norm(z - [0.9, 0.6], axis=1) < radius))
        return (needle - np.sum(z * z, axis=1))[:, None]

    optimum = Optimum(np.zeros(2), 0.0, np.eye(2), np.empty((0, 0)))
    file = tmp_path / "chains.ckpt"
    plan = Plan(("a", "b"), 1, checkpoint=file, progress=False, target_ess=100, max_steps=2400)
    assert sample_independently(lambda z: z, held_log_prob, [optimum], NONE, plan, limit=7.0) is None
    assert not file.exists()
    monkeypatch.setattr(importance, "_PATIENCE", 3000)
    chains = sample_independently(
        lambda z: z, held_log_prob, [optimum], NONE, replace(plan, checkpoint=None), limit=7.0
    )
    assert chains.n_steps == 2400 and not chains.converged


def test_solutions_that_start_from_known_places_are_the_same_and_cheaper():
    def residuals(z):
        return np.stack([40.0 * (z[:, 1] - z[:, 0] ** 2), 25.0 * (z[:, 2] - np.sin(2.0 * z[:, 1])), z[:, 0]], axis=1)

    place = ResidualMap(residuals, np.eye(3), np.zeros(3), NONE)
    x = np.random.default_rng(5).standard_normal((400, 3))
    first = place.place(x[:300], 7.0)
    began = place.n_evaluations
    alone = place.place(x[300:], 7.0)
    spent = place.n_evaluations - began
    place.remember(first.z[first.met], first.x[first.met], first.slope[first.met])
    began = place.n_evaluations
    near = place.place(x[300:], 7.0)
    both = near.met & alone.met
    assert near.met.mean() > 0.9 and both.mean() > 0.9
    assert place.n_evaluations - began < 0.6 * spent
    np.testing.assert_allclose(near.z[both], alone.z[both], atol=1e-3)
    np.testing.assert_allclose(near.log_det[both], alone.log_det[both], atol=1e-2)


def test_proposals_learn_where_the_posterior_is_not_standard_normal():
    """A posterior that is tilted beside its residuals: the weights of learnt proposals are evener, their mean stays."""

    def residuals(z):
        return np.stack([np.sinh(z[:, 0]), z[:, 1] + 0.8 * z[:, 0] ** 2 - 1.0], axis=1)

    def log_prob(z, held):
        return (1.5 * z[:, 0] - 0.5 * np.sum(residuals(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1))[:, None]

    start = np.array([0.0, 0.5])
    source = Source.of(residuals, log_prob, [Optimum(start, 0.0, np.eye(2), np.empty((0, 0)))], NONE, 7.0)

    def worth(rng):
        w = np.exp(source.draw(4000, rng)[2])
        return w.sum() ** 2 / np.sum(w**2) / len(w), w.mean()

    source.heavy = [np.inf]
    before, evidence = worth(np.random.default_rng(0))
    assert source.pilot(5)
    after, again = worth(np.random.default_rng(1))
    assert after > 1.5 * before
    assert again == pytest.approx(evidence, rel=0.1)  # the weights' mean, the evidence, is what it was


def test_threads_change_nothing():
    threads = nb.get_num_threads()
    try:
        found = []
        for n in (1, threads):
            nb.set_num_threads(n)
            found.append(drawn(bent, [[0.05, 0.0025]])[1])
    finally:
        nb.set_num_threads(threads)
    np.testing.assert_array_equal(*found)


def test_a_branch_that_no_map_leads_to_is_noticed():
    """Two halves, joined by a pass, of which the search found one: its map folds on the pass, and its weights look
    well; walks under the posterior cross over."""

    def residuals(z):
        return np.stack([1.2 * (z[:, 0] ** 2 - 1.0), z[:, 1] - z[:, 0]], axis=1)

    both, _ = drawn(residuals, [[0.8, 0.4], [-0.8, -0.4]])
    assert both is not None and both.converged
    assert drawn(residuals, [[0.8, 0.4]])[0] is None


def test_spare_branches_draw_the_same_posterior():
    """An optimum given twice is one branch, and two where spare ones are wanted; the second attempt is such, and a
    run resumed in it goes on as it."""

    def log_prob(z, held):
        return (-0.5 * np.sum(bent(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1))[:, None]

    peaks = [Optimum(np.array(z), 0.0, np.eye(2), np.empty((0, 0))) for z in ([0.05, 0.0025], [0.4, 0.16])]
    found = []
    for beside, branches in ((0, 1), (2, 2)):
        source = Source.of(bent, log_prob, peaks, NONE, 7.0)
        assert source.pilot(1, beside) and len(source.branches) == branches
        z, _, log_w = source.draw(4000, np.random.default_rng(0))
        w = np.exp(log_w - log_w.max())
        found.append((w @ z / w.sum(), log_mean_exp(log_w[None])[0][0]))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=0.1)
    assert found[0][1] == pytest.approx(found[1][1], abs=0.1)


def test_the_second_attempt_is_gone_on_from(tmp_path, monkeypatch):
    pilot = Source.pilot
    monkeypatch.setattr(Source, "pilot", lambda *a: a[2] > 0 and pilot(*a))  # without spare branches it does not fit
    options = dict(optima=[[0.05, 0.0025], [0.4, 0.16]], target_ess=1500)
    whole, _ = drawn(bent, **options)
    file = tmp_path / "chains.ckpt"
    cut, _ = drawn(bent, **options, checkpoint=file, max_steps=384)
    assert cut.n_steps == 384 and not cut.converged
    again, _ = drawn(bent, **options, checkpoint=file, resume=True)
    np.testing.assert_array_equal(again.draws, whole.draws)


def test_weights_of_a_long_tail_are_not_trusted():
    rng = np.random.default_rng(4)
    assert untrusted(np.append(rng.exponential(0.4, 4000), -np.inf)) == ""  # exponential ln w of mean k: Pareto's index
    said = untrusted(rng.exponential(0.95, 40_000))
    assert float(said.split(" is ")[1].split(" > ")[0]) == pytest.approx(0.95, abs=0.15)
