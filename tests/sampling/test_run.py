"""Whole runs: right answers, honest ends, and checkpoints from which a killed run draws what it would have drawn."""

import io
import os
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from bayes_iwan.executors import opened
from bayes_iwan.sampling import checkpoint, run
from bayes_iwan.sampling.blocks import Density
from bayes_iwan.sampling.chains import Stop
from bayes_iwan.sampling.checkpoint import CheckpointError, read_checkpoint
from bayes_iwan.sampling.plan import Plan, SamplingError
from bayes_iwan.threads import linear_algebra

NAMES = ("mean", "log scale")
Y = np.random.default_rng(0).standard_normal(10) * 0.5 + 0.8
BEST, ROOT = np.array([[0.65, -0.6]]), np.diag([0.2, 0.22])


def log_prob(z):
    """Ten residuals of z0 with scale exp(z1)."""
    squares = np.sum((Y - z[..., :1]) ** 2, axis=-1)
    return -10.0 * z[..., 1] - 0.5 * squares * np.exp(-2.0 * z[..., 1]) - 0.5 * np.sum(z * z, axis=-1)


def noisy(x, random):
    return log_prob(x)[:, None]


def of(function, *blocks):
    """A density of which all coordinates are walked in."""
    places = [np.array(block) for block in blocks]
    return Density(function, np.sort(np.concatenate(places)), np.empty(0, np.int64), tuple(places))


TARGET = of(noisy, [0], [1])


@pytest.fixture(autouse=True)
def few_draws_to_learn_from(monkeypatch):
    """Else learning, and leading many walkers, is most of these runs."""
    monkeypatch.setattr(run, "_LEARNT", 2000)
    monkeypatch.setattr(run, "POPULATION", 64)


def sample(density=TARGET, starts=BEST, root=ROOT, executor=None, n_walkers=24, n_ensembles=4, **asked):
    names = (*NAMES, "c", "d")[: density.ndim]
    plan = Plan(**{"names": names, "seed": 1, "progress": False, **asked})
    return run.sample(density, starts, root, plan, executor=executor, n_walkers=n_walkers, n_ensembles=n_ensembles)


#: of a run whose moves are learnt anew whenever there are half as many draws again, which never are enough
ENDLESS = {"target_ess": 1e9, "chain_taus": 1e5}


def learnt_after(monkeypatch):
    """The blocks after which moves are learnt, as they are."""
    found, learn = [], run.EnsembleRun._learn
    monkeypatch.setattr(run.EnsembleRun, "_learn", lambda self: (found.append(self.learnt), learn(self)))
    return found


@pytest.mark.parametrize("away, width", [(0.0, 0.7), (2.0, 1.0), (0.0, 2.0)])
def test_draws_of_one_like_it_lead_to_a_posterior(monkeypatch, away, width):
    """From draws that are narrower, wider, or beside it."""
    monkeypatch.setattr(run, "POPULATION", 512)
    ndim, random = 4, np.random.default_rng(5)
    scale = np.array([1.0, 0.1, 1.0, 3.0])

    def tilted(x, _):
        u = np.stack([x[:, 0], x[:, 1] - 0.2 * x[:, 0], x[:, 2], x[:, 3]], axis=1) / scale
        return -0.5 * np.sum(u * u, axis=1)[:, None]

    u = random.standard_normal((1000, ndim)) * scale
    x = np.stack([u[:, 0], u[:, 1] + 0.2 * u[:, 0], u[:, 2], u[:, 3]], axis=1)
    known = width * x + away * scale
    density = of(tilted, [0, 1], [2, 3])
    found = run.draws_of_one_like_it(density, known, (1,))
    assert found.shape == (512, ndim)
    np.testing.assert_allclose(found.mean(axis=0) / x.std(axis=0), 0.0, atol=0.2)
    np.testing.assert_allclose(found.std(axis=0) / x.std(axis=0), 1.0, rtol=0.15)
    np.testing.assert_array_equal(found, run.draws_of_one_like_it(density, known, (1,)))
    assert not np.array_equal(found, run.draws_of_one_like_it(density, known, (2,)))


def test_from_draws_none_of_which_is_possible_nothing_is_led():
    nowhere = of(lambda x, _: np.full((len(x), 1), -np.inf), [0])
    with pytest.raises(SamplingError, match="nowhere to start from"):
        run.draws_of_one_like_it(nowhere, np.random.default_rng(0).standard_normal((50, 1)), (1,))


def test_a_run_ends_by_itself_with_the_right_moments():
    axis = np.linspace(-3.0, 3.0, 1201)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    p = np.exp(log_prob(places) - log_prob(places).max())
    moments = [np.sum(p * places[:, i] ** k) / p.sum() for i in (0, 1) for k in (1, 2)]
    squares = dict(quantities=lambda z: z**2, quantity_names=("aa", "bb"))
    chains = sample(target_ess=1500, **squares)
    assert chains.converged and chains.message == "converged" and chains.stop is Stop.CONVERGED
    assert chains.convergence.worst_r_hat < 1.01 and chains.convergence.least_ess > 1500
    assert chains.convergence.names == (*NAMES, "aa", "bb")
    assert chains.draws.shape == (4, chains.n_steps, 24, 2)
    z = chains.flat()
    np.testing.assert_allclose([np.mean(z[:, i] ** k) for i in (0, 1) for k in (1, 2)], moments, atol=0.03)
    np.testing.assert_allclose(chains.log_prob.reshape(-1), log_prob(z), rtol=1e-9)
    np.testing.assert_array_equal(chains.quantities, chains.draws**2)
    again = sample(target_ess=1500, **squares)
    np.testing.assert_array_equal(again.draws, chains.draws)
    assert (sample(seed=2, max_steps=25).draws[0, 0] != chains.draws[0, 0]).any()


# ---- coordinates that are drawn given the others

SLOPES = np.array([[1.0, 2.0, 0.3], [0.5, 1.9, -0.4], [2.0, -0.1, 1.0], [0.3, 0.2, 0.1]])
DATA = np.array([1.2, 0.9, 0.8, -0.1])
PRECISION = np.eye(3) + SLOPES.T @ SLOPES
MEAN = np.linalg.solve(PRECISION, SLOPES.T @ DATA)


def linear(x, random, drawn=(0, 2), least=-np.inf):
    """DATA = SLOPES b + noise, b and noise standard normal: ln p of the others and a draw of those drawn given them;
    impossible where the first of these is below `least`."""
    others = [i for i in range(3) if i not in drawn]
    covariance = np.linalg.inv(PRECISION)
    off = x - MEAN[others]
    level = -0.5 * np.sum(off @ np.linalg.inv(covariance[np.ix_(others, others)]) * off, axis=1)
    own = PRECISION[np.ix_(drawn, drawn)]
    given = MEAN[list(drawn)] - off @ np.linalg.solve(own, PRECISION[np.ix_(drawn, others)]).T
    root = np.linalg.cholesky(np.linalg.inv(own))
    c = given + random.standard_normal(given.shape) @ root.T
    return np.concatenate([np.where(c[:, 0] >= least, level, -np.inf)[:, None], c], axis=1)


def test_drawn_coordinates_have_their_joint_moments_with_the_others():
    density = Density(linear, np.array([1]), np.array([0, 2]), (np.array([0]),))
    chains = sample(density, np.zeros((1, 3)), np.eye(3), target_ess=4000)
    assert chains.converged and chains.draws.shape[-1] == 3 and chains.convergence.names == (*NAMES, "c")
    z = chains.flat()
    sd = np.sqrt(np.diag(np.linalg.inv(PRECISION)))
    np.testing.assert_allclose((z.mean(axis=0) - MEAN) / sd, 0.0, atol=0.06)
    np.testing.assert_allclose(np.cov(z.T) / np.outer(sd, sd), np.linalg.inv(PRECISION) / np.outer(sd, sd), atol=0.06)


def with_what_is_drawn(z, sign):
    out = z.copy()
    out[..., 1] += sign * 3.0 * z[..., 0]
    return out


def test_what_is_walked_in_may_be_less_than_what_is_reported(tmp_path):
    """The second coordinate holds three times the first, which is drawn; resumed to the bit."""
    density = Density(linear, np.array([1]), np.array([0, 2]), (np.array([0]),), with_what_is_drawn)
    z = with_what_is_drawn(sample(density, np.zeros((1, 3)), np.eye(3), target_ess=4000).flat(), -1)
    np.testing.assert_allclose(z.mean(axis=0), MEAN, atol=0.03)
    np.testing.assert_allclose(np.cov(z.T), np.linalg.inv(PRECISION), atol=0.03)
    whole = sample(density, np.zeros((1, 3)), np.eye(3), max_steps=100, **ENDLESS)
    file = tmp_path / "chains.ckpt"
    sample(density, np.zeros((1, 3)), np.eye(3), max_steps=50, checkpoint=file, **ENDLESS)
    again = sample(density, np.zeros((1, 3)), np.eye(3), max_steps=100, checkpoint=file, resume=True, **ENDLESS)
    np.testing.assert_array_equal(again.draws, whole.draws)


def one_drawn(x, random):
    return linear(x, random, (1,))


def test_one_coordinate_may_be_drawn_alone():
    """emcee keeps a single blob in another shape."""
    density = Density(one_drawn, np.array([0, 2]), np.array([1]), (np.array([1]), np.array([0])))
    z = sample(density, np.zeros((1, 3)), np.eye(3), target_ess=4000).flat()
    np.testing.assert_allclose(z.mean(axis=0), MEAN, atol=0.03)
    np.testing.assert_allclose(np.cov(z.T), np.linalg.inv(PRECISION), atol=0.03)


def squared(x, random):
    return np.concatenate([-0.5 * x**2, x**2, random.standard_normal(x.shape)], axis=1)


def test_what_is_drawn_stays_with_the_place_that_it_was_drawn_for():
    """From step to step and block to block; and it is drawn with random numbers of its own."""
    density = Density(squared, np.array([1]), np.array([0, 2]), (np.array([0]),))
    chains = sample(density, np.zeros((1, 3)), np.eye(3), target_ess=4000)
    z = chains.flat()
    np.testing.assert_array_equal(z[:, 0], z[:, 1] ** 2)
    still = np.diff(chains.draws[..., 1], axis=1) == 0.0
    assert 0.05 < still.mean() < 0.7 and np.all(np.diff(chains.draws, axis=1)[still] == 0.0)
    np.testing.assert_allclose(np.corrcoef(z.T)[2, :2], 0.0, atol=0.05)
    assert np.var(z[:, 2]) == pytest.approx(1.0, abs=0.06)


def cut(x, random):
    return linear(x, random, least=0.4)


def test_what_is_impossible_of_the_drawn_ones_is_cut_from_the_joint_distribution():
    """Though ln p of the others does not know of it: a place whose draw is impossible is refused as a whole."""
    density = Density(cut, np.array([1]), np.array([0, 2]), (np.array([0]),))
    z = sample(density, MEAN[None], np.eye(3), target_ess=4000).flat()
    exact = np.random.default_rng(2).multivariate_normal(MEAN, np.linalg.inv(PRECISION), 400_000)
    exact = exact[exact[:, 0] >= 0.4]
    assert z[:, 0].min() >= 0.4 and len(exact) < 300_000
    np.testing.assert_allclose(z.mean(axis=0), exact.mean(axis=0), atol=0.03)
    np.testing.assert_allclose(np.cov(z.T), np.cov(exact.T), atol=0.03)


# ---- learning


def test_moves_are_learnt_anew_as_draws_grow_and_draws_count_since_then(monkeypatch):
    found = learnt_after(monkeypatch)
    endless = sample(max_steps=125, n_walkers=4, **ENDLESS)
    assert found == [0, 1, 2, 3, 5, 8, 12] and endless.n_steps == 125
    assert endless.draws.shape == (4, 125, 4, 2)


def test_moves_are_not_learnt_anew_where_as_many_draws_again_would_be_enough(monkeypatch):
    found = learnt_after(monkeypatch)
    asked = {"n_walkers": 4, "target_r_hat": np.inf}
    near = sample(target_ess=700.0, **asked)
    assert near.converged and found[-1] == 8 and near.n_steps > 100  # 100: half as many again as in eight blocks
    far = sample(target_ess=1400.0, **asked)
    assert far.converged and found[-1] >= 12


def test_what_is_learnt_serves_where_the_start_is_wrong():
    """Too wide a start by a thousand times in one direction, and a bend that no normal approximation has."""

    def sheet(x, random):
        thin = (x[:, 1] - x[:, 0] ** 2) / 0.01
        return (-0.5 * x[:, 0] ** 2 - 0.5 * thin**2)[:, None]

    chains = sample(of(sheet, [0], [1]), np.zeros((1, 2)), np.diag([1.0, 10.0]), target_ess=600)
    assert chains.converged
    z = chains.flat()
    np.testing.assert_allclose([z[:, 0].mean(), z[:, 0].var()], [0.0, 1.0], atol=0.1)
    assert z[:, 1].mean() == pytest.approx(1.0, abs=0.15)
    assert np.std(z[:, 1] - z[:, 0] ** 2) == pytest.approx(0.01, rel=0.05)


def test_convergence_is_looked_at_when_draws_would_be_enough(monkeypatch):
    """At no more than twice the steps of the last look, and not at every block."""
    looks, convergence = [], run.EnsembleRun.convergence
    monkeypatch.setattr(run.EnsembleRun, "_again", lambda self: False)
    monkeypatch.setattr(run.EnsembleRun, "convergence", lambda self: (looks.append(self.steps), convergence(self))[1])
    sample(n_walkers=4, max_steps=325, **ENDLESS)
    assert looks == [100, 200, 325]


# ---- ends


def test_processes_draw_the_same():
    """The same to the bit in this process alone and with a spawned one, which takes half of the walkers."""
    runs = []
    for workers in (1, 2):
        with opened(workers, along=True) as executor:
            runs.append(sample(max_steps=50, executor=executor, **ENDLESS))
    np.testing.assert_array_equal(runs[1].draws, runs[0].draws)
    np.testing.assert_array_equal(runs[1].log_prob, runs[0].log_prob)


def jumping(x, random):
    """A normal density cut into steps."""
    return -0.5 * np.sum(np.round(x, 1) ** 2, axis=1, keepdims=True)


def test_a_posterior_with_jumps_is_sampled():
    chains = sample(of(jumping, [0, 1]), np.zeros((1, 2)), np.eye(2), target_ess=1500)
    assert chains.converged
    np.testing.assert_allclose(chains.flat().var(axis=0), 1.0, rtol=0.1)


def test_walkers_that_do_not_leave_their_branch_have_not_converged():
    """Halves that no step leads between, walkers in each: what share each has is not known, and that is said."""

    def halves(x, random):
        return np.where(np.abs(x[:, :1]) < 1.0, -np.inf, -0.5 * np.sum(x * x, axis=1, keepdims=True) * 1e6)

    starts = np.array([[1.001, 0.0], [-1.001, 0.0], [-1.001, 0.0]])
    chains = sample(of(halves, [0, 1]), starts, 1e-4 * np.eye(2), max_steps=100, n_ensembles=5, n_walkers=1)
    assert chains.stop is Stop.STEPS and not chains.converged and "R-hat of mean" in chains.message


def test_steps_time_and_ctrl_c_end_a_run(monkeypatch):
    few = sample(max_steps=50, target_ess=1e6)
    assert few.message.startswith("not converged: stopped at 50 steps") and "ESS" in few.message
    late = sample(budget_s=0.0)
    assert late.stop is Stop.BUDGET and late.n_steps == 25 and not late.converged
    taken, left = run.EnsembleRun.block, iter(range(7))  # moves are learnt after five

    def block(self):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return taken(self)

    monkeypatch.setattr(run.EnsembleRun, "block", block)
    stopped = sample(**ENDLESS)
    assert stopped.stop is Stop.INTERRUPTED and stopped.n_steps == 50 and stopped.convergence is not None
    early = sample()
    assert early.n_steps == 0 and "before any draw counts" in early.message and not early.converged


def test_ctrl_c_while_quantities_are_made_leaves_whole_blocks():
    left = iter(range(7))

    def quantities(z):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return z**2

    chains = sample(quantities=quantities, quantity_names=("aa", "bb"), **ENDLESS)
    assert chains.stop is Stop.INTERRUPTED and chains.n_steps == 50
    np.testing.assert_array_equal(chains.quantities, chains.draws**2)


def test_a_quantity_that_says_nothing_has_not_converged():
    chains = sample(quantities=lambda z: 0.0 * z[:, :1], quantity_names=("same",), max_steps=150)
    assert chains.stop is Stop.STEPS and "R-hat of same is nan" in chains.message


@pytest.mark.parametrize(("n_ensembles", "n_walkers"), [(2, 1), (3, 33)])
def test_few_walkers_and_more_than_go_together_will_do(n_ensembles, n_walkers):
    density = of(lambda x, _: -0.5 * x**2, [0])
    chains = sample(density, np.zeros((1, 1)), np.eye(1), n_ensembles=n_ensembles, n_walkers=n_walkers, target_ess=800)
    assert chains.converged and chains.draws.shape == (n_ensembles, chains.n_steps, n_walkers, 1)
    np.testing.assert_allclose([chains.flat().mean(), chains.flat().var()], [0.0, 1.0], atol=0.15)


def test_a_start_at_an_impossible_place_goes_nearer_to_the_optimum():
    """And an impossible optimum is none."""
    density = of(lambda x, _: np.where(np.abs(x) < 0.01, 0.0, -np.inf)[:, :1], [0])
    chains = sample(density, np.array([[0.0], [5.0]]), np.eye(1), max_steps=25)
    assert np.isfinite(chains.log_prob).all() and np.abs(chains.draws).max() < 0.01


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"density": of(lambda x, _: np.full((len(x), 1), -np.inf), [0, 1])}, "finite"),
        ({"density": of(lambda x, _: np.full((len(x), 1), np.nan), [0, 1])}, "NaN"),
        ({"density": of(lambda x, _: np.full((len(x), 1), np.inf), [0, 1])}, "inf at z"),
        ({"density": of(lambda x, _: np.where(x[:, :1] == BEST[0, 0], 0.0, np.nan), [0, 1])}, "NaN"),
        ({"density": of(lambda x, _: x, [0, 1])}, r"shape \(96, 2\) for 96 places; it must be \(96, 1\)"),
        ({"starts": BEST[:, :1]}, "starts have shape"),
        ({"n_ensembles": 1}, "n_ensembles"),
        ({"quantities": lambda z: z}, "go together"),
        ({"quantity_names": ("q",)}, "go together"),
        ({"quantities": lambda z: z, "quantity_names": ("q",)}, r"shape \(\d+, 2\); it must be \(n, 1\)"),
    ],
)
def test_unusable_input_is_refused_with_its_reason(changed, words):
    with pytest.raises(SamplingError, match=words):
        sample(**changed)


def test_moves_are_learnt_on_one_thread_of_linear_algebra(monkeypatch):
    """More would round sums in another order, so the draws would depend on the machine."""
    threads, learn = [], run.learnt_moves

    def counted(*rest):
        threads.extend(m["num_threads"] for m in threadpool_info() if m["user_api"] == "blas")
        return learn(*rest)

    monkeypatch.setattr(run, "learnt_moves", counted)
    with linear_algebra().limit(limits=2):
        sample(max_steps=25)
    assert threads and set(threads) == {1}


# ---- checkpoints


def test_a_run_that_is_resumed_draws_what_an_uninterrupted_one_does(tmp_path):
    """Stopped after some blocks, killed in the middle of writing one, resumed: the same to the bit."""
    whole = sample(max_steps=75, **ENDLESS)
    file = tmp_path / "chains.ckpt"
    sample(max_steps=50, checkpoint=file, **ENDLESS)
    file.write_bytes(file.read_bytes()[:-100])  # the last block is lost, those before are not
    again = sample(max_steps=75, checkpoint=file, resume=True, **ENDLESS)
    np.testing.assert_array_equal(again.draws, whole.draws)
    np.testing.assert_array_equal(again.log_prob, whole.log_prob)
    assert again.message == whole.message
    with pytest.raises(CheckpointError, match="exists already"):
        sample(checkpoint=file)
    with pytest.raises(CheckpointError, match="seed was 1, is 2"):
        sample(checkpoint=file, resume=True, seed=2)
    with pytest.raises(CheckpointError, match="data was absent, is two") as refused:
        sample(checkpoint=file, resume=True, fingerprint={"data": "two"})
    assert "seed was" not in str(refused.value)


def test_a_run_whose_time_is_up_before_its_walkers_have_arrived_starts_anew(tmp_path):
    file = tmp_path / "chains.ckpt"
    late = sample(budget_s=0.0, checkpoint=file)
    assert late.stop is Stop.BUDGET and late.n_steps == 25 and not file.exists()
    again = sample(max_steps=50, checkpoint=file, resume=True, **ENDLESS)
    np.testing.assert_array_equal(again.draws, sample(max_steps=50, **ENDLESS).draws)


def test_resumed_at_any_block_a_run_learns_its_moves_anew_as_it_would_have(tmp_path, monkeypatch):
    """Killed after each block, so before and after moves are learnt, and once while they are."""
    whole, file = sample(max_steps=125, n_walkers=4, **ENDLESS), tmp_path / "chains.ckpt"
    found, taken, learn = learnt_after(monkeypatch), run.EnsembleRun.block, run.learnt_moves

    def killed(self):
        if self.blocks > came:
            raise OSError
        taken(self)

    def killed_in_learning(*rest):
        if rest[0].shape[0] == 4 * 4 * 25 * 4:  # from blocks 4 to 8
            raise OSError
        return learn(*rest)

    for came in range(14):
        with monkeypatch.context() as patch, pytest.raises(OSError):
            patch.setattr(run.EnsembleRun, "block", killed)
            if came == 8:
                patch.setattr(run, "learnt_moves", killed_in_learning)
            sample(checkpoint=file, resume=True, max_steps=125, n_walkers=4, **ENDLESS)
    assert {0, 1, 2, 3, 5, 8, 12} == set(found)
    again = sample(checkpoint=file, resume=True, max_steps=125, n_walkers=4, **ENDLESS)
    np.testing.assert_array_equal(again.draws, whole.draws)
    np.testing.assert_array_equal(again.log_prob, whole.log_prob)


@pytest.mark.parametrize("came", [25, 27])
def test_resumed_where_as_many_draws_again_would_be_enough_a_run_keeps_its_moves(tmp_path, monkeypatch, came):
    """What was seen at the last look decides that, whether the run was killed since or not."""
    found, taken = learnt_after(monkeypatch), run.EnsembleRun.block
    asked = {"n_walkers": 4, "target_r_hat": np.inf, "target_ess": 1200.0}
    whole, file = sample(**asked), tmp_path / "chains.ckpt"
    assert found[-1] == 18 and whole.n_steps > 225  # half as many again as in 18 blocks

    def killed(self):
        if self.blocks >= came:
            raise OSError
        taken(self)

    with monkeypatch.context() as patch, pytest.raises(OSError):
        patch.setattr(run.EnsembleRun, "block", killed)
        sample(checkpoint=file, **asked)
    again = sample(checkpoint=file, resume=True, **asked)
    np.testing.assert_array_equal(again.draws, whole.draws)


SCRIPT = textwrap.dedent("""
    import sys, pathlib
    sys.path.insert(0, {here!r})
    import test_run as t
    t.run._LEARNT, t.run.POPULATION = 2000, 64
    t.sample(max_steps=300, n_walkers=8, seed=5, checkpoint=pathlib.Path({path!r}), resume=True, **t.ENDLESS)
""")


def test_killed_at_random_and_resumed_a_run_draws_what_it_would_have_drawn(tmp_path):
    asked = {"max_steps": 300, "n_walkers": 8, "seed": 5, **ENDLESS}
    whole, path = sample(**asked), tmp_path / "run.ckpt"
    code, kills = SCRIPT.format(here=os.path.dirname(__file__), path=str(path)), 0
    rng = np.random.default_rng()
    for goal in sorted(rng.integers(1, 600, size=2)):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while process.poll() is None and _stored(path) < goal:
                time.sleep(0.02)
            time.sleep(rng.uniform(0, 0.02))
        finally:
            process.send_signal(signal.SIGKILL)
            kills += process.wait() == -signal.SIGKILL
        read_checkpoint(path)  # readable after every kill
    assert kills >= 1
    resumed = sample(checkpoint=path, resume=True, **asked)
    np.testing.assert_array_equal(resumed.draws, whole.draws)
    np.testing.assert_array_equal(resumed.log_prob, whole.log_prob)


def _stored(path):
    try:
        return len(read_checkpoint(path).draws)
    except CheckpointError:  # not there yet
        return 0


@pytest.mark.parametrize(
    "changed",
    [
        {"state/x": np.zeros((3, 2))},
        {"state/x": np.full((96, 2), np.nan)},
        {"state/drawn": np.zeros((96, 1))},
        {"state/log_prob": np.array("none")},
        {"state/led": np.full((1, 2), np.nan)},
        {"state/led": np.zeros((1, 3))},
        {"state/learnt": np.array(99)},
        {"state/learnt": np.array(np.inf)},
        {"state/look": np.zeros(2)},
        {"draws": np.zeros((4, 7, 3))},
        {"draws": np.full((25, 96, 2), np.nan)},
        {"draws": np.zeros((25, 96, 2))},
        {"log_prob": np.zeros(5)},
        {"header": np.array('{"fingerprint": 1, "names": [], "walkers": 0}')},
        {"header": np.array("{}")},
        {"keys": np.array("[" * 5000)},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_a_checkpoint_with_checksums_made_anew_is_refused_in_one_line(tmp_path, changed):
    """A result is data, also one that somebody wrote who knows the format."""
    path = tmp_path / "run"
    sample(max_steps=25, target_ess=0.0, target_r_hat=np.inf, chain_taus=0.0, checkpoint=path)
    raw, records = path.read_bytes(), []
    at = len(checkpoint._MAGIC)
    while at < len(raw):
        length = int.from_bytes(raw[at : at + 8], "big")
        with np.load(io.BytesIO(raw[at + 40 : at + 40 + length]), allow_pickle=False) as stored:
            records.append({k: stored[k] for k in stored.files})
        at += 40 + length
    for key, value in changed.items():
        for record in records if key == "draws" and len(value) == 25 else [r for r in records if key in r][-1:]:
            record[key] = value if key in record else record.get(key)
    records = [{k: v for k, v in r.items() if v is not None} for r in records]
    out, digest = checkpoint._MAGIC, b""
    for record in records:
        one, digest = checkpoint._record(record, digest)
        out += one
    path.write_bytes(out)
    with pytest.raises(CheckpointError, match=r"run: .*delete it to start anew") as refused:
        sample(checkpoint=path, resume=True)
    assert "\n" not in str(refused.value)
