"""A batch of specimens: finished, failed, stopped half way and gone on with, the same wherever it ran."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from pypdf import PdfReader

import bayes_iwan
from bayes_iwan.report.batch import batch_run as room
from bayes_iwan.report.batch.batch_run import BatchError, batch
from bayes_iwan.report.batch.batch_sheet import WORDS
from bayes_iwan.report.batch.specimens import lots_of
from bayes_iwan.report.identification.marginals import in_interval

pytestmark = pytest.mark.usefixtures("no_figure_files")

CONFIG = {
    "model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False},
    "likelihood": {"kind": "gaussian"},
    "search": {"members": 40, "evaluations": 400, "starts": 4, "second_search": False},
    "sampling": {"ensembles": 2, "walkers": 24, "r_hat": 1.2, "ess": 40.0, "taus": 5.0, "draws": 500},
}


@pytest.fixture(scope="module", autouse=True)
def _quick(no_pictures, few_quick_walkers):
    """For every batch here."""


@pytest.fixture(scope="module")
def folder(made_up_campaign, tmp_path_factory):
    """Three specimens of parallel springs and forces that differ by a known factor, one broken, one folder of none."""
    out = tmp_path_factory.mktemp("specimens")
    for name, factor in (("a", 1.0), ("b", 1.1), ("c", 0.9)):
        shutil.copytree(made_up_campaign, out / name)
        for path in (out / name).glob("*.csv"):
            head, *rows = path.read_text().splitlines()
            scaled = [",".join([*row.split(",")[:-1], repr(factor * float(row.split(",")[-1]))]) for row in rows]
            path.write_text("\n".join([head, *scaled]) + "\n")
    shutil.copytree(made_up_campaign, out / "broken <b>")
    (out / "broken <b>" / "campaign.toml").write_text("format = 1\n[specimen\n")
    (out / "notes").mkdir()
    return out


@pytest.fixture(scope="module")
def two(folder, tmp_path_factory):
    """Two of them."""
    out = tmp_path_factory.mktemp("two")
    for name in "ab":
        shutil.copytree(folder / name, out / name)
    return out


@pytest.fixture(scope="module")
def done(folder, tmp_path_factory, _quick):
    out = tmp_path_factory.mktemp("batch") / "out"
    return batch(folder, out, config=CONFIG, seed=3, progress=False), out


def test_what_is_finished_what_failed_and_the_files(done):
    result, out = done
    assert [x.name for x in result.finished] == ["a", "b", "c"] and all(x.converged for x in result.finished)
    assert list(result.failures) == ["broken <b>"] and "campaign.toml" in result.failures["broken <b>"]
    kp = {x.name: x.quantities["kp_N_mm"] for x in result.finished}
    for name, factor in (("a", 1.0), ("b", 1.1), ("c", 0.9)):
        assert kp[name].low < 5.5 * factor < kp[name].high or abs(kp[name].median / (5.5 * factor) - 1) < 0.01
    rows = list(csv.DictReader((out / "batch.csv").open()))
    assert [r["specimen"] for r in rows] == ["a", "b", "broken <b>", "c"]
    assert float(rows[1]["kp_N_mm_q50"]) == pytest.approx(kp["b"].median) and rows[2]["state"] == "failed"
    parquet = pytest.importorskip("pyarrow.parquet").read_table(out / "batch.parquet").to_pydict()
    assert parquet["kp_N_mm_q50"][1] == pytest.approx(kp["b"].median)
    for written in (x for x in out.rglob("*") if x.is_file()):
        assert str(out.parents[1]).encode() not in written.read_bytes(), written
    page = (out / "batch.html").read_text()
    assert "broken &lt;b&gt;" in page and "<b>" not in page and 'href="specimens/a/report.html"' in page
    assert not [p for p in out.rglob(".*")] and not list(out.rglob("chains.ckpt"))
    population = result.populations["kp_N_mm"]
    assert population.typical[1] < 5.5 < population.typical[2] and population.spread[1] < 0.1 < population.spread[2]


def test_the_excel_file_is_the_csv_file(done):
    """The same head, rows and numbers, as numbers; what is empty in one is empty in the other."""
    openpyxl = pytest.importorskip("openpyxl")
    _, out = done
    (sheet,) = openpyxl.load_workbook(out / "batch.xlsx").worksheets
    rows = [*csv.reader((out / "batch.csv").open(encoding="utf-8"))]
    cells = [*sheet.iter_rows(values_only=True)]
    assert len(cells) == len(rows) == 5 and list(cells[0]) == rows[0]
    numbers = 0
    for excel, text in zip(cells[1:], rows[1:], strict=True):
        for name, cell, written in zip(rows[0], excel, text, strict=True):
            if isinstance(cell, int | float):
                assert cell == pytest.approx(float(written), rel=1e-8), name
                numbers += 1
            else:
                assert (cell or "") == written, name
    assert numbers > 30 and sheet.freeze_panes == "B2"


def test_the_customer_s_sheet_is_one_page_with_the_batch_s_numbers(done):
    result, out = done
    (page,) = PdfReader(out / "sheet.pdf").pages
    width, height = (float(x) / 72 for x in page.mediabox[2:])
    assert (width, height) == pytest.approx((8.27, 11.69), abs=0.02)
    text = " ".join(page.extract_text().split())
    assert "4 specimens" in text and "3 finished, 1 failed" in text and "Failed: broken <b>" in text
    rows = [q for q in result.populations if q in WORDS]
    assert {"kp_N_mm", "k1_N_mm", "mean_slip_force_N"} <= {*rows}
    for q in rows:
        p = result.populations[q]
        if not p.doubt:
            assert "{} [{}, {}]".format(*in_interval(*p.typical)) in text, q
            assert f"{100 * p.spread[0]:.2g} %" in text, q
    assert all(x.name in text for x in result.unusual)


def test_what_is_finished_is_not_run_again_unless_data_or_settings_differ(done, folder, tmp_path, monkeypatch):
    _, out = done
    mine = tmp_path / "out"
    shutil.copytree(out, mine)
    asked = []

    def recorded(campaign, *args, **kwargs):
        asked.append(Path(campaign).name)
        raise ValueError("was run")

    monkeypatch.setattr(bayes_iwan, "identify", recorded)
    again = batch(folder, mine, config=CONFIG, seed=3, progress=False)
    assert asked == ["broken <b>"]
    assert len(again.finished) == 3
    path = mine / "specimens" / "a" / "specimen.json"
    path.write_text(path.read_text()[:-40])  # damaged
    record = json.loads((mine / "specimens" / "b" / "specimen.json").read_text())
    record["made_with"]["seed"] = 4
    (mine / "specimens" / "b" / "specimen.json").write_text(json.dumps(record))
    asked.clear()
    again = batch(folder, mine, config=CONFIG, seed=3, progress=False)
    assert sorted(asked) == ["a", "b", "broken <b>"] and again.failures["a"] == "ValueError: was run"
    assert [x.name for x in again.finished] == ["c"]


QUANTITY = {"label": "kp", "unit": "N/mm", "median": 5, "low": 4.9, "high": 5.1, "draws": [4.9, 5.1], "prior": [1, 9.0]}


@pytest.mark.parametrize(
    "change",
    [
        {"prior": {}},
        {"draws": ["a", 1.0]},
        {"draws": []},
        {"draws": [[1.0]]},
        {"median": "5"},
        {"low": 10**400},
        {"label": 3},
        {"draws": [float("nan"), 1.0]},
    ],
    ids=str,
)
def test_a_specimen_s_record_that_is_none_of_ours_is_run_again(tmp_path, change):
    record = {"schema": 1, "made_with": {}, "quantities": {"kp": QUANTITY}, "seconds": 3}
    (tmp_path / "specimen.json").write_text(json.dumps(record))
    assert room.stored_specimen(tmp_path, {}).quantities["kp"].median == 5.0
    (tmp_path / "specimen.json").write_text(json.dumps(record | {"quantities": {"kp": QUANTITY | change}}))
    assert room.stored_specimen(tmp_path, {}) is None


def test_nothing_to_do_is_said(tmp_path, folder):
    with pytest.raises(BatchError, match=r"no folder in it holds a campaign\.toml"):
        batch(tmp_path, tmp_path / "out")
    with pytest.raises(BatchError, match="not a folder"):
        batch(tmp_path / "none", tmp_path / "out")
    with pytest.raises(BatchError, match="nothing to do"):
        batch(folder, tmp_path / "out", identify=False)
    with pytest.raises(ValueError, match="walkrs"):
        batch(folder, tmp_path / "out", config={"sampling": {"walkrs": 3}})


RUN = """
import json, sys
from bayes_iwan.report.batch.batch_run import batch

if __name__ == "__main__":
    batch(sys.argv[1], sys.argv[2], config=json.loads(sys.argv[3]), seed=3, progress=False, workers=2)
"""


def test_killed_half_way_in_two_processes_it_goes_on_to_the_same_answer(done, two, tmp_path, few_walkers, no_pictures):
    _, whole = done
    out, script = tmp_path / "out", tmp_path / "run.py"
    # above `if __name__`: its worker processes read it too
    files = "from bayes_iwan.report import page; page.FILES = ()"
    script.write_text("\n".join((few_walkers, no_pictures, files, RUN)))
    env = {**os.environ, "PYTHONPATH": str(Path(bayes_iwan.__file__).parents[1])}
    words = [sys.executable, str(script), str(two), str(out), json.dumps(CONFIG)]
    run = subprocess.Popen(words, env=env, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 200
    while not list(out.rglob("chains.ckpt")) and time.monotonic() < end:
        time.sleep(0.05)
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert subprocess.run(words, env=env, check=True).returncode == 0
    for name in "ab":
        one, other = ((f / "specimens" / name / "summary.csv").read_bytes() for f in (out, whole))
        assert one == other, name
    assert not [p for p in out.rglob(".*")]


def test_quick_ones_are_not_sampled_and_say_so_and_each_answer_is_that_of_the_specimen_alone(two, tmp_path):
    result = batch(two, tmp_path / "out", config=CONFIG, seed=3, quick=True, progress=False)
    assert [(x.name, x.converged) for x in result.finished] == [("a", None), ("b", None)]
    for x, factor in zip(result.finished, (1.0, 1.1)):
        assert x.message.startswith("quick: ") and x.quantities["kp_N_mm"].median == pytest.approx(
            5.5 * factor, rel=0.02
        )
    bayes_iwan.identify(two / "b", tmp_path / "b", config=CONFIG, seed=3, quick=True, progress=False)
    there = tmp_path / "out" / "specimens" / "b" / "summary.csv"
    assert there.read_bytes() == (tmp_path / "b" / "summary.csv").read_bytes() and b",quick" in there.read_bytes()
    assert "not converged" not in (tmp_path / "out" / "batch.csv").read_text()


def test_a_diagnosis_of_each(folder, tmp_path, monkeypatch):
    """What `diagnose` says goes into the table; the diagnosis itself has its own tests."""
    said = {"a": ("moving_mass", None, 0.8), "b": ("none", None, 0.9), "c": ("moving_mass", "free_play", 0.7)}

    def diagnosed(campaign, out, **options):
        assert options["seed"] == 5 and options["quick"] and options["progress"] is False
        cause, second, p = said[Path(campaign).name]
        Path(out).mkdir(parents=True, exist_ok=True)
        answer = {
            "verdict": {"cause": cause, "second_cause": second, "probability": p},
            "gap": {"before_share": 0.05, "shrink": 0.6},
        }
        return SimpleNamespace(to_dict=lambda: answer)

    monkeypatch.setattr(room, "write_diagnosis", diagnosed)
    result = batch(folder, tmp_path / "out", identify=False, diagnose=True, quick=True, seed=5, progress=False)
    assert [(x.cause, x.second_cause, x.probability) for x in result.finished] == list(said.values())
    assert list(result.failures) == ["broken <b>"]  # no verdict for it: a KeyError is listed like any other
    page = (tmp_path / "out" / "batch.html").read_text()
    assert "moving mass + free play" in page and 'href="specimens/a/diagnosis.html"' in page


def test_lots_that_do_not_fit_the_folders_are_refused_before_anything_runs(tmp_path):
    """A typo left a specimen out of its lot, without a word."""
    table = tmp_path / "specimens.csv"
    table.write_text("specimen,lot\na,1\nb,\n")
    assert lots_of(tmp_path, "lot", ["a", "b"]) == {"a": "1", "b": ""}
    for names, says in (
        (["a", "b", "c"], "no line for the campaign folder c: add it"),
        (["a"], "no campaign folder b:"),
    ):
        with pytest.raises(BatchError, match=says):
            lots_of(tmp_path, "lot", names)
    with pytest.raises(BatchError, match=r"no line for .* c: .*; no campaign folder b: fix the name"):
        lots_of(tmp_path, "lot", ["a", "c"])
    with pytest.raises(BatchError, match=r"""has no column "lott"; add it, .*; did you mean 'lot'\?$"""):
        lots_of(tmp_path, "lott", ["a", "b"])
    table.write_text("specimen,lot\na,1\nb,2\na,2\n")
    with pytest.raises(BatchError, match="several lines for a: delete all but one"):
        lots_of(tmp_path, "lot", ["a", "b"])
    table.write_bytes(b"specimen,lot\na,gr\xf6n\n")
    with pytest.raises(BatchError, match="line 2: not UTF-8"):
        lots_of(tmp_path, "lot", ["a"])
