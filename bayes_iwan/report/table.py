"""A table as a page and a CSV file show it."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.files import write_whole

#: what a row holds
Cell = str | float | None
Rows = tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Table:
    """Rows of a table as text or numbers; `name` is the CSV file's, numbers keep full precision there and
    what is not a number is an empty cell."""

    name: str
    caption: str
    columns: tuple[str, ...]
    rows: Rows

    def csv(self) -> str:
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(
            [("" if np.isnan(x) else f"{x:.9g}") if isinstance(x, float) else x for x in row] for row in self.rows
        )
        return out.getvalue()

    def in_units(self, units: Units) -> Table:
        """The table with a campaign's own units in its columns' names and in its texts."""
        return replace(self, columns=units.everywhere(self.columns), rows=units.everywhere(self.rows))

    def write_csv(self, folder: str | os.PathLike[str]) -> Path:
        return write_whole(Path(folder) / f"{self.name}.csv", self.csv())
