"""MATLAB files: SciPy for versions 4 to 7, h5py for 7.3 and any HDF5, mat-io for tables and timetables.

Arrays inside structs, struct arrays and cells are channels named by the way to them, `run(2).force`, `runs(1)(3)`, or
by what a text beside them says.
"""

import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bayes_iwan.campaign.importing.clock_words import STARTS, THINNED, stated_rates
from bayes_iwan.campaign.importing.formats.stamps import seconds
from bayes_iwan.campaign.importing.recordings import (
    FEWEST_SAMPLES,
    Channel,
    NoSignals,
    Recording,
    channel,
    from_first,
    library,
    only_rate,
)  # fmt: skip
from bayes_iwan.campaign.importing.scaling import YEARS_S
from bayes_iwan.campaign.importing.unit_texts import is_unit
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.unapplied import not_applied

MOST_COLUMNS = 64  # of a matrix: a wider one is no set of channels
DEEPEST = 20  # of structs and cells within each other
LATEST_S = 1e5  # what is more is a date: in seconds since 1970, or of no unit that is known
PACKED = {"scale_factor": 1, "add_offset": 0}  # by which the conventions of netCDF pack numbers, with their neutrals
LABELS = {"name", "label", "title", "unit", "units", "signalname"}
Said = TypeVar("Said", float, str)
_ARRAY, _COMPRESSED = 14, 15
_KINDS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _ARRAY, _COMPRESSED, 16, 17, 18}
_HEADER = 128
_DEEPEST = 100
SAVE = (
    "in MATLAB: save(file, '-struct', 's') with numeric vectors in s (of a table T: s = table2struct(T, 'ToScalar', "
    "true))"
)


def read_matlab(path: Path, file: str) -> list[Recording]:
    """The arrays of a MATLAB file of any version."""
    import scipy.io

    try:
        if scipy.io.matlab.matfile_version(path)[0] == 1:
            _refuse_unsound(path.read_bytes())
        found = scipy.io.loadmat(path, simplify_cells=True)
    except NotImplementedError:
        return read_hdf5(path, file)
    except Exception as error:  # a damaged file makes loadmat fail in many ways
        raise CampaignError(f"{file}: cannot be read as a MATLAB file ({shown(str(error))})") from None
    if "__function_workspace__" in found:
        found = _objects(path, file)
    found = {k: v for k, v in found.items() if not k.startswith("__")}
    return of_variables(file, found, "MATLAB", f"the file holds {_kinds(found)}; save numbers as vectors ({SAVE})")


def of_variables(file: str, found: Any, what: str, otherwise: str) -> list[Recording]:
    """The arrays of variables within each other, as channels of recordings; raises CampaignError, with what to do
    otherwise, where there are none."""
    held = list(flat("", found, 0))
    arrays = [(k, v) for k, v in held if not isinstance(v, str)]
    texts = {k: v for k, v in held if isinstance(v, str)}
    return _recordings(file, arrays, what, otherwise, texts)


def read_hdf5(path: Path, file: str) -> list[Recording]:
    """The arrays of a MATLAB 7.3 file or any other HDF5 file."""
    import h5py

    arrays: list[tuple[str, np.ndarray]] = []
    objects: set[str] = set()
    texts: dict[str, str] = {}

    def stated(name: str, item: Any) -> None:
        """Numbers and texts that are stated of a dataset or group, read as those beside it are."""
        said = {f"{name.replace('/', '.')}.{k}".strip("."): x for k, x in item.attrs.items() if k not in PACKED}
        arrays.extend(
            (k, np.asarray(x)) for k, x in said.items() if np.size(x) == 1 and np.asarray(x).dtype.kind in "iuf"
        )
        texts.update({k: _text(x) for k, x in said.items() if isinstance(x, bytes | str)})

    def visit(name: str, item: Any, depth: int = 0) -> None:
        if isinstance(item, h5py.Group):
            stated(name, item)
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or depth > DEEPEST:
            return
        name = name.replace("/", ".")
        kind = _text(item.attrs.get("MATLAB_class", b"double"))
        if "MATLAB_object_decode" in item.attrs and kind not in ("cell", "struct"):
            objects.add(kind)
        elif h5py.check_ref_dtype(item.dtype) is h5py.Reference:  # a cell, or one field of a struct array
            stem, dot, field = name.rpartition(".")
            for k, reference in enumerate(item[()].T.flat, 1):
                inner = item.file[reference]
                below = f"{stem}({k}).{field}" if dot and kind != "cell" else f"{name}({k})"
                if isinstance(inner, h5py.Group):
                    inner.visititems(lambda n, x, below=below: visit(f"{below}.{n}", x, depth + 1))
                visit(below, inner, depth + 1)
        elif item.dtype.kind in "iuf" and kind not in ("char", "logical"):
            size, zero = (item.attrs.get(k, neutral) for k, neutral in PACKED.items())
            values = item[()].T  # MATLAB writes columns first
            arrays.append((name, values if size == 1 and zero == 0 else values * size + zero))
            stated(name, item)
        elif item.dtype.names == ("real", "imag"):
            values = item[()].T
            arrays.append((name, values["real"] + 1j * values["imag"]))
        elif item.dtype.names and item.ndim == 1:  # a table, as PyTables and pandas write it
            arrays.extend((f"{name}.{field}", item[field]) for field in item.dtype.names)

    try:
        with h5py.File(path, "r") as source:
            stated("", source)
            source.visititems(visit)
    except Exception as error:  # a damaged file makes HDF5 fail in many ways
        raise CampaignError(f"{file}: cannot be read as MATLAB v7.3 or HDF5 ({shown(str(error))})") from None
    if objects:  # tables; what mat-io cannot read may stand beside arrays
        with suppress(CampaignError):
            return of_variables(file, _objects(path, file), "MATLAB v7.3", SAVE)
    held = ", ".join(sorted(objects)) or "no such arrays"
    return _recordings(
        file,
        arrays,
        "MATLAB v7.3 or HDF5",
        f"it holds {held[:200]}; save numbers as vectors ({SAVE}), or save with -v7",
        texts,
    )


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _objects(path: Path, file: str) -> dict[str, Any]:
    """The variables of a file with tables, timetables or other objects, which SciPy does not open."""
    matio = library("matio", "mat-io", file, "a MATLAB table")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pandas' options that it sets
            found: dict[str, Any] = matio.load_from_mat(path)
    except Exception as error:
        raise CampaignError(
            f"{file}: a MATLAB table or other object that cannot be read ({shown(str(error))}); save it {SAVE}"
        ) from None
    return found


def _kinds(found: dict[str, Any]) -> str:
    some = [f"{k} ({type(v).__name__})" for k, v in found.items() if not k.startswith("__")]
    text = ", ".join(some) or "no variables"
    return text if len(text) <= 200 else text[:197] + "..."


def _said_of(arrays: list[tuple[str, np.ndarray]], texts: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Units and names that a file's texts say of single arrays, as Simulink, dSPACE and Testlab write them: `label`,
    `Name`, `Unit` in the struct of one array, or anywhere in a variable that holds no other, or `units.force`."""
    said = {k: t.strip() for k, t in texts.items() if _leaf(k) in LABELS and t.strip()}
    said = {k: t.partition(" since ")[0] for k, t in said.items()}  # as netCDF writes moments
    of_units = {k: t for k, t in said.items() if is_unit(t) or _leaf(k) in ("unit", "units")}
    vectors = [k for k, v in arrays if np.size(v) > 1]
    of_names = {k: t for k, t in said.items() if k not in of_units and k.rpartition(".")[0] not in vectors}
    apart = {_leaf(k): t.strip() for k, t in texts.items() if _leaf(k.rpartition(".")[0]) in ("unit", "units")}
    units, names = {k: apart[_leaf(k)] for k in vectors if _leaf(k) in apart}, {}
    for name in vectors:
        group, top = name.rpartition(".")[0], name.partition(".")[0]
        if sum(k.rpartition(".")[0] == group for k in vectors) > 1:
            group = ""
        alone = bool(group) and sum(k.partition(".")[0] == top for k in vectors) == 1
        unit, names[name] = (_beside(x, name, group, alone) or "" for x in (of_units, of_names))
        units[name] = unit or units.get(name, "")
    return units, names


def flat(prefix: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """Numeric arrays, numbers and texts with the way to each."""
    if depth > DEEPEST:
        return
    if hasattr(value, "columns") and hasattr(value, "to_numpy"):  # a table or timetable, by mat-io
        if type(value.index).__name__ != "RangeIndex":
            value = value.reset_index()
        value = {str(name): value[name].to_numpy() for name in value.columns}
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flat(f"{prefix}.{key}" if prefix else str(key), inner, depth + 1)
    elif isinstance(value, str):
        yield prefix, value
    elif isinstance(value, int | float):
        yield prefix, np.asarray(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "iufcmM":
        yield prefix, value
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for k, inner in enumerate(value if isinstance(value, list) else value.flat, 1):
            yield from flat(f"{prefix}({k})", inner, depth + 1)


def _recordings(
    file: str,
    arrays: list[tuple[str, np.ndarray]],
    what: str,
    otherwise: str,
    texts: Mapping[str, str],
) -> list[Recording]:
    units, names = _said_of(arrays, texts)
    plain, first = from_first([v for _, v in arrays])
    arrays = [(k, x) for (k, _), x in zip(arrays, plain)]
    channels: list[Channel | None] = []
    rate = None
    numbers = {k: float(np.real(np.ravel(v)[0])) for k, v in arrays if np.size(v) == 1}
    own_rates = {k: r for k, x in numbers.items() if (r := only_rate(stated_rates([f"{_leaf(k)} = {x!r}"])))}
    if any(THINNED.search(f"{_leaf(k)} = {x:g}") for k, x in numbers.items()):
        own_rates = {}  # not all samples were kept
    stamps = {k: found[2] for k, text in texts.items() if (found := seconds([text])) is not None}
    starts = {k: x for k, x in (numbers | stamps).items() if STARTS.fullmatch(_leaf(k)) and "." in k}
    starts = {k: x for k, x in starts.items() if abs(x) < LATEST_S or YEARS_S[0] < x < YEARS_S[1]}
    began = x if (x := min(starts.values(), default=0.0)) > LATEST_S else first
    vectors = [k for k, v in arrays if np.size(v) > 1]
    rates = list(own_rates.values())
    if len({round(np.log(x), 9) for x in rates}) == 1:
        rate = rates[0]
    for name, values in arrays:
        values = np.squeeze(values)
        group = name.rpartition(".")[0]
        if np.iscomplexobj(values) and np.imag(values).any() and values.ndim == 1:
            raise CampaignError(
                f"{file}: {name} is complex with an imaginary part; save real time histories, like real({name})"
            )
        if values.ndim == 1:
            alone = sum(k.partition(".")[0] == name.partition(".")[0] for k in vectors) == 1
            own, start = (_beside(x, name, group, alone) for x in (own_rates, starts))
            start = start and start - (began or 0.0)
            called = names.get(name) or name
            channels.append(channel(called, units.get(name, ""), values, own or rate, start, group))
        elif values.ndim == 2:
            columns = values if values.shape[0] >= values.shape[1] else values.T
            if columns.shape[1] <= MOST_COLUMNS:
                channels += [channel(f"{name}({k})", "", c, rate, None, name) for k, c in enumerate(columns.T, 1)]
    kept = [c for c in channels if c is not None]
    if not kept:
        raise NoSignals(f"{file}: no signals of 16 samples or more in it: {otherwise}")
    short = [(k, x) for k, v in arrays if np.size(v) < FEWEST_SAMPLES and k not in starts for x in np.real(np.ravel(v))]
    said = not_applied([*(f"{k} = {float(x):g}" for k, x in short), *map(" = ".join, texts.items())])
    return [replace(x, warnings=said, began_s=began) for x in _parts(file, kept, what)]


def _beside(numbers: Mapping[str, Said], name: str, group: str, alone: bool) -> Said | None:
    """What is stated of an array, in its struct, or anywhere in a variable that holds no other array."""
    for parent in (name, group):
        for key, x in numbers.items():
            if parent and key.rpartition(".")[0] == parent:
                return x
    within = [f"{group}.", name.partition(".")[0] + "."] if alone else []
    return next((x for start in within for key, x in numbers.items() if key.startswith(start)), None)


def _leaf(name: str) -> str:
    return name.rpartition(".")[2].lower()


def _parts(file: str, channels: list[Channel], what: str) -> list[Recording]:
    """One recording, or one a group where several hold channels of the same names (run1.force, run2.force)."""
    groups: dict[str, list[Channel]] = {}
    for c in channels:
        groups.setdefault(c.group, []).append(c)
    leaves = [sorted(c.name.removeprefix(group) for c in some) for group, some in groups.items()]
    if len(groups) > 1 and len(leaves[0]) > 1 and all(x == leaves[0] for x in leaves):
        return [Recording(file, group, tuple(some), (what,)) for group, some in groups.items()]
    return [Recording(file, "", tuple(channels), (what,))]


def _refuse_unsound(raw: bytes) -> None:
    """Raise ValueError, with one line, for a file of MATLAB 5 whose elements (a tag with kind and number of bytes, then
    data) are cut short or of no kind that there is: SciPy takes that on trust, and the whole process would end."""
    order = {b"IM": "little", b"MI": "big"}.get(raw[126:128])
    if order is None:
        raise ValueError("no byte order in its header")
    _walk(raw, _HEADER, len(raw), order == "big", 0)


def _walk(raw: bytes, at: int, end: int, big: bool, depth: int) -> None:
    def word(k: int) -> int:
        return int.from_bytes(raw[k : k + 4], "big" if big else "little")

    if depth > _DEEPEST:
        raise ValueError(f"nested more than {_DEEPEST} deep")
    while at < end:
        if end - at < 8:
            raise ValueError(f"byte {at}: a tag cut short")
        kind, size, start = word(at), word(at + 4), at + 8
        if small := kind >> 16:  # up to four bytes of data within the tag
            kind, size, start = kind & 0xFFFF, small, at + 4
        if kind not in _KINDS or (small and (size > 4 or kind in (_ARRAY, _COMPRESSED))):
            raise ValueError(f"byte {at}: no kind of data has the number {kind}")
        if start + size > end:
            raise ValueError(f"byte {at}: {size} bytes said to follow, there are {end - start}")
        if kind == _ARRAY:
            _walk(raw, start, start + size, big, depth + 1)
        elif kind == _COMPRESSED:
            inner = zlib.decompress(raw[start : start + size])
            _walk(inner, 0, len(inner), big, depth + 1)
        at = at + 8 if small else start + size + (-size % 8 if kind != _COMPRESSED else 0)
