"""The one way against the street: a result draws itself by asking the report room, which stands at its end.

Results of the inner rooms have methods that plot (`posterior.plot_corner()`); matplotlib and the figures stay in
`report/` and are found by name when they are asked for.
"""

from __future__ import annotations

import importlib
from typing import Any


def draw(name: str, *arguments: Any, **options: Any) -> Any:
    """What the function `name` of :mod:`bayes_iwan.report` returns, a figure or a path."""
    return getattr(importlib.import_module("bayes_iwan.report"), name)(*arguments, **options)


def exported(result: Any, to: str, out: Any, **options: Any) -> Any:
    """What :func:`bayes_iwan.export.export` makes of a result, likewise."""
    return importlib.import_module("bayes_iwan.export").export(result, to, out, **options)
