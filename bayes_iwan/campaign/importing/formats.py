"""The binary formats of data-acquisition systems: NI TDMS, universal files (data set 58), MATLAB, Parquet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from bayes_iwan.campaign.importing.matlab_elements import refuse_unsound
from bayes_iwan.campaign.importing.recordings import FEWEST_SAMPLES, Channel, Recording, library
from bayes_iwan.campaign.importing.text import Layout, read_text
from bayes_iwan.campaign.importing.units import split_name
from bayes_iwan.campaign.recording.records import CampaignError, shown

MOST_COLUMNS = 64  # of a MATLAB matrix: a wider one is no set of channels
RATES = {"fs", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "sample_rate_hz", "fsample", "srate"}
#: UFF's "specific data type" of an ordinate, in SI
UFF_UNITS = {8: "m", 9: "N", 12: "m/s2", 13: "N", 15: "Pa"}
UFF_TYPES = {2: "single precision", 4: "double precision", 5: "complex single precision", 6: "complex double precision"}
UFF_FLOATS = {1: "DEC VMS", 2: "IEEE", 3: "IBM 370"}


def read_file(path: Path, layout: Layout) -> list[Recording]:
    """All recordings of a file, whose format its first bytes tell. Raises CampaignError."""
    file = path.name
    try:
        with path.open("rb") as handle:
            start = handle.read(1024)
    except FileNotFoundError:
        raise CampaignError(f"{path}: not found") from None
    except OSError as error:
        raise CampaignError(f"{path}: cannot be read ({error.strerror})") from None
    if not start:
        raise CampaignError(f"{file}: empty")
    if start.startswith(b"TDSm"):
        out = _tdms(path, file)
    elif b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:520]):
        out = [_hdf5(path, file)]
    elif start.startswith(b"MATLAB 5.0") or path.suffix.lower() == ".mat":
        out = [_matlab(path, file)]
    elif start.startswith(b"PAR1"):
        out = [_parquet(path, file)]
    elif start.lstrip(b"\r\n").startswith(b"    -1") or path.suffix.lower() in (".uff", ".unv", ".bunv"):
        out = _uff(path, file)
    elif start.startswith(b"PK\x03\x04"):
        raise CampaignError(f"{file}: an Excel workbook or zip archive; export the sheet as text (CSV)")
    else:
        out = [read_text(path, file, layout)]
    if not any(x.channels for x in out):
        raise CampaignError(f"{file}: no signals of {FEWEST_SAMPLES} samples or more in it")
    return [x for x in out if x.channels]


def _channel(name: str, unit: str, given: ArrayLike, rate: float | None) -> Channel | None:
    """A channel from what a library gave, None for texts, settings and complex numbers."""
    values = np.asarray(given)
    if values.ndim != 1 or values.size < FEWEST_SAMPLES:
        return None
    if np.issubdtype(values.dtype, np.datetime64):
        values = (values - values[0]) / np.timedelta64(1, "s")
        unit = "s"
    if values.dtype.kind not in "iuf":
        return None
    values = values.astype(float)
    if not np.isfinite(values).all():
        values = np.where(np.isfinite(values), values, np.nan)
    if not unit.strip():
        name, unit = split_name(name)
    return Channel(name, unit.strip(), values, rate)


def _tdms(path: Path, file: str) -> list[Recording]:
    nptdms = library("nptdms", "npTDMS", file, "a TDMS file")
    out = []
    try:
        whole = nptdms.TdmsFile.read(path)
        for group in whole.groups():
            channels = []
            for source in group.channels():
                step = source.properties.get("wf_increment")
                rate = 1 / float(step) if step else None
                unit = str(source.properties.get("unit_string", "") or "")
                channels.append(_channel(source.name, unit, source[:], rate))
            out.append(Recording(file, group.name, tuple(c for c in channels if c is not None)))
    except Exception as error:  # a damaged file makes npTDMS fail in many ways
        raise CampaignError(f"{file}: cannot be read as TDMS ({shown(str(error))}); copy or export it again") from None
    out = [x for x in out if x.channels]
    if len(out) == 1:
        return [Recording(file, "", out[0].channels, (f"TDMS, group {out[0].part!r}",))]
    return [Recording(file, x.part, x.channels, ("TDMS",)) for x in out]


def _uff(path: Path, file: str) -> list[Recording]:
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
    for k in sets:
        found = _uff_set(source, k, file)
        if int(found.get("func_type", 1)) not in (0, 1) or np.iscomplexobj(found["data"]):
            notes.append(f"data set {k + 1} is no time history and was left out")
            continue
        name = _uff_name(found)
        unit = _said(found.get("ordinate_axis_units_lab")) or (
            UFF_UNITS.get(int(found.get("ordinate_spec_data_type", 0)), "") if si else ""
        )
        even = int(found["abscissa_spacing"]) == 1
        rate = 1 / float(found["abscissa_inc"]) if even and found["abscissa_inc"] else None
        channel = _channel(name, unit, found["data"], rate)
        if channel is None:
            continue
        if any(c.name == channel.name for c in parts[-1]):
            parts.append([])  # the same channel again: the next run
        if not even and not parts[-1]:
            parts[-1].append(Channel("time", "s", np.asarray(found["x"], dtype=float)))
        parts[-1].append(channel)
    kept = [p for p in parts if p]
    said = ("UFF 58", *notes)
    return [Recording(file, f"run {k}" if len(kept) > 1 else "", tuple(p), said) for k, p in enumerate(kept, 1)]


def _uff_set(source: Any, k: int, file: str) -> Mapping[str, Any]:
    """One data set 58 with as many values as it announces; the message of a failure says which variant it is."""
    variant = "58"
    try:
        head = source.read_sets(k, header_only=True)
        kind = UFF_TYPES.get(int(head["ord_data_type"]), f"ordinate type {head['ord_data_type']}")
        spacing = "even" if int(head["abscissa_spacing"]) == 1 else "uneven"
        variant = f"58, ASCII, {kind}, {spacing} abscissa"
        if head["binary"]:
            order = "little-endian" if int(head["byte_ordering"]) == 1 else "big-endian"
            floats = UFF_FLOATS.get(int(head["fp_format"]), f"float format {head['fp_format']}")
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


def _uff_name(found: Mapping[str, Any]) -> str:
    for key in ("ordinate_axis_lab", "rsp_ent_name", "id1"):
        text = _said(found.get(key))
        if text:
            node = f" {int(found.get('rsp_node', 0))}:{int(found.get('rsp_dir', 0))}"
            return text if key == "ordinate_axis_lab" else text + (node if node != " 0:0" else "")
    return f"{int(found.get('rsp_node', 0))}:{int(found.get('rsp_dir', 0))}"


def _said(text: object) -> str:
    text = str(text or "").strip()
    return "" if text.upper() == "NONE" else text


def _matlab(path: Path, file: str) -> Recording:
    import scipy.io

    try:
        if scipy.io.matlab.matfile_version(path)[0] == 1:
            refuse_unsound(path.read_bytes())
        found = scipy.io.loadmat(path, simplify_cells=True)
    except NotImplementedError:
        return _hdf5(path, file)
    except Exception as error:  # a damaged file makes loadmat fail in many ways
        raise CampaignError(f"{file}: cannot be read as a MATLAB file ({shown(str(error))})") from None
    arrays = _flat("", {k: v for k, v in found.items() if not k.startswith("__")})
    return _of_arrays(file, arrays, "MATLAB")


def _flat(prefix: str, value: object) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, int | float):
        yield prefix, np.asarray(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
        yield prefix, value


def _hdf5(path: Path, file: str) -> Recording:
    import h5py

    arrays: list[tuple[str, np.ndarray]] = []

    def visit(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or item.dtype.kind not in "iuf":
            return
        if item.attrs.get("MATLAB_class", b"double") in (b"char", b"logical", "char", "logical"):
            return
        arrays.append((name.replace("/", "."), item[()].T))  # MATLAB writes columns first

    try:
        with h5py.File(path, "r") as source:
            source.visititems(visit)
    except Exception as error:  # a damaged file makes HDF5 fail in many ways
        raise CampaignError(f"{file}: cannot be read as MATLAB v7.3 or HDF5 ({shown(str(error))})") from None
    return _of_arrays(file, iter(arrays), "MATLAB v7.3 or HDF5")


def _of_arrays(file: str, arrays: Iterator[tuple[str, np.ndarray]], what: str) -> Recording:
    channels: list[Channel | None] = []
    rate = None
    for name, values in arrays:
        values = np.squeeze(values)
        if values.ndim == 0 and name.rsplit(".", 1)[-1].lower() in RATES and float(values) > 0:
            rate = float(values)
        elif values.ndim == 1:
            channels.append(_channel(name, "", values, None))
        elif values.ndim == 2:
            columns = values if values.shape[0] >= values.shape[1] else values.T
            if columns.shape[1] <= MOST_COLUMNS:
                channels += [_channel(f"{name}({k + 1})", "", c, None) for k, c in enumerate(columns.T)]
    kept = [Channel(c.name, c.unit, c.values, rate) for c in channels if c is not None]
    return Recording(file, "", tuple(kept), (what,))


def _parquet(path: Path, file: str) -> Recording:
    library("pyarrow", "pyarrow", file, "a Parquet file")
    try:
        table = pd.read_parquet(path, engine="pyarrow")
    except Exception as error:  # pyarrow's errors are its own
        raise CampaignError(f"{file}: cannot be read as Parquet ({shown(str(error))})") from None
    if not isinstance(table.index, pd.RangeIndex):
        table = table.reset_index()
    channels = [_channel(str(name), "", table[name].to_numpy(), None) for name in table.columns]
    return Recording(file, "", tuple(c for c in channels if c is not None), ("Parquet",))
