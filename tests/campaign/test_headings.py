"""Headings in other languages and encodings, rows of labels, and signs that are neither unit nor number."""

import string

import numpy as np
import pytest

from bayes_iwan.campaign import CampaignError
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests
from bayes_iwan.campaign.importing.unit_texts import converted, role_of, split_name

RATE, N = 250.0, 500
T = np.arange(N) / RATE
X, F = 900 * np.sin(2 * np.pi * 5 * T + 0.3), 40 * np.sin(2 * np.pi * 5 * T + 0.8)
LATE_S = 0.008
F_LATE = 40 * np.sin(2 * np.pi * 5 * (T + LATE_S) + 0.8)


def record(folder, text, encoding="utf-8", **options):
    (folder / "a.csv").write_bytes(text.encode(encoding))
    (test,) = import_tests([folder / "a.csv"], **options)
    return test.record


def rows(head, *columns, decimal="."):
    cells = [[c if isinstance(c, str) else f"{c:.6f}".replace(".", decimal) for c in row] for row in zip(*columns)]
    return "\n".join([*head, *map(";".join, cells)]) + "\n"


def same(found, x=X / 1e3, f=F, atol=1e-6):
    np.testing.assert_allclose(found.displacement_mm, x, atol=atol)
    np.testing.assert_allclose(found.force_N, f, atol=atol)


@pytest.mark.parametrize(
    ("head", "encoding"),
    [
        ("Время, с;Перемещение, мкм;Усилие, Н", "cp1251"),
        ("Время [с];Деформация [мкм];Нагрузка [Н]", "cp866"),
        ("Время (с);Перемещение (мкм);Сила (Н)", "koi8-r"),
        ("Zeit [s];Wegänderung [µm];Prüfkraft [N]", "cp437"),
        ("Zeit [s];Weg [µm];Kraft [N]", "cp850"),
        ("时间（秒）;位移（微米）;力（牛）", "gbk"),
        ("時間(s);変位(μm);荷重(N)", "cp932"),
        ("Время (с);Перемещение (мкм);Сила (Н)", "utf-16-be"),
    ],
)
def test_headings_are_known_by_their_words(tmp_path, head, encoding):
    same(record(tmp_path, rows([head], T, X, F, decimal=","), encoding))


@pytest.mark.parametrize("between", [";", "\t", ","])
@pytest.mark.parametrize("counted", [True, False])
def test_a_sign_of_remarks_may_stand_above_the_rows_numbers(tmp_path, between, counted):
    """A "#" is the name of a column of numbers, or marks the line of names as a remark."""
    columns = [[str(i) for i in range(N)], T, X, F] if counted else [T, X, F]
    text = rows([("#;" if counted else "# ") + "Time (s);Disp (µm);Force (N)"], *columns)
    same(record(tmp_path, text.replace(";", between)))


@pytest.mark.parametrize("unit", ["?m", "\ufffdm", "$m", "m!"])
def test_a_sign_that_no_unit_has_makes_none(tmp_path, unit):
    """A micrometre whose sign was lost is no metre."""
    assert role_of(unit) is None
    with pytest.raises(ImportAsks, match="states no unit"):
        record(tmp_path, rows([f"Time (s);Disp ({unit});Force (N)"], T, X, F))


@pytest.mark.parametrize(
    ("head", "order"),
    [
        ("Disp (um);t1 (s);Force (N);t2 (s)", (0, 2, 1, 3)),
        ("Disp (um);Force (N);Time Disp (s);Time Force (s)", (0, 1, 2, 3)),
    ],
)
def test_a_time_column_behind_its_channel(tmp_path, head, order):
    columns = (X, F_LATE, T, T + LATE_S)
    found = record(tmp_path, rows([head], *(columns[k] for k in order)))
    assert any("starts" in w for w in found.warnings)
    same(found, X[2:] / 1e3, F[2:])


@pytest.mark.parametrize("late", [0.0, LATE_S])
def test_rows_of_labels_name_scale_and_time_the_columns(tmp_path, late):
    """As LabVIEW SignalExpress writes waveforms: labels on lines of their own."""
    starts = f"3/1/2024 10:00:00.000;3/1/2024 10:00:00.{round(late * 1e3):03d}"
    head = ["channel names:", "Weg (um);Kraft (N)", "start times:", starts, "dt:", "0.004;0.004", "data:"]
    found = record(tmp_path, rows(head, X, F_LATE if late else F))
    assert any("starts" in w for w in found.warnings) == bool(late)
    skip = round(late * RATE)
    same(found, X[skip:] / 1e3, F[skip:])


def test_commas_within_brackets_do_not_part_headings(tmp_path):
    text = rows(["Time (s);Position(8800 (0,1):Position) (um);Load(8800 (0,1):Load) (N)"], T, X, F)
    same(record(tmp_path, text.replace(";", ",")))


def test_points_that_may_divide_thousands_are_asked_of(tmp_path):
    text = rows(
        ["Zeit (ms);Weg (nm);Kraft (mN)"], *([f"{v:,.0f}".replace(",", ".") for v in 1e3 * c] for c in (T, X, F))
    )
    with pytest.raises(CampaignError, match=r"divide thousands.*--decimal"):
        record(tmp_path, text)
    from bayes_iwan.campaign.importing.formats.text_layout import Layout

    same(record(tmp_path, text, recipe=Recipe(layout=Layout(decimal=","))), atol=6e-4)


def test_a_word_that_repeats_among_numbers_is_a_gap(tmp_path):
    cells = ["O.R." if abs(v) > 39.7 else f"{v:.6f}" for v in F]
    found = record(tmp_path, rows(["Time (s);Disp (um);Force (N)"], T, X, cells))
    assert found.force_N.size == N - cells.count("O.R.") and np.abs(found.force_N).max() < 39.7


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9])
def test_moments_since_1970_say_their_unit(tmp_path, size):
    moments = [str(round(1709287198 * size) + round(size * t)) for t in T]
    found = record(tmp_path, rows(["time;Disp (um);Force (N)"], moments, X, F))
    assert found.frequency_hz == 5.0
    same(found)


@pytest.mark.parametrize("unit", ["g", "mN/V"])
def test_a_unit_that_may_be_a_force_s(tmp_path, unit):
    """A load cell in grams is no accelerometer; a unit that the user states needs none in the file."""
    text = rows([f"Time (s);Disp (um);Load ({unit})"], T, X, F / 9.80665e-3 if unit == "g" else F)
    same(record(tmp_path, text, recipe=Recipe(units={} if unit == "g" else {"force": "N"})), atol=1e-5)


@pytest.mark.parametrize(
    ("head", "asked"),
    [
        (["Time (s);Disp (um);Force (N)", "s;um;kN"], "force=<UNIT>"),
        (["Time (ms);Disp (um);Force (N)", "s;um;N"], "time=<ms>"),
        (["Time [Tage];Disp [um];Force [N]"], "time=<ms>"),
    ],
)
def test_units_that_contradict_each_other_or_are_not_known_are_asked_of(tmp_path, head, asked):
    with pytest.raises(ImportAsks, match=asked):
        record(tmp_path, rows(head, T, X, F))


def test_a_time_in_days_without_a_unit_is_asked_of(tmp_path):
    days = [f"{0.4 + t / 86400:.12f}" for t in T]
    text = rows(["Zeit;Disp (um);Force (N)"], days, X, F)
    with pytest.raises(ImportAsks, match="or day"):
        record(tmp_path, text)
    assert record(tmp_path, text, recipe=Recipe(units={"time": "day"})).frequency_hz == 5.0


@pytest.mark.parametrize("name", ["1000*Force (N)", "Force x10 (N)", "Force (N) x1000", "Force/10 (N)"])
def test_a_factor_in_a_name_is_said(tmp_path, name):
    found = record(tmp_path, rows([f"Time (s);Disp (um);{name}"], T, X, F))
    assert any("may name a factor" in w for w in found.warnings)
    assert not record(tmp_path, rows(["Time (s);Disp 10 (um);Force x1 (N)"], T, X, F)).warnings


def test_headings_merged_over_several_rows_name_each_column(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    for row in (["Rig", "Gain", 10], ["Zeit s", "axial", None], [None, "Weg", "Kraft"], [None, "um", "N"]):
        sheet.append(row)
    sheet.merge_cells("A2:A4")
    sheet.merge_cells("B2:C2")
    for row in zip(T.tolist(), X.tolist(), F.tolist()):
        sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    (test,) = import_tests([tmp_path / "a.xlsx"])
    same(test.record)
    assert any("'Rig Gain 10', which is not applied" in w for w in test.record.warnings)


@pytest.mark.parametrize(
    ("start", "what"),
    [
        ("<table><tr><td>1</td></tr></table>", "a document"),
        ("CDF\x01" + 99 * "\0", "netCDF 3"),
        ("FORMAT" + 99 * "\0", "no text, .* export it as CSV"),
    ],
)
def test_other_formats_say_how_to_save_them(tmp_path, start, what):
    with pytest.raises(CampaignError, match=what):
        record(tmp_path, start)


def test_a_rate_that_a_time_without_a_unit_contradicts_is_asked_of(tmp_path):
    text = rows([f"Sample rate: {RATE} Hz", "Time;Disp (um);Force (N)"], T / 3.6, X, F)
    with pytest.raises(CampaignError, match=r"250 samples a second by the file, 900.* by 'Time'.*--time none"):
        record(tmp_path, text)
    same(record(tmp_path, text, recipe=Recipe(channels={"time": "none"})))


@pytest.mark.parametrize(
    ("stem", "written"),
    [
        ("force", "n kn mn g kg kp lb lbf kip kgf pa kpa mpa bar psi nm newton v mv"),
        ("disp", "m mm cm um nm in inch inches ft deg grad rad mil thou v mv"),
        ("time", "s ms us ns sec min v mv"),
    ],
)
def test_a_letter_or_word_behind_a_name_is_a_unit_only_if_recorders_write_it(stem, written):
    """pint knows year (a), day (d), barns (b), points, chains ...: in a heading these are load cells and sides."""
    pint = pytest.importorskip("pint")
    letters = [a + b for a in ["", *string.ascii_letters] for b in string.ascii_letters]
    for ending in letters + [x for x in pint.UnitRegistry()._units if x.isalpha() and len(x) < 7]:
        whole = f"{stem}_{ending}"
        assert split_name(whole) == (whole, "") or ending.lower() in written.split(), ending


@pytest.mark.parametrize(
    "name", ["force_N_2", "Load cell (100 N)", "Force (kN*10)", "force_dyn", "force_h", "Force (counts)", "Force (-N)"]
)
def test_what_is_no_unit_of_a_sample_is_asked_for(tmp_path, name):
    with pytest.raises(
        ImportAsks, match=r"'force|'[LF]o.*(states no unit|what is a sample of 1)|No channel is known as force"
    ):
        record(tmp_path, rows([f"Time (s);Disp (um);{name}"], T, X, F))


def test_a_count_of_cycles_is_no_angle(tmp_path):
    with pytest.raises(ImportAsks, match=r"'Machine_Displacement' \(displacement\) states no unit"):
        record(tmp_path, rows(["Machine_N_cycles;Machine_Load;Machine_Displacement"], np.floor(5 * T), F, X))


@pytest.mark.parametrize("head", ["Time (s);Angle (mrad);Torque (nm)", "time_s;angle_mrad;torque_nm"])
def test_nm_of_a_torque_is_no_length(tmp_path, head):
    same(record(tmp_path, rows([head], T, X / 1e3, F)))


@pytest.mark.parametrize("unit", ["ft-lbs", "lbf.ft", "ft·lb", "lb-ft"])
def test_products_of_units_in_any_spelling(tmp_path, unit):
    text = rows([f"Time (s);Angle (º);Torque ({unit})"], T, np.rad2deg(X / 1e6), F / 1.3558179483314)
    same(record(tmp_path, text), atol=1e-4)


@pytest.mark.parametrize(
    "head",
    [
        "时间(s);位移(um);载荷(N);压缩应力(MPa)",  # Bluehill: 应力 is a stress
        "Time (s);Stroke (um);Friction force (N);Normal force (N)",
        "Time (s);Pos (um);Load (N);Stress (MPa)",
    ],
)
def test_neither_a_stress_nor_a_normal_force_is_the_force(tmp_path, head):
    same(record(tmp_path, rows([head], T, X, F, F + 1)))


def test_a_force_along_x_is_no_displacement(tmp_path):
    text = rows(["t;ft.force.x;ft.force.z;stage.pos"], T, F, F + 1, X)
    with pytest.raises(ImportAsks, match=r"Which channel is the force: ft.force.x, ft.force.z\? .*states no unit"):
        record(tmp_path, text)
    same(
        record(
            tmp_path, text, recipe=Recipe({"force": "ft.force.x"}, {"force": "N", "displacement": "um", "time": "s"})
        )
    )


def test_a_revolution_is_an_angle():
    assert split_name("Angle (rev)") == ("Angle", "rev") and role_of("rev") == "displacement"


@pytest.mark.parametrize(
    ("above", "factor"),
    [
        ("Units: s, mm, kN", 1e3),
        ("Units: mm, N", 1.0),
        ("Einheiten: mm; kN", 1e3),
        ("Units: kN mm s", None),  # a product?
        ("Disp: mm\nForce unit = kN", 1e3),
        ("# Disp: mm, Force: kN", 1e3),
        ("Displacement in mm, force in kN", 1e3),
        ("Units = disp [mm], force [kN]", 1e3),
        ("Channel 1: Disp, mm\nChannel 2: Force, kN", 1e3),
        ("Einheit Kraft: kN\nEinheit Weg: mm", 1e3),
        ("Disp: mm\nForce: 3 kN max", None),
        ("Disp: mm\nForce: N\nForce: kN", None),
        ("Units: mm, mm", None),
        ("Units: SI", None),
        ("Force: mm\nDisp: mm", None),
    ],
)
def test_units_of_lines_above_are_read_where_they_can_be_one_thing_alone(tmp_path, above, factor):
    rows = "".join(f"{t:.6f};{x:.6f};{f:.6f}\n" for t, x, f in zip(T, X, F))
    (tmp_path / "a.csv").write_text(f"Rig 3\n{above}\nTime;Disp;Force\n{rows}")
    if factor is None:
        with pytest.raises(ImportAsks, match=r"'Force' .force. states no unit"):
            import_tests([tmp_path / "a.csv"])
        return
    (found,) = import_tests([tmp_path / "a.csv"])
    np.testing.assert_allclose(found.record.force_N, factor * F, atol=1e-2)
    assert any("units by the lines above: " in x and "'Disp' in mm" in x for x in found.said)


@pytest.mark.parametrize(
    "per",
    ["(m/s^2)", "(m/s²)", "(m/s2)", "[m/s²]", "m/s^2", "m/s²", "m/s/s", "ms-2", "ms^-2", "m·s⁻²", "(m·s⁻²)", "m s-2"],
)
def test_a_sensitivity_per_unit_of_acceleration_as_data_sheets_write_it(per):
    for text in (f"10.2 mV/{per}", f"10,2 mV / {per}", f"[10.2 mV/{per}]", f"10.2 mV per {per}"):
        values, unit = converted(np.full(1, 10.2), "mV", text, "acceleration", "a.csv")
        assert unit == "m/s²" and values == pytest.approx([1.0]), text
    assert role_of(per) == "acceleration"
