"""The page: one file, whole, readable without a picture, and escaping what it is given."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from markupsafe import Markup

from bayes_iwan.report import latex_table
from bayes_iwan.report.identification import searches_said
from bayes_iwan.report.page import Page
from bayes_iwan.report.style import save, subplots

VOID = {"meta", "link", "br", "input", "img", "path", "circle", "use", "hr"}


class Outline(HTMLParser):
    """Ids, headings, pictures, labels and outside references of a page, and whether its tags close."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.headings, self.references, self.open, self.pictures, self.controls = [], [], [], [], [], []
        self.links = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        a = dict(attrs)
        self.ids += [a["id"]] if "id" in a else []
        self.headings += [int(tag[1])] if re.fullmatch(r"h[1-6]", tag) else []
        self.references += [v for k, v in attrs if k in ("src", "href", "xlink:href", "action") and v]
        self.links += [v[1:] for k, v in attrs if k == "href" and v and v.startswith("#") and tag == "a"]
        if tag == "img":
            self.pictures.append(a.get("alt"))
        if tag == "svg" and a.get("role") == "img":
            self.pictures.append(a.get("aria-labelledby"))
        if tag in ("select", "input"):
            self.controls.append((a.get("id"), "label" in self.open))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag, tag


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
    for reference in outline.references:
        assert reference.startswith(("#", "data:")), reference
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
    assert all(link in outline.ids for link in outline.links)
    assert text.count("<caption>") == text.count("<table>")


def test_small_enough_and_no_rubble(page):
    assert (page / "report.html").stat().st_size < 5_000_000
    assert not [x for x in page.rglob(".*")]
    assert (page / "report.pdf").read_bytes().startswith(b"%PDF")


def test_text_is_escaped(tmp_path):
    page = Page("<script>alert(1)</script>", "a & b")
    section = page.section("x < y")
    section.text("<b>bold?</b>", Markup("<em>yes</em>"))
    section.table(("<i>", "n"), [("<u>", 1.5)], "1 < 2")
    figure, axes = subplots(1, 1, 2, 2)
    axes[0, 0].plot([0, 1], [0, 1])
    section.figure(figure, "<q>", '"quoted" <alt>')
    page.script(Markup("1;"), "data", json.dumps({"a": "</script>"}))
    html = page.write(tmp_path / "page.html").read_text()
    for bad in ("<script>alert", "<b>bold", "<i>", "<u>", "<q>", "<alt>", '</script>"}'):
        assert bad not in html, bad
    assert "<em>yes</em>" in html
    Outline(html)


def test_the_page_lets_no_script_run_but_its_own():
    page = Page("scripts")
    assert "script-src 'none';" in page.html()
    page.script(Markup("let a = 1 < 2;"))
    html = page.html()
    own = re.findall(r"<script>(.*?)</script>", html, re.S)
    assert own == ["let a = 1 < 2;"]
    digest = base64.b64encode(hashlib.sha256(own[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in html and "unsafe-inline" not in html.split("script-src")[1].split(";")[0]


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
    assert float(rows["kp_N_mm"]["median"]) == pytest.approx(np.median(kp), rel=1e-8)
    assert float(rows["kp_N_mm"]["q05"]) == pytest.approx(np.quantile(kp, 0.05), rel=1e-8)
    with (page / "tables" / "loops.csv").open() as file:
        loops = list(csv.DictReader(file))
    assert [r["role"] for r in loops].count("held-out") == 1
    for row in loops:
        assert float(row["energy_mJ_median"]) == pytest.approx(float(row["energy_mJ_measured"]), rel=0.03)
    with (page / "tables" / "per_frequency.csv").open() as file:
        assert {"all"} == {r["frequency"] for r in csv.DictReader(file)}


def test_latex_table_is_balanced_and_ascii_enough(posterior):
    tex = latex_table(posterior)
    assert r"$\eta_{1}$" in tex and "$k_p$" in tex
    assert tex.count("{") == tex.count("}") and tex.count("$") % 2 == 0
    body = [line for line in tex.splitlines() if line.endswith(r"\\")]
    assert len(body) == posterior.ndim + 1 and all(line.count(" & ") == 4 for line in body)
    assert all(ord(c) < 128 for c in tex), sorted({c for c in tex if ord(c) >= 128})


def test_searches_that_disagree_are_said(posterior):
    """A second search that stayed five below the first, and one that ended where the first did."""
    z = posterior.point.z
    other = z.copy()
    other[posterior.names.index("kp_N_mm")] -= 2.0
    for gap, agree in ((5.0, False), (0.1, True)):
        point = replace(posterior.point, each_z=np.stack([z, other]), each_log_prob=np.array([0.0, -gap]))
        said, same = searches_said(replace(posterior, point=point))
        assert same == agree and ("kp_N_mm" in said) == (not agree)
    assert "One search only" in searches_said(posterior)[0]
