"""Classes of a user's own, from a Python file. Reading it runs the user's code."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from bayes_iwan.models import ModelError, Simulator

T = TypeVar("T")

_NAMED = "bayes_iwan_user_"


def classes_in(path: str | os.PathLike[str], base: type[T], error: type[ValueError]) -> tuple[type[T], ...]:
    """The subclasses of `base` that a Python file defines. Raises `error` naming the file and the fix."""
    path = Path(path)
    if not path.is_file():
        raise error(f"{path}: no such file")
    # a name of its own by place: files of one name do not meet, and a class knows its module (dataclasses ask for it)
    name = f"{_NAMED}{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}_{path.stem}"
    module = _run(name, path, error)
    return tuple(
        v for v in vars(module).values() if isinstance(v, type) and issubclass(v, base) and v.__module__ == name
    )


def file_of(kind: type) -> Path | None:
    """The user's file that a class was read from by :func:`classes_in`, None for any other class."""
    module = kind.__module__
    return Path(str(sys.modules[module].__file__)).resolve() if module.startswith(_NAMED) else None


def place_in(error: BaseException) -> str:
    """The line of a user's own file that an exception came through last; "" for one that came through none."""
    places = [
        f"{Path(frame.f_code.co_filename).name}, line {line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__", "")).startswith(_NAMED)
    ]
    return places[-1] if places else ""


def _run(name: str, path: Path, error: type[ValueError]) -> ModuleType:
    """A Python file as a module of this name."""
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
    return module


@dataclass(frozen=True)
class UserFiles:
    """A user's own files by the names of their modules, which another process needs for objects of their classes.

    Reading it from what another process sent runs the files there, so that whatever follows it can be read.
    """

    paths: tuple[tuple[str, Path], ...]

    @classmethod
    def of(cls, objects: Iterable[object]) -> UserFiles:
        """The files that the classes of these objects come from."""
        names = sorted({type(x).__module__ for x in objects if type(x).__module__.startswith(_NAMED)})
        return cls(tuple((name, Path(str(sys.modules[name].__file__)).resolve()) for name in names))

    def __reduce__(self) -> tuple[Callable[..., UserFiles], tuple[object, ...]]:
        return _with_files, (self.paths,)


def _with_files(paths: tuple[tuple[str, Path], ...]) -> UserFiles:
    for name, path in paths:
        if name not in sys.modules:
            _run(name, path, ModelError)
    return UserFiles(paths)


def load_simulator(path: str | os.PathLike[str]) -> Simulator:
    """The simulator that a user's Python file defines: its one class that can be made without arguments.

    Raises ModelError naming the file and the fix.
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
    if not (isinstance(simulator.name, str) and simulator.name.isidentifier()):  # type: ignore[redundant-expr]
        raise ModelError(f"{path}: {kind.__name__}.name = {simulator.name!r} must be one word, as a variable's")
    return simulator
