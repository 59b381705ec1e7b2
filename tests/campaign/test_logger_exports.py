"""A known loop as public loggers and testing machines export it: read with the right energy, or asked of in one line.

Each form is written after the program's own exports: its preamble, its marks, its units and its side channels.
"""

import json
import zipfile

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests

RATE, N, AMPLITUDE, FREQUENCY = 500.0, 1000, 1.25, 5.0
T = np.arange(N) / RATE
X = AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * T + 0.3)
F = 1800.0 * np.sin(2 * np.pi * FREQUENCY * T + 0.7) + 0.5 * np.random.default_rng(0).standard_normal(N)
ENERGY_NMM = np.pi * AMPLITUDE * 1800.0 * np.sin(0.4)


def table(head, *columns, separator=",", decimal=".", end="\n", tail="", fmt="{:.6f}"):
    """Lines above, then rows; a column is an array, or texts."""
    cells = [[c if isinstance(c, str) else fmt.format(c).replace(".", decimal) for c in row] for row in zip(*columns)]
    return end.join([*head, *(separator.join(row) for row in cells)]) + end + tail


def clock(form, start=0.0):
    import datetime

    day = datetime.datetime(2025, 3, 14, 9, 26, 53)
    return [(day + datetime.timedelta(seconds=float(t + start))).strftime(form) for t in T]


def german(values, digits=6):
    return [f"{v:,.{digits}f}".translate(str.maketrans(",.", ".,")) for v in values]


def french(values, digits=6):
    return [f"{v:,.{digits}f}".replace(",", "\u202f").replace(".", ",") for v in values]


_T, _X, _F = ([round(float(v), 6) for v in values] for values in (T, X, F))
#: a value of JSON, and what must be said of it
JSON = {
    "columns": ({"time_s": _T, "disp_mm": _X, "force_N": _F}, {}),
    "records": ([{"t_s": t, "stage": {"disp_mm": x}, "force_N": f} for t, x, f in zip(_T, _X, _F)], {}),
    "rows": ([[t, x, f] for t, x, f in zip(_T, _X, _F)],
             {"channels": {"time": "1", "displacement": "2", "force": "3"},
              "units": {"time": "s", "displacement": "mm", "force": "N"}}),
    "split": ({"columns": ["time_s", "disp_mm", "force_N"], "index": list(range(N)),
               "data": [[t, x, f] for t, x, f in zip(_T, _X, _F)]}, {}),
    "pandas": ({k: dict(enumerate(v)) for k, v in (("time_s", _T), ("disp_mm", _X), ("force_N", _F))}, {}),
    "settings": ({"meta": {"sample_rate_hz": RATE}, "units": {"disp": "mm", "force": "N"},
                  "data": {"disp": _X, "force": _F}}, {}),
    "rates": ({"channels": [{"name": "disp", "unit": "mm", "sample_rate": RATE, "values": _X},
                            {"name": "force", "unit": "N", "sample_rate": RATE / 2, "values": _F[::2]}]}, {}),
    "gaps": ({"time_s": _T, "disp_mm": [None, *_X[1:]], "force_N": [*_F[:-1], float("nan")]}, {}),
}  # fmt: skip
TEK = [
    "Record Length,1.0e+03,", "Sample Interval,2.000000e-03,", ",,", "Source,CH1,", "Vertical Units,V,", "Pt Fmt,Y,",
    "Model Number,TBS1072B,", "Firmware Version,FV:v4.06,",
]  # fmt: skip
MICSIG = ["Model,TO1104,", "Channel,CH1,", "Sample,500Sa/s,", "Points,1000,"]
ASCENDING = [str(k) for k in range(1, N + 1)]
FORMS = {
    # measuring software
    "dewesoft": (
        table(
            ["Data1 info", "File name: test_0001.dxd", "Start time: 3/14/2025 09:26:53.000", "Sample rate: 500 Hz",
             "Channels: 2", "", "Data1", "Time\tWeg\tKraft", "s\tmm\tkN"],
            T, X, F / 1e3, separator="\t"), {}),
    "dewesoft_csv_brackets": (table(['"Time (s)","AI 1/Disp (mm); ","AI 2/Force (N); "'], T, X, F), {}),
    "catman_asc": (
        table(
            ["CATMAN", "V5.5.3", "", "Datum\t14.03.2025 09:26:53", "Kanäle\t3", "Abtastrate\t500 Hz",
             "Zeit  1 - Standardmessrate [s]\tWeg [mm]\tKraft [kN]"],
            T, X, F / 1e3, separator="\t", decimal=","), {}),
    "catman_trailing": (
        table(["HBM_CATMAN_DATAFILE_40", "Zeit [s];Weg [mm];Kraft [N];"], T, X, F, [""] * N, separator=";",
                decimal=","),
        {}),
    "famos": (table(["x-Achse;Weg;Kraft", "s;mm;N"], T, X, F, separator=";", decimal=","), {}),
    "famos_labels": (
        table(["Name:\tWeg\tKraft", "Y-Einheit:\tmm\tN", "X-Delta:\t0,002\t0,002"], [""] * N, X, F, separator="\t",
              decimal=","), {}),
    "famos_no_x": (table(["Weg;Kraft", "mm;N", "dx = 0,002 s;dx = 0,002 s"], X, F, separator=";", decimal=","), {}),
    "diadem": (
        table(["DIAHEADER", "Zeit;Weg;Kraft", "s;mm;kN", "DOUBLE;DOUBLE;DOUBLE"], T, X, F / 1e3, separator=";",
              decimal=","), {}),
    "testlab": (
        table(["Title1\tRun 3", "Point id\tS1:+X", "X axis\tTime", "", "Time\tDisplacement\tForce", "s\tmm\tN"],
              T, X, F, separator="\t"), {}),
    "testlab_blanks": (table(["% Simcenter Testlab", "%  Time s   Disp mm   Force N"], T, X, F, separator="   "), {}),
    "labview_waveforms": (
        table(["waveform\tWeg (mm)\tKraft (N)", "t0\t4/22/2018  13:45:12.100572\t4/22/2018  13:45:12.100572",
               "delta t\t2.000000E-3\t2.000000E-3", "", "time\tY[0]\tY[1]"], clock("%m/%d/%Y  %H:%M:%S.%f"), X, F,
              separator="\t"), {}),
    "labview_one_header": (
        table(["LabVIEW Measurement", "Separator\tTab", "***End_of_Header***", "Time\tWeg[mm]\tKraft[N]"], T, X, F,
              separator="\t"), {}),
    "labview_spreadsheet": (table(["Time (s)\tStroke (mm)\tLoad (N)"], T, X, F, separator="\t", end="\r\n"), {}),
    "signalexpress": (
        table(["channel names: ", "Zeit*\tWeg - Alle Daten (mm)\tKraft - Alle Daten (N)"], T, X, F,
                separator="\t"), {}),
    "sciemetric_pipes": (table(["|time|disp|force|", "|s|mm|N|"], [""] * N, T, X, F, [""] * N, separator="|"), {}),
    # testing machines
    "bluehill": (
        table(["Results Table 1", ",Maximum Load,Break", ",(N),(mm)", "1,1800.0,1.25", "", "Raw Data",
               "Time,Extension,Load", "(s),(mm),(N)"], T, X, F), {}),
    "keyence_cycle": (table(["Sampling cycle,2000us", "No.,Disp,Force", ",mm,N"], ASCENDING, X, F), {}),
    "bluehill_quoted": (table(['"Time","Displacement","Force"', '"(s)","(mm)","(kN)"'],
                              *([f'"{v:.6f}"' for v in c] for c in (T, X, F / 1e3))), {}),
    "bluehill_units_after": (table(["Time sec,Extension mm,Load N"], T, X, F), {}),
    "testxpert": (
        table(["Prüfer;Meier", "Prüfzeit;Standardweg;Standardkraft", "s;mm;N"], T, X, F, separator=";",
                decimal=","), {}),
    "testxpert_quotes": (
        table(['"Prüfzeit";"Standardweg";"Standardkraft"', '"s";"µm";"N"'], T, X * 1e3, F, separator=";",
                decimal=","), {}),
    "mts_testsuite": (
        table(['"Station Name","Rig"', '"Data Acquisition: Timed"', '"Time","Axial Displacement","Axial Force"',
               '"Sec","mm","kN"'], T, X, F / 1e3), {}),
    "mts_testworks_tabs": (table(["Running Time\tAxial Disp\tAxial Force", "sec\tin\tlbf"], T, X / 25.4,
                                 F / 4.4482216152605, separator="\t", fmt="{:.8f}"), {}),
    "instron_wavematrix": (
        table(['"Total Time (s)","Elapsed Cycles","Displacement(Linear:Position) (mm)","Load(Linear:Load) (kN)"'],
              T, np.floor(T * FREQUENCY), X, F / 1e3), {"channels": {"displacement": "3", "force": "4"}}),
    "shimadzu": (table(['"Time","Force","Stroke"', '"sec","N","mm"'], T, F, X), {}),
    "walter_bai": (table(["Zeit[s]  Weg[mm]  Kraft[kN]"], T, X, F / 1e3, separator="  ", decimal=","), {}),
    # oscilloscopes
    "keysight": (
        table(["x-axis,1,2", "second,Volt,Volt"], T, X / 10, F / 1000, fmt="{:+.6E}"),
        {"channels": {"displacement": "1", "force": "2"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "tektronix_side": (
        table(["Record Length,1000,Points", "Sample Interval,2e-3,s", "TIME,CH1,CH2"], T, X / 10, F / 1000,
                fmt="{:.9f}"),
        {"channels": {"displacement": "CH1", "force": "CH2"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "lecroy": (
        table(["LECROYWS3034,12345,Waveform", "Segments,1,SegmentSize,1000", "Segment,TrigTime,TimeSinceSegment1",
               "#1,14-Mar-2025 09:26:53,0", "Time,Ampl,Ampl2"], T, X / 10, F / 1000, fmt="{:.9f}"),
        {"channels": {"displacement": "Ampl", "force": "Ampl2"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "rigol_increment": (
        table(["X,CH1,CH2,Start,Increment", "Sequence,VOLT,VOLT,0.000000e+00,2.000000e-03"],
              [str(k) for k in range(N)], X / 10, F / 1000, fmt="{:.6e}"),
        {"channels": {"displacement": "CH1", "force": "CH2"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "micsig": (
        table(["ProID,Info,,time,Vol.,,ProID,Info,,time,Vol.,"],
              [*MICSIG, *[",,"] * (N - len(MICSIG))], T, X / 10, [""] * N, [*MICSIG, *[",,"] * (N - len(MICSIG))], T,
              F / 1000, [""] * N, fmt="{:.9f}"),
        {"channels": {"displacement": "2", "force": "4"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "picoscope_ms": (
        table(["Time,Channel A,Channel B", "(ms),(mV),(V)", ""], T * 1e3, X * 100, F / 1000),
        {"channels": {"displacement": "Channel A", "force": "Channel B"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "moku": (
        table(["% Moku:Go Data Logger", "% Acquisition rate: 5.000e+02 Hz", "% Time (s), Input A (V), Input B (V)"],
              T, X / 10, F / 1000, separator=", "),
        {"channels": {"displacement": "Input A", "force": "Input B"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    # self-made
    "arduino_millis": (table(["millis,disp_um,force_mN"], T * 1e3, X * 1e3, F * 1e3, fmt="{:.0f}"),
                       {"units": {"time": "ms", "force": "mN", "displacement": "um"}}),
    "arduino_monitor": (table(["time_ms,disp_mm,force_N"], clock("%H:%M:%S.%f -> ") and
                              [f"{s[:-3]} -> {t:.0f}" for s, t in zip(clock("%H:%M:%S.%f"), T * 1e3)], X, F), {}),
    "putty_log": (table(["=~=~=~=~= PuTTY log 2025.03.14 09:26:53 =~=~=~=~=", "t_us disp_mm force_N"], T * 1e6, X, F,
                        separator=" "), {}),
    "plotter_labels": (
        "".join(f"t:{t:.4f},disp_mm:{x:.5f},force_N:{f:.3f}\n" for t, x, f in zip(T, X, F)), {}),
    "numpy_savetxt": (table(["# time_s disp_mm force_N"], T, X, F, separator=" ", fmt="{:.18e}"), {}),
    "pandas_index": (table([",time_s,disp_mm,force_N"], [str(k) for k in range(N)], T, X, F), {}),
    "pandas_datetime": (table(["timestamp,disp_mm,force_N"], clock("%Y-%m-%d %H:%M:%S.%f+00:00"), X, F), {}),
    "iso_z": (table(["timestamp,disp_mm,force_N"], clock("%Y-%m-%dT%H:%M:%S.%fZ"), X, F), {}),
    # spreadsheets
    "excel_german": (table(["Zeit [s];Weg [mm];Kraft [N]"], german(T), german(X), german(F), separator=";"), {}),
    "excel_french": (table(["Temps (s);Déplacement (mm);Force (N)"], french(T), french(X), french(F),
            separator=";"), {}),
    "excel_sep_line": (table(["sep=;", "Zeit [s];Weg [mm];Kraft [N]"], T, X, F, separator=";", decimal=","), {}),
    "comma_and_semicolon": (table(["Time (s);Disp, axial (mm);Force, axial (N)"], T, X, F, separator=";",
            decimal=","), {}),
    "comma_decimal_comma_space": (table(["Time s, Disp mm, Force N"], T, X, F, separator=", ", decimal=","), {}),
    "swiss_thousands": (table(["Zeit [s];Weg [mm];Kraft [N]"], T, X, [f"{v:,.3f}".replace(",", "'") for v in F],
                              separator=";"), {}),
    "grafana": (table(['"Time","Disp","Force"'], clock("%Y-%m-%d %H:%M:%S.%f"), [f"{x:.5f} mm" for x in X],
                      [f"{f:.3f} N" for f in F]), {}),
    "numbers_and_units_in_cells": (
        table(["Time,Disp,Force"], [f"{t:.4f} s" for t in T], [f"{x:.5f} mm" for x in X],
                [f"{f:.3f} N" for f in F]), {}),
    "statistics_below": (
        table(["Time (s),Disp (mm),Force (N)"], T, X, F, tail="Max,1.25,1800\nMin,-1.25,-1800\nMean,0,0\n"), {}),
    "marker_column": (table(["Time (s),Marker,Disp (mm),Force (N)"], T,
            ["" if k else "Start" for k in range(N)], X, F), {}),
    "row_number": (table(["No.,Time (s),Disp (mm),Force (N)"], ASCENDING, T, X, F), {}),
    "graphtec": (
        table(['"Vendor","GRAPHTEC Corporation"', '"Sampling interval","2ms"', '"AMP settings"',
               '"CH1","Weg","DC","1V","Off"', '"Number","Date&Time","ms","CH1","CH2","Alarm1-10"',
               '"NO.","Time","ms","mm","N","A1234567890"'],
              [f"{k:8d}" for k in range(1, N + 1)], clock("%Y/%m/%d %H:%M:%S"), [f"{round(1e3 * t) % 1000}" for t in T],
              *([f"{'+' if v >= 0 else '-'}{abs(v):12.6f}" for v in c] for c in (X, F)), ["LLLLLLLLLL"] * N), {}),
    "yokogawa": (
        table(['"TraceName","CH1","CH2"', '"BlockSize",1000,1000', '"VUnit","V","V"', '"SampleRate",500,500',
               '"HResolution",2.0E-03,2.0E-03', '"HOffset",-1.0,-1.0', '"HUnit","s","s"', '"DisplayPointNo.",1,1',
               '"Date","2025/03/14","2025/03/14"', '"Time","09:26:53.1","09:26:53.1"', ""],
              [""] * N, X / 10, F / 1000, fmt="{:.8E}"),
        {"channels": {"displacement": "CH1", "force": "CH2"},
         "sensitivities": {"displacement": "10 mm/V", "force": "1000 N/V"}}),
    "oros": (table(["Signal;Weg;Kraft", "X unit;s;s", "Y unit;mm;N", "Time;Weg;Kraft"], T, X, F, separator=";"), {}),
    "capstone": (table(["Zeit ( s ) Lauf 1;Position ( m ) Lauf 1;Kraft ( N ) Lauf 1"], T, X / 1e3, F, separator=";",
                       decimal=",", fmt="{:.9f}"), {}),
    "units_first": (table(["[s] Zeit;[mm] Weg;[N] Kraft"], T, X, F, separator=";"), {}),
    "origin_long_names": (table(["Long Name,Time,Disp,Force", "Units,s,mm,kN", "F(x)=,,,"], ASCENDING, T, X, F / 1e3),
                          {}),
    "r_row_names": (table(['"time_s" "disp_mm" "force_N"'], [f'"{k}"' for k in ASCENDING], T, X, F, separator=" "), {}),
    "matlab_timetable": (table(["Time,disp_mm,force_N"], [f"{t:.3f} sec" for t in T], X, F), {}),
    "json_lines": ("".join(f'{{"t": {t:.4f}, "disp_mm": {x:.5f}, "force_N": {f:.3f}}}\n' for t, x, f in zip(T, X, F)),
                   {}),
    **{f"json_{name}": (json.dumps(value), options) for name, (value, options) in JSON.items()},
    "interval_and_its_unit": (table(["Sampling interval,2000,us", "Disp (mm),Force (N)"], X, F), {}),
    "step_unit_below": (table(["X increment: 2", "X unit: ms", "Disp (mm);Force (N)"], X, F, separator=";"), {}),
    "step_unit_of_each": (table(["X-Einheit:;ms;ms", "X-Delta:;2;2", "Zeit;Weg (mm);Kraft (N)"], [""] * N, X, F,
                                separator=";"), {}),
    "separators_behind_rows": (table(["Time (s);Disp (mm);Force (N)"], T, X, F, [""] * N, [""] * N, separator=";"), {}),
    "ruler": (table(["time (s) | disp (mm) | force (N)", "--- | --- | ---"], T, X, F, separator=" | "), {}),
    "remarks_with_commas": (table(["time_s,disp_mm,force_N"], T, X, F).replace("\n0.3", "\n% pause 3,5,7\n0.3", 1), {}),
    "excel_errors": (table(["time_s,disp_mm,force_N"], T, X, ["#DIV/0!", *map("{:.6f}".format, F[1:])]), {}),
    "sensor_behind_unit": (table(["Time (s),Disp [mm] (LVDT 1),Force [N] (cell A)"], T, X, F), {}),
    "utc": (table(["time,disp_mm,force_N"], clock("%Y-%m-%d %H:%M:%S.%f UTC"), X, F), {}),
    "pandas_timedelta": (table(["time,disp_mm,force_N"], [f"0 days 00:00:{t:09.6f}" for t in T], X, F), {}),
    "milliseconds_without_zeros": (
        table(["Time;Disp (mm);Force (N)"], [f"12:00:{round(1e3 * t) // 1000:02d}.{round(1e3 * t) % 1000}" for t in T],
              X, F, separator=";"), {}),
    "decimals_without_zeros": (
        table(["Time;Disp (mm);Force (N)"], [s.rstrip("0").rstrip(".") for s in clock("%H:%M:%S.%f")], X, F,
              separator=";"), {}),
    "footer": (table(["Time (s);Disp (mm);Force (N)"], T, X, F, separator=";", tail="\n[EOF]\n"), {}),
    "diadem_rows": (table(["Name;Displacement;Force", "Unit;mm;N", "Length;1000;1000", "x0;0;0", "dx;0,002;0,002"],
                          [""] * N, X, F, separator=";", decimal=","), {}),
    "famos_rows": (table(["[Name]\tWeg\tKraft", "[Einheit]\tmm\tN", "[x-Einheit]\ts\ts", "[dx]\t0.002\t0.002",
                          "[x0]\t0\t0"], [""] * N, X, F, separator="\t"), {}),
    "step_below_names": (table(["Weg[mm];Kraft[N]", "Delta-X: 2 ms"], X, F, separator=";"), {}),
    "arduino": (table(["millis,disp_mm,force_N"], [f"{1e3 * t:.0f}" for t in T], X, F), {}),
    "campbell": (table(['"TOA5","CR6","Fast"', '"TIMESTAMP","RECORD","Disp","Force"', '"TS","RN","mm","N"',
                        '"","","Smp","Smp"'], clock("%Y-%m-%d %H:%M:%S.%f"), ASCENDING, X, F), {}),
    "statistics_above": (table([";Time (s);Disp (mm);Force (N)", "Max;2;1.25;1800", "Mean;1;0;0"], [""] * N, T, X, F,
                               separator=";"), {}),
    "names_by_tabs": (table(["Time (s)\tDisp (mm)\tLoad (tonf)"], T, X, F / 9806.65, fmt="{:.9f}"), {}),
    "units_behind_blanks": (table(["Time (s) Disp (mm) Force (N)"], T, X, F, separator=" "), {}),
    "minutes_in_german": (table(["Zeit [Min];Weg [Mm];Kraft [kn]"], T / 60, X, F / 1e3, separator=";",
                                fmt="{:.9f}"), {}),
}  # fmt: skip


def energy(test):
    loop = test.loop
    return float(np.mean(loop.force_N * loop.velocity_m_s) / loop.frequency_hz * 1e3)


#: forms that nothing can read: commas that divide columns and decimals alike
REFUSED = ("comma_decimal_comma_space",)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("name", FORMS)
def test_a_logger_s_export(tmp_path, name, encoding):
    text, options = FORMS[name]
    file = tmp_path / "run.csv"
    file.write_bytes(text.encode(encoding))
    if name in REFUSED:
        with pytest.raises(CampaignError, match="commas divide columns and decimals alike"):
            import_tests([file], Recipe(**options))
        return
    (test,) = import_tests([file], Recipe(**options))
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)
    assert test.loop.frequency_hz == pytest.approx(FREQUENCY, rel=1e-3)


def test_specimens_one_below_another_with_numbers_in_their_headers(tmp_path):
    """As Bluehill writes raw data of several specimens."""
    blocks = [f"{k},Time,Displacement,Force\n,(s),(mm),(N)\n" + table([], [""] * N, T, X * k, F * k) for k in (1, 2)]
    (tmp_path / "a.csv").write_text("Results Table 1\n,Width,Area\n,(mm),(mm^2)\n1,24.7,77.2\n\n" + "\n".join(blocks))
    first, second = import_tests([tmp_path / "a.csv"])
    assert energy(first) == pytest.approx(ENERGY_NMM, rel=0.003)
    assert energy(second) == pytest.approx(4 * ENERGY_NMM, rel=0.003)


def test_rows_with_remarks_beside_them_are_samples(tmp_path):
    """A TBS1072B writes F0000CH1.CSV and F0000CH2.CSV, each with its settings beside the first rows."""
    for k, values in ((1, X / 10), (2, F / 1000)):
        side = [x.replace("CH1", f"CH{k}") for x in TEK] + [",,"] * (N - len(TEK))
        (tmp_path / f"F0000CH{k}.CSV").write_text(table([], side, T, values, [""] * N, fmt="{:.9f}"))
    options = {"displacement": "10 mm/V", "force": "1000 N/V"}
    recipe = Recipe(channels={"displacement": "CH1", "force": "CH2"}, sensitivities=options)
    (test,) = import_tests(sorted(tmp_path.iterdir()), recipe, join=True)
    assert test.record.time_s.size == N
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)


def test_what_is_asked_of_channels_that_are_not_chosen_yet_is_asked_at_once(tmp_path):
    (tmp_path / "a.csv").write_text(table(["t (s),force.x,force.z,pos"], T, F, F + 1, X))
    with pytest.raises(CampaignError, match=r'--force "<NAME>" --unit "force=<UNIT>" --unit "displacement=<UNIT>"'):
        import_tests([tmp_path / "a.csv"])


@pytest.mark.parametrize(
    ("head", "columns", "asked"),
    [
        ("Sample rate: 5000 Hz\nDecimation: 10\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        ("Sample rate: 5000 Hz\nSaved: every 10th sample\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        ("Sample rate: 5000 Hz\nDecimation factor: 10\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        ("Sample rate: 5000 Hz\nSave every 10 samples\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        (
            "Time,Disp (mm),Force (N)",
            (0.78125 * np.arange(N), X, F),
            "'Time' goes up by 0.7812 a row and states no unit",
        ),
        ("Sample rate: 5000 Hz\nAveraging: 10\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        ("Scan rate: 5000 Hz\nStorage rate: 500 Hz\nDisp (mm),Force (N)", (X, F), "states 500 or 5000 samples"),
        ("Sample rate: 30000 /min\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        ("Sampling interval: 2\nDisp (mm),Force (N)", (X, F), "neither a time channel"),
        ("Time (1/100 s),Disp (mm),Force (N)", (100 * T, X, F), r"'Time \(1/100 s\)' goes up by .* no unit"),
        ("Zeit in 1/10 s;Weg in mm;Kraft in N", (10 * T, X, F), "'Zeit in 1/10 s' goes up by .* no unit"),
        ("Time s;Disp 0.01 mm;Force N", (T, 100 * X, F), "states no unit"),
        ("Time (s),Disp (mm) [um],Force (N)", (T, X, F), "states two units"),
        ("Time (s),Disp (mm),Force (N)\ns,in,N", (T, X, F), r"'Disp \(mm\), in' \(displacement\) states two units"),
        ("Time (s),Disp (mm),Force (%)", (T, X, F), r"is in %: what is a sample of 1\?"),
    ],
)
def test_a_rate_or_unit_that_may_be_another_is_asked(tmp_path, head, columns, asked):
    """Samples that were thinned, steps of nobody knows what, and numbers before a unit."""
    (tmp_path / "a.csv").write_text(table([head], *columns, separator=";" if ";" in head else ","))
    with pytest.raises(CampaignError, match=asked):
        import_tests([tmp_path / "a.csv"])


def test_a_rate_that_a_time_channel_contradicts_is_not_passed_over(tmp_path):
    (tmp_path / "a.csv").write_text(table(["Time [samples],Disp (mm),Force (N)"], np.arange(N), X, F))
    with pytest.raises(CampaignError, match=r"500 samples a second as you say, 1 by 'Time .*--time none"):
        import_tests([tmp_path / "a.csv"], Recipe(sample_rate_hz=500))
    (test,) = import_tests([tmp_path / "a.csv"], Recipe(sample_rate_hz=500, channels={"time": "none"}))
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)


@pytest.mark.parametrize(
    ("head", "times"),
    [
        ("Time (s)", [f"{t:.3g}" for t in T]),  # coarser from 1 s on
        ("Time (s)", [f"{t:.2f}" for t in T]),
        ("Time", [f"{1e3 * t + 1e6:.6g}" for t in T]),  # in ms, of which two digits are gone
        ("Time", [f"{t / 60 + 166:.2f}" for t in T]),  # in minutes: four times in all
        ("Time (s)", [f"{t:.3f}" for t in 0.1 * T]),
    ],
)
def test_a_time_rounded_too_far_is_read_with_the_rate_that_is_asked_for(tmp_path, head, times):
    rate = RATE if times[1] != "0.000" or times[-1] > "1" else 10 * RATE
    (tmp_path / "a.csv").write_text(table([f"{head},Disp (mm),Force (N)"], times, X, F))
    with pytest.raises(ImportAsks, match="it is rounded too far") as asked:
        import_tests([tmp_path / "a.csv"])
    assert [q.option for q in asked.value.questions] == ["--sample-rate"]
    (test,) = import_tests([tmp_path / "a.csv"], Recipe(sample_rate_hz=rate))
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)
    assert test.loop.frequency_hz == pytest.approx(FREQUENCY * rate / RATE, rel=1e-3)


def test_rows_lost_from_a_rounded_time_are_not_passed_over(tmp_path):
    there = np.delete(np.arange(N), np.arange(400, 430))  # 0.06 s
    times = [f"{t:.2f}" for t in T[there]]
    (tmp_path / "a.csv").write_text(table(["Time (s),Disp (mm),Force (N)"], times, X[there], F[there]))
    with pytest.raises(CampaignError, match="does not increase"):
        import_tests([tmp_path / "a.csv"], Recipe(sample_rate_hz=RATE))


def test_a_rate_that_the_time_contradicts_is_warned_of(tmp_path):
    (tmp_path / "a.csv").write_text(table(["Sample rate: 1000 Hz", "Time (s),Disp (mm),Force (N)"], T, X, F))
    (test,) = import_tests([tmp_path / "a.csv"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)
    assert any("1000 samples a second, its time 500: the time is used" in w for w in test.record.warnings)


@pytest.mark.parametrize(
    ("mark", "separator"), [(";", ","), (";", "\t"), (";", " "), ("'", ","), ("'", ";"), ("--", " "), ("@", " ")]
)
def test_lines_that_begin_as_remarks_do(tmp_path, mark, separator):
    names = separator.join(["time_s", "disp_mm", "force_N"])
    text = table([f"{mark} Rig 3", names], T, X, F, separator=separator)
    text = text.replace("\n0.6", f"\n{mark} the operator paused here\n0.6", 1)
    (tmp_path / "a.csv").write_text(text)
    (test,) = import_tests([tmp_path / "a.csv"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003) and test.record.time_s.size == N
    (tmp_path / "a.csv").write_text(table([f"{mark} {names}"], T, X, F, separator=separator))
    assert energy(import_tests([tmp_path / "a.csv"])[0]) == pytest.approx(ENERGY_NMM, rel=0.003)


def test_recordings_of_a_folder_are_read_and_notes_beside_them_are_passed_over(tmp_path):
    (tmp_path / "a.csv").write_text(table(["time_s,disp_mm,force_N"], T, X, F))
    (tmp_path / "b.json").write_text(json.dumps({"time_s": _T, "disp_mm": [0.9 * x for x in _X], "force_N": _F}))
    notes = {
        "rig.json": json.dumps({"operator": "me", "gains": [1, 2, 3]}).encode(),
        "readme.txt": b"Run in for 10 min.\n1. mounted\n2. warm\n",
        "log": b"Gain\t10\nRange\t500\n",
        "empty.csv": b"",
        "photo.jpg": b"\xff\xd8\xff\xe0\0\x10JFIF\0" + bytes(256),
        "report.pdf": b"%PDF-1.4\nxref\n" + b"0000000015 00000 n\n" * 30,
        "old.doc": b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600),
    }
    for name, raw in notes.items():
        (tmp_path / name).write_bytes(raw)
    with zipfile.ZipFile(tmp_path / "notes.docx", "w") as packed:
        packed.writestr("word/document.xml", "<x/>")
    tests = import_tests([tmp_path])
    assert [x.record.file for x in tests] == ["a.csv", "b.csv"]
    said = [line for x in tests for line in x.said if line.startswith("passed over, as no recording: ")]
    assert sorted(line.split(": ")[1] for line in said) == sorted([*notes, "notes.docx"])
    for name in notes:
        with pytest.raises(CampaignError, match=name):  # which was named itself
            import_tests([tmp_path / "a.csv", tmp_path / name])
    (tmp_path / "damaged.csv").write_text(table(["time_s,disp_mm,force_N"], T, X, F) + "1,2,3,4\n")
    with pytest.raises(CampaignError, match=r"damaged\.csv line"):
        import_tests([tmp_path])


@pytest.mark.parametrize("clock", ["moments", "starts"])
def test_stamps_of_channels_that_began_apart(tmp_path, clock):
    """The force began 16 ms late, by moments of each channel or by the stamp of each one's start."""
    k, day = 8, np.datetime64("2025-03-14T09:26:53.589")
    stamps = [str(day + np.timedelta64(int(1e6 * t), "us")) for t in T]
    parts = [{"disp_mm": _X[:-k]}, {"force_N": _F[k:]}]
    for part, own in zip(parts, (stamps[:-k], stamps[k:])):
        part.update({"time": own} if clock == "moments" else {"start_time": own[0], "dt": 1 / RATE})
    (tmp_path / "a.json").write_text(json.dumps(dict(zip(("laser", "cell"), parts))))
    (test,) = import_tests([tmp_path / "a.json"], Recipe(units={"displacement": "mm", "force": "N"}))
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)
    assert any("starts 0.016 s after" in w for w in test.record.warnings)


def _tdms(path, *channels):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject(*some) for some in channels])
    return [path]


def test_tdms_steps_in_other_units_and_steps_that_nobody_set(tmp_path):
    def rig(**said):
        both = (("r", "Weg", X, {"unit_string": "mm", **said}), ("r", "Kraft", F, {"unit_string": "N", **said}))
        return _tdms(tmp_path / "a.tdms", *both)

    (test,) = import_tests(rig(wf_increment=2.0, wf_xunit_string="ms"))
    assert test.loop.frequency_hz == pytest.approx(FREQUENCY, rel=1e-3)
    with pytest.raises(ImportAsks, match="neither a time channel"):
        import_tests(rig(wf_increment=1.0))
    with pytest.raises(CampaignError, match="x axis is in 'Hz', which is no time"):
        import_tests(rig(wf_increment=0.5, wf_xunit_string="Hz"))
    (test,) = import_tests(rig(wf_increment=0.002, wf_trigger_offset=0.016))
    assert any("wf_trigger_offset = 0.016" in w for w in test.record.warnings)


def test_tdms_groups_with_moments_of_their_own(tmp_path):
    k, moments = 8, np.datetime64("2025-03-14T09:26:53") + np.round(1e6 * T).astype("timedelta64[us]")
    a = ("laser", "Time", moments[:-k], {}), ("laser", "Weg", X[:-k], {"unit_string": "mm"})
    b = ("cell", "Time", moments[k:], {}), ("cell", "Kraft", F[k:], {"unit_string": "N"})
    (test,) = import_tests(_tdms(tmp_path / "a.tdms", *a, *b))
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)


def test_uff_remarks_that_name_a_factor_are_warned_of(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    for label, values, unit in (("Weg", X, "mm"), ("Kraft", F, "N")):
        data = {
            "type": 58, "binary": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
            "id4": "Scale factor 2.0", "data": values, "x": T, "abscissa_spacing": 1, "abscissa_spec_data_type": 17,
            "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 0, "ordinate_axis_lab": label,
            "ordinate_axis_units_lab": unit, "ord_data_type": 4, "abscissa_inc": 1 / RATE, "abscissa_min": 0.0,
        }  # fmt: skip
        pyuff.UFF(str(tmp_path / "a.uff")).write_sets([data], "add", force_double=True)
    (test,) = import_tests([tmp_path / "a.uff"])
    assert any("'Scale factor 2.0', which is not applied" in w for w in test.record.warnings)


def test_a_column_that_is_a_channel_s_own_time_by_its_name(tmp_path):
    k = 8
    head = "t_disp,disp_mm,t_force,force_N"
    (tmp_path / "a.csv").write_text(table([head], T[:-k], X[:-k], T[k:], F[k:]))
    (test,) = import_tests([tmp_path / "a.csv"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)


def test_two_channels_of_one_role_and_unit_are_asked_of_whatever_their_names(tmp_path):
    head = "Time (s),Stroke (mm),Extensometer (mm),Force (N)"
    (tmp_path / "a.csv").write_text(table([head], T, 1.5 * X, X, F))
    with pytest.raises(ImportAsks, match=r"Which channel is the displacement: Stroke \(mm\), Extensometer"):
        import_tests([tmp_path / "a.csv"])


def test_a_table_of_gains_above_the_numbers_is_warned_of(tmp_path):
    head = ["Channel;Unit;Gain", "Disp;mm;1", "Force;N;10", "", "Time (s);Disp (mm);Force (N)"]
    (tmp_path / "a.csv").write_text(table(head, T, X, F, separator=";"))
    (test,) = import_tests([tmp_path / "a.csv"])
    assert [w for w in test.record.warnings if "not applied" in w] == [
        "the file states 'Force Gain: 10', which is not applied: if the numbers do not hold it yet, say so with --gain "
        "or --unit"
    ]


LVM_HEAD = ["LabVIEW Measurement", "Separator\tTab", "***End_of_Header***", "", "Channels\t2"]


@pytest.mark.parametrize(
    ("said", "found"),
    [
        (
            ["Delta_X\t0.002\t0.002", f"Samples\t{2 * N}\t{2 * N}"],
            f"has {N} of {2 * N} samples that segment 1 announces",
        ),
        (["Delta_X\t1.0\t1.0"], "neither a time channel"),
        (["Delta_X\t2.0\t2.0", "X_Unit_Label\tms\tms"], ""),
        (["Delta_X\t2.0\t2.0", "X_Unit_Label\tmm\tmm"], "x axis is in 'mm', which is no time"),
    ],
)
def test_labview_steps_in_other_units_steps_that_nobody_set_and_files_cut_off(tmp_path, said, found):
    head = [*LVM_HEAD[:2], "X_Columns\tNo", *LVM_HEAD[2:], "Y_Unit_Label\tmm\tN", *said, "***End_of_Header***"]
    text = table([*head, "X_Value\tWeg\tKraft\tComment"], [""] * N, X, F, separator="\t")
    (tmp_path / "a.lvm").write_text(text)
    if "samples" in found or not found:
        (test,) = import_tests([tmp_path / "a.lvm"])
        assert test.loop.frequency_hz == pytest.approx(FREQUENCY, rel=1e-3)
        assert bool(found) == any(found in w for w in test.record.warnings)
    else:
        with pytest.raises(CampaignError, match=found):
            import_tests([tmp_path / "a.lvm"])


def test_labview_channels_of_one_x_column_whose_starts_differ(tmp_path):
    k = 8
    head = [*LVM_HEAD[:2], "X_Columns\tOne", *LVM_HEAD[2:], "Y_Unit_Label\tmm\tN", "X0\t0.0\t0.016"]
    head += ["Delta_X\t0.002\t0.002", "***End_of_Header***", "X_Value\tWeg\tKraft\tComment"]
    (tmp_path / "a.lvm").write_text(table(head, T[:-k], X[:-k], F[k:], separator="\t"))
    (test,) = import_tests([tmp_path / "a.lvm"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)


def test_factors_that_a_matlab_file_holds_as_a_vector_are_warned_of(tmp_path):
    import scipy.io

    scipy.io.savemat(tmp_path / "a.mat", {"disp_mm": X, "force_N": F, "fs": RATE, "scale": [1e-4, 0.01]})
    (test,) = import_tests([tmp_path / "a.mat"])
    assert sum("not applied" in w for w in test.record.warnings) == 2


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('{"t": [0.1, 0.2', "damaged JSON"),
        ('{"a": [1, 2]}', "no signals of 16 samples"),
        (
            f'{{"a": [{", ".join(["9" * 400] * 16)}]}}',
            "lacks the force, and no other goes with it",
        ),  # larger than any number
    ],
)
def test_json_that_holds_no_recording(tmp_path, text, what):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(CampaignError, match=what):
        import_tests([tmp_path / "a.json"])


def test_hidden_sheets_are_left_out(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for sheet, size in ((book.active, 1.0), (book.create_sheet("old"), 2.0)):
        for row in [("Time (s)", "Disp (mm)", "Force (N)"), *zip(_T, (size * X).tolist(), (size * F).tolist())]:
            sheet.append(row)
    book["old"].sheet_state = "hidden"
    book.save(tmp_path / "a.xlsx")
    (test,) = import_tests([tmp_path / "a.xlsx"])
    assert energy(test) == pytest.approx(ENERGY_NMM, rel=0.003)
