"""Text files of numbers in any layout: one recording for each table in the file."""

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_iwan.campaign.importing.clock_words import STARTS, STEPS, rate_of_step, stated_rates
from bayes_iwan.campaign.importing.formats.json_text import read_json
from bayes_iwan.campaign.importing.formats.labelled import plain_rows
from bayes_iwan.campaign.importing.formats.lvm import END_OF_HEADER, read_lvm
from bayes_iwan.campaign.importing.formats.stamps import is_date, seconds
from bayes_iwan.campaign.importing.formats.text_layout import (
    MISSING,
    REMARK,
    SEPARATORS,
    Layout,
    Style,
    decoded,
    find_style,
    is_missing,
    labelled,
    names_and_units,
    range_passed,
    words_of_roles,
)
from bayes_iwan.campaign.importing.formats.units_above import units_above
from bayes_iwan.campaign.importing.recordings import FEWEST_SAMPLES, Channel, Recording
from bayes_iwan.campaign.importing.unit_texts import contradict, is_unit, role_of, split_name
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.table import read_bytes
from bayes_iwan.campaign.recording.unapplied import not_applied

SAMPLE = 65536  # characters looked at from the start and from the end to find the layout
SUMMARY = 20  # lines of words below a table at most
SIDE = 0.9  # of a column's cells empty: remarks beside the table, not a signal


def read_text(path: Path, file: str, layout: Layout) -> list[Recording]:
    """The tables of a text file. Raises CampaignError naming the line and how to fix it."""
    text, encoding = decoded(file, read_bytes(path, file), layout.encoding)
    if text.startswith("LabVIEW Measurement") and text.count(END_OF_HEADER) > 1:
        return read_lvm(file, text)
    if (found := read_json(file, text)) is not None:
        return found
    return _read(file, plain_rows(text), layout, "", encoding)


def read_lines(file: str, lines: Sequence[str], layout: Layout, part: str) -> list[Recording]:
    """The tables of lines that another format's cells were written as."""
    return _read(file, "\n".join(lines) + "\n", layout, part, part)


def _read(file: str, text: str, layout: Layout, part: str, how: str) -> list[Recording]:
    head = text[:SAMPLE].split("\n")
    if len(text) > SAMPLE:
        head = head[:-1]
    style, first, width = find_style(file, head, text[-SAMPLE:].split("\n")[1:-1], layout)
    above = head[:first]
    names, units = names_and_units(above, style, width)
    if not names and [style.cells(line)[0] for line in head[first : first + 3]] == ["1", "2", "3"]:
        found = names_and_units(above, style, width - 1)  # R does not head the numbers of its rows
        names, units = (["", *x] if x else x for x in found)
    filled = max(k for x in head[first : first + 50] for k, c in enumerate(style.cells(x), 1) if c)
    if not names and filled < width:  # a separator behind each row and not behind the names
        names, units = names_and_units(above, style, filled)
    if names and (all(is_unit(x) for x in names) or all(style.is_number(x) for x in names if x)):
        names = [f"column {k + 1}" for k in range(len(names))]
    said = (
        f"text: {SEPARATORS.get(style.separator, style.separator)}, decimal {style.decimal}, {how}, numbers from line "
    )
    start = len("\n".join(head[:first])) + (1 if first else 0)
    body, below = _without_summary(text[start:], style)
    body, remarks = _without_remarks(body, style)
    remarks = (*remarks, *below)
    table, notes = _numbers(file, body, style, max(width, len(names)), first)
    if table is not None:
        note = (said + str(first + 1), *notes, *remarks)
        return [_recording(file, part, table, names, units, above, note, style)]
    out: list[Recording] = []
    lines = body.split("\n")
    for k, (a, b, over) in enumerate(_blocks(file, lines, style, width, first), 1):
        own, own_units = names_and_units(over, style, width) if over else (names, units)
        if len(own) != width and not words_of_roles(own):
            own, own_units = names, units  # a remark
        table, notes = _numbers(file, "\n".join(lines[a:b]) + "\n", style, max(width, len(own)), first + a)
        if table is None:  # a cell that is neither: said with its line
            _numbers(file, "\n".join(lines[a:b]) + "\n", style, max(width, len(own)), first + a, strict=True)
            continue
        label = f"{part} table {k}".strip()
        note = (said + str(first + a + 1), *notes)
        out.append(_recording(file, label, table, own or names, own_units or units, over or above, note, style))
    out = _continued(out)
    return out if len(out) != 1 else [replace(out[0], part=part)]


def _continued(tables: list[Recording]) -> list[Recording]:
    """Tables whose first column goes on where that of the one before ended are one: the header was only repeated."""
    out: list[Recording] = []
    for x in tables:
        old = out[-1] if out else None
        if old and [(c.name, c.unit) for c in old.channels] == [(c.name, c.unit) for c in x.channels] and x.channels:
            before, after = old.channels[0].values, x.channels[0].values
            step = float(np.median(np.diff(before)))
            if step > 0 and abs(after[0] - before[-1] - step) < 0.5 * step:
                joined = [
                    replace(a, values=np.concatenate([a.values, b.values])) for a, b in zip(old.channels, x.channels)
                ]
                out[-1] = replace(old, channels=tuple(joined))
                continue
        out.append(x)
    return out


def _without_summary(body: str, style: Style) -> tuple[str, tuple[str, ...]]:
    """The body without the lines of words (Max; Min; Mean; end of file) that some programs write below a table, and a
    word on them."""
    lines = body.rstrip().split("\n")
    if not style.is_number(style.cells(lines[0])[0]):
        return body, ()
    end = len(lines)
    while end > max(len(lines) - SUMMARY, FEWEST_SAMPLES) and re.match(r"\s*(\W?[^\W\d_]{2}|$)", lines[end - 1]):
        end -= 1
    words = [style.cells(line)[0].lower() for line in lines[end:] if line.strip()]
    if not words or any(is_missing(w) or range_passed(w) is not None for w in words):
        return body, ()
    return "\n".join(lines[:end]) + "\n", (f"{len(words)} line(s) of words below the table dropped",)


def _without_remarks(body: str, style: Style) -> tuple[str, tuple[str, ...]]:
    """The body with lines that begin as remarks do made empty, and a word on them."""
    body, n = re.subn(rf"(?m)^[ \t]*(?!#(?:IND|N/A|INF|OVER))(?!{re.escape(style.separator)}){REMARK}.*$", "", body)
    return body, (f"{n} line(s) of remarks dropped",) if n else ()


def _numbers(
    file: str, body: str, style: Style, width: int, first: int, strict: bool = False
) -> tuple[pd.DataFrame | None, tuple[str, ...]]:
    """A table's columns as numbers or text, and what was dropped; None where the body is several tables."""
    try:
        raw = io.BytesIO(body.encode("utf-8", "replace"))
        table = pd.read_csv(
            raw, sep=style.separator, decimal=style.decimal, names=range(width), header=None,
            na_values=MISSING, keep_default_na=False, skipinitialspace=True, low_memory=False,
        )  # fmt: skip
        if not isinstance(table.index, pd.RangeIndex):
            raise ValueError(f"Expected {width} fields in line 1, saw {width + table.index.nlevels}")
    except (ValueError, OverflowError) as error:
        if not strict and _has_header(body, style):
            return None, ()
        found = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if not found:
            raise CampaignError(f"{file}: cannot be read as a table ({shown(str(error))})") from None
        raise CampaignError(
            f"{file} line {first + int(found[2])}: {found[3]} columns where the lines above have {found[1]}: a damaged "
            "line? Correct it in the file"
        ) from None
    notes = []
    if len(table) > 1 and not body.endswith("\n"):
        row = table.iloc[-1]
        if (row.isna() & ~table.iloc[-2].isna()).any() or any(
            isinstance(x, str) and not isinstance(y, str) for x, y in zip(row, table.iloc[-2])
        ):
            table = table.iloc[:-1]
            notes.append("the last line is cut off and was dropped")
    columns: dict[int, pd.Series] = {}
    for k in table:
        column = table[k]
        if pd.api.types.is_bool_dtype(column):
            continue
        if pd.api.types.is_numeric_dtype(column):
            columns[k] = column
            continue
        column = column.map(lambda x: x.strip() if isinstance(x, str) else x)
        filled = column.dropna()
        if len(filled) and len(filled) < (1 - SIDE) * len(column):
            columns[k] = column
            continue
        values = [_number(x, style) for x in column]
        bad = [j for j, (x, y) in enumerate(zip(column, values)) if y is None]
        if not bad:
            columns[k] = pd.Series(np.array(values, dtype=float))
        elif len(bad) == len(filled) or all(_words(x) for x in filled):
            columns[k] = column  # stamps, or remarks
        elif not strict and _has_header(body, style):
            return None, ()
        elif len(word := {str(column.iloc[j]) for j in bad}) == 1 and len(bad) > 1 and _words(*word):
            columns[k] = pd.Series(np.array([np.nan if y is None else y for y in values]))
            notes.append(f"{len(bad)} cells read {shown(*word)} where numbers are: dropped. Was the range passed?")
        else:
            cell = str(column.iloc[bad[0]])
            raise CampaignError(
                f"{file} line {first + bad[0] + 1}: {shown(cell)} is not a number; correct the line in the file"
            )
    return pd.DataFrame(columns), tuple(notes)


def _number(cell: object, style: Style) -> float | None:
    """A cell's number: NaN for a gap, ±inf where the range was passed, None for a text."""
    if not isinstance(cell, str):
        return float(cell) if cell is not None else np.nan  # type: ignore[arg-type]
    if style.is_number(cell):
        other = "," if style.decimal == "." else "."  # divides thousands
        return float(re.sub(rf"[{other} '’\u00a0\u202f]", "", cell).replace(",", ".").lower().replace("d", "e"))
    return np.nan if is_missing(cell) else range_passed(cell)


def _words(cell: object) -> bool:
    return isinstance(cell, str) and not re.match(r"[+-]?[\d.,]+$", cell)


def _has_header(body: str, style: Style) -> bool:
    """Whether a line of names stands within the numbers: two texts or more, and no number."""
    lines = (x for x in body.split("\n") if re.search(r"[^\W\d_]{2}", x))
    return any(_is_header(style.cells(x), style) for x in lines)


def _is_header(cells: list[str], style: Style) -> bool:
    words = [c for c in cells if re.search(r"[^\W\d_]", c)]
    return len(words) > 1 and (words_of_roles(cells) > 1 or not any(style.is_number(c) for c in cells))


def _blocks(file: str, lines: list[str], style: Style, width: int, first: int) -> list[tuple[int, int, list[str]]]:
    """Tables within one file: first line and one past the last of each, and the lines above it."""
    blocks: list[tuple[int, int, list[str]]] = []
    between: list[str] = []
    start = None
    for k, line in enumerate([*lines, "end of file"]):
        cells = style.cells(line)
        row = k < len(lines) and len(cells) >= width and style.numbers(cells) > 0
        if row and start is None:
            start = k
            if blocks and not any(_is_header(style.cells(x), style) for x in between):
                odd = next((j for j, x in enumerate(between) if x.strip() and len(style.cells(x)) > 1), None)
                if odd is not None:
                    raise CampaignError(
                        f"{file} line {first + blocks[-1][1] + odd + 1}: {shown(between[odd])} is no row of numbers: a "
                        "damaged line? Correct it in the file"
                    )
        elif not row and start is not None:
            blocks.append((start, k, between))
            start, between = None, [line]
        elif not row:
            between.append(line)
    return [x for x in blocks if x[1] - x[0] >= FEWEST_SAMPLES]


def _recording(
    file: str, part: str, table: pd.DataFrame, names: list[str], units: list[str], above: list[str],
    notes: tuple[str, ...], style: Style,
) -> Recording:  # fmt: skip
    """A table's columns as channels, with what the lines above and the remarks beside it say of them."""
    names = names + [f"column {k + 1}" for k in range(len(names), max(table, default=0) + 1)]
    units = units + [""] * (len(names) - len(units))
    side = [k for k in table if 0 < table[k].notna().sum() < (1 - SIDE) * len(table)]
    beside = [",".join(str(x) for x in row if x == x) for row in table[side].head(40).to_numpy()] if side else []
    whole = all(bool((table[k].dropna() % 1 == 0).all()) for k in table if pd.api.types.is_numeric_dtype(table[k]))
    lines = [";".join(style.cells(x)) if style.separator == "," else x for x in [*above, *beside]]
    # an oscilloscope's increment stands in the row of units
    increments = [_number(x, style) for name, x in zip(names, units) if re.fullmatch(r"(?i)increment|delta_?x", name)]
    rates = tuple(1 / x for x in increments if x and x > 0) or stated_rates(lines, "" if whole else style.decimal)
    labels = _labels([*above, *beside])
    starts = _numbers_of(labelled(above, style, len(names), STARTS), style)
    steps = _numbers_of(labelled(above, style, len(names), STEPS), style)
    used = [k for k in table if k not in side and table[k].notna().any() and units[k].lower() != "sequence"]
    numeric = [k for k in used if pd.api.types.is_numeric_dtype(table[k])]
    # what names say is said of those that are used
    stated = [*(x for x in above if not all(name in x for name in names)), *beside]
    of_labels = {numeric[k]: x for k, x in units_above([split_name(names[k])[0] for k in numeric], stated).items()}
    taken: list[str] = []
    channels: dict[int, Channel] = {}  # by column: a time is of the channels behind it
    for k in numeric:
        name, unit = split_name(names[k])
        if units[k] and is_unit(units[k]):
            two = re.search(r"[\[(]", names[k]) and contradict(unit, units[k])  # Force (N) above kN
            name, unit = (f"{names[k]}, {units[k]}", "") if two else (names[k], units[k])
            units[k] = "" if two else units[k]
        if name.startswith("column ") and k == numeric[-1]:
            name = labels.get("source", name)
        of_label = of_labels.get(k, "")
        taken += [] if unit.strip() or units[k] or not of_label else [f"{name!r} in {of_label}"]
        unit = unit.strip() or units[k] or of_label
        if contradict(unit, of_label):
            name, unit = f"{names[k]}, {of_label}", ""
        heading = names[k] + (f" ({units[k]})" if units[k] else "")
        values, own = table[k].to_numpy(dtype=float), rate_of_step(steps[k], above) if k in steps else None
        channels[k] = Channel(name or f"column {k + 1}", unit, values, own, starts.get(k), heading=heading)
    began = next((x[2] for k, v in labels.items() if STARTS.fullmatch(k) and "." in v and (x := seconds([v]))), None)
    if not any(role_of(c.unit) == "time" for c in channels.values()):
        clocks, said, first = _clocks({k: table[k] for k in used if k not in numeric}, names)
        channels, notes, began = channels | clocks, (*notes, *said), first if clocks else began
    kept = tuple(channels[k] for k in sorted(channels)) if len(table) >= FEWEST_SAMPLES else ()
    notes += (f"units by the lines above: {', '.join(taken)}",) if taken else ()
    return Recording(file, part, kept, notes, rates, not_applied([*stated, *_tabled(above, style)]), began)


def _tabled(above: Sequence[str], style: Style) -> Iterator[str]:
    """What a table above the numbers states of single channels: "Force gain: 10" of a row Force below a head Gain."""
    rows = [style.cells(line) for line in above]
    for at, head in enumerate(rows):
        for row in rows[at + 1 :]:
            pairs = ((x, y) for x, y in zip(head[1:], row[1:]) if x and not style.is_number(x))
            yield from (f"{row[0]} {x}: {y}" for x, y in pairs if re.search("[1-9]", y))


def _numbers_of(cells: Sequence[str], style: Style) -> dict[int, float]:
    """Numbers or stamps of a row above the table, by column: stamps in seconds from the first one."""
    there = {k: c for k, c in enumerate(cells) if c}
    found = {k: x for k, c in there.items() if style.is_number(c) and (x := _number(c, style)) is not None}
    if there and not found and (stamps := seconds(list(there.values()))) is not None:
        return {k: float(x) for k, x in zip(there, stamps[0])}
    return found if len(found) == len(there) else {}  # not "5, ms": a number and its unit


def _clocks(columns: dict[int, pd.Series], names: list[str]) -> tuple[dict[int, Channel], tuple[str, ...], float]:
    """The times that columns of text hold, by column, all from the first one's first stamp, what was done to them, and
    that stamp: times of day, with a column of dates beside them or without."""
    texts = {k: c for k, c in columns.items() if c.dropna().map(lambda x: isinstance(x, str)).all()}
    dated = {k: c for k, c in texts.items() if c.dropna().map(is_date).all()}
    clocks: dict[int, Channel] = {}
    notes: list[str] = []
    origin: tuple[list[str], list[str] | None] | None = None
    began = 0.0
    for k, column in texts.items():
        if k in dated:
            continue
        there = column.notna()
        dates = next((dated[j] for j in [*range(k - 1, -1, -1), *dated] if j in dated), None)
        days = dates[there].tolist() if dates is not None and dates[there].notna().all() else None
        stamps = column[there].tolist()
        origin = origin or (stamps[:1], days and days[:1])
        found = seconds(origin[0] + stamps, origin[1] + days if origin[1] and days else None)
        if found is None:
            origin = None if not clocks else origin
            continue
        time = np.full(len(column), np.nan)
        time[there.to_numpy()] = found[0][1:]
        began = began if clocks else found[2]
        clocks[k] = Channel(names[k] or "time", "s", time, heading=names[k])
        if found[1]:
            notes.append(f"{names[k] or 'time'}: {found[1]}")
    return clocks, tuple(notes), began


def _labels(lines: Sequence[str]) -> dict[str, str]:
    """What lines above or beside a table say, by what they say it of: "vertical units" -> "V"."""
    found: dict[str, str] = {}
    for line in lines:
        m = re.match(r"[^\w]*([^\d\W][^:=;,\t]*?)\s*[:=;,\t]\s*\"?([^;,\t\"]+)", line)
        if m:
            found.setdefault(m[1].strip().lower(), m[2].strip())
    return found
