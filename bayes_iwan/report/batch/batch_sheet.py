"""sheet.pdf: a batch on one page for a customer: how many, typical values and spread, who is unusual, causes."""

from collections import Counter
from datetime import date
from pathlib import Path
from textwrap import fill, shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_iwan import __version__
from bayes_iwan.report.batch.batch_page import draw_unusual
from bayes_iwan.report.batch.specimens import Batch
from bayes_iwan.report.identification.marginals import in_interval, number
from bayes_iwan.report.style import house_style, save, styled

#: inches of A4; quantities and specimens that one page has space for
A4 = (8.27, 11.69)
QUANTITIES, SPECIMENS, NAMED = 12, 25, 6
#: heights of a line of text and of a row of the table, as shares of the page's
LINE, ROW = 0.0175, 0.0185
#: of quantities, in words that need no paper
WORDS = {
    "kp_N_mm": "stiffness once all contacts slide",
    "k1_N_mm": "stiffness of sticking contacts",
    "mean_slip_force_N": "mean slip force",
    **{f"slip_force_q{x}_N": f"slip force of {x} % of contacts" for x in (25, 50, 75)},
}


@styled
def sheet_figure(batch: Batch) -> Figure:
    """One A4 page: a table of populations, the most unusual specimens, and what the diagnosis found."""
    figure = Figure(figsize=A4, layout=None)
    figure.text(0.08, 0.955, f"{len(batch.finished) + len(batch.failures)} specimens", size="xx-large", weight="bold")
    head = f"{len(batch.finished)} finished, {len(batch.failures)} failed · {date.today()} · bayes-iwan {__version__}"
    figure.text(0.08, 0.935, head)
    said = "\n".join(fill(x, 100) for x in _said(batch))
    figure.text(0.08, 0.90, said, va="top", linespacing=1.5)
    top = 0.87 - LINE * (said.count("\n") + 1)
    rows = _table(figure.add_axes((0.08, top - 0.1, 0.84, 0.1)), batch)
    top -= ROW * (rows + 1) + 0.05
    high = min(0.03 + ROW * len(batch.unusual[:SPECIMENS]), top - 0.07)
    _ranking(figure.add_axes((0.30, top - high, 0.62, high)), batch)
    return figure


def _said(batch: Batch) -> list[str]:
    failed = [shorten(f"Failed: {name}: {reason}", 100) for name, reason in list(batch.failures.items())[:NAMED]]
    if not batch.finished:
        return failed
    odd = [x for x in batch.unusual if x.notable]
    labels = {q: WORDS.get(q, batch.label(q)) for q in batch.populations}
    out = [
        f"Unusual: {x.name}, in {', '.join(labels[q] for q in x.notable[:4])}"
        + (f" and {len(x.notable) - 4} more" if len(x.notable) > 4 else "")
        + "."
        for x in odd[:NAMED]
    ] or ["No specimen stands out from the others."]
    if len(odd) > NAMED:
        out.append(f"{len(odd) - NAMED} more are unusual; see batch.html.")
    causes = Counter(x.cause.replace("_", " ") for x in batch.finished if x.cause is not None)
    if causes:
        out.append("Causes found: " + ", ".join(f"{c} ({n})" for c, n in causes.most_common(5)) + ".")
    gaps = [x.gap_share for x in batch.finished if x.gap_share is not None]
    if gaps:
        worst = f"{100 * np.median(gaps):.2g} % of the friction force (median), at most {100 * max(gaps):.2g} %"
        out.append(f"Gap beyond noise: {worst}.")
    if late := [x.name for x in batch.finished if x.converged is False]:
        out.append(f"Not converged, intervals too narrow: {', '.join(late[:NAMED])}.")
    return out + failed


def _table(ax: Axes, batch: Batch) -> int:
    """Draw it; how many rows it has below its head."""
    ax.axis("off")
    rows = []
    # a customer knows no symbols; with a simulator of one's own there are no words for them
    known = {q: f"{WORDS[q]}, {batch.label(q)}" for q in batch.populations if q in WORDS}
    for q in list(known or batch.populations)[:QUANTITIES]:
        p = batch.populations[q]
        times, unit = batch.spread_unit(q)
        spread = f"{times * p.spread[0]:.2g} {unit}"
        low, high = p.next_specimen
        typical = "{} [{}, {}]".format(*in_interval(*p.typical))
        further = f"{number(low, high - low)} to {number(high, high - low)}"
        said = [typical, spread, further] if not p.doubt else [p.doubt, "", ""]
        rows.append([known.get(q, batch.label(q)), *said])
    if not rows:
        ax.text(0.0, 1.0, "Fewer than three specimens determine any quantity.", va="top")
        return 0
    table = ax.table(
        rows,
        colLabels=["quantity", "typical specimen [90 %]", "spread", "90 % of further ones"],
        loc="upper left",
        cellLoc="left",
        colWidths=[0.43, 0.26, 0.1, 0.21],
        edges="horizontal",
    )
    table.auto_set_font_size(False)
    for cell in table.get_celld().values():
        cell.set_height(ROW / 0.1)
        cell.get_text().set_fontsize("small")
    return len(rows)


def _ranking(ax: Axes, batch: Batch) -> None:
    shown = batch.unusual[:SPECIMENS]
    if not shown:
        ax.axis("off")
        return
    draw_unusual(ax, shown)
    ax.set_yticks(ax.get_yticks(), [x.name[:28] for x in shown], size="small")
    more = f" (the first {SPECIMENS} of {len(batch.unusual)})" if len(batch.unusual) > SPECIMENS else ""
    ax.set_xlabel(f"robust distance from the others, 1 for a usual one{more}; orange: unusual")


@house_style()
def write_sheet(batch: Batch, path: Path) -> Path:
    """The page as PDF."""
    return save(sheet_figure(batch), path)
