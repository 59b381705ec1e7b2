"""A record's file as numbers: whole, finite, and never more of the machine's memory than the file deserves."""

import codecs
import gzip
import io
import math
import re
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.stated import LARGEST_NUMBER
from bayes_iwan.campaign.recording.units import TIMES
from bayes_iwan.errors import nearest, not_utf8

FREE_EXPANSION, LARGEST_EXPANSION = 64_000_000, 100  # bytes, and times its size, that a packed record may unpack to
IMPORT = "or let `bayes-iwan import` read the file"


def header_has(names: list[str]) -> str:
    """What a message says of a header, however long it is."""
    text = ", ".join(names)
    return "the header has " + (text if len(text) <= 200 else text[:197] + "...")


def read_table(path: Path, file: str) -> tuple[list[str], Array, tuple[str, ...]]:
    """Column names, (n, columns) numbers and warnings of a .csv or .csv.gz file.

    Raises CampaignError naming the line of the first cell that is no finite number.
    """
    if not file.endswith((".csv", ".csv.gz")):
        raise CampaignError(f"{file}: records are read from .csv or .csv.gz files; `bayes-iwan import` reads others")
    raw = read_bytes(path, file)
    _check_text(file, raw)
    start = raw.find(b"\n") + 1 or len(raw)
    header = raw[:start].decode("utf-8-sig").rstrip("\r\n")
    names = [name.strip().strip('"') for name in header.split(",")]
    if len(names) < 2:
        hint = f"; columns must be separated by commas, {IMPORT}" if re.search(r"[;\t]", header) else ""
        raise CampaignError(f"{file} line 1: no header with column names{hint}")
    if not all(name.isprintable() for name in names):
        raise CampaignError(f"{file} line 1: the header is no text; is it a text file with column names above numbers?")
    if len(set(names)) < len(names):
        raise CampaignError(f"{file} line 1: two columns have one name")
    warnings: tuple[str, ...] = ()
    if len(raw) > start and not raw.endswith(b"\n"):
        # a row cut off inside its last number still reads as numbers, so it cannot be trusted
        end = raw.rfind(b"\n") + 1
        last = raw[end:]
        line, cells = raw.count(b"\n") + 1, last.count(b",") + 1
        if last.strip() and cells != len(names):
            raise CampaignError(
                f"{file} line {line}: the last line is cut off ({cells} of {len(names)} columns); delete it or export "
                "the record again"
            )
        raw = raw[:end]
        warnings = ("the last line has no end and may be cut off: it was omitted",)
    if not raw[start:].strip():
        raise CampaignError(f"{file}: no samples below the header")
    body = io.BytesIO(raw)
    body.seek(start)
    try:
        table = pd.read_csv(body, header=None, dtype=np.float64).to_numpy()
    except (ValueError, OverflowError):
        raise _bad_cell(file, names, raw) from None
    if table.shape[1] != len(names) or not np.isfinite(table).all():
        raise _bad_cell(file, names, raw)
    return names, table, warnings


def read_bytes(path: Path, file: str) -> bytes:
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
        raise CampaignError(f"{file}: not found in {path.parent}; fix its name in campaign.toml") from None
    except (OSError, EOFError, zlib.error) as error:
        raise CampaignError(f"{file}: cannot be read ({error}); copy or export it again") from None
    if len(text) > most:
        raise CampaignError(
            f"{file}: unpacks to more than {most // 1_000_000} MB, {most / max(len(raw), 1):.0f} times its size, "
            "which no record does; unpack it yourself and list the .csv"
        )
    return text


def _check_text(file: str, raw: bytes) -> None:
    """Refuse what is not UTF-8 text, saying what it seems to be."""
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise CampaignError(f"{file}: written as UTF-16; save it as UTF-8, {IMPORT}")
    if (k := raw.find(b"\0")) >= 0:
        line = raw.count(b"\n", 0, k) + 1
        text = raw[:k].isascii() and k > 0
        what = "the file was not written to its end; copy or export it again" if text else "not a text file"
        raise CampaignError(f"{file} line {line}: zero bytes: {what}")
    if raw.isascii():
        return
    try:
        raw.decode()
    except UnicodeDecodeError as error:
        if re.search(rb"[\x01-\x08\x0e-\x1f]", raw):
            raise CampaignError(f"{file}: not a text file; export it as comma-separated text, {IMPORT}") from None
        raise CampaignError(f"{file} {not_utf8(error)}, {IMPORT}") from None


def _bad_cell(file: str, names: list[str], raw: bytes) -> CampaignError:
    lines = raw.decode("utf-8-sig").splitlines()[1:]
    for number, line in enumerate(lines, 2):
        if not line.strip():
            continue
        cells = [cell.strip().strip('"') for cell in line.split(",")]
        where = f"{file} line {number}"
        if cells == names:
            return CampaignError(f"{where}: the header again; delete it, or give each of two records a file of its own")
        if number == 2 and not any(_is_number(cell) for cell in cells):
            units = shown(", ".join(cells))
            return CampaignError(
                f"{where}: a row of units ({units})? Put them into the column names and delete it, {IMPORT}"
            )
        if len(cells) != len(names):
            last = number == len(lines) + 1
            return CampaignError(
                f"{where}{' (the last line: cut off?)' if last else ''}: {len(cells)} columns where the header has "
                f"{len(names)}; {'delete the line' if last else _without_line(names)} or export the record again"
            )
        for name, cell in zip(names, cells):
            if not _is_number(cell):
                return CampaignError(f"{where}: {shown(cell)} in {name} is not a number")
            if not math.isfinite(float(cell)):
                return CampaignError(f"{where}: {name} is {cell}; {_without_line(names)} or fix the export")
    return CampaignError(f"{file}: cannot be read as numbers")


def times_in(names: list[str]) -> list[str]:
    """The columns that hold times, by the ends of their names."""
    return [name for name in names if ending(name, {"s": TIMES})]


def _without_line(names: list[str]) -> str:
    """How a file is read without one of its lines: without times, the rows after it would be taken for earlier ones."""
    if times_in(names):
        return "delete the line (a short gap is bridged)"
    return "delete the line and add a column time_s with the time of each row, let `bayes-iwan import` read the file"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def working_unit(name: str, quantities: Mapping[str, Mapping[str, float]]) -> str | None:
    """The working unit of a column, which the end of its name tells (torque_N_m: N·m); None where it tells none."""
    found = ending(name, quantities)
    return found and next(working for working, units in quantities.items() if found in units)


def ending(name: str, quantities: Mapping[str, Mapping[str, float]]) -> str | None:
    """The longest unit that a column's name ends in."""
    units = sorted((x for units in quantities.values() for x in units), key=len, reverse=True)
    return next((x for x in units if name.endswith("_" + x)), None)


def column(
    names: list[str], table: Array, name: str, quantities: Mapping[str, Mapping[str, float]], file: str
) -> Array:
    """(n,) a column by its name, in the working unit that the end of its name tells. Raises CampaignError."""
    if name not in names:
        meant = nearest(name, names, ". Fix [channels] or the header")
        raise CampaignError(f"{file}: no column {shown(name)}; {header_has(names)}{meant}")
    sizes = {unit: size for units in quantities.values() for unit, size in units.items()}
    if (unit := ending(name, quantities)) is None:
        ends = ", ".join("_" + u for u in sizes)
        raise CampaignError(f"{file}: column {shown(name)} does not say its unit; end its name in one of {ends}")
    column = table[:, names.index(name)] * sizes[unit]
    if np.abs(column).max() > LARGEST_NUMBER:
        line = int(np.argmax(np.abs(column))) + 2
        raise CampaignError(f"{file} line {line}: {name} is beyond any instrument; {_without_line(names)}")
    return np.ascontiguousarray(column)
