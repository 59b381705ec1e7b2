"""Several tests in a file, lines above a table, drives that are no sine, and staircases: a known signal comes back."""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from known_signals import EXAMPLES, back, form, same, signals

from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests

SIZES = (1.0, 0.6, 1.5)  # of the tests of one file


def _rows(*columns, separator=",", digits=7):
    return "".join(separator.join(f"{v:.{digits}f}" for v in row) + "\n" for row in zip(*columns))


def _runs_appended(path, t, runs):
    path.with_suffix(".csv").write_text("Time (s),Weg (mm),Kraft (N)\n" + "".join(_rows(t, x, f) for x, f in runs))


def _mts_blocks(path, t, runs):
    blocks = (
        f"Data Acquisition: Cyclic\t\t\tTime:\t{100 * k:.1f}\tSec\t1/1/2024 10:0{k}:00 AM\n"
        "Time\tAxial Displacement\tAxial Force\nSec\tmm\tkN\n"
        + _rows(t + 100 * k, x, f / 1e3, separator="\t", digits=9)
        for k, (x, f) in enumerate(runs)
    )
    path.with_suffix(".txt").write_text("MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\n" + "\n".join(blocks))


def _lvm_segments(path, t, runs):
    lines = ["LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t.", "X_Columns\tOne"]
    lines += ["***End_of_Header***\t", ""]
    for x, f in runs:
        lines += ["Channels\t2\t\t", f"Samples\t{t.size}\t{t.size}\t", "Y_Unit_Label\tmm\tN\t", "X0\t0\t0\t"]
        lines += [f"Delta_X\t{t[1]:.9f}\t{t[1]:.9f}\t", "***End_of_Header***\t\t", "X_Value\tWeg\tKraft\tComment"]
        lines += [_rows(t, x, f, separator="\t")]
    path.with_suffix(".lvm").write_text("\n".join(lines))


def _tdms_groups(path, t, runs):
    nptdms = pytest.importorskip("nptdms")
    channels = (
        nptdms.ChannelObject(f"run {k}", name, values, {"unit_string": unit, "wf_increment": t[1]})
        for k, run in enumerate(runs)
        for name, unit, values in zip(("Weg", "Kraft"), ("mm", "N"), run)
    )
    with nptdms.TdmsWriter(path.with_suffix(".tdms")) as writer:
        writer.write_segment(list(channels))


def _uff_runs(path, t, runs):
    pyuff = pytest.importorskip("pyuff")
    for run in runs:
        for k, (label, unit, values) in enumerate(zip(("Weg", "Kraft"), ("mm", "N"), run)):
            data = {
                "type": 58, "binary": k, "func_type": 1, "rsp_node": k, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
                "rsp_ent_name": "NONE", "id1": "run", "data": values, "x": t, "abscissa_spacing": 1,
                "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 0,
                "ordinate_axis_lab": label, "ordinate_axis_units_lab": unit, "ord_data_type": 4, "abscissa_inc": t[1],
                "abscissa_min": 0.0,
            }  # fmt: skip
            pyuff.UFF(str(path.with_suffix(".uff"))).write_sets([data], "add", force_double=True)


def _structs(t, runs):
    return [{"t_s": t, "weg_mm": x, "kraft_N": f} for x, f in runs]


def _matlab_struct_array(path, t, runs):
    import scipy.io

    array = np.zeros((1, len(runs)), dtype=[(name, object) for name in ("t_s", "weg_mm", "kraft_N")])
    for k, one in enumerate(_structs(t, runs)):
        array[0, k] = tuple(one.values())
    scipy.io.savemat(path.with_suffix(".mat"), {"run": array})


def _matlab_cell(path, t, runs):
    import scipy.io

    cell = np.empty((1, len(runs)), dtype=object)
    cell[0, :] = _structs(t, runs)
    scipy.io.savemat(path.with_suffix(".mat"), {"runs": cell})


def _json_runs(path, t, runs):
    some = [{k: v.tolist() for k, v in one.items()} for one in _structs(t, runs)]
    path.with_suffix(".json").write_text(json.dumps({f"run{k}": one for k, one in enumerate(some)}))


def _excel_sheets(path, t, runs):
    book = pytest.importorskip("openpyxl").Workbook()
    for k, (x, f) in enumerate(runs):
        sheet = book.create_sheet(f"run {k}")
        for row in (("Zeit [s]", "Weg [mm]", "Kraft [N]"), *zip(t.tolist(), x.tolist(), f.tolist())):
            sheet.append(row)
    book.save(path.with_suffix(".xlsx"))


SEVERAL = (
    _runs_appended, _mts_blocks, _lvm_segments, _tdms_groups, _uff_runs, _matlab_struct_array, _matlab_cell, _json_runs,
    _excel_sheets,
)  # fmt: skip


@form
@given(signals(), st.sampled_from(SEVERAL), st.integers(2, 3))
def test_several_tests_in_one_file(signal, write, n):
    rate, x, f = signal
    t = np.arange(x.size) / rate
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder, "a"), t, [(s * x, s * f) for s in SIZES[:n]])
        found = import_tests([folder])
    assert len(found) == n
    for size, one in zip(SIZES, found):
        same(one.record, rate, size * x, size * f)


def _rounded(rate, t, x, f):
    """Times rounded to more than a step, beside the rate that they were taken at."""
    return f"Sample rate: {rate:g} Hz\nTime (s),Weg (mm),Kraft (N)\n" + _rows(np.round(t, 2), x, f)


def _rate_and_units(rate, t, x, f):
    return f"Rig 3\nAbtastrate = {rate:g} Hz\nEinheiten: mm; kN\nWeg;Kraft\n" + _rows(
        x, f / 1e3, separator=";", digits=9
    )


def _side_metadata(rate, t, x, f):
    said = [f"Sample Interval,{1 / rate:.9e},s", "Vertical Units,N,", "Model,DPO,"]
    rows = _rows(t, x, f).splitlines()
    return "Record,,,Time (s),Weg (mm),Kraft\n" + "".join(
        f"{said[k] if k < 3 else ',,'},{row}\n" for k, row in enumerate(rows)
    )


def _one_name(rate, t, x, f):
    """The heading of the time stands before each channel, and another channel is called as the force is."""
    return "Time (s),Weg (mm),Time (s),Kraft (N),Kraft (V)\n" + _rows(t, x, t, f, 0 * f + 2.5)


def _json_columns(rate, t, x, f):
    return json.dumps({"fs": rate, "weg_mm": x.tolist(), "kraft_N": f.tolist()})


def _json_rows(rate, t, x, f):
    return json.dumps([{"t_s": a, "weg_mm": b, "kraft_N": c} for a, b, c in zip(t.tolist(), x.tolist(), f.tolist())])


ABOVE = _rounded, _rate_and_units, _side_metadata, _one_name, _json_columns, _json_rows


@form
@given(signals(), st.sampled_from(ABOVE))
def test_lines_and_columns_beside_the_signal(signal, text):
    rate, x, f = signal

    def write(folder):
        (folder / "a.txt").write_text(text(rate, np.arange(x.size) / rate, x, f))
        return folder / "a.txt"

    same(back(write), rate, x, f)


@form
@given(signals(), st.booleans(), st.sampled_from(["v7", "v7.3"]))
def test_matlab_tables_and_timetables(signal, clock, version):
    matio, pd = pytest.importorskip("matio"), pytest.importorskip("pandas")
    rate, x, f = signal
    t = np.arange(x.size) / rate
    table = pd.DataFrame({"weg_mm": x, "kraft_N": f})
    if clock:
        table.index = pd.Index(pd.to_timedelta(np.round(t * 1e9), unit="ns"), name="Time")
    else:
        table.insert(0, "Zeit_s", t)

    def write(folder):
        matio.save_to_mat(str(folder / "a.mat"), {"T": table}, version=version)
        return folder / "a.mat"

    same(back(write), rate, x, f)


def _drive(kind, phase):
    triangle = 4 * np.abs((phase + 0.75) % 1.0 - 0.5) - 1
    return {
        "triangle": triangle,
        "trapezoid": np.clip(1.4 * triangle, -1, 1),
        "third harmonic": np.sin(2 * np.pi * phase) + 0.4 * np.sin(6 * np.pi * phase + 0.3),
        "multisine": sum(np.cos(2 * np.pi * h * phase - 0.7 * h**2) / h for h in (1, 2, 5)),
    }[kind]


def _friction(u):
    """Three sliders in parallel and a spring."""
    out = 2.0 * u
    for k, level in ((40.0, 2.0), (25.0, 4.0), (10.0, 6.0)):
        z = 0.0
        for i in range(1, u.size):
            z = float(np.clip(z + k * (u[i] - u[i - 1]), -level, level))
            out[i] += z
    return out


@form
@given(
    st.sampled_from(["triangle", "trapezoid", "third harmonic", "multisine"]),
    st.sampled_from([250.0, 1000.0, 1280.0]),
    st.floats(60.0, 150.0),
    st.floats(0.3, 3.0),
    st.floats(0.0, 1.0),
)
def test_drives_that_are_no_sine(kind, rate, per_cycle, amplitude, start):
    u = amplitude * _drive(kind, np.arange(int(7.4 * per_cycle)) / per_cycle + start)
    f = _friction(u)

    def write(folder):
        (folder / "a.csv").write_text("Time (s),Weg (mm),Kraft (N)\n" + _rows(np.arange(u.size) / rate, u, f))
        return folder / "a.csv"

    record = back(write)
    same(record, rate, u, f)
    assert record.frequency_hz == pytest.approx(rate / per_cycle, rel=1e-2)
    assert not any("clipped" in w for w in record.warnings)


@settings(form, max_examples=max(EXAMPLES // 4, 1))
@given(st.lists(st.integers(3, 8), min_size=3, max_size=4), st.sampled_from([250.0, 1000.0]), st.floats(50.0, 100.0))
def test_a_staircase_gives_each_level_its_samples(cycles, rate, per_cycle):
    """As it stands it is asked of; split, each test holds samples of its own level."""
    phases = [np.arange(round(n * per_cycle)) / per_cycle for n in cycles]
    levels = [0.5, 1.0, 2.0, 3.5][: len(cycles)]
    u = np.concatenate([a * np.sin(2 * np.pi * p) for a, p in zip(levels, phases)])
    f, t = _friction(u), np.arange(u.size) / rate
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.csv")
        path.write_text("Time (s),Weg (mm),Kraft (N)\n" + _rows(t, u, f))
        with pytest.raises(ImportAsks, match="a staircase of") as asked:
            import_tests([path])
        found = import_tests([path], Recipe(), split=True)
    assert [q.option for q in asked.value.questions] == ["--split"]
    assert [x.loop.amplitude_mm for x in found] == pytest.approx(levels, rel=0.02)
    ends = np.cumsum([p.size for p in phases])
    for one, first, last in zip(found, [0, *ends], ends):
        at = np.rint(one.columns["time_s"] * rate).astype(int)
        at += 0 if at[0] >= first else first  # each test's own time, or the record's
        assert first - per_cycle / 2 <= at[0] and at[-1] <= last + per_cycle / 2
        np.testing.assert_allclose(one.record.force_N.max(), f[first:last].max(), rtol=0.05)
