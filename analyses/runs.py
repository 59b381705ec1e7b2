"""Many independent runs, each kept as JSON in a file of its own, so that an interrupted study goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from bayes_iwan import executors
from bayes_iwan.files import write_whole

#: file, function, and the function's arguments; it returns what JSON can hold
Job = tuple[Any, ...]


def kept(file: Path, work: Callable[..., Any], *args: Any) -> Any:
    """The result of work(*args), from the file where an earlier run left it."""
    if file.is_file():
        return json.loads(file.read_text())
    result = json.dumps(work(*args))
    write_whole(file, result)
    return json.loads(result)  # as it will be read again: the same types either way


def _one(_: None, job: Job) -> Any:
    return kept(*job)


def each(jobs: Sequence[Job], workers: int, what: str = "runs") -> Iterator[Any]:
    """Results of kept(*job), in order, from this process or from several of them; the first that fails ends it."""
    pieces = {str(job[0]): job for job in jobs}
    waiting = iter(pieces)
    done: dict[str, Any] = {}
    first = next(waiting, None)
    for name, result in executors.finished(pieces, _one, None, workers=workers, what=what, unit="run"):
        if isinstance(result, executors.Failure):
            raise RuntimeError(f"{name}: {result}\n{result.trace}")
        done[name] = result
        while first in done:
            yield done.pop(first)
            first = next(waiting, None)
