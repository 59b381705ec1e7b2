"""How many small errors in the package its tests notice: a sample of mutants of one folder, and the share caught.

    python analyses/mutation_score.py models --mutants 30 --seed 1 --out runs/mutants_models.json

A mutant is the package with one operator, comparison, number or condition changed. It runs in a copy of the repository
against the tests that run its line, those of the file of its own name first, then those that run some line of its file,
the quickest first, up to the first that fails or to `--seconds` of tests (the rest might catch more). What takes ten
times as long as the unchanged code and two minutes more is caught too (an endless loop). Which tests run a line, and
how long they take, is found by one run of each file of tests, which is kept in `--kept` until the folder or that file
changes; tests that do not pass then (time budgets on a busy machine) are left out and named. Code that Numba compiles,
whose lines nobody counts, and what runs on import are tried against all tests, with a cache less what was compiled from
that code. Texts, types, decorators, messages and seeds are not changed. Survivors are printed with their line, so that
a test can be written for each.
"""

from __future__ import annotations

import argparse
import ast
import copy
import hashlib
import json
import multiprocessing
import os
import re
import shutil
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from xml.etree import ElementTree

import arviz  # noqa: F401  with numba and pytest what takes longest to import, once for all mutants
import numba
import numpy as np
import pytest
from coverage import CoverageData
from scipy.stats import beta

Lines = dict[Path, dict[int, set[str]]]
ROOT = Path(__file__).resolve().parents[1]
#: tests of a folder's own, and those of other folders that run its kernels or hold its priors; others would catch
#: more, and take longer
TESTS = {
    "models": ["tests/models", "tests/effects/test_series_elements.py", "tests/effects/test_effects.py"],
    "effects": ["tests/effects", "tests/virtual_rig/test_faults_against_effects.py"],
    "inference": ["tests/inference", "tests/models/test_simulator.py"],
    "diagnosis": ["tests/diagnosis"],
}
OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or,
    ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change: file, line, what stood there and what stands there now; `status` once it was tried."""

    file: str
    line: int
    before: str
    after: str
    status: str = ""
    seconds: float = 0.0


def changeable(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes that a mutant may change: no docstrings, annotations, decorators, messages, representations, seeds."""
    stack: list[ast.AST] = [tree]
    while stack:
        node = stack.pop()
        if isinstance(node, (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)):
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            if node.name in ("__repr__", "_repr_html_"):
                continue
            stack += node.body + node.args.defaults
            continue
        if isinstance(node, ast.ClassDef):
            stack += node.body
            continue
        if isinstance(node, ast.AnnAssign):
            stack += [node.value] if node.value is not None else []
            continue
        if isinstance(node, ast.BinOp) and any(isinstance(x, ast.JoinedStr) for x in (node.left, node.right)):
            continue
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
            continue
        yield node
        stack += list(ast.iter_child_nodes(node))


def mutate(node: ast.AST) -> bool:
    """Change a node in place; False if there is nothing to change in it."""
    if isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp)):
        kind = OPERATORS.get(type(node.op))
        if kind is None or (isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr)):
            return False
        node.op = kind()  # type: ignore[assignment]
        return True
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        kind = OPERATORS.get(type(node.ops[0]))
        if kind is not None:
            node.ops = [kind()]  # type: ignore[list-item]
        return kind is not None
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        node.op = ast.UAdd()  # "+x" of a condition is as true as x, so that "not" is gone
        return True
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
        node.value = node.value + 1 if isinstance(node.value, int) else node.value * 1.5 + 0.1
        return True
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        node.value = not node.value
        return True
    return False


def mutants_of(path: Path) -> list[tuple[Mutant, int]]:
    """Every mutant of a file, with the number of the node that it changes."""
    out = []
    for k, node in enumerate(changeable(ast.parse(path.read_text(encoding="utf-8")))):
        before, line = ast.unparse(node), getattr(node, "lineno", 0)
        changed = copy.deepcopy(node)
        if line and mutate(changed):
            out.append((Mutant(str(path), line, before, ast.unparse(changed)), k))
    return out


def statement_lines(text: str, line: int) -> range:
    """Lines of the statement that a line is in, without its body: what runs is counted at any one of them."""
    found = range(line, line + 1)
    for x in ast.walk(ast.parse(text)):  # from the outermost inwards
        if isinstance(x, ast.stmt):
            body = getattr(x, "body", None)
            lines = range(x.lineno, body[0].lineno if body else (x.end_lineno or x.lineno) + 1)
            found = lines if line in lines else found
    return found


def runs_compiled(text: str, line: int, imported: bool) -> bool:
    """Is a line in a function that Numba compiles, or in a file that has some and among what runs on import?"""
    tree = ast.parse(text)
    made = [x for x in tree.body if isinstance(x, ast.Assign) and "jit(" in ast.unparse(x.value)]
    names = {ast.unparse(target) for x in made for target in x.targets}
    functions = [x for x in ast.walk(tree) if isinstance(x, ast.FunctionDef)]
    compiled = [f for f in functions if any("jit" in d or d in names for d in map(ast.unparse, f.decorator_list))]
    return any(imported or f.lineno <= line <= (f.end_lineno or 0) for f in compiled)


def _text(text: str, k: int) -> str:
    """The file's text with its k-th changeable node changed."""
    tree = ast.parse(text)
    mutate(next(x for i, x in enumerate(changeable(tree)) if i == k))
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n"


def run_tests(copied: Path, numba_cache: Path, tests: list[str], limit_s: float, *options: str) -> tuple[bool, float]:
    """Do the tests pass in a copy of the repository within so many seconds? In a process split off from this one, which
    has imported the libraries."""
    started = time.perf_counter()
    command = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *options, *tests]
    process = multiprocessing.get_context("fork").Process(target=_pytest, args=(copied, numba_cache, command))
    process.start()
    process.join(limit_s)
    if process.is_alive() and process.pid:
        os.killpg(process.pid, signal.SIGKILL)
        process.join()
    return process.exitcode == 0, time.perf_counter() - started


def _pytest(copied: Path, numba_cache: Path, command: list[str]) -> None:
    os.setpgrp()  # what it starts ends with it
    os.chdir(copied)
    sys.path[:] = [str(copied), *(p for p in sys.path if Path(p).resolve() != ROOT)]
    os.environ |= {"NUMBA_CACHE_DIR": str(numba_cache), "PYTHONPATH": str(copied)}
    numba.config.reload_config()
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    os._exit(pytest.main(command))


def digest(files: Iterable[Path]) -> str:
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(files))).hexdigest()[:12]


def what_runs_what(home: Path, numba_cache: Path, folder: str, file: Path) -> tuple[Lines, dict[str, float]]:
    """By file and line the tests of a file that run it, "" where it is imported, and the seconds of each test, by its
    place as pytest names it; from the run that is kept on disk, or a new one."""
    lines: Lines = {}
    took: dict[str, float] = {}
    asked = [*(home / "copy/bayes_iwan" / folder).rglob("*.py"), *(home / "copy/tests").rglob("conftest.py"), file]
    kept = home / f"{folder}-{file.stem}-{digest(asked)}"
    coverage, report = kept.with_suffix(".coverage"), kept.with_suffix(".xml")
    if not report.exists():
        os.environ["COVERAGE_FILE"] = str(coverage)
        which = (f"--cov=bayes_iwan/{folder}", "--cov-context=test", "--cov-report=", f"--junitxml={report}")
        print(f"{file.name} on the unchanged code", file=sys.stderr)
        run_tests(home / "copy", numba_cache, [str(file), "--maxfail=1000"], 7200.0, *which)
    for case in ElementTree.parse(report).iter("testcase"):
        place = f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}"
        if {"failure", "error", "skipped"} & {x.tag for x in case}:
            print(f"left out, since it does not pass on the unchanged code: {place}", file=sys.stderr)
        else:
            took[place] = float(case.attrib["time"])
    data = CoverageData(str(coverage))
    data.read()
    for f in data.measured_files():
        for n, contexts in data.contexts_by_lineno(f).items():
            lines.setdefault(Path(f), {}).setdefault(n, set()).update(c.partition("|")[0] for c in contexts)
    return lines, took


def cache_without(numba_cache: Path, copied: Path, path: Path) -> Path:
    """A copy of Numba's cache less what was compiled from a file and from those that import it, by however many
    others: Numba does not see changes of functions that another file calls."""
    imports = {f: f.read_text(encoding="utf-8") for f in (copied / "bayes_iwan").rglob("*.py")}
    stale, new = {path}, {path}
    while new:
        words = re.compile("|".join(rf"\b{f.parent.name if f.stem == '__init__' else f.stem}\b" for f in new))
        lines = {f: re.findall(r"^\s*(?:from|import) .*(?:\([^)]*\))?", text, re.M) for f, text in imports.items()}
        new = {f for f, found in lines.items() if f not in stale and words.search(" ".join(found))}
        stale |= new
    cache = numba_cache.with_name("numba of a mutant")
    left = {(f.parent.name, f.stem) for f in stale}
    shutil.copytree(numba_cache, cache, ignore=lambda folder, files: [
        x for x in files if (Path(folder).name.rpartition("_")[0], x.partition(".")[0]) in left
    ])  # fmt: skip
    return cache


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", choices=sorted(TESTS))
    parser.add_argument("--mutants", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tests", nargs="+", help="files or folders of tests in the place of the folder's own")
    parser.add_argument("--files", nargs="+", help="mutate these files of the folder only (parts of their paths)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests that a mutant is tried against")
    parser.add_argument("--minutes", type=float, default=60.0, help="start no further mutant after so many")
    parser.add_argument("--kept", type=Path, default=ROOT / "runs/mutants", help="where what the tests run is kept")
    parser.add_argument("--out", type=Path, help="JSON with every mutant and what became of it")
    args = parser.parse_args()
    home = args.kept.resolve()
    copied, numba_cache = home / "copy", home / f"numba-{digest((ROOT / 'bayes_iwan').rglob('*.py'))}"
    shutil.rmtree(copied, ignore_errors=True)
    for name in ("bayes_iwan", "tests", "analyses", "data", "pyproject.toml"):
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, copied / name)
    files = sorted((copied / "bayes_iwan" / args.folder).rglob("*.py"))
    files = [f for f in files if not args.files or any(part in str(f) for part in args.files)]
    found = [(f, m, k) for f in files for m, k in mutants_of(f)]
    chosen = np.random.default_rng(args.seed).choice(len(found), min(args.mutants, len(found)), replace=False)
    every = [copied / x for x in args.tests or TESTS[args.folder]]
    every = [f for x in every for f in (sorted(x.glob("test_*.py")) if x.is_dir() else [x])]
    ran: Lines = {}
    took: dict[str, float] = {}
    for file in every:
        lines, times = what_runs_what(home, numba_cache, args.folder, file)
        took |= times
        for path, by_line in lines.items():
            for n, tests in by_line.items():
                ran.setdefault(path, {}).setdefault(n, set()).update(tests)
    done: list[Mutant] = []
    until = time.monotonic() + 60.0 * args.minutes
    for i in chosen:
        if time.monotonic() > until:
            break
        path, mutant, k = found[int(i)]
        where = path.relative_to(copied)
        text = path.read_text(encoding="utf-8")
        these = set().union(*(ran.get(path, {}).get(n, ()) for n in statement_lines(text, mutant.line)))
        compiled = runs_compiled(text, mutant.line, imported="" in these)
        run = set(took) if compiled or "" in these else these & took.keys()
        near = set().union(*ran.get(path, {}).values())
        some = sorted(run, key=lambda t: (f"/test_{path.stem}.py::" not in t, t not in near, took[t]))
        some = some[: np.searchsorted(np.cumsum([took[t] for t in some]), args.seconds) + 1]
        passed, seconds = True, 0.0
        if some:
            unchanged = path.stat()
            path.write_text(_text(text, k), encoding="utf-8")
            cache = cache_without(numba_cache, copied, path) if compiled else numba_cache
            passed, seconds = run_tests(copied, cache, some, 10.0 * sum(took[t] for t in some) + 120.0)
            shutil.rmtree(numba_cache.with_name("numba of a mutant"), ignore_errors=True)
            path.write_text(text, encoding="utf-8")
            os.utime(path, ns=(unchanged.st_atime_ns, unchanged.st_mtime_ns))  # Numba's cache goes by it
        done.append(
            Mutant(str(where), mutant.line, mutant.before, mutant.after, "lives" if passed else "caught", seconds)
        )
        print(
            f"{done[-1].status:6s} {seconds:5.0f} s  {where}:{mutant.line}  {mutant.before}  ->  {mutant.after}",
            flush=True,
        )
        if args.out:
            args.out.parent.mkdir(parents=True, exist_ok=True)
            args.out.write_text(json.dumps([asdict(m) for m in done], indent=1), encoding="utf-8")
    caught = sum(m.status == "caught" for m in done)
    low, high = beta.ppf([0.05, 0.95], [caught + 0.5], [len(done) - caught + 0.5])  # Jeffreys' interval
    share = f"{100 * caught / max(len(done), 1):.0f} % (90 % interval {100 * low:.0f} to {100 * high:.0f})"
    print(f"{args.folder}: {caught} of {len(done)} mutants caught, {share}; {len(found)} are possible")


if __name__ == "__main__":
    main()
