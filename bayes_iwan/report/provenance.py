"""Where a page's numbers come from: when it was made, with which version and seed, from which files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from bayes_iwan import __version__
from bayes_iwan.campaign import Campaign


@dataclass(frozen=True)
class Provenance:
    """What stands below a page's title.

    date : when the page was written, local time; version : of the package; seed : of all random numbers, None where
    none were drawn. folder : name of the campaign's folder, without where it lies, for pages go to customers; files :
    of it that were read; source : as it states itself; counted : what the files are.
    """

    date: str
    version: str
    seed: int | None
    folder: str
    files: tuple[str, ...]
    source: str = ""
    counted: str = "file"

    def said(self) -> str:
        """One line."""
        seed = "" if self.seed is None else f", seed {self.seed}"
        files = f" ({len(self.files)} {self.counted}{'s' if len(self.files) != 1 else ''})" if self.files else ""
        return f"{self.date} · bayes-iwan {self.version}{seed} · from {self.folder}{files}"


def provenance(campaign: Campaign | None, seed: int | None = None) -> Provenance:
    """That of a page about one campaign; None for loops that came from no folder."""
    if campaign is None:
        return replace(of_folder(".", seed), folder="loops in memory")
    files = ("campaign.toml", *(test.file for test in campaign.tests))
    return of_folder(campaign.path, seed, files, campaign.source)


def of_folder(folder: str | Path, seed: int | None = None, files: Sequence[str] = (), source: str = "") -> Provenance:
    """That of a page about files in a folder."""
    date = f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"
    return Provenance(date, __version__, seed, Path(folder).absolute().name, tuple(files), source)
