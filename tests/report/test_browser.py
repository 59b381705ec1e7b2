"""The page in a real browser: it loads without an error or an outside request, and its controls do what they say."""

from __future__ import annotations

import re

import pytest
from pypdf import PdfReader

from bayes_iwan.report.browser import print_pdf
from bayes_iwan.report.identification.predictive import predict

from .chromium import BROWSER, NO_BROWSER

pytestmark = [pytest.mark.usefixtures("no_figure_files"), pytest.mark.skipif(BROWSER is None, reason=NO_BROWSER)]

# runs in the page after its own scripts
CHECK = """
  const get = (id) => document.getElementById(id), out = { errors: window.pageErrors, tests: [],
    resources: performance.getEntriesByType("resource").map((e) => e.name).filter((n) => !n.startsWith("data:")) };
  const set = (id, value) => { get(id).value = value; get(id).dispatchEvent(new Event("change", { bubbles: true })); };
  const tick = (id, on) => { if (get(id).checked !== on) get(id).click(); };
  const drawn = () => JSON.parse(get("v-plot").dataset.drawn);
  for (const option of get("v-test").options) {
    set("v-test", option.value);
    const one = { name: option.textContent.trim() };
    for (const what of ["friction", "total", "residual"]) {
      set("v-what", what);
      for (const model of ["bands", "draws", "median"]) { set("v-model", model); one[what + " " + model] = drawn(); }
      tick("v-cycles", false); tick("v-average", false); one[what + " none"] = drawn();
      tick("v-cycles", true); tick("v-average", true);
      get("v-phase").value = 32; get("v-phase").dispatchEvent(new Event("input"));
      one[what + " reading"] = get("v-read").textContent;
      one[what + " title"] = get("v-plot").getAttribute("aria-label");
      // pointed at, once the plot stands: the reading follows the pointer
      await new Promise((done) => setTimeout(done, 20));
      const over = get("v-plot").querySelector(".u-over"), r = over.getBoundingClientRect();
      const at = { bubbles: true, clientX: r.left + 0.1 * r.width, clientY: r.top + 0.8 * r.height };
      over.dispatchEvent(new MouseEvent("mouseenter", at));
      over.dispatchEvent(new MouseEvent("mousemove", at));
      one[what + " pointed"] = +get("v-phase").value;
    }
    out.tests.push(one);
  }
  out.focusable = ["v-test", "v-what", "v-model", "v-cycles", "v-average", "v-phase"].every((id) => {
    if (get(id).disabled) return true;
    get(id).focus();
    return document.activeElement === get(id) && (get(id).labels || []).length === 1;
  });
  return out;
"""
EARLY = """
window.pageErrors = [];
window.onerror = (message) => { window.pageErrors.push(String(message)); };
document.addEventListener("securitypolicyviolation", (e) => window.pageErrors.push("asked for " + e.blockedURI));
"""


@pytest.fixture(scope="module")
def seen(page, chromium):
    chromium.open(page / "report.html", 1200, 900, early=EARLY)
    return chromium.done(CHECK), chromium.said


def test_no_error_and_nothing_from_outside(seen):
    found, said = seen
    assert found["errors"] == found["resources"] == said == []


def test_an_outside_request_would_be_seen(page, chromium, tmp_path):
    text = (page / "report.html").read_text(encoding="utf-8")
    path = tmp_path / "bad.html"
    path.write_text(text.replace("</body>", '<img src="https://example.org/a.png"></body>'), encoding="utf-8")
    chromium.open(path, early=EARLY)
    found = chromium.done(CHECK.replace('get("v-test").options', "[]"))
    assert found["resources"] == ["https://example.org/a.png"] and found["errors"] and chromium.said


def test_viewer_draws_every_test_in_every_way(seen, posterior):
    found, _ = seen
    assert len(found["tests"]) == len(posterior.loops)
    for one in found["tests"]:
        for what in ("friction", "total", "residual"):
            cycles = 0 if what == "residual" else 8
            usual = {"cycles": cycles, "average": 1, "bands": 0, "draws": 0, "alone": 0}
            assert one[f"{what} bands"] == usual | {"bands": 2}
            assert one[f"{what} draws"] == usual | {"draws": 16}
            assert one[f"{what} median"] == usual
            assert one[f"{what} none"] == usual | {"cycles": 0, "average": 0}
            assert one[f"{what} pointed"] != 32
            assert re.search(r"phase 0\.250: u = .* mm, measured .* N, .*residual .* N", one[f"{what} reading"])
            assert one["name"] in one[f"{what} title"]


def test_reading_is_the_posterior_s(seen, posterior):
    found, _ = seen
    loop = posterior.loops[0]
    shown = re.search(r"measured (\S+) N", found["tests"][0]["total reading"]).group(1).replace("\u2212", "-")
    zero = float(predict(posterior, n=400).zero_N[0])
    assert float(shown) == pytest.approx(loop.force_N[32] - zero, abs=2e-3)


def test_controls_take_the_keyboard(seen):
    found, _ = seen
    assert found["focusable"]


def test_printed_it_is_text_answer_first(page, tmp_path):
    """A customer prints the page: words, figures' texts among them, can be searched and copied."""
    pages = [one.extract_text() for one in PdfReader(print_pdf(page / "report.html", tmp_path / "p.pdf")).pages]
    assert "Answer" in pages[0] and "largest gap" in pages[0]
    whole = " ".join(" ".join(pages).split())
    for words in ("parallel spring", "friction force (N)", "10 Hz, 0.4 mm", "What is not known", "Methods"):
        assert words in whole, words
