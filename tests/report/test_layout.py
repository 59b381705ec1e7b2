"""Every kind of page at four widths and in print: nothing is cut, nothing sticks out, no heading without its text."""

import shutil

import numpy as np
import pytest
from markupsafe import Markup

import bayes_iwan as bi
from bayes_iwan.report.batch.batch_page import write_batch_page
from bayes_iwan.report.batch.specimens import Finished, Quantity, summarised
from bayes_iwan.report.browser import BrowserError, find_browser, print_pdf
from bayes_iwan.report.identification.identification_page import identification_report
from bayes_iwan.report.inspection.inspect_page import inspect_to
from bayes_iwan.report.page import Page, of_folder

from .layout import BROWSER, NO_BROWSER, WIDTHS, cut_elements, torn

needs_browser = pytest.mark.skipif(BROWSER is None, reason=NO_BROWSER)
SHORT = {
    "search": {"members": 40, "evaluations": 400, "starts": 2, "second_search": False},
    "sampling": {"ensembles": 2, "budget_s": 2.0, "draws": 200},
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
def pages(page, specimens, made_up_campaign, tmp_path_factory):
    """A folder with every kind of page."""
    out = tmp_path_factory.mktemp("pages")
    shutil.copy(page / "report.html", out)
    inspect_to(made_up_campaign, out)
    campaign = bi.demo(out / "demo")
    bi.diagnose(campaign.path, out, quick=True, seed=1, config=CLASSICAL)
    bi.compare(campaign, out, families=["uniform", "gamma1"], config=SHORT, by="tests", seed=1, progress=False)
    write_batch_page(specimens, out, of_folder(out, 1))
    return out


@needs_browser
@pytest.mark.parametrize("name", ["report", "inspect", "batch", "diagnosis", "compare"])
def test_nothing_is_cut_at_any_width_nor_in_print(pages, tmp_path, name):
    html = pages / f"{name}.html"
    found = cut_elements(html, tmp_path)
    assert found == {str(width): [] for width in WIDTHS}
    assert torn(html, print_pdf(html, tmp_path / "page.pdf")) == []
    assert html.stat().st_size < 3_000_000
    assert str(pages.parent) not in html.read_text(encoding="utf-8"), "a local path reached the page"


@needs_browser
def test_what_is_cut_would_be_seen(tmp_path):
    page = Page("cut")
    page.section("Wide").html(Markup("<p>Words.</p>"))
    path = page.write(tmp_path / "cut.html")
    wide = '<main><div style="width:600px;height:9px">wide</div><div style="width:99px;overflow:hidden">'
    path.write_text(path.read_text().replace("<main", wide + "<p style=width:300px>hidden</p></div></main><main", 1))
    found = cut_elements(path, tmp_path, (390, 1280))
    assert any("sticks out: DIV" in x for x in found["390"]) and any("cut: DIV" in x for x in found["390"])
    assert not any("sticks out" in x for x in found["1280"]) and any("cut: DIV" in x for x in found["1280"])


@needs_browser
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
    assert len(repr(specimens).splitlines()) < 25
