"""Draws shared out over threads, a few at a time."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache, partial
from typing import TypeVar

import numba as nb
from threadpoolctl import ThreadpoolController

#: samples of all draws and loops that go through together: what lies between stages stays in the processor's cache
CHUNK = 1 << 16
#: fewer samples than this are not enough for a second thread
ALONE = 1 << 14


Piece = TypeVar("Piece")
Result = TypeVar("Result")


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Threads of this process: a forked child would find its parent's dead, so the process is part of the key."""
    return ThreadPoolExecutor(threads, thread_name_prefix="physics")


def over_draws(work: Callable[[slice], None], draws: int, samples: int) -> None:
    """Call work(part) for parts of range(draws) that make it up, `samples` being those of one draw.

    Uses as many threads as numba is set to (`numba.set_num_threads`, NUMBA_NUM_THREADS). numba's own prange is not
    used: it is slow to compile, breaks forked workers, and one of its layers aborts when two threads enter it.
    Raises what `work` raises.
    """
    threads = nb.get_num_threads() if draws * samples > ALONE else 1
    together = max(1, min(CHUNK // samples, -(-draws // threads)))
    parts = [slice(first, first + together) for first in range(0, draws, together)]
    if threads == 1 or len(parts) == 1:
        for part in parts:
            work(part)
    else:
        deque(_pool(threads, os.getpid()).map(work, parts), maxlen=0)


@cache
def _side_by_side(threads: int, process: int) -> ThreadPoolExecutor:
    """Threads whose own calls of :func:`over_draws` stay on one thread."""
    alone = partial(nb.set_num_threads, 1)
    return ThreadPoolExecutor(threads, thread_name_prefix="blocks", initializer=alone)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    return ThreadpoolController()


def linear_algebra() -> ThreadpoolController:
    """The libraries' own threads. To look for the libraries takes ten milliseconds, longer than much of the work, so
    they are looked for again only where modules have been imported since."""
    return _libraries(len(sys.modules))


def alongside(work: Callable[[Piece], Result], pieces: Sequence[Piece]) -> Iterator[Result]:
    """work(piece) of each piece in their order, on as many threads as numba is set to.

    Each works on one thread, and its linear algebra too, so results are the same to the bit however many there are.
    """
    threads = nb.get_num_threads()
    with linear_algebra().limit(limits=1):
        if threads > 1 and len(pieces) > 1:
            yield from _side_by_side(threads, os.getpid()).map(work, pieces)
        else:
            yield from map(work, pieces)
