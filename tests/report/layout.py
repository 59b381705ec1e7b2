"""Pages in Chromium at several widths and in print: what is cut, sticks out, or is torn from its heading."""

from __future__ import annotations

import html
import json
import re
import subprocess
import unicodedata
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from bayes_iwan.report.browser import OPTIONS, find_browser

VOID = {"meta", "link", "br", "input", "img", "path", "circle", "use", "hr"}


class Outline(HTMLParser):
    """Ids, headings (levels, and texts of the second), pictures, controls, links and outside references of a page, and
    whether its tags close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids, self.headings, self.titles, self.open, self.pictures, self.controls = [], [], [], [], [], []
        self.links, self.outside = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        a = dict(attrs)
        self.ids += [v for k, v in attrs if k == "id" or (k, tag) == ("name", "a")]
        self.headings += [int(tag[1])] if re.fullmatch(r"h[1-6]", tag) else []
        references = [v for k, v in attrs if k in ("src", "href", "xlink:href", "action") and v]
        self.outside += [x for x in references if not x.startswith(("#", "data:"))]
        self.links += references if tag in ("a", "link", "img", "script") else []
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

    def handle_data(self, data):
        if self.open[-1:] == ["h2"]:
            self.titles.append(data.strip())


def visible(page: str) -> str:
    """A page's words as a reader sees them, figures' texts included; scripts, styles and pictures left out."""
    page = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.S)
    return html.unescape(re.sub(r"<[^>]+>", " ", page))


BROWSER = find_browser()
NO_BROWSER = "no Chromium here; to run these tests: apt-get update && apt-get install -y chromium"
WIDTHS = (390, 768, 1280, 1400)

# every width is a frame of its own, so that media queries hold; what is found goes into an element for --dump-dom
_WRAPPER = """<!DOCTYPE html><meta charset="utf-8"><body><script>
const html = %s, widths = %s, scrolled = %s, found = {}, SMALLEST = 8.9; // px of a figure's letters on a phone
function cut(doc, width) {
  const bad = [], view = doc.defaultView, say = (why, e) => bad.push(why + ": " + e.tagName + "." +
    (e.getAttribute("class") || "") + " " + (e.textContent || "").trim().slice(0, 60));
  for (const d of doc.querySelectorAll("details")) d.open = true;
  for (const e of doc.querySelectorAll("body *")) {
    const r = e.getBoundingClientRect(), style = view.getComputedStyle(e);
    if (!r.width || !r.height || e.closest(".skip, .wy-nav-side") || style.visibility === "hidden") continue;
    if (e.closest("math")) continue; // a wide formula is scrolled
    const scroll = e.closest(".scroll"),
      table = width > 700 && width < scrolled && scroll && scroll.querySelector("table");
    if (e.closest("svg, canvas, .u-over") && !["text", "svg", "canvas"].includes(e.tagName.toLowerCase())) continue;
    if (!(table && e !== scroll) && (r.right > width + 1 || r.left < -1)) say("sticks out", e);
    if (style.overflowX !== "visible" && !(table && e === scroll) && e.scrollWidth > e.clientWidth + 1 &&
      !["select", "input"].includes(e.tagName.toLowerCase()) && !e.closest(".uplot")) say("cut", e);
    if (width < 500 && e.tagName === "text" && e.ownerSVGElement && e.textContent.trim()) {
      const svg = e.ownerSVGElement, scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
      if (parseFloat(style.fontSize) * scale < SMALLEST) say("letters too small to read", e);
    }
    if (["svg", "img"].includes(e.tagName.toLowerCase())) {
      for (let p = e.parentElement; p && p !== doc.body; p = p.parentElement) {
        const q = p.getBoundingClientRect();
        if (r.right > q.right + 1.5 || r.left < q.left - 1.5) { say("wider than what holds it", e); break; }
      }
    }
  }
  return bad;
}
(async function () {
  for (const width of widths) {
    const frame = document.createElement("iframe");
    frame.style.cssText = "border:0;height:1200px;width:" + width + "px";
    frame.srcdoc = html;
    await new Promise((done) => { frame.onload = done; document.body.appendChild(frame); });
    await new Promise((done) => setTimeout(done, 100));
    found[width] = cut(frame.contentDocument, frame.contentWindow.innerWidth);
    frame.remove();
  }
  const out = document.createElement("pre");
  out.id = "found";
  out.textContent = JSON.stringify(found);
  document.body.appendChild(out);
})();
</script></body>"""


def run_browser(page: Path | str, profile: Path, *options: str) -> tuple[str, str]:
    """Run Chromium on a local file or an address; returns its stdout and stderr."""
    command = [str(BROWSER), *OPTIONS, f"--user-data-dir={profile}", "--enable-logging=stderr"]
    command += ["--virtual-time-budget=20000", *options, page if isinstance(page, str) else page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    return run.stdout, run.stderr


def cut_elements(
    page: Path, folder: Path, widths: tuple[int, ...] = WIDTHS, scrolled: int = 10_000
) -> dict[str, list[str]]:
    """What is cut or sticks out of a page, a list for each width in px; below `scrolled` px tables may scroll."""
    text = page.read_text(encoding="utf-8").replace("<head>", f'<head><base href="{page.parent.as_uri()}/">', 1)
    source = json.dumps(text).replace("<", "\\u003c")
    wrapper = folder / f"{page.stem}_wrapped.html"
    wrapper.write_text(_WRAPPER % (source, json.dumps(widths), scrolled), encoding="utf-8")
    out, err = run_browser(wrapper, folder / "profile", "--dump-dom", "--window-size=1500,1300")
    found = re.search(r'<pre id="found">(.*?)</pre>', out, re.S)
    assert found, err[-2000:]
    return json.loads(html.unescape(found.group(1)))


def printed(pdf: Path) -> list[list[tuple[str, float, float]]]:
    """Texts of each page of a PDF with their place from the left and from the bottom edge as shares of the page."""
    from pypdf import PdfReader

    pages = []
    for page in PdfReader(pdf).pages:
        texts: list[tuple[str, float, float]] = []
        wide, tall = float(page.mediabox.width), float(page.mediabox.height)

        def visit(text: Any, cm: Any, tm: Any, font: Any, size: Any, to=texts, w=wide, h=tall) -> None:
            if text.strip():
                x = tm[4] * cm[0] + tm[5] * cm[2] + cm[4]
                y = tm[4] * cm[1] + tm[5] * cm[3] + cm[5]
                to.append((text.strip(), x / w, y / h))

        page.extract_text(visitor_text=visit)
        pages.append(texts)
    return pages


def _squeezed(text: str) -> str:
    """Letters, digits and brackets alone: a PDF spells spaces, ligatures and rarer signs in its own way."""
    return re.sub(r"[^A-Za-z0-9_\[\]]", "", unicodedata.normalize("NFKD", text))


def torn(page: Path, pdf: Path) -> list[str]:
    """Headings that end a printed page, texts beyond a page's edge, and figures whose caption stands on another page
    than they do."""
    whole, bad = page.read_text(encoding="utf-8"), []
    pages = printed(pdf)
    squeezed = [_squeezed("".join(t for t, _, _ in texts)) for texts in pages]
    for number, texts in enumerate(pages, 1):
        bad += [f"page {number}: {t[:40]} beyond the edge" for t, x, y in texts if not (0 <= x <= 1 and 0 <= y <= 1)]
    for heading in re.findall(r"<h[23][^>]*>(.*?)</h[23]>", whole, re.S):
        said = _squeezed(html.unescape(heading))
        if any(text.endswith(said) for text in squeezed[:-1]):
            bad.append(f"{heading}: ends a page")
    printable = re.sub(r'<div class="picture phone">.*?</div>', "", whole, flags=re.S)
    for svg, name in re.findall(
        r"<figure>(?:(?!</figure>).)*?(<svg.*?</svg>).*?\[([a-z_0-9]+)\]</span>", printable, re.S
    ):
        words = [_squeezed(html.unescape(w)) for w in re.findall(r"<text[^>]*>([^<]{6,})</text>", svg)]
        here = [text for text in squeezed if f"[{name}]" in text]
        if not here:
            bad.append(f"{name}: not printed")
        elif missing := [w for w in words if w not in here[0]]:
            bad.append(f"{name}: not whole beside its caption ({len(missing)} of {len(words)} texts: {missing[0]})")
    return bad
