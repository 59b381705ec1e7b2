"""Text files of numbers in any layout: separator, decimal mark, encoding, lines above the table, a row of units."""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.units import is_unit, split_name
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.table import read_bytes

SAMPLE = 65536  # bytes looked at from the start and from the end to find the layout
MISSING = ["-", "--", "---", "NaN", "nan", "NAN", "", "#N/A", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN", "null", "n/a"]
MISSING += ["inf", "-inf", "Inf", "-Inf", "INF", "1.#INF", "-1.#INF"]
SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", r"\s+": "blanks"}
MARKS = {  # digits are matched in one way only: a cell of 60,000 of them would take minutes otherwise
    ".": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+(,\d*)?|,\d+)([eE][+-]?\d+)?"),
}
DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}([ T]\d{1,2}:\d{2}.*)?|\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?")


@dataclass(frozen=True)
class Layout:
    """How a text file is written; what is None is found from the file.

    header_line : number of the line with the columns' names, counted from 1.
    """

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    header_line: int | None = None

    def __post_init__(self) -> None:
        if self.decimal not in (None, ".", ","):
            raise CampaignError(f"decimal must be . or , not {self.decimal!r}")
        if self.separator is not None and self.separator not in SEPARATORS and len(self.separator) != 1:
            raise CampaignError(f"separator must be one character or \\s+ for blanks, not {self.separator!r}")
        if self.header_line is not None and self.header_line < 1:
            raise CampaignError(f"header line must be 1 or more, not {self.header_line}")


def read_text(path: Path, file: str, layout: Layout) -> Recording:
    """The columns of a text file as channels. Raises CampaignError naming the line and the mend."""
    raw = read_bytes(path, file)
    encoding = layout.encoding or _encoding(file, raw)
    try:
        head = codecs.getincrementaldecoder(encoding)().decode(raw[:SAMPLE])
        tail = codecs.getincrementaldecoder(encoding)("replace").decode(raw[-(min(SAMPLE, len(raw)) // 2 * 2) :])
    except LookupError:
        raise CampaignError(f"{file}: encoding {encoding!r} is not known; utf-8, cp1252 and utf-16 are") from None
    except UnicodeError:
        raise CampaignError(f"{file}: not written in {encoding}; leave --encoding out, or name the right one") from None
    lines = head.splitlines()
    if len(raw) > SAMPLE and not head.endswith("\n"):
        lines = lines[:-1]
    separator, decimal, first = _layout(file, lines, tail.splitlines()[1:-1], layout)
    names, units = _header(lines, first, separator, layout)
    table, notes = _numbers(file, raw, encoding, separator, decimal, first)
    if len(names) < table.shape[1]:
        names += [f"column {k + 1}" for k in range(len(names), table.shape[1])]
    channels = []
    for k, column in enumerate(table):
        values = table[column]
        if not values.notna().any():
            continue
        name, unit = (names[k], units[k]) if k < len(units) and units[k] else split_name(names[k])
        channels.append(Channel(name or f"column {k + 1}", unit, _column(file, values, first, name)))
    how = f"{SEPARATORS.get(separator, separator)}, decimal {decimal}, {encoding}"
    return Recording(file, "", tuple(channels), (f"text: {how}, numbers from line {first + 1}", *notes))


def _encoding(file: str, raw: bytes) -> str:
    for mark, name in (
        (codecs.BOM_UTF8, "utf-8-sig"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if raw.startswith(mark):
            return name
    start = raw[:SAMPLE]
    if (zeros := start.count(0)) > 0.2 * len(start):
        odd = start[1::2].count(0)
        if zeros == max(odd, zeros - odd) and zeros < 0.6 * len(start):
            return "utf-16-le" if odd else "utf-16-be"
    if (k := raw.find(b"\0")) >= 0:
        line = raw.count(b"\n", 0, k) + 1
        cut = "the file was not written to its end; copy or export it again"
        what = cut if k and raw[:k].isascii() else "no text, and no TDMS, UFF, MATLAB or Parquet file"
        raise CampaignError(f"{file} line {line}: zero bytes: {what}")
    if raw.isascii():
        return "utf-8"
    try:
        raw.decode("utf-8")
        return "utf-8"
    except UnicodeDecodeError:
        if re.search(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f]", start):
            raise CampaignError(f"{file}: no text, and no TDMS, UFF, MATLAB or Parquet file") from None
        return "cp1252"


def _cells(line: str, separator: str) -> list[str]:
    cells = line.split() if separator == r"\s+" else line.split(separator)
    return [cell.strip().strip('"').strip() for cell in cells]


def _is_data(cells: Sequence[str], mark: re.Pattern[str]) -> bool:
    """Two numbers or more, beside gaps and no more remarks and times of day than numbers."""
    numbers = sum(bool(mark.fullmatch(cell)) for cell in cells)
    gaps = sum(cell in MISSING for cell in cells)
    return numbers > 1 and len(cells) - numbers - gaps < numbers


def _layout(file: str, lines: list[str], tail: list[str], layout: Layout) -> tuple[str, str, int]:
    """Separator, decimal mark and the index of the first line of numbers.

    The layout is that in which most lines of the file's start and end are rows of numbers of one length.
    """
    best: tuple[int, int, str, str, int] | None = None
    for separator in [layout.separator] if layout.separator else SEPARATORS:
        for decimal in [layout.decimal] if layout.decimal else MARKS:
            if decimal == separator:
                continue
            rows = [_cells(line, separator) for line in lines]
            good = [_is_data(cells, MARKS[decimal]) for cells in rows]
            counts = [len(cells) for cells, ok in zip(rows, good) if ok]
            if not counts:
                continue
            width = max(set(counts), key=counts.count)
            n = counts.count(width)
            n += sum(
                len(cells) == width and _is_data(cells, MARKS[decimal])
                for cells in (_cells(line, separator) for line in tail)
            )
            start = next(k for k, cells in enumerate(rows) if good[k] and len(cells) == width)
            if layout.header_line is not None:
                start = next((k for k in range(layout.header_line, len(rows)) if good[k]), start)
            if best is None or (n, width) > best[:2]:
                best = (n, width, separator, decimal, start)
    if best is None or best[0] < 2:
        raise CampaignError(
            f"{file}: no rows of numbers in two columns or more found; say how it is written with --separator, "
            "--decimal, --encoding, --header-line"
        )
    return best[2], best[3], best[4]


def _header(lines: list[str], first: int, separator: str, layout: Layout) -> tuple[list[str], list[str]]:
    """Names and units of the columns, from the lines above the numbers; empty where there are none."""
    width = len(_cells(lines[first], separator))
    if layout.header_line is not None:
        at = layout.header_line - 1
        names = _cells(lines[at], separator) if at < len(lines) else []
        below = [_cells(line, separator) for line in lines[at + 1 : first] if line.strip()]
        return names, next((cells for cells in below if all(is_unit(c) for c in cells)), [])
    above = [_cells(line, separator) for line in lines[:first] if line.strip()]
    fitting: list[list[str]] = []
    for cells in reversed(above):
        if len(cells) < width:
            break
        fitting.append(cells)
    if len(fitting) > 1 and all(is_unit(cell) for cell in fitting[0]):
        return fitting[1], [re.sub(r"^[-–]+$|^none$", "", c.strip("[]()")) for c in fitting[0]]
    if not fitting:
        return [], []
    return fitting[0], (fitting[0] if all(is_unit(cell) for cell in fitting[0]) else [])


def _numbers(
    file: str, raw: bytes, encoding: str, separator: str, decimal: str, first: int
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """The table below the header, and what was left out of it."""
    try:
        table = pd.read_csv(
            io.BytesIO(raw), sep=separator, decimal=decimal, encoding=encoding, skiprows=first, header=None,
            na_values=MISSING, keep_default_na=False, skipinitialspace=True, low_memory=False,
        )  # fmt: skip
    except UnicodeError:
        raise CampaignError(f"{file}: not written in {encoding}; name the right encoding with --encoding") from None
    except (ValueError, OverflowError) as error:
        found = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if not found:
            raise CampaignError(f"{file}: cannot be read as a table ({shown(str(error))})") from None
        raise CampaignError(
            f"{file} line {int(found[2])}: {found[3]} columns where the lines above have {found[1]}; two records in "
            "one file, or a damaged line? Mend or split it"
        ) from None
    notes = []
    text = [c for c in table.columns if not pd.api.types.is_numeric_dtype(table[c])]
    last = table.iloc[-1]
    cut = not raw.rstrip(b"\r\0").endswith(b"\n") and len(table) > 1
    if cut and (last.isna() & ~table.iloc[-2].isna()).any():
        table, cut = table.iloc[:-1], True
        notes.append("the last line is cut off and was left out")
    for column in text:
        if column == 0 and table[column].map(lambda x: isinstance(x, str) and bool(DATE.fullmatch(x.strip()))).all():
            continue
        if all(_is_number(x, decimal) for x in table[column]):  # what was none of them went with the last line
            table[column] = [float(str(x).replace(decimal, ".")) for x in table[column]]
            continue
        if not any(_is_number(x, decimal) for x in table[column]):
            table[column] = np.nan  # a column of remarks
            continue
        _refuse_cell(file, table[column], decimal, first)
    return table, tuple(notes)


def _is_number(cell: object, decimal: str) -> bool:
    return not isinstance(cell, str) or bool(MARKS[decimal].fullmatch(cell.strip()))


def _refuse_cell(file: str, column: pd.Series, decimal: str, first: int) -> None:
    row = next(k for k, cell in enumerate(column) if not _is_number(cell, decimal))
    cell = str(column.iloc[row]).strip()
    hint = "a second header? Give each record a file of its own" if re.match(r"[^\W\d]", cell) else "mend the line"
    raise CampaignError(f"{file} line {first + row + 1}: {shown(cell)} is not a number; {hint}")


def _column(file: str, values: pd.Series, first: int, name: str) -> Array:
    if pd.api.types.is_numeric_dtype(values):
        out = values.to_numpy(dtype=float)
        return np.where(np.isfinite(out), out, np.nan) if not np.isfinite(out).all() else out
    text = values.str.strip().str.replace(",", ".", regex=False)
    day_first = bool(re.match(r"\d{1,2}\.", text.iloc[0]))
    try:
        times = pd.to_datetime(text, dayfirst=day_first, format="mixed")
    except (ValueError, OverflowError) as error:
        raise CampaignError(f"{file}: {name or 'the first column'} is no time of day ({shown(str(error))})") from None
    return (times - times.iloc[0]).dt.total_seconds().to_numpy(dtype=float)
