"""Every kind of page at four widths, in print, on a light and a dark screen, and every kind of result in a terminal:
nothing is cut, nothing sticks out, nothing is pale, no heading without its text."""

import dataclasses
import inspect
import json
import re
import shutil
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup

import bayes_iwan as bi
from bayes_iwan.diagnosis.assessment.budget import Share
from bayes_iwan.report import style
from bayes_iwan.report.batch.batch_page import write_batch_page
from bayes_iwan.report.batch.specimens import Finished, Quantity, summarised
from bayes_iwan.report.browser import BrowserError, find_browser
from bayes_iwan.report.identification.identification_page import identification_report
from bayes_iwan.report.inspection.inspect_page import inspect_to
from bayes_iwan.report.page import Page, of_folder

from .layout import WIDTHS, cut_elements, pale_texts, torn

SHORT = {
    "search": {"members": 40, "evaluations": 400, "starts": 2, "second_search": False},
    "sampling": {"ensembles": 2, "budget_s": 0.5, "draws": 200},
}
CLASSICAL = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant"}}


@pytest.fixture(scope="module")
def specimens():
    """Eight specimens of two lots, one with 46 % more slip force, as if identified and diagnosed."""
    rng = np.random.default_rng(2)
    finished = []
    for i in range(8):
        slip = (1.46 if i == 5 else 1.0) * (1.0 + 0.03 * rng.standard_normal())
        draws = {"kp_N_mm": 5.4 * (1 + 0.03 * rng.standard_normal()), "mean_slip_force_N": slip}
        quantities = {}
        for name, value in draws.items():
            drawn = (value * np.exp(0.006 * rng.standard_normal(300)), np.exp(0.5 * rng.standard_normal(400)))
            label = f"{name} of the contacts at rest (N)"
            quantities[name] = Quantity(label, "N", value, 0.99 * value, 1.01 * value, *drawn)
        row = (60.0, True, "converged", quantities, "viscous_damping", None, 0.9, 0.08, 0.7, 0.01)
        finished.append(Finished(f"specimen_with_a_long_name_{i}", *row))
    lots = {x.name: "AB"[i % 2] for i, x in enumerate(finished)}
    return summarised(tuple(finished), {"broken": "campaign.toml: not valid TOML"}, 1, "lot", lots)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def results(out, posterior, specimens, made_up_campaign, few_quick_walkers):
    """Every kind of result, by name; those with a page have written it."""
    posterior = replace(posterior)  # what it computes when asked is computed here, by few walkers
    campaign = bi.demo(out / "demo")
    plan = [bi.PlannedTest(f, a, cycles=6) for f in (8.0, 20.0) for a in (0.4, 0.9)]
    return {
        "campaign": campaign,
        "check": bi.check(made_up_campaign),
        "posterior": posterior,
        "summary": posterior.summary(),
        "values": posterior.values(),
        "quantities": posterior.quantities(),
        "warnings": posterior.warnings(),
        "prediction": posterior.predict(frequency_hz=12.0, amplitude_mm=0.5),
        "plot": posterior.plot,
        "model": bi.load(posterior.export("json", out / "json", draws=3)),
        "diagnosis": bi.diagnose(campaign.path, out, quick=True, seed=1, config=CLASSICAL),
        "comparison": bi.compare(
            campaign, out, families=["uniform", "gamma1"], config=SHORT, by="tests", seed=1, progress=False
        ),
        "batch": specimens,
        "table": specimens.table(),
        "differences": specimens.differences(),
        "virtual": bi.simulate_campaign(plan, fault="viscous_damping", size=0.2, seed=1),
        "settings": bi.settings_of(),
        "citation": bi.cite(),
    }


@pytest.fixture(scope="module")
def pages(page, results, out, made_up_campaign):
    """A folder with every kind of page."""
    shutil.copy(page / "report.html", out)
    inspect_to(made_up_campaign, out)
    write_batch_page(results["batch"], out, of_folder(out, 1))
    return out


@pytest.mark.parametrize("name", ["report", "inspect", "batch", "diagnosis", "compare"])
def test_nothing_is_cut_at_any_width_nor_in_print(pages, chromium, tmp_path, name):
    html = pages / f"{name}.html"
    found = cut_elements(html, chromium)
    assert found == {str(width): [] for width in WIDTHS}
    assert torn(html, chromium.printed(html, tmp_path / "page.pdf")) == []
    assert html.stat().st_size < 3_000_000
    for written in (x for x in pages.rglob("*") if x.is_file()):
        assert str(pages.parent).encode() not in written.read_bytes(), f"a local path is in {written.name}"


@pytest.mark.parametrize("dark", [True, False], ids=["dark", "light"])
def test_no_text_is_pale_on_a_dark_screen_nor_on_a_light_one(pages, results, chromium, tmp_path, dark):
    """Bars among them of what no diagnosis here has: a gap without a name, and pale letters, which are seen."""
    found = results["diagnosis"]
    whole = replace(found.budget.unexplained, share=Share(1.0, 1.0, 1.0), probability=1.0)
    page = Page("bars")
    unexplained = replace(found, budget=replace(found.budget, causes=(), unexplained=whole))
    page.section("Unexplained").figure(bi.plot.gap(unexplained), "caption", "alt", name="bars")
    page.section("Pale").html(Markup('<p style="color: #808080">pale words</p>'))
    page.write(tmp_path / "bars.html")
    seen = pale_texts([*sorted(pages.glob("*.html")), tmp_path / "bars.html"], chromium, dark)
    assert [x.partition(": ")[2] for x in seen.pop("bars.html")] == ["pale words"]
    assert len(seen) == 5 and seen == {name: [] for name in seen}


def test_the_palette_stays_as_clear_on_a_dark_screen():
    """Lines and marks: at least as far from the paper as on a light screen, or 3 : 1 (WCAG 2.2, 1.4.11)."""
    css = (Path(style.__file__).parent / "templates" / "page.css").read_text(encoding="utf-8")
    light, dark = (
        dict(re.findall(r"--c-(\w{6}): #(\w{6})", part)) for part in css.split("prefers-color-scheme: dark", 1)
    )

    def contrast(colours, name):
        def luminance(text):
            srgb = np.array([int(text[i : i + 2], 16) for i in (0, 2, 4)]) / 255
            linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
            return float(linear @ (0.2126, 0.7152, 0.0722)) + 0.05

        one, paper = luminance(colours[name]), luminance(colours["ffffff"])
        return max(one, paper) / min(one, paper)

    for colour in (*style._SERIES, style.PRIOR):
        name = colour[1:].lower()
        assert contrast(dark, name) >= min(3.0, contrast(light, name)), colour


DEPTH = 3


def parts(value, depth=DEPTH):
    """A result and all public results that it holds, with the way to each; arrays show themselves as NumPy does."""
    if depth < DEPTH and isinstance(value, bi.Posterior):
        return  # as the one at the top
    yield "", value
    if depth == 0:
        return
    if isinstance(value, dict | tuple):
        for key in list(value)[:2] if isinstance(value, dict) else range(min(2, len(value))):
            yield from ((f"[{key!r}]{way}", x) for way, x in parts(value[key], depth - 1))
    elif type(value).__module__.startswith("bayes_iwan."):
        names = [f.name for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
        if depth == DEPTH:  # what a result computes when asked for it
            names += [n for n, x in inspect.getmembers(type(value)) if isinstance(x, property | cached_property)]
        for name in names:
            if not name.startswith("_"):
                yield from ((f".{name}{way}", x) for way, x in parts(getattr(value, name), depth - 1))


def test_every_result_and_what_it_holds_fits_a_screen(results):
    """24 lines of 120 characters, and a notebook's table where there are several."""
    seen, bad = set(), []
    for root, result in results.items():
        for way, x in parts(result):
            arrays = isinstance(x, tuple) and all(isinstance(y, np.ndarray | float | int) for y in x)
            if arrays or isinstance(x, np.ndarray | str) or id(x) in seen:
                continue
            seen.add(id(x))
            lines = repr(x).splitlines() or [""]
            if len(lines) > 24 or max(map(len, lines)) > 120 or (len(lines) > 1 and not hasattr(x, "_repr_html_")):
                bad.append(f"{root}{way}: {type(x).__name__}, {len(lines)} lines, {max(map(len, lines))} characters")
    assert not bad, "\n".join(bad)
    assert len(seen) > 300


SORTED = """
const table = document.querySelector("table.sortable"), heads = Array.from(table.tHead.rows[0].cells), out = {};
const column = (i) => Array.from(table.tBodies[0].rows, (r) => r.cells[i].textContent.trim());
for (const [i, head] of heads.entries()) {
  const clicks = [column(i)];
  for (let k = 0; k < 2; k++) {
    head.querySelector("button").click();
    clicks.push(column(i), head.getAttribute("aria-sort"));
  }
  out[head.textContent.trim()] = clicks;
}
return [out, document.querySelectorAll("[aria-sort]").length];
"""


def test_a_click_on_a_column_of_the_batch_sorts_by_it(pages, chromium):
    chromium.open(pages / "batch.html")
    found, marked = chromium.done(SORTED)
    assert marked == 1 and len(found) >= 5
    for name, (before, up, ascending, down, descending) in found.items():
        assert (ascending, descending) == ("ascending", "descending"), name
        assert sorted(before) == sorted(up) == sorted(down)
        first = [re.match(r"[−-]?[\d.]+", x) for x in up]
        keys = [float(x[0].replace("−", "-")) if x else -np.inf for x in first] if any(first) else up
        assert keys == sorted(keys), (name, up)
        assert [keys[up.index(x)] for x in down] == sorted(keys, reverse=True), (name, down)


SWITCHED = """
const get = (id) => document.getElementById(id), wait = (ms) => new Promise((done) => setTimeout(done, ms));
const seen = () => ({ drawn: JSON.parse(get("v-plot").dataset.drawn), read: get("v-read").textContent });
const picture = () => get("v-plot").querySelector("canvas").toDataURL();
get("v-what").value = "total";
get("v-what").dispatchEvent(new Event("change", { bubbles: true }));
const out = { on: seen() };
document.querySelectorAll(".v-effect").forEach((e) => e.click());
out.off = seen();
document.querySelectorAll(".v-effect").forEach((e) => e.click());
out.again = seen();
await wait(50);
const over = get("v-plot").querySelector(".u-over"), r = over.getBoundingClientRect(), whole = picture();
const at = (type, x, y, to) => to.dispatchEvent(new MouseEvent(type, { bubbles: true, button: 0, buttons: 1,
  movementX: 9, movementY: 9, clientX: r.left + x * r.width, clientY: r.top + y * r.height }));
at("mouseenter", 0.3, 0.3, over);
at("mousedown", 0.3, 0.3, over);
at("mousemove", 0.7, 0.7, over);
await wait(50);
at("mouseup", 0.7, 0.7, over);
await wait(100);
out.zoomed = picture() !== whole;
get("v-whole").click();
get("v-phase").value = 0;
get("v-phase").dispatchEvent(new Event("input"));
await wait(100);
out.back = picture() === whole;
return out;
"""


def test_an_effect_is_switched_and_a_loop_zoomed(pages, chromium):
    """The model without its effects is what the diagnosis predicts, drawn beside none; a drag shows a part of it."""
    page = pages / "diagnosis.html"
    chromium.open(page)
    found = chromium.done(SWITCHED)
    data = re.search(r'id="viewer-data">(.*?)</script>', page.read_text(encoding="utf-8"), re.S)
    first = json.loads(data.group(1))["tests"][0]["sets"]
    assert found["on"] == found["again"] and found["zoomed"] and found["back"]
    assert found["on"]["drawn"]["alone"] == 1 and found["off"]["drawn"]["alone"] == 0
    for state, force in (("on", first[-1]), ("off", first[0])):
        predicted = re.search(r"predicted (\S+) N", found[state]["read"]).group(1).replace("−", "-")
        assert float(predicted) == pytest.approx(force[0], abs=6e-4)
    assert found["on"]["read"] != found["off"]["read"]


def test_what_is_cut_would_be_seen(chromium, tmp_path):
    page = Page("cut")
    page.section("Wide").html(Markup("<p>Words.</p>"))
    path = page.write(tmp_path / "cut.html")
    wide = '<main><div style="width:600px;height:9px">wide</div><div style="width:99px;overflow:hidden">'
    path.write_text(path.read_text().replace("<main", wide + "<p style=width:300px>hidden</p></div></main><main", 1))
    found = cut_elements(path, chromium, (390, 1280))
    assert any("sticks out: DIV" in x for x in found["390"]) and any("cut: DIV" in x for x in found["390"])
    assert not any("sticks out" in x for x in found["1280"]) and any("cut: DIV" in x for x in found["1280"])


@pytest.mark.usefixtures("chromium")
def test_pdf_is_the_report(page):
    from pypdf import PdfReader

    text = " ".join(" ".join(x.extract_text() for x in PdfReader(page / "report.pdf").pages).split())
    assert "What is not known" in text and "Priors used" in text and "Loop viewer" not in text


def test_without_a_browser_a_pdf_is_refused_before_work(posterior, tmp_path, monkeypatch):
    monkeypatch.setenv("BAYES_IWAN_BROWSER", str(tmp_path / "none"))
    assert find_browser() is None
    with pytest.raises(BrowserError, match="Chromium, Chrome or Edge"):
        identification_report(posterior, tmp_path / "out", pdf=True)
    assert not (tmp_path / "out").exists()


def test_the_unusual_specimen_comes_first_and_lots_are_compared(specimens):
    assert specimens.unusual[0].name.endswith("_5") and "mean_slip_force_N" in specimens.unusual[0].notable
    assert {(d.a, d.b) for d in specimens.differences()} == {("A", "B")}
    for found in specimens.differences():  # both lots' errors are in the ratio, which one seed's draws would cancel
        draws = [specimens.lot_populations[k][found.quantity].typical_draws for k in "AB"]
        wide = [float(np.diff(np.quantile(np.log(x), [0.05, 0.95]))[0]) for x in draws]
        assert np.log(found.high / found.low) == pytest.approx(np.hypot(*wide), rel=0.2)
    table = specimens.table()
    assert all(len(row) == len(table.columns) for row in table.rows)
