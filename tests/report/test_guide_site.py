"""The guide's site: it is built, its links lead somewhere, and a browser shows it whole at every width and in print."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from .layout import WIDTHS, Outline, cut_elements, torn

GUIDE = Path(__file__).parents[2] / "analyses" / "guide"
if not GUIDE.is_dir():
    pytest.skip("the guide is not part of this installation", allow_module_level=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs")
    out = tmp_path_factory.mktemp("guide") / "site"
    command = [sys.executable, "-W", "error::UserWarning", str(GUIDE / "build.py"), "--out", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(GUIDE.parents[1]), "MPLBACKEND": "Agg"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return out


def test_links_lead_somewhere_and_nothing_is_loaded_from_outside(site):
    pages = {p: Outline(p.read_text(encoding="utf-8")) for p in site.glob("*.html")}
    assert len(pages) >= len([*GUIDE.glob("*.md")])
    for page, links in pages.items():
        if page.name == "404.html":
            continue  # made for a server's root
        for link in links.links:
            path, _, name = link.partition("#")
            if not link or re.match(r"[a-z]+:", path):
                continue
            target = page if not path else (page.parent / path)
            assert target.exists(), f"{page.name}: {link}"
            if name and target in pages:
                assert name in pages[target].ids, f"{page.name}: {link}"
    outside = re.compile(r"<(?:script|img|link)[^>]+(?:src|href)=\"https?:")
    assert not [p.name for p in site.rglob("*.html") if outside.search(p.read_text(encoding="utf-8"))]


def test_formulae_are_mathml(site):
    text = (site / "how_it_decides.html").read_text(encoding="utf-8")
    assert text.count("<math") > 20 and "$" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)


def test_site_opens_in_a_browser_and_finds_words(site, chromium):
    def opened(page: str, query: str = "") -> tuple[str, list[str]]:
        """The page as Chromium shows it, and what it says."""
        chromium.open((site / page).as_uri() + query)
        return chromium.done("return document.documentElement.outerHTML"), chromium.said

    shown, said = opened("index.html")
    assert "First identification" in shown and said == []
    shown, said = opened("search.html", "?q=compliance")
    assert said == [] and re.search(r"[1-9]\d* places? for “compliance”", shown), shown[-2000:]
    assert 'href="./glossary.html' in shown
    shown, said = opened("search.html", "?q=identify")
    assert 'href="./api/bayes_iwan.html#identify"' in shown
    shown, said = opened("api/bayes_iwan.html")
    assert 'id="identify"' in shown and said == []


def test_no_page_is_cut_or_torn_in_print(site, chromium, tmp_path):
    pages = [p for p in sorted(site.glob("*.html")) if p.stem not in ("404", "search")]
    assert len(pages) > 10
    assert {p.name: cut_elements(p, chromium) for p in pages} == {
        p.name: {str(width): [] for width in WIDTHS} for p in pages
    }
    assert {p.name: torn(p, chromium.printed(p, tmp_path / f"{p.stem}.pdf")) for p in pages} == {
        p.name: [] for p in pages
    }
