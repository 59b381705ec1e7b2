"""The withheld protocol: make cases and seal their truths, have them answered, open the seals.

Three roles. `make` draws cases on the virtual rig and publishes, beside the data, a salted SHA-256 commitment to
each truth; the truths go into a folder apart. `answer` runs a diagnosis over the cases, without the truth.
`score.score` (in `gap.scoring`) checks the commitments before it compares.

Layout::

    DIR/commitments.json              {"rule": ..., "cases": {"case_01": "<sha256>", ...}}
    DIR/case_01/campaign.toml ...     what a diagnosis is given
    DIR-truth/truth.json              {"schema": 1, "seed": ..., "cases": {"case_01": {...}, ...}}
    DIR-truth/unseen/case_01/...      tests of the same specimen that no diagnosis sees, to check its predictions

A case's truth is an object: "schema", "case", "kind" (none, single, pair or outside), "effects" (a list of
{"name", "size", "visible_share", "parameters"}: size as RMS change of the force over RMS friction force, the share
of it that no other numbers of the specimen imitate, units in the parameters' names), "specimen", "setup", "noise",
"friction_rms_N", "design", "seed" (of the case's run), "data" (SHA-256 of each file of its campaign, so that
neither can be changed after the other) and "salt".
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan import executors
from bayes_iwan.campaign import write_campaign
from bayes_iwan.files import write_whole
from bayes_iwan.rig import cases as rig_cases

RULE = "sha256 of the case's truth as JSON with sorted keys, salt inside"
Diagnose = Callable[[Path, Path, int, bool], Any]


class WithheldError(ValueError):
    """The protocol cannot go on: a seal is broken, a truth lies open, files are missing. The message says which."""


# ---- writing and sealing


def write_json(path: Path, content: Any) -> None:
    """Write JSON so that a reader finds the old file or the new one, never half of either."""
    write_whole(path, json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file; raise `WithheldError` naming it if it is missing or broken."""
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise WithheldError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise WithheldError(f"{path}: not readable as JSON ({error})") from None


def commitment(truth: Mapping[str, Any]) -> str:
    """SHA-256 (hex) of a truth as JSON with sorted keys. Raises `WithheldError` if it has no salt."""
    if not truth.get("salt"):
        raise WithheldError("a truth without a salt cannot be sealed: its commitment could be guessed")
    return hashlib.sha256(json.dumps(truth, sort_keys=True).encode()).hexdigest()


def matches(truth: Mapping[str, Any], sealed: str) -> bool:
    """Whether `sealed` is a commitment to this truth, in any of the usual spellings of JSON with sorted keys."""
    spellings: tuple[dict[str, Any], ...] = (
        {},
        {"separators": (",", ":")},
        {"ensure_ascii": False},
        {"separators": (",", ":"), "ensure_ascii": False},
        {"indent": 1},
        {"indent": 2},
    )
    texts = (json.dumps(truth, sort_keys=True, **s).encode() for s in spellings)
    return any(hashlib.sha256(text).hexdigest() == sealed for text in texts)


def file_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of each file directly in a folder, by name."""
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.iterdir())
        if p.is_file() and not p.name.startswith(".")
    }


def truth_folder(directory: Path) -> Path:
    """Where `make` puts the truths of the cases in `directory`: a folder beside it."""
    return directory.resolve().with_name(directory.resolve().name + "-truth")


# ---- make


def _make_one(where: tuple[int, Path, Path], job: tuple[str, int, str | None]) -> dict[str, Any]:
    seed, out, unseen = where
    name, index, kind = job
    case = rig_cases.draw_case(np.random.default_rng([seed, index]), kind)
    given, kept = rig_cases.simulate(case)
    for folder, tests in ((out, given), (unseen, kept)):
        write_campaign(
            folder / name, name=name, description="a rope spring on the virtual rig, one withheld case",
            tests=tests, source="bayes_iwan withheld",
        )  # fmt: skip
    return {**case.truth(name), "data": file_hashes(out / name), "salt": secrets.token_hex(32)}


def make(
    n: int,
    seed: int,
    out: Path | str,
    *,
    kinds: Sequence[str] | None = None,
    executor: Executor | None = None,
) -> Path:
    """Draw `n` cases, write their campaigns to `out` and seal their truths beside it.

    Parameters: `seed` settles specimens, tests, effects and records (so keep it from whoever answers); the salts
    are fresh each time. `kinds`, one a case, in place of the random mix. `executor` runs cases side by side.
    Returns the path of the truth file. Raises `WithheldError` if either folder exists already.
    """
    out = Path(out)
    apart = truth_folder(out)
    if n < 1:
        raise WithheldError(f"{n} cases asked for; ask for at least one")
    if kinds is not None and len(kinds) != n:
        raise WithheldError(f"{len(kinds)} kinds given for {n} cases")
    for folder in (out, apart):
        if folder.exists() and any(folder.iterdir()):
            raise WithheldError(f"{folder} exists and is not empty; choose another name or remove it")
    names = [f"case_{i + 1:0{max(2, len(str(n)))}d}" for i in range(n)]
    jobs = {name: (name, i, kinds[i] if kinds is not None else None) for i, name in enumerate(names)}
    where = (seed, out, apart / "unseen")
    truths: dict[str, dict[str, Any]] = {}
    for name, truth in executors.run(
        jobs, _make_one, where, executor=executor, what="making cases", unit="case"
    ).items():
        if isinstance(truth, executors.Failure):
            raise WithheldError(f"{name} could not be made: {truth}")
        truths[name] = truth
    write_json(apart / "truth.json", {"schema": 1, "seed": seed, "cases": truths})
    write_json(out / "commitments.json", {"rule": RULE, "cases": {k: commitment(truths[k]) for k in names}})
    return apart / "truth.json"


# ---- answer

_forbidden: list[str] = []  # folders that this process must not read while it diagnoses
_hooked = False


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _forbidden or not isinstance(arguments[0], (str, bytes, os.PathLike)):
        return
    path = os.path.realpath(os.fsdecode(arguments[0]))
    name = os.path.basename(path)
    if (name.startswith("truth") and name.endswith(".json")) or any(
        path == f or path.startswith(f + os.sep) for f in _forbidden
    ):
        raise PermissionError(f"the truth of withheld cases is closed while they are answered: {path}")


def _answer_one(common: tuple[Diagnose, bool, str], job: tuple[Path, Path, int]) -> dict[str, Any]:
    """Diagnose one case with the truth closed to this process."""
    global _hooked
    diagnose, quick, forbidden = common
    campaign, out, seed = job
    if not _hooked:
        sys.addaudithook(_watch)
        _hooked = True
    _forbidden.append(forbidden)
    try:
        diagnose(campaign, out, seed, quick)
    finally:
        _forbidden.clear()
    return read_diagnosis(out)


def read_diagnosis(folder: Path) -> dict[str, Any]:
    """A finished `diagnosis.json`. Raises `WithheldError` if it lacks a verdict or probabilities."""
    diagnosis = read_json(folder / "diagnosis.json")
    if not isinstance(diagnosis, dict) or not {"verdict", "probabilities"} <= set(diagnosis):
        raise WithheldError(f"{folder / 'diagnosis.json'}: no verdict and probabilities in it")
    return diagnosis


def case_names(directory: Path) -> list[str]:
    """The cases of a withheld folder, from its commitments."""
    sealed = read_json(directory / "commitments.json")
    if not isinstance(sealed, dict) or not isinstance(sealed.get("cases"), dict) or not sealed["cases"]:
        raise WithheldError(f"{directory / 'commitments.json'}: no cases in it")
    missing = [n for n in sealed["cases"] if not (directory / n / "campaign.toml").is_file()]
    if missing:
        raise WithheldError(f"{directory}: no campaign for {', '.join(missing)}")
    return sorted(sealed["cases"])


def refuse_open_truth(directory: Path) -> None:
    """Raise `WithheldError` if a truth lies within the folder that is to be answered."""
    for path in sorted(directory.rglob("*.json")):
        if path.name.startswith("truth") or '"salt"' in path.read_text(errors="replace"):
            raise WithheldError(f"{path} holds a truth; move it out of {directory} before answering")


def answer(
    directory: Path | str,
    diagnose: Diagnose,
    *,
    out: Path | str | None = None,
    seed: int = 0,
    quick: bool = False,
    executor: Executor | None = None,
    only: Sequence[str] | None = None,
) -> Path:
    """Diagnose every case of a withheld folder; go on where an earlier run stopped.

    Parameters: `diagnose(campaign, out, seed, quick)` writes `out/diagnosis.json`; it must be importable by name
    when processes are used. `out`, by default `directory/answers`. `executor`, from `executors.opened`, answers
    cases side by side. `only`, some case names.

    Each case gets a seed of its own that depends on `seed` and its name alone. While it is diagnosed, files named
    `truth*.json` and everything in the folder of truths beside `directory` cannot be opened by that process.

    Returns the path of `answers.json`: {"schema", "seed", "quick", "answers": {case: diagnosis},
    "failed": {case: message}}. Raises `WithheldError` for a truth inside the folder, for unknown names, or when
    earlier answers were made with other settings.
    """
    directory = Path(directory)
    out = Path(out) if out is not None else directory / "answers"
    refuse_open_truth(directory)
    names = case_names(directory)
    unknown = sorted(set(only or ()) - set(names))
    if unknown:
        raise WithheldError(f"{directory}: no case {', '.join(unknown)}; there are {names[0]} to {names[-1]}")
    target = out / "answers.json"
    settings = {"schema": 1, "seed": seed, "quick": quick}
    answers: dict[str, Any] = {}
    if target.exists():
        earlier = read_json(target)
        if {k: earlier.get(k) for k in settings} != settings:
            raise WithheldError(
                f"{target} was made with seed {earlier.get('seed')}, quick {earlier.get('quick')}; use the same "
                "settings to go on, or another --out"
            )
        answers = dict(earlier["answers"])
    failed: dict[str, str] = {}

    def save() -> None:
        write_json(target, {**settings, "answers": answers, "failed": failed})

    save()
    todo = [n for n in only or names if n not in answers]
    forbidden = str(truth_folder(directory))
    jobs = {name: (directory / name, out / name, case_seed(seed, name)) for name in todo}
    common = (diagnose, quick, forbidden)
    for name, result in executors.finished(jobs, _answer_one, common, executor=executor, what="answering", unit="case"):
        if isinstance(result, executors.Failure):
            failed[name] = str(result)
        else:
            answers[name] = result
        save()
    return target


def case_seed(seed: int, name: str) -> int:
    """The seed with which a case is diagnosed: the same whatever else is answered beside it."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:4], "big")


# ---- opening the seals


def read_truths(path: Path | str) -> dict[str, dict[str, Any]]:
    """The truths in a truth file: {"cases": {name: truth}}, {name: truth}, or a list of truths."""
    content = read_json(Path(path))
    if isinstance(content, dict) and isinstance(content.get("cases"), dict | list):
        content = content["cases"]
    if isinstance(content, list):
        content = {t.get("case"): t for t in content if isinstance(t, dict)}
    if not isinstance(content, dict) or not all(isinstance(t, dict) for t in content.values()) or not content:
        raise WithheldError(f"{path}: no truths in it")
    return content


def check_seals(directory: Path | str, truths: Mapping[str, Mapping[str, Any]]) -> None:
    """Check every truth against its commitment, and every campaign against its truth, before anything is scored.

    Raises `WithheldError` that names the cases whose truth or data is not what was sealed.
    """
    directory = Path(directory)
    sealed = read_json(directory / "commitments.json")["cases"]
    missing, strange = sorted(set(sealed) - set(truths)), sorted(set(truths) - set(sealed))
    if missing or strange:
        raise WithheldError(
            f"truths and commitments are not of the same cases: {', '.join(missing + strange)} in one of them only"
        )
    broken = [n for n in sorted(sealed) if not matches(truths[n], sealed[n])]
    if broken:
        raise WithheldError(f"the truth is not the one that was sealed: {', '.join(broken)}")
    changed = [n for n in sorted(sealed) if "data" in truths[n] and file_hashes(directory / n) != truths[n]["data"]]
    if changed:
        raise WithheldError(f"the campaign was changed after it was sealed: {', '.join(changed)}")
