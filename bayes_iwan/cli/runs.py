"""The folder that a command's results go to: named if the user does not, guarded, and with a log of what was run."""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import platform
import time
from collections.abc import Sequence
from pathlib import Path

from bayes_iwan import __version__
from bayes_iwan.cli.command import quoted
from bayes_iwan.files import OutputError, write_json

RECORD = "run.json"  # in the folder: which campaign each command's results are of
LOG_FILE = "log.txt"
#: what a finished command leaves, by which results of older versions are known as well
FINISHED = {
    "identify": "posterior.nc", "diagnose": "diagnosis.json", "compare": "compare.html", "batch": "batch.html"
}  # fmt: skip
RECORDINGS = (
    ".csv",
    ".txt",
    ".dat",
    ".tdms",
    ".uff",
    ".unv",
    ".mat",
    ".lvm",
    ".xlsx",
    ".wav",
    ".parquet",
    ".asc",
    ".gz",
)


def refuse_recordings(path: str) -> None:
    """Raise OutputError, with the command to run, for recordings given where a campaign is wanted."""
    here = Path(path)
    if here.name == "campaign.toml" or (here / "campaign.toml").is_file():
        return
    inside = here.is_dir() and any(p.suffix.lower() in RECORDINGS for p in here.iterdir() if p.is_file())
    if here.is_file() or inside:
        what = "a folder of recordings" if inside else "a recording"
        raise OutputError(
            f"{path}: {what}, no campaign yet. Make one: "
            + quoted(["bayes-iwan", "import", path, "--out", f"{here.resolve().with_suffix('').name}-campaign"])
        )


def results_folder(args: argparse.Namespace, command: str, source: str) -> Path:
    """The folder for a command's results on a campaign or a folder of them; args.out is set to it where it is not.

    Raises OutputError where it holds finished results of another campaign and --overwrite is not given.
    """
    if args.out is None:
        args.out = f"{Path(source).resolve().name}-{command}"
    folder = Path(args.out)
    written = _record(folder).get(command)
    finished = (folder / FINISHED[command]).exists()
    own = written is not None and (identity(source) or "") == written.get("identity")
    own = own or (written is not None and written.get("source") == str(Path(source).resolve()))
    # to go on from a checkpoint, which knows its campaign, is no overwriting
    if finished and not own and not args.overwrite and not getattr(args, "resume", False):
        of = written["source"] if written else "another campaign, or of a version that did not note which"
        raise OutputError(
            f"{folder}: holds finished results of {of}; name another folder with --out, or write over them with "
            "--overwrite"
        )
    return folder


def note_run(folder: Path, command: str, source: str) -> None:
    """Note in the folder whose results it holds, if it was made."""
    if folder.is_dir():
        record = _record(folder)
        record[command] = {
            "source": str(Path(source).resolve()),
            "identity": identity(source) or "",
            "version": __version__,
        }
        write_json(folder / RECORD, record)


def identity(source: str) -> str | None:
    """A digest of a campaign's files, the same wherever it is moved; None for a folder without campaign.toml."""
    folder = Path(source)
    folder = folder.parent if folder.name == "campaign.toml" else folder
    if not (folder / "campaign.toml").is_file():
        return None
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.iterdir() if p.is_file() and p.name.endswith((".toml", ".csv", ".csv.gz"))):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _record(folder: Path) -> dict[str, dict[str, str]]:
    try:
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {k: v for k, v in found.items() if isinstance(v, dict)} if isinstance(found, dict) else {}


class RunLog(logging.Handler):
    """Lines of the log, in the results' folder from the moment that there is one."""

    def __init__(self, arguments: Sequence[str]) -> None:
        super().__init__(logging.INFO)
        self.folder: Path | None = None
        self.lines: list[str] = []
        self.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        self.lines.append(f"{time.strftime('%Y-%m-%d %H:%M:%S')} $ {quoted(['bayes-iwan', *arguments])}")
        self.lines.append(f"bayes-iwan {__version__}, Python {platform.python_version()}, {platform.platform()}")

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line, and write all that are kept where the folder is there."""
        self.lines.append(self.format(record))
        self.write()

    def write(self) -> None:
        """Append what is kept to the folder's log; without a folder it waits."""
        if self.folder is not None and self.folder.is_dir() and self.lines:
            try:
                with (self.folder / LOG_FILE).open("a", encoding="utf-8") as file:
                    file.write("\n".join(self.lines) + "\n")
            except OSError:  # a full disk is said by what writes the results
                return
            self.lines = []
