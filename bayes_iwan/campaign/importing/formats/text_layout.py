"""How a text table is written: encoding, separator, decimal mark, first line of numbers, what stands above it."""

import codecs
import csv
import math
import re
import unicodedata
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from encodings.aliases import aliases
from functools import lru_cache

from bayes_iwan.campaign.importing.clock_words import STARTS, STEPS
from bayes_iwan.campaign.importing.formats.stamps import is_stamp
from bayes_iwan.campaign.importing.formats.units_above import UNIT_WORDS
from bayes_iwan.campaign.importing.names import WORDS, named
from bayes_iwan.campaign.importing.recordings import FEWEST_SAMPLES, NoSignals
from bayes_iwan.campaign.importing.unit_texts import is_unit, is_volts, role_of
from bayes_iwan.campaign.recording.records import CampaignError
from bayes_iwan.errors import nearest

MISSING = ["-", "--", "---", "NaN", "nan", "NAN", "", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN", "null", "n/a"]
MISSING += ["#N/A", "#DIV/0!", "#VALUE!", "#NUM!", "#REF!", "#NAME?"]  # Excel's
#: what recorders write where the range was passed, without the marks (#OVER, <OL>) and the sign around it
_PASSED = {"∞", "inf", "infinity", "1.#inf", "ol", "ovl", "over", "overrange", "overflow", "overload", "ovfl", "ovld"}
_PASSED |= {"ovrflw", "saturated", "saturation", "clipped", "clipping"}
_BELOW = {"under", "underflow", "underrange"}
SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", r"\s+": "blanks"}
NAMED = {"tab": "\t", "tabs": "\t", "\\t": "\t", "comma": ",", "semicolon": ";", "blank": r"\s+", "blanks": r"\s+"}
NAMED |= {"space": r"\s+", "spaces": r"\s+", "bar": "|"}
REMARK = r"(?:#|//|!|%|;|')"  # what a line of remarks begins with
MARKS = {  # digits are matched in one way only: a cell of 60,000 of them would take minutes otherwise
    ".": re.compile(r"(?:[+-] *)?(\d+(\.\d*)?|\.\d+)([eEdD][+-]?\d+)?"),
    ",": re.compile(r"(?:[+-] *)?(\d+(,\d*)?|,\d+)([eEdD][+-]?\d+)?"),
}
THOUSANDS = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}([, '’\u00a0\u202f]\d{3})+(\.\d*)?"),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}([. '’\u00a0\u202f]\d{3})+(,\d*)?"),
}
_DIVIDED = re.compile(r"\d[,. '’\u00a0\u202f]\d{3}(?!\d)")  # what THOUSANDS need
#: of text that is no UTF-8, in the order in which they are taken where they make equal sense
ENCODINGS = (
    "cp1252", "utf-8", "cp1251", "gb18030", "cp932", "cp850", "cp866", "koi8-r", "big5", "cp949", "euc-jp", "mac-roman",
    "cp1250",
)  # fmt: skip
NO_TEXT = "no text, and no format that is known by its first bytes; export it as CSV, MAT, TDMS, UFF 58 or Parquet"
LONGEST_WORD, MOST_WORDS = 40, 200
#: labels at the head of a row above the table that has a cell for each channel
_NAMES = re.compile(r"(?:channel|trace|ch|kanal|long|測定ch)[ _-]?(?:names?|名称)|names?|kanal|waveform", re.IGNORECASE)
_UNITS = re.compile(UNIT_WORDS, re.IGNORECASE)
_EDGES = " :=[]"  # of a label
_OUTSIDE = re.compile(r",(?![^()\[\]]*[)\]])")  # a comma, and not within brackets


@dataclass(frozen=True)
class Layout:
    """How a text file is written; what is None is found from the file.

    separator : one character, or its name (tab, comma, semicolon, blank).
    """

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None

    def __post_init__(self) -> None:
        if self.separator is not None:
            object.__setattr__(self, "separator", NAMED.get(self.separator.lower(), self.separator))
        if self.decimal not in (None, ".", ","):
            raise CampaignError(f"decimal must be . or , not {self.decimal!r}")
        if self.separator is not None and self.separator not in SEPARATORS and len(self.separator) != 1:
            raise CampaignError(
                f"the separator {self.separator!r} is no single character{nearest(self.separator, NAMED)}"
            )


@dataclass(frozen=True)
class Style:
    """A table's separator and decimal mark, and whether marks divide thousands."""

    separator: str
    decimal: str
    thousands: bool = False

    def is_number(self, cell: str) -> bool:
        """Whether a cell is a number in this style."""
        return bool(MARKS[self.decimal].fullmatch(cell)) or (
            self.thousands and bool(THOUSANDS[self.decimal].fullmatch(cell))
        )

    def cells(self, line: str) -> list[str]:
        """A line's cells without blanks and quotes around them."""
        cells = line.split(None if self.separator == r"\s+" else self.separator)
        if '"' in line and self.separator != r"\s+":
            with suppress(csv.Error):
                cells = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        return [cell.strip().strip('"').strip() for cell in cells]

    def numbers(self, cells: Sequence[str]) -> int:
        """How many more numbers than texts a row of the table has: 0 for what is no row."""
        found = [1 if self.is_number(cell) else _word(cell) for cell in cells]
        return max(sum(found), 0)


@lru_cache(100_000)
def _word(cell: str) -> int:
    """1 for a cell that says that the range was passed, 0 for a gap or a stamp, -1 for any other text."""
    if len(cell) > LONGEST_WORD:
        return -1
    return 1 if range_passed(cell) is not None else -int(not is_missing(cell) and not is_stamp(cell))


def range_passed(cell: str) -> float | None:
    """±inf for a cell that says that the range was passed (OL, #OVER, -OVLD, +++++, *****), None for any other."""
    word = cell.lower().strip("#<>[]()! ")
    if re.fullmatch(r"\+{2,}|\*{2,}", word):
        return math.inf
    if word in _BELOW:
        return -math.inf
    if word.strip("+-−") in _PASSED:
        return -math.inf if word[0] in "-−" else math.inf
    return None


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no number."""
    return cell in MISSING or re.fullmatch("-{4,12}", cell) is not None


def decoded(file: str, raw: bytes, encoding: str | None) -> tuple[str, str]:
    """A file's text with lines ended by \\n, and its encoding."""
    found = encoding or _encoding(file, raw)
    if "16" in found and len(raw) % 2:
        raw = raw[:-1]
    try:
        text = raw.decode(found, "strict" if encoding else "replace")  # a damaged remark harms no number
    except LookupError:
        known = nearest(encoding, set(aliases.values()), "; utf-8, cp1252 and utf-16 are")
        raise CampaignError(f"{file}: encoding {encoding!r} is not known{known}") from None
    except UnicodeError:
        raise CampaignError(f"{file}: not written in {encoding}; leave --encoding out, or name the right one") from None
    text = re.sub(r"−(?=[\d.,])", "-", text.removeprefix("\ufeff"))  # a typographer's minus
    return (text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text), found


def _encoding(file: str, raw: bytes) -> str:
    for mark, name in (
        (codecs.BOM_UTF8, "utf-8-sig"),
        (codecs.BOM_UTF32_LE, "utf-32"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if raw.startswith(mark):
            return name
    start = raw[:65536]
    if (zeros := start.count(0)) > 0.2 * len(start):
        odd = start[1::2].count(0)
        if zeros == max(odd, zeros - odd) and zeros < 0.6 * len(start):
            return "utf-16-le" if odd else "utf-16-be"
    if (k := raw.find(b"\0")) >= 0:
        line = raw.count(b"\n", 0, k) + 1
        if not re.search(rb"\n[^\n]*\d[^\n]*\n", raw[:k]) or not raw[:k].isascii():
            raise NoSignals(f"{file}: {NO_TEXT}")
        raise CampaignError(
            f"{file} line {line}: zero bytes: the file was not written to its end; copy or export it again"
        )
    if raw.isascii():
        return "utf-8"
    try:
        raw.decode("utf-8")
        return "utf-8"
    except UnicodeDecodeError:
        if re.search(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f]", start):
            raise NoSignals(f"{file}: {NO_TEXT}") from None
    words = {name: _understood(start.decode(name, "replace")) for name in ENCODINGS}
    return max(words, key=lambda name: words[name])


def _understood(text: str) -> tuple[int, int]:
    """How many words with letters beyond ASCII are a unit or begin a channel's name (one encoding makes them so), and
    minus how many letters there are none of."""
    texts = unicodedata.normalize("NFKC", text)
    words = {w for w in re.split(r"[\s;,|:/\[\](){}<>\"=]+", texts) if w and not w.isascii() and len(w) < LONGEST_WORD}
    whole = sorted(w for w in words if "\ufffd" not in w)[:MOST_WORDS]
    known = sum((w.isalpha() and any(named(w, x) for x in WORDS)) or role_of(w) is not None for w in whole)
    return known, -texts.count("\ufffd")


def find_style(file: str, head: list[str], tail: list[str], layout: Layout) -> tuple[Style, int, int]:
    """Style, index of the first line of numbers, and width of the table.

    The style is that in which most lines of the file's start and end are rows of numbers of one length, and most cells
    of these are numbers.
    """
    quoted = any('"' in line for line in head[-50:])
    best: tuple[int, int, Style, int, int] | None = None
    separators = [layout.separator] if layout.separator else SEPARATORS
    cut = {x: [[Style(x, ".").cells(line) for line in lines] for lines in (head, tail)] for x in separators}
    divided = any(_DIVIDED.search(line) for line in [*head, *tail])
    for thousands in (False, True) if divided else (False,):
        for separator in separators:
            for decimal in [layout.decimal] if layout.decimal else MARKS:
                if decimal == separator and not quoted:
                    continue
                style = Style(separator, decimal, thousands)
                rows, last = cut[separator]
                good = [style.numbers(cells) for cells in rows]
                widths = [len(cells) for cells, n in zip(rows, good) if n]
                if not widths:
                    continue
                width = max(set(widths), key=widths.count)
                ends = [(len(cells), style.numbers(cells)) for cells in last]
                fit = [n for cells, n in zip(rows, good) if len(cells) == width and n] + [
                    n for w, n in ends if w == width and n
                ]
                if best is None or (len(fit), sum(fit)) > best[:2]:
                    at = {k for k, cells in enumerate(rows) if good[k] and len(cells) == width}
                    runs = ([k for k in sorted(at) if at.issuperset(range(k, k + n))] for n in (FEWEST_SAMPLES, 3, 1))
                    first = next(some[0] for some in runs if some)  # not numbers among names
                    best = (len(fit), sum(fit), style, first, width)
    if best is None or best[0] < 2:
        raise NoSignals(
            f"{file}: no rows of numbers found; say how it is written with --separator, --decimal, --encoding"
        )
    style, first, width = best[2:]
    first = _with_remarks(cut[style.separator][0], style, first, width)
    if layout.decimal is None and (cell := _may_be_thousands(style, head[first:])):
        other = "," if style.decimal == "." else "."
        raise CampaignError(
            f'{file}: "{cell}" and cells without a {style.decimal} stand in one column: does it divide thousands? Say '
            f'--decimal "{other}" if it does, --decimal "{style.decimal}" if not'
        )
    if (style.separator, style.decimal) == (",", ".") and not layout.decimal and not layout.separator:
        cells = [c for line in head[first:] for c in line.split(",")]
        if any(re.fullmatch(r"0\d+", c.strip()) for c in cells) and not any("." in c for c in cells):
            if width > 2:
                raise CampaignError(
                    f"{file} line {first + 1}: commas divide columns and decimals alike; export it with points or with "
                    "semicolons between columns"
                )
            return Style("\t", ","), first, 1
    return style, first, width


def _with_remarks(rows: list[list[str]], style: Style, first: int, width: int) -> int:
    """The first row of a table: one with remarks beside its numbers belongs to it, one that is labelled or counts the
    columns, as pandas does, does not."""
    places = [[k for k, c in enumerate(cells) if style.is_number(c)] if len(cells) == width else [] for cells in rows]
    last = max(k for k, x in enumerate(places) if x)
    usual = places[last]
    while first and set(usual) <= set(places[first - 1]):
        first -= 1
    cells = [rows[first][k] for k in places[first]]
    counts = len(cells) > 1 and cells in ([str(k + a) for k in range(len(cells))] for a in (0, 1))
    if counts and any(style.decimal in c for c in rows[first + 1]):
        first += 1
    while places[first] == usual and (
        (rows[first][0] and not rows[last][0] and len(usual) == width - 1)  # "Length", 900, 900 above an empty column
        or any(x.fullmatch(rows[first][0].strip(_EDGES)) for x in (STARTS, STEPS))
    ):
        first += 1
    return first


def _may_be_thousands(style: Style, lines: list[str]) -> str:
    """A number of a column in which a mark stands before three digits, or the number has three at most and no mark."""
    for cells in zip(*(style.cells(line) for line in lines if line.strip())):
        marked = [c for c in cells if style.decimal in c]
        whole = [c for c in cells if re.fullmatch(r"[+-]?(?:[1-9]\d{0,2}|0)", c)]
        form = rf"[+-]?[1-9]\d{{0,2}}[{style.decimal}]\d{{3}}"
        if len(marked) > 1 and len(whole) > 1 and len(marked) + len(whole) == len([c for c in cells if c]):
            if all(re.fullmatch(form, c) for c in marked):
                return marked[0]
    return ""


def names_and_units(lines: list[str], style: Style, width: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns, from the lines above the numbers; empty where there are none."""
    names, units = (labelled(lines, style, width, x) for x in (_NAMES, _UNITS))
    if any(names) and (any(units) or words_of_roles(names)):
        return names, _bare(units)
    fitting: list[list[str]] = []
    below = False
    space = r"[^\S\t]" if style.separator == "\t" else r"\s"  # "#" may be the name of a column
    for line in reversed([line for line in lines if re.search(r"[^\W_]", line)]):
        line = re.sub(rf"^\s*(?!{re.escape(style.separator)}){REMARK}{space}*", "", line)
        line = re.sub(rf"^(?i:{UNIT_WORDS})\s*[:=]\s*", "", line)
        cells = style.cells(line)
        if style.separator == r"\s+" and len(cells) > width == len(spaced := re.split(r"\t|\s{2,}", line.strip())):
            cells = spaced  # names of several words, or with a unit
        elif len(cells) != width:  # Time (s) Force (N), or divided by another mark than the numbers
            ways = (
                re.findall(r"[^\s(\[]+(?: ?[\[(][^\])]*[\])])?", line),
                *(Style(x, ".").cells(line) for x in SEPARATORS),
            )
            cells = next((x for x in ways if len(x) == width and words_of_roles(x) > 1), cells)
        if len(cells) > width and (whole := _OUTSIDE.split(line)) and len(whole) == width:
            cells = [cell.strip().strip('"') for cell in whole]  # "Position(0,1) (mm)" is one
        while len(cells) > width and not re.search(r"\w", cells[0]):
            cells = cells[1:]  # what marks a remark
        below = below or (not fitting and len(cells) < width)  # remarks below the names, which then must be such
        numbers = len(cells) > 1 and all(map(style.is_number, cells[1:])) and not words_of_roles(cells)  # "Mean", 0, 0
        if not fitting and (numbers or (below and (len(cells) < width or words_of_roles(cells) < 2))):
            continue
        if len(cells) < width or (len(fitting) and len(cells) < len(fitting[0]) - 1):
            break
        fitting.append(cells)
    if not fitting:
        return [], []
    are_units = [_is_units(cells, style) for cells in fitting]
    if any(units) and not are_units[0]:
        return fitting[0], _bare(units)
    if len(fitting) > 1 and are_units[0]:
        return _filled(fitting[1:]), _bare(fitting[0])
    if len(fitting) > 1 and are_units[1]:  # units above names, or a row of remarks below them
        return max([fitting[0], *fitting[2:3]], key=words_of_roles), _bare(fitting[1])
    return _filled(fitting), (fitting[0] if are_units[0] else [])


def _filled(rows: Sequence[Sequence[str]]) -> list[str]:
    """Names, the lowest row first; a cell that is merged with those above it has its name in one of these."""
    return [next((row[k] for row in rows if k < len(row) and row[k]), "") for k in range(len(rows[0]))]


def words_of_roles(cells: Sequence[str]) -> int:
    """How many cells say by a word what their channels are."""
    return sum(any(named(cell, role) for role in WORDS) for cell in cells)


def labelled(lines: Sequence[str], style: Style, width: int, label: re.Pattern[str]) -> list[str]:
    """A cell for each column of a row that begins with a label ("Units", mm, N), or stands below it; else nothing."""
    for line, below in zip(lines, [*lines[1:], ""]):
        cells = style.cells(line)
        if label.fullmatch(cells[0].strip(_EDGES)) if cells else False:
            beside = any(cells[1:])  # and the column below the label holds times, numbers of rows or nothing
            row = cells[1:] if beside else style.cells(below)
            while len(row) > width and not row[-1]:
                row = row[:-1]
            if len(row) == width or (beside and len(row) == width - 1):
                return [""] * (width - len(row)) + row
    return []


def _is_units(cells: Sequence[str], style: Style) -> bool:
    """Whether a row is one of units; of several cells half may be what no unit is (segments, RN)."""
    # oscilloscopes write a count of samples there besides, or their start and step
    strange = [c for c in cells if not (is_unit(c) or c.lower() == "sequence" or style.is_number(c))]
    if strange:
        others = sum(not named(c, "time") and c.lower().strip(".") != "no" for c in strange)
        return 2 * others <= len(cells) and sum(role_of(c) is not None or is_volts(c) for c in cells) > 1
    return any(cells) and not all(map(style.is_number, cells))


def _bare(cells: list[str]) -> list[str]:
    return [re.sub(r"^[-–]+$|^none$", "", c.strip("[](){}<>")) for c in cells]
