"""The page: one file, whole, readable without a picture, and escaping what it is given."""

from __future__ import annotations

import base64
import csv
import hashlib
import html
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from jinja2 import UndefinedError
from markupsafe import Markup
from pypdf import PdfReader

from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.inference.results.remarks import searches_said
from bayes_iwan.report import page as pages
from bayes_iwan.report.identification.marginals import reported
from bayes_iwan.report.identification.tables import _tex_symbol, latex_table
from bayes_iwan.report.page import Page, Section
from bayes_iwan.report.style import save, subplots

from .layout import Outline

pytestmark = pytest.mark.usefixtures("no_figure_files", "few_quick_walkers")


@pytest.fixture(scope="module")
def text(page):
    return (page / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def outline(text):
    return Outline(text)


def test_tags_close_and_ids_are_unique(outline):
    assert outline.open == []
    assert len(set(outline.ids)) == len(outline.ids)


def test_asks_nothing_of_a_network(outline, text):
    assert outline.outside == []
    assert not re.search(r"url\(\s*['\"]?(?!#|data:)", text)
    assert "@import" not in text
    for name in re.findall(r"url\(#([^)]+)\)", text):
        assert name in outline.ids


def test_readable_without_pictures(outline, text):
    assert outline.headings[0] == 1 and outline.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(outline.headings, outline.headings[1:]))
    assert all(outline.pictures) and len(outline.pictures) >= 14
    assert all(inside for _, inside in outline.controls) and outline.controls
    assert '<html lang="en">' in text and 'name="viewport"' in text
    assert {link[1:] for link in outline.links if link.startswith("#")} <= {*outline.ids}
    assert text.count("<caption>") == len(re.findall(r"<table\b", text))


def test_small_enough_and_no_rubble(page):
    assert (page / "report.html").stat().st_size < 5_000_000
    assert "<img" not in (page / "report.html").read_text()  # a picture stays white on a dark screen: the corner plot
    assert not [x for x in page.rglob(".*")]
    assert (page / "report.pdf").read_bytes().startswith(b"%PDF")


class Words(Section):
    """A paragraph for each text."""

    heading = "x < y"
    template = pages._ENVIRONMENT.from_string(
        "{% block Words %}{% for x in r %}<p>{{ x }}</p>{% endfor %}{% endblock %}"
    )


class Mixed(Section):
    """Words, a figure, a table and words again."""

    heading = "Mixed"
    template = pages._ENVIRONMENT.from_string(
        '{% block Mixed %}first {{ r.name }}{{ figure(s.draw(), "shown", "alt", name="f") }}<p>3 N</p>'
        '{{ figure(none, "nothing", "") }}{{ table(("a",), (("<0>",),), "t") }}<p>last</p>{% endblock %}'
    )

    def draw(self):
        return one_figure()


def test_a_section_is_what_its_block_says_in_order():
    """What is asked for stands where it was asked for, drawn or not; a text that looks like its mark is only a text."""
    page = Page("mixed", units=Units("mm", "kPa"))
    page.add(Mixed(SimpleNamespace(name="<1>")))
    text = page.html().split("<main")[1]
    places = [text.index(x) for x in ("first &lt;1&gt;", "<svg", "<p>3 kPa</p>", "&lt;0&gt;", "<p>last</p>")]
    assert places == sorted(places) and text.count("<figure>") == 1
    assert list(page.sections[0].figures) == ["f"]
    with pytest.raises(UndefinedError):
        page.add(Mixed(SimpleNamespace()))


def test_text_is_escaped(tmp_path):
    page = Page("<script>alert(1)</script>", "a & b")
    page.add(Words(("<b>bold?</b>", Markup("<em>yes</em>"))))
    section = page.sections[-1]
    section.table(("<i>", "n"), [("<u>", 1.5)], "1 < 2")
    figure, axes = subplots(1, 1, 2, 2)
    axes[0, 0].plot([0, 1], [0, 1])
    section.figure(figure, "<q>", '"quoted" <alt>')
    page.script(Markup("1;"), "data", json.dumps({"a": "</script>"}))
    written = page.write(tmp_path / "page.html").read_text()
    for bad in ("<script>alert", "<b>bold", "<i>", "<u>", "<q>", "<alt>", '</script>"}'):
        assert bad not in written, bad
    assert "<em>yes</em>" in written
    Outline(written)


def test_names_cannot_steer_a_terminal_that_shows_the_source(tmp_path):
    page = Page("sound \x1b[2J\x9b31m")
    page.add(Words(("a\x1b]0;title\x07b",)))
    text = page.write(tmp_path / "page.html").read_text()
    assert "sound ?[2J?31m" in text and "a?]0;title?b" in text
    assert not any((ord(c) < 32 and c not in "\t\r\n") or 127 <= ord(c) < 160 for c in text)


def test_the_page_lets_no_script_run_but_its_own():
    page = Page("scripts")
    assert "script-src 'none';" in page.html()
    page.script(Markup("let a = 1 < 2;"))
    written = page.html()
    own = re.findall(r"<script>(.*?)</script>", written, re.S)
    assert own == ["let a = 1 < 2;"]
    digest = base64.b64encode(hashlib.sha256(own[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in written
    assert "unsafe-inline" not in written.split("script-src")[1].split(";")[0]


@pytest.mark.parametrize("name", ["$x^{$", "a$b", r"$\\frac{$", "5 $ and 6 $"])
def test_names_that_look_like_mathematics_are_drawn(name, tmp_path):
    figure, axes = subplots(1, 1, 2, 2)
    axes[0, 0].set_title(name)
    assert save(figure, tmp_path / "f.svg").stat().st_size > 100
    page = Page("names")
    page.section("one").figure(figure, name, name)
    assert "<svg" in page.html()


def test_two_figures_do_not_share_ids():
    page = Page("ids")
    section = page.section("one")
    for _ in range(2):
        figure, axes = subplots(1, 1, 2, 2)
        axes[0, 0].fill_between([0, 1], [0, 1], alpha=0.5)
        section.figure(figure, "c", "a")
    ids = Outline(page.html()).ids
    assert len(ids) == len(set(ids))


def one_figure(text="displacement α (mm)"):
    figure, axes = subplots(1, 1, 2, 2)
    axes[0, 0].set_xlabel(text)
    return figure


def test_figures_are_files_beside_the_page_with_text_in_them(tmp_path, figure_files):
    page = Page("figures")
    page.section("one").figure(one_figure(), "c", "a", name="alpha").figure(one_figure(), "c", "a")
    page.write(tmp_path / "report.html")
    names = {"report_alpha", "report_one-f2"}
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {f"{n}.{k}" for n in names for k in ("png", "pdf")}
    drawn = (tmp_path / "figures" / "report_alpha.pdf").read_bytes()
    assert b"/CIDFontType2" in drawn and b"/ToUnicode" in drawn and b"/Type3" not in drawn
    text = PdfReader(tmp_path / "figures" / "report_alpha.pdf").pages[0].extract_text()
    assert "displacement α (mm)" in text
    written = (tmp_path / "report.html").read_text()
    assert "[alpha]" in written and "figures/report_NAME.png" in written and "displacement α (mm)</text>" in written
    other = Page("another page's figures stay, one's own old ones go")
    other.section("one").figure(one_figure(), "c", "a", name="beta")
    other.write(tmp_path / "diagnosis.html")
    page = Page("figures")
    page.section("one").figure(one_figure(), "c", "a", name="alpha")
    page.write(tmp_path / "report.html")
    assert {p.stem for p in (tmp_path / "figures").iterdir()} == {"report_alpha", "diagnosis_beta"}


def test_a_figure_is_laid_out_once(tmp_path, monkeypatch):
    figure, laid = one_figure(), []
    engine = figure.get_layout_engine()
    monkeypatch.setattr(engine, "execute", lambda f, run=engine.execute: (laid.append(1), run(f)))
    for kind in ("svg", "png", "pdf"):
        save(figure, tmp_path / f"f.{kind}")
    assert laid == [1]


def test_the_head_says_when_with_what_and_from_where(text, posterior):
    head = text.split("<main")[0]
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d \w+ · bayes-iwan [\d.]+, seed 1 · from \w", head), "no local path"
    assert f"({len(posterior.campaign.tests) + 1} files)" in head
    foot = text.split("<footer>")[1]
    assert all(test.file in foot for test in posterior.campaign.tests)


def test_the_answer_comes_first_and_symbols_before_what_uses_them(text, posterior):
    sections = re.findall(r"<h2[^>]*>(.*?)</h2>", text)
    assert sections[0] == "Answer"
    first = text.split("<h2")[1]
    wanted = "parallel spring;mean slip force;equivalent stiffness;loss factor;residual;What is not"
    assert not [words for words in wanted.split(";") if words not in first]
    legend = re.search(r'<dl class="symbols">(.*?)</dl>', text, re.S)
    symbols = {html.unescape(x) for x in re.findall(r"<dt>(.*?)</dt>", legend.group(1))}
    assert {q.symbol for q in posterior.problem.prior.parameters} <= symbols
    assert legend.start() < text.index("[parameters]</span>")


def test_one_set_of_numbers(page, text, posterior):
    """What the page, the tables, the LaTeX table and the summary say of a number is the same."""
    rows = {r.name: r for r in posterior.summary()}
    with (page / "tables" / "parameters.csv").open() as file:
        for r in csv.DictReader(file):
            row = rows[r["name"]]
            assert tuple(float(r[x]) for x in ("q50", "q05", "q95")) == pytest.approx(
                (row.q50, row.q05, row.q95), rel=1e-7
            )
    with (page / "tables" / "convergence.csv").open() as file:
        for r in csv.DictReader(file):
            assert float(r["ess_bulk"]) == pytest.approx(rows[r["name"]].ess_bulk, rel=1e-7)
    with (page / "tables" / "loops.csv").open() as file:
        loops = list(csv.DictReader(file))
    for r in loops:
        row = rows[f"dissipated_energy_mJ[{r['file']}]"]
        found = [float(r[f"energy_mJ_{x}"]) for x in ("q50", "q05", "q95")]
        assert found == pytest.approx([row.q50, row.q05, row.q95], rel=1e-7)
    residual = posterior.residual_size()
    fitted = [float(r["rms_residual_N"]) for r in loops if r["role"] != "held-out"]
    assert np.sqrt(np.mean(np.square(fitted))) == pytest.approx(residual.rms_N, rel=1e-6)
    shares = [float(r["residual_share_of_friction"]) for r in loops if r["role"] != "held-out"]
    friction = np.array(fitted) / np.array(shares)  # one friction force for every percentage
    assert residual.rms_N / np.sqrt(np.mean(friction**2)) == pytest.approx(residual.share, rel=1e-6)
    for name in ("kp_N_mm", "k1_N_mm", "mean_slip_force_N"):
        middle, low, high = reported(posterior, name)
        first, rest = text.split("<h2")[1], text.split("<h2")[2]
        assert f"{low} to {high}" in html.unescape(first)
        assert f"{middle} [{low}, {high}]" in html.unescape(rest)  # the figure's own text
    assert f"{100 * residual.share:.2g} % of the friction force" in text.split("<h2")[1]


def test_failed_write_leaves_the_old_page(tmp_path, monkeypatch):
    page = Page("first")
    path = page.write(tmp_path / "p.html")
    before = path.read_text()
    monkeypatch.setattr("os.replace", lambda *a: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError):
        Page("second").write(path)
    assert path.read_text() == before
    assert [x.name for x in tmp_path.iterdir()] == ["p.html"]


def test_tables_beside_the_page(page, posterior):
    with (page / "tables" / "parameters.csv").open() as file:
        rows = {r["name"]: r for r in csv.DictReader(file)}
    assert set(rows) == set(posterior.names)
    kp = posterior.values()["kp_N_mm"]
    assert float(rows["kp_N_mm"]["q50"]) == pytest.approx(np.median(kp), rel=1e-8)
    assert float(rows["kp_N_mm"]["q05"]) == pytest.approx(np.quantile(kp, 0.05), rel=1e-8)
    with (page / "tables" / "loops.csv").open() as file:
        loops = list(csv.DictReader(file))
    assert [r["role"] for r in loops].count("held-out") == 1
    for row in loops:
        assert float(row["energy_mJ_q50"]) == pytest.approx(float(row["energy_mJ_measured"]), rel=0.03)
    with (page / "tables" / "per_frequency.csv").open() as file:
        assert {"all"} == {r["frequency"] for r in csv.DictReader(file)}


@pytest.mark.parametrize(
    "symbol, tex", [("η1", r"\eta_{1}"), ("τ2", r"\tau_{2}"), ("γ", r"\gamma"), ("σy", r"\sigma y"), ("kp", "k_p")]
)
def test_greek_symbols_of_a_users_own_model_are_commands_of_latex(symbol, tex):
    assert _tex_symbol(symbol) == f"${tex}$"


def test_latex_table_is_balanced_and_ascii_enough(posterior):
    tex = latex_table(posterior)
    assert r"$\eta_{1}$" in tex and "$k_p$" in tex
    assert tex.count("{") == tex.count("}") and tex.count("$") % 2 == 0
    body = [line for line in tex.splitlines() if line.endswith(r"\\")]
    assert len(body) == posterior.ndim + 1 and all(line.count(" & ") == 4 for line in body)
    assert all(ord(c) < 128 for c in tex), sorted({c for c in tex if ord(c) >= 128})


def test_searches_that_disagree_are_said(posterior, monkeypatch):
    """A second search that stayed five below the first, and one that ended where the first did."""
    monkeypatch.setattr(type(posterior), "held_out", ())  # each is sampled anew
    z = posterior.point.z
    other = z.copy()
    other[posterior.names.index("kp_N_mm")] -= 2.0
    for gap, agree in ((5.0, False), (0.1, True)):
        point = replace(posterior.point, each_z=np.stack([z, other]), each_log_prob=np.array([0.0, -gap]))
        said, same = searches_said(replace(posterior, point=point))
        assert (said in replace(posterior, point=point).warnings()) == (not agree)
        assert same == agree and ("kp_N_mm" in said) == (not agree)
    assert "One search only" in searches_said(posterior)[0]
