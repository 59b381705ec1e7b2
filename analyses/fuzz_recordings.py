"""A sound recording in every form that `import` reads, and its reader: what fuzz.py damages, alone or beside the rest.

All paths are relative to the working directory, so that several processes can damage copies side by side.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import mutations
from bayes_iwan.campaign import Record
from bayes_iwan.campaign.importing import Recipe, import_tests, read_recipe
from bayes_iwan.files import write_whole

Damage = Callable[[bytes, mutations.Rng], bytes]


def resealed_zip(raw: bytes, rng: mutations.Rng) -> bytes:
    """A workbook of which one part was damaged and packed again: the archive's checksums hold."""
    with zipfile.ZipFile(io.BytesIO(raw)) as packed:
        parts = {x.filename: packed.read(x) for x in packed.infolist()}
    sheets = [name for name in parts if "sheet" in name and not name.startswith("_")]
    name = sheets[rng.integers(len(sheets))] if rng.random() < 0.6 else list(parts)[rng.integers(len(parts))]
    parts[name] = mutations.damaged(parts[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for key, value in parts.items():
            packed.writestr(zipfile.ZipInfo(key), value)
    return out.getvalue()


RECIPE = """
sample_rate_hz = 640
reverse = ["force"]
[channels]
displacement = "Weg"
force = "2"
[units]
force = "V"
[sensitivities]
force = "9.55 mV/N"
[gains]
force = 10
[text]
separator = ";"
decimal = ","
[specimen]
name = "isolator 7"
"""


@dataclass(frozen=True)
class Reader:
    """Sound files, of which one is damaged each time; what reads them (None: refused without a word); how to damage."""

    files: tuple[Path, ...]
    read: Callable[[], object]
    damage: Damage = mutations.damaged


def _recordings(folder: Path, record: Record) -> dict[str, Path]:
    """One record as every format that `import` reads."""
    import h5py
    import nptdms
    import pandas as pd
    import pyuff
    import scipy.io
    from scipy.io import wavfile

    folder.mkdir()
    t, x, f = record.time_s, record.displacement_mm, record.force_N
    step = float(t[1] - t[0])
    german = "\n".join(f"{a:.6f};{b:.6f};{c:.6f}".replace(".", ",") for a, b, c in zip(t, x, f))
    out = {"text": write_whole(folder / "a.csv", f"Zeit;Weg;Kraft\ns;mm;N\n{german}\n")}
    out["tdms"] = folder / "a.tdms"
    with nptdms.TdmsWriter(out["tdms"]) as writer:
        more = {"wf_increment": step}
        channels = [("Weg", x, "mm"), ("Kraft", f, "N")]
        writer.write_segment(
            [nptdms.ChannelObject("Messung", n, v, {"unit_string": u, **more}) for n, v, u in channels]
        )
    out["uff"] = folder / "a.uff"
    for node, (label, values, unit) in enumerate(channels, 1):
        data = {
            "type": 58, "binary": 0, "func_type": 1, "rsp_node": node, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
            "rsp_ent_name": "NONE", "id1": "run", "data": values, "x": t, "abscissa_spacing": 1,
            "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 0,
            "ordinate_axis_lab": label, "ordinate_axis_units_lab": unit, "ord_data_type": 4, "abscissa_inc": step,
            "abscissa_min": 0.0,
        }  # fmt: skip
        pyuff.UFF(str(out["uff"])).write_sets([data], "add", force_double=True)
    out["matlab"] = folder / "a.mat"
    scipy.io.savemat(out["matlab"], {"run": {"Weg_mm": x, "Kraft_N": f, "note": "good"}, "fs": 1 / step})
    out["matlab 7.3"] = folder / "b.mat"
    with h5py.File(out["matlab 7.3"], "w", userblock_size=512) as file:
        for name, y in (("Weg_mm", x[None]), ("Kraft_N", f[:, None]), ("fs", [[1 / step]])):
            file.create_dataset(name, data=y).attrs["MATLAB_class"] = np.bytes_("double")
    with out["matlab 7.3"].open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    out["parquet"] = folder / "a.parquet"
    pd.DataFrame({"time_s": t, "Weg_mm": x, "Kraft_N": f}).to_parquet(out["parquet"])
    rows = [f"\t{a:.6f}\t{b:.6f}" for a, b in zip(x, f)]
    lvm = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "X_Columns\tNo",
        "***End_of_Header***\t",
        "",
    ]
    lvm += ["Channels\t2\t\t", f"Samples\t{x.size}\t{x.size}", "Y_Unit_Label\tmm\tN", "X0\t0\t0"]
    lvm += [f"Delta_X\t{step:.9f}\t{step:.9f}", "***End_of_Header***\t\t", "X_Value\tWeg\tKraft\tComment", *rows, ""]
    out["labview"] = write_whole(folder / "a.lvm", "\n".join(lvm))
    stamps = [f"{a:%H:%M:%S.%f}" for a in pd.Timestamp("2024-03-01 23:59:59") + pd.to_timedelta(t, unit="s")]
    stamped = "\n".join(f'01.03.2024;{a};"{b:,.6f}";{c:.6f}' for a, b, c in zip(stamps, x, f))
    out["stamps"] = write_whole(folder / "b.csv", f"Rate: {1 / step} Hz\nDatum;Zeit;Weg [mm];Kraft [N]\n{stamped}\n")
    blocks = "\n".join(f"{a:.6f}\t{b:.6f}\t{c:.6f}" for a, b, c in zip(t, x, f))
    other = "\n".join(f"{a + 99:.6f}\t{0.7 * b:.6f}\t{0.9 * c:.6f}" for a, b, c in zip(t, x, f))
    head = "Data Acquisition: cyclic\nTime\tAxial Displacement\tAxial Force\nSec\tmm\tN\n"
    out["blocks"] = write_whole(folder / "a.dat", f"{head}{blocks}\n\n{head}{other}\n")
    pd.DataFrame({"Time (s)": t, "Weg (mm)": x, "Kraft (N)": f}).to_excel(folder / "a.xlsx", index=False)
    out["excel"] = folder / "a.xlsx"
    rows = pd.DataFrame({"time_s": t, "disp_mm": x, "force_N": f}).to_json(orient="records")
    out["json"] = write_whole(folder / "a.json", rows)
    out["wav"] = folder / "a.wav"
    wavfile.write(out["wav"], round(1 / step), np.column_stack([x / 4, f / (4 * np.abs(f).max())]).astype("float32"))
    return out


def made_up_record() -> Record:
    """Eight cycles of a friction loop."""
    p = 2 * np.pi * np.arange(8 * 64) / 64
    rng = np.random.default_rng(0)
    force = 40.0 * np.sin(p + 0.4) + 6.0 * np.sin(3 * p + 0.9) + 0.02 * rng.standard_normal(p.size)
    return Record("a.csv", 10.0, 1.0, "fit", {}, np.arange(p.size) / 640.0, np.sin(p), force)


def recording_readers(record: Record) -> dict[str, Reader]:
    """Files below the working directory, and their readers by the kind of file."""
    recipe = write_whole("recipe.toml", RECIPE)
    recordings = _recordings(Path("recordings"), record)
    out = {"recipe": Reader((recipe,), lambda: Recipe().over(read_recipe(recipe)))}
    for name, path in recordings.items():
        # a WAV says neither names nor units
        said = Recipe(channels={"displacement": "1", "force": "2"}, units={"displacement": "4 mm", "force": "400 N"})
        recipe_of = said if name == "wav" else Recipe()
        read = lambda path=path, r=recipe_of: import_tests([path], r)  # noqa: E731
        out[f"import {name}"] = Reader((path,), read)
        if name == "excel":
            out["import excel, resealed"] = Reader((path,), read, resealed_zip)
    return out
