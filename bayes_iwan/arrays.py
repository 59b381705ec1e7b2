"""The two array types that every folder speaks of, and how what holds arrays is shown on one screen."""

import textwrap
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: real numbers in double precision, of any shape
Array = NDArray[np.float64]
#: values by name, (draws,) each
ParameterValues = Mapping[str, Array]


WIDE, LONGEST = 98, 70  # characters of a line, and of one field's value in it


def wrapped(text: str, width: int = 100) -> str:
    """A long text in lines of a screen's width, the following ones set in."""
    return "\n".join(textwrap.wrap(text, width, subsequent_indent="    ", drop_whitespace=True))


def brief(self: Any) -> str:
    """The `__repr__` of a dataclass that may hold arrays or many items: on one line where that is short, else a line a
    field, arrays by their shape."""
    shown = [f"{f.name}={_brief(getattr(self, f.name))}" for f in fields(self) if f.repr]
    line = f"{type(self).__name__}({', '.join(shown)})"
    if len(line) <= WIDE and "\n" not in line:
        return line
    return "\n".join((f"{type(self).__name__}(", *(f"  {x}," for x in shown), ")"))


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"array of {value.dtype} {value.shape}" if value.size > 4 else " ".join(repr(value).split())
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple) and 0 < len(value) <= 6 and all(isinstance(x, int | float) for x in value):
        return f"({', '.join(map(_brief, value))})"
    if isinstance(value, Collection) and not isinstance(value, str) and len(value) > 0:
        few = ", ".join(map(str, list(value)[:4])) if isinstance(next(iter(value)), str) else ""
        few += ", …" if few and len(value) > 4 else ""
        return _cut(f"{len(value)} in a {type(value).__name__}" + (f": {few}" if few else ""))
    text = repr(value)
    if is_dataclass(value) and ("\n" in text or len(text) > LONGEST):
        return f"{type(value).__name__}(…)"
    return _cut(" ".join(text.split()))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
