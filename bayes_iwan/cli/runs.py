"""Recordings given in the place of a campaign, and the log of what was run in the folder of its results."""

import argparse
import logging
import os
import platform
import re
import time
from collections.abc import Sequence
from pathlib import Path

from bayes_iwan import __version__
from bayes_iwan.cli.command import quoted
from bayes_iwan.files import RECORD, OutputError, seen_from

#: arguments that are paths
PATHS = ("campaign", "folder", "directory", "files", "out", "recipe", "config", "simulator", "effects", "answers")
LOG_FILE = "log.txt"


def refuse_other_shells(args: argparse.Namespace) -> None:
    """Raise OutputError for what another system's shell would take otherwise: marks that continue a line, paths of
    Windows elsewhere, a quote that a backslash before it kept."""
    for value in (getattr(args, name, None) or () for name in PATHS):
        for path in [value] if isinstance(value, str) else value:
            if path in ("^", "`", "\\"):
                raise OutputError(f'"{path}" continues a line in another shell; write the command on one line')
            drive = re.match(r"[A-Za-z]:[\\/]", path)
            if Path(path).exists() or not (drive or "\\" in path or '"' in path):
                continue
            if '"' in path:
                raise OutputError(f"{path}: a backslash before a closing quote keeps the quote; leave it out")
            if os.name != "nt":
                here = "name its folder on this machine" if drive else f'write "{path.replace(chr(92), "/")}"'
                raise OutputError(f"{path}: a path of Windows, which this system does not have; {here}")


def refuse_recordings(path: str) -> None:
    """Raise OutputError, with the command to run, for recordings or results given where a campaign is wanted."""
    here = Path(path)
    if here.name == "campaign.toml" or (here / "campaign.toml").is_file():
        return
    if (here / RECORD).is_file():
        raise OutputError(
            f"{path}: the results of a run, no campaign; {RECORD} in it names the campaign. These commands take "
            "results: bayes-iwan report, bayes-iwan export"
        )
    from bayes_iwan.campaign.folders.contents import recordings_in

    if any(p.is_file() for p in recordings_in(path)):
        what = "a folder of recordings" if here.is_dir() else "recordings"
        raise OutputError(f"{path}: {what}, no campaign yet. Make one: {quoted(['bayes-iwan', 'import', path])}")


class RunLog(logging.Handler):
    """Lines of the log, in the results' folder from the moment that there is one; it goes with the folder, and so names
    what lies elsewhere as seen from there."""

    def __init__(self, arguments: Sequence[str]) -> None:
        super().__init__(logging.INFO)
        self.folder: Path | None = None
        self.paths = [word for word in arguments if os.path.isabs(word)]
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
            text = "\n".join(self.lines) + "\n"
            for path in sorted(self.paths, key=len, reverse=True):
                text = text.replace(path, seen_from(self.folder, path))
            try:
                with (self.folder / LOG_FILE).open("a", encoding="utf-8") as file:
                    file.write(text)
            except OSError:  # a full disk is said by what writes the results
                return
            self.lines = []
