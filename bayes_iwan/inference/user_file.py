"""Classes of a user's own, from a Python file. Reading it runs the user's code."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import sys
from pathlib import Path
from typing import TypeVar

from bayes_iwan.physics import ModelError, Simulator

T = TypeVar("T")


def classes_in(path: str | os.PathLike[str], base: type[T], error: type[ValueError]) -> tuple[type[T], ...]:
    """The subclasses of `base` that a Python file defines. Raises `error` naming the file and the mend."""
    path = Path(path)
    if not path.is_file():
        raise error(f"{path}: no such file")
    # a name of its own by place: files of one name do not meet, and a class knows its module (dataclasses ask for it)
    name = f"bayes_iwan_user_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise error(f"{path}: not a Python file (it must end in .py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as problem:
        del sys.modules[name]
        raise error(f"{path}: cannot be run: {type(problem).__name__}: {problem}") from problem
    return tuple(
        v for v in vars(module).values() if isinstance(v, type) and issubclass(v, base) and v.__module__ == name
    )


def load_simulator(path: str | os.PathLike[str]) -> Simulator:
    """The simulator that a user's Python file defines: its one class that can be made without arguments.

    Raises ModelError naming the file and the mend.
    """
    defined = classes_in(path, Simulator, ModelError)  # type: ignore[type-abstract]
    found = [c for c in defined if not c.__name__.startswith("_")]
    if len(found) != 1:
        many = ", ".join(c.__name__ for c in found)
        raise ModelError(
            f"{path}: defines "
            + (f"several simulators ({many}); leave one" if found else "no subclass of bayes_iwan.Simulator")
        )
    (kind,) = found
    if inspect.isabstract(kind):
        raise ModelError(f"{path}: {kind.__name__} lacks {', '.join(sorted(kind.__abstractmethods__))}")
    try:
        simulator = kind()
    except TypeError as problem:
        raise ModelError(f"{path}: {kind.__name__}() must work without arguments: {problem}") from None
    if not (isinstance(simulator.name, str) and simulator.name.isidentifier()):
        raise ModelError(f"{path}: {kind.__name__}.name = {simulator.name!r} must be one word, as a variable's")
    return simulator
