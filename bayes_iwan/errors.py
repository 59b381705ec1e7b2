"""The base of every error that is the user's to fix, so that a defect of ours is never shown as one."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Something that the user gave cannot be used; one line that says what, where, and how to fix it.

    The command line prints it and exits with 2. Any other exception is a defect of the package and is reported as one.
    """


def nearest(name: object, known: Iterable[str], otherwise: str = "", alike: float = 0.6) -> str:
    """What a message adds of the known name that was probably meant; `otherwise` where none is near."""
    near = difflib.get_close_matches(str(name), list(known), 1, alike)
    return f"; did you mean {near[0]!r}?" if near else otherwise
