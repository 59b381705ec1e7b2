"""Answering withheld cases: each in a process of its own, which the kernel keeps from the truths where it can."""

import hashlib
import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

from bayes_iwan.errors import nearest
from bayes_iwan.executors import Failure, Workers, finished
from bayes_iwan.files import clear, write_json
from bayes_iwan.withheld import confinement
from bayes_iwan.withheld.sealed import WithheldError, case_names, commitments, read_json, truth_folder

#: compiled code of the answering processes while they are at work, since the package's own folder is closed to them
_CACHE = ".numba_cache"

Diagnose = Callable[[Path, Path, int, bool], object]


@dataclass(frozen=True)
class _Task:
    """What all cases share: the diagnosis by name, folders, settings."""

    module: str
    function: str
    directory: Path
    out: Path
    seed: int
    quick: bool


def read_diagnosis(folder: Path) -> dict[str, object]:
    """A finished `diagnosis.json`. Raises `WithheldError` if it lacks a verdict or probabilities."""
    diagnosis = read_json(folder / "diagnosis.json")
    if not isinstance(diagnosis, dict) or not {"verdict", "probabilities"} <= set(diagnosis):
        raise WithheldError(f"{folder / 'diagnosis.json'}: no verdict and probabilities in it")
    return diagnosis


def refuse_open_truth(directory: Path) -> None:
    """Raise `WithheldError` if a truth lies within the folder that is to be answered."""
    for path in sorted(directory.rglob("*.json")):
        if path.name.startswith("truth") or '"salt"' in path.read_text(errors="replace"):
            raise WithheldError(f"{path} holds a truth; move it out of {directory} before answering")


def case_seed(seed: int, name: str) -> int:
    """The seed with which a case is diagnosed: the same whatever else is answered beside it."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:4], "big")


def answer(
    directory: Path | str,
    diagnose: Diagnose,
    *,
    out: Path | str | None = None,
    seed: int = 0,
    quick: bool = False,
    workers: Workers = None,
    only: Sequence[str] | None = None,
) -> Path:
    """Diagnose every case of a withheld folder; go on where an earlier run stopped.

    Parameters: `diagnose(campaign, out, seed, quick)`, a function of a module, writes `out/diagnosis.json`. `out`, by
    default `directory/answers`. `workers` answer cases side by side. `only`, some case names.

    Each case gets a seed of its own that depends on `seed` and its name alone, and a process of its own. Where the
    machine has Landlock, that process reads Python, its libraries and this one campaign, and writes to this case's
    folder: the truths, the other cases and everything else are closed to it and to what it starts (see `confinement`
    for what this does not cover). `answers.json` says whether it was so.

    Returns the path of `answers.json`: {"schema", "cases" (a hash of their commitments), "seed", "quick", "confined",
    "answers": {case: diagnosis}, "failed": {case: message}}. Raises `WithheldError` for a truth inside the folder, for
    unknown names, or when earlier answers are of other cases or were made with other settings.
    """
    directory = Path(directory)
    out = Path(out) if out is not None else directory / "answers"
    refuse_open_truth(directory)
    names = case_names(directory)
    unknown = sorted(set(only or ()) - set(names))
    if unknown:
        raise WithheldError(f"{directory}: no case {unknown[0]!r}{nearest(unknown[0], names)}")
    target = out / "answers.json"
    cases = hashlib.sha256(json.dumps(commitments(directory), sort_keys=True).encode()).hexdigest()
    settings = {"schema": 2, "cases": cases, "seed": seed, "quick": quick, "confined": confinement.available()}
    answers: dict[str, object] = {}
    if target.exists():
        earlier = read_json(target)
        if earlier.get("cases") != cases:
            raise WithheldError(f"{target} answers other cases than those sealed in {directory}; choose another --out")
        if {k: earlier.get(k) for k in settings} != settings:
            raise WithheldError(
                f"{target} was made with seed {earlier.get('seed')}, quick {earlier.get('quick')}, confined "
                f"{earlier.get('confined')}; use the same settings to go on, or another --out"
            )
        answers = dict(earlier["answers"])
    failed: dict[str, str] = {}

    def save() -> None:
        write_json(target, {**settings, "answers": answers, "failed": failed})

    out.mkdir(parents=True, exist_ok=True)
    save()
    todo = {n: n for n in only or names if n not in answers}
    task = _Task(_module_of(diagnose), diagnose.__qualname__, directory.resolve(), out.resolve(), seed, quick)
    for name, result in finished(todo, _answer_one, task, workers=workers, what="answering", unit="case"):
        if isinstance(result, Failure):
            failed[name] = str(result)
        else:
            answers[name] = result
        save()
    shutil.rmtree(out / _CACHE, ignore_errors=True)
    return target


def _module_of(diagnose: Diagnose) -> str:
    """The module by which another process can import a diagnosis; a script's own name where it is in the script."""
    if diagnose.__module__ != "__main__":
        return diagnose.__module__
    return Path(str(sys.modules["__main__"].__file__)).stem


def _answer_one(task: _Task, name: str) -> dict[str, object]:
    """Start a process for one case, wait for it, read what it wrote."""
    folder = task.out / name
    folder.mkdir(parents=True, exist_ok=True)
    clear(folder, "diagnosis.json", "diagnosis.html", "fits.json")  # of an answer that was begun and not counted
    scratch = Path(tempfile.mkdtemp(prefix="bayes_iwan_"))
    cache = task.out / _CACHE
    cache.mkdir(exist_ok=True)
    places = {"campaign": task.directory / name, "out": folder, "scratch": scratch, "cache": cache}
    order = {"module": task.module, "function": task.function, "quick": task.quick}
    order |= {"seed": case_seed(task.seed, name), "closed": [str(truth_folder(task.directory))]}
    order |= {place: str(path) for place, path in places.items()}
    modules = {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    ones = ("PYTHONDONTWRITEBYTECODE", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    own = dict.fromkeys(("TMPDIR", "HOME", "MPLCONFIGDIR"), str(scratch)) | dict.fromkeys(ones, "1")
    environment = os.environ | modules | own
    try:
        done = subprocess.run(
            [sys.executable, "-m", "bayes_iwan.withheld.answering"],
            input=json.dumps(order), text=True, capture_output=True, env=environment, cwd=scratch, check=False,
        )  # fmt: skip
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1]
        raise WithheldError(f"{name}: {last}")
    return read_diagnosis(folder)


def _in_own_process() -> None:
    """Read an order, close everything that it does not need, diagnose."""
    confinement.end_with_parent()
    order = json.loads(sys.stdin.read())
    if confinement.available():
        read = [*confinement.program_folders(), Path(order["campaign"])]
        write = [Path(order[k]) for k in ("out", "scratch", "cache")]
        write += [p for p in (Path("/dev/null"), Path("/dev/shm")) if p.exists()]
        confinement.confine(read, write, [Path(p) for p in order["closed"]])
    diagnose: Diagnose = attrgetter(order["function"])(importlib.import_module(order["module"]))
    diagnose(Path(order["campaign"]), Path(order["out"]), order["seed"], order["quick"])


if __name__ == "__main__":
    _in_own_process()
