"""One C99 file without dependencies: parameters, state and step of a device, written from its stages."""

import re
import textwrap
from functools import cache
from pathlib import Path

import numpy as np

from bayes_iwan.export.device import Device, rows_of
from bayes_iwan.export.laws import LEAST_STROKE
from bayes_iwan.models.kernels.sliders import MAX_PIECES, OCTAVES

TEMPLATES = Path(__file__).parent / "templates"
#: steps within a step of the solver, and where friction follows the speed besides: so many keep the difference from the
#: forward model below 0.1 % of the friction force at 20 steps a cycle (analyses/export_round_trip.py)
SUBSTEPS, SUBSTEPS_OF_SPEED = 4, 8
NAME: str = "isolator.c"


@cache
def template(name: str) -> str:
    """A file of the templates; Python ones end in .in, so that nobody takes them for modules of the package."""
    return (TEMPLATES / (f"{name}.in" if name.endswith(".py") else name)).read_text(encoding="utf-8")


def filled(text: str, places: dict[str, str]) -> str:
    """A template with every @PLACE@ filled."""
    return re.sub(r"@([A-Z0-9_]+)@", lambda m: places[m.group(1)], text)


def c_source(device: Device, head: str) -> str:
    """The whole file; head : text of its first comment."""
    laws = [code for stage in device.stages.values() for code in stage]
    places = {
        "HEAD": "/*\n" + textwrap.indent(_ascii(head).replace("*/", "* /"), " * ", lambda _: True) + "\n */",
        "SETS": str(device.sets),
        "PIECES": str(MAX_PIECES),
        "OCTAVES": str(OCTAVES),
        "CELLS": str(device.tables.shape[1] // OCTAVES),
        "SUBSTEPS": str(substeps(device)),
        "PARAMETER_FIELDS": "\n".join(
            f"    double {n}{_length(x.shape[1] if x.ndim > 1 else 1)};" for n, x in device.parameters.items()
        ),
        "STATE_FIELDS": "\n".join(f"    double {n}{_length(count)};" for n, (count, _) in device.states.items()),
        "START": "\n".join(f"    s->{n} = {v!r};" for n, (_, v) in device.states.items() if v != 0.0),
        "TABLES": "\n".join(_table(device, i) for i in range(device.sets)),
        "VALUES": ",\n".join(_values(device, i) for i in range(device.sets)),
        "HELPERS": _helpers(laws),
        "ASYMMETRY": " + ".join(device.stages["asymmetry"]) or "0.0",
        "SPECIMEN": _indented(device.stages["specimen"] or ("force = specimen(p, s, h, u, v);",)),
        **{
            stage.upper(): _indented(device.stages[stage])
            for stage in ("before", "alpha", "stiffness", "slip", "force")
        },
    }
    return re.sub(r"\n{3,}", "\n\n", filled(template("core.c"), places))


def substeps(device: Device) -> int:
    """Steps of a device within a step of the solver."""
    return SUBSTEPS_OF_SPEED if device.stages["slip"] else SUBSTEPS


def _ascii(text: str) -> str:
    """C99 compilers need not read other letters."""
    for letter, plain in {"—": "-", "–": "-", "·": "*", "φ": "phi", "α": "alpha", "±": "+-", "≤": "<="}.items():
        text = text.replace(letter, plain)
    return text.encode("ascii", "replace").decode()


def _length(count: int) -> str:
    return "" if count == 1 else f"[{count}]"


def _indented(code: tuple[str, ...]) -> str:
    return textwrap.indent("\n".join(code), "    ")


def _numbers(x: np.ndarray) -> str:
    return ", ".join(f"{v:.17g}" if np.isfinite(v) else "0.0" for v in np.ravel(x))


def _table(device: Device, index: int) -> str:
    rows = ",\n".join("    " + _numbers(row) for row in rows_of(device.tables[index]))
    return f"static const double table_{index}[] = {{\n{rows}\n}};"


def _values(device: Device, index: int) -> str:
    each = [
        "{" + _numbers(x[index]) + "}" if x.ndim > 1 else _numbers(x[index : index + 1])
        for x in device.parameters.values()
    ]
    ends = _numbers(device.top_N[index : index + 1]), _numbers(device.tables[index][-1].sum())
    return "    {" + ", ".join([*each, *ends, f"table_{index}"]) + "}"


@cache
def _library() -> dict[str, str]:
    """The functions of helpers.c by name, in the order in which they are defined."""
    parts = filled(template("helpers.c"), {"LEAST_STROKE": f"{LEAST_STROKE}"}).strip().split("\n\n")[1:]
    return {re.findall(r"^static \w+ (\w+)\(", part, re.M)[0]: part for part in parts}


def _helpers(laws: list[str]) -> str:
    """Those that the laws call, and those that these call, in the order in which they are defined."""
    wanted: set[str] = set()
    texts = list(laws)
    while texts:
        text = texts.pop()
        for name, code in _library().items():
            if name not in wanted and re.search(rf"\b{name}\(", text):
                wanted.add(name)
                texts.append(code)
    return "".join(f"{code}\n\n" for name, code in _library().items() if name in wanted)
