"""Tables of a known signal, and each form that a program may write them in: what fuzz_planted.py plants."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

Rng = np.random.Generator


@dataclass(frozen=True)
class Column:
    """A channel as it will be written: times_s its samples' own, or None for the table's."""

    name: str
    unit: str
    values: np.ndarray
    times_s: np.ndarray | None = None


@dataclass(frozen=True)
class Table:
    """What is written: times (n,) in s, columns, and how."""

    time_s: np.ndarray
    columns: tuple[Column, ...]
    rate_hz: float
    energy_Nmm: float
    frequency_hz: float
    how: dict[str, object] = field(default_factory=dict)

    def column(self, k: int, **changes: object) -> Table:
        """With one column changed; 0 the displacement, 1 the force, wherever they stand."""
        at = next(i for i, c in enumerate(self.columns) if c.name == ("Weg", "Kraft")[k])
        columns = list(self.columns)
        columns[at] = replace(columns[at], **changes)
        return replace(self, columns=tuple(columns))

    def get(self, k: int) -> Column:
        return next(c for c in self.columns if c.name == ("Weg", "Kraft")[k])

    def rows(self, index: np.ndarray, renumbered: bool = False) -> Table:
        """With these rows alone."""
        columns = tuple(
            replace(c, values=c.values[index], times_s=None if c.times_s is None else c.times_s[index])
            for c in self.columns
        )
        times = self.time_s[: len(self.time_s[index])] if renumbered else self.time_s[index]
        return replace(self, time_s=times, columns=columns)


def known_signal(rng: Rng) -> Table:
    """A friction loop with 0.15 of a third harmonic and a little noise."""
    rate = float(rng.choice([200.0, 250.0, 500.0, 1000.0, 1280.0]))
    per_cycle, cycles = rng.uniform(30, 90), rng.uniform(7.3, 14)
    n = int(per_cycle * cycles)
    p = 2 * np.pi * np.arange(n) / per_cycle + rng.uniform(0, 6)
    amplitude, size = rng.uniform(0.2, 3.0), rng.uniform(20, 3000)
    force = size * (np.sin(p + 0.4) + 0.15 * np.sin(3 * p + 0.9) + 1e-4 * rng.standard_normal(n))
    columns = (Column("Weg", "mm", amplitude * np.sin(p)), Column("Kraft", "N", force))
    return Table(np.arange(n) / rate, columns, rate, np.pi * amplitude * size * np.sin(0.4), rate / per_cycle)


def _text_cells(table: Table) -> tuple[list[str], list[str], list[list[str]]]:
    """Names, units and rows of cells of a text table."""
    how = table.how
    decimal, thousands = how.get("decimal", "."), how.get("thousands", False)

    def number(value: float, digits: int) -> str:
        if np.isnan(value):
            return ""
        if np.isinf(value):
            return "∞" if value > 0 else "-∞"
        text = f"{value:{',' if thousands else ''}.{digits}f}" if abs(value) < 1e9 else f"{value:.6E}"
        return text.translate(str.maketrans(",.", ".,")) if decimal == "," else text

    unit, factor = how.get("time unit", ("s", 1.0))  # type: ignore[misc]
    names, units, columns = [], [], []
    if not how.get("no time"):
        names.append("Zeit")
        if "stamps" in how:
            kind, before = how["stamps"]  # type: ignore[misc]
            units.append("us" if kind == "us" else "")
            start = datetime.datetime(2024, 3, 1) - datetime.timedelta(seconds=before)
            if kind == "us":
                columns.append([number((2**32 + 1e6 * (t - before)) % 2**32, 1) for t in table.time_s])
            else:
                moments = [start + datetime.timedelta(seconds=round(float(t), 6)) for t in table.time_s]
                columns.append(
                    [x.strftime(kind).replace(".", decimal) if kind[1] in "HI" else x.strftime(kind) for x in moments]
                )
        else:
            units.append(unit)
            columns.append([number(t * factor, 9 if unit == "min" else 7) for t in table.time_s])
    for c in table.columns:
        if c.times_s is not None:
            names.append(f"Zeit {c.name}")
            units.append(unit)
            columns.append([number(t * factor, 9 if unit == "min" else 7) for t in c.times_s])
        names.append(c.name)
        units.append(c.unit)
        columns.append([number(v, 9) for v in c.values])
    return names, units, [list(row) for row in zip(*columns)]


def write_text(path: Path, table: Table, rng: Rng) -> Path:
    how = table.how
    names, units, rows = _text_cells(table)
    separator = str(how.get("separator", ";"))
    clash = separator == how.get("decimal", ".") or (
        separator == "," and (how.get("thousands") or how.get("decimal") == ",")
    )
    quoted = bool(how.get("quoted")) or clash

    def line(cells: list[str]) -> str:
        return separator.join(f'"{c}"' if quoted else c for c in cells)

    heads = {
        "brackets": [line([f"{n} [{u}]" if u else n for n, u in zip(names, units)])],
        "row": [line(names), line([u or "-" for u in units])],
        "above": [line([u or "-" for u in units]), line(names)],
    }[str(how.get("units", "brackets"))]
    body = [*how.get("above", ()), *heads, *map(line, rows), ""]  # type: ignore[misc]
    text = str(how.get("end", "\n")).join(body)
    encoding = str(how.get("encoding", "utf-8"))
    path.write_bytes(text.encode(encoding, "replace" if encoding == "cp1252" else "strict"))
    return path


def write_lvm(path: Path, table: Table, rng: Rng) -> Path:
    a, b = table.get(0), table.get(1)
    own = b.times_s is not None or not np.allclose(np.diff(table.time_s), 1 / table.rate_hz)
    columns = "Multi" if own else str(rng.choice(["No", "One", "Multi"]))
    clocks = [table.time_s, table.time_s if b.times_s is None else b.times_s]
    lines = ["LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t.", f"X_Columns\t{columns}"]
    lines += ["***End_of_Header***\t", "", "Channels\t2\t\t"]
    gap = "\t\t" if columns == "Multi" else "\t"
    n = a.values.size
    step = 1 / table.rate_hz
    for key, x, y in (
        ("Samples", n, n), ("Y_Unit_Label", a.unit, b.unit), ("X0", f"{clocks[0][0]:.7f}", f"{clocks[1][0]:.7f}"),
        ("Delta_X", f"{step:.9f}", f"{step:.9f}"),
    ):  # fmt: skip
        lines.append(f"{key}\t{x}{gap}{y}\t")
    names = ["X_Value", a.name, "X_Value", b.name] if columns == "Multi" else ["X_Value", a.name, b.name]
    lines += ["***End_of_Header***\t\t", "\t".join([*names, "Comment"])]

    def number(v: float) -> str:
        return (
            ""
            if np.isnan(v)
            else f"{v:.9f}"
            if abs(v) < 1e9
            else ("Inf" if v > 0 else "-Inf")
            if np.isinf(v)
            else f"{v:.5E}"
        )

    for k in range(n):
        x, y = number(a.values[k]), number(b.values[k])
        s, t = (f"{c[k]:.7f}" for c in clocks)
        lines.append("\t".join({"No": ["", x, y], "One": [s, x, y], "Multi": [s, x, t, y]}[columns]))
    path.write_text("\n".join([*lines, ""]))
    return path


def write_excel(path: Path, table: Table, rng: Rng) -> Path:
    import openpyxl

    plain = replace(table, how={k: v for k, v in table.how.items() if k in ("above", "no time", "time unit", "stamps")})
    names, units, rows = _text_cells(plain)
    book = openpyxl.Workbook()
    sheet = book.active
    for line in table.how.get("above", ()):  # type: ignore[attr-defined]
        sheet.append(line.split(": "))
    if rng.random() < 0.5:
        sheet.append([f"{n} [{u}]" if u else n for n, u in zip(names, units)])
    else:
        sheet.append(names)
        sheet.append([u or "-" for u in units])

    def cell(text: str) -> object:
        try:
            return float(text)
        except ValueError:
            return text or None

    for row in rows:
        sheet.append([cell(x) for x in row])
    book.save(path)
    return path


def write_tdms(path: Path, table: Table, rng: Rng) -> Path:
    import nptdms

    start = np.datetime64("2024-03-01T10:00:00")
    channels = []
    even = np.allclose(np.diff(table.time_s), 1 / table.rate_hz)
    groups = rng.random() < 0.3
    for c in table.columns:
        clock = table.time_s if c.times_s is None else c.times_s
        begun = {
            "wf_start_time": start + np.timedelta64(round(1e6 * float(clock[0])), "us"),
            "wf_increment": 1 / table.rate_hz,
        }
        props = {"unit_string": c.unit, **(begun if even else {})}
        channels.append(nptdms.ChannelObject(c.name if groups else "rig", c.name, c.values, props))
    if not even:
        props = {"unit_string": "s"}
        channels.insert(0, nptdms.ChannelObject("rig", "Zeit", table.time_s, props))
        channels = [nptdms.ChannelObject("rig", x.channel, x.data, x.properties) for x in channels]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)
    return path


def write_uff(path: Path, table: Table, rng: Rng) -> Path:
    import pyuff

    even = np.allclose(np.diff(table.time_s), 1 / table.rate_hz)
    for k, c in enumerate(table.columns, 1):
        clock = table.time_s if c.times_s is None else c.times_s
        data = {
            "type": 58, "binary": int(rng.integers(2)), "func_type": 1, "rsp_node": k, "rsp_dir": 3, "ref_node": 0,
            "ref_dir": 0, "rsp_ent_name": "NONE", "id1": "run", "data": c.values, "x": clock,
            "abscissa_spacing": int(even),
            "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 0,
            "ordinate_axis_lab": c.name, "ordinate_axis_units_lab": c.unit or "NONE", "ord_data_type": 4,
            "abscissa_inc": 1 / table.rate_hz if even else 0.0, "abscissa_min": float(clock[0]),
        }  # fmt: skip
        pyuff.UFF(str(path)).write_sets([data], "add", force_double=True)
    return path


def _named(table: Table) -> dict[str, np.ndarray]:
    """Variables whose names end with the unit, the time beside each channel that has its own."""
    plain = {"µm": "um", "°C": "degC", "mm/s": "mm_s", "mm/mm": "ratio"}
    out: dict[str, np.ndarray] = {}
    for c in table.columns:
        out[f"{c.name}_{plain.get(c.unit, c.unit)}".rstrip("_")] = c.values
    return out


def write_matlab(path: Path, table: Table, rng: Rng) -> Path:
    import scipy.io

    named = _named(table)
    own = table.get(1).times_s
    if own is not None:
        force = next(k for k in named if k.startswith("Kraft"))
        data: dict[str, object] = {
            "laser": {"t": table.time_s, **{k: v for k, v in named.items() if k != force}},
            "cell": {"t": own, force: named[force]},
        }
    elif rng.random() < 0.5:
        data = {"run": {"t": table.time_s, **named}}
    else:
        data = {"t": table.time_s, **named, "fs": table.rate_hz}
    scipy.io.savemat(path, data, do_compression=bool(rng.random() < 0.5))
    return path


def write_parquet(path: Path, table: Table, rng: Rng) -> Path:
    import pandas as pd

    own = table.get(1).times_s
    if own is not None:
        a, b = (next((k, v) for k, v in _named(table).items() if k.startswith(n)) for n in ("Weg", "Kraft"))
        data = {"time_s": table.time_s, a[0]: a[1], "time 2_s": own, b[0]: b[1]}
    else:
        data = {"time_s": table.time_s, **_named(table)}
    pd.DataFrame(data).to_parquet(path)
    return path


def write_wav(path: Path, table: Table, rng: Rng) -> Path:
    """Shares of full scale: what it is, 4 times the largest, is written into the recipe."""
    from scipy.io import wavfile

    columns = [np.nan_to_num(table.get(k).values, posinf=9e9, neginf=-9e9) for k in (0, 1)]
    sizes = [float(s) for s in table.how["full scale"]]  # type: ignore[attr-defined]
    x = np.clip(np.column_stack([c / s for c, s in zip(columns, sizes)]), -1, 1)
    if rng.random() < 0.5:
        wavfile.write(path, round(table.rate_hz), x.astype("float32"))
    else:
        wavfile.write(path, round(table.rate_hz), np.rint(x * 32767).astype("int16"))
    return path


def write_two_files(path: Path, table: Table, rng: Rng) -> Path:
    """One channel a file, each with its own times."""
    path.mkdir()
    for k, name in ((0, "run1_disp.txt"), (1, "run1_load.txt")):
        one = table.get(k)
        clock = table.time_s if one.times_s is None else one.times_s
        part = replace(table, columns=(replace(one, times_s=None),), time_s=clock, how={})
        write_text(path / name, part, rng)
    return path


Writer = Callable[[Path, Table, Rng], Path]
FORMS: dict[str, tuple[str, Writer]] = {
    "text": ("a.csv", write_text), "lvm": ("a.lvm", write_lvm), "excel": ("a.xlsx", write_excel),
    "tdms": ("a.tdms", write_tdms), "uff": ("a.uff", write_uff), "matlab": ("a.mat", write_matlab),
    "parquet": ("a.parquet", write_parquet), "wav": ("a.wav", write_wav), "two files": ("run1", write_two_files),
}  # fmt: skip
#: of a hundred: text has most ways to be written
WEIGHTS = {"text": 40, "lvm": 12, "excel": 6, "tdms": 10, "uff": 8, "matlab": 8, "parquet": 4, "wav": 4, "two files": 8}
