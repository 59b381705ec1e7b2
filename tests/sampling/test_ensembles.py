"""Whole sampling runs: right answers, honest stops, checkpoints that survive kill -9."""

import io
import os
import signal
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.sampling.common import checkpoint
from bayes_iwan.sampling.common.chains import Stop
from bayes_iwan.sampling.common.checkpoint import Checkpoint, CheckpointError, read_checkpoint
from bayes_iwan.sampling.common.plan import Plan, SamplingError
from bayes_iwan.sampling.ensemble import ensembles, run, walkers

NAMES = ("a", "b", "c")
SHORT = dict(n_walkers=16, target_ess=300.0, chain_taus=20.0, progress=False)


def sample(log_prob, start, *, n_ensembles=4, n_walkers=40, **asked):
    return ensembles.sample(log_prob, start, Plan(**asked), n_ensembles=n_ensembles, n_walkers=n_walkers)


def banana(z):
    return -0.5 * (z[:, 0] ** 2 + (z[:, 1] - z[:, 0] ** 2) ** 2 + 100 * (z[:, 2] + z[:, 0] * z[:, 1] / 5) ** 2)


def population(seed=0, n=300):
    return 2.0 * np.random.default_rng(seed).standard_normal((n, 3))


@pytest.fixture(autouse=True)
def short_adaptation(monkeypatch):
    monkeypatch.setattr(run, "_WARMUP_STEPS", 100)
    monkeypatch.setattr(run, "_ROUND_STEPS", (60, 100))
    monkeypatch.setattr(run, "_ROUNDS", (3, 6))


def test_a_run_ends_by_itself_with_the_right_moments_and_the_same_draws_for_the_same_seed():
    squares = dict(quantities=lambda z: z[:, :2] ** 2, quantity_names=("aa", "bb"))
    runs = [sample(banana, population(), names=NAMES, seed=1, **squares, **SHORT) for _ in range(2)]
    chains = runs[0]
    np.testing.assert_array_equal(chains.draws, runs[1].draws)
    assert chains.converged and chains.message == "converged"
    assert chains.convergence.names == (*NAMES, "aa", "bb")
    assert chains.convergence.worst_r_hat <= 1.01 and chains.convergence.least_ess >= 300
    assert chains.n_steps >= 20 * chains.convergence.worst_tau and chains.n_steps == chains.thin * chains.draws.shape[1]
    z = chains.flat()
    error = 4 / np.sqrt(chains.convergence.least_ess)
    np.testing.assert_allclose(z[:, :2].mean(axis=0), [0, 1], atol=2 * error)
    np.testing.assert_allclose(z[:, :2].var(axis=0), [1, 3], rtol=4 * error)
    np.testing.assert_array_equal(chains.log_prob[0, 3], banana(chains.draws[0, 3]))
    np.testing.assert_array_equal(chains.flat_quantities(50), chains.flat(50)[:, :2] ** 2)
    assert chains.draws.shape[::2] == (4, 16) and len(np.unique(chains.draws[:, -1, :, 0])) > 32
    other = sample(banana, population(), names=NAMES, seed=2, max_steps=100, **SHORT)
    assert other.draws.shape[1] == 0 or (other.draws[0, 0] != chains.draws[0, 0]).any()


def test_modes_that_no_walker_can_leave_are_not_called_converged():
    def wells(z):  # two wells of equal weight, 200 standard deviations apart, with no way between them
        side = np.where(z[:, 0] > 0, 1.0, -1.0)
        inside = -0.5 * ((z[:, 0] - 100 * side) ** 2 + z[:, 1] ** 2 + z[:, 2] ** 2)
        return np.where(np.abs(z[:, 0] - 100 * side) < 20, inside, -np.inf)

    start = np.random.default_rng(0).standard_normal((400, 3))
    start[:, 0] += 100
    start[:90, 0] -= 200  # the walkers' shares of the two wells differ between ensembles, and stay
    chains = sample(wells, start, names=NAMES, seed=3, max_steps=300, **SHORT)
    share = (chains.draws[..., 0] > 0).mean(axis=(1, 2))
    if np.ptp(share) > 0.05:
        assert not chains.converged and "R-hat" in chains.message
    else:  # the proposals found the way between the wells: then the shares must be the true ones
        assert abs(share.mean() - 0.5) < 0.1


def test_slow_production_is_taken_for_more_adaptation(tmp_path, monkeypatch):
    """Slow by decree: five times the length so far is asked for at every look. The restarts are few, what they leave
    behind is not in the result, what remains is right, and a checkpoint goes on behind them."""
    monkeypatch.setattr(run, "_TRIAL_STEPS", 200)
    seen, restart = [], run.Run.restart_if_slow

    def watched(self, result, chain_taus):
        did = restart(self, result, 1e9)
        seen.append((did, self.n_steps))
        return did

    monkeypatch.setattr(run.Run, "restart_if_slow", watched)
    file, long = tmp_path / "chains.ckpt", SHORT | {"target_ess": 6000.0}
    chains = sample(banana, population(), names=NAMES, seed=1, checkpoint=file, **long)
    restarted = [x for x in seen if x[0]]
    assert len(restarted) == run._RESTARTS and all(steps == 0 for _, steps in restarted)
    assert chains.converged and chains.n_steps == chains.thin * chains.draws.shape[1]
    error = 4 / np.sqrt(chains.convergence.least_ess)
    z = chains.flat()
    np.testing.assert_allclose(z[:, :2].mean(axis=0), [0, 1], atol=2 * error)
    np.testing.assert_allclose(z[:, :2].var(axis=0), [1, 3], rtol=4 * error)
    again = sample(banana, population(), names=NAMES, seed=1, checkpoint=file, resume=True, **long)
    np.testing.assert_array_equal(again.draws, chains.draws)


def test_steps_and_time_limits_are_said_plainly():
    few = sample(banana, population(), names=NAMES, seed=1, max_steps=60, **SHORT | {"target_ess": 1e6})
    assert not few.converged and few.n_steps >= 60
    assert few.message.startswith("not converged: stopped at 60 steps") and "ESS" in few.message
    late = sample(banana, population(), names=NAMES, seed=1, budget_s=0.0, **SHORT)
    assert not late.converged and "time budget" in late.message and late.draws.shape[1] >= 8


@pytest.mark.parametrize("most", [1, 8, 30])
def test_very_few_steps_are_an_end_too(most):
    few = sample(banana, population(), names=NAMES, seed=1, max_steps=most, **SHORT | {"target_ess": 1e6})
    assert not few.converged and "stopped at" in few.message


def test_a_clock_changes_nothing_but_the_end_or_says_so(tmp_path, monkeypatch):
    """Time is counted in evaluations, so that budgets end runs at many places; gone on with, each draws the same."""
    settings = SHORT | dict(target_ess=1e9, max_steps=900)
    calls = 0

    def counted(z):
        nonlocal calls
        calls += 1
        return banana(z)

    clock = SimpleNamespace(monotonic=lambda: float(calls))
    monkeypatch.setattr(run, "time", clock)
    monkeypatch.setattr(walkers, "time", clock)
    whole = sample(counted, population(), names=NAMES, seed=5, **settings)
    every = calls
    for share in (0.75, 0.88):
        path = tmp_path / f"{share}.ckpt"
        mine = dict(names=NAMES, seed=5, checkpoint=path, **settings)
        cut = sample(counted, population(), budget_s=share * every, **mine)
        assert cut.stop is Stop.BUDGET and "stopped at the time budget" in cut.message
        assert "adaptation" not in cut.message and 0 < cut.n_steps < whole.n_steps
        np.testing.assert_array_equal(cut.draws, whole.draws[:, : cut.draws.shape[1]])
        resumed = sample(counted, population(), resume=True, **mine)
        np.testing.assert_array_equal(resumed.draws, whole.draws)
        assert resumed.message == whole.message
    hurried = sample(counted, population(), names=NAMES, seed=5, budget_s=0.3 * every, **settings)
    assert "the time budget cut adaptation short" in hurried.message
    lucky = sample(counted, population(), names=NAMES, seed=5, budget_s=0.93 * every, **settings | {"target_ess": 1.0}
                   | {"chain_taus": 1e-3, "target_r_hat": 99.0})  # fmt: skip
    assert lucky.message == "converged"


def test_ctrl_c_keeps_the_draws_so_far():
    calls = 0

    def interrupted(z):
        nonlocal calls
        calls += 1
        if calls == 1500:
            raise KeyboardInterrupt
        return banana(z)

    chains = sample(interrupted, population(), names=NAMES, seed=1, **SHORT | {"target_ess": 1e6})
    assert not chains.converged and "interrupted" in chains.message and chains.draws.shape[1] > 0


@pytest.mark.parametrize(
    "log_prob, start, words",
    [
        (lambda z: np.full(len(z), -np.inf), population(), "finite"),
        (lambda z: np.where(z[:, 0] > 0, np.nan, banana(z)), population(), "NaN"),
        (lambda z: z, population(), "shape"),
        (banana, population()[:, :2], "population"),
        (banana, np.tile(population()[:2], (50, 1)), "different members"),
    ],
)
def test_unusable_input_is_refused_with_its_reason(log_prob, start, words):
    with pytest.raises(SamplingError, match=words):
        sample(log_prob, start, names=NAMES, seed=0, **SHORT)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"quantities": lambda z: z}, "go together"),
        ({"quantity_names": ("q",)}, "go together"),
        ({"quantities": lambda z: z, "quantity_names": ("q",)}, r"shape \(\d+, 3\); it must be \(n, 1\)"),
    ],
)
def test_quantities_that_are_not_what_their_names_say_are_refused(asked, words):
    with pytest.raises(SamplingError, match=words):
        sample(banana, population(), names=NAMES, seed=0, max_steps=60, **SHORT, **asked)


def test_too_few_walkers_or_ensembles_are_refused():
    with pytest.raises(SamplingError, match="n_walkers"):
        sample(banana, population(), names=NAMES, seed=0, **SHORT | {"n_walkers": 7})
    with pytest.raises(SamplingError, match="n_ensembles"):
        sample(banana, population(), names=NAMES, seed=0, n_ensembles=1, **SHORT)


SCRIPT = textwrap.dedent("""
    import sys, pathlib
    sys.path.insert(0, {here!r})
    import test_ensembles as t
    from bayes_iwan.sampling.ensemble import run
    run._WARMUP_STEPS, run._ROUND_STEPS, run._ROUNDS, run._TRIAL_STEPS = 100, (60, 100), (3, 6), 200
    settings = t.SHORT | dict(target_ess=1e9, max_steps=1500, chain_taus=1e5)
    t.sample(t.banana, t.population(), names=t.NAMES, seed=5, checkpoint=pathlib.Path({path!r}),
             fingerprint={{"data": "d"}}, resume=True, **settings)
""")


def test_killed_at_random_and_resumed_a_run_draws_what_it_would_have_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "_TRIAL_STEPS", 200)  # with so long a chain asked for, production is begun anew as well
    settings = SHORT | dict(target_ess=1e9, max_steps=1500, chain_taus=1e5)
    whole = sample(banana, population(), names=NAMES, seed=5, fingerprint={"data": "d"}, **settings)
    path = tmp_path / "run.ckpt"
    code = SCRIPT.format(here=os.path.dirname(__file__), path=str(path))
    rng = np.random.default_rng()
    kills = 0
    for goal in sorted(rng.integers(1, whole.draws.shape[1], size=3)):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while process.poll() is None and _stored(path) < goal:
                time.sleep(0.05)
            time.sleep(rng.uniform(0, 0.05))
        finally:
            process.send_signal(signal.SIGKILL)
            kills += process.wait() == -signal.SIGKILL
        read_checkpoint(path, ("plain", "production"))  # readable after every kill
    assert kills >= 1
    resumed = sample(
        banana, population(), names=NAMES, seed=5, checkpoint=path, fingerprint={"data": "d"}, resume=True, **settings
    )
    np.testing.assert_array_equal(resumed.draws, whole.draws)
    np.testing.assert_array_equal(resumed.log_prob, whole.log_prob)
    assert resumed.n_evaluations == whole.n_evaluations


def _stored(path):
    try:
        return len(read_checkpoint(path, ("plain", "production"))[2].draws["production"])
    except CheckpointError:  # not there yet
        return 0


def test_checkpoints_of_other_runs_are_refused_naming_what_differs(tmp_path):
    path = tmp_path / "run.ckpt"
    mine = dict(names=NAMES, checkpoint=path, **SHORT | {"max_steps": 60})
    sample(banana, population(), seed=1, fingerprint={"data": "one", "model": "m"}, **mine)
    with pytest.raises(CheckpointError, match="exists already"):
        sample(banana, population(), seed=1, fingerprint={"data": "one", "model": "m"}, **mine)
    with pytest.raises(CheckpointError, match=r"data was one, is two") as refused:
        sample(banana, population(), seed=1, fingerprint={"data": "two", "model": "m"}, resume=True, **mine)
    assert "model" not in str(refused.value)
    with pytest.raises(CheckpointError, match="seed was 1, is 2"):
        sample(banana, population(), seed=2, fingerprint={"data": "one", "model": "m"}, resume=True, **mine)
    path.write_text("no checkpoint")
    with pytest.raises(CheckpointError, match=r"run\.ckpt"):
        sample(banana, population(), seed=1, resume=True, **mine)


def small_checkpoint(path):
    """Two commits of three draws each; the bytes of the file after each."""
    file = Checkpoint.create(path, {}, ("x",), {"plain": 8, "production": 4}, {"i": np.array(0.0)})
    ends = [path.stat().st_size]
    for i in (1.0, 2.0):
        file.append("production", np.full((3, 4, 1), i), np.full((3, 4), i))
        file.commit({"i": np.array(i), "kept": np.arange(5)})
        ends.append(path.stat().st_size)
    file.close()
    return ends


def test_a_commit_that_is_cut_short_falls_back_to_the_one_before(tmp_path):
    path, stages = tmp_path / "run", ("plain", "production")
    start, first, end = small_checkpoint(path)
    whole = path.read_bytes()
    assert read_checkpoint(path, stages)[2].draws["production"][:, 0, 0].tolist() == [1, 1, 1, 2, 2, 2]
    for cut in range(first, end, 7):
        path.write_bytes(whole[:cut])
        snapshot = read_checkpoint(path, stages)[2]
        assert snapshot.state["i"] == 1.0 and snapshot.damaged == cut - first
        assert snapshot.draws["production"].shape == (3, 4, 1) and snapshot.draws["plain"].shape == (0, 8, 1)
    file, _ = Checkpoint.resume(path, {}, ("x",), stages)  # what was cut is drawn again, and the file is whole again
    file.append("production", np.full((3, 4, 1), 2.0), np.full((3, 4), 2.0))
    file.commit({"i": np.array(2.0), "kept": np.arange(5)})
    file.close()
    assert path.read_bytes() == whole
    for cut in range(start):
        path.write_bytes(whole[:cut])
        with pytest.raises(CheckpointError, match=r"run: (not a checkpoint|damaged at its start)"):
            read_checkpoint(path, stages)


def test_no_changed_byte_changes_a_draw(tmp_path):
    path, stages = tmp_path / "run", ("plain", "production")
    start, first, _ = small_checkpoint(path)
    whole = path.read_bytes()
    for at in range(0, len(whole), 5):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        if at < start:
            with pytest.raises(CheckpointError, match=r"run: "):
                read_checkpoint(path, stages)
            continue
        snapshot = read_checkpoint(path, stages)[2]
        kept = [1.0] * 3 if at >= first else []
        assert snapshot.damaged == len(whole) - (first if kept else start)
        assert snapshot.draws["production"][:, 0, 0].tolist() == kept and snapshot.state["i"] == len(kept) / 3


@pytest.mark.parametrize(
    "changed",
    [
        {"state/coords": np.zeros((3, 2))},
        {"state/coords": np.full((128, 3), np.nan)},
        {"state/random_key": np.zeros(624)},
        {"state/producing": np.array("perhaps"), "state/thin": np.array("none")},
        {"draws/plain": np.zeros((4, 7, 3))},
        {"log_prob/plain": np.zeros(5)},
        {"header": np.array('{"fingerprint": 1, "names": [], "walkers": {}}')},
        {"header": np.array("{}")},
        {"keys": np.array("[" * 5000)},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_a_checkpoint_with_checksums_made_anew_is_refused_in_one_line(tmp_path, changed):
    """A result is data, also one that somebody wrote who knows the format."""
    path = tmp_path / "run"
    mine = dict(names=NAMES, seed=1, checkpoint=path, **SHORT | {"max_steps": 40})
    sample(banana, population(), **mine)
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
        sample(banana, population(), resume=True, **mine)
    assert "\n" not in str(refused.value)
