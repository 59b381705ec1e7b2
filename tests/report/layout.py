"""Pages in Chromium at several widths and in print: what is cut, sticks out, or is torn from its heading."""

from __future__ import annotations

import html
import json
import re
import unicodedata
from collections.abc import Iterable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from .chromium import Chromium

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


WIDTHS = (390, 768, 1280, 1400)

# a page in a frame, drawn
_SHOWN = """
async function shown(html, width) {
  const frame = document.createElement("iframe");
  frame.style.cssText = "border:0;height:1200px;width:" + width + "px";
  frame.srcdoc = html;
  await new Promise((done) => { frame.onload = done; document.body.appendChild(frame); });
  await drawn();
  return frame;
}
const drawn = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
"""
# every width is a frame of its own, so that media queries hold
_CUT = (
    _SHOWN
    + """
const html = %s, widths = %s, scrolled = %s, found = {};
const SMALLEST = 8.9, BEYOND = 4; // px of a figure's letters on a phone, and of what of them may stick out of it
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
    if (e.tagName === "text" && e.ownerSVGElement) {
      const q = e.ownerSVGElement.getBoundingClientRect();
      if (Math.max(q.left - r.left, r.right - q.right, q.top - r.top, r.bottom - q.bottom) > BEYOND)
        say("text beyond its figure", e);
    }
    if (width < 500 && e.tagName === "text" && e.ownerSVGElement && e.textContent.trim()) {
      const svg = e.ownerSVGElement, scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
      if (parseFloat(style.fontSize) * scale < SMALLEST) say("letters too small to read", e);
    }
    for (const node of e.matches("td, td *, th, th *") ? e.childNodes : []) {
      for (const word of node.nodeType === 3 ? node.data.matchAll(/(?<!\\S)[^\\s\\/_.–-]{1,14}(?!\\S)/g) : []) {
        const range = doc.createRange();
        range.setStart(node, word.index);
        range.setEnd(node, word.index + word[0].length);
        if (range.getClientRects().length > 1) say("a word torn in two, " + word[0], e);
      }
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
for (const width of widths) {
  const frame = await shown(html, width);
  found[width] = cut(frame.contentDocument, frame.contentWindow.innerWidth);
  frame.remove();
}
return found;
"""
)


# every page in a frame as tall as it is; of each text its contrast with what lies beneath it, figures' shapes included
_PALE = (
    _SHOWN
    + """
const pages = %s, found = {}, LEAST = 4.5; // WCAG 2.2, 1.4.3
const rgba = (text) => [...(text.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number), 1].slice(0, 4);
const over = (top, under) => top.slice(0, 3).map((x, i) => x * top[3] + under[i] * (1 - top[3])).concat(1);
const linear = (x) => x / 255 <= 0.04045 ? x / 255 / 12.92 : ((x / 255 + 0.055) / 1.055) ** 2.4;
const light = (c) => 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]) + 0.05;
const contrast = (a, b) => Math.max(light(a) / light(b), light(b) / light(a));
function pale(doc) {
  const bad = [], style = (e) => doc.defaultView.getComputedStyle(e), paper = rgba(style(doc.body).backgroundColor);
  const clear = (e) => e === doc.body ? 1 : +style(e).opacity * clear(e.parentElement);
  const filled = (e) => { // what an element covers its place with
    if (!e.ownerSVGElement) return rgba(style(e).backgroundColor);
    const s = style(e), c = s.fill.startsWith("rgb") && e.tagName !== "text" ? rgba(s.fill) : [0, 0, 0, 0];
    return [c[0], c[1], c[2], c[3] * s.fillOpacity * clear(e)];
  };
  for (const d of doc.querySelectorAll("details")) d.open = true;
  const walker = doc.createTreeWalker(doc.body, NodeFilter.SHOW_TEXT), range = doc.createRange();
  while (walker.nextNode()) {
    const node = walker.currentNode, e = node.parentElement;
    if (!node.data.trim() || e.closest("script, style, title, .skip")) continue;
    range.selectNodeContents(node);
    const r = range.getBoundingClientRect(), s = style(e);
    if (!r.width || s.visibility === "hidden") continue;
    const own = rgba(e.ownerSVGElement ? s.fill : s.color);
    own[3] *= clear(e);
    let least = Infinity;
    for (const share of [0.1, 0.5, 0.9]) {
      const stack = doc.elementsFromPoint(r.left + share * r.width, r.top + 0.5 * r.height), at = stack.indexOf(e);
      const under = stack.slice(at + 1).map(filled), whole = under.findIndex((c) => c[3] > 0.999);
      const back = (whole < 0 ? under : under.slice(0, whole + 1)).reduceRight((b, c) => over(c, b), paper);
      least = Math.min(least, contrast(over(own, back), back));
    }
    if (least < LEAST) bad.push(least.toFixed(2) + ": " + node.data.trim().slice(0, 60));
  }
  return bad;
}
for (const [name, html] of Object.entries(pages)) {
  const frame = await shown(html, 1280);
  for (const d of frame.contentDocument.querySelectorAll("details")) d.open = true;
  frame.style.height = frame.contentDocument.documentElement.scrollHeight + "px";
  await drawn();
  found[name] = pale(frame.contentDocument);
  frame.remove();
}
return found;
"""
)


def _found(script: str, given: tuple[object, ...], chromium: Chromium, dark: bool = False) -> Any:
    """What a script with what it is given returns from an empty page."""
    blank = chromium.folder / "blank.html"
    blank.write_text("<!DOCTYPE html><body>", encoding="utf-8")
    chromium.open(blank, 1500, 1300, dark)
    return chromium.done(script % tuple(map(json.dumps, given)))


def _source(page: Path) -> str:
    """A page's text as a frame takes it, with what it links to found."""
    return page.read_text(encoding="utf-8").replace("<head>", f'<head><base href="{page.parent.as_uri()}/">', 1)


def cut_elements(
    page: Path, chromium: Chromium, widths: tuple[int, ...] = WIDTHS, scrolled: int = 10_000
) -> dict[str, list[str]]:
    """What is cut or sticks out of a page, a list for each width in px; below `scrolled` px tables may scroll."""
    return _found(_CUT, (_source(page), widths, scrolled), chromium)


def pale_texts(pages: Iterable[Path], chromium: Chromium, dark: bool) -> dict[str, list[str]]:
    """Texts whose contrast with what they stand on is below 4.5, a list for each page."""
    return _found(_PALE, ({p.name: _source(p) for p in pages},), chromium, dark)


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
