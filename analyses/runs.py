"""Many independent runs, here or in processes, each kept in a file so that an interrupted study goes on."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any

from bayes_iwan.files import write_whole

#: file, function, and the function's arguments
Job = tuple[Any, ...]


def kept(file: Path, work: Callable[..., Any], *args: Any) -> Any:
    """The result of work(*args), from the file where an earlier run left it."""
    if file.is_file():
        return pickle.loads(file.read_bytes())
    result = work(*args)
    write_whole(file, pickle.dumps(result))
    return result


@contextlib.contextmanager
def pool(workers: int) -> Iterator[Executor | None]:
    """Processes to share work, or None where this one does it alone."""
    if workers == 1:
        yield None
        return
    # spawned, not forked: compiled parallel code in this process would kill forked workers
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as executor:
        yield executor


def each(jobs: Sequence[Job], workers: int) -> Iterator[Any]:
    """Results of kept(*job), in order, from this process or from several of them."""
    with pool(workers) as executor:
        if executor is None:
            yield from (kept(*job) for job in jobs)
            return
        yield from (f.result() for f in [executor.submit(kept, *job) for job in jobs])
