"""Files as their own libraries write them come back sample by sample; damaged ones are refused in one line."""

import builtins
import zlib
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from bayes_iwan.campaign import CampaignError
from bayes_iwan.campaign.importing import import_tests, recordings
from bayes_iwan.campaign.importing.formats.text_layout import Layout
from bayes_iwan.campaign.importing.read import read_file

N, RATE = 500, 1280.0
T = np.arange(N) / RATE
X = np.sin(2 * np.pi * 10 * T)
F = 3.25 * np.cos(2 * np.pi * 10 * T)
TRUTH = {"Weg": X, "Kraft oben": F}


def read(path):
    return read_file(path, Layout())


def same(recording, units=("mm", "N"), rate=RATE, rtol=1e-12):
    found = {c.name: c for c in recording.channels}
    for (name, truth), unit in zip(TRUTH.items(), units):
        np.testing.assert_allclose(found[name].values, truth, rtol=rtol, atol=rtol)
        assert found[name].unit == unit
        assert rate is None or found[name].rate_hz == pytest.approx(rate, rel=1e-6)


def refused(path, *words):
    with pytest.raises(CampaignError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message and path.name in message
    for word in words:
        assert word in message, message


# --- TDMS


@pytest.fixture
def tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")

    def write(name="a.tdms", groups=("Messung",), **properties):
        with nptdms.TdmsWriter(tmp_path / name) as writer:
            for group in groups:
                channels = [
                    nptdms.ChannelObject(group, n, x, {"unit_string": unit, "wf_increment": 1 / RATE, **properties})
                    for (n, x), unit in zip(TRUTH.items(), ("mm", "N"))
                ]
                writer.write_segment(channels)
        return tmp_path / name

    return write


def test_tdms(tdms):
    (recording,) = read(tdms())
    same(recording)
    assert recording.part == ""
    first, second = read(tdms("b.tdms", groups=("run 1", "run 2")))
    same(first)
    same(second)
    assert (first.part, second.part) == ("run 1", "run 2")


def test_tdms_time_stamps_and_texts(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    stamps = np.datetime64("2026-11-21T10:00:00.000000") + np.arange(N) * np.timedelta64(1000, "us")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        channels = [nptdms.ChannelObject("g", "Uhr", stamps), nptdms.ChannelObject("g", "Kraft [kN]", F)]
        writer.write_segment([*channels, nptdms.ChannelObject("g", "Notiz", ["gut"] * N)])
    (recording,) = read(tmp_path / "a.tdms")
    assert [(c.name, c.unit) for c in recording.channels] == [("Uhr", "s"), ("Kraft", "kN")]
    np.testing.assert_allclose(recording.channels[0].values, np.arange(N) * 1e-3, atol=1e-9)


def test_tdms_unit_as_daqmx_writes_it(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("g", "Kraft", F, {"NI_UnitDescription": "kN"})])
    (recording,) = read(tmp_path / "a.tdms")
    assert [(c.name, c.unit) for c in recording.channels] == [("Kraft", "kN")]


def test_damaged_tdms(tdms, tmp_path, caplog):
    """Cut within its head it is refused; within its data what is there is read, and said once, by us alone."""
    whole = tdms().read_bytes()
    (tmp_path / "cut.tdms").write_bytes(whole[:60])
    refused(tmp_path / "cut.tdms")
    (tmp_path / "short.tdms").write_bytes(whole[:-800])
    (recording,) = read(tmp_path / "short.tdms")
    assert recording.channels[1].values.size < N
    assert any("ends before its data do" in warning for warning in recording.warnings)
    assert not caplog.records


# --- universal files


@pytest.fixture
def uff(tmp_path):
    pyuff = pytest.importorskip("pyuff")

    def write(name="a.uff", binary=0, even=1, runs=1, force_double=True, **changed):
        file = pyuff.UFF(str(tmp_path / name))
        for run in range(runs):
            for node, ((label, x), unit) in enumerate(zip(TRUTH.items(), ("mm", "N")), 1):
                data = {
                    "type": 58, "binary": binary, "func_type": 1, "rsp_node": node, "rsp_dir": 3, "ref_node": 0,
                    "ref_dir": 0, "rsp_ent_name": "NONE", "id1": f"run {run}", "data": x, "x": T,
                    "abscissa_spacing": even, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8,
                    "orddenom_spec_data_type": 0, "ordinate_axis_lab": label, "ordinate_axis_units_lab": unit,
                    "ord_data_type": 4, "abscissa_inc": 1 / RATE, "abscissa_min": 0.0,
                } | changed  # fmt: skip
                file.write_sets([data], "add", force_double=force_double)
        return tmp_path / name

    return write


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
def test_uff(uff, binary, even):
    (recording,) = read(uff(binary=binary, even=even))
    same(recording, rate=RATE if even else None, rtol=1e-12 if binary else 2e-11)
    if not even:
        times = [c for c in recording.channels if c.name == "time"]
        assert len(times) == 2, "each channel keeps its own abscissa"
        for time in times:  # ASCII abscissae have six digits
            np.testing.assert_allclose(time.values, T, atol=1e-12 if binary else 5e-7)


def test_uff_in_single_precision_and_several_runs(uff):
    (recording,) = read(uff("single.uff", force_double=False, ord_data_type=2))
    same(recording, rtol=1e-5)
    parts = read(uff("runs.uff", runs=3))
    assert [x.part for x in parts] == ["run 1", "run 2", "run 3"]
    for part in parts:
        same(part, rtol=2e-11)


def test_a_universal_file_that_fails_says_which_variant(uff, tmp_path):
    whole = uff("b.uff", binary=1).read_bytes()
    (tmp_path / "vms.uff").write_bytes(whole.replace(b"58b     1     2", b"58b     1     1"))
    refused(tmp_path / "vms.uff", "data set 1", "58b, little-endian, DEC VMS, double precision, even abscissa")
    (tmp_path / "short.uff").write_bytes(whole.replace(b"       500         1", b"       900         1"))
    refused(tmp_path / "short.uff", "500 of 900 values", "58b, little-endian, IEEE")
    text = uff("c.uff").read_text()
    (tmp_path / "bad.uff").write_text(text.replace(text.splitlines()[20], "x" * 80))
    refused(tmp_path / "bad.uff", "58, ASCII, double precision, even abscissa")
    (tmp_path / "none.uff").write_text("    -1\n   151\nmodel\n    -1\n")
    refused(tmp_path / "none.uff", "no data set 58")


def test_spectra_in_universal_files_are_left_out(uff):
    path = uff("a.uff", func_type=4)
    refused(path, "no signals")


# --- MATLAB


@pytest.mark.parametrize("compress", [True, False])
def test_matlab_v5(tmp_path, compress):
    run = {"Weg_mm": X, "Kraft_oben_N": F.reshape(1, -1), "note": "good", "count": 3.0}
    scipy.io.savemat(
        tmp_path / "a.mat", {"run": run, "fs": RATE, "both": np.column_stack([X, F])}, do_compression=compress
    )
    (recording,) = read(tmp_path / "a.mat")
    found = {c.name: c for c in recording.channels}
    assert {k: c.unit for k, c in found.items()} == {
        "run.Weg": "mm", "run.Kraft_oben": "N", "both(1)": "", "both(2)": ""
    }  # fmt: skip
    for name, truth in (("run.Weg", X), ("run.Kraft_oben", F), ("both(1)", X), ("both(2)", F)):
        np.testing.assert_array_equal(found[name].values, truth)
        assert found[name].rate_hz == RATE


T = np.arange(len(X)) / RATE
MAT_EXPORTS = {
    "simulink": {"out": {"time": T, "signals": [{"values": X, "label": "Weg"}, {"values": F, "label": "Kraft"}]}},
    "dspace": {"rec": {
        "X": {"Name": "Zeit", "Data": T, "Unit": "s"},
        "Y": [{"Name": "Weg", "Data": X, "Unit": "mm"}, {"Name": "Kraft", "Data": F, "Unit": "N"}],
    }},
    "testlab": {f"Signal_{k}": {
        "x_values": {"start_value": 0.0, "increment": 1.0 / RATE, "number_of_values": len(X)},
        "y_values": {"values": x, "quantity": {"label": unit}},
        "function_record": {"name": name},
    } for k, (name, x, unit) in enumerate([("Weg", X, "mm"), ("Kraft", F, "N")])},
}  # fmt: skip


@pytest.mark.parametrize("kind", MAT_EXPORTS)
def test_names_and_units_beside_an_array_are_its_own(tmp_path, kind):
    scipy.io.savemat(tmp_path / "a.mat", MAT_EXPORTS[kind])
    (recording,) = read(tmp_path / "a.mat")
    found = {c.name: c for c in recording.channels}
    assert {"Weg", "Kraft"} <= set(found)
    if kind != "simulink":
        assert (found["Weg"].unit, found["Kraft"].unit) == ("mm", "N")
    np.testing.assert_array_equal(found["Kraft"].values, F)


def test_a_title_of_many_arrays_names_none(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"test": {"title": "specimen", "units": "N", "Weg": X, "Kraft": F}})
    (recording,) = read(tmp_path / "a.mat")
    assert {(c.name, c.unit) for c in recording.channels} == {("test.Weg", ""), ("test.Kraft", "")}


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize(("was", "becomes"), [(9, 0), (9, 8), (9, 300), (14, 77)])
def test_matlab_elements_of_no_kind_do_not_end_the_process(tmp_path, compress, was, becomes):
    """SciPy's reader looks such a kind up without asking and the process dies of it."""
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"Weg": X}, do_compression=compress)
    raw = path.read_bytes()
    inner = zlib.decompress(raw[136:]) if compress else raw[128:]
    at = inner.index(was.to_bytes(4, "little"))
    inner = inner[:at] + becomes.to_bytes(4, "little") + inner[at + 4 :]
    packed = zlib.compress(inner)
    tag = (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little")
    path.write_bytes(raw[:128] + (tag + packed if compress else inner))
    refused(path, "MATLAB", "no kind of data")


def test_matlab_v73(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, x in (("Weg", X[None]), ("run/Kraft", F[:, None]), ("both", np.stack([X, F])), ("fs", [[RATE]])):
            file.create_dataset(name, data=x).attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("note", data=np.arange(40, dtype="uint16")[None])
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=X)
    with path.open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    (recording,) = read(path)
    found = {c.name: c.values for c in recording.channels}
    assert set(found) == {"Weg", "run.Kraft", "both(1)", "both(2)"}
    for name, truth in (("Weg", X), ("run.Kraft", F), ("both(1)", X), ("both(2)", F)):
        np.testing.assert_array_equal(found[name], truth)
    assert recording.channels[0].rate_hz == RATE
    (tmp_path / "cut.mat").write_bytes(path.read_bytes()[:3000])
    refused(tmp_path / "cut.mat", "v7.3")


SAMPLES = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"


@pytest.mark.parametrize("path", sorted(SAMPLES.glob("*.mat")), ids=lambda p: p.name)
def test_matlab_files_that_scipy_installs(path, monkeypatch):
    """Every one, written by MATLAB 4 to 7.4 on three machines, is read as it was meant or refused in one line."""
    monkeypatch.setattr(recordings, "FEWEST_SAMPLES", 2)
    try:
        (recording,) = read(path)
    except CampaignError as error:
        assert not path.name.startswith("testdouble")
        assert path.name in str(error) and "\n" not in str(error)
        return
    found = {c.name: c.values for c in recording.channels}
    if path.name.startswith("testdouble"):
        np.testing.assert_allclose(found["testdouble"], np.arange(9) * np.pi / 4, rtol=1e-14)


# --- Parquet


def test_parquet(tmp_path):
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame({"time_s": T, "Weg_mm": X, "Kraft oben [N]": F, "who": ["a"] * N})
    frame.to_parquet(tmp_path / "a.parquet")
    (recording,) = read(tmp_path / "a.parquet")
    same(recording, rate=None)
    frame.set_index("time_s").to_parquet(tmp_path / "b.parquet")
    (recording,) = read(tmp_path / "b.parquet")
    np.testing.assert_array_equal(recording.channels[0].values, T)
    (tmp_path / "c.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:2000])
    refused(tmp_path / "c.parquet", "Parquet")


def test_a_damaged_tree_in_hdf5_is_one_line(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("Weg_mm", data=X)
    path.write_bytes(path.read_bytes().replace(b"SNOD", b"SNAD"))
    refused(path, "HDF5")


@pytest.mark.parametrize(
    ("name", "start", "module", "says"),
    [
        ("a.tdms", b"TDSm", "nptdms", "npTDMS"),
        ("a.uff", b"    -1\n    58\n", "pyuff", "pyuff"),
        ("a.parquet", b"PAR1", "pyarrow", "pyarrow"),
    ],
)
def test_a_missing_library_is_named(tmp_path, monkeypatch, name, start, module, says):
    (tmp_path / name).write_bytes(start + bytes(40))
    real = builtins.__import__

    def without(wanted, *args, **options):
        if wanted.split(".")[0] == module:
            raise ImportError(wanted)
        return real(wanted, *args, **options)

    monkeypatch.setattr("importlib.import_module", lambda wanted: without(wanted))
    refused(tmp_path / name, says, "python -m pip install")


def test_a_channel_that_states_no_start_begins_with_the_file(tmp_path):
    """Only the displacement says that it began 12 ms late."""
    nptdms = pytest.importorskip("nptdms")
    t = np.arange(1000) / 250.0
    x, f = np.sin(10 * np.pi * (t + 0.012)), 20.0 * np.sin(10 * np.pi * t + 0.5)
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        for name, unit, values, more in (("Disp", "mm", x, {"wf_start_offset": 0.012}), ("Force", "N", f, {})):
            said = {"unit_string": unit, "wf_increment": 0.004, **more}
            writer.write_segment([nptdms.ChannelObject("rig", name, values, said)])
    (test,) = import_tests([tmp_path / "a.tdms"])
    u = 2 * np.mean(test.loop.displacement_mm * np.exp(-2j * np.pi * test.loop.phase))
    assert np.angle(test.loop.harmonics_N[1] / u) == pytest.approx(0.5, abs=0.01)
    assert any("aligned by start" in x for x in test.record.warnings)


@pytest.mark.parametrize("late", [0, 7])
def test_tdms_groups_that_hold_times_alone_lend_them(tmp_path, late):
    nptdms = pytest.importorskip("nptdms")
    t = np.arange(600) / 200
    x, f = np.sin(2 * np.pi * 5 * t), 40 * np.sin(2 * np.pi * 5 * t + 0.5)
    end = t.size - late
    parts = [("Zeit Weg", "t", t[:end], "s"), ("M", "Weg", x[:end], "mm"), ("M", "Kraft", f[late:], "N")]
    parts += [("Zeit Kraft", "t", t[late:], "s")] if late else []
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject(g, n, v, {"unit_string": u}) for g, n, v, u in parts])
    (test,) = import_tests([tmp_path / "a.tdms"])
    n = test.record.time_s.size
    np.testing.assert_allclose(test.record.displacement_mm, x[late : late + n], atol=1e-9)
    np.testing.assert_allclose(test.record.force_N, f[late : late + n], atol=1e-9)


def test_a_lvm_file_s_stamps_align_its_channels(tmp_path):
    t = np.arange(600) / 200
    x, f = np.sin(2 * np.pi * 5 * t), 40 * np.sin(2 * np.pi * 5 * t + 0.5)
    head = ["LabVIEW Measurement\t", "Separator\tTab", "X_Columns\tOne", "***End_of_Header***\t", "", "Channels\t2\t"]
    head += ["Time\t09:26:53.100\t09:26:53.135\t", "Y_Unit_Label\tmm\tN\t", "X_Dimension\tTime\tTime\t"]
    head += ["Delta_X\t0.005\t0.005\t", "***End_of_Header***\t\t", "X_Value\tWeg\tKraft\tComment"]
    lines = [f"{a:.3f}\t{b:.6f}\t{c:.6f}" for a, b, c in zip(t, x[:-7], f[7:])]
    file = tmp_path / "a.lvm"
    file.write_text("\n".join([*head, *lines, ""]))
    (test,) = import_tests([file])
    np.testing.assert_allclose(test.record.force_N[:500], f[7:507], atol=1e-6)
    np.testing.assert_allclose(test.record.displacement_mm[:500], x[7:507], atol=1e-6)
    file.write_text(file.read_text().replace("Time\tTime", "Frequency\tFrequency"))
    with pytest.raises(CampaignError, match="X is 'Frequency'"):
        import_tests([file])


@pytest.mark.parametrize(("unit", "size"), [("ms", 1e3), ("s", 1.0)])
def test_a_universal_file_s_abscissa_has_its_unit(tmp_path, unit, size):
    pyuff = pytest.importorskip("pyuff")
    t = np.arange(600) / 200
    for name, y, u in (("Weg", np.sin(2 * np.pi * 5 * t), "mm"), ("Kraft", 40 * np.sin(2 * np.pi * 5 * t + 0.5), "N")):
        data = {
            "type": 58, "binary": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
            "rsp_ent_name": "NONE", "id1": name, "data": y, "x": t * size, "abscissa_spacing": 1,
            "abscissa_spec_data_type": 17, "abscissa_axis_units_lab": unit, "ordinate_spec_data_type": 8,
            "orddenom_spec_data_type": 0, "ordinate_axis_lab": name, "ordinate_axis_units_lab": u, "ord_data_type": 4,
            "abscissa_inc": size / 200, "abscissa_min": 0.0,
        }  # fmt: skip
        pyuff.UFF(str(tmp_path / "a.uff")).write_sets([data], "add", force_double=True)
    (test,) = import_tests([tmp_path / "a.uff"])
    assert test.record.frequency_hz == 5.0


@pytest.mark.parametrize("word", ["Sample Rate (Hz)", "SampleFrequency", "fs_kHz", "dt"])
def test_one_list_of_words_for_rates_in_all_formats(tmp_path, word):
    nptdms = pytest.importorskip("nptdms")
    import scipy.io

    from bayes_iwan.campaign.importing.clock_words import stated_rates

    value = {"fs_kHz": 0.2, "dt": 0.005}.get(word, 200.0)
    t = np.arange(600) / 200
    x, f = np.sin(2 * np.pi * 5 * t), 40 * np.sin(2 * np.pi * 5 * t + 0.5)
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        channels = [nptdms.ChannelObject("g", n, v, {"unit_string": u}) for n, v, u in (("x", x, "mm"), ("F", f, "N"))]
        writer.write_segment([nptdms.RootObject({word: value}), *channels])
    (test,) = import_tests([tmp_path / "a.tdms"])
    assert test.record.frequency_hz == 5.0
    if "(" not in word:
        scipy.io.savemat(tmp_path / "a.mat", {"x_mm": x, "F_N": f, word: value})
        (test,) = import_tests([tmp_path / "a.mat"])
        assert test.record.frequency_hz == 5.0
    (tmp_path / "a.csv").write_text(f"{word}: {value}\nx (mm);F (N)\n" + "".join(f"{a};{b}\n" for a, b in zip(x, f)))
    (test,) = import_tests([tmp_path / "a.csv"])
    assert test.record.frequency_hz == 5.0
    assert stated_rates(["Period: 0.2 s", "Step: 3", "Resolution: 1 us"]) == ()
