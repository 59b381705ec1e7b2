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
_MAGIC = b"bayes_iwan checkpoint 3\n"
_NOT_OURS = "not what a run of this version has written"
_HEAD = 40  # bytes before a record's arrays: its length and its checksum


class CheckpointError(InputError):
    """A checkpoint that cannot be read, or that belongs to another run."""


@dataclass(frozen=True)
class Snapshot:
    """What a checkpoint holds: names of what is sampled, the run's state, and the draws up to it (stored, walkers,
    ndim) with their log_prob (stored, walkers)."""

    names: tuple[str, ...]
    state: Mapping[str, NDArray[Any]]
    draws: Array
    log_prob: Array


class Checkpoint:
    """An open checkpoint file: each `commit` adds draws and the state that belongs to them."""

    def __init__(self, file: BinaryIO, digest: bytes, state: Mapping[str, NDArray[Any]]) -> None:
        self._file, self._digest, self._state = file, digest, dict(state)

    @classmethod
    def create(
        cls,
        path: Path,
        fingerprint: Mapping[str, str],
        names: tuple[str, ...],
        walkers: int,
        state: Mapping[str, NDArray[Any]],
    ) -> Checkpoint:
        """A new file at `path`, put there whole with its first state, open for appending."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        header = {"fingerprint": dict(fingerprint), "names": list(names), "walkers": walkers}
        record, digest = _record({"header": np.array(json.dumps(header))}, b"")
        first, digest = _record(_changes(state, {}), digest)
        with replacing(path) as temporary:
            temporary.write_bytes(_MAGIC + record + first)
        return cls(open(path, "ab"), digest, state)

    @classmethod
    def resume(cls, path: Path, fingerprint: Mapping[str, str], names: tuple[str, ...]) -> tuple[Checkpoint, Snapshot]:
        """The last state in `path`, and the file open for going on from it.

        Raises CheckpointError if the file is no checkpoint, holds no state yet, or belongs to another run; the
        message names which part of the fingerprint differs.
        """
        journal = _read(path)
        stored, found = journal.fingerprint, journal.snapshot
        differ = [key for key in sorted({*stored, *fingerprint}) if stored.get(key) != fingerprint.get(key)]
        if differ:
            what = "; ".join(f"{k} was {_short(stored.get(k))}, is {_short(fingerprint.get(k))}" for k in differ)
            raise CheckpointError(
                f"{path}: this checkpoint is of another run ({what}). Give back what it was started with, "
                "or delete the file (or name another one) to start anew"
            )
        if found.names != names:
            raise CheckpointError(f"{path}: this checkpoint samples {', '.join(found.names)}, not {', '.join(names)}")
        file = open(path, "r+b")
        file.truncate(journal.whole)
        file.seek(journal.whole)
        return cls(file, journal.digest, found.state), found

    def commit(self, draws: Array, log_prob: Array, state: Mapping[str, NDArray[Any]]) -> None:
        """Store draws (stored, walkers, ndim), their log_prob (stored, walkers), and the state that belongs to all
        draws so far."""
        arrays = {"draws": np.asarray(draws, float), "log_prob": np.asarray(log_prob, float)}
        record, self._digest = _record(_changes(state, self._state) | arrays, self._digest)
        self._file.write(record)
        self._file.flush()
        self._state = dict(state)

    def close(self) -> None:
        self._file.close()


def read_checkpoint(path: Path) -> Snapshot:
    """The last state of a checkpoint and all draws; the file is not changed, and may be one being written."""
    return _read(path).snapshot


@dataclass(frozen=True)
class _Journal:
    """What the whole records of a file say, folded together: `whole` bytes of it, `digest` the last one's checksum."""

    fingerprint: dict[str, str]
    snapshot: Snapshot
    whole: int
    digest: bytes


def _read(path: Path) -> _Journal:
    if not Path(path).is_file():
        raise CheckpointError(f"{path}: there is no such file")
    state: dict[str, NDArray[Any]] = {}
    draws, log_prob = [], []
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
            kinds = {"fingerprint": dict, "names": list, "walkers": int}
            if not all(isinstance(header[k], kind) for k, kind in kinds.items()):
                raise CheckpointError(f"{path}: {_NOT_OURS} (its header); delete it to start anew")
            names = tuple(header["names"])
            for arrays, checksum, end in records:
                digest, whole = checksum, end
                draws += [arrays["draws"]] if "draws" in arrays else []
                log_prob += [arrays["log_prob"]] if "log_prob" in arrays else []
                known = state | {k[6:]: v for k, v in arrays.items() if k.startswith("state/")}
                state = {k: known[k] for k in json.loads(str(arrays["keys"]))}
        if not state:
            raise CheckpointError(f"{path}: damaged at its start; delete it to start anew")
        every = np.concatenate([np.empty((0, header["walkers"], len(names))), *draws])
        every_log_prob = np.concatenate([np.empty((0, header["walkers"])), *log_prob])
        if len(every) != len(every_log_prob):
            raise CheckpointError(f"{path}: {_NOT_OURS} (draws without their log_prob); delete it to start anew")
    except CheckpointError:
        raise
    except Exception as error:  # a file whose checksums somebody made anew can hold whatever breaks numpy's readers
        raise not_ours(path, error) from None
    return _Journal(header["fingerprint"], Snapshot(names, state, every, every_log_prob), whole, digest)


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
