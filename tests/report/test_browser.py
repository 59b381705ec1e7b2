"""The page in a real browser: it loads without an error or an outside request, and its controls do what they say."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess

import pytest
from pypdf import PdfReader

from bayes_iwan.report import predict

BROWSER = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
pytestmark = [
    pytest.mark.usefixtures("no_figure_files"),
    pytest.mark.skipif(
        BROWSER is None, reason="no Chromium here; to run these tests: apt-get update && apt-get install -y chromium"
    ),
]

# runs in the page after its own scripts; what it finds goes into an element that --dump-dom brings back
CHECK = """
<script>
(function () {
  const get = (id) => document.getElementById(id), out = { errors: window.pageErrors, tests: [],
    resources: performance.getEntriesByType("resource").map((e) => e.name).filter((n) => !n.startsWith("data:")) };
  const set = (id, value) => { get(id).value = value; get(id).dispatchEvent(new Event("change", { bubbles: true })); };
  const tick = (id, on) => { if (get(id).checked !== on) get(id).click(); };
  const paths = () => get("v-plot").querySelectorAll("path").length;
  const lines = (stroke) => get("v-plot").querySelectorAll('path[stroke="' + stroke + '"]').length;
  const bands = () => get("v-plot").querySelectorAll(".band").length;
  for (const option of get("v-test").options) {
    set("v-test", option.value);
    const one = { name: option.textContent.trim() };
    for (const what of ["friction", "total", "residual"]) {
      set("v-what", what);
      set("v-model", "bands"); one[what + " bands"] = bands();
      tick("v-cycles", true); const grey = lines("#9a9a9a"), black = lines("#000");
      tick("v-cycles", false); one[what + " cycles"] = grey - lines("#9a9a9a"); tick("v-cycles", true);
      tick("v-average", false); one[what + " average"] = black - lines("#000"); tick("v-average", true);
      set("v-model", "draws"); one[what + " draws"] = [bands(), paths()];
      set("v-model", "median"); one[what + " median"] = [bands(), paths()];
      get("v-phase").value = 32; get("v-phase").dispatchEvent(new Event("input"));
      one[what + " reading"] = get("v-read").textContent;
      one[what + " title"] = get("v-plot").querySelector("title").textContent;
      const box = get("v-plot").getBoundingClientRect();
      one[what + " inside"] = Array.from(get("v-plot").querySelectorAll("text")).every((t) => {
        const r = t.getBoundingClientRect();
        return r.left >= box.left - 1 && r.right <= box.right + 1 && r.top >= box.top - 1 && r.bottom <= box.bottom + 1;
      });
    }
    out.tests.push(one);
  }
  out.focusable = ["v-test", "v-what", "v-model", "v-cycles", "v-average", "v-phase"].every((id) => {
    if (get(id).disabled) return true;
    get(id).focus();
    return document.activeElement === get(id) && (get(id).labels || []).length === 1;
  });
  document.documentElement.style.width = "390px";      // a phone's width: nothing may stick out but what scrolls
  out.wide = Array.from(document.querySelectorAll("body *")).filter((e) => {
    const r = e.getBoundingClientRect();
    return r.width > 0 && r.right > 392 && !e.closest(".scroll") && !e.closest(".skip") && !e.closest("nav");
  }).map((e) => e.tagName + "." + e.className).slice(0, 5);
  const found = document.createElement("pre");
  found.id = "found";
  found.textContent = JSON.stringify(out);
  document.body.appendChild(found);
})();
</script>
"""
EARLY = """
<script>
window.pageErrors = [];
window.onerror = (message) => { window.pageErrors.push(String(message)); };
document.addEventListener("securitypolicyviolation", (e) => window.pageErrors.push("asked for " + e.blockedURI));
</script>
"""


def open_to_scripts(html):
    """The page with a policy that lets this file's scripts in beside the page's own; the rest of it stands."""
    text, n = re.subn(r"script-src [^;]+", "script-src 'unsafe-inline'", html)
    assert n == 1
    return text


def browse(path, folder, *options):
    """Run Chromium on a local file; returns its stdout and stderr."""
    run = subprocess.run(
        [
            str(BROWSER),
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-component-update",
            "--disable-background-networking",
            "--no-first-run",
            f"--user-data-dir={folder / 'profile'}",
            "--enable-logging=stderr",
            "--virtual-time-budget=20000",
            *options,
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env={**os.environ, "LC_ALL": "C.UTF-8"},
    )
    return run.stdout, run.stderr


@pytest.fixture(scope="module")
def seen(page, tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    text = open_to_scripts((page / "report.html").read_text(encoding="utf-8"))
    path = folder / "report.html"
    path.write_text(text.replace("<head>", "<head>" + EARLY, 1).replace("</body>", CHECK + "</body>"), encoding="utf-8")
    out, err = browse(path, folder, "--dump-dom", "--window-size=1200,900")
    found = re.search(r'<pre id="found">(.*?)</pre>', out, re.S)
    assert found, err[-2000:]
    text = found.group(1)
    for code, sign in (("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")):
        text = text.replace(code, sign)
    return json.loads(text), err


def test_no_error_and_nothing_from_outside(seen):
    found, err = seen
    assert found["errors"] == []
    assert found["resources"] == []
    assert "CONSOLE" not in err, [line for line in err.splitlines() if "CONSOLE" in line]


def test_an_outside_request_would_be_seen(page, tmp_path):
    text = open_to_scripts((page / "report.html").read_text(encoding="utf-8"))
    path = tmp_path / "bad.html"
    check = CHECK.replace('get("v-test").options', "[]")
    path.write_text(
        text.replace("<head>", "<head>" + EARLY, 1).replace(
            "</body>", '<img src="https://example.org/a.png">' + check + "</body>"
        ),
        encoding="utf-8",
    )
    out, _ = browse(path, tmp_path, "--dump-dom")
    assert '"resources":["https://example.org/a.png"]' in out


def test_viewer_draws_every_test_in_every_way(seen, posterior):
    found, _ = seen
    assert len(found["tests"]) == len(posterior.loops)
    for one in found["tests"]:
        for what in ("friction", "total", "residual"):
            assert one[f"{what} bands"] == 2
            assert one[f"{what} cycles"] == (0 if what == "residual" else 8)
            assert one[f"{what} average"] == 1
            assert one[f"{what} draws"][0] == 0 and one[f"{what} draws"][1] > one[f"{what} median"][1] + 10
            assert one[f"{what} median"][0] == 0
            assert re.search(r"phase 0\.250: u = .* mm, measured .* N, .*residual .* N", one[f"{what} reading"])
            assert one["name"] in one[f"{what} title"]
            assert one[f"{what} inside"]


def test_reading_is_the_posterior_s(seen, posterior):
    found, _ = seen
    loop = posterior.loops[0]
    shown = re.search(r"measured (\S+) N", found["tests"][0]["total reading"]).group(1).replace("\u2212", "-")
    zero = float(predict(posterior, n=400).zero_N[0])
    assert float(shown) == pytest.approx(loop.force_N[32] - zero, abs=2e-3)


def test_controls_take_the_keyboard_and_fit_a_phone(seen):
    found, _ = seen
    assert found["focusable"]
    assert found["wide"] == []


def test_printed_it_is_text_answer_first(page, tmp_path):
    """A customer prints the page: words, figures' texts among them, can be searched and copied."""
    browse(page / "report.html", tmp_path, f"--print-to-pdf={tmp_path / 'p.pdf'}", "--no-pdf-header-footer")
    pages = [one.extract_text() for one in PdfReader(tmp_path / "p.pdf").pages]
    assert "Answer" in pages[0] and "parallel spring" in pages[0] and "mean slip force" in pages[0]
    whole = " ".join(" ".join(pages).split())
    for words in ("friction force (N)", "relative normal force α", "10 Hz, 0.4 mm", "What is not known"):
        assert words in whole, words
