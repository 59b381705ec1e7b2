"""Whole runs: right answers, honest ends, and checkpoints from which a killed run draws what it would have drawn."""

import io
import os
import signal
import subprocess
import sys
import textwrap
import time

import numba as nb
import numpy as np
import pytest
from bayes_iwan.sampling.moves.metropolis import LeastSquares
from bayes_iwan.sampling.nuisance import Nuisance

from bayes_iwan.executors import opened
from bayes_iwan.sampling import checkpoint, run
from bayes_iwan.sampling.chains import Stop
from bayes_iwan.sampling.checkpoint import CheckpointError, read_checkpoint
from bayes_iwan.sampling.plan import Plan, SamplingError

NAMES = ("mean", "log scale")
Y = np.random.default_rng(0).standard_normal(10) * 0.5 + 0.8
BEST = np.array([[0.65, -0.6]])


def log_prob(z):
    """Ten residuals of z0 with scale exp(z1)."""
    squares = np.sum((Y - z[..., :1]) ** 2, axis=-1)
    return -10.0 * z[..., 1] - 0.5 * squares * np.exp(-2.0 * z[..., 1]) - 0.5 * np.sum(z * z, axis=-1)


def rows(z):
    return (z[:, :1] - Y) * np.exp(-z[:, 1:])


def of_nuisance(z, drawn):
    return log_prob(np.stack([np.broadcast_to(z[:, :1], drawn.shape[:2]), drawn[:, :, 0]], axis=2))


TARGET = LeastSquares(rows, of_nuisance, Nuisance(np.array([1]), BEST[0, 1:], np.array([[0.22]])), 2, 8.0)


def sample(target=TARGET, function=log_prob, starts=BEST, executor=None, n_walkers=24, n_ensembles=4, **asked):
    plan = Plan(**{"names": NAMES, "seed": 1, "progress": False, **asked})
    return run.sample(function, target, starts, plan, executor=executor, n_walkers=n_walkers, n_ensembles=n_ensembles)


@pytest.fixture(autouse=True)
def short_pilot(monkeypatch):
    monkeypatch.setattr(run, "_WARM_UP", 1)


def test_a_run_ends_by_itself_with_the_right_moments():
    axis = np.linspace(-3.0, 3.0, 1201)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    p = np.exp(log_prob(places) - log_prob(places).max())
    moments = [np.sum(p * places[:, i] ** k) / p.sum() for i in (0, 1) for k in (1, 2)]
    squares = dict(quantities=lambda z: z**2, quantity_names=("aa", "bb"))
    chains = sample(target_ess=1500, **squares)
    assert chains.converged and chains.message == "converged" and chains.stop is Stop.CONVERGED
    assert chains.convergence.worst_r_hat < 1.01 and chains.convergence.least_ess > 1500
    assert chains.convergence.names == (*NAMES, "aa", "bb") and chains.independent
    z = chains.flat()
    np.testing.assert_allclose([np.mean(z[:, i] ** k) for i in (0, 1) for k in (1, 2)], moments, atol=0.03)
    np.testing.assert_allclose(chains.log_prob.reshape(-1), log_prob(z), rtol=1e-9)
    np.testing.assert_array_equal(chains.quantities, chains.draws**2)
    again = sample(target_ess=1500, **squares)
    np.testing.assert_array_equal(again.draws, chains.draws)
    assert (sample(seed=2, max_steps=25).draws[0, 0] != chains.draws[0, 0]).any()


def test_processes_draw_the_same():
    """The same to the bit in this process alone and with a spawned one, which takes half of the walkers."""
    runs = []
    for workers in (1, 2):
        with opened(workers, along=True) as executor:
            runs.append(sample(max_steps=25, executor=executor))
    np.testing.assert_array_equal(runs[1].draws, runs[0].draws)
    np.testing.assert_array_equal(runs[1].log_prob, runs[0].log_prob)


def jumping(z):
    """A normal density cut into steps: its residuals have no slope."""
    return -0.5 * np.sum(np.round(z, 2) ** 2, axis=-1)


def test_a_posterior_with_jumps_is_sampled_by_walkers_that_move_by_each_other():
    """Steps along a manifold lead nowhere, and that is found out."""
    target = LeastSquares(
        lambda z: 30.0 * np.sin(1e9 * z), lambda z, _: jumping(z)[:, None],
        Nuisance(np.empty(0, np.int64), np.empty(0), np.empty((0, 0))), 2, 8.0,
    )  # fmt: skip
    chains = sample(target, jumping, np.zeros((1, 2)), chain_taus=20.0)
    assert chains.converged and not chains.independent and chains.draws.shape[2] == 24
    assert chains.draws.shape[1] == chains.n_steps - chains.n_steps // 2  # the first half does not count
    np.testing.assert_allclose(chains.flat().var(axis=0), 1.0, rtol=0.2)


def test_walkers_that_do_not_leave_their_branch_have_not_converged():
    """Two halves that no step leads between, walkers in each: what share each has is not known, and that is said."""

    def halves(z):
        return 30.0 * (z[:, :1] ** 2 - 1.0)

    def density(z):
        return -0.5 * np.sum(halves(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1)

    none = Nuisance(np.empty(0, np.int64), np.empty(0), np.empty((0, 0)))
    target = LeastSquares(halves, lambda z, _: density(z)[:, None], none, 2, 8.0)
    chains = sample(target, density, np.array([[1.0, 0.0], [-1.0, 0.0]]), max_steps=100)
    assert chains.stop is Stop.STEPS and not chains.converged and "R-hat of mean" in chains.message


def test_steps_time_and_ctrl_c_end_a_run(monkeypatch):
    few = sample(max_steps=50, target_ess=1e6)
    assert few.message.startswith("not converged: stopped at 50 steps") and "ESS" in few.message
    late = sample(budget_s=0.0)
    assert late.stop is Stop.BUDGET and late.n_steps == 25 and not late.converged
    taken, left = run.EnsembleRun.block, iter(range(4))  # two of them are the pilot's

    def block(self):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return taken(self)

    monkeypatch.setattr(run.EnsembleRun, "block", block)
    cut = sample()
    assert cut.stop is Stop.INTERRUPTED and cut.n_steps == 50 and cut.convergence is not None
    early = sample()
    assert early.n_steps == 0 and "before any draw counts" in early.message and not early.converged


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"function": lambda z: np.full(len(z), -np.inf)}, "finite"),
        ({"function": lambda z: np.full(len(z), np.nan)}, "NaN"),
        ({"function": lambda z: z}, "shape"),
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


def test_a_run_that_is_resumed_draws_what_an_uninterrupted_one_does(tmp_path):
    """Stopped after some blocks, killed in the middle of writing one, resumed: the same to the bit, on any threads."""
    whole = sample(max_steps=75, target_ess=1e6)
    file = tmp_path / "chains.ckpt"
    cut = sample(max_steps=50, target_ess=1e6, checkpoint=file)
    np.testing.assert_array_equal(cut.draws, whole.draws[:, :50])
    file.write_bytes(file.read_bytes()[:-100])  # the second block is lost, the first is not
    threads = nb.get_num_threads()
    try:
        nb.set_num_threads(1)
        again = sample(max_steps=75, target_ess=1e6, checkpoint=file, resume=True)
    finally:
        nb.set_num_threads(threads)
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


def test_independent_proposals_are_resumed_too(tmp_path):
    def curled(z):
        return np.stack([40.0 * (z[:, 1] - z[:, 0] ** 2), 40.0 * (z[:, 2] - np.sin(2.0 * z[:, 0]))], axis=1)

    def density(z):
        return -0.5 * np.sum(curled(z) ** 2, axis=1) - 0.5 * np.sum(z * z, axis=1)

    none = Nuisance(np.empty(0, np.int64), np.empty(0), np.empty((0, 0)))
    target = LeastSquares(curled, lambda z, _: density(z)[:, None], none, 3, 8.0)
    asked = {"names": ("a", "b", "c"), "target_ess": 1e6}
    whole = sample(target, density, np.zeros((1, 3)), max_steps=75, **asked)
    file = tmp_path / "chains.ckpt"
    sample(target, density, np.zeros((1, 3)), max_steps=50, checkpoint=file, **asked)
    assert "curving" in read_checkpoint(file, (run.STAGE,))[2].state
    again = sample(target, density, np.zeros((1, 3)), max_steps=75, checkpoint=file, resume=True, **asked)
    np.testing.assert_array_equal(again.draws, whole.draws)


SCRIPT = textwrap.dedent("""
    import sys, pathlib
    sys.path.insert(0, {here!r})
    import test_run as t
    t.run._WARM_UP = 1
    t.sample(max_steps=600, target_ess=1e9, chain_taus=1e5, seed=5, checkpoint=pathlib.Path({path!r}), resume=True)
""")


def test_killed_at_random_and_resumed_a_run_draws_what_it_would_have_drawn(tmp_path):
    asked = {"max_steps": 600, "target_ess": 1e9, "chain_taus": 1e5, "seed": 5}
    whole, path = sample(**asked), tmp_path / "run.ckpt"
    code, kills = SCRIPT.format(here=os.path.dirname(__file__), path=str(path)), 0
    rng = np.random.default_rng()
    for goal in sorted(rng.integers(1, 500, size=3)):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while process.poll() is None and _stored(path) < goal:
                time.sleep(0.02)
            time.sleep(rng.uniform(0, 0.02))
        finally:
            process.send_signal(signal.SIGKILL)
            kills += process.wait() == -signal.SIGKILL
        read_checkpoint(path, (run.STAGE,))  # readable after every kill
    assert kills >= 1
    resumed = sample(checkpoint=path, resume=True, **asked)
    np.testing.assert_array_equal(resumed.draws, whole.draws)
    np.testing.assert_array_equal(resumed.log_prob, whole.log_prob)


def _stored(path):
    try:
        return len(read_checkpoint(path, (run.STAGE,))[2].draws[run.STAGE])
    except CheckpointError:  # not there yet
        return 0


@pytest.mark.parametrize(
    "changed",
    [
        {"state/z": np.zeros((3, 2))},
        {"state/z": np.full((64, 2), np.nan)},
        {"state/scale": np.array("none")},
        {"state/root": np.zeros((7, 7))},
        {"draws/production": np.zeros((4, 7, 3))},
        {"log_prob/production": np.zeros(5)},
        {"header": np.array('{"fingerprint": 1, "names": [], "walkers": {}}')},
        {"header": np.array("{}")},
        {"keys": np.array("[" * 5000)},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_a_checkpoint_with_checksums_made_anew_is_refused_in_one_line(tmp_path, changed):
    """A result is data, also one that somebody wrote who knows the format."""
    path = tmp_path / "run"
    sample(max_steps=25, checkpoint=path)
    raw, records = path.read_bytes(), []
    at = len(checkpoint._MAGIC)
    while at < len(raw):
        length = int.from_bytes(raw[at : at + 8], "big")
        with np.load(io.BytesIO(raw[at + 40 : at + 40 + length]), allow_pickle=False) as stored:
            records.append({k: stored[k] for k in stored.files})
        at += 40 + length
    for key, value in changed.items():
        last = [r for r in records if key in r][-1]
        last[key] = value
    out, digest = checkpoint._MAGIC, b""
    for record in records:
        one, digest = checkpoint._record(record, digest)
        out += one
    path.write_bytes(out)
    with pytest.raises(CheckpointError, match=r"run: .*delete it to start anew") as refused:
        sample(checkpoint=path, resume=True)
    assert "\n" not in str(refused.value)
