"""The guide as one static site: pages, pictures, API pages, search; no outside file, opened from a folder or a server.

    python analyses/guide/build.py --out site [--pictures]

Markdown becomes pages by mkdocs, formulae become MathML, docstrings become API pages by pdoc. --pictures draws the
pictures of the pages anew (a minute); they are kept beside the pages.
"""

from __future__ import annotations

import argparse
import html
import inspect
import itertools
import json
import logging
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import pdoc
import yaml
from latex2mathml.converter import convert
from mkdocs.commands.build import build
from mkdocs.config import load_config

import bayes_iwan as bi

GUIDE = Path(__file__).parent
#: pages in their order; those about export follow where they are written
PAGES = (
    "index", "first_identification", "reading_the_report", "likelihood", "first_diagnosis", "how_it_decides",
    "own_effect", "own_simulator", "importing", "batch", "withheld", "glossary", "measured",
)  # fmt: skip
#: the picture shows these tests of data/rope_spring
SHOWN = ("f10_a0.3.csv.gz", "f15_a0.6.csv.gz", "f20_a1.csv.gz")

#: commands and tables stay within a phone's width
WRAP = """
.rst-content pre, .rst-content pre code { white-space: pre-wrap; overflow-wrap: anywhere; overflow: visible; }
.rst-content table { display: block; }
.rst-content table td, .rst-content table th { white-space: normal !important; overflow-wrap: break-word; }
.rst-content img { max-width: 100%; }
.rst-content math[display="block"] { display: block; overflow-x: auto; max-width: 100%; }
.rst-content code { white-space: normal; overflow-wrap: anywhere; max-width: 100%; }
.rst-content th code { overflow-wrap: normal; }
@media (min-width: 1200px) { .wy-nav-content { max-width: 62rem; } }
/* on a phone every row of a table is a card, each number with its column's name */
@media screen and (max-width: 768px) {
  .rst-content table thead { display: none; }
  .rst-content table, .rst-content tbody, .rst-content tr, .rst-content td { display: block; width: auto; }
  .rst-content tr { border: 1px solid #e1e4e5; margin: 0 0 0.6rem; }
  .rst-content table td { display: grid; grid-template-columns: minmax(6rem, 40%) minmax(0, 1fr); column-gap: 0.7rem;
    border: 0; padding: 4px 12px; }
  .rst-content table td:first-child { display: block; font-weight: bold; }
  .rst-content table td:not(:first-child)::before { content: attr(data-label); color: #555; }
  .rst-content table td:empty { display: none; }
  .rst-content math[display="block"] { font-size: 72%; }
}
"""


def pages() -> list[Path]:
    """The guide's pages in the order of the site."""
    first = [GUIDE / f"{name}.md" for name in PAGES]
    return [*first[:-2], *sorted(GUIDE.glob("export_*.md")), *first[-2:]]


def with_mathml(text: str) -> str:
    """Markdown with $…$ and $$…$$ outside code as MathML, which browsers draw by themselves."""
    parts = re.split(r"(^```.*?^```|`[^`\n]+`)", text, flags=re.S | re.M)
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(
            r"\$\$(.+?)\$\$", lambda m: f"\n<p>{convert(m[1].strip(), display='block')}</p>\n", parts[i], flags=re.S
        )
        parts[i] = re.sub(r"\$([^$\n]+)\$", lambda m: f"<span>{convert(m[1])}</span>", parts[i])
    return "".join(parts)


def write_api(out: Path) -> None:
    """API pages of all that `import bayes_iwan` offers. Names are imported when they are first asked for, and pdoc does
    not ask, so all of them are asked for here."""
    for name in bi.__all__:
        setattr(bi, name, getattr(bi, name))
    pdoc.render.configure(docformat="numpy", show_source=False, math=False)
    pdoc.pdoc("bayes_iwan", output_directory=out)


def api_entries() -> list[dict[str, str]]:
    """What the search finds of the API: every public name with its docstring."""
    out = []
    for name in bi.__all__:
        thing = getattr(bi, name)
        if not isinstance(thing, str):
            out.append(
                {"location": f"api/bayes_iwan.html#{name}", "title": f"bi.{name}", "text": inspect.getdoc(thing) or ""}
            )
    return out


def make_searchable(site: Path) -> None:
    """Replace mkdocs' search, which needs a server, by one that needs none."""
    folder = site / "search"
    index = json.loads((folder / "search_index.json").read_text(encoding="utf-8"))
    docs = [*index["docs"], *api_entries()]
    (folder / "search_index.js").write_text(f"window.searchIndex = {json.dumps({'docs': docs})};\n", encoding="utf-8")
    shutil.copy(GUIDE / "search.js", folder / "main.js")
    for name in ("search_index.json", "worker.js"):
        (folder / name).unlink()


def label_cells(page: str) -> str:
    """A page whose tables' cells know their columns' names, which a phone shows beside them."""

    def labelled(table: re.Match[str]) -> str:
        heads = [re.sub(r"<[^>]+>", "", x) for x in re.findall(r"<th[^>]*>(.*?)</th>", table[0], re.S)]
        names = itertools.cycle(heads)
        return re.sub(r"<td", lambda _: f'<td data-label="{html.escape(html.unescape(next(names)))}"', table[0])

    return re.sub(r"<table>.*?</table>", labelled, page, flags=re.S)


def build_site(out: Path) -> Path:
    """Build the site in a folder, whose contents are replaced; returns its first page."""
    logging.basicConfig(level=logging.WARNING)  # mkdocs says by it why it ends
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "pages"
        source.mkdir()
        for page in pages():
            text = page.read_text(encoding="utf-8").replace("](../pictures/", "](pictures/")
            (source / page.name).write_text(with_mathml(text), encoding="utf-8")
        for folder in (GUIDE / "pictures", GUIDE / "notebooks", GUIDE.parent / "pictures"):
            shutil.copytree(folder, source / folder.name, dirs_exist_ok=True)
        (source / "wrap.css").write_text(WRAP, encoding="utf-8")
        write_api(source / "api")
        config: dict[str, Any] = {
            "site_name": "bayes_iwan",
            "site_url": "",
            "docs_dir": str(source),
            "site_dir": str(out.resolve()),
            "use_directory_urls": False,
            "strict": True,
            "nav": [*(p.name for p in pages()), {"API": "api/bayes_iwan.html"}],
            "theme": {"name": "readthedocs", "highlightjs": False, "navigation_depth": 2},
            "plugins": ["search"],
            "markdown_extensions": ["tables", "fenced_code", "toc", "md_in_html"],
            "extra_css": ["wrap.css"],
            "extra_javascript": ["search/search_index.js", "search/lunr.js", "search/main.js"],
        }
        file = Path(temporary) / "mkdocs.yml"
        file.write_text(yaml.safe_dump(config), encoding="utf-8")
        build(load_config(str(file)))
    make_searchable(out)
    for page in out.glob("*.html"):
        page.write_text(label_cells(page.read_text(encoding="utf-8")), encoding="utf-8")
    return out / "index.html"


def draw_pictures() -> None:
    """The pictures of the pages, from a quick identification of the shipped campaign."""
    from bayes_iwan.report.identification.law_figures import slip_density_figure
    from bayes_iwan.report.identification.loops import loops_figure

    run = bi.identify(GUIDE.parents[1] / "data" / "rope_spring", quick=True, seed=1, progress=False)
    (GUIDE / "pictures").mkdir(exist_ok=True)
    shown = [x for x in run.loops if x.file in SHOWN]
    for name, figure in (("loops", loops_figure(run, loops=shown)), ("slip_forces", slip_density_figure(run))):
        figure.savefig(GUIDE / "pictures" / f"{name}.png", dpi=100, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("site"))
    parser.add_argument("--pictures", action="store_true", help="draw the pictures of the pages anew")
    args = parser.parse_args()
    if args.pictures:
        draw_pictures()
    print(build_site(args.out))


if __name__ == "__main__":
    main()
