"""batch.html: many specimens on one page, their quantities, the population, causes, outliers, failures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from bayes_iwan.inference.setup.scales import Scales
from bayes_iwan.physics import Model
from bayes_iwan.physics.models.sampled import default_parameters
from bayes_iwan.report.identification.answer import QUANTILES
from bayes_iwan.report.page import Page, Section
from bayes_iwan.report.provenance import Provenance
from bayes_iwan.report.style import MEASURED, MODEL, house_style, styled, subplots

if TYPE_CHECKING:
    from bayes_iwan.report.batch import Batch

#: specimens that are named along the axis; of more, every n-th is
NAMED = 40


@house_style()
def write_batch_page(result: Batch, out: Path, made: Provenance) -> Path:
    """The page across specimens; returns its path. made : from what and when."""
    n, failed = len(result.finished), len(result.failures)
    page = Page(
        f"{n + failed} specimens",
        footer="The numbers of this page are in batch.csv, the reasons of failures in failures.csv.",
        made=made,
    )
    section = page.section("Answer")
    _summary(section, result)
    if result.populations:
        _populations(section, result)
    if rows := _symbols(result):
        section.text("Symbols of this page:").symbols(rows)
    if any(x.quantities for x in result.finished):
        section = page.section("Parameters against specimen")
        section.figure(
            parameters_figure(result),
            "Each quantity that a specimen's loops determine: the posterior's median and 90 % interval (q05 to q95 of "
            "batch.csv). Band: 90 % of the specimens "
            "that are still to come, by the population's mean and spread; open circles stand out from the others.",
            "One panel a quantity: an interval for every specimen over the population's band; the same numbers are in "
            "batch.csv.",
            name="parameters",
        )
    if any(x.cause is not None for x in result.finished):
        _causes(page, result)
    _specimens(page, result)
    return page.write(out / "batch.html")


def _symbols(result: Batch) -> list[tuple[str, str, str]]:
    """Meaning and unit of the Iwan model's symbols among the labels; a user's own model says its own in its report."""
    scales = Scales(*[1.0] * 6)
    known = {q.symbol: q.description for q in default_parameters(Model(scales.reference), scales)}
    known |= {symbol: meaning for symbol, meaning, _ in QUANTILES}
    labels = {q.label: q.unit for x in result.finished for q in x.quantities.values()}
    found = {label.partition(" (")[0]: unit for label, unit in labels.items()}
    return [(symbol, known[symbol], unit) for symbol, unit in found.items() if symbol in known]


def _summary(section: Section, result: Batch) -> None:
    late = [x.name for x in result.finished if x.converged is False]
    section.text(
        f"{len(result.finished)} finished, {len(result.failures)} failed; "
        f"{sum(x.seconds for x in result.finished):.0f} s of work."
    )
    if late:
        section.note(f"Not converged, so that their intervals are too narrow: {', '.join(late)}.", "warning")
    if any(x.quantities and x.converged is None for x in result.finished):
        section.note("Quick: intervals are Laplace's about the most probable point, not sampled.")
    for name, found in result.outliers().items():
        section.note(f"{name} stands out from the others in {', '.join(found)}.", "warning")
    if result.failures:
        section.table(("specimen", "reason"), list(result.failures.items()), "Failures")


def _populations(section: Section, result: Batch) -> None:
    rows = []
    for name, p in result.populations.items():
        label = next(x.quantities[name].label for x in result.finished if name in x.quantities)
        if p.relative:
            spread = "{:.3g} % [{:.2g}, {:.2g}]".format(*(100.0 * v for v in p.spread))
        else:
            spread = "{:.3g} [{:.2g}, {:.2g}]".format(*p.spread)
        typical = "{:.4g} [{:.4g}, {:.4g}]".format(*p.typical)
        rows.append((label, len(p.names), typical, spread, "{:.4g} to {:.4g}".format(*p.next_specimen)))
    section.heading_below("The population")
    section.text(
        "Typical value and spread between specimens, each posterior's own error taken off (a normal population of "
        "logarithms where values are positive; flat priors on mean and spread)."
    ).table(
        ("quantity", "specimens", "typical value [90 %]", "spread between specimens [90 %]", "90 % of further ones"),
        rows,
        "Population of each quantity",
    )


@styled
def parameters_figure(result: Batch) -> Figure:
    """Each quantity against specimen: intervals over the population's band."""
    names = list(dict.fromkeys(q for x in result.finished for q in x.quantities))
    specimens = [x.name for x in result.finished]
    wide = float(np.clip(0.16 * len(specimens) + 1.5, 4.0, 11.0))
    figure, axes = subplots(len(names), 1, wide, 1.25 * len(names) + 0.8, sharex=True)
    outliers = result.outliers()
    for ax, name in zip(axes[:, 0], names):
        if name in result.populations:
            ax.axhspan(*result.populations[name].next_specimen, color=MODEL, alpha=0.15, linewidth=0)
        label = name
        for i, x in enumerate(result.finished):
            if name not in x.quantities:
                continue
            q = x.quantities[name]
            label = q.label
            odd = name in outliers.get(x.name, ())
            ax.plot([i, i], [q.low, q.high], color=MEASURED, linewidth=1)
            ax.plot(
                [i], [q.median], "o", color=MEASURED, markersize=5 if odd else 2.5, fillstyle="none" if odd else "full"
            )
        ax.set_ylabel(label)
    every = -(-len(specimens) // NAMED)
    axes[-1, 0].set_xticks(range(0, len(specimens), every), specimens[::every], rotation=90)
    axes[-1, 0].set_xlim(-0.7, len(specimens) - 0.3)
    return figure


def _causes(page: Page, result: Batch) -> None:
    which: dict[str, list[str]] = {}
    for x in result.finished:
        if x.cause is not None:
            cause = f"{x.cause} + {x.second_cause}" if x.second_cause else x.cause
            which.setdefault(cause.replace("_", " "), []).append(x.name)
    rows = [(cause, len(n), ", ".join(n)) for cause, n in sorted(which.items(), key=lambda kv: -len(kv[1]))]
    page.section("Causes found").table(("cause", "specimens", "which"), rows, "Causes")


def _specimens(page: Page, result: Batch) -> None:
    rows = []
    for x in result.finished:
        links = []
        if x.quantities:
            links.append(_link(x.name, "report.html", "report"))
        if x.cause is not None:
            links.append(_link(x.name, "diagnosis.html", "diagnosis"))
        cause = "–" if x.cause is None else f"{x.cause.replace('_', ' ')} ({x.probability or 0.0:.2f})"
        rows.append((x.name, Markup(" · ").join(links), x.message or "–", cause, f"{x.seconds:.0f}"))
    page.section("Specimens").table(
        ("specimen", "pages", "sampling", "cause (probability)", "seconds"), rows, "Every specimen"
    )


def _link(name: str, file: str, text: str) -> Markup:
    return Markup(f'<a href="specimens/{escape(quote(name))}/{file}">{escape(text)}</a>')
