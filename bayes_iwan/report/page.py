"""A page that stands alone: text, figures and tables in one HTML file; and tables as CSV files have them."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from bayes_iwan import __version__
from bayes_iwan.campaign import Campaign
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.files import write_whole
from bayes_iwan.report.rendering import Order, Rendered, Renderer
from bayes_iwan.report.style import Shown, relabel
from bayes_iwan.screen import on_screen, table

#: pixels an inch of a figure takes on a screen: its smallest letters are then as large as small print
PIXELS = 112
#: is every figure written as PNG and as PDF beside the page?
FILES = True
Text = TypeVar("Text", str, Markup)
Results = TypeVar("Results", covariant=True)

_ENVIRONMENT = Environment(
    loader=PackageLoader("bayes_iwan.report", "templates"), autoescape=True, trim_blocks=True, lstrip_blocks=True,
    undefined=StrictUndefined,
)  # fmt: skip


def template(name: str, **values: object) -> Markup:
    """One of the folder's templates, filled in; values are escaped unless they are Markup."""
    return Markup(_ENVIRONMENT.get_template(name).render(**values))


def asset(name: str) -> Markup:
    """A template file as it stands (style sheets, scripts)."""
    assert _ENVIRONMENT.loader is not None
    return Markup(_ENVIRONMENT.loader.get_source(_ENVIRONMENT, name)[0])


@dataclass(frozen=True)
class Picture:
    """A figure on a page; it may still be in the making, so it becomes HTML when the page does. phone : the order of
    its variant for a narrow screen, None where there is none."""

    figure: Figure
    caption: str
    name: str
    order: Order
    renderer: Renderer
    phone: Order | None = None

    @property
    def rendered(self) -> Rendered:
        return self.renderer.rendered(self.order)

    def __html__(self) -> str:
        phone = None if self.phone is None else self.renderer.rendered(self.phone).svg
        width = round(PIXELS * self.figure.get_size_inches()[0])
        return template(
            "figure.html", picture=self.rendered.svg, phone=phone, caption=self.caption, file=self.name, width=width
        )


def anchor_of(heading: str) -> str:
    """The name by which links find a section."""
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") or "section"


#: a cell of a table that is a number, with whatever error or unit
_NUMERIC = re.compile(r"[−+-]?[\d.,  ]+(?:e[−-]?\d+)?(?: ?[%–±].*)?|–|∞|nan|")


class Finding(NamedTuple):
    """One check behind an answer: what it says, whether all is well, and the heading of the section that shows it ("":
    none does)."""

    text: str
    good: bool = False
    section: str = ""


class Section(Generic[Results]):
    """One section of a page: the results that it says, and its block in its page's template, that of its class's name.

    The block sees `r`, the results; `s`, this object, for what has to be worked out of them; and :class:`Body`'s
    methods figure, table, status, symbols and viewer. Where nothing has to be worked out, block and heading are given.
    """

    heading: str
    template: str

    def __init__(self, r: Results, block: str = "", heading: str = "") -> None:
        self.r, self.block = r, block or type(self).__name__
        self.heading = heading or self.heading


@dataclass
class Body:
    """What stands below a heading of a page, in order. Text is escaped; pass Markup for HTML."""

    page: Page
    heading: str
    anchor: str
    body: list[Markup | Picture] = field(default_factory=list)
    figures: dict[str, Picture] = field(default_factory=dict)

    def fill(self, section: Section[object]) -> Body:
        """What a section says: its block's words in the campaign's own units, and what they ask for between them."""
        asked: list[Markup | Picture] = []

        def between(make: Callable[..., Body]) -> Callable[..., Markup]:
            def call(*args: object, **kwargs: object) -> Markup:
                make(*args, **kwargs)
                asked.append(self.body.pop())
                return Markup(f"<{len(asked) - 1}>")  # no text of a file can look so: all of them are escaped

            return call

        methods = {m.__name__: between(m) for m in (self.figure, self.table, self.status, self.symbols, self.viewer)}
        whole = _ENVIRONMENT.get_template(section.template)
        said = whole.blocks[section.block](whole.new_context({"r": section.r, "s": section, **methods}))
        pieces = re.split(r"<(\d+)>", "".join(said))
        self.body += [asked[int(x)] if i % 2 else self._said(Markup(x)) for i, x in enumerate(pieces)]
        return self

    def _said(self, text: Text) -> Text:
        """A text, or Markup, written for N and mm in the campaign's own units."""
        return type(text)(self.page.units.said(text))

    def html(self, markup: Markup) -> Body:
        self.body.append(markup)
        return self

    def status(self, found: Sequence[Finding]) -> Body:
        """The checks behind an answer: one box in amber if any is not well, green only when all are."""
        rows = [(self._said(text), good, heading, anchor_of(heading)) for text, good, heading in found]
        return self.html(template("status.html", rows=sorted(rows, key=lambda x: x[1]), well=all(x[1] for x in rows)))

    def symbols(self, rows: Sequence[tuple[str, str, str]]) -> Body:
        """A legend of symbols, (symbol, what it is, unit) each, to stand before what first uses them."""
        said = [(a, self._said(b), "" if c in ("", "-", "–") else self._said(c)) for a, b, c in rows]
        return self.html(template("symbols.html", rows=said))

    def figure(self, figure: Figure | None, caption: str, alt: str, name: str | None = None) -> Body:
        """A matplotlib figure, as inline SVG, and as files when the page is written; None shows nothing.

        alt says what a reader would see in it; name is that of the files (default: the section's and a number). The
        figure is not to be changed afterwards.
        """
        if figure is None:
            return self.html(Markup())
        relabel(figure, self.page.units)
        number = f"{self.anchor}-f{len(self.figures) + 1}"
        order, phone, renderer = Order(number, self._said(alt), FILES), None, self.page.renderer
        renderer.order(order, figure)
        if isinstance(figure, Shown) and figure.for_phone is not None:
            again, phone = figure.for_phone(), Order(f"{number}-phone", self._said(alt), False)
            relabel(again, self.page.units)
            renderer.order(phone, again)
        picture = Picture(figure, self._said(caption), name or number, order, renderer, phone)
        self.figures[picture.name] = picture
        self.body.append(picture)
        return self

    def table(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[object]],
        caption: str,
        fold: bool = False,
        sortable: bool = False,
    ) -> Body:
        """A table; the first column heads its row.

        fold : closed until the reader opens it. sortable : a click on a column's name sorts by it, where the page has
        the script for it (sort.js).
        """
        rows = [[self._said(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
        numeric = [bool(rows) and all(_NUMERIC.fullmatch(str(row[i])) for row in rows) for i in range(len(columns))]
        head, caption = list(zip(map(self._said, columns), numeric)), self._said(caption)
        shown = {"fold": fold, "sortable": sortable}
        return self.html(template("table.html", columns=head, rows=rows, caption=caption, numeric=numeric, **shown))

    def viewer(self, data: Mapping[str, Any]) -> Body:
        """The loop viewer, one a page; data : see :mod:`bayes_iwan.report.viewer`."""
        self.page.styles.append(asset("uplot.min.css"))
        self.page.script(Markup("/*\n") + asset("uplot-LICENSE.txt") + Markup("*/\n") + asset("uplot.min.js"))
        content = json.dumps(data, separators=(",", ":"), allow_nan=False)
        self.page.script(asset("viewer.js"), "viewer-data", content)
        names = [self._said(test["name"]) for test in data["tests"]]
        return self.html(template("viewer.html", tests=names, effects=data.get("effects", ())))


#: names from files may hold what steers a terminal that shows a page's source
_CONTROL = {i: "?" for i in (*range(32), 127, *range(128, 160)) if chr(i) not in "\t\n\r"}


class Page:
    """An HTML page in the making. `write` replaces the file whole or not at all.

    made : when, with which version and seed, and from which files; it stands below the title. renderer : draws the
    figures (default: this process alone).
    """

    def __init__(
        self,
        title: str,
        subtitle: str = "",
        footer: str = "",
        units: Units | None = None,
        made: Provenance | None = None,
        renderer: Renderer | None = None,
    ) -> None:
        self.units = units or Units()
        self.title, self.footer, self.made = title, self.units.said(footer), made
        self.subtitle = self.units.said(subtitle)
        self.sections: list[Body] = []
        self.scripts: list[Markup] = []
        self.styles: list[Markup] = []
        self.data: list[tuple[str, Markup]] = []
        self.renderer = renderer or Renderer()

    def add(self, *sections: Section[object]) -> None:
        """Sections at the end of the page."""
        for section in sections:
            self.section(section.heading).fill(section)

    def section(self, heading: str) -> Body:
        """A new heading at the end of the page."""
        anchor = anchor_of(heading)
        taken = {s.anchor for s in self.sections}
        self.sections.append(Body(self, heading, anchor if anchor not in taken else f"{anchor}-{len(taken)}"))
        return self.sections[-1]

    def script(self, source: Markup, data_id: str | None = None, data_json: str | None = None) -> None:
        """A script at the end of the page, with JSON in an element of its own (never evaluated)."""
        self.scripts.append(source)
        if data_id is not None and data_json is not None:
            self.data.append((data_id, Markup(data_json.replace("<", "\\u003c"))))

    @property
    def policy(self) -> Markup:
        """The page's content-security policy: nothing from elsewhere, and no script but the page's own."""
        hashes = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in self.scripts]
        scripts = " ".join(f"'sha256-{h}'" for h in hashes) or "'none'"
        return Markup(
            f"default-src 'none'; style-src 'unsafe-inline'; script-src {scripts}; img-src data:; base-uri 'none'; "
            "form-action 'none'"
        )

    @property
    def drawn(self) -> bool:
        """Has it figures?"""
        return any(section.figures for section in self.sections)

    def html(self, stem: str = "page") -> str:
        """The page's text; stem : what its figures' files begin with."""
        return str(template("page.html", page=self, css=asset("page.css"), stem=stem))

    def write(self, path: str | os.PathLike[str]) -> Path:
        """The page, and before it every figure as figures/STEM_NAME.png and .pdf beside it, STEM that of the page."""
        path = Path(path)
        folder = path.parent / "figures"
        pictures = {f"{path.stem}_{name}": x for section in self.sections for name, x in section.figures.items()}
        for old in folder.glob(f"{path.stem}_*"):
            if old.stem not in pictures:
                old.unlink()
        for name, picture in pictures.items():
            if picture.order.files:
                write_whole(folder / f"{name}.png", picture.rendered.png)
                write_whole(folder / f"{name}.pdf", picture.rendered.pdf)
        return write_whole(path, self.html(path.stem).translate(_CONTROL))


@dataclass(frozen=True)
class Provenance:
    """What stands below a page's title.

    date : when the page was written, local time; version : of the package; seed : of all random numbers, None where
    none were drawn. folder : name of the campaign's folder, without where it lies, for pages go to customers; files :
    of it that were read; source : as it states itself; counted : what the files are.
    """

    date: str
    version: str
    seed: int | None
    folder: str
    files: tuple[str, ...]
    source: str = ""
    counted: str = "file"

    def said(self) -> str:
        """One line."""
        seed = "" if self.seed is None else f", seed {self.seed}"
        files = f" ({len(self.files)} {self.counted}{'s' if len(self.files) != 1 else ''})" if self.files else ""
        return f"{self.date} · bayes-iwan {self.version}{seed} · from {self.folder}{files}"


def provenance(campaign: Campaign | None, seed: int | None = None) -> Provenance:
    """That of a page about one campaign; None for loops that came from no folder."""
    if campaign is None:
        return replace(of_folder(".", seed), folder="loops in memory")
    files = ("campaign.toml", *(test.file for test in campaign.tests))
    return of_folder(campaign.path, seed, files, campaign.source)


def of_folder(folder: str | Path, seed: int | None = None, files: Sequence[str] = (), source: str = "") -> Provenance:
    """That of a page about files in a folder."""
    date = f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"
    return Provenance(date, __version__, seed, Path(folder).absolute().name, tuple(files), source)


#: what a row holds
Cell = str | float | None
Rows = tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
@on_screen
class Table:
    """Rows of a table as text or numbers; `name` is the CSV file's, numbers keep full precision there and
    what is not a number is an empty cell."""

    name: str
    columns: tuple[str, ...]
    rows: Rows

    def __repr__(self) -> str:
        return table(self.columns, self.rows, f"{self.name}.csv")

    def csv(self) -> str:
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(
            [("" if np.isnan(x) else f"{x:.9g}") if isinstance(x, float) else x for x in row] for row in self.rows
        )
        return out.getvalue()

    def in_units(self, units: Units) -> Table:
        """The table with a campaign's own units in its columns' names and in its texts."""
        return replace(self, columns=units.everywhere(self.columns), rows=units.everywhere(self.rows))

    def write_csv(self, folder: str | os.PathLike[str]) -> Path:
        return write_whole(Path(folder) / f"{self.name}.csv", self.csv())
