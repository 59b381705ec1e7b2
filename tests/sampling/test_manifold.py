"""Chains along the manifold, on bent posteriors whose moments a grid or a quadrature gives."""

import numba as nb
import numpy as np
import pytest

from bayes_iwan.executors import opened
from bayes_iwan.sampling.common.chains import Stop
from bayes_iwan.sampling.common.checkpoint import CheckpointError
from bayes_iwan.sampling.common.held import Held
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.manifold import on_manifold
from bayes_iwan.sampling.manifold.on_manifold import sample_on_manifold
from bayes_iwan.sampling.manifold.sheet import Sheet

NONE = np.empty(0, dtype=np.int64)


def density(rows):
    return lambda z, held=None: (-0.5 * np.sum(rows(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1))[:, None]


def walked(rows, z, steps, scale=0.9):
    """Draws (steps, walkers, ndim) of exp(−½|rows|² − ½|z|²) by walkers that start at z (walkers, ndim)."""
    sheet = Sheet(rows, density(rows), Held(NONE, np.empty(0), np.empty((0, 0)), 1), z.shape[1], 8.0)
    rng = np.random.default_rng(1)
    draws, _, accepted = sheet.advance(sheet.begin(z, rng), steps, scale, rng)
    assert accepted > 0.1
    return draws


def spread(axis, p, count):
    """Values (count,) that are spread as p (n,) on axis (n,) says."""
    return np.interp((np.arange(count) + 0.5) / count, np.cumsum(p) / p.sum(), axis)


def chains_of(rows, optima, **options):
    optima = np.atleast_2d(np.array(optima, float))
    names = tuple(f"z{i}" for i in range(optima.shape[1]))
    return sample_on_manifold(
        rows,
        density(rows),
        optima,
        density(rows)(optima)[:, 0],
        NONE,
        np.empty((0, 0)),
        Plan(names, **{"seed": 3, "progress": False, **options}),
        limit=8.0,
    )


@pytest.fixture
def soon(monkeypatch):
    """A warm-up of two blocks."""
    monkeypatch.setattr(on_manifold, "_WARM_UP", 1)


def bent(z):
    """z1 = z0² to within 0.02"""
    return np.stack([50.0 * (z[:, 1] - z[:, 0] ** 2), 0.5 * (z[:, 0] - 0.3)], axis=1)


def test_a_thin_bent_sheet_keeps_its_moments():
    """Where the sheet is steep there is more of it for the same z: without |det R| these are wrong."""
    axis = np.linspace(-5.0, 5.0, 40_001)
    p = np.exp(-0.125 * (axis - 0.3) ** 2 - 0.5 * axis**2 - 0.5 * axis**4)  # z1 is where it must be
    z0 = spread(axis, p, 4000)
    z = walked(bent, np.stack([z0, z0**2 + 0.02 * np.random.default_rng(0).standard_normal(4000)], axis=1), 12)[4:]
    for k, tolerance in ((1, 0.02), (2, 0.02), (4, 0.04)):
        assert np.mean(z[:, :, 0] ** k) == pytest.approx(np.sum(p * axis**k) / p.sum(), abs=tolerance)
    assert np.std(z[:, :, 1] - z[:, :, 0] ** 2) == pytest.approx(0.02, rel=0.05)


def test_a_wave_is_drawn_only_with_the_way_back():
    """From a crest one step leads to the next flank; from the flank it leads elsewhere. Chains that went without
    asking for the way back would be off by 0.024, without |det R| by 0.13."""
    axis = np.linspace(-6.0, 6.0, 60_001)
    p = np.exp(-0.5 * np.sin(4.0 * axis) ** 2 - 0.5 * axis**2)

    def share(x):
        return np.abs(np.sin(4.0 * x)) > 0.5

    z = walked(lambda z: np.sin(4.0 * z), spread(axis, p, 12_000)[:, None], 12, scale=0.8)[5:, :, 0]
    assert np.mean(share(z)) == pytest.approx(np.sum(p * share(axis)) / p.sum(), abs=0.01)
    assert np.mean(z**2) == pytest.approx(np.sum(p * axis**2) / p.sum(), rel=0.04)


def test_a_shell_in_twenty_dimensions():
    """|z|² = 16 to within 0.4, from one point of it: the radius by quadrature, every direction alike."""
    radius = np.linspace(3.0, 5.0, 4001)
    p = radius**19 * np.exp(-0.5 * ((radius**2 - 16.0) / 0.4) ** 2 - 0.5 * radius**2)
    mean, square = (np.sum(p * radius**k) / p.sum() for k in (1, 2))
    start = np.tile(np.eye(20)[0] * 4.0, (100, 1))
    z = walked(lambda z: (np.sum(z * z, axis=1, keepdims=True) - 16.0) / 0.4, start, 50)[20:]
    r = np.linalg.norm(z, axis=2)
    assert np.mean(r) == pytest.approx(mean, abs=0.006)
    assert np.var(r) == pytest.approx(square - mean**2, rel=0.15)
    np.testing.assert_allclose(np.mean(z**2, axis=(0, 1)), square / 20.0, rtol=0.2)
    np.testing.assert_allclose(np.mean(z, axis=(0, 1)), 0.0, atol=0.1)


Y = np.random.default_rng(0).standard_normal(10) * 0.5 + 0.8


def noisy_log_prob(z):
    """Ten residuals of z0 with scale exp(z1)."""
    squares = np.sum((Y - z[..., :1]) ** 2, axis=-1)
    return -10.0 * z[..., 1] - 0.5 * squares * np.exp(-2.0 * z[..., 1]) - 0.5 * np.sum(z * z, axis=-1)


def noisy_rows(z):
    return (z[:, :1] - Y) * np.exp(-z[:, 1:])


def held_log_prob(z, held):
    return noisy_log_prob(np.stack([np.broadcast_to(z[:, :1], held.shape[:2]), held[:, :, 0]], axis=2))


@pytest.fixture(scope="module")
def grid():
    """Places (n, 2) and their probability."""
    axis = np.linspace(-3.0, 3.0, 1201)
    z = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    p = np.exp(noisy_log_prob(z) - noisy_log_prob(z).max())
    return z, p / p.sum()


def noisy_chains(best, executor=None, **settings):
    """Chains of the model with noise of unknown size, about its maximum (1, 2)."""
    known = noisy_rows, held_log_prob, best, noisy_log_prob(best), np.array([1]), np.array([[0.22]])
    plan = Plan(("mean", "log scale"), 1, progress=False, **settings)
    return sample_on_manifold(*known, plan, limit=8.0, executor=executor)


def test_held_noise_is_integrated_out(grid):
    """The joint posterior's moments by a grid."""
    places, p = grid
    moments = [np.sum(p * places[:, i] ** k) for i in (0, 1) for k in (1, 2)]
    best = places[[np.argmax(p)]]
    chains = noisy_chains(best, target_ess=1500)
    assert chains.converged and chains.convergence.worst_r_hat < 1.01
    z = chains.flat()
    np.testing.assert_allclose([np.mean(z[:, i] ** k) for i in (0, 1) for k in (1, 2)], moments, atol=0.025)
    np.testing.assert_allclose(chains.log_prob.reshape(-1), noisy_log_prob(z), rtol=1e-9)


def test_processes_draw_the_same(soon):
    """The same to the bit in this process alone and with a spawned one, which takes half of the walkers."""
    best, runs = np.array([[0.7, -0.6]]), []
    for workers in (1, 2):
        with opened(workers, along=True) as executor:
            runs.append(noisy_chains(best, max_steps=25, executor=executor))
            # it starts when there is something to share
            assert workers == 1 or len(executor._pools) == 1
    alone, shared = runs
    np.testing.assert_array_equal(shared.draws, alone.draws)
    np.testing.assert_array_equal(shared.log_prob, alone.log_prob)
    assert shared.n_evaluations == alone.n_evaluations


def spread_of_noise(grid):
    """Of chains that begin where they should, with two draws of the noise each from far too wide a distribution: how
    much wider the noise's own is after some steps than it should be."""
    places, p = grid
    rng = np.random.default_rng(5)
    z = places[rng.choice(len(p), 6000, p=p)]
    sheet = Sheet(noisy_rows, held_log_prob, Held(np.array([1]), np.array([-0.6]), np.array([[1.0]]), 2), 2, 8.0)
    walkers = sheet.begin(z, rng)
    walkers.z, walkers.log_prob = z.copy(), noisy_log_prob(z)
    sheet.refresh(walkers, rng)  # theirs is the posterior's: so estimates are as they should be, too
    draws, _, _ = sheet.advance(walkers, 8, 0.9, rng)
    mean = p @ places[:, 1]
    return np.std(draws[2:, :, 1]) / np.sqrt(p @ (places[:, 1] - mean) ** 2) - 1.0


def test_drawing_the_noise_anew_changes_nothing(grid):
    assert spread_of_noise(grid) == pytest.approx(0.0, abs=0.03)


def test_estimates_that_are_all_drawn_anew_would(grid, monkeypatch):
    """Without the walkers' own draw the noise is blurred: the test above would see it."""

    def wrong(self, walkers, rng):
        chances, pick = self.held.chances(len(walkers.z), rng), rng.random(len(walkers.z))
        walkers.log_total, walkers.z, walkers.log_prob = self.held.integrated(self.log_prob, walkers.z, chances, pick)

    monkeypatch.setattr(Sheet, "refresh", wrong)
    assert abs(spread_of_noise(grid)) > 0.08


def test_walkers_that_do_not_leave_their_branch_have_not_converged(soon):
    """Two halves that no step leads between, a walker in each: what share each has is not known, and that is said."""

    def rows(z):
        return np.stack([30.0 * (z[:, 0] ** 2 - 1.0)], axis=1)

    chains = chains_of(rows, [[1.0, 0.0], [-1.0, 0.0]], max_steps=100)
    assert chains.stop is Stop.STEPS and not chains.converged and "R-hat of z0" in chains.message


def test_where_steps_lead_nowhere_nothing_is_drawn(tmp_path):
    def rows(z):
        return 30.0 * np.sin(1e9 * z)

    file = tmp_path / "chains.ckpt"
    assert chains_of(rows, [[0.0, 0.0]], checkpoint=file) is None
    assert not file.exists()


@pytest.mark.usefixtures("soon")
def test_a_run_that_goes_on_draws_what_an_uninterrupted_one_does(tmp_path):
    """Stopped after some blocks, killed in the middle of writing one, resumed: the same to the bit, on any threads."""
    whole = chains_of(bent, [[0.05, 0.0025]], max_steps=75)
    file = tmp_path / "chains.ckpt"
    cut = chains_of(bent, [[0.05, 0.0025]], max_steps=50, checkpoint=file)
    np.testing.assert_array_equal(cut.draws, whole.draws[:, :50])
    file.write_bytes(file.read_bytes()[:-100])  # the second block is lost, the first is not
    threads = nb.get_num_threads()
    try:
        nb.set_num_threads(1)
        again = chains_of(bent, [[0.05, 0.0025]], max_steps=75, checkpoint=file, resume=True)
    finally:
        nb.set_num_threads(threads)
    np.testing.assert_array_equal(again.draws, whole.draws)
    np.testing.assert_array_equal(again.log_prob, whole.log_prob)
    assert again.message == whole.message
    with pytest.raises(CheckpointError, match="seed was 3, is 4"):
        chains_of(bent, [[0.05, 0.0025]], checkpoint=file, resume=True, seed=4)


@pytest.mark.usefixtures("soon")
def test_the_budget_and_ctrl_c_end_a_run(monkeypatch):
    late = chains_of(bent, [[0.05, 0.0025]], budget_s=0.0)
    assert late.stop is Stop.BUDGET and late.n_steps == 25 and "cut warm-up short" in late.message
    taken, left = on_manifold.ManifoldRun.block, iter(range(7))  # five of them warm up

    def block(run):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return taken(run)

    monkeypatch.setattr(on_manifold.ManifoldRun, "block", block)
    cut = chains_of(bent, [[0.05, 0.0025]])
    assert cut.stop is Stop.INTERRUPTED and cut.n_steps == 50 and cut.convergence is not None
    early = chains_of(bent, [[0.05, 0.0025]])
    assert early.n_steps == 0 and "before any draw counts" in early.message and not early.converged
