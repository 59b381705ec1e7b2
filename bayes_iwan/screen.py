"""How results show themselves: on one screen, as a table where they hold many of a kind, and so in a notebook too."""

import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, TypeVar

import numpy as np

from bayes_iwan.errors import nearest

#: lines of a screen that a result may fill, characters of a line, of a field's value in it, and of a table's cell
LINES, WIDE, LONGEST, CELL = 24, 100, 70, 30
_SCALARS = (str, bool, int, float, type(None), np.generic)
T = TypeVar("T")


def wrapped(text: str, width: int = WIDE) -> str:
    """A long text in lines of a screen's width, the following ones set in."""
    return "\n".join(textwrap.wrap(text, width, subsequent_indent="    ", drop_whitespace=True))


def screen(head: Iterable[str], rows: Sequence[str], tail: Iterable[str] = (), where: str = "") -> str:
    """Lines that fit a screen: all of head and tail, if these do, and as many rows as they leave space for.

    head, tail : texts, which are wrapped. where : says of rows that do not fit where they are.
    """
    first, last = ["\n".join(map(wrapped, x)).splitlines() for x in (head, tail)]
    space = max(LINES - len(first) - len(last), 2)
    shown = [_cut(row, WIDE) for row in (rows if len(rows) <= space else rows[: space - 1])]
    if more := len(rows) - len(shown):
        shown.append(f"  … and {more} more" + (f", all in {where}" if where else ""))
    lines = [*first, *shown, *last]
    return "\n".join(lines if len(lines) <= LINES else [*lines[: LINES - 1], "  …"])


def as_html(self: object) -> str:
    """The `_repr_html_` of what shows itself as aligned lines."""
    return f"<pre>{escape(repr(self))}</pre>"


def on_screen(kind: type[T]) -> type[T]:
    """A dataclass (this stands below `@dataclass`) that shows itself on one screen, and so do the tuples and dicts that
    it holds. What it defines itself stands."""
    for name, method in (("__repr__", brief), ("_repr_html_", as_html)):
        if name not in vars(kind):
            setattr(kind, name, method)
    check = vars(kind).get("__post_init__")

    def __post_init__(self: Any) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if (held := listed(value)) is not value:
                object.__setattr__(self, f.name, held)
        if check is not None:
            check(self)

    setattr(kind, "__post_init__", __post_init__)  # noqa: B010
    return kind


def listed(value: Any) -> Any:
    """A tuple or dict as one that shows itself; arrays, alone or in a tuple, as they are: they go to compiled code."""
    if type(value) is dict and value:
        return Named({key: listed(x) for key, x in value.items()})
    if type(value) is tuple and value and not all(isinstance(x, np.ndarray | float | int) for x in value):
        return Listed(map(listed, value))
    return value


class Listed(tuple[T, ...]):
    """A tuple of results, or of sentences, that shows itself as a table or a line each where one line is too short."""

    __slots__ = ()

    def __repr__(self) -> str:
        return _many(tuple.__repr__(self) if all(isinstance(x, _SCALARS) for x in self) else "", None, self)

    _repr_html_ = as_html


K = TypeVar("K")


class Named(dict[K, T]):
    """A dict of results by name that shows itself as a table or a line each where one line is too short; of a name
    that it does not have it says which was probably meant."""

    def __missing__(self, key: K) -> T:
        raise KeyError(f"{key!r}{nearest(key, self)}")

    def __repr__(self) -> str:
        whole = all(isinstance(x, _SCALARS) for x in self.values())
        return _many(dict.__repr__(self) if whole else "", list(map(str, self)), list(self.values()))

    _repr_html_ = as_html


def _many(line: str, names: Sequence[str] | None, values: Sequence[Any]) -> str:
    if line and len(line) <= WIDE:
        return line
    kinds = {type(x) for x in values}
    if len(kinds) == 1 and is_dataclass(kind := next(iter(kinds))) and kind.__repr__ is brief:
        columns = [f.name for f in fields(kind) if f.repr]
        cells = [[getattr(x, c) for c in columns] for x in values]
        if names is not None:
            columns, cells = ["", *columns], [[name, *row] for name, row in zip(names, cells)]
        return table(columns, cells)
    texts = [x if isinstance(x, str) else _brief(x) for x in values]
    if names is None:
        return screen(texts, ()) if kinds == {str} else screen((), texts)
    wide = min(max(map(len, names), default=0), CELL)
    return screen((), [f"{_cut(name, CELL):{wide}s}  {text}" for name, text in zip(names, texts)])


def table(columns: Sequence[str], rows: Iterable[Sequence[object]], where: str = "") -> str:
    """Aligned columns, as many as a line has space for, the first one a name."""
    cells = [[_cut(_cell(x), CELL if i else 2 * CELL) for i, x in enumerate(row)] for row in rows]
    wide = [max(map(len, column)) for column in zip(columns, *cells)]
    kept = max(1, int(np.searchsorted(np.cumsum(wide) + 2 * np.arange(len(wide)), WIDE - 3, side="right")))
    numbers = [any(row[i][:1].isdigit() or row[i][:1] == "-" for row in cells) for i in range(len(wide))]

    def line(texts: Sequence[str]) -> str:
        put = [f"{x:>{w}s}" if i and n else f"{x:{w}s}" for i, (x, w, n) in enumerate(zip(texts, wide, numbers))]
        return ("  ".join(put[:kept]) + ("  …" if kept < len(wide) else "")).rstrip()

    return screen((), [line(columns), *map(line, cells)], where=where)


def brief(self: Any) -> str:
    """The `__repr__` of a dataclass that may hold arrays or many items: on one line where that is short, else a line a
    field, arrays by their shape."""
    shown = [f"{f.name}={_brief(getattr(self, f.name))}" for f in fields(self) if f.repr]
    line = f"{type(self).__name__}({', '.join(shown)})"
    if len(line) <= WIDE - 2 and "\n" not in line:
        return line
    return screen((f"{type(self).__name__}(",), [f"  {x}," for x in shown], (")",))


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
        kind = "dict" if isinstance(value, Mapping) else "tuple" if isinstance(value, tuple) else type(value).__name__
        return _cut(f"{len(value)} in a {kind}" + (f": {few}" if few else ""))
    text = repr(value)
    if is_dataclass(value) and ("\n" in text or len(text) > LONGEST):
        return f"{type(value).__name__}(…)"
    return _cut(" ".join(text.split()))


def _cell(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.4g}"
    return "" if value is None else _brief(value)


def _cut(text: str, longest: int = LONGEST) -> str:
    return text if len(text) <= longest else text[: longest - 1] + "…"
