"""The two array types that every folder speaks of, and how what holds arrays is shown on one screen."""

from __future__ import annotations

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


def wrapped(text: str, width: int = 100) -> str:
    """A long text in lines of a screen's width, the following ones set in."""
    return "\n".join(textwrap.wrap(text, width, subsequent_indent="    ", drop_whitespace=True))


def brief(self: Any) -> str:
    """The `__repr__` of a dataclass that holds arrays or many items: a line a field, arrays by their shape."""
    shown = (f"  {f.name}={_brief(getattr(self, f.name))}," for f in fields(self) if f.repr)
    return "\n".join((f"{type(self).__name__}(", *shown, ")"))


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"array of {value.dtype} {value.shape}" if value.size > 4 else repr(value)
    if isinstance(value, Collection) and not isinstance(value, str) and len(value) > 0:
        few = ", ".join(map(str, list(value)[:4])) if isinstance(next(iter(value)), str) else ""
        few += ", …" if few and len(value) > 4 else ""
        return f"{len(value)} in a {type(value).__name__}" + (f": {few}" if few else "")
    text = f"{type(value).__name__}(…)" if is_dataclass(value) else " ".join(repr(value).split())
    return text if len(text) <= 90 else text[:89] + "…"
