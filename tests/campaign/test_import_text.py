"""Text files in any layout: separators, decimal marks, encodings, lines above the table, rows of units, gaps."""

import gzip
import time

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError
from bayes_iwan.campaign.importing import import_tests
from bayes_iwan.campaign.importing.formats.text_layout import Layout
from bayes_iwan.campaign.importing.read import read_file
from bayes_iwan.campaign.importing.unit_texts import is_unit

N = 200
T = np.arange(N) / 1000.0
X = np.sin(2 * np.pi * 10 * T)
F = -3.25 * X + 1e-3 * np.cos(2 * np.pi * 10 * T)


def rows(separator=",", decimal=".", digits=8):
    text = [separator.join(f"{v:.{digits}g}" for v in row).replace(".", decimal) for row in zip(T, X, F)]
    return "\n".join(text) + "\n"


def read(tmp_path, content, name="a.csv", **layout):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (recording,) = read_file(path, Layout(**layout))
    return recording


def same(recording, names, units=None):
    assert [c.name for c in recording.channels] == names
    if units is not None:
        assert [c.unit for c in recording.channels] == units
    for channel, truth in zip(recording.channels, (T, X, F)):
        np.testing.assert_allclose(channel.values, truth, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "  \t "])
@pytest.mark.parametrize("decimal", [".", ","])
def test_separators_and_decimal_marks(tmp_path, separator, decimal):
    if separator == decimal:
        pytest.skip("one sign cannot be both")
    head = separator.join(["t", "x", "F"]) + "\n"
    same(read(tmp_path, head + rows(separator, decimal)), ["t", "x", "F"], ["", "", ""])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_encodings_and_line_ends(tmp_path, encoding, end):
    text = ("Zeit [s];Weg über Grund [µm];Kraft é [N]\n" + rows(";", ",")).replace("\n", end)
    same(read(tmp_path, text.encode(encoding)), ["Zeit", "Weg über Grund", "Kraft é"], ["s", "µm", "N"])


def test_lines_above_and_a_row_of_units(tmp_path):
    above = "Prüfstand 3\nDatum;21.11.2026\nAbtastrate: 1000\n\n"
    text = above + "Zeit;Weg;Kraft\ns;mm;kN\n" + rows(";", ",")
    recording = read(tmp_path, text.encode("cp1252"))
    same(recording, ["Zeit", "Weg", "Kraft"], ["s", "mm", "kN"])
    assert "semicolons, decimal ,, cp1252, numbers from line 7" in recording.notes[0]
    same(read(tmp_path, text.replace("s;mm;kN", "[s];[mm];[kN]")), ["Zeit", "Weg", "Kraft"], ["s", "mm", "kN"])
    same(read(tmp_path, "first;second;third\na;b;c\n" + rows(";", ",")), ["a", "b", "c"])


def test_no_header_trailing_separators_quotes_and_remarks(tmp_path):
    same(read(tmp_path, rows()), ["column 1", "column 2", "column 3"])
    same(read(tmp_path, "t,x,F,\n" + rows().replace("\n", ",\n")), ["t", "x", "F"])
    same(read(tmp_path, '"t","x","F"\n' + rows()), ["t", "x", "F"])
    same(read(tmp_path, "t;x;F;remark\n" + rows(";").replace("\n", ";good\n")), ["t", "x", "F"])
    quoted = "\n".join(";".join(f'"{cell}"' for cell in line.split(";")) for line in rows(";", ",").splitlines())
    same(read(tmp_path, "t;x;F\n" + quoted + "\n"), ["t", "x", "F"])
    # a table that a spreadsheet took for one column: each line is one cell, quotes within it are doubled
    for separator, decimal, end in ((",", ".", ""), (";", ",", ",,"), ("\t", ",", "")):
        lines = ["t;x;F".replace(";", separator), *rows(separator, decimal).splitlines()]
        same(read(tmp_path, "".join(f'"{line}"{end}\n' for line in lines)), ["t", "x", "F"])
    doubled = quoted.replace('"', '""').splitlines()
    same(read(tmp_path, "".join(f'"{line}"\n' for line in doubled)), ["column 1", "column 2", "column 3"])


def test_times_of_day_become_seconds(tmp_path):
    for stamp in ("2026-11-21 23:59:59.{:06d}", "21.11.2026 23:59:59,{:06d}", "23:59:59.{:06d}"):
        lines = [f"{stamp.format(1000 * k)};{x:.8g};{f:.8g}" for k, (x, f) in enumerate(zip(X, F))]
        same(read(tmp_path, "Zeit;x;F\n" + "\n".join(lines) + "\n"), ["Zeit", "x", "F"])


def test_gaps_are_not_numbers_and_a_cut_last_line_is_left_out(tmp_path):
    lines = ("t;x;F\n" + rows(";")).splitlines()
    for gap in ("", "NaN", "-", "1.#IND", "inf"):
        lines[51] = f"{T[50]:.8g};{gap};{F[50]:.8g}"
        recording = read(tmp_path, "\n".join(lines) + "\n")
        assert np.flatnonzero(~np.isfinite(recording.channels[1].values)).tolist() == [50]
    cut = read(tmp_path, "t;x;F\n" + rows(";")[: rows(";").rindex(";")])
    assert cut.channels[0].values.size == N - 1 and any("cut off" in note for note in cut.notes)


def test_packed_text(tmp_path):
    same(read(tmp_path, gzip.compress(("t,x,F\n" + rows()).encode()), "a.txt.gz"), ["t", "x", "F"])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["empty"]),
        (b"one line", ["no rows of numbers", "--separator"]),
        (("t,x,F\n" + rows() + "1,2,3,4\n").encode(), [f"line {N + 2}: 4 columns where the lines above have 3"]),
        (("t,x,F\n" + rows().replace("\n0.1,", "\n0.1,12:x", 1)).encode(), ["is not a number"]),
        (("t,x,F\n" + rows()).encode()[:3000] + bytes(3000), ["zero bytes", "not written to its end"]),
        (bytes(range(256)) * 20, ["no text", "export it as CSV"]),
        (bytes(5000), ["no text"]),
        (b"PK\x03\x04" + bytes(50), ["Excel", "CSV"]),
    ],
)
def test_what_cannot_be_read(tmp_path, content, words):
    with pytest.raises(CampaignError) as caught:
        read(tmp_path, content)
    message = str(caught.value)
    assert message.startswith("a.csv") and "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    "unit",
    ["a" * 20_000, "9**9**9**9*m", "9^9^9^9 m", "9²²²²²²²²²m", "m**9**9**9", "((((9)**9)**9)**9)**9*m", "N⁹⁹⁹⁹⁹⁹⁹⁹"],
)
def test_a_unit_that_would_never_be_worked_out_is_none(unit):
    began = time.process_time()
    assert not is_unit(unit)
    assert time.process_time() - began < 2.0
    for usual in ("mm", "m/s^2", "m/s²", "m/s2", "m/s**2", "m s^-2", "N·m", "mm·s^-1", "rad/s**2"):
        assert is_unit(usual), usual


@pytest.mark.parametrize("cell", ["9" * 60_000 + "x", "1" * 30_000 + "." + "1" * 30_000 + "e", "-" * 60_000])
def test_a_very_long_cell_is_refused_at_once(tmp_path, cell):
    """Found by fuzzing: 5,000 digits and a letter took more than ten seconds."""
    began = time.process_time()
    with pytest.raises(CampaignError):
        read(tmp_path, "t,x,F\n" + rows().replace("\n0.1,", f"\n{cell},", 1))
    assert time.process_time() - began < 5.0


@pytest.mark.parametrize("rest", ["0,{{", "0,1;0,", "x"])
def test_a_last_line_that_is_cut_in_its_first_cell_is_left_out(tmp_path, rest):
    """Found by fuzzing: the column had been taken for text on account of that line alone."""
    whole = "t;x;F\n" + rows(";", ",")
    recording = read(tmp_path, whole + rest)
    same(recording, ["t", "x", "F"])
    assert any("cut off" in note for note in recording.notes)


def test_a_wrong_layout_is_refused(tmp_path):
    for layout, words in (
        ({"encoding": "utf-99"}, "utf-99"),
        ({"decimal": ";"}, "decimal must be"),
        ({"separator": "ab"}, "is no single character"),
    ):
        with pytest.raises(CampaignError, match=words):
            read(tmp_path, "t,x,F\n" + rows(), **layout)
    with pytest.raises(CampaignError, match="not written in utf-8"):
        read(tmp_path, ("t;x;Kräfte\n" + rows(";")).encode("cp1252"), encoding="utf-8")


def test_an_adc_s_end_code_is_a_range_that_was_passed(tmp_path):
    values = F.copy()
    values[57] = 32767.0
    body = "\n".join(f"{t:.6f},{x:.8g},{f:.8g}" for t, x, f in zip(T, X, values))
    (test,) = import_tests([write(tmp_path, f"time_s,disp_mm,force_N\n{body}\n")])
    assert any("1 sample(s) of 'force' read exactly 32767" in w and "range" in w for w in test.record.warnings)
    assert not any("spike" in w for w in test.record.warnings)


@pytest.mark.parametrize("digits", [1, 2])
def test_a_late_channel_with_rounded_times_is_aligned(tmp_path, digits):
    """Each channel has its own times, rounded to far more than a step; the rate is stated."""
    k, t = 7, np.arange(1000) / 1000.0
    x, f = np.sin(2 * np.pi * 10 * t), np.sin(2 * np.pi * 10 * t + 0.4)
    rows = zip(np.round(t[:-k], digits), x[:-k], np.round(t[k:], digits), f[k:])
    body = "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows)
    (test,) = import_tests([write(tmp_path, f"Sample rate: 1000 Hz\ntime_s,disp_mm,time_s,force_N\n{body}\n")])
    loop = test.loop
    energy = float(np.mean(loop.force_N * loop.velocity_m_s) / loop.frequency_hz * 1e3)
    assert energy == pytest.approx(np.pi * np.sin(0.4), rel=0.01)


@pytest.mark.parametrize("head", ["Time 1 [s],Time 2 [s]", "t1,t2"])
def test_two_clocks_that_contradict_each_other_are_asked_about(tmp_path, head):
    """They were taken for one clock in two units, whatever the ratio: half the frequency, without a word."""
    for ratio, asked in ((0.5, True), (1e3, head.startswith("Time"))):
        body = "\n".join(f"{t:.6f},{ratio * t:.6f},{x:.8g},{f:.8g}" for t, x, f in zip(T, X, F))
        path = write(tmp_path, f"{head},disp_mm,force_N\n{body}\n")
        if asked:
            with pytest.raises(CampaignError, match="Which is the time"):
                import_tests([path])
        else:
            import_tests([path])
    body = "\n".join(f"{t:.6f},{1e3 * t:.6f},{x:.8g},{f:.8g}" for t, x, f in zip(T, X, F))
    (test,) = import_tests([write(tmp_path, f"Time 1 [s],Time 2 [ms],disp_mm,force_N\n{body}\n")])
    assert test.loop.frequency_hz == pytest.approx(10.0, rel=1e-4)


def write(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path
