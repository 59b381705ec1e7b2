"""Arguments of public functions, checked: a wrong one is an InputError of one line that names it and says what it must
be."""

import operator
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError

Kind = TypeVar("Kind")
#: the largest seed that files can hold
LARGEST_SEED = 2**63 - 1
CAMPAIGN = "one campaign: its folder's path, or what read_campaign returns"


def shown(value: object) -> str:
    """A value of any kind and size as text of one short line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits
        text = type(value).__name__
    return text if len(text) <= 60 else text[:57] + "..."


def path_of(given: object, argument: str, what: str = "one path") -> Path:
    """A path, given as text or as a Path; what : what the argument must be, in words."""
    if not isinstance(given, str | os.PathLike):
        raise InputError(f"{argument} must be {what}, not {shown(given)}")
    return Path(given)


def classes_of(given: object, argument: str, base: type[Kind]) -> tuple[type[Kind], ...] | str | os.PathLike[str]:
    """Classes of a user's own, or the path of the Python file that defines them."""
    if isinstance(given, str | os.PathLike):
        return given
    kinds = tuple(given) if isinstance(given, Sequence) else (given,)
    for kind in kinds:
        if not (isinstance(kind, type) and issubclass(kind, base)):
            raise InputError(
                f"{argument} must be classes of your own ({base.__name__}) or the path of the Python file that defines "
                f"them, not {shown(kind)}; those of the catalogue need not be named"
            )
    return kinds


def whole(given: object, argument: str, least: int, most: int | None = None) -> int:
    """A whole number from `least` to `most`."""
    upto = "or more" if most is None else f"to {most}"
    try:
        number = operator.index(given)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if number < least or (most is not None and number > most):
        raise InputError(f"{argument} must be a whole number, {least} {upto}, not {shown(given)}")
    return number


def seed_of(given: object) -> int:
    """A seed, as files can hold it."""
    return whole(given, "seed", 0, LARGEST_SEED)


def level_of(given: object) -> float:
    """The level of an interval, a share."""
    if not (isinstance(given, int | float | np.floating) and 0.0 < given < 1.0):
        raise InputError(f"level must be between 0 and 1, such as 0.9 for 90 %, not {shown(given)}")
    return float(given)


def positive(given: object, argument: str) -> Array:
    """Positive numbers."""
    values = np.asarray(given, dtype=float)
    if not (sound := np.isfinite(values) & (values > 0.0)).all():
        raise InputError(f"{argument} = {values[~sound][0]:g}: it must be a positive number")
    return values
