"""A known signal in every form, changed as programs, recorders and people change files: is its number silently wrong?

    python analyses/fuzz_planted.py --inputs 10000 [--seed N] [--only lvm ...] [--show]

The energy of a cycle and the frequency of the signal are known. A table of it is changed in one to three ways: written
otherwise (units, marks, codings, foreign columns, other order), or recorded worse (range passed, held, late by its own
start, rows lost or repeated, a counter that rolls over, bytes of the body changed, and the faults of mutations.py).
What `import` makes of the file is *refused* (one line), *asked*, *said* (a warning), *right* (both numbers within 1 %
without a word), or *silent*, which must not be; *traceback* and *hang* neither. A changed unit or name that stands in
the file as it could be meant is not tried: nobody could see it.
"""

from __future__ import annotations

import argparse
import datetime
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import mutations
from bayes_iwan.campaign import CampaignError, Record
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests
from fuzz_campaigns import Hang, limited

Rng = np.random.Generator
WRONG = 0.01
OUTCOMES = ("refused", "asked", "said", "right", "silent", "traceback", "hang")
#: what single records cannot show
FAULTS = mutations.SEEN[:-3]


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
        at = [i for i, c in enumerate(self.columns) if c.name in (("Weg",), ("Kraft",))[k]][0]
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


# ---- ways to change a table ---------------------------------------------------------------------------------------


def other_units(table: Table, rng: Rng) -> Table:
    motion, force, clock = (
        list(x)[rng.integers(len(x))]
        for x in (
            (("m", 1e-3), ("µm", 1e3), ("in", 1 / 25.4), ("cm", 0.1), ("MM", 1.0)),
            (("kN", 1e-3), ("lbf", 1 / 4.4482216152605), ("daN", 0.1), ("KN", 1e-3), ("kgf", 1 / 9.80665)),
            (("ms", 1e3), ("us", 1e6), ("min", 1 / 60), ("SEC", 1.0)),
        )
    )
    table = table.column(0, unit=motion[0], values=table.get(0).values * motion[1])
    table = table.column(1, unit=force[0], values=table.get(1).values * force[1])
    return replace(table, how={**table.how, "time unit": clock})


def foreign_columns(table: Table, rng: Rng) -> Table:
    n = table.time_s.size
    speed = np.gradient(table.get(0).values, table.time_s)
    some = [
        Column("Temperature", "°C", 20 + 0.01 * rng.standard_normal(n)),
        Column("Velocity", "mm/s", speed),
        Column("Dehnung", "mm/mm", table.get(0).values / 50),
        Column("Spannung", "V", rng.standard_normal(n)),
        Column("Cycle", "", np.floor(table.time_s * table.frequency_hz)),
        Column("Status", "", np.ones(n)),
        Column("Beschleunigung", "g", rng.standard_normal(n)),
    ]
    more = [c for c in some if rng.random() < 0.4]
    columns = [*table.columns, *more]
    return replace(table, columns=tuple(columns[k] for k in rng.permutation(len(columns))))


def other_marks(table: Table, rng: Rng) -> Table:
    separator = str(rng.choice([";", "\t", "|", ","]))
    how = {
        "separator": separator, "decimal": str(rng.choice([".", ","])), "thousands": bool(rng.random() < 0.3),
        "quoted": bool(rng.random() < 0.3), "end": str(rng.choice(["\n", "\r\n"])),
        "encoding": str(rng.choice(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252", "gb18030"])),
        "units": str(rng.choice(["brackets", "row", "above"])),
    }  # fmt: skip
    return replace(table, how={**table.how, **how})


def preamble(table: Table, rng: Rng) -> Table:
    lines = ["Rig 3, operator X", f"Date: {datetime.date(2024, 3, 1)}", f"Sample rate: {table.rate_hz:g} Hz"]
    return replace(table, how={**table.how, "above": lines[: int(rng.integers(1, 4))]})


def stamps(table: Table, rng: Rng) -> Table:
    kind = str(rng.choice(["%H:%M:%S.%f", "%I:%M:%S.%f %p", "%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "us"]))
    before = float(rng.uniform(0, 1.5)) * float(np.ptp(table.time_s))
    return replace(table, how={**table.how, "stamps": (kind, before)})


def rounded_time(table: Table, rng: Rng) -> Table:
    """Times rounded to some digits, beside a stated rate."""
    digits = int(rng.integers(1, 4))
    lines = ["Rig 3", f"Sample rate: {table.rate_hz:g} Hz"]
    return replace(table, time_s=np.round(table.time_s, digits), how={**table.how, "above": lines})


def no_time(table: Table, rng: Rng) -> Table:
    above = [f"Sample rate: {table.rate_hz:g} Hz"] if rng.random() < 0.7 else ["Rig 3"]
    return replace(table, how={**table.how, "above": above, "no time": True})


def late(table: Table, rng: Rng) -> Table:
    """The force began later, as its own times say."""
    k = int(rng.integers(1, 12))
    one = table.get(1)
    n = table.time_s.size - k
    shifted = replace(one, values=one.values[k:], times_s=table.time_s[k:])
    table = table.rows(np.arange(n))
    return table.column(1, values=shifted.values, times_s=shifted.times_s)


def overrange(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    limit = float(rng.uniform(0.7, 0.98)) * np.abs(one.values).max()
    code = float(rng.choice([9.91e37, 9.9e37, np.inf, 999999.0]))
    return table.column(k, values=np.where(np.abs(one.values) > limit, np.sign(one.values) * code, one.values))


def gaps(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    values = one.values.copy()
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(values.size))
        values[at : at + int(rng.integers(1, 30))] = np.nan
    return table.column(k, values=values)


def held(table: Table, rng: Rng) -> Table:
    k, times = int(rng.integers(2)), int(rng.integers(2, 9))
    one = table.get(k)
    start = int(rng.integers(times))
    index = np.maximum((np.arange(one.values.size) + start) // times * times - start, 0)
    return table.column(k, values=one.values[index])


def coarse(table: Table, rng: Rng) -> Table:
    k, levels = int(rng.integers(2)), int(rng.integers(6, 300))
    one = table.get(k)
    step = np.nanmax(np.abs(one.values[np.isfinite(one.values)])) * 2 / levels
    return table.column(k, values=np.round(one.values / step) * step)


def drift(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    size = np.nanmax(np.abs(one.values[np.isfinite(one.values)])) * rng.uniform(0.2, 6)
    return table.column(k, values=one.values + size * np.linspace(0, 1, one.values.size))


def mean_moved(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    return table.column(k, values=one.values + np.nanstd(one.values) * rng.uniform(-20, 20))


def rows_repeated(table: Table, rng: Rng) -> Table:
    a = int(rng.integers(table.time_s.size - 20))
    n = int(rng.integers(1, 20))
    return table.rows(np.concatenate([np.arange(a + n), np.arange(a, table.time_s.size)]))


def rows_swapped(table: Table, rng: Rng) -> Table:
    index = np.arange(table.time_s.size)
    i, j = rng.integers(0, index.size, 2)
    index[i], index[j] = index[j], index[i]
    return table.rows(index)


def run_appended(table: Table, rng: Rng) -> Table:
    n = table.time_s.size
    return table.rows(np.concatenate([np.arange(n), np.arange(n)]))


def runs_glued(table: Table, rng: Rng) -> Table:
    """Two pieces of one test, one behind the other, the clock counted on."""
    n = table.time_s.size
    a, b = sorted(rng.integers(n // 4, 3 * n // 4, 2))
    return table.rows(np.concatenate([np.arange(b), np.arange(a, n)])[:n], renumbered=True)


def record_fault(table: Table, rng: Rng) -> Table:
    fault = FAULTS[rng.integers(len(FAULTS))]
    if not np.median(np.diff(table.time_s)) > 0:
        return table  # rounded to more than a step
    a, b = table.get(0), table.get(1)
    record = Record("a.csv", table.frequency_hz, 1.0, "fit", {}, table.time_s, a.values, b.values)
    with np.errstate(all="ignore"):
        found = fault(record, rng)
    table = replace(table, columns=(a, b), time_s=found.time_s)
    n = found.time_s.size
    table = table.column(0, values=found.displacement_mm[:n]).column(1, values=found.force_N[:n], times_s=None)
    return replace(table, how={**table.how, "fault": fault.__name__})


REWRITTEN = (other_units, foreign_columns, other_marks, preamble, stamps, rounded_time, no_time)
WORSE = (
    late, overrange, gaps, held, coarse, drift, mean_moved, rows_repeated, rows_swapped, run_appended, runs_glued,
    record_fault,
)  # fmt: skip


# ---- forms --------------------------------------------------------------------------------------------------------


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
                columns.append([x.strftime(kind).replace(".", decimal) if kind[1] in "HI" else x.strftime(kind) for x in moments])
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
    clash = separator == how.get("decimal", ".") or (separator == "," and (how.get("thousands") or how.get("decimal") == ","))
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
        return "" if np.isnan(v) else f"{v:.9f}" if abs(v) < 1e9 else ("Inf" if v > 0 else "-Inf") if np.isinf(v) else f"{v:.5E}"

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
        begun = {"wf_start_time": start + np.timedelta64(round(1e6 * float(clock[0])), "us"), "wf_increment": 1 / table.rate_hz}
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
            "type": 58, "binary": int(rng.integers(2)), "func_type": 1, "rsp_node": k, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
            "rsp_ent_name": "NONE", "id1": "run", "data": c.values, "x": clock, "abscissa_spacing": int(even),
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


def body_damaged(path: Path, rng: Rng) -> None:
    """Damage the bytes behind the head, as a cable, a disk or an editor does."""
    one = path if path.is_file() else sorted(path.iterdir())[int(rng.integers(2))]
    raw = one.read_bytes()
    start = min(2000, len(raw) // 3)
    kinds = mutations.GENTLE[::2] if rng.random() < 0.5 else mutations.ROUGH[:5]
    one.write_bytes(raw[:start] + kinds[rng.integers(len(kinds))](raw[start:], rng))


@dataclass(frozen=True)
class Trial:
    """One planted signal: the form, the changes, what came of it, and the energy over the true one."""

    form: str
    changes: tuple[str, ...]
    outcome: str
    ratio: float
    words: str


def trial(seed: int, i: int, only: list[str] | None, folder: Path) -> Trial:
    rng = np.random.default_rng([seed, i])
    names = only or list(FORMS)
    weights = np.array([WEIGHTS[n] for n in names], dtype=float)
    form = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    table = known_signal(rng)
    recipe = Recipe()
    if form == "wav":
        sizes = [4 * float(np.abs(table.get(k).values).max()) for k in (0, 1)]
        recipe = Recipe(
            channels={"displacement": "1", "force": "2"},
            units={"displacement": f"{sizes[0]!r} mm", "force": f"{sizes[1]!r} N"},
        )
        table = replace(table, how={"full scale": sizes})
    changes: list[str] = []
    for way in [REWRITTEN[k] for k in rng.permutation(len(REWRITTEN))[: int(rng.integers(0, 3))]]:
        if form == "wav" or (form == "two files" and way is not preamble):
            continue
        if way in (stamps, no_time, rounded_time) and form not in ("text", "excel"):
            continue
        if {"stamps", "no time"} & set(table.how) and way in (stamps, no_time, rounded_time):
            continue
        table = way(table, rng)
        changes.append(way.__name__)
    if rng.random() < 0.8:
        way = WORSE[rng.integers(len(WORSE))]
        if not (way is late and (form == "wav" or {"stamps", "no time"} & set(table.how))):
            table = way(table, rng)
            changes.append(str(table.how.get("fault", way.__name__)))
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir()
    path = FORMS[form][1](folder / FORMS[form][0], table, rng)
    if rng.random() < 0.15:
        body_damaged(path, rng)
        changes.append("bytes")
    outcome, ratio, words = _judged(table, path, recipe)
    return Trial(form, tuple(changes), outcome, ratio, words)


def _judged(table: Table, path: Path, recipe: Recipe) -> tuple[str, float, str]:
    try:
        with limited():
            tests = import_tests([path], recipe)
    except ImportAsks as error:
        return "asked", np.nan, str(error)
    except CampaignError as error:
        return ("traceback" if "\n" in str(error) else "refused"), np.nan, str(error)
    except Hang:
        return "hang", np.nan, ""
    except Exception:
        return "traceback", np.nan, traceback.format_exc(limit=-3)
    worst, wrong = 1.0, False
    for test in tests:
        loop = test.loop
        energy = float(np.mean(loop.force_N * loop.velocity_m_s) / loop.frequency_hz * 1e3)
        ratio = energy / table.energy_Nmm
        if abs(ratio - 1) > abs(worst - 1):
            worst = ratio
        off = abs(ratio - 1) > WRONG or abs(loop.frequency_hz / table.frequency_hz - 1) > WRONG
        wrong |= off and not test.record.warnings
    if any(t.record.warnings for t in tests) and not wrong:
        return "said", worst, "; ".join(w for t in tests for w in t.record.warnings)
    return ("silent" if wrong else "right"), worst, ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", nargs="+", metavar="FORM", choices=list(FORMS))
    parser.add_argument("--show", nargs="*", metavar="OUTCOME", choices=OUTCOMES, default=["silent", "traceback", "hang"])
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    began = time.monotonic()
    by_form: dict[str, Counter[str]] = {}
    by_change: dict[str, Counter[str]] = {}
    scratch = Path(tempfile.mkdtemp(prefix="planted", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        for i in range(args.first, args.first + args.inputs):
            with np.errstate(all="ignore"):
                found = trial(args.seed, i, args.only, scratch / "one")
            by_form.setdefault(found.form, Counter())[found.outcome] += 1
            for change in found.changes or ("none",):
                by_change.setdefault(change, Counter())[found.outcome] += 1
            if found.outcome in args.show:
                print(f"{found.outcome}: {args.seed} {i}: {found.form}, {' + '.join(found.changes)}, {found.ratio:.4f} {found.words}", flush=True)
    finally:
        shutil.rmtree(scratch)
    for head, table in (("form", by_form), ("change", by_change)):
        print(f"{head:22s} " + " ".join(f"{h:>9s}" for h in OUTCOMES))
        for name, counts in sorted(table.items()):
            print(f"{name:22s} " + " ".join(f"{counts[h]:9d}" for h in OUTCOMES))
    total = sum(by_form.values(), Counter())
    print(f"{'all':22s} " + " ".join(f"{total[h]:9d}" for h in OUTCOMES))
    print(f"{sum(total.values())} inputs in {time.monotonic() - began:.0f} s")
    sys.exit(1 if any(total[x] for x in ("silent", "traceback", "hang")) else 0)


if __name__ == "__main__":
    main()
