"""Independent pieces of work, in this process or in any `concurrent.futures.Executor`, with the same answers anywhere.

    done = run({"a": 1, "b": 2}, work, settings, workers=4)  # {"a": work(settings, 1), ...} or a Failure

Whatever runs many independent things goes through :func:`finished` or :func:`run`: no scheduler of our own. A piece
works on one thread wherever it runs, so its answer is the same to the bit (on one make of processor) in this process,
in spawned ones and on a Dask cluster. What all pieces need travels once to each process, not with every piece.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Generic, TypeVar, cast

import numba as nb
from tqdm import tqdm

from bayes_iwan.errors import InputError
from bayes_iwan.terminal import stopped
from bayes_iwan.threads import alongside, linear_algebra

Shared = TypeVar("Shared")
Piece = TypeVar("Piece")
Result = TypeVar("Result")
Name = TypeVar("Name")

#: a number of processes (None: this one), the address of a Dask scheduler ("tcp://host:port") whose workers have this
#: package and see the same folders, or an executor of your own
Workers = int | str | Executor | None

_CONNECT_S = 20.0


class ExecutorError(InputError):
    """Processes or a cluster that cannot be had as asked for."""


@dataclass(frozen=True)
class Failure:
    """A piece that gave no result: the exception's type, its message and where it was raised ("" if it died)."""

    kind: str
    message: str
    trace: str = ""

    def __str__(self) -> str:
        return f"{self.kind}: {self.message}" if self.message else self.kind


@contextmanager
def serial() -> Iterator[None]:
    """One thread, ours and the linear algebra's: pieces side by side share the cores, and sums keep their order."""
    threads = nb.get_num_threads()
    nb.set_num_threads(1)
    try:
        with linear_algebra().limit(limits=1):
            yield
    finally:
        nb.set_num_threads(threads)


@contextmanager
def opened(workers: Workers = None, along: bool = False, needs: Sequence[str] = ()) -> Iterator[Executor | None]:
    """An executor: None (this process) for one worker, spawned processes for more, or a Dask cluster's workers.

    workers : see :data:`Workers`; an executor that is given stays open. along : this process is one of the workers, for
    it takes its share (:class:`Rounds`), and the others start when there is something to share; needs : modules that
    spawned processes import as they start, which then is at once, while this one prepares their first pieces. Leaving
    the block by an exception, Ctrl-C among them, ends the processes at once and takes back what a cluster has not done.
    Raises ExecutorError for less than one worker and for a cluster that does not answer.
    """
    if isinstance(workers, str):
        with _cluster(workers) as executor:
            yield executor
    elif isinstance(workers, Executor):
        yield workers
    elif workers is None or workers == 1:
        yield None
    elif workers < 1:
        raise ExecutorError(f"{workers} workers asked for; there must be at least one")
    else:
        with Processes(workers - along, needs, at_once=not along or len(needs) > 0) as processes:
            yield processes


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise ExecutorError("Dask is not installed; python -m pip install distributed") from None
    try:
        client = Client(address, timeout=_CONNECT_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:  # a scheduler that is not there, an address that is none
        raise ExecutorError(f"no Dask scheduler answers at {address} ({str(error) or 'no answer'})") from None
    try:
        # pure: two equal calls would be one
        executor = client.get_executor(pure=False)  # type: ignore[no-untyped-call]
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False)  # takes back what has not run
            raise
        executor.shutdown()
    finally:
        client.close()  # type: ignore[no-untyped-call]


def run(
    pieces: Mapping[str, Piece],
    work: Callable[[Shared, Piece], Result],
    shared: Shared,
    *,
    workers: Workers = None,
    what: str = "",
    unit: str = "piece",
    progress: bool = True,
) -> dict[str, Result | Failure]:
    """What :func:`finished` gives, all of it, in the order of `pieces`."""
    done = dict(finished(pieces, work, shared, workers=workers, what=what, unit=unit, progress=progress))
    return {name: done[name] for name in pieces}


def finished(
    pieces: Mapping[str, Piece],
    work: Callable[[Shared, Piece], Result],
    shared: Shared,
    *,
    workers: Workers = None,
    what: str = "",
    unit: str = "piece",
    progress: bool = True,
) -> Iterator[tuple[str, Result | Failure]]:
    """Name and work(shared, piece) of every piece, as they come, each exactly once.

    An exception is a Failure in place of the result, so that one broken piece does not lose the others. A piece that
    dies with its process is tried once more, then it is a Failure too. `work` and `shared` must be importable or
    picklable where an executor is of other processes. what, unit : of the progress bar.
    """
    bar = tqdm(total=len(pieces), desc=what or None, unit=unit, disable=None if progress else True)
    with opened(workers) as executor, bar:
        if executor is None:
            some: Iterator[tuple[str, Result | Failure]] = ((n, _piece(shared, work, x)) for n, x in pieces.items())
        else:
            some = _elsewhere(executor, pieces, work, shared, _sent(executor, shared))
        for name, result in some:
            bar.update()
            yield name, result


class Rounds(Generic[Shared]):
    """Rounds of pieces that share one thing, which travels once to each process and not with every round.

    This process takes its share of the pieces beside spawned ones, which begin at the other end of a round.
    """

    def __init__(self, executor: Executor | None, shared: Shared) -> None:
        self._executor, self._shared = executor, shared
        self._there = None if executor is None else _sent(executor, shared)

    def results(self, pieces: Sequence[Piece], work: Callable[[Shared, Piece], Result]) -> Iterator[Result]:
        """work(shared, piece) of each piece, in their order; a single one stays in this process, and all of them do
        where there is no executor, shared out over its threads.

        What a piece raises here is raised, where there is no executor. Raises ExecutorError where one failed else.
        """
        if self._executor is None or len(pieces) < 2:
            yield from alongside(partial(work, self._shared), pieces)
            return
        numbered = dict(enumerate(pieces))
        if isinstance(self._executor, Processes):
            done = self._with_this_one(self._executor, numbered, work)
        else:
            done = dict(_elsewhere(self._executor, numbered, work, self._shared, self._there))
        for i in numbered:
            found = done[i]
            if isinstance(found, Failure):
                raise ExecutorError(f"a piece of the work failed ({found}); workers = 1 shows where")
            yield found

    def _with_this_one(
        self, executor: Processes, pieces: Mapping[int, Piece], work: Callable[[Shared, Piece], Result]
    ) -> dict[int, Result | Failure]:
        """Results of pieces, those that no process has begun taken by this one, the last first."""
        waiting = {i: executor.submit(_piece, self._there, work, piece) for i, piece in pieces.items()}
        done: dict[int, Result | Failure] = {}
        try:
            with _handing_on():
                for i in reversed(waiting):
                    if waiting[i].cancel():
                        done[i] = _piece(self._shared, work, pieces[i])
            return {i: done[i] if i in done else _result(future) for i, future in waiting.items()}
        finally:  # whoever asked has gone: do not start the others
            for future in waiting.values():
                future.cancel()


@contextmanager
def _handing_on() -> Iterator[None]:
    """While this process works along, the threads that feed the others get their turn at once: each would wait for
    five milliseconds several times a piece."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def _elsewhere(
    executor: Executor,
    pieces: Mapping[Name, Piece],
    work: Callable[[Shared, Piece], Result],
    shared: Shared,
    there: object,
) -> Iterator[tuple[Name, Result | Failure]]:
    """Name and result of every piece as they come; `there` stands for `shared` in the calls."""
    waiting = {executor.submit(_piece, there, work, piece): name for name, piece in pieces.items()}
    again: dict[Future[Result | Failure], Name] = {}
    try:
        for future in as_completed(waiting):
            name = waiting[future]
            if future.cancelled() and there is not shared:  # what was sent ahead died with the process that had it
                again[executor.submit(_piece, shared, work, pieces[name])] = name
                continue
            yield name, _result(future)
        for future in as_completed(again):
            yield again[future], _result(future)
    finally:  # whoever asked has gone: do not start the others
        for future in (*waiting, *again):
            future.cancel()


def _result(future: Future[Result | Failure]) -> Result | Failure:
    try:
        return future.result()
    except BrokenExecutor:
        why = 'killed, out of memory, or started by a script without `if __name__ == "__main__":`'
        return Failure("died", f"its process died twice ({why})")
    except Exception as error:  # of the transport: a piece's own exceptions come as Failures
        return Failure(type(error).__name__, str(error))


def _piece(shared: object, work: Callable[[Shared, Piece], Result], piece: Piece) -> Result | Failure:
    """One piece, on one thread, where it runs; its exception as a Failure, for some exceptions cannot travel."""
    value = cast("Shared", _here[shared.key] if isinstance(shared, _Sent) else shared)
    with serial():
        try:
            return work(value, piece)
        except Exception as error:
            if stopped.is_set():  # a library that is interrupted fails in its own way
                raise KeyboardInterrupt from error
            return Failure(type(error).__name__, str(error), traceback.format_exc())


def _sent(executor: Executor, shared: object) -> object:
    """What stands for `shared` in a call: the thing itself, or a ticket for what every process is given once."""
    if isinstance(executor, Processes):
        return executor.send(shared)
    client = getattr(executor, "_client", None)  # Dask's executor has no public way back to its client
    return shared if client is None else client.scatter(shared, broadcast=True, hash=False)


# ---- spawned processes


@dataclass(frozen=True)
class _Sent:
    key: int


#: what this process was sent ahead of its pieces; the latest only, and only ever in a spawned process
_here: dict[int, object] = {}


def _receive(key: int, packed: bytes) -> None:
    _here.clear()
    _here[key] = ForkingPickler.loads(packed)


def _unpacked(packed: bytes) -> object:
    fn, args, kwargs = ForkingPickler.loads(packed)
    return fn(*args, **kwargs)


def _begin(alive: Connection, needs: Sequence[str]) -> None:
    """In a new process: leave Ctrl-C to the parent, end with it however it ends, and import what is needed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        try:
            alive.recv_bytes()  # nothing is ever sent: it returns when the parent has closed its end or has died
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    for name in needs:
        importlib.import_module(name)


def _ready() -> None:
    """Nothing: whoever can call it has imported the package."""


def _packed(value: object) -> bytes | Exception:
    """As it travels to a process of ours, packed as the pool would, or why it cannot, which whoever waits learns."""
    try:
        return bytes(ForkingPickler.dumps(value))
    except Exception as error:
        return error


def _travels(packed: bytes | Exception) -> bytes:
    if isinstance(packed, Exception):
        raise packed
    return packed


class _Slot(threading.local):
    """One spawned process, and what was sent to it; each thread of `Processes` has its own."""

    pool: ProcessPoolExecutor | None = None
    key: int | None = None


class Processes(ThreadPoolExecutor):
    """`count` spawned processes; one that dies takes only its own piece with it, which is tried once more.

    Each is a process pool of one that a thread of its own feeds. Spawned, not forked: compiled parallel code in this
    process would kill forked ones. What travels is packed by whoever sends it, before this process goes on: a thread of
    a pool would pack objects that are being worked on here.
    """

    def __init__(self, count: int, needs: Sequence[str] = (), at_once: bool = True) -> None:
        super().__init__(count, thread_name_prefix="processes")
        self._needs = tuple(needs)
        self._context = multiprocessing.get_context("spawn")
        self._read, self._write = self._context.Pipe(duplex=False)
        self._slot = _Slot()
        self._pools: list[ProcessPoolExecutor] = []
        self._values: list[bytes | Exception] = []
        for _ in range(count if at_once else 0):  # they import what they need while this process prepares their pieces
            self.submit(_ready)

    def send(self, value: object) -> _Sent:
        """A ticket that stands for `value` in calls; the value goes to each process once."""
        self._values.append(_packed(value))
        return _Sent(len(self._values) - 1)

    def submit(self, fn: Callable[..., Result], /, *args: object, **kwargs: object) -> Future[Result]:
        tickets = [a for a in args if isinstance(a, _Sent)]
        future = super().submit(self._in_process, _packed((fn, args, kwargs)), tickets)
        return cast("Future[Result]", future)  # what the other process sends back

    def _in_process(self, packed: bytes | Exception, tickets: Sequence[_Sent]) -> object:
        try:
            return self._try(packed, tickets)
        except BrokenExecutor:
            if self._write.closed:
                raise
            return self._try(packed, tickets)

    def _try(self, packed: bytes | Exception, tickets: Sequence[_Sent]) -> object:
        slot = self._slot
        if slot.pool is None:
            slot.pool = ProcessPoolExecutor(1, self._context, initializer=_begin, initargs=(self._read, self._needs))
            slot.key = None
            self._pools.append(slot.pool)
        try:
            for sent in (t for t in tickets if t.key != slot.key):
                slot.pool.submit(_receive, sent.key, _travels(self._values[sent.key])).result()
                slot.key = sent.key
            return slot.pool.submit(_unpacked, _travels(packed)).result()
        except BrokenExecutor:
            slot.pool = None
            raise

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        super().shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            self._write.close()  # nothing is left to do: the processes need not tidy up, which takes half a second
        for pool in self._pools:
            pool.shutdown(wait)
        self._write.close()
        self._read.close()

    def __exit__(self, kind: type[BaseException] | None, *others: object) -> None:
        if kind is not None:
            self._write.close()  # ends every process at once: pieces keep what they need to go on in files
        self.shutdown(cancel_futures=kind is not None)
