"""Checkpoints of a sampling run: a journal that only grows, readable after a kill at any moment.

The file is a line that says what it is and then records, one a commit: length, SHA-256, and arrays as numpy stores
them (no pickle). A record holds the draws since the one before and what has changed of the run's state; its checksum
covers the record before as well, so that none can be lost or changed unnoticed. Whatever follows the last whole record
(a kill in the middle of a write, a full disk, a damaged byte) is omitted, and a run that goes on from the records
before draws the very same again: a run follows from its state, bit for bit.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.files import replacing

#: the checkpoint's name in a folder of results
NAME = "chains.ckpt"
_MAGIC = b"bayes_iwan checkpoint 2\n"
_NOT_OURS = "not what a run of this version has written"
_HEAD = 40  # bytes before a record's arrays: its length and its checksum


class CheckpointError(InputError):
    """A checkpoint that cannot be read, or that belongs to another run."""


@dataclass(frozen=True)
class Snapshot:
    """What a checkpoint holds: the run's state and the draws of each stage up to it, (stored, walkers, ...).

    damaged : bytes after the last whole record, which are omitted.
    """

    state: Mapping[str, NDArray[Any]]
    draws: Mapping[str, Array]
    log_prob: Mapping[str, Array]
    damaged: int = 0


class Checkpoint:
    """An open checkpoint file: `append` draws of a stage, then `commit` the state that belongs to them."""

    def __init__(self, file: BinaryIO, digest: bytes, state: Mapping[str, NDArray[Any]]) -> None:
        self._file, self._digest, self._state = file, digest, dict(state)
        self._appended: dict[str, list[Array]] = {}

    @classmethod
    def create(
        cls,
        path: Path,
        fingerprint: Mapping[str, str],
        names: tuple[str, ...],
        walkers: Mapping[str, int],
        state: Mapping[str, NDArray[Any]],
    ) -> Checkpoint:
        """A new file at `path`, put there whole with its first state, open for appending.

        walkers : how many walkers each stage has.
        """
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        header = {"fingerprint": dict(fingerprint), "names": list(names), "walkers": dict(walkers)}
        record, digest = _record({"header": np.array(json.dumps(header))}, b"")
        first, digest = _record(_changes(state, {}), digest)
        with replacing(path) as temporary:
            temporary.write_bytes(_MAGIC + record + first)
        return cls(open(path, "ab"), digest, state)

    @classmethod
    def resume(
        cls, path: Path, fingerprint: Mapping[str, str], names: tuple[str, ...], stages: tuple[str, ...]
    ) -> tuple[Checkpoint, Snapshot]:
        """The last state in `path`, and the file open for going on from it.

        Raises CheckpointError if the file is no checkpoint, holds no state yet, or belongs to another run; the
        message names which part of the fingerprint differs.
        """
        journal = _read(path)
        stored = journal.header["fingerprint"]
        differ = [key for key in sorted({*stored, *fingerprint}) if stored.get(key) != fingerprint.get(key)]
        if differ:
            what = "; ".join(f"{k} was {_short(stored.get(k))}, is {_short(fingerprint.get(k))}" for k in differ)
            raise CheckpointError(
                f"{path}: this checkpoint is of another run ({what}). Give back what it was started with, "
                "or delete the file (or name another one) to start anew"
            )
        if journal.header["names"] != list(names):
            raise CheckpointError(
                f"{path}: this checkpoint samples {', '.join(journal.header['names'])}, not {', '.join(names)}"
            )
        snapshot = journal.snapshot(stages)
        file = open(path, "r+b")
        file.truncate(journal.whole)
        file.seek(journal.whole)
        return cls(file, journal.digest, journal.state), snapshot

    def append(self, stage: str, draws: Array, log_prob: Array) -> None:
        """Add draws (stored, walkers, ndim) and their log_prob (stored, walkers) to a stage, with the next commit."""
        for kind, values in (("draws", draws), ("log_prob", log_prob)):
            self._appended.setdefault(f"{kind}/{stage}", []).append(np.asarray(values, dtype=float))

    def commit(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Store the state that belongs to all draws appended so far."""
        arrays = _changes(state, self._state) | {k: np.concatenate(v) for k, v in self._appended.items()}
        record, digest = _record(arrays, self._digest)
        self._file.write(record)
        self._file.flush()
        self._digest, self._state, self._appended = digest, dict(state), {}

    def close(self) -> None:
        self._file.close()


def read_checkpoint(path: Path, stages: tuple[str, ...]) -> tuple[dict[str, str], tuple[str, ...], Snapshot]:
    """Fingerprint, names and last state of a checkpoint; the file is not changed, and may be one being written."""
    journal = _read(path)
    return journal.header["fingerprint"], tuple(journal.header["names"]), journal.snapshot(stages)


@dataclass
class _Journal:
    """What the whole records of a file say, folded together; `whole` bytes of it, `damaged` behind them."""

    path: Path
    header: dict[str, Any]
    whole: int
    digest: bytes
    state: dict[str, NDArray[Any]]
    appended: dict[str, list[Array]]
    damaged: int = 0

    def snapshot(self, stages: tuple[str, ...]) -> Snapshot:
        """The last state and all draws. Raises CheckpointError where the records contradict each other."""
        if not self.state:
            raise CheckpointError(f"{self.path}: damaged at its start; delete it to start anew")
        n = len(self.header["names"])

        def together(kind: str, stage: str, *shape: int) -> Array:
            none = np.empty((0, self.header["walkers"][stage], *shape))
            return np.concatenate([none, *self.appended.get(f"{kind}/{stage}", [])])

        try:
            draws = {s: together("draws", s, n) for s in stages}
            log_prob = {s: together("log_prob", s) for s in stages}
        except (KeyError, ValueError, TypeError) as error:
            raise not_ours(self.path, error) from None
        if any(len(draws[s]) != len(log_prob[s]) for s in stages):
            raise CheckpointError(f"{self.path}: {_NOT_OURS} (draws without their log_prob); delete it to start anew")
        return Snapshot(self.state, draws, log_prob, self.damaged)


def _read(path: Path) -> _Journal:
    if not Path(path).is_file():
        raise CheckpointError(f"{path}: there is no such file")
    try:
        with open(path, "rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise CheckpointError(f"{path}: not a checkpoint of this version; delete it to start anew")
            records = _records(file)
            first = next(records, None)
            if first is None:
                raise CheckpointError(f"{path}: damaged at its start; delete it to start anew")
            arrays, digest, whole = first
            header = json.loads(str(arrays["header"]))
            if not all(
                isinstance(header[k], t) for k, t in (("fingerprint", dict), ("names", list), ("walkers", dict))
            ):
                raise CheckpointError(f"{path}: {_NOT_OURS} (its header); delete it to start anew")
            journal = _Journal(Path(path), header, whole, digest, {}, {})
            for arrays, journal.digest, journal.whole in records:
                for key in (k for k in arrays if k.startswith(("draws/", "log_prob/"))):
                    journal.appended.setdefault(key, []).append(arrays[key])
                state = journal.state | {k[6:]: v for k, v in arrays.items() if k.startswith("state/")}
                journal.state = {k: state[k] for k in json.loads(str(arrays["keys"]))}
            journal.damaged = os.fstat(file.fileno()).st_size - journal.whole
    except CheckpointError:
        raise
    except Exception as error:  # a file whose checksums somebody made anew can hold whatever breaks numpy's readers
        raise not_ours(path, error) from None
    return journal


def _records(file: BinaryIO) -> Iterator[tuple[dict[str, NDArray[Any]], bytes, int]]:
    """Arrays of each whole record, its checksum and where it ends; stops before the first that is not whole."""
    before, size = b"", os.fstat(file.fileno()).st_size
    while len(head := file.read(_HEAD)) == _HEAD:
        length = int.from_bytes(head[:8], "big")
        if length > size - file.tell():
            return
        body = file.read(length)
        if hashlib.sha256(before + head[:8] + body).digest() != head[8:]:
            return
        before = head[8:]
        with np.load(io.BytesIO(body), allow_pickle=False) as stored:
            yield {k: stored[k] for k in stored.files}, before, file.tell()


def _record(arrays: Mapping[str, NDArray[Any]], before: bytes) -> tuple[bytes, bytes]:
    """The bytes of a record, and its checksum, which covers that of the record before."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    body = buffer.getvalue()
    length = len(body).to_bytes(8, "big")
    digest = hashlib.sha256(before + length + body).digest()
    return length + digest + body, digest


def _changes(state: Mapping[str, NDArray[Any]], before: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """What a record says of a state: the names of all its arrays, and those that are not as they were."""
    changed = {f"state/{k}": v for k, v in state.items() if k not in before or not _same(before[k], v)}
    return {"keys": np.array(json.dumps(list(state)))} | changed


def _same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    a, b = np.asarray(a), np.asarray(b)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def not_ours(path: Path, error: Exception) -> CheckpointError:
    """What to raise of a checkpoint that an error says makes no sense."""
    line = " ".join(str(error).split())[:120] or type(error).__name__
    return CheckpointError(f"{path}: {_NOT_OURS} ({line}); delete it to start anew")


def _short(value: object) -> str:
    if value is None:
        return "absent"
    text = str(value)
    return text if len(text) <= 24 else text[:21] + "..."
