"""A known signal, written in every form that public programs write, comes back within the form's own rounding.

Hypothesis draws the signal and how it is written.
"""

import datetime
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from known_signals import back, back_or_said, form, same, signals

from bayes_iwan.campaign import CampaignError
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests
from bayes_iwan.campaign.importing.defects import few_a_cycle
from bayes_iwan.cli import parser
from bayes_iwan.cli.campaigns import _recipe


@form
@given(
    signals(),
    st.sampled_from([";", "\t", "|", ","]),
    st.sampled_from([".", ","]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "gb18030"]),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["brackets", "row below", "row above", "upper case", "underscore", "comma"]),
    st.booleans(),
    st.booleans(),
)
def test_text(signal, separator, decimal, encoding, end, units, quoted, thousands):
    rate, x, f = signal
    quoted = quoted or separator == decimal or (separator == "," and (thousands or units == "comma"))
    heads = {
        "brackets": ["Zeit [s]", "Weg (mm)", "Kraft {N}"],
        "row below": ["Time", "Displacement", "Force"],
        "row above": ["Time", "Displacement", "Force"],
        "upper case": ["TIME (SEC)", "DISP (MM)", "LOAD (KN)"],
        "underscore": ["t_s", "x_mm", "F_N"],
        "comma": ["Time, s", "Displacement, mm", "Force, N"],
    }[units]
    scale = 1e-3 if units == "upper case" else 1.0

    def number(value, digits):
        text = f"{value:{',' if thousands else ''}.{digits}f}"
        return text.translate(str.maketrans(",.", ".,")) if decimal == "," else text

    def row(cells):
        return separator.join(f'"{c}"' if quoted else c for c in cells)

    lines = [row(heads)]
    if units == "row below":
        lines.append(row(["s", "mm", "N"]))
    elif units == "row above":
        lines.insert(0, row(["s", "mm", "N"]))
    lines += [row([number(k / rate, 6), number(a, 6), number(b * scale, 8)]) for k, (a, b) in enumerate(zip(x, f))]
    text = end.join([*lines, ""])

    def write(folder):
        (folder / "a.csv").write_bytes(text.encode(encoding))
        return folder / "a.csv"

    same(back(write), rate, x, f)


@form
@given(
    signals(),
    st.sampled_from(["24 h", "12 h", "date beside", "iso", "compact", "minutes", "us counter", "german"]),
    st.integers(1, 40),
)
def test_stamps_through_midnight_and_rollover(signal, kind, before):
    """The clock starts again `before` samples after the start; times go on."""
    rate, x, f = signal
    midnight = datetime.datetime(2024, 3, 1) - datetime.timedelta(seconds=before / rate)
    stamps = [midnight + datetime.timedelta(seconds=round(k / rate, 6)) for k in range(x.size)]
    formats = {"24 h": "%H:%M:%S.%f", "12 h": "%I:%M:%S.%f %p", "date beside": "%d.%m.%Y;%H:%M:%S.%f"}
    formats |= {
        "compact": "%Y%m%d %H%M%S.%f",
        "iso": "%Y-%m-%dT%H:%M:%S.%f",
        "minutes": "%M:%S.%f",
        "german": "%d.%m.%Y %H:%M:%S,%f",
    }
    head = "Datum;Zeit" if kind == "date beside" else "Zeit [us]" if kind == "us counter" else "Zeit"
    if kind == "us counter":
        cells = [f"{(2**32 - before * 1e6 / rate + k * 1e6 / rate) % 2**32:.1f}" for k in range(x.size)]
    else:
        cells = [stamp.strftime(formats[kind]) for stamp in stamps]
    rows = "".join(f"{c};{a:.6f};{b:.6f}\n" for c, a, b in zip(cells, x, f))

    def write(folder):
        (folder / "a.csv").write_text(f"{head};Weg [mm];Kraft [N]\n{rows}")
        return folder / "a.csv"

    same(back(write), rate, x, f, time_digits=5)


@form
@given(
    signals(),
    st.sampled_from(["%H:%M:%S.%f", "%I:%M:%S.%f %p", "%I:%M:%S.%f", "1899-12-30 %H:%M:%S.%f", "excel", "excel text"]),
    st.sampled_from(["%d.%m.%Y", "%Y-%m-%d", "%Y-%m-%d 00:00:00", "%m/%d/%y", "excel"]),
    st.integers(1, 60),
    st.sampled_from([0, 1, 3, -1, -3, 50, 10_000]),
)
def test_a_date_beside_times_of_day_may_change_late_or_early(signal, time, date, before, late):
    """Midnight is `before` samples after the start; the date changes `late` samples after it, or never."""
    rate, x, f = signal
    rate = 1000.0 if time == "excel" else rate  # whose times of day end at ms in openpyxl
    midnight = datetime.datetime(2024, 3, 1) - datetime.timedelta(seconds=before / rate)
    stamps = [midnight + datetime.timedelta(seconds=round(k / rate, 6)) for k in range(x.size)]
    days = [stamps[int(np.clip(k - late, 0, x.size - 1))].date() for k in range(x.size)]
    excel = "excel" in (time, date)
    times = [s.time() if time == "excel" else s.strftime("%H:%M:%S.%f" if "e" in time else time) for s in stamps]
    dates = [d if date == "excel" else d.strftime(date) for d in days]
    rows = [("Datum", "Zeit", "Weg [mm]", "Kraft [N]"), *zip(dates, times, np.round(x, 6), np.round(f, 6))]

    def write(folder):
        if not excel:
            (folder / "a.csv").write_text("".join(";".join(map(str, row)) + "\n" for row in rows))
            return folder / "a.csv"
        book = pytest.importorskip("openpyxl").Workbook()
        for row in rows:
            book.active.append([v.item() if isinstance(v, np.floating) else v for v in row])
        book.save(folder / "a.xlsx")
        return folder / "a.xlsx"

    same(back(write), rate, x, f, time_digits=5)


@pytest.mark.parametrize("hours", [1, 5, 24, 25, 49])
@pytest.mark.parametrize("beside", [";", " "])
def test_a_slow_logger_s_dates_are_followed(tmp_path, hours, beside):
    p = 2 * np.pi * np.arange(400) / 40
    start = datetime.datetime(2024, 2, 20, 10)
    times = [(start + k * datetime.timedelta(hours=hours)).strftime(f"%Y-%m-%d{beside}%H:%M:%S") for k in range(400)]
    rows = "".join(f"{t};{a:.6f};{b:.6f}\n" for t, a, b in zip(times, np.sin(p), np.sin(p + 0.4)))
    (tmp_path / "a.csv").write_text(f"{'Datum;Zeit' if beside == ';' else 'Zeit'};Weg (mm);Kraft (N)\n{rows}")
    (found,) = import_tests([tmp_path / "a.csv"])
    np.testing.assert_allclose(np.diff(found.columns["time_s"]), 3600.0 * hours)


@form
@given(signals(), st.sampled_from(["%H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%f", "date beside"]), st.integers(0, 12))
def test_each_channel_with_stamps_of_its_own(signal, kind, late):
    """The force starts `late` samples after the displacement, and its columns end earlier."""
    rate, x, f = signal
    start = datetime.datetime(2024, 3, 1, 10)
    times = [start + datetime.timedelta(seconds=round(k / rate, 6)) for k in range(x.size)]
    cells = [t.strftime("%Y-%m-%d;%H:%M:%S.%f" if kind == "date beside" else kind) for t in times]
    none = ";" if kind == "date beside" else ""
    own = "Datum;Zeit" if kind == "date beside" else "Zeit"
    forces = [*(f"{c};{b:.6f}" for c, b in zip(cells[late:], f[late:])), *[f"{none};"] * late]
    rows = "".join(f"{c};{a:.6f};{b}\n" for c, a, b in zip(cells, x, forces))

    def write(folder):
        (folder / "a.csv").write_text(f"{own};Weg [mm];{own};Kraft [N]\n{rows}")
        return folder / "a.csv"

    same(back(write), rate, x[late:], f[late:], time_digits=5)


def _lvm(rate, x, f, columns, separator, decimal, late):
    sep = {"Tab": "\t", "Comma": ","}[separator]
    head = {"No": ["", ""], "One": ["", ""], "Multi": ["", "", ""]}[columns]
    places = sep + sep.join(["{}", "", "{}"] if columns == "Multi" else ["{}", "{}"]) + sep
    lines = ["LabVIEW Measurement" + sep, f"Separator{sep}{separator}", f"Decimal_Separator{sep}{decimal}"]
    lines += [f"X_Columns{sep}{columns}", "***End_of_Header***" + sep, sep, f"Channels{sep}2" + sep * len(head)]
    for key, a, b in (
        ("Samples", x.size, x.size),
        ("Y_Unit_Label", "mm", "N"),
        ("X0", "0", f"{late / rate:.9f}"),
        ("Delta_X", f"{1 / rate:.9f}", f"{1 / rate:.9f}"),
    ):
        lines.append(key + places.format(str(a).replace(".", decimal), str(b).replace(".", decimal)))
    lines.append("***End_of_Header***" + sep)
    names = ["X_Value", "Weg", "X_Value", "Kraft"] if columns == "Multi" else ["X_Value", "Weg", "Kraft"]
    lines.append(sep.join([*names, "Comment"]))
    for k, (a, b) in enumerate(zip(x, f)):
        times = [f"{k / rate:.6f}", f"{(k + late) / rate:.6f}"]
        cells = {"No": ["", f"{a:.6f}", f"{b:.6f}"], "One": [times[0], f"{a:.6f}", f"{b:.6f}"]}.get(
            columns, [times[0], f"{a:.6f}", times[1], f"{b:.6f}"]
        )
        lines.append(sep.join(c.replace(".", decimal) for c in cells) + (sep + "remark" if k == 3 else ""))
    return "\n".join([*lines, ""])


@form
@given(
    signals(), st.sampled_from(["No", "One", "Multi"]), st.sampled_from([("Tab", "."), ("Tab", ","), ("Comma", ".")])
)
def test_labview(signal, columns, style):
    rate, x, f = signal

    def write(folder):
        (folder / "a.lvm").write_text(_lvm(rate, x, f, columns, *style, 0))
        return folder / "a.lvm"

    same(back(write), rate, x, f)


def _late(folder, form, rate, x, f, late):
    """A file in which the force began `late` samples after the displacement, and says so."""
    f = f[late:]
    if form in ("tdms start", "tdms offset", "tdms groups"):
        nptdms = pytest.importorskip("nptdms")
        start = np.datetime64("2024-03-01T10:00:00.000000")
        properties = [{"wf_increment": 1 / rate, "unit_string": unit} for unit in ("mm", "N")]
        for k, one in enumerate(properties):
            seconds = k * late / rate
            offset = seconds if form == "tdms offset" else 0.0
            one |= {
                "wf_start_time": start + np.timedelta64(round(1e6 * (seconds - offset)), "us"),
                "wf_start_offset": offset,
            }
        group = ("laser", "cell") if form == "tdms groups" else ("rig", "rig")
        with nptdms.TdmsWriter(folder / "a.tdms") as writer:
            writer.write_segment(
                [
                    nptdms.ChannelObject(group[k], n, v, properties[k])
                    for k, (n, v) in enumerate((("Weg", x), ("Kraft", f)))
                ]
            )
        return folder / "a.tdms"
    if form == "uff":
        pyuff = pytest.importorskip("pyuff")
        for k, (label, values, unit) in enumerate((("Weg", x, "mm"), ("Kraft", f, "N"))):
            data = {
                "type": 58, "binary": 0, "func_type": 1, "rsp_node": k, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
                "rsp_ent_name": "NONE", "id1": "run", "data": values, "x": (np.arange(values.size) + k * late) / rate,
                "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8,
                "orddenom_spec_data_type": 0, "ordinate_axis_lab": label, "ordinate_axis_units_lab": unit,
                "ord_data_type": 4, "abscissa_inc": 1 / rate, "abscissa_min": k * late / rate,
            }  # fmt: skip
            pyuff.UFF(str(folder / "a.uff")).write_sets([data], "add", force_double=True)
        return folder / "a.uff"
    if form.startswith("matlab"):
        import scipy.io

        a = {"t": np.arange(x.size) / rate, "weg_mm": x}
        b = {"t": (np.arange(f.size) + late) / rate, "kraft_N": f}
        scipy.io.savemat(folder / "a.mat", {"laser": a, "cell": b})
        return folder / "a.mat"
    n = f.size
    table = zip(np.arange(n) / rate, x, (np.arange(n) + late) / rate, f)
    rows = "".join(f"{a:.7f},{b:.6f},{c:.7f},{d:.6f}\n" for a, b, c, d in table)
    if form == "lvm":
        (folder / "a.lvm").write_text(_lvm(rate, x[:n], f, "Multi", "Tab", ".", late))
        return folder / "a.lvm"
    (folder / "a.csv").write_text("Time 1 [s],Weg [mm],Time 2 [s],Kraft [N]\n" + rows)
    return folder / "a.csv"


@form
@given(
    signals(),
    st.sampled_from(["tdms start", "tdms offset", "tdms groups", "uff", "matlab", "csv", "lvm"]),
    st.integers(1, 9),
)
def test_a_channel_that_starts_late_is_put_in_its_place(signal, form, late):
    rate, x, f = signal
    record = back(lambda folder: _late(folder, form, rate, x, f, late))
    n = min(record.time_s.size, x.size - late)
    assert n > 0.9 * (x.size - 2 * late)
    tolerance = 1e-5 * np.abs(x).max() + 1e-6
    np.testing.assert_allclose(record.displacement_mm[:n], x[late : late + n], atol=max(tolerance, 1e-3 * np.ptp(x)))
    np.testing.assert_allclose(record.force_N[:n], f[late : late + n], atol=1e-3 * np.ptp(f))
    assert any("aligned by start" in w for w in record.warnings)


def _binary(folder, form, rate, x, f):
    t = np.arange(x.size) / rate
    if form == "tdms":
        nptdms = pytest.importorskip("nptdms")
        with nptdms.TdmsWriter(folder / "a.tdms") as writer:
            channels = [("Weg", x, "mm"), ("Kraft", f / 1e3, "kN")]
            writer.write_segment(
                [nptdms.ChannelObject("g", n, v, {"unit_string": u, "wf_increment": 1 / rate}) for n, v, u in channels]
            )
        return folder / "a.tdms"
    if form == "parquet":
        pd = pytest.importorskip("pandas")
        pytest.importorskip("pyarrow")
        pd.DataFrame({"time_s": t, "weg_mm": x, "kraft_N": f}).to_parquet(folder / "a.parquet")
        return folder / "a.parquet"
    if form.startswith("xlsx"):
        openpyxl = pytest.importorskip("openpyxl")
        book = openpyxl.Workbook()
        sheet = book.active
        sheet.append(["Rig", 3])
        if form == "xlsx":
            sheet.append(["Time", "Weg", "Kraft"])
            sheet.append(["s", "mm", "N"])
            rows = zip(t.tolist(), x.tolist(), f.tolist())
        else:
            sheet.append(["Sampling rate [Hz]", rate])
            sheet.append(["Weg [mm]", "Kraft [N]"])
            rows = zip(x.tolist(), f.tolist())
        for row in rows:
            sheet.append(row)
        book.create_sheet("remarks").append(["nothing here"])
        book.save(folder / "a.xlsx")
        return folder / "a.xlsx"
    import scipy.io

    if form == "matlab complex":
        data = {"fs": rate, "weg_mm": x.astype(complex), "kraft_N": f.astype(complex)}
    elif form == "matlab cell":
        cell = np.empty((1, 1), dtype=object)
        cell[0, 0] = {"t": t, "weg_mm": x, "kraft_N": f}
        data = {"runs": cell}
    elif form == "matlab struct array":
        array = np.zeros((1, 1), dtype=[("t", object), ("weg_mm", object), ("kraft_N", object)])
        array[0, 0] = (t, x, f)
        data = {"run": array}
    else:
        import h5py

        with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
            references = file.create_group("#refs#")
            for name, values in (("t", t), ("weg_mm", x), ("kraft_N", f)):
                one = references.create_dataset(name, data=values[None])
                one.attrs["MATLAB_class"] = np.bytes_("double")
                field = file.create_dataset(f"run/{name}", (1, 1), dtype=h5py.ref_dtype)
                field[0, 0] = one.ref
        return folder / "a.mat"
    scipy.io.savemat(folder / "a.mat", data)
    return folder / "a.mat"


@form
@given(
    signals(),
    st.sampled_from(
        ["tdms", "parquet", "xlsx", "xlsx rate", "matlab complex", "matlab cell", "matlab struct array", "matlab 7.3"]
    ),
)
def test_binary_forms(signal, form):
    rate, x, f = signal
    same(back(lambda folder: _binary(folder, form, rate, x, f)), rate, x, f, digits=9)


@form
@given(signals(), st.sampled_from(["int16", "int32", "float32", "uint8"]))
def test_wav(signal, dtype):
    """A sample of 1 is what the user says that full scale is."""
    from scipy.io import wavfile

    rate, x, f = signal
    scaled = np.column_stack([x / np.abs(x).max(), f / np.abs(f).max()]) * 0.99
    top = {"int16": 32768.0, "int32": 2.0**31, "float32": 1.0, "uint8": 128.0}[dtype]
    raw = scaled * top + (128.0 if dtype == "uint8" else 0.0)
    stored = (np.rint(raw) if dtype != "float32" else raw).astype(dtype)
    sizes = [float(np.abs(y).max() / 0.99) for y in (x, f)]
    recipe = Recipe(
        channels={"displacement": "1", "force": "2"},
        units={"displacement": f"{sizes[0]!r} mm", "force": f"{sizes[1]!r} N"},
    )

    def write(folder):
        wavfile.write(folder / "a.wav", int(rate), stored)
        return folder / "a.wav"

    record = back(write, recipe)
    step = {"int16": 2.0**-15, "int32": 2.0**-30, "float32": 1e-7, "uint8": 2.0**-7}[dtype]
    if record.force_N.size == f.size:  # else samples that repeat were taken for a held channel, and that is said
        np.testing.assert_allclose(record.displacement_mm, x, atol=step * sizes[0])
        np.testing.assert_allclose(record.force_N, f, atol=step * sizes[1])
    else:
        assert any("repeats each value" in w for w in record.warnings)


@form
@given(signals(), st.integers(2, 5))
def test_a_held_channel_is_said_and_put_on_time(signal, times):
    rate, x, f = signal
    keep = x.size // times * times
    held = np.repeat(x[:keep:times], times)
    rows = "".join(f"{k / rate:.7f},{a:.7f},{b:.6f}\n" for k, (a, b) in enumerate(zip(held, f)))

    def write(folder):
        (folder / "a.csv").write_text("Time [s],Weg [mm],Kraft [N]\n" + rows)
        return folder / "a.csv"

    record = back_or_said(write, "samples a cycle")
    if record is None:
        return
    assert any("repeats each value" in w for w in record.warnings)
    at = np.rint(record.time_s * rate).astype(int)
    np.testing.assert_allclose(record.displacement_mm, x[at], atol=1e-6)
    np.testing.assert_allclose(record.force_N, f[at], atol=1e-5)


@form
@given(signals(), st.floats(0.2, 0.9))
def test_codes_at_both_ends_of_the_range_are_no_force(signal, level):
    """Found by fuzz_planted.py (seed 2, 64): they were, since each hid the other."""
    rate, x, f = signal
    limit = level * np.abs(f).max()
    coded = np.where(np.abs(f) > limit, np.sign(f) * 999999.0, f)

    def write(folder):
        rows = "".join(f"{k / rate:.7f};{a:.7f};{b:.6f}\n" for k, (a, b) in enumerate(zip(x, coded)))
        (folder / "a.csv").write_text("Time [s];Weg [mm];Kraft [N]\n" + rows)
        return folder / "a.csv"

    try:
        assert np.abs(back(write).force_N).max() <= limit + 1e-6
    except CampaignError as error:  # too little is left
        assert "a code, dropped" in str(error) or "samples that are numbers" in str(error)


@form
@given(signals(), st.floats(0.5, 0.75))
def test_an_integer_that_overflowed_is_refused(signal, share):
    """Force beyond `share` of its amplitude wraps round; a force that jumps as friction does is none."""
    rate, x, f = signal
    limit = share * np.abs(f).max()

    def write(force):
        def into(folder):
            rows = "".join(f"{k / rate:.7f};{a:.7f};{b:.6f}\n" for k, (a, b) in enumerate(zip(x, force)))
            (folder / "a.csv").write_text("Time [s];Weg [mm];Kraft [N]\n" + rows)
            return folder / "a.csv"

        return into

    with pytest.raises(CampaignError, match="an integer that overflowed"):
        back(write((f + limit) % (2 * limit) - limit))
    friction = np.sign(np.gradient(x)) + 0.1 * x / np.abs(x).max()
    assert not any("overflowed" in w for w in back(write(limit * friction)).warnings)


@pytest.mark.parametrize("per_sample", [0.38, 0.45, 0.55, 0.7, 1.45])
def test_a_few_samples_a_cycle_are_said_to_be_that(tmp_path, per_sample):
    """Neither an integer that overflowed, nor a slow motion with spikes."""
    n = np.arange(600)
    u = np.sin(2.0 * np.pi * per_sample * n + 0.3)
    force = 4.0 * u + np.tanh(30.0 * np.cos(2.0 * np.pi * per_sample * n + 0.3))
    rows = "".join(f"{k / 100:.2f};{a:.6f};{b:.6f}\n" for k, a, b in zip(n, u, force))
    (tmp_path / "a.csv").write_text(f"Time [s];Weg [mm];Kraft [N]\n{rows}")
    with pytest.raises(CampaignError, match=r"'Weg' jumps over half of its range at \d\d % .* a few samples a cycle"):
        import_tests([tmp_path / "a.csv"], Recipe())


def test_a_drive_that_jumps_twice_a_cycle_is_sampled_often_enough():
    square = np.tile(np.repeat([1.0, -1.0], 4), 40) + 0.01 * np.random.default_rng(0).standard_normal(320)
    assert few_a_cycle(square, "u") == "" and few_a_cycle(square[::2], "u") != ""


def test_a_time_that_repeats_tells_the_rate_of_its_first_and_last_row(tmp_path):
    k = np.arange(4000)
    rows = "".join(f"{x / 853:.2f};{np.sin(x / 20):.6f};{np.cos(x / 20):.6f}\n" for x in k)
    (tmp_path / "a.csv").write_text(f"Time [s];Weg [mm];Kraft [N]\n{rows}")
    with pytest.raises(CampaignError, match=r"rounded too far\. Its first and last row make 85[23]\.?\d* Hz"):
        import_tests([tmp_path / "a.csv"], Recipe())


@pytest.mark.parametrize("unit", ["kg", "kgf"])
def test_a_load_in_kilograms_is_a_force(tmp_path, unit):
    t = np.arange(400) / 100.0
    rows = "".join(f"{a:.2f};{np.sin(2 * np.pi * a):.6f};{2 * np.cos(2 * np.pi * a):.6f}\n" for a in t)
    rows = rows.replace("\n", ";3.2\n")  # and a mass is none
    (tmp_path / "a.csv").write_text(f"Time [s];Stroke [mm];ch2 ({unit});moving mass (kg)\n{rows}")
    (found,) = import_tests([tmp_path / "a.csv"], Recipe())
    np.testing.assert_allclose(np.max(found.record.force_N), 2 * 9.80665, rtol=1e-4)


def test_numpy_files_say_how_to_save_them(tmp_path):
    np.savez(tmp_path / "a.npz", t=np.arange(20.0), f=np.arange(20.0))
    with pytest.raises(CampaignError, match="NumPy arrays; save them with names and units"):
        import_tests([tmp_path / "a.npz"], Recipe())


@form
@given(
    signals(),
    st.sampled_from(
        ["9.91E+37", "9.9E37", "∞", "1.#INF", "OL", "999999", "#OVER", "-OVLD", "+++++", "Saturated", "*****"]
    ),
    st.integers(1, 4),
)
def test_overrange_is_missing_and_said(signal, code, wide):
    rate, x, f = signal
    over = np.zeros(x.size, dtype=bool)
    for k in range(20, x.size - 10, 40):
        over[k : k + wide] = True
    cells = [code if o else f"{a:.7f}" for a, o in zip(x, over)]
    rows = "".join(f"{k / rate:.7f};{a};{b:.6f}\n" for k, (a, b) in enumerate(zip(cells, f)))

    def write(folder):
        (folder / "a.csv").write_text("Time [s];Weg [mm];Kraft [N]\n" + rows, encoding="utf-8")
        return folder / "a.csv"

    record = back_or_said(write, "dropped")
    if record is None:
        return
    np.testing.assert_allclose(record.displacement_mm, x[~over], atol=1e-6)
    assert any("dropped" in w for w in record.warnings)


def _table(folder, head, *columns, end=""):
    rows = "\n".join(",".join(row) for row in zip(*columns))
    (folder / "a.csv").write_text(f"{head}\n{rows}\n{end}")
    return folder / "a.csv"


def _digits(values, digits=7):
    return [f"{v:.{digits}f}" for v in values]


@form
@given(signals(), st.sampled_from(["excel days", "matlab days", "units with a word", "fortran", "summary", "hash"]))
def test_texts_of_odd_programs(signal, kind):
    rate, x, f = signal
    t = np.arange(x.size) / rate

    def write(folder):
        time, a, b = _digits(t), _digits(x), _digits(f)
        if kind.endswith("days"):
            time = _digits((45352.4 if kind == "excel days" else 739312.4) + t / 86400, 12)
            return _table(folder, "Time,Weg (mm),Kraft (N)", time, a, b)
        if kind == "units with a word":  # MTS counts segments
            return _table(folder, "Time,Weg,Kraft,Axial Count\nSec,mm,N,segments", time, a, b, _digits(10 * t, 0))
        if kind == "fortran":
            a, b = ([f"{v:.9E}".replace("E", "D") for v in y] for y in (x, f))
            return _table(folder, "t_s,Weg_mm,Kraft_N", time, a, b)
        if kind == "summary":
            end = f"\nMax,{x.max():.3f},{f.max():.3f}\nMin,{x.min():.3f},{f.min():.3f}\n"
            return _table(folder, "Zeit [s],Weg [mm],Kraft [N]", time, a, b, end=end)
        (folder / "a.csv").write_text(
            f"# rig 3\n# fs: {rate:g}\n# Weg_mm Kraft_N\n" + "".join(f"{p} {q}\n" for p, q in zip(a, b))
        )
        return folder / "a.csv"

    same(back(write), rate, x, f, time_digits=4 if kind.endswith("days") else 6)


@form
@given(signals(), st.sampled_from(["table", "units"]))
def test_hdf5_of_python_programs(signal, kind):
    import h5py

    rate, x, f = signal
    t = np.arange(x.size) / rate

    def write(folder):
        with h5py.File(folder / "a.h5", "w") as file:
            if kind == "table":
                rows = np.zeros(t.size, dtype=[("time_s", "f8"), ("weg_mm", "f8"), ("kraft_N", "f8")])
                rows["time_s"], rows["weg_mm"], rows["kraft_N"] = t, x, f
                file["run"] = rows
            else:
                for name, values, unit in (("time", t, "s"), ("weg", x, "mm"), ("kraft", f, "N")):
                    file[name] = values
                    file[name].attrs["units"] = unit
        return folder / "a.h5"

    same(back(write), rate, x, f, digits=9)


def test_a_time_in_whole_numbers_without_a_unit_is_asked_of(tmp_path):
    p = 2 * np.pi * np.arange(400) / 40
    head = "Time,Weg (mm),Kraft (N)"
    path = _table(tmp_path, head, [str(2 * k) for k in range(400)], _digits(np.sin(p)), _digits(np.sin(p + 0.4)))
    with pytest.raises(ImportAsks, match="is it s, ms, us"):
        import_tests([path])
    (test,) = import_tests([path], Recipe(units={"time": "ms"}))
    assert test.rate_hz == pytest.approx(500.0) or test.record.time_s[1] == pytest.approx(0.002)


#: a file or group for each channel, and what its channel is called: of the displacement, then of the force
SENSORS = {
    "named by file": (("run1_disp", "run1_load"), ("Value", "Value")),
    "named by file in part": (("laser", "x32"), ("Value", "Value")),
    "named by nothing": (("ch1", "ch2"), ("Value", "Value")),
    "without a name": (("ch1", "ch2"), ("", "")),
    "named by channel": (("a_31", "b_32"), ("Weg", "Kraft")),
    "with units": (("a_31", "b_32"), ("Weg (mm)", "Kraft (N)")),
}


def _a_channel_a_file(folder, kind, rate, x, f, container, clock):
    """One file a channel, or one TDMS group or MATLAB struct."""
    t = np.arange(x.size) / rate
    parts, names = SENSORS[kind]
    for part, name, values in zip(parts, names, (x, f)):
        if container == "text":
            rows = zip(*map(_digits, (t, values) if clock else (values,)))
            head = f"{'Time (s),' if clock else ''}{name}\n" if name or clock else ""
            (folder / f"{part}.csv").write_text(head + "".join(",".join(row) + "\n" for row in rows))
        elif container == "matlab files":
            import scipy.io

            scipy.io.savemat(folder / f"{part}.mat", {"y": values} | ({"t_s": t} if clock else {}))
    if container == "matlab":
        import scipy.io

        both = {p: {"y": v} | ({"t_s": t} if clock else {}) for p, v in zip(parts, (x, f))}
        scipy.io.savemat(folder / "a.mat", both)
    if container.startswith("tdms"):
        nptdms = pytest.importorskip("nptdms")
        said = {"wf_increment": 1 / rate} if clock else {}
        groups = [(p, n or "Untitled", v) for p, n, v in zip(parts, names, (x, f))]
        for file in [[g] for g in groups] if container == "tdms files" else [groups]:
            with nptdms.TdmsWriter(folder / f"{file[0][0] if container == 'tdms files' else 'a'}.tdms") as writer:
                writer.write_segment([nptdms.ChannelObject(g, n, v, said) for g, n, v in file])
    return folder


@form
@given(
    signals(),
    st.sampled_from(list(SENSORS)),
    st.sampled_from(["text", "tdms", "tdms files", "matlab", "matlab files"]),
    st.booleans(),
)
def test_a_channel_a_file_is_asked_of_once(signal, kind, container, clock):
    """The command that the only message ends with works, with answers in the place of its < >."""
    rate, x, f = signal
    if "a_31" in SENSORS[kind][0] and container.startswith("matlab"):
        return  # whose variables are called alike here
    answers = {"<HZ>": f"{rate}", "displacement=<UNIT>": "displacement=mm", "force=<UNIT>": "force=N"}
    with tempfile.TemporaryDirectory() as folder:
        (home := Path(folder, "rig")).mkdir()
        _a_channel_a_file(home, kind, rate, x, f, container, clock)
        words = ["import", str(home), "--out", str(Path(folder, "campaign"))]
        for again in (True, False):
            args = parser().parse_args(words)
            try:
                recipe = _recipe(args)
                (found,) = import_tests(args.files, recipe, args.split, args.held_out, args.join)
                break
            except ImportAsks as asks:
                assert again, str(asks)
                for question in asks.questions:
                    role = 0 if question.option == "--displacement" else 1
                    part, name = (some[role] for some in SENSORS[kind])
                    name = "y" if "matlab" in container else name
                    name = f"{part}.{name}" if name else part
                    more = question.words()
                    words += [answers.get(w, name if w == "<NAME>" else w) for w in more]
    same(found.record, rate, x, f, digits=6)


@pytest.mark.parametrize("channels", [("Value", "Value"), ("Weg (mm)", "Kraft (N)")])
def test_sensors_of_several_tests_are_paired_by_what_differs_in_their_names(tmp_path, channels):
    p = 2 * np.pi * np.arange(400) / 40
    for k in (1, 2):
        for part, name, y in zip(("laser", "load cell"), channels, (k * np.sin(p), np.sin(p + 0.4))):
            _table(tmp_path, f"Time (s),{name}", _digits(p / 10), _digits(y)).rename(tmp_path / f"{part}_0{k}.csv")
    tests = import_tests([tmp_path], Recipe(units={"displacement": "mm", "force": "N"}))
    assert [round(x.loop.amplitude_mm) for x in tests] == [1, 2]
    (tmp_path / "laser_02.csv").unlink()
    with pytest.raises(CampaignError, match="lacks the displacement, and no other goes with it"):
        import_tests([tmp_path], Recipe(units={"displacement": "mm", "force": "N"}))


def test_two_channels_of_one_name_and_unit_are_asked_of(tmp_path):
    p = 2 * np.pi * np.arange(400) / 40
    head = "Time (s),Disp (mm),Disp (mm),Force (N)"
    path = _table(tmp_path, head, *map(_digits, (p / 10, np.sin(p), 0.5 * np.sin(p), np.sin(p + 0.4))))
    with pytest.raises(ImportAsks, match=r"2: Disp .mm., 3: Disp"):
        import_tests([path])
