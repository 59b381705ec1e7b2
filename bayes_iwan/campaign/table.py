"""A record's file as numbers: whole, finite, and never more of the machine's memory than the file deserves."""

from __future__ import annotations

import gzip
import io
import math
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.records import CampaignError, shown

FREE_EXPANSION, LARGEST_EXPANSION = 64_000_000, 100  # bytes, and times its size, that a packed record may unpack to


def header_has(names: list[str]) -> str:
    """What a message says of a header, however long it is."""
    text = ", ".join(names)
    return "the header has " + (text if len(text) <= 200 else text[:197] + "...")


def read_table(path: Path, file: str) -> tuple[list[str], Array, tuple[str, ...]]:
    """Column names, (n, columns) numbers and warnings of a .csv or .csv.gz file.

    Raises CampaignError naming the line of the first cell that is no finite number.
    """
    if not file.endswith((".csv", ".csv.gz")):
        raise CampaignError(f"{file}: records are read from .csv or .csv.gz files")
    raw = _content(path, file)
    end = raw.find(b"\n") + 1 or len(raw)
    try:
        header = raw[:end].decode("utf-8-sig").rstrip("\r\n")
        body = raw[end:].decode("utf-8")  # numbers in plain text: one byte a character
    except UnicodeDecodeError:
        raise CampaignError(f"{file}: not a text file; export it as comma-separated text") from None
    del raw
    names = [name.strip().strip('"') for name in header.split(",")]
    if len(names) < 2:
        hint = "; columns must be separated by commas" if re.search(r"[;\t]", header) else ""
        raise CampaignError(f"{file} line 1: no header with column names{hint}")
    if not all(name.isprintable() for name in names):
        raise CampaignError(f"{file} line 1: the header is no text; is it a text file with column names above numbers?")
    if len(set(names)) < len(names):
        raise CampaignError(f"{file} line 1: two columns have one name")
    warnings: tuple[str, ...] = ()
    if body and not body.endswith("\n"):
        # a row cut off inside its last number still reads as numbers, so it cannot be trusted
        body, _, last = body.rpartition("\n")
        body += "\n" if body else ""
        if last.strip() and last.count(",") != len(names) - 1:
            line = 2 + body.count("\n")
            raise CampaignError(
                f"{file} line {line}: the last line is cut off ({last.count(',') + 1} of {len(names)} "
                "columns); delete it or export the record again"
            )
        warnings = ("the last line has no end and may be cut off: it was left out",)
    if not body.strip():
        raise CampaignError(f"{file}: no samples below the header")
    try:
        table = np.loadtxt(_lines(body), delimiter=",", comments=None, ndmin=2)
    except (ValueError, OverflowError):
        raise _bad_cell(file, names, body) from None
    if table.shape[1] != len(names) or not np.isfinite(table).all():
        raise _bad_cell(file, names, body)
    return names, table, warnings


def _content(path: Path, file: str) -> bytes:
    """A record's bytes, unpacked. Raises CampaignError for what is no ordinary file or unpacks without end."""
    try:
        if path.exists() and not path.is_file():
            raise CampaignError(f"{file}: not a file that holds a record (a folder, pipe or device)")
        raw = path.read_bytes()
        if not file.endswith(".gz"):
            return raw
        most = max(FREE_EXPANSION, LARGEST_EXPANSION * len(raw))
        with gzip.open(io.BytesIO(raw)) as packed:
            text = packed.read(most + 1)
    except FileNotFoundError:
        raise CampaignError(f"{file}: not found in {path.parent}; mend its name in campaign.toml") from None
    except (OSError, EOFError, zlib.error) as error:
        raise CampaignError(f"{file}: cannot be read ({error}); copy or export it again") from None
    if len(text) > most:
        raise CampaignError(
            f"{file}: unpacks to more than {most // 1_000_000} MB, {most / max(len(raw), 1):.0f} times its size, "
            "which no record does; unpack it yourself and list the .csv"
        )
    return text


def _lines(body: str) -> Iterator[str]:
    """Line by line, without a copy of the whole: a `StringIO` holds four bytes for each character."""
    start = 0
    while start < len(body):
        stop = body.find("\n", start) + 1 or len(body)
        yield body[start:stop]
        start = stop


def _bad_cell(file: str, names: list[str], body: str) -> CampaignError:
    lines = body.splitlines()
    for number, line in enumerate(lines, 2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(names):
            last = " (the last line: cut off?)" if number == len(lines) + 1 else ""
            return CampaignError(
                f"{file} line {number}{last}: {len(cells)} columns where the header has {len(names)}; delete the "
                "line or export the record again"
            )
        for name, cell in zip(names, cells):
            try:
                value = float(cell)
            except ValueError:
                return CampaignError(f"{file} line {number}: {shown(cell.strip())} in {name} is not a number")
            if not math.isfinite(value):
                return CampaignError(
                    f"{file} line {number}: {name} is {cell.strip()}; delete the line (a short gap is bridged) or "
                    "mend the export"
                )
    return CampaignError(f"{file}: cannot be read as numbers")
