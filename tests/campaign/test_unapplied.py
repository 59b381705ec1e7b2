"""What a file states and an import does not apply is said; what only has a force's unit is not taken for the force."""

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from bayes_iwan.campaign import CampaignError, read_campaign
from bayes_iwan.campaign.importing.clock_words import stated_rates
from bayes_iwan.campaign.importing.importer import import_tests, write_tests
from bayes_iwan.campaign.importing.questions import ImportAsks
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import only_rate
from bayes_iwan.campaign.recording.unapplied import not_applied

N, RATE_HZ, FREQUENCY_HZ, LATE_S = 1000, 250.0, 5.0, 0.008
T = np.arange(N) / RATE_HZ


def motion(t):
    return np.sin(2 * np.pi * FREQUENCY_HZ * t)


def force(t):
    p = 2 * np.pi * FREQUENCY_HZ * t
    return 50.0 * (np.sin(p + 0.4) + 0.1 * np.sin(3 * p))


ENERGY_NMM = np.pi * 50.0 * np.sin(0.4)
U, F, LATE_F = motion(T), force(T), force(T + LATE_S)


def energy(test):
    loop = test.loop
    return float(np.mean(loop.force_N * loop.velocity_m_s) / loop.frequency_hz * 1e3)


def text(path, head, *columns):
    rows = [";".join(x if isinstance(x, str) else f"{x:.9f}" for x in row) for row in zip(*columns)]
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    return path


def stamps(t):
    return [str(np.datetime64("2024-03-01T23:59:58") + np.timedelta64(round(1e6 * x), "us"))[11:] for x in t]


@pytest.mark.parametrize(
    "line", ["Force start offset: 0.008 s", "t0=0.000;t0=0.008", "Kanal-Delay Kraft = 0,008", "Scale factor;1;1;10"]
)
def test_a_start_or_factor_above_a_table_is_said(tmp_path, line):
    file = text(tmp_path / "a.csv", ["Sample rate: 250 Hz", line, "Displacement (mm);Force (N)"], U, LATE_F)
    (test,) = import_tests([file])
    assert any("which is not applied" in x for x in test.record.warnings)


def test_neutral_statements_are_not_said():
    assert (
        not_applied(
            [
                "Start time: 10:00:00",
                "T0=01.03.2024 10:00:00",
                "Delay: 0.000 s",
                "Gain;1;1",
                "Vertical Scale,0.5",
                "again 10",
            ]
        )
        == ()
    )


def test_stamps_of_each_channel_align_them_across_midnight(tmp_path):
    head = ["Zeit;Weg [mm];Zeit;Kraft [N]"]
    (test,) = import_tests([text(tmp_path / "a.csv", head, stamps(T), U, stamps(T + LATE_S), LATE_F)])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


@pytest.mark.parametrize("name", ["Force error (N)", "Energy (Nm)", "Work (J)", "Kraft Soll (N)"])
def test_what_only_has_the_unit_of_a_force_is_asked_for(tmp_path, name):
    with pytest.raises(ImportAsks, match="No channel is known as force"):
        import_tests([text(tmp_path / "a.csv", [f"Time (s);Displacement (mm);{name}"], T, U, F)])


def test_the_measured_position_is_taken_beside_its_setpoint(tmp_path):
    head = ["Time (s);Position setpoint (mm);Position actual (mm);Force (N)"]
    (test,) = import_tests([text(tmp_path / "a.csv", head, T, 1.1 * U, U, F)])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_mn_in_capitals_is_asked_for(tmp_path):
    with pytest.raises(ImportAsks, match="meganewtons or millinewtons"):
        import_tests([text(tmp_path / "a.csv", ["TIME (SEC);DISP (MM);LOAD (MN)"], T, U, 1e3 * F)])


@pytest.mark.parametrize("first_day", [45_352.0, 739_312.0, 2_460_370.5])
def test_days_of_spreadsheets_matlab_and_astronomers(tmp_path, first_day):
    days = [f"{first_day + x / 86400:.12f}" for x in T]
    (test,) = import_tests([text(tmp_path / "a.csv", ["Time;Displacement (mm);Force (N)"], days, U, F)])
    assert test.loop.frequency_hz == pytest.approx(FREQUENCY_HZ, rel=0.02)


def test_typographical_minus_and_mils(tmp_path):
    cells = [f"{x:.9f}".replace("-", "−") for x in U / 0.0254]
    (test,) = import_tests([text(tmp_path / "a.csv", ["Time (s);Displacement (mils);Force (N)"], T, cells, F)])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_hdf5_attributes_give_unit_rate_and_start(tmp_path):
    t = np.arange(2 * N) / (2 * RATE_HZ)
    with h5py.File(tmp_path / "a.h5", "w") as out:
        for name, values, unit, rate, start in (
            ("displacement", U, "mm", RATE_HZ, 0.0),
            ("force", force(t + LATE_S) / 1e3, "kN", 2 * RATE_HZ, LATE_S),
        ):
            one = out.create_dataset(name, data=values)
            one.attrs.update({"units": unit, "sample_rate": rate, "start_time": start})
    (test,) = import_tests([tmp_path / "a.h5"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_structs_with_a_step_and_start_of_their_own(tmp_path):
    laser = {"disp_mm": U, "dt": 1 / RATE_HZ, "t0": 0.0}
    cell = {"force_N": LATE_F, "dt": 1 / RATE_HZ, "t0": LATE_S}
    scipy.io.savemat(tmp_path / "a.mat", {"laser": laser, "cell": cell})
    (test,) = import_tests([tmp_path / "a.mat"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_durations_in_parquet_are_times(tmp_path):
    table = pd.DataFrame({"t": pd.to_timedelta(T, unit="s"), "disp_mm": U, "force_N": F})
    table.to_parquet(tmp_path / "a.parquet")
    (test,) = import_tests([tmp_path / "a.parquet"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_a_tdms_gain_is_said(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    channels = [("Displacement", U, {"unit_string": "mm"}), ("Force", F / 10, {"unit_string": "N", "Gain": 10.0})]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as out:
        out.write_segment([nptdms.ChannelObject("g", n, x, {**p, "wf_increment": 1 / RATE_HZ}) for n, x, p in channels])
    (test,) = import_tests([tmp_path / "a.tdms"])
    assert any("Gain = 10" in x for x in test.record.warnings)


@pytest.mark.parametrize("start, what", [(b"MDF     4.10    ", "ASAM MDF"), (b"\x93NUMPY\x01\x00", "NumPy array")])
def test_formats_that_are_not_read_are_named(tmp_path, start, what):
    (tmp_path / "a.dat").write_bytes(start + bytes(500))
    with pytest.raises(CampaignError, match=what):
        import_tests([tmp_path / "a.dat"])


DAY = "2024-03-14 "
STARTS = {"iso": "2024-03-14T09:26:53.{:03d}", "space": DAY + "09:26:53.{:03d}", "day": "09:26:53.{:03d}"}


def began(form, late_s):
    return STARTS[form].format(round(1e3 * late_s))


def one_channel(folder, form, name, unit, values, late_s):
    """A file with one channel that says in its own way when it began."""
    path = folder / f"run1_{name}"
    moments = np.datetime64(began("iso", late_s)) + np.rint(1e6 * T).astype("timedelta64[us]")
    if form == "stamps":
        return text(path.with_suffix(".csv"), [f"time;{name} ({unit})"], [str(x) for x in moments], values)
    if form == "times of day":
        return text(path.with_suffix(".csv"), [f"time;{name} ({unit})"], [str(x)[11:] for x in moments], values)
    if form == "dates beside":
        cells = ([str(x)[:10] for x in moments], [str(x)[11:] for x in moments])
        return text(path.with_suffix(".csv"), [f"Date;Time;{name} ({unit})"], *cells, values)
    if form == "seconds since 1970":
        return text(path.with_suffix(".csv"), [f"t;{name} ({unit})"], T + 1.7e9 + late_s, values)
    if form in ("preamble", "preamble in ms"):
        size, clock = (1e3, "ms") if form.endswith("ms") else (1.0, "s")
        head = [f"Start time: {began('space', late_s)}", f"time ({clock});{name} ({unit})"]
        return text(path.with_suffix(".csv"), head, size * T, values)
    if form == "lvm":
        keys = f"Date\t2024/03/14\nTime\t{began('day', late_s)}\n"
        head = f"{keys}X0\t0\nDelta_X\t{1 / RATE_HZ}\nY_Unit_Label\t{unit}\n***End_of_Header***\nX_Value\t{name}\n"
        body = "".join(f"{t:.6f}\t{x:.9f}\n" for t, x in zip(T, values))
        path.with_suffix(".lvm").write_text(f"LabVIEW Measurement\n***End_of_Header***\n\n{head}{body}")
        return path.with_suffix(".lvm")
    if form == "parquet":
        pd.DataFrame({"time": moments, f"{name}_{unit}": values}).to_parquet(path.with_suffix(".parquet"))
        return path.with_suffix(".parquet")
    if form == "hdf5":
        with h5py.File(path.with_suffix(".h5"), "w") as out:
            out[name] = values
            out[name].attrs.update({"unit": unit, "sample_rate": RATE_HZ, "start_time": 1.7e9 + late_s})
        return path.with_suffix(".h5")
    nptdms = pytest.importorskip("nptdms")
    properties = {"unit_string": unit, "wf_increment": 1 / RATE_HZ, "wf_start_time": moments[0]}
    with nptdms.TdmsWriter(path.with_suffix(".tdms")) as out:
        out.write_segment([nptdms.ChannelObject("g", name, values, properties)])
    return path.with_suffix(".tdms")


@pytest.mark.parametrize(
    "form",
    "stamps, times of day, dates beside, seconds since 1970, preamble, preamble in ms, lvm, parquet, hdf5, tdms".split(
        ", "
    ),
)
def test_files_that_say_when_they_began_are_aligned_by_it(tmp_path, form):
    files = [
        one_channel(tmp_path, form, "disp", "mm", U, 0.0),
        one_channel(tmp_path, form, "force", "N", LATE_F, LATE_S),
    ]
    (test,) = import_tests(files)
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)
    assert not any("one clock" in x for x in test.record.warnings)


def test_files_that_do_not_say_when_they_began_are_said_to(tmp_path):
    files = [
        text(tmp_path / f"{n}.csv", [f"t (s);{n} ({u})"], T, x) for n, u, x in (("disp", "mm", U), ("force", "N", F))
    ]
    (test,) = import_tests(files)
    assert any("do not say when they began" in x for x in test.record.warnings)
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_starts_since_1970_align_the_channels_of_one_file(tmp_path):
    laser = {"disp_mm": U, "fs": RATE_HZ, "t0": 1.7e9}
    scipy.io.savemat(
        tmp_path / "a.mat", {"laser": laser, "cell": {"force_N": LATE_F, "fs": RATE_HZ, "t0": 1.7e9 + LATE_S}}
    )
    (test,) = import_tests([tmp_path / "a.mat"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)
    assert not any("not applied" in x for x in test.record.warnings)


@pytest.mark.parametrize("word", ["sensitivity", "Resolution", "offset", "scale", "gain", "Empfindlichkeit", "YInc"])
@pytest.mark.parametrize("value", [9.55, "9.55 mV/N"])
@pytest.mark.parametrize("form", ["hdf5", "mat", "tdms"])
def test_what_a_channel_states_and_nothing_applies_is_said(tmp_path, word, value, form):
    columns = {"t": (T, "s", {}), "disp": (U, "mm", {}), "force": (F, "N", {word: value})}
    if form == "hdf5":
        with h5py.File(tmp_path / "a", "w") as out:
            for name, (values, unit, more) in columns.items():
                out[name] = values
                out[name].attrs.update({"unit": unit, **more})
    elif form == "mat":
        scipy.io.savemat(
            tmp_path / "a.mat", {"run": {f"{k}_{u}": x for k, (x, u, _) in columns.items()} | {word: value}}
        )
        (tmp_path / "a.mat").rename(tmp_path / "a")
    else:
        nptdms = pytest.importorskip("nptdms")
        with nptdms.TdmsWriter(tmp_path / "a") as out:
            out.write_segment(
                [nptdms.ChannelObject("g", k, x, {"unit_string": u, **more}) for k, (x, u, more) in columns.items()]
            )
    (test,) = import_tests([tmp_path / "a"])
    assert any(f"{word} = 9.55" in x and "which is not applied" in x for x in test.record.warnings)
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


def test_packed_numbers_of_netcdf_are_unpacked(tmp_path):
    with h5py.File(tmp_path / "a.nc", "w") as out:
        for name, values, unit in (("time", T, "s"), ("displacement", U, "mm"), ("force", F, "N")):
            out[name] = np.rint((values - 3.0) / 1e-3).astype("i4")
            out[name].attrs.update({"units": unit, "scale_factor": 1e-3, "add_offset": 3.0})
    (test,) = import_tests([tmp_path / "a.nc"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)
    assert not any("not applied" in x for x in test.record.warnings)


HEADS = ["t [s];x [mm];F [N]"]


def test_a_rate_of_which_not_all_rows_were_kept_is_asked_for(tmp_path):
    """10 Hz were read for 5 without a word."""
    with pytest.raises(ImportAsks, match="nor a sample rate"):
        import_tests([text(tmp_path / "a.txt", ["Sample rate 500 Hz (decimated by 2)", "x [mm];F [N]"], U, F)])


def test_hours_have_no_prefix(tmp_path):
    """HH was a hundred hours."""
    with pytest.raises(ImportAsks, match=r"'t \(HH\)' goes up by .* states no unit that is known"):
        import_tests([text(tmp_path / "a.txt", ["t (HH);x [mm];F [N]"], T / 3600, U, F)])


def test_a_time_without_a_number_starts_no_run(tmp_path):
    path = text(tmp_path / "a.txt", HEADS, [t if k != 50 else "NaN" for k, t in enumerate(T)], U, F)
    (test,) = import_tests([path])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.01)


def test_a_refusal_names_samples_without_a_number(tmp_path):
    lost = [f"{x:.5f}" if x < 45 else "Err" for x in F]
    with pytest.raises(CampaignError, match=r"lost to gaps.* \d+ sample\(s\) without a number dropped: was the range"):
        import_tests([text(tmp_path / "a.txt", HEADS, T, U, lost)])


def test_a_tab_in_a_file_name_makes_a_campaign_that_reads(tmp_path):
    tests = import_tests([text(tmp_path / "run\t1.txt", HEADS, T, U, F)])
    write_tests(tests, tmp_path / "campaign")
    assert [x.file for x in read_campaign(tmp_path / "campaign").tests] == ["run_1.csv"]


IN_NAMES = (
    "x2, x10, *2, /2, /10, 2x, gain 100, gain10, G=10, amp 10, scaled 0.1, delayed 4 ms, +4ms, offset 50, -2 samples, "
    "lowpass 100 Hz, filtered, smoothed, LP50, TP 100, moving average, gefiltert, geglättet, filtré, mean of 10"
)


@pytest.mark.parametrize("said", IN_NAMES.split(", "))
def test_a_factor_offset_delay_or_filter_in_a_channels_name_is_said(tmp_path, said):
    (test,) = import_tests([text(tmp_path / "a.txt", [f"t [s];x [mm];Force {said} [N]"], T, U, F)])
    assert any(f"'Force {said}' may name a factor, an offset, a delay or a filter" in x for x in test.record.warnings)
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)


@pytest.mark.parametrize(
    "motion, force",
    [
        ("Weg 10mm", "U9C 5kN"),
        ("Lissajous u", "Bypass valve force"),
        ("x2", "Force 2"),
        ("Disp x1", "F2"),
        ("LVDT 3", "Load cell 1/2"),
        ("Laser x2", "Force 10 kN range"),
    ],
)
def test_axes_and_numbers_in_names_are_no_factors(tmp_path, motion, force):
    other = motion[:-1] + "9"  # a kin, which makes of x2 an axis
    (test,) = import_tests(
        [text(tmp_path / "a.txt", [f"t [s];{motion} [mm];{force} [N];{other} [V]"], T, U, F, F / 100)],
    )
    assert not any("may name" in x for x in test.record.warnings)


def test_a_sign_in_a_name_is_decided_by_the_loop(tmp_path):
    heads = ["t [s];x [mm];Force inverted [N]"]
    (test,) = import_tests([text(tmp_path / "a.txt", heads, T, U, F)])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)
    with pytest.raises(
        CampaignError, match=r"one channel is reversed.*this file's .*where all files are .*--reverse force"
    ):
        import_tests([text(tmp_path / "b.txt", heads, T, U, -F)])


@pytest.mark.parametrize("name", ["Peak force", "Force max", "abs(Force)", "Force_rms", "|Force|", "Force p-p"])
def test_what_is_derived_of_a_force_is_asked_for(tmp_path, name):
    with pytest.raises(ImportAsks, match="No channel is known as force"):
        import_tests([text(tmp_path / "a.txt", [f"t [s];x [mm];{name} [N]"], T, U, F)])
    recipe = Recipe(channels={"force": name})
    (test,) = import_tests([tmp_path / "a.txt"], recipe)
    assert any(f"{name!r} is no force or motion as it was measured" in x for x in test.record.warnings)


@pytest.mark.parametrize("name", ["force_lowpass_100Hz_N", "force_x10_N", "abs_force_N", "force_4_ms_late_N"])
def test_names_in_a_campaigns_own_files_are_read_as_those_of_imports(folder, toml, name):
    path = folder(toml.replace("force_N", name))
    (path / "test.csv").write_text((path / "test.csv").read_text().replace("force_N", name))
    assert any(f"'{name[:-2]}' " in x for x in read_campaign(path).tests[0].warnings)


def test_an_absolute_value_is_said_whatever_it_is_called(tmp_path):
    (test,) = import_tests([text(tmp_path / "a.txt", ["t [s];x [mm];F [N]"], T, U, np.abs(F))])
    assert any("a force without its sign" in x for x in test.record.warnings)


RATES = (
    "Rate 0.5 kHz", "500 S/s", "Sample time: 0.002", "dt = 2 ms", "Sampling interval 2 ms", "Sampled at 500 Hz",
    "Samples per second: 500", "Δt: 0.002 s", "Sampling freq. (Hz) 500", "Date: 1.3.2024; Sampling rate: 500 Hz",
    "Periodo de muestreo: 0,002 s", "Sampling rate;0,5;kHz", "Sample rate: 0.5 кГц", "Sampling rate: 500 1/s",
    "Sample Rate Per Channel: 500.000 Hz",
)  # fmt: skip


@pytest.mark.parametrize("line", RATES)
def test_a_rate_is_read_by_its_label_number_and_unit(line):
    assert stated_rates([line]) == (500.0,)


NO_RATES = (
    "FS: 10 kN", "fs 100 N", "Sample 3, 8 Hz", "Data 8 Hz 1.2 mm", "Recorded: 2024-03-01", "Sampling time: 20 s",
    "NI 9234 51.2 kS/s", "Sample rate: 1 000 Hz", "Sampling rate [Hz];500;250", "500 S/s;100 S/s", "SR 12",
    "Sampling interval 0.1 mm", "Rate: 0.5 mm/s", "Max. sampling rate: 100 kHz", "Rate: 8 Hz",
    "Sample rate: 8000 Hz; oversampling 16", "Sample rate: 8000 Hz; output rate: 500 Hz", "Sampling rate: 1,280 Hz",
    "Sampling interval;2e-3;4e-3",
)  # fmt: skip


@pytest.mark.parametrize("line", NO_RATES)
def test_what_is_no_rate_of_all_samples_is_asked(line):
    """10 kN full scale was read as 10 samples a second, the first of several rates as all of them."""
    assert only_rate(stated_rates([line])) is None


@pytest.mark.parametrize("mark, decimal", [(".", ","), (",", "."), (".", ""), (",", "")])
def test_a_rate_whose_mark_may_divide_thousands_is_asked_in_one_message(tmp_path, mark, decimal):
    """1.280 Hz were read for 1,280 where numbers have decimal commas, and 1,280 was not mentioned."""
    values = [[f"{x:.6f}".replace(".", decimal) if decimal else f"{1e3 * x:.0f}" for x in y] for y in (U, F)]
    units = ("mm", "N") if decimal else ("um", "mN")
    head = [f"Sampling rate: 1{mark}280 Hz", "Disp ({}); Force ({})".format(*units)]
    with pytest.raises(
        ImportAsks, match=r"states 1\.28 or 1280 samples a second: which is right\? Say it with --sample"
    ):
        import_tests([text(tmp_path / "a.txt", head, *values)])
    head[0] = f"Sampling rate: 1{decimal or mark}280 kHz"
    if decimal:
        (test,) = import_tests([text(tmp_path / "a.txt", head, *values)])
        assert test.loop.frequency_hz == pytest.approx(FREQUENCY_HZ * 1280 / RATE_HZ, rel=1e-3)


@pytest.mark.parametrize(
    "lines, said",
    [
        (["Channel;Filter", "Disp;off", "Force;Bessel 50 Hz"], "'Force Filter: Bessel 50 Hz', which is not undone"),
        (["Filter;off;LP 50 Hz"], "'Filter;off;LP 50 Hz', which is not undone"),
        (["Moving average: 9"], "'Moving average: 9', which is not undone"),
        (["Channel;Offset", "Disp;0", "Force;0.0"], ""),
        (["Filter: off; range 100 N"], ""),
    ],
)
def test_a_filter_above_a_table_is_said(tmp_path, lines, said):
    (test,) = import_tests([text(tmp_path / "a.txt", [*lines, "t [s];x [mm];F [N]"], T, U, F)])
    assert (
        [x for x in test.record.warnings if said in x]
        if said
        else not any("which is not" in x for x in test.record.warnings)
    )


def test_a_unit_above_a_table_that_contradicts_the_columns_is_asked(tmp_path):
    with pytest.raises(ImportAsks, match=r"'Force \(N\), kN' \(force\) states two units"):
        import_tests([text(tmp_path / "a.txt", ["Force unit: kN", "t [s];x [mm];Force (N)"], T, U, F)])


def test_ticks_of_100_ns_are_no_nanoseconds(tmp_path):
    ticks = [str(638_775_736_131_234_567 + round(1e7 * t)) for t in T]
    with pytest.raises(ImportAsks, match="states no unit that is known"):
        import_tests([text(tmp_path / "a.txt", ["Timestamp;x [mm];F [N]"], ticks, U, F)])


def test_a_rate_in_a_struct_of_which_not_all_samples_were_kept_is_asked_for(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"x_mm": U, "F_N": F, "fs": 8 * RATE_HZ, "oversampling": 8.0})
    with pytest.raises(ImportAsks, match="nor a sample rate"):
        import_tests([tmp_path / "a.mat"])


def test_structs_as_testlab_and_dewesoft_write_them(tmp_path):
    def signal(values, unit, name):
        axis = {"start_value": 0.0, "increment": 1 / RATE_HZ, "quantity": {"label": "s"}}
        y = {"values": values, "quantity": {"label": unit}}
        return {"x_values": axis, "y_values": y, "function_record": {"name": name}}

    scipy.io.savemat(tmp_path / "a.mat", {"S0": signal(U, "mm", "Displacement"), "S1": signal(F, "N", "Force")})
    (test,) = import_tests([tmp_path / "a.mat"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)
    own = {"D1_Weg_mm": U, "D1_time_Weg_s": T, "D1_Kraft_N": LATE_F, "D1_time_Kraft_s": T + LATE_S}
    scipy.io.savemat(tmp_path / "b.mat", own)
    (test,) = import_tests([tmp_path / "b.mat"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.005)
