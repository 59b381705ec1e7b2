"""Universal files, data set 58 (time histories), read by pyuff."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.campaign.importing.recordings import Channel, Recording, axis, channel, library
from bayes_iwan.campaign.importing.unit_texts import role_of
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.unapplied import not_applied

#: "specific data type" of an ordinate, in SI
UNITS = {8: "m", 9: "N", 12: "m/s2", 13: "N", 15: "Pa"}
TYPES = {2: "single precision", 4: "double precision", 5: "complex single precision", 6: "complex double precision"}
FLOATS = {1: "DEC VMS", 2: "IEEE", 3: "IBM 370"}


def read_uff(path: Path, file: str) -> list[Recording]:
    """One recording a run: a channel that comes again begins the next."""
    pyuff = library("pyuff", "pyuff", file, "a universal file (UFF)")
    try:
        source = pyuff.UFF(str(path))
        types = [int(x) for x in source.get_set_types()]
        si = any(source.read_sets(k).get("units_code") == 1 for k, x in enumerate(types) if x == 164)
    except Exception as error:  # pyuff raises plain Exception
        raise CampaignError(f"{file}: cannot be read as a universal file ({shown(str(error))})") from None
    sets = [k for k, x in enumerate(types) if x == 58]
    if not sets:
        others = ", ".join(str(x) for x in sorted(set(types))) or "none"
        raise CampaignError(f"{file}: no data set 58 (signals); the file has {others}. Export time histories as UFF 58")
    parts: list[list[Channel]] = [[]]
    notes = []
    said: tuple[str, ...] = ()
    for k in sets:
        found = _data_set(source, k, file)
        if int(found.get("func_type", 1)) not in (0, 1) or np.iscomplexobj(found["data"]):
            notes.append(f"data set {k + 1} is no time history and was dropped")
            continue
        unit = _said(found.get("ordinate_axis_units_lab")) or (
            UNITS.get(int(found.get("ordinate_spec_data_type", 0)), "") if si else ""
        )
        even, clock = int(found["abscissa_spacing"]) == 1, _said(found.get("abscissa_axis_units_lab"))
        clock = clock if role_of(clock) == "time" else "s"
        said += not_applied(_said(found.get(f"id{k}")) for k in range(1, 6))
        rate, start = axis(found["abscissa_inc"], found.get("abscissa_min") or 0.0, clock, f"{file}: abscissa")
        one = channel(_name(found), unit, found["data"], rate if even else None, start if even else None)
        if one is None:
            continue
        if any(c.name == one.name for c in parts[-1]):
            parts.append([])  # the same channel again: the next run
        if not even:  # each channel keeps the abscissa that stands beside it
            one = replace(one, group=f"data set {k + 1}")
            parts[-1].append(Channel("time", clock, np.asarray(found["x"], dtype=float), group=one.group))
        parts[-1].append(one)
    kept = [p for p in parts if p]
    names = [f"run {k}" if len(kept) > 1 else "" for k in range(1, len(kept) + 1)]
    return [Recording(file, name, tuple(p), ("UFF 58", *notes), warnings=said) for name, p in zip(names, kept)]


def _data_set(source: Any, k: int, file: str) -> Mapping[str, Any]:
    """One data set 58 with as many values as it announces; the message of a failure says which variant it is."""
    variant = "58"
    try:
        head = source.read_sets(k, header_only=True)
        kind = TYPES.get(int(head["ord_data_type"]), f"ordinate type {head['ord_data_type']}")
        spacing = "even" if int(head["abscissa_spacing"]) == 1 else "uneven"
        variant = f"58, ASCII, {kind}, {spacing} abscissa"
        if head["binary"]:
            order = "little-endian" if int(head["byte_ordering"]) == 1 else "big-endian"
            floats = FLOATS.get(int(head["fp_format"]), f"float format {head['fp_format']}")
            variant = f"58b, {order}, {floats}, {kind}, {spacing} abscissa"
            if int(head["fp_format"]) != 2:
                raise CampaignError("floats that are not IEEE")
        found = source.read_sets(k)
        n, wanted = len(found["data"]), int(head["num_pts"])
        if n < wanted:
            raise CampaignError(f"{n} of {wanted} values")
    except Exception as error:  # pyuff raises plain Exception
        raise CampaignError(
            f"{file}: data set {k + 1} ({variant}) cannot be read ({shown(str(error))}); export it as 58 ASCII, double "
            "precision"
        ) from None
    return {**found, "data": found["data"][:wanted], "x": None if found["x"] is None else found["x"][:wanted]}


def _name(found: Mapping[str, Any]) -> str:
    for key in ("ordinate_axis_lab", "rsp_ent_name", "id1"):
        text = _said(found.get(key))
        if text:
            node = f" {int(found.get('rsp_node', 0))}:{int(found.get('rsp_dir', 0))}"
            return text if key == "ordinate_axis_lab" else text + (node if node != " 0:0" else "")
    return f"{int(found.get('rsp_node', 0))}:{int(found.get('rsp_dir', 0))}"


def _said(text: object) -> str:
    text = str(text or "").strip()
    return "" if text.upper() == "NONE" else text
