"""An identification of a torque over an angle: no page, table or figure text speaks of N or mm."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from bayes_iwan import cli
from bayes_iwan.campaign import read_campaign, write_campaign
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.comparison.families import FAMILIES, Comparison, Entry
from bayes_iwan.comparison.loo import Loo
from bayes_iwan.inference.setup.config import settings_of
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.report import page as pages
from bayes_iwan.report.batch import batch_run, specimens
from bayes_iwan.report.batch.batch_page import write_batch_page
from bayes_iwan.report.comparison_page import comparison_report
from bayes_iwan.report.page import Page, Section, of_folder
from bayes_iwan.report.style import relabel

from .layout import visible

pytestmark = pytest.mark.usefixtures("no_figure_files", "no_phones", "few_quick_walkers")

#: newtons that are no newton metres, and millimetres; names of numbers with these units
FOREIGN = re.compile(r"(?<![\w·])(?:[km]?N(?!·m|\w)|mm(?!\w))|\w_(?:N|mm)(?:_\w+)?(?![\w.])")


def test_an_identification_of_torque_over_angle(tmp_path, capsys, made_up_campaign, short_config):
    records = [replace(x, units=Units("mrad", "N·m")) for x in read_campaign(made_up_campaign).tests]
    write_campaign(tmp_path / "torsion", name="torsion damper", description="", tests=records)
    out = tmp_path / "out"
    arguments = ["identify", str(tmp_path / "torsion"), "--out", str(out), "--config", str(short_config), "--seed", "1"]
    assert cli.main(arguments) in (0, 3)
    said = capsys.readouterr().out
    assert re.search(r"kp_Nm_mrad .* N·m/mrad", said)
    texts = {"output": said, "report.html": visible((out / "report.html").read_text())}
    texts |= {p.name: p.read_text() for p in [out / "summary.csv", *(out / "tables").iterdir()]}
    for name, text in texts.items():
        found = FOREIGN.search(text.replace(str(tmp_path), ""))
        assert found is None, f"{name}: {text[max(found.start() - 60, 0) : found.end() + 40]!r}"
    assert "N·m/mrad" in texts["summary.csv"] and "torque" not in texts["summary.csv"]
    page = (out / "report.html").read_text()
    assert "displacement u (mrad)" in page and '"force":"N·m"' in page.replace("\\u00b7", "·")
    assert cli.main(["check", str(tmp_path / "torsion")]) == 0
    assert "A, mrad" in capsys.readouterr().out


class Said(Section):
    heading = "Loops"
    template = pages._ENVIRONMENT.from_string("{% block Said %}<p>a gap of 3 N</p>1.2 mJ, kp_N_mm{% endblock %}")


def test_texts_of_pages_and_figures(tmp_path):
    units = Units("mm", "kPa")
    page = Page("title", "all in N", "footer with 3 N/mm", units=units)
    figure = Figure()
    axes = figure.subplots()
    axes.set_xlabel("displacement (mm)")
    axes.set_ylabel("force (N)")
    axes.plot([0, 1], [0, 1], label="2 N")
    axes.legend()
    axes.set_xticks([0, 1], ["10 N", "20 N"])
    page.add(Said(None))
    page.sections[0].figure(figure, "caption in N", "alt in N").table(
        ("name", "N"), [("kp_N_mm", "3 N")], "table in mN"
    )
    text = visible(page.html())
    wanted = "all in kPa;3 kPa/mm;force (kPa);2 kPa;20 kPa;a gap of 3 kPa;1.2 J/m²;kp_kPa_mm;Pa"
    assert not [words for words in wanted.split(";") if words not in text]
    assert not re.search(r"(?<!\w)N(?!\w)", text)
    with pytest.raises(AttributeError):
        units.force = "N"  # type: ignore[misc]
    before = axes.get_ylabel()
    relabel(figure, Units())
    assert axes.get_ylabel() == before == "force (kPa)"


def test_batch_and_compare_of_torque_over_angle(tmp_path, posterior, monkeypatch):
    units = Units("mrad", "N·m")
    loops = tuple(replace(x, record=replace(x.record, units=units)) for x in posterior.loops)
    problem = make_problem(tuple(x for x in loops if x.role == "fit"), posterior.settings)
    campaign = replace(posterior.campaign, tests=tuple(x.record for x in loops))
    torsion = replace(posterior, problem=problem, loops=loops, campaign=campaign)
    monkeypatch.setattr("bayes_iwan.identify", lambda *a, **k: torsion)
    job = batch_run.Job(tmp_path, tmp_path, True, False, False, 0, settings_of(None), False)
    (tmp_path / "a").mkdir()
    record = batch_run._identified(job, tmp_path / "a", tmp_path / "a")["quantities"]
    assert "kp_Nm_mrad" in record and record["kp_Nm_mrad"]["unit"] == "N·m/mrad"
    quantities = {
        n: batch_run.Quantity(**(q | {"draws": np.array(q["draws"]), "prior": np.array(q["prior"])}))
        for n, q in record.items()
    }
    finished = tuple(
        batch_run.Finished(x, 1.0, True, "", quantities, None, None, None, None, None) for x in ("one", "two", "three")
    )
    result = batch_run.Batch(finished, {}, specimens.populations(finished))
    page = write_batch_page(result, tmp_path, of_folder(tmp_path, 0)).read_text()
    loo = Loo(10.0, 1.0, 13.0, np.ones(10), np.zeros(10))
    entry = Entry(FAMILIES["gamma1"], torsion, 13, 0.01, loo, None, 1.0)
    comparison_report(Comparison(None, "loo", (entry,)), tmp_path)
    texts = [visible(page), visible((tmp_path / "compare.html").read_text()), result.table().csv()]
    for text in (*texts, (tmp_path / "compare.csv").read_text()):
        found = FOREIGN.search(text.replace(str(tmp_path), ""))
        assert found is None, text[max(found.start() - 60, 0) : found.end() + 40]
    assert "kp (N·m/mrad)" in texts[0] and "stiffness of the parallel spring (N·m/mrad)" in texts[0]


def test_an_answer_in_other_units():
    answer = {"gap_N": 3.0, "sentences": ["misses 3 N", ("1 mm", 2)], "text": {"unit": "N/mm"}}
    assert Units().everywhere(answer) is answer
    told = Units("mrad", "N·m").everywhere(answer)
    assert told == {"gap_N": 3.0, "sentences": ["misses 3 N·m", ("1 mrad", 2)], "text": {"unit": "N·m/mrad"}}
