"""The base of every error that is the user's to fix, so that a defect of ours is never shown as one."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Something that the user gave cannot be used; one line that says what, where, and how to fix it.

    The command line prints it and exits with 2. Any other exception is a defect of the package, or of a
    Python file of the user's own, and is reported as one.
    """


#: names that a message lists, where there are more
LISTED = 12


def few(names: Iterable[object]) -> str:
    """The first of some names, for a message."""
    there = [str(x) for x in names]
    return ", ".join(there[:LISTED]) + (f" … ({len(there)})" if len(there) > LISTED else "")


def nearest(name: object, known: Iterable[object], otherwise: str | None = None, alike: float = 0.6) -> str:
    """What a message adds to a name that is not known: the known one that was probably meant; where none is near
    `otherwise`, or which there are."""
    there = [str(x) for x in known]
    if near := difflib.get_close_matches(str(name), there, 1, alike):
        return f"; did you mean {near[0]!r}?"
    if otherwise is None and there:
        return f"; there are {few(there)}"
    return otherwise or ""


def not_utf8(error: UnicodeDecodeError) -> str:
    """What a message says behind the name of a text file that is in another encoding: where, and what to do."""
    return f"line {error.object.count(10, 0, error.start) + 1}: not UTF-8; encoding cp1252? Save it as UTF-8"
