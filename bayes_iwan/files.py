"""Files that are whole at every moment, in folders that belong to one run at a time."""

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: no lock there, and two runs in one folder are the user's affair
    fcntl = None  # type: ignore[assignment]

#: temporary files' names start so: what a killed run leaves behind is known by it and swept up by the next
_PART = ".part."
_LOCK = ".lock"
RECORD = "run.json"  # in a folder of results: which campaign each command's results are of
#: what a finished command leaves, by which results of older versions are known as well
FINISHED = {
    "identify": "posterior.nc", "diagnose": "diagnosis.json", "compare": "compare.html", "batch": "batch.html"
}  # fmt: skip


def seen_from(folder: str | os.PathLike[str], path: str | os.PathLike[str]) -> str:
    """A path as files in a folder name it, so that both can be moved together and nothing is said of the machine: as
    seen from the folder; from another drive its name alone."""
    try:
        return Path(os.path.relpath(Path(path).resolve(), Path(folder).resolve())).as_posix()
    except ValueError:
        return Path(path).name


class OutputError(InputError):
    """A folder that results cannot be written to; the message says why."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that takes its place when the block ends well, and is removed when not."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f"{_PART}{path.stem}.", suffix=path.suffix)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o644)
        with open(name, "rb") as written:
            os.fsync(written.fileno())  # a machine that fails must not find the new name on an empty file
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)


def write_whole(path: str | os.PathLike[str], content: bytes | str) -> Path:
    """Write a file (text as UTF-8) whole or not at all; its folder is made where there is none."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@contextmanager
def reading(path: Path, refused: type[InputError], again: str) -> Iterator[None]:
    """A block that makes something of a file that we wrote: one that is missing, or that somebody has changed, which
    breaks whatever is made of it in any way, is `refused` in one line that says what makes it `again`."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise refused(f"{path}: cannot be read ({error.strerror}); {again}") from None
    except Exception as error:
        said = " ".join(str(error).split())[:120]
        raise refused(f"{path}: damaged ({type(error).__name__}: {said}); {again}") from None


@contextmanager
def owned(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder for results, made if need be, that no other run may use meanwhile; leftovers of a killed one are swept.

    Raises OutputError before any work is done: it is a file, cannot be written to, or another run works in it.
    """
    folder = Path(folder)
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise OutputError(f"{folder}: there is a file of this name (or a part of it); name a folder") from None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made ({error.strerror})") from None
    lock = folder / _LOCK
    handle = _locked(lock)
    try:
        for left in folder.rglob(f"{_PART}*"):
            left.unlink(missing_ok=True)
        yield folder
    finally:
        with contextlib.suppress(OSError):  # gone with its folder
            lock.unlink(missing_ok=True)
            if made:  # refused before anything was written, or so the folder is not empty
                folder.rmdir()
        os.close(handle)


@contextmanager
def swapped(folder: str | os.PathLike[str], own: Callable[[str], bool]) -> Iterator[Path]:
    """A new folder to write to, which takes the place of `folder` when the block ends well and goes when not; what
    stands in `folder` under names that are not `own` is kept.

    A full disk leaves the former folder as it was, a kill that or, between two renames, none; the next use brings it
    back. Raises OutputError as :func:`owned`, and where the folder cannot be replaced: it is where the process is.
    """
    folder = Path(folder).absolute()
    if folder in (Path.cwd(), *Path.cwd().parents):
        raise OutputError(f"{folder}: is the folder you are in, which cannot be replaced; name one inside it")
    former = folder.with_name(f".former.{folder.name}")
    if former.exists() and not folder.exists():
        os.rename(former, folder)
    with owned(folder):
        for left in (former, *folder.parent.glob(f"{_PART}{folder.name}.*")):
            shutil.rmtree(left, ignore_errors=True)
        try:
            new = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f"{_PART}{folder.name}."))
        except OSError as error:
            raise OutputError(f"{folder.parent}: cannot be written to ({error.strerror}); name another") from None
        try:
            yield new
            for kept in folder.iterdir():
                if kept.name != _LOCK and not own(kept.name):
                    _linked(kept, new / kept.name)
            os.chmod(new, folder.stat().st_mode)
            try:
                os.rename(folder, former)
                os.rename(new, folder)
            except OSError as error:
                raise OutputError(f"{folder}: cannot be replaced ({error.strerror}); name a folder inside it") from None
            finally:
                if not folder.exists():
                    os.rename(former, folder)
            shutil.rmtree(former, ignore_errors=True)
        finally:
            shutil.rmtree(new, ignore_errors=True)


def _linked(old: Path, new: Path) -> None:
    """The same file, or folder of files, under another name."""
    if old.is_symlink():
        os.symlink(os.readlink(old), new)
    elif old.is_dir():
        shutil.copytree(old, new, symlinks=True, copy_function=os.link)
    else:
        os.link(old, new)


def refuse_campaign(folder: str | os.PathLike[str]) -> None:
    """Raise OutputError for a campaign's own folder where results are to be written: its files are records."""
    if (Path(folder) / "campaign.toml").exists():
        raise OutputError(f"{folder}: is a campaign's own folder, which takes no results; name another (--out DIR)")


@contextmanager
def results_folder(
    out: str | os.PathLike[str], command: str, source: str | os.PathLike[str] | None, *, overwrite: bool = False
) -> Iterator[Path]:
    """:func:`owned`, for what `command` finds of the campaign (or folder of campaigns) in `source`, which is noted.

    source : None where data came from no folder; such results are never known for one's own.
    Raises OutputError, before any work, where finished results of other data stand there and `overwrite` is False, and
    for a campaign's own folder.
    """
    refuse_campaign(out)
    folder = Path(out)
    finished = folder / FINISHED[command]
    if finished.exists() and not overwrite:
        noted = _noted(folder).get(command, {})
        there = (folder / noted["source"]).resolve() if "source" in noted else None
        own = source is not None and there == Path(source).resolve()
        own = own or (source is not None and (known := identity(source)) is not None and known == noted.get("identity"))
        if not own:
            of = there or "another campaign, or of a version that did not note which"
            raise OutputError(
                f"{folder}: holds finished results of {of}; name another folder, or write over them with --overwrite "
                "(in Python overwrite=True)"
            )
    clash = (x for x in FINISHED if "batch" in (x, command) and x != command and (folder / FINISHED[x]).exists())
    if not overwrite and (other := next(clash, None)):
        raise OutputError(f"{folder}: holds the results of {other}, beside which no others stand; name another")
    before = _written_at(finished)
    with owned(folder):
        try:
            yield folder
        finally:
            if _written_at(finished) != before and source is not None:
                note = {"source": seen_from(folder, source), "identity": identity(source)}
                write_json(folder / RECORD, {**_noted(folder), command: note})


def identity(source: str | os.PathLike[str]) -> str | None:
    """A digest of a campaign's files, or of those of a folder's campaigns, the same wherever it is moved; None for a
    folder of neither."""
    folder = Path(source)
    folder = folder.parent if folder.name == "campaign.toml" else folder
    places = [folder] if (folder / "campaign.toml").is_file() else [p.parent for p in folder.glob("*/campaign.toml")]
    digest = hashlib.sha256()
    for path in sorted(p for place in places for p in place.iterdir() if p.is_file()):
        if path.name.endswith((".toml", ".csv", ".csv.gz")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest() if places else None


def _written_at(path: Path) -> int | None:
    return path.stat().st_mtime_ns if path.exists() else None


def _noted(folder: Path) -> dict[str, dict[str, str]]:
    try:
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {k: v for k, v in found.items() if isinstance(v, dict)} if isinstance(found, dict) else {}


def _locked(lock: Path) -> int:
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o644)
        except OSError as error:
            raise OutputError(f"{lock.parent}: cannot be written to ({error.strerror})") from None
        if fcntl is not None:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                pid = os.read(handle, 32).decode(errors="replace").strip()
                os.close(handle)
                who = f"another run (process {pid})" if pid.isdigit() else "another run"
                raise OutputError(f"{lock.parent}: {who} is working in it; wait, or name another folder") from None
        try:
            same = os.path.samestat(os.stat(lock), os.fstat(handle))
        except FileNotFoundError:
            same = False
        if same:  # else its owner removed it between our opening and our locking it
            break
        os.close(handle)
    try:
        os.ftruncate(handle, 0)
        os.write(handle, f"{os.getpid()}\n".encode())
    except OSError as error:
        os.close(handle)
        raise OutputError(f"{lock.parent}: cannot be written to ({error.strerror})") from None
    return handle


def clear(folder: Path, *names: str) -> None:
    """Remove what an older run left under these names, files or folders, before a new one writes its own.

    So a kill between the first new file and the last leaves some that are missing, and never new beside old.
    """
    for name in names:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def finite(value: object) -> Any:
    """A value as JSON's types, a dataclass by its fields; numbers that are not finite become None."""
    if is_dataclass(value) and not isinstance(value, type):
        return finite(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, np.bool_):
        return bool(value)
    return value


def write_json(path: str | os.PathLike[str], value: object) -> Path:
    """Write JSON whole or not at all; numbers that are not finite become null."""
    return write_whole(path, json.dumps(finite(value), indent=1) + "\n")
