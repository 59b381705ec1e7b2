"""Every move by itself, in a plain emcee sampler, on distributions whose moments are known."""

import copy
import pickle

import emcee
import numpy as np
import pytest
from bayes_iwan.sampling.moves import DifferentialMove, ManifoldMove, NestedMove, SnookerMove
from bayes_iwan.sampling.moves.manifold import Manifold
from bayes_iwan.sampling.moves.metropolis import LeastSquares
from bayes_iwan.sampling.moves.nested import curving_parameters
from bayes_iwan.sampling.nuisance import Nuisance

NONE = Nuisance(np.empty(0, np.int64), np.empty(0), np.empty((0, 0)))


def target_of(rows, ndim):
    """exp(−½|rows|² − ½|z|²)"""
    return LeastSquares(
        rows, lambda z, _: (-0.5 * np.sum(rows(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1))[:, None], NONE, ndim, 8.0
    )


def log_prob_of(target):
    return lambda z: target.log_prob(z, z[:, None, target.nuisance.columns])[:, 0]


def walked(move, log_prob, z, steps, seed=1):
    """Draws (steps, walkers, ndim) of walkers that start at z, by emcee and one move; and the share accepted."""
    sampler = emcee.EnsembleSampler(*z.shape, log_prob, moves=[move], vectorize=True)
    state = emcee.State(z, log_prob=log_prob(z), random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    return sampler.get_chain(), float(np.mean(sampler.acceptance_fraction))


def spread(axis, p, count):
    """Values (count,) that are spread as p (n,) on axis (n,) says."""
    return np.interp((np.arange(count) + 0.5) / count, np.cumsum(p) / p.sum(), axis)


def bent(z):
    """z1 = z0² to within 0.02"""
    return np.stack([50.0 * (z[:, 1] - z[:, 0] ** 2), 0.5 * (z[:, 0] - 0.3)], axis=1)


# ---- walkers that move by each other


@pytest.mark.parametrize("move", [DifferentialMove(), SnookerMove()], ids=["differential", "snooker"])
def test_a_normal_distribution_of_sixteen_dimensions_keeps_its_variance(move):
    """`emcee.moves.DESnookerMove` of 3.1.6 gives 0.57 here."""
    z = np.random.default_rng(0).standard_normal((400, 16))
    draws, accepted = walked(move, lambda z: -0.5 * np.sum(z * z, axis=1), z, 500)
    assert accepted > 0.1
    assert np.mean(np.var(draws[100:].reshape(-1, 16), axis=0)) == pytest.approx(1.0, abs=0.04)


def test_whole_differences_lead_from_mode_to_mode():
    def two(z):
        tail = -0.5 * np.sum(z[:, 1:] ** 2, axis=1)
        left, right = (np.log(w) - 0.5 * ((z[:, 0] - x) / 0.5) ** 2 for w, x in ((0.25, -3.0), (0.75, 3.0)))
        return tail + np.logaddexp(left, right)

    z = np.random.default_rng(0).standard_normal((100, 3))
    z[:, 0] = np.where(np.arange(100) < 50, -3.0, 3.0) + 0.5 * z[:, 0]  # not the shares that they should have
    draws, _ = walked(DifferentialMove(whole=0.3), two, z, 1500)
    assert np.mean(draws[300:, :, 0] < 0.0) == pytest.approx(0.25, abs=0.04)


# ---- steps along the manifold


def test_a_thin_bent_sheet_keeps_its_moments():
    """Where the sheet is steep there is more of it for the same z: without |det R| these are wrong."""
    axis = np.linspace(-5.0, 5.0, 40_001)
    p = np.exp(-0.125 * (axis - 0.3) ** 2 - 0.5 * axis**2 - 0.5 * axis**4)  # z1 is where it must be
    z0 = spread(axis, p, 4000)
    start = np.stack([z0, z0**2 + 0.02 * np.random.default_rng(0).standard_normal(4000)], axis=1)
    target = target_of(bent, 2)
    z, accepted = walked(ManifoldMove(target, 0.9), log_prob_of(target), start, 12)
    assert accepted > 0.1
    for k, tolerance in ((1, 0.02), (2, 0.02), (4, 0.04)):
        assert np.mean(z[4:, :, 0] ** k) == pytest.approx(np.sum(p * axis**k) / p.sum(), abs=tolerance)
    assert np.std(z[4:, :, 1] - z[4:, :, 0] ** 2) == pytest.approx(0.02, rel=0.05)


def wave_share(monkeypatch=None):
    """How much more often |sin 4z| > 0.5 than it should be, where a step from a crest leads to the next flank, and one
    from there elsewhere."""
    axis = np.linspace(-6.0, 6.0, 60_001)
    p = np.exp(-0.5 * np.sin(4.0 * axis) ** 2 - 0.5 * axis**2)
    target = target_of(lambda z: np.sin(4.0 * z), 1)
    start = spread(axis, p, 12_000)[:, None]
    z, _ = walked(ManifoldMove(target, 0.8), log_prob_of(target), start, 12)
    above = np.abs(np.sin(4.0 * axis)) > 0.5
    return np.mean(np.abs(np.sin(4.0 * z[5:])) > 0.5) - np.sum(p[above]) / p.sum()


def test_a_wave_is_drawn_only_with_the_way_back():
    assert wave_share() == pytest.approx(0.0, abs=0.01)


def test_without_the_determinant_it_is_not(monkeypatch):
    """So the test above would see it."""
    whole = Manifold.places

    def wrong(self, z):
        found = whole(self, z)
        found.log_det[:] = 0.0
        return found

    monkeypatch.setattr(Manifold, "places", wrong)
    assert abs(wave_share()) > 0.05


def test_a_way_along_the_sheet_is_followed_to_its_end_or_to_where_the_sheet_turns_over():
    manifold = Manifold(target_of(bent, 2))
    start = manifold.places(np.array([[0.3, 0.09]]))
    x = np.repeat(start.seen(start.values), 33, axis=0)
    x[:, 1] = np.linspace(-2.0, 6.0, 33)
    z = manifold.followed(start, x, 8)
    assert np.max(np.abs(z[:, 1] - z[:, 0] ** 2)) < 0.1
    seen = manifold.target.values(z, manifold.free) @ start.tangent[0].T
    met = np.max(np.abs(seen - x), axis=1) < 1e-3
    z0 = np.linspace(-2.8, 2.8, 4001)[:, None]
    least = np.min(manifold.target.values(np.hstack([z0, z0**2]), manifold.free) @ start.tangent[0, 1])
    assert -0.7 < least < -0.5  # here the sheet turns over, as seen from the start
    np.testing.assert_array_equal(met, x[:, 1] > least)
    part = (start.seen(start.values)[0, 1] - x[~met, 1]) / 8.0
    above = seen[~met, 1] - least
    assert np.all(above > -1e-3) and np.all(above < 1.01 * part)
    _, found = manifold.reached(start.some(np.zeros(33, np.int64)), x)
    assert not found[-3:].any() and met[-3:].all()  # so far no single step leads


def test_a_shell_in_twenty_dimensions():
    """|z|² = 16 to within 0.4, from one point of it: the radius by quadrature, every direction alike."""
    radius = np.linspace(3.0, 5.0, 4001)
    p = radius**19 * np.exp(-0.5 * ((radius**2 - 16.0) / 0.4) ** 2 - 0.5 * radius**2)
    mean, square = (np.sum(p * radius**k) / p.sum() for k in (1, 2))
    target = target_of(lambda z: (np.sum(z * z, axis=1, keepdims=True) - 16.0) / 0.4, 20)
    start = np.tile(np.eye(20)[0] * 4.0, (100, 1))
    z, _ = walked(ManifoldMove(target, 0.9), log_prob_of(target), start, 50)
    r = np.linalg.norm(z[20:], axis=2)
    assert np.mean(r) == pytest.approx(mean, abs=0.006)
    assert np.var(r) == pytest.approx(square - mean**2, rel=0.15)
    np.testing.assert_allclose(np.mean(z[20:] ** 2, axis=(0, 1)), square / 20.0, rtol=0.2)
    np.testing.assert_allclose(np.mean(z[20:], axis=(0, 1)), 0.0, atol=0.1)


# ---- nuisance parameters

Y = np.random.default_rng(0).standard_normal(10) * 0.5 + 0.8


def noisy_log_prob(z):
    """Ten residuals of z0 with scale exp(z1)."""
    squares = np.sum((Y - z[..., :1]) ** 2, axis=-1)
    return -10.0 * z[..., 1] - 0.5 * squares * np.exp(-2.0 * z[..., 1]) - 0.5 * np.sum(z * z, axis=-1)


def noisy_target(centre=-0.6, root=0.22, count=16):
    def log_prob(z, drawn):
        return noisy_log_prob(np.stack([np.broadcast_to(z[:, :1], drawn.shape[:2]), drawn[:, :, 0]], axis=2))

    nuisance = Nuisance(np.array([1]), np.array([centre]), np.array([[root]]), count)
    return LeastSquares(lambda z: (z[:, :1] - Y) * np.exp(-z[:, 1:]), log_prob, nuisance, 2, 8.0)


@pytest.fixture(scope="module")
def grid():
    """Places (n, 2) and their probability."""
    axis = np.linspace(-3.0, 3.0, 1201)
    z = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    p = np.exp(noisy_log_prob(z) - noisy_log_prob(z).max())
    return z, p / p.sum()


def spread_of_noise(grid):
    """Of walkers that begin where they should, with two draws of the noise each from far too wide a distribution: how
    much wider the noise's own is after some steps than it should be."""
    places, p = grid
    z = places[np.random.default_rng(5).choice(len(p), 6000, p=p)]
    draws, _ = walked(ManifoldMove(noisy_target(root=1.0, count=2), 0.9), noisy_log_prob, z, 8)
    mean = p @ places[:, 1]
    return np.std(draws[2:, :, 1]) / np.sqrt(p @ (places[:, 1] - mean) ** 2) - 1.0


def test_nuisance_parameters_are_integrated_out(grid):
    assert spread_of_noise(grid) == pytest.approx(0.0, abs=0.03)


def test_estimates_without_the_walkers_own_draw_would_blur_them(grid, monkeypatch):
    """So the test above would see it."""
    whole = Nuisance.integrated
    monkeypatch.setattr(
        Nuisance, "integrated", lambda self, log_prob, z, random, keep=False: whole(self, log_prob, z, random)
    )
    assert abs(spread_of_noise(grid)) > 0.08


# ---- independent proposals by way of the parameters that bend the manifold


def curled(z):
    """z1 and z2 follow z0, which the data leave free: no one place's tangents serve all of it."""
    return np.stack(
        [40.0 * (z[:, 1] - z[:, 0] ** 2), 40.0 * (np.exp(z[:, 1]) * z[:, 2] - np.sin(2.0 * z[:, 0]))], axis=1
    )


AXIS = np.linspace(-5.0, 5.0, 40_001)


def density_of_z0():
    last = np.sin(2.0 * AXIS) * np.exp(-(AXIS**2))
    p = np.exp(-0.5 * AXIS**2 - 0.5 * AXIS**4 - 0.5 * last**2 - AXIS**2)  # its sheet is thinner where z1 is larger
    return p / p.sum()


def on_sheet(z0):
    return np.stack([z0, z0**2, np.exp(-(z0**2)) * np.sin(2.0 * z0)], axis=1)


def nested_move():
    target = target_of(curled, 3)
    known = on_sheet(np.random.default_rng(3).choice(AXIS, 200, p=density_of_z0()))
    return NestedMove(target, np.array([0]), known)


def stationary(move):
    """How much more |z0| > 0.6 there is among walkers that begin where they should and are offered twelve proposals."""
    p, rng = density_of_z0(), np.random.default_rng(4)
    start = on_sheet(spread(AXIS, p, 3000))
    start[:, 1] += 0.025 * rng.standard_normal(3000)
    start[:, 2] = np.exp(-start[:, 1]) * (np.sin(2.0 * start[:, 0]) + 0.025 * rng.standard_normal(3000))
    z, accepted = walked(move, log_prob_of(move.target), start, 12)
    assert accepted > 0.3
    return np.mean(np.abs(z[6:, :, 0]) > 0.6) - np.sum(p[np.abs(AXIS) > 0.6])


def test_what_bends_is_found():
    def rows(z):
        return np.stack([40.0 * (z[:, 1] - z[:, 0] ** 2), 40.0 * z[:, 2]], axis=1)

    z = np.random.default_rng(0).standard_normal((8, 3))
    z[:, 1], z[:, 2] = z[:, 0] ** 2, 0.0
    assert curving_parameters(target_of(rows, 3), z).tolist() == [0]
    assert curving_parameters(target_of(lambda z: 40.0 * z, 3), z).tolist() == []


def test_independent_proposals_leave_the_posterior_as_it_is():
    assert stationary(nested_move()) == pytest.approx(0.0, abs=0.015)


def test_without_their_density_of_the_others_they_do_not(monkeypatch):
    """So the test above would see it."""
    whole = NestedMove._log_others
    monkeypatch.setattr(
        NestedMove, "_log_others", lambda self, middle, place: whole(self, middle, place) - place.log_det
    )
    assert abs(stationary(nested_move())) > 0.04


def test_a_place_has_the_same_density_whether_proposed_or_come_upon():
    move = nested_move()
    z, log_q = move.draw(300, np.random.RandomState(3))
    there = np.isfinite(log_q)
    again = move.log_density(z[there])
    led = np.isfinite(again)
    assert there.mean() > 0.9 and led.mean() > 0.99
    np.testing.assert_allclose(again[led], log_q[there][led], atol=1e-2)


def test_a_walker_where_no_proposal_leads_stays():
    move = nested_move()
    off = on_sheet(np.array([0.3])) + np.array([0.0, 0.0, 9.0])
    beyond = on_sheet(np.array([0.3])) + np.array([20.0, 0.0, 0.0])
    assert np.isneginf(move.log_density(np.concatenate([off, beyond]))).all()
    offer = move.candidates(np.repeat(off, 20, axis=0), np.random.RandomState(0))
    assert np.isneginf(offer.log_ratio).all()


@pytest.mark.parametrize(
    "make", [nested_move, lambda: ManifoldMove(target_of(curled, 3), 0.9)], ids=["nested", "manifold"]
)
def test_what_a_move_remembers_changes_nothing(make):
    """Places and densities that are kept from step to step are those that would be found anew."""
    move, log_prob = make(), log_prob_of(target_of(curled, 3))
    start = on_sheet(spread(AXIS, density_of_z0(), 40))
    whole, _ = walked(move, log_prob, start, 6)
    z, random = start, np.random.RandomState(1)
    for step in whole:
        fresh = copy.copy(move)  # remembers nothing
        random.choice([0], p=[1.0])  # as emcee chooses among its moves
        state = emcee.State(z, log_prob=log_prob(z))
        state, _ = fresh.propose(type("Model", (), {"random": random})(), state)
        z = state.coords
        np.testing.assert_allclose(z, step, atol=1e-9)


def test_moves_travel_to_other_processes():
    move = ManifoldMove(LeastSquares(bent, no_density, NONE, 2, 8.0), 0.7)
    move.manifold.places(np.zeros((2, 2)))
    assert pickle.loads(pickle.dumps(move)).scale == 0.7


def no_density(z, nuisance):
    raise NotImplementedError
