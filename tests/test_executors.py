"""Pieces here, in processes and on a Dask cluster: each counts once, and answers do not know where they ran."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba as nb
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from bayes_iwan import executors
from bayes_iwan.executors import ExecutorError, Failure
from bayes_iwan.terminal import terminate_as_interrupt

ANALYSES = Path(__file__).parents[1] / "analyses"
PIECES = {f"piece {i}": i for i in range(6)}


def draw(shared, i):
    """Numbers of a seed and of the shared data, summed by linear algebra: threads would show in the last bits."""
    x = np.random.default_rng([shared["seed"], i]).standard_normal((200, 200)) + shared["data"]
    return float(np.linalg.norm(x @ x.T)), nb.get_num_threads(), sorted({i["num_threads"] for i in threadpool_info()})


def note(shared, i):
    """Leave a mark of having run, and die half way the first time (piece 2) or every time (piece 4, if asked for)."""
    with open(shared["folder"] / f"{i}.txt", "a") as file:
        file.write(f"{os.getpid()}\n")
    time.sleep(0.05)
    if i == 2 and len((shared["folder"] / "2.txt").read_text().split()) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if i == 4 and shared["fatal"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return i


def refuse_three(_, i):
    if i == 3:
        raise ValueError("three is refused")
    return i


class Heavy:
    """Shared data that writes down each time it is unpacked in a process."""

    def __init__(self, folder):
        self.folder = folder

    def __setstate__(self, state):
        self.__dict__.update(state)
        with open(self.folder / "unpacked", "a") as file:
            file.write(f"{os.getpid()}\n")


def own_process(shared, i):
    assert isinstance(shared, Heavy)
    time.sleep(0.05)
    return os.getpid()


@pytest.fixture(scope="module")
def processes():
    with executors.opened(2) as executor:
        yield executor


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed")
    # nannies, as on a real cluster: a worker that dies is started again
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as there:
        yield there


@pytest.fixture(scope="module")
def dask(cluster):
    with executors.opened(cluster.scheduler_address) as executor:
        yield executor


@pytest.fixture(params=["here", "threads", "processes", "dask"])
def executor(request):
    if request.param == "here":
        yield None
    elif request.param == "threads":
        with ThreadPoolExecutor(1) as some:
            yield some
    else:
        yield request.getfixturevalue(request.param)


def test_same_bits_and_one_thread_everywhere(executor):
    shared = {"seed": 5, "data": np.linspace(0, 1, 200)}
    expected = {name: draw_alone(shared, i) for name, i in PIECES.items()}
    found = executors.run(PIECES, draw, shared, workers=executor, progress=False)
    assert list(found) == list(PIECES), "the order is that of the pieces"
    assert found == expected


def draw_alone(shared, i):
    with executors.serial():
        return draw(shared, i)


def test_threads_are_given_back():
    before = nb.get_num_threads()
    executors.run(PIECES, draw, {"seed": 5, "data": 0.0}, progress=False)
    assert nb.get_num_threads() == before


def test_an_exception_takes_only_its_own_piece(executor):
    found = executors.run(PIECES, refuse_three, None, workers=executor, progress=False)
    failure = found.pop("piece 3")
    assert isinstance(failure, Failure) and str(failure) == "ValueError: three is refused"
    assert "refuse_three" in failure.trace
    assert list(found.values()) == [0, 1, 2, 4, 5]


@pytest.mark.parametrize("where", ["processes", "dask"])
def test_a_killed_worker_loses_nothing_and_each_piece_counts_once(where, request, tmp_path):
    shared = {"folder": tmp_path, "fatal": False}
    executor = request.getfixturevalue(where)
    came = list(executors.finished(PIECES, note, shared, workers=executor, progress=False))
    assert sorted(came) == sorted(PIECES.items())
    ran = {i: (tmp_path / f"{i}.txt").read_text().split() for i in range(6)}
    assert len(ran[2]) == 2 and ran[2][0] != ran[2][1], "tried again, in another process"
    if where == "processes":
        assert all(len(ran[i]) == 1 for i in (0, 1, 3, 4, 5)), "only the piece that died is run again"


def test_a_piece_that_always_kills_its_process_fails_and_the_rest_is_finished(processes, tmp_path):
    found = executors.run(PIECES, note, {"folder": tmp_path, "fatal": True}, workers=processes, progress=False)
    assert str(found.pop("piece 4")).startswith("died: its process died twice")
    assert list(found.values()) == [0, 1, 2, 3, 5]
    assert len((tmp_path / "4.txt").read_text().split()) == 2


@pytest.mark.parametrize("where", ["processes", "dask"])
def test_data_go_once_to_each_process(where, request, tmp_path):
    executor = request.getfixturevalue(where)
    pieces = {str(i): i for i in range(12)}
    pids = executors.run(pieces, own_process, Heavy(tmp_path), workers=executor, progress=False)
    unpacked = [int(x) for x in (tmp_path / "unpacked").read_text().split()]
    assert set(pids.values()) <= set(unpacked) and len(set(unpacked)) <= 2
    # a scheduler under load may send them once more, as it did on one machine; never with every piece
    assert len(unpacked) <= (2 if where == "processes" else 4)


@pytest.mark.parametrize("where", ["processes", "dask"])
def test_data_go_once_to_each_process_for_all_rounds(where, request, tmp_path):
    rounds = executors.Rounds(request.getfixturevalue(where), Heavy(tmp_path))
    pids = [pid for _ in range(3) for pid in rounds.results(range(4), own_process)]
    unpacked = [int(x) for x in (tmp_path / "unpacked").read_text().split()]
    taken_here = {os.getpid()} if where == "processes" else set()
    assert taken_here <= set(pids) <= {*unpacked, *taken_here}, "this process takes its share beside spawned ones"
    assert len(set(unpacked)) <= 2 and os.getpid() not in unpacked
    # as above: a loaded scheduler may send them once more, never with every round, let alone every piece
    assert len(unpacked) <= (2 if where == "processes" else 4)
    (alone,) = rounds.results([0], own_process)
    assert alone == os.getpid(), "one piece is not worth the way"


class Noted:
    """What notes who packs it."""

    def __init__(self):
        self.by = []

    def __getstate__(self):
        self.by.append(threading.current_thread())
        return {"by": []}


def is_noted(shared, piece):
    return isinstance(shared, Noted) and isinstance(piece, Noted)


def test_whoever_sends_packs(processes):
    """A thread of a pool would pack what this process is working on by then, and may meet a dictionary that grows."""
    shared, pieces = Noted(), [Noted() for _ in range(4)]
    assert all(executors.Rounds(processes, shared).results(pieces, is_noted))
    assert {t for x in (shared, *pieces) for t in x.by} == {threading.current_thread()}
    assert len(shared.by) == 1


def test_what_cannot_travel_is_a_failure_of_its_piece(processes):
    done = executors.run({"a": 1, "b": lambda: 2}, refuse_three, None, workers=processes, progress=False)
    assert done["a"] == 1 and isinstance(done["b"], Failure) and "pickle" in done["b"].message


def test_rounds_give_results_in_order_and_say_what_failed(executor):
    rounds = executors.Rounds(executor, None)
    assert list(rounds.results([5, 4, 1, 2], refuse_three)) == [5, 4, 1, 2]
    with pytest.raises(ValueError, match="three is refused"):
        list(rounds.results([1, 3], refuse_three))


@pytest.fixture(scope="module")
def wanted(kit):
    """A small campaign with a dashpot in it, and effects to look for: one is sudden, one a user's own."""
    # not at the top, which every process reads
    from bayes_iwan.diagnosis.fits.data import gap_data
    from bayes_iwan.diagnosis.search.model_search import search
    from bayes_iwan.effects import catalogue
    from bayes_iwan.effects.catalogue import load_effects
    from bayes_iwan.inference.setup.loop_scales import scales_of

    loops = kit.campaign_of(kit.rig_records("viscous_damping")).loops(**kit.small)
    kinds = {n: catalogue.variants()[n] for n in ("viscous_damping", "channel_delay", "end_stop")}
    kinds |= {e.name: (e,) for e in load_effects(ANALYSES / "effects" / "quadratic_drag.py")}
    data, scales = gap_data(loops), scales_of(loops)
    return lambda executor: search(data, scales, kit.settings, kinds, np.random.default_rng(1), executor=executor)


@pytest.fixture(scope="module")
def found_here(wanted):
    return wanted(None)


@pytest.mark.parametrize("where", ["processes", "dask"])
def test_a_search_finds_the_same_bits_wherever_effects_are_refitted(where, request, wanted, found_here):
    found = wanted(request.getfixturevalue(where))
    assert found.chosen == found_here.chosen and "quadratic_drag" in found_here.effects
    assert list(found.fits) == list(found_here.fits) and len(found.fits) > 4
    for names, fit in found.fits.items():
        here = found_here.fits[names]
        for value in ("z", "log_z", "covariance", "optima"):
            np.testing.assert_array_equal(getattr(fit, value), getattr(here, value))
        assert fit.problem.loops[0] is found.data.loops[0], "the data are not sent back"


def test_a_cluster_s_lost_data_are_sent_again(tmp_path):
    """One worker only, which dies with the data it was sent: they come again with the piece."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as one:
        with executors.opened(one.scheduler_address) as executor:
            shared = {"folder": tmp_path, "fatal": False}
            assert executors.run(PIECES, note, shared, workers=executor, progress=False) == PIECES


def test_what_cannot_be_had_is_refused_in_one_line():
    with pytest.raises(ExecutorError, match="at least one"):
        with executors.opened(0):
            pass
    with executors.opened(1, along=True) as executor:
        assert executor is None


def test_a_cluster_that_does_not_answer_is_said(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "_CONNECT_S", 1.0)
    with pytest.raises(ExecutorError, match="no Dask scheduler answers at tcp://"):
        with executors.opened("tcp://127.0.0.1:1"):
            pass


SLEEPER = """
import os, signal, sys, time
from pathlib import Path
from bayes_iwan import executors

def sleep(folder, i):
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(600)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts in the background is deaf to it
    with executors.opened(2) as executor:
        executors.run({"a": 1, "b": 2, "c": 3}, sleep, sys.argv[1], workers=executor, progress=False)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_processes_end_with_their_parent_however_it_ends(how, tmp_path):
    script, marks = tmp_path / "sleeper.py", tmp_path / "marks"
    marks.mkdir()
    script.write_text(SLEEPER)
    root = str(Path(executors.__file__).parents[1])
    parent = subprocess.Popen(
        [sys.executable, str(script), str(marks)], env={**os.environ, "PYTHONPATH": root}, stderr=subprocess.PIPE
    )
    wait_for(lambda: len(list(marks.iterdir())) == 2)
    parent.send_signal(how)
    assert parent.wait(90) != 0
    pids = [int(p.name) for p in marks.iterdir()]
    assert len(pids) == 2, "nothing new was begun"
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids) if os.path.isdir("/proc") else True)


def wait_for(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def fail_when_interrupted(shared, piece):
    """As a compiler does that a signal interrupts."""
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10.0)
    except KeyboardInterrupt:
        raise RuntimeError("half a type") from None


def test_a_piece_that_a_signal_makes_fail_ends_the_work():
    """Not that piece alone, with the next one begun."""
    with pytest.raises(KeyboardInterrupt), terminate_as_interrupt():
        list(executors.finished({"a": 1, "b": 2}, fail_when_interrupted, None))
    assert isinstance(dict(executors.finished({"a": 1}, int, None))["a"], Failure)  # later errors are errors again
