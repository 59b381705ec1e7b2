"""The withheld protocol: make cases and seal their truths, open the seals.

Three roles. `make` draws cases on the virtual rig and publishes, beside the data, a salted SHA-256 commitment to
each truth; the truths go into a folder apart. `answering.answer` runs a diagnosis over the cases, without the truth.
`scoring.score` checks the commitments before it compares.

Layout::

    DIR/commitments.json              {"rule": ..., "sealed": true, "entropy": "<sha256>", "cases": {"case_01": ...}}
    DIR/case_01/campaign.toml ...     what a diagnosis is given
    DIR-truth/truth.json              {"schema": 2, "entropy": ..., "cases": {"case_01": {...}, ...}}
    DIR-truth/sealed/case_01/...      tests of the same specimen that no diagnosis sees, to check its predictions

Everything random follows from 256 bits of the system's entropy, which are kept with the truths, committed to, and
published with them at opening: whoever has the campaigns cannot try seeds until one gives them. Development cases may
be drawn from a seed instead; their commitments say that they are not sealed.

A case's truth is an object: "schema", "case", "kind" (one of `rig.cases.KINDS`), "effects" (a list of {"name", "law",
"size", "visible_share", "share", "share_of_square", "parameters"}: size as RMS change of the force over RMS friction
force, the share of it that no other parameters of the specimen imitate, its share of the gap that all leave together,
units in the parameters' names), "true_gap_N" (RMS gap, N, that the base model leaves of the rig with each set of the
faults, by names joined with "+"), "true_share" (of the gap, what is gone with each fault out of the rig, the others
there), "specimen", "setup", "noise", "friction_rms_N", "design", "seed" (of the case's run), "data" and "sealed_data"
(SHA-256 of each file of its campaign and of its sealed tests, so that none can be changed
after the other) and "salt".
"""

import hashlib
import json
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan import former_names
from bayes_iwan.campaign import write_campaign
from bayes_iwan.errors import InputError
from bayes_iwan.executors import Failure, Workers, finished
from bayes_iwan.files import write_json

_PLAIN_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*")
RULE = "sha256 of the case's truth as JSON with sorted keys, salt inside"


class WithheldError(InputError):
    """The protocol cannot go on: a seal is broken, a truth lies open, files are missing. The message says which."""


# ---- writing and sealing


def read_json(path: Path) -> Any:
    """Read a JSON file; raise `WithheldError` naming it if it is missing or broken."""
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise WithheldError(f"{path}: no such file") from None
    except (OSError, ValueError, RecursionError) as error:
        raise WithheldError(f"{path}: not readable as JSON ({error})") from None


def commitment(truth: Mapping[str, object]) -> str:
    """SHA-256 (hex) of a truth as JSON with sorted keys. Raises `WithheldError` if it has no salt."""
    if not truth.get("salt"):
        raise WithheldError("a truth without a salt cannot be sealed: its commitment could be guessed")
    return hashlib.sha256(json.dumps(truth, sort_keys=True).encode()).hexdigest()


def matches(truth: Mapping[str, object], sealed: str) -> bool:
    """Whether `sealed` is a commitment to this truth, in any of the usual spellings of JSON with sorted keys."""
    spaced = ((None, None), (None, (",", ":")), (1, None), (2, None))
    texts = (
        json.dumps(truth, sort_keys=True, indent=indent, separators=separators, ensure_ascii=ascii_)
        for indent, separators in spaced
        for ascii_ in (True, False)
    )
    return any(hashlib.sha256(text.encode()).hexdigest() == sealed for text in texts)


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


@dataclass(frozen=True)
class _Draws:
    """What all cases of a set share: where randomness comes from, where files go, which laws are drawn."""

    entropy: str
    out: Path
    sealed: Path
    laws: str
    excluded_laws: tuple[str, ...]
    excluded_outside: tuple[str, ...]


def _make_one(draws: _Draws, piece: tuple[str, str | None]) -> dict[str, object]:
    # together they take a second, which the process of each answer can do without
    from bayes_iwan.virtual_rig import cases as rig_cases
    from bayes_iwan.withheld.true_gaps import by_name, removed, true_gaps_N

    name, kind = piece
    bits = hashlib.sha256(f"{draws.entropy}/{name}".encode()).digest()
    case = rig_cases.draw_case(
        np.random.default_rng(int.from_bytes(bits, "big")), kind, laws=draws.laws,
        excluded_laws=draws.excluded_laws, excluded_outside=draws.excluded_outside,
    )  # fmt: skip
    given, kept = rig_cases.simulate(case)
    for folder, tests in ((draws.out, given), (draws.sealed, kept)):
        write_campaign(
            folder / name, name=name, description="a rope spring on the virtual rig, one withheld case",
            tests=tests, source="bayes_iwan withheld",
        )  # fmt: skip
    gap_N = true_gaps_N(case, 0)
    shares = {n: removed(gap_N, {n})[n] for n in max(gap_N, key=len, default=())}
    gap = {"true_gap_N": by_name(gap_N), "true_share": shares}
    hashes = {"data": file_hashes(draws.out / name), "sealed_data": file_hashes(draws.sealed / name)}
    return {**case.truth(name), **gap, **hashes, "salt": secrets.token_hex(32)}


def make(
    n: int,
    out: Path | str,
    *,
    seed: int | None = None,
    kinds: Sequence[str] | None = None,
    laws: str = "all",
    excluded_laws: Sequence[str] = (),
    excluded_outside: Sequence[str] = (),
    workers: Workers = None,
) -> Path:
    """Draw `n` cases, write their campaigns to `out` and seal their truths beside it.

    Parameters: `seed`, for development cases alone: it makes them again, and they are marked as not sealed; without it
    everything follows from 256 bits of the system's entropy. `kinds`, one a case, in place of the random mix; `laws`,
    `excluded_laws` and `excluded_outside` as in `rig.cases.draw_case`. `workers` make cases side by side. Returns
    the path of the truth file. Raises `WithheldError` if either folder exists already.
    """
    out = Path(out)
    apart = truth_folder(out)
    if n < 1:
        raise WithheldError(f"{n} cases asked for; ask for at least one")
    if kinds is not None and len(kinds) != n:
        raise WithheldError(f"{len(kinds)} kinds given for {n} cases")
    for folder in (out, apart):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise WithheldError(f"{folder} exists and is not empty; choose another name or remove it")
    names = [f"case_{i + 1:0{max(2, len(str(n)))}d}" for i in range(n)]
    pieces = {name: (name, kinds[i] if kinds is not None else None) for i, name in enumerate(names)}
    entropy = secrets.token_hex(32) if seed is None else f"seed {seed}"
    draws = _Draws(entropy, out, apart / "sealed", laws, tuple(excluded_laws), tuple(excluded_outside))
    truths: dict[str, dict[str, object]] = {}
    for name, truth in finished(pieces, _make_one, draws, workers=workers, what="making cases", unit="case"):
        if isinstance(truth, Failure):
            raise WithheldError(f"{name} could not be made: {truth}")
        truths[name] = truth
    source = {"entropy": entropy} if seed is None else {"seed": seed}
    write_json(apart / "truth.json", {"schema": 2, **source, "cases": truths})
    public = {"rule": RULE, "sealed": seed is None, "cases": {k: commitment(truths[k]) for k in names}}
    public |= {"entropy": hashlib.sha256(entropy.encode()).hexdigest()} if seed is None else {}
    write_json(out / "commitments.json", public)
    return apart / "truth.json"


def commitments(directory: Path) -> dict[str, str]:
    """The sealed commitment of each case of a withheld folder. Raises `WithheldError` where there are none.

    A case's name is that of a folder in it, and no way out of it.
    """
    path = directory / "commitments.json"
    sealed = read_json(path)
    cases = sealed.get("cases") if isinstance(sealed, dict) else None
    if not isinstance(cases, dict) or not cases or not all(isinstance(c, str) for c in cases.values()):
        raise WithheldError(f"{path}: no cases in it")
    if strange := [n for n in cases if not _PLAIN_NAME.fullmatch(n)]:
        raise WithheldError(f"{path}: {strange[0][:60]!r} is no name of a case (letters, digits, -, _ and . inside)")
    return cases


def case_names(directory: Path) -> list[str]:
    """The cases of a withheld folder, from its commitments."""
    cases = commitments(directory)
    if missing := [n for n in cases if not (directory / n / "campaign.toml").is_file()]:
        raise WithheldError(f"{directory}: no campaign for {', '.join(missing)}")
    return sorted(cases)


# ---- opening the seals


def read_truths(path: Path | str) -> dict[str, dict[str, object]]:
    """The truths in a truth file: {"cases": {name: truth}}, {name: truth}, or a list of truths."""
    content = read_json(Path(path))
    if isinstance(content, dict) and isinstance(content.get("cases"), dict | list):
        content = content["cases"]
    if isinstance(content, list):
        content = {t.get("case"): t for t in content if isinstance(t, dict)}
    if not isinstance(content, dict) or not all(isinstance(t, dict) for t in content.values()) or not content:
        raise WithheldError(f"{path}: no truths in it")
    return content


def check_seals(directory: Path | str, truths: Mapping[str, Mapping[str, object]]) -> None:
    """Check every truth against its commitment, and every campaign against its truth, before anything is scored.

    Raises `WithheldError` that names the cases whose truth or data is not what was sealed.
    """
    directory = Path(directory)
    sealed = commitments(directory)
    missing, strange = sorted(set(sealed) - set(truths)), sorted(set(truths) - set(sealed))
    if missing or strange:
        raise WithheldError(
            f"truths and commitments are not of the same cases: {', '.join(missing + strange)} in one of them only"
        )
    broken = [n for n in sorted(sealed) if not matches(truths[n], sealed[n])]
    if broken:
        raise WithheldError(f"the truth is not the one that was sealed: {', '.join(broken)}")
    case_names(directory)
    changed = [n for n in sorted(sealed) if "data" in truths[n] and file_hashes(directory / n) != truths[n]["data"]]
    if changed:
        raise WithheldError(f"the campaign was changed after it was sealed: {', '.join(changed)}")


def sealed_tests(truth_file: Path, name: str) -> Path:
    """The folder of a case's sealed tests beside its truth file, which sets of before call otherwise."""
    found = [truth_file.parent / folder / name for folder in ("sealed", *former_names.TRUTH)]
    return next((x for x in found if x.is_dir()), found[0])


def check_sealed(name: str, folder: Path, truth: Mapping[str, object]) -> None:
    """Raise `WithheldError` if the sealed tests of a case are not those that were sealed with its truth."""
    hashes = next((truth[k] for k in ("sealed_data", *former_names.TRUTH) if k in truth), None)
    if hashes is not None and file_hashes(folder) != hashes:
        raise WithheldError(f"the sealed tests were changed after they were sealed: {name}")
