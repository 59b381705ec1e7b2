"""Rows whose cells carry more than numbers: "t:0.1,force:3.2" and "12:00:01.003 -> 0.1,3.2" of serial monitors, JSON
lines, "0.1 s; 3.2 N", and rows that are one quoted cell. They are turned into rows of numbers below one of names or
units."""

import re

from bayes_iwan.campaign.importing.formats.stamps import is_stamp
from bayes_iwan.campaign.importing.formats.text_layout import MARKS, THOUSANDS
from bayes_iwan.campaign.importing.unit_texts import is_unit

#: non-empty lines from the end of the sample that are looked at, and the share of them that must be alike
LOOKED_AT, ALIKE = 200, 0.95
_NUMBER = r"[+-]?(?:\d[\d.,]*|\.\d+)(?:[eE][+-]?\d+)?"
_STAMP = re.compile(r"(?m)^\d\d:\d\d:\d\d(?:[.,]\d+)? -> ")
#: rows of serial monitors and of JSON, and what stands around their numbers
_AROUND = (_STAMP, _STAMP), (re.compile(r"\{.*\},?\s*$"), re.compile(r"[{}\"]"))
#: a table that a spreadsheet took for one column and wrote in quotes
_ONE_CELL = re.compile(r"(?m)^([\"'])((?:(?!\1).|\1\1)*)\1[,;\t ]*$")
_PAIR = re.compile(rf"([^\W\d][\w ]*?)\s*[:=]\s*({_NUMBER.replace('.,', '.')})(?:[,;\t ]+|$)")
_PLAIN = re.compile(rf"\s*{_NUMBER}\s*")
_WITH_UNIT = re.compile(rf"\s*({_NUMBER})\s*([^\W\d_][^\s,;]*|°|%)\s*")


def plain_rows(text: str) -> str:
    """A text with its labels and units moved from the rows of numbers to a row above these."""
    sample = [line for line in text[-65536:].split("\n")[1 if len(text) > 65536 else 0 :] if line.strip()][-LOOKED_AT:]
    cells, one_number = [m[2] for x in sample if (m := _ONE_CELL.fullmatch(x))], (*MARKS.values(), *THOUSANDS.values())
    if sum(not any(number.fullmatch(x) for number in one_number) for x in cells) > len(sample) / 2:
        return plain_rows(_ONE_CELL.sub(lambda m: m[2].replace(m[1] * 2, m[1]), text))
    for rows, dropped in _AROUND:
        if len(sample) > 8 and sum(bool(rows.match(x)) for x in sample) >= ALIKE * len(sample):
            text, sample = dropped.sub("", text), [dropped.sub("", x) for x in sample]
    for read in (_labels, *(lambda line, s=s: _units(line, s) for s in (";", "\t", ","))):
        found = [read(x) for x in sample]
        if found and (first := found[len(found) // 2]) and found.count(first) >= ALIKE * len(found):
            return _rewritten(text, read, first)
    return text


def _labels(line: str) -> tuple[str, ...]:
    pairs = _PAIR.findall(line)
    return ("\t", *(name for name, _ in pairs)) if len(pairs) > 1 and not _PAIR.sub("", line).strip() else ()


def _units(line: str, separator: str) -> tuple[str, ...]:
    cells = line.split(separator)
    plain = [bool(_PLAIN.fullmatch(x)) or is_stamp(x.strip(' "')) for x in cells]
    found = [None if p else _WITH_UNIT.fullmatch(x) for x, p in zip(cells, plain)]
    fits = all(p or (m is not None and is_unit(m[2])) for p, m in zip(plain, found))
    return (separator, *(m[2] if m else "" for m in found)) if len(cells) > 1 and any(found) and fits else ()


def _rewritten(text: str, read, head: tuple[str, ...]) -> str:  # type: ignore[no-untyped-def]
    out, above = [], False
    for line in text.split("\n"):
        if line.strip() and read(line) == head:
            if not above:
                out.append(head[0].join(head[1:]))
                above = True
            pairs = _PAIR.findall(line)
            cells = [x if _PLAIN.fullmatch(x) else _WITH_UNIT.sub(r"\1", x) for x in line.split(head[0])]
            cells = [x for _, x in pairs] if len(pairs) > 1 else cells
            line = head[0].join(cells)
        out.append(line)
    return "\n".join(out)
