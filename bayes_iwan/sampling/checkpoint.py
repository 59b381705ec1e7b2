"""Checkpoints of a sampling run in one HDF5 file, readable after a kill at any moment.

The file is written in HDF5's single-writer mode (SWMR), which orders its own bookkeeping so that the file is whole
at every instant. On top of that the run's state is kept in two slots that are written in turn, each with a counter
and a checksum: a kill in the middle of writing one leaves the other. A state names how many draws belong to it;
what was appended after it is ignored.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.files import replacing

_FORMAT = 1
_SLOTS = ("state_a", "state_b")


class CheckpointError(ValueError):
    """A checkpoint that cannot be read, or that belongs to another run."""


@dataclass(frozen=True)
class Snapshot:
    """What a checkpoint holds: the run's state and the draws of each stage up to it, (stored, walkers, ...)."""

    state: Mapping[str, NDArray]
    draws: Mapping[str, Array]
    log_prob: Mapping[str, Array]


class Checkpoint:
    """An open checkpoint file: `append` draws of a stage, then `commit` the state that belongs to them."""

    def __init__(self, file: h5py.File, stages: tuple[str, ...], counter: int) -> None:
        self._file, self._stages, self._counter = file, stages, counter

    @classmethod
    def create(
        cls,
        path: Path,
        fingerprint: Mapping[str, str],
        names: tuple[str, ...],
        walkers: Mapping[str, int],
        snapshot: Snapshot | None = None,
    ) -> Checkpoint:
        """A new file at `path`, put there whole (temporary file and rename), open for appending.

        walkers : how many walkers each stage has.
        """
        stages = tuple(walkers)
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary, h5py.File(temporary, "w", libver="latest") as file:
            file.attrs["format"] = _FORMAT
            file.attrs["fingerprint"] = json.dumps(dict(fingerprint))
            file.attrs["names"] = json.dumps(list(names))
            for stage, n in walkers.items():
                for kind, shape in (("draws", (n, len(names))), ("log_prob", (n,))):
                    old = None if snapshot is None else getattr(snapshot, kind)[stage]
                    file.create_dataset(
                        f"{stage}_{kind}",
                        shape=(0 if old is None else len(old), *shape),
                        maxshape=(None, *shape),
                        chunks=(16, *shape),
                        dtype="f8",
                        data=old,
                    )
            for slot in _SLOTS:
                file.create_dataset(slot, shape=(0,), maxshape=(None,), chunks=(1 << 16,), dtype="u1")
            if snapshot is not None:
                _write_slot(file, 1, snapshot.state, {s: len(snapshot.draws[s]) for s in stages})
        file = h5py.File(path, "r+", libver="latest")
        file.swmr_mode = True
        return cls(file, stages, 1)

    @classmethod
    def resume(
        cls, path: Path, fingerprint: Mapping[str, str], names: tuple[str, ...], stages: tuple[str, ...]
    ) -> tuple[Checkpoint, Snapshot]:
        """The last state in `path`, and the file open for going on from it.

        Raises CheckpointError if the file is no checkpoint, holds no state yet, or belongs to another run; the
        message names which part of the fingerprint differs.
        """
        stored, stored_names, snapshot = read_checkpoint(path, stages)
        differ = [key for key in sorted({*stored, *fingerprint}) if stored.get(key) != fingerprint.get(key)]
        if differ:
            what = "; ".join(f"{k} was {_short(stored.get(k))}, is {_short(fingerprint.get(k))}" for k in differ)
            raise CheckpointError(
                f"{path}: this checkpoint is of another run ({what}). Give back what it was started with, "
                "or delete the file (or name another one) to start anew"
            )
        if stored_names != tuple(names):
            raise CheckpointError(f"{path}: this checkpoint samples {', '.join(stored_names)}, not {', '.join(names)}")
        walkers = {stage: snapshot.draws[stage].shape[1] for stage in stages}
        return cls.create(path, fingerprint, names, walkers, snapshot), snapshot

    def append(self, stage: str, draws: Array, log_prob: Array) -> None:
        """Add draws (stored, walkers, ndim) and their log_prob (stored, walkers) to a stage."""
        for kind, values in (("draws", draws), ("log_prob", log_prob)):
            data = self._file[f"{stage}_{kind}"]
            begin = len(data)
            data.resize(begin + len(values), axis=0)
            data[begin:] = values
            data.flush()

    def commit(self, state: Mapping[str, NDArray]) -> None:
        """Store the state that belongs to all draws appended so far."""
        self._counter += 1
        counts = {stage: len(self._file[f"{stage}_draws"]) for stage in self._stages}
        _write_slot(self._file, self._counter, state, counts)

    def close(self) -> None:
        self._file.close()


def read_checkpoint(path: Path, stages: tuple[str, ...]) -> tuple[dict[str, str], tuple[str, ...], Snapshot]:
    """Fingerprint, names and last state of a checkpoint; the file is not changed, and may be one being written."""
    try:
        with h5py.File(path, "r", libver="latest", swmr=True) as file:
            if file.attrs.get("format") != _FORMAT:
                raise CheckpointError(f"{path}: not a checkpoint of this version; delete it to start anew")
            fingerprint = json.loads(file.attrs["fingerprint"])
            names = tuple(json.loads(file.attrs["names"]))
            found = [slot for slot in (_read_slot(file[name]) for name in _SLOTS) if slot is not None]
            if not found:
                raise CheckpointError(f"{path}: holds no state yet; delete it to start anew")
            _, counts, state = max(found, key=lambda slot: slot[0])
            draws = {s: file[f"{s}_draws"][: counts[s]] for s in stages}
            log_prob = {s: file[f"{s}_log_prob"][: counts[s]] for s in stages}
    except (OSError, KeyError) as error:
        raise CheckpointError(f"{path}: cannot be read as a checkpoint ({error}); delete it to start anew") from None
    return fingerprint, names, Snapshot(state, draws, log_prob)


def _write_slot(file: h5py.File, counter: int, state: Mapping[str, NDArray], counts: Mapping[str, int]) -> None:
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {f"state_{k}": v for k, v in state.items()}
    np.savez(buffer, **arrays, counts=json.dumps(dict(counts)))
    body = counter.to_bytes(8, "big") + buffer.getvalue()
    record = np.frombuffer(hashlib.sha256(body).digest() + len(body).to_bytes(8, "big") + body, dtype="u1")
    slot = file[_SLOTS[counter % 2]]
    if len(slot) < len(record):  # it only ever grows: shrinking would free blocks that a reader may hold
        slot.resize(len(record), axis=0)
    slot[: len(record)] = record
    slot.flush()


def _read_slot(data: h5py.Dataset) -> tuple[int, dict[str, int], dict[str, NDArray]] | None:
    raw = data[:].tobytes()
    length = int.from_bytes(raw[32:40], "big")
    body = raw[40 : 40 + length]
    if len(raw) < 48 or len(body) < length or hashlib.sha256(body).digest() != raw[:32]:
        return None
    with np.load(io.BytesIO(body[8:]), allow_pickle=False) as stored:
        state = {k.removeprefix("state_"): stored[k] for k in stored.files if k.startswith("state_")}
        counts = json.loads(str(stored["counts"]))
    return int.from_bytes(body[:8], "big"), counts, state


def _short(value: str | None) -> str:
    if value is None:
        return "absent"
    return value if len(value) <= 24 else value[:21] + "..."
