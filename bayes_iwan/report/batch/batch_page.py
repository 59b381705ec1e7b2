"""batch.html: many specimens on one page, their quantities, the population, causes, outliers, failures."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from urllib.parse import quote

import numpy as np
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.models import Model
from bayes_iwan.models.iwan_parameters import default_parameters
from bayes_iwan.report.batch.specimens import Batch, Finished
from bayes_iwan.report.identification.marginals import number
from bayes_iwan.report.identification.summary import QUANTILES
from bayes_iwan.report.page import Page, Provenance, Section
from bayes_iwan.report.style import MEASURED, MODEL, ORANGE, house_style, styled, subplots

#: specimens that are named along the axis; of more, every n-th is
NAMED = 40
#: specimens that the ranking shows
RANKED = 30


@house_style()
def write_batch_page(result: Batch, out: Path, made: Provenance) -> Path:
    """The page across specimens; returns its path. made : from what and when."""
    n, failed = len(result.finished), len(result.failures)
    page = Page(
        f"{n + failed} specimens",
        footer="The numbers of this page are in batch.csv (and batch.xlsx), the reasons of failures in failures.csv; "
        "sheet.pdf is one page for a customer.",
        made=made,
    )
    section = page.section("Answer")
    _summary(section, result)
    if result.populations:
        _populations(section, result)
    page.sorting()
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
    if result.lot_populations:
        _lots(page.section(f"Lots, by {result.group}"), result)
    if any(x.cause is not None for x in result.finished):
        _causes(page, result)
    _values(page, result)
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
    done, failed = len(result.finished), len(result.failures)
    found: list[tuple[str, bool, str]] = [(f"{done} finished, {failed} failed.", not failed, "")]
    odd = [x for x in result.unusual if x.notable]
    for x in odd[:12]:
        named = ", ".join(result.label(q) for q in x.notable[:5])
        more = f" and {len(x.notable) - 5} more" if len(x.notable) > 5 else ""
        found.append((f"{x.name} is unusual (distance {x.distance:.1f}): {named}{more}.", False, ""))
    if len(odd) > 12:
        found.append((f"{len(odd) - 12} more are unusual.", False, ""))
    if result.unusual and not odd:
        found.append(("No specimen stands out from the others.", True, ""))
    if late := [x.name for x in result.finished if x.converged is False]:
        found.append((f"Not converged, so that their intervals are too narrow: {', '.join(late)}.", False, ""))
    if any(x.quantities and x.converged is None for x in result.finished):
        found.append(("Quick: intervals are a normal approximation, not sampled.", False, ""))
    large = [x for x in result.finished if (x.gap_share or 0.0) > LARGE_RESIDUAL]
    if large:
        named = ", ".join(f"{x.name} ({100 * (x.gap_share or 0.0):.2g} %)" for x in large[:8])
        found.append(
            (f"The model misses more than {100 * LARGE_RESIDUAL:.0f} % of the friction force of {named}.", False, "")
        )
    causes = Counter(_cause(x) for x in result.finished if x.cause is not None)
    if causes:
        gaps = [x.gap_share for x in result.finished if x.gap_share is not None]
        size = f" The gap is {100 * np.median(gaps):.2g} % of the friction force in the median." if gaps else ""
        text = "Causes found: " + ", ".join(f"{c} ({n})" for c, n in causes.most_common(6)) + "." + size
        found.append((text, set(causes) <= {"none"}, "Causes found"))
    poor = [result.label(q) for q, p in result.populations.items() if p.fits() < 0.01]
    if poor:
        text = f"A normal population does not fit {', '.join(poor)}: read its bands with care, and look for lots."
        found.append((text, False, ""))
    section.status(found)
    if result.unusual:
        section.figure(
            unusual_figure(result),
            "Robust distance of each specimen from the others over all quantities, 1 for a usual one, the most unusual "
            f"first (at most {RANKED}). Orange: stands out in at least one quantity; of those named, one in twenty is "
            "expected to be so by chance.",
            "Bars of the robust distance of every specimen.",
            name="unusual",
        )
    if result.failures:
        section.table(("specimen", "reason"), list(result.failures.items()), "Failures")


@styled
def unusual_figure(result: Batch) -> Figure:
    """Every specimen by its robust distance from the others."""
    shown = result.unusual[:RANKED]
    figure, axes = subplots(1, 1, 6.4, 0.19 * len(shown) + 0.9)
    ax = axes[0, 0]
    at = np.arange(len(shown))
    ax.barh(at, [x.distance for x in shown], color=[ORANGE if x.notable else MODEL for x in shown], height=0.65)
    ax.axvline(1.0, color=MEASURED, linewidth=0.8, linestyle=":")
    ax.set_yticks(at, [x.name for x in shown])
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("robust distance")
    return figure


def _lots(section: Section, result: Batch) -> None:
    sizes = Counter(result.lots.get(x.name, "") for x in result.finished)
    section.text("Specimens: " + ", ".join(f"{lot or 'no lot'} ({n})" for lot, n in sorted(sizes.items())) + ".")
    rows = []
    for d in result.differences():
        one = "1" if d.relative else "0"
        says = "differ" if not d.low <= float(one) <= d.high else "–"
        sign = "/" if d.relative else "−"
        name = f"{result.label(d.quantity)}: {d.a} {sign} {d.b}"
        rows.append((name, f"{d.median:.4g}", f"{d.low:.4g} to {d.high:.4g}", f"{d.larger:.3f}", says))
    if rows:
        section.table(
            ("typical value", "ratio or difference", "90 %", "probability that the first is larger", "differ?"),
            rows,
            "Lots against each other: ratio of the typical values (difference where a quantity has either sign). Each "
            "row at 90 %: of equal lots one row in ten differs by chance.",
            sortable=True,
        )
    else:
        section.note("Fewer than two lots have three specimens that determine a quantity: nothing to compare.")


def _values(page: Page, result: Batch) -> None:
    names = list(dict.fromkeys(q for x in result.finished for q in x.quantities))
    if not names:
        return
    ranked = {x.name: x for x in result.unusual}
    head = ["specimen", *([result.group] if result.group else []), "distance", "gap (%)", *map(result.label, names)]
    rows = []
    for x in result.finished:
        odd = ranked.get(x.name)
        row = [x.name, *([result.lots.get(x.name, "–")] if result.group else [])]
        row.append("–" if odd is None else f"{odd.distance:.1f}")
        row.append("–" if x.gap_share is None else f"{100 * x.gap_share:.2g}")
        for q in names:
            have, lot = x.quantities.get(q), result.shrunk.get(q, {}).get(x.name)
            text = "–" if have is None else f"{number(have.median, have.high - have.low)}"
            if have is not None and lot is not None and lot.usable:
                text += f" ({number(lot.q50, lot.q95 - lot.q05)})"
            row.append(text)
        rows.append(row)
    section = page.section("Values of every specimen")
    unusable = sum(not s.usable for found in result.shrunk.values() for s in found.values())
    others = "the others of its lot" if result.group else "all others"
    said = f"Medians; in brackets what {others} say of a specimen beside its own loops (hierarchical shrinkage: "
    said += "its draws are weighted by their population). Click on a column's name to sort. Intervals are in batch.csv."
    if unusable:
        said += f" {unusable} values have none: too few draws carry the weights, or they are too uneven (Pareto's k)."
    section.text(said).table(head, rows, "Values of every specimen", sortable=True)


def _populations(section: Section, result: Batch) -> None:
    rows = []
    for name, p in result.populations.items():
        label = result.label(name)
        if p.relative:
            spread = "{:.3g} % [{:.2g}, {:.2g}]".format(*(100.0 * v for v in p.spread))
        else:
            spread = "{:.3g} [{:.2g}, {:.2g}]".format(*p.spread)
        typical = "{:.4g} [{:.4g}, {:.4g}]".format(*p.typical)
        rows.append(
            (label, len(p.names), typical, spread, "{:.4g} to {:.4g}".format(*p.next_specimen), f"{p.fits():.2f}")
        )
    section.heading_below("The population")
    section.text(
        "Typical value and spread between specimens, each posterior's own error taken off (a normal population on the "
        "scale on which the prior is normal; flat priors on mean and spread). Fit: p-value of that population."
    ).table(
        (
            "quantity",
            "specimens",
            "typical value [90 %]",
            "spread between specimens [90 %]",
            "90 % of further ones",
            "fit",
        ),
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


def _cause(x: Finished) -> str:
    return (f"{x.cause} + {x.second_cause}" if x.second_cause else str(x.cause)).replace("_", " ")


def _causes(page: Page, result: Batch) -> None:
    which: dict[str, list[Finished]] = {}
    for x in result.finished:
        if x.cause is not None:
            which.setdefault(_cause(x), []).append(x)
    rows = []
    for cause, some in sorted(which.items(), key=lambda kv: -len(kv[1])):
        gaps = [100 * x.gap_share for x in some if x.gap_share is not None]
        rows.append((cause, len(some), f"{np.median(gaps):.2g}" if gaps else "–", ", ".join(x.name for x in some)))
    page.section("Causes found").table(("cause", "specimens", "gap (%), median", "which"), rows, "Causes")


def _specimens(page: Page, result: Batch) -> None:
    rows = []
    for x in result.finished:
        links = []
        if x.quantities:
            links.append(_link(x.name, "report.html", "report"))
        if x.cause is not None:
            links.append(_link(x.name, "diagnosis.html", "diagnosis"))
        cause = "–" if x.cause is None else f"{_cause(x)} ({x.probability or 0.0:.2f})"
        gap = "–" if x.gap_share is None else f"{100 * x.gap_share:.2g}"
        rows.append((x.name, Markup(" · ").join(links), x.message or "–", gap, cause, f"{x.seconds:.0f}"))
    page.section("Specimens").table(
        ("specimen", "pages", "sampling", "gap (%)", "cause (probability)", "seconds"),
        rows,
        "Every specimen",
        sortable=True,
    )


def _link(name: str, file: str, text: str) -> Markup:
    return Markup(f'<a href="specimens/{escape(quote(name))}/{file}">{escape(text)}</a>')
