"""batch.html: many specimens on one page, their quantities, the population, causes, outliers, failures."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_iwan.comparison.unusual import Unusual
from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.models import Model
from bayes_iwan.models.iwan_parameters import default_parameters
from bayes_iwan.report.batch.specimens import Batch, Finished
from bayes_iwan.report.identification.marginals import in_interval, number
from bayes_iwan.report.identification.summary import QUANTILES
from bayes_iwan.report.page import Finding, Page, Provenance, Section, asset
from bayes_iwan.report.style import MEASURED, MODEL, ORANGE, house_style, one_panel, styled, subplots

#: specimens that are named along the axis; of more, every n-th is
NAMED = 40
#: specimens that the ranking shows
RANKED = 30


class BatchSection(Section[Batch]):
    template = "batch.html"


class Answer(BatchSection):
    """What finished, who is unusual, what the model misses, which causes were found; the population."""

    heading, ranked = "Answer", RANKED

    @property
    def found(self) -> list[Finding]:
        result = self.r
        done, failed = len(result.finished), len(result.failures)
        found = [Finding(f"{done} finished, {failed} failed.", not failed)]
        odd = [x for x in result.unusual if x.notable]
        for x in odd[:12]:
            named = ", ".join(result.label(q) for q in x.notable[:5])
            more = f" and {len(x.notable) - 5} more" if len(x.notable) > 5 else ""
            found.append(Finding(f"{x.name} is unusual (distance {x.distance:.1f}): {named}{more}."))
        if len(odd) > 12:
            found.append(Finding(f"{len(odd) - 12} more are unusual."))
        if result.unusual and not odd:
            found.append(Finding("No specimen stands out from the others.", True))
        if late := [x.name for x in result.finished if x.converged is False]:
            found.append(Finding(f"Not converged, so that their intervals are too narrow: {', '.join(late)}."))
        if any(x.quantities and x.converged is None for x in result.finished):
            found.append(Finding("Quick: intervals are those of first draws, not asked whether they have converged."))
        if large := [(x.name, x.gap_share) for x in result.finished if (x.gap_share or 0.0) > LARGE_RESIDUAL]:
            named = ", ".join(f"{name} ({100 * (share or 0.0):.2g} %)" for name, share in large[:8])
            text = f"The model misses more than {100 * LARGE_RESIDUAL:.0f} % of the friction force of {named}."
            found.append(Finding(text))
        causes = Counter(_cause(x) for x in result.finished if x.cause is not None)
        if causes:
            gaps = [x.gap_share for x in result.finished if x.gap_share is not None]
            size = f" The gap is {100 * np.median(gaps):.2g} % of the friction force in the median." if gaps else ""
            text = "Causes found: " + ", ".join(f"{c} ({n})" for c, n in causes.most_common(6)) + "." + size
            found.append(Finding(text, set(causes) <= {"none"}, "Causes found"))
        if ends := [f"{result.label(q)} ({p.open_end})" for q, p in result.populations.items() if p.open_end]:
            text = f"One end is not set by the loops of most specimens, so no band is given: {', '.join(ends)}."
            found.append(Finding(text))
        if poor := [result.label(q) for q, p in result.populations.items() if p.doubt and not p.open_end]:
            text = f"A normal population does not fit {', '.join(poor)}, so no band is given: look for lots."
            found.append(Finding(text))
        return found

    def unusual(self) -> Figure | None:
        return unusual_figure(self.r) if self.r.unusual else None

    def populations(self) -> Sequence[tuple[object, ...]]:
        rows = []
        for name, p in self.r.populations.items():
            times, unit = self.r.spread_unit(name)
            spread = "{} [{}, {}]".format(*in_interval(*(times * v for v in p.spread))) + f" {unit}"
            typical = "{} [{}, {}]".format(*in_interval(*p.typical))
            low, high = p.next_specimen
            further = f"{number(low, high - low)} to {number(high, high - low)}"
            said = (typical, spread, further) if not p.doubt else (p.doubt, "", "")
            rows.append((self.r.label(name), len(p.names), *said, f"{p.fits():.2g}"))
        return rows

    def legend(self) -> list[tuple[str, str, str]]:
        """Meaning and unit of the Iwan model's symbols among the labels; a user's own model's are in its report."""
        scales = Scales(*[1.0] * 6)
        known = {q.symbol: q.description for q in default_parameters(Model(scales.reference), scales)}
        known |= {symbol: meaning for symbol, meaning, _ in QUANTILES}
        labels = {q.label: q.unit for x in self.r.finished for q in x.quantities.values()}
        found = {label.partition(" (")[0]: unit for label, unit in labels.items()}
        return [(symbol, known[symbol], unit) for symbol, unit in found.items() if symbol in known]


class Parameters(BatchSection):
    heading = "Parameters against specimen"

    def draw(self) -> Figure:
        return parameters_figure(self.r)


class Lots(BatchSection):
    def __init__(self, r: Batch) -> None:
        super().__init__(r, heading=f"Lots, by {r.group}")

    @property
    def sizes(self) -> str:
        sizes = Counter(self.r.lots.get(x.name, "") for x in self.r.finished)
        return ", ".join(f"{lot or 'no lot'} ({n})" for lot, n in sorted(sizes.items()))

    def rows(self) -> Sequence[tuple[object, ...]]:
        rows = []
        for d in self.r.differences():
            says = "differ" if not d.low <= d.relative <= d.high else "–"
            name = f"{self.r.label(d.quantity)}: {d.a} {'/' if d.relative else '−'} {d.b}"
            rows.append((name, f"{d.median:.4g}", f"{d.low:.4g} to {d.high:.4g}", f"{d.larger:.3f}", says))
        return rows


class Causes(BatchSection):
    heading = "Causes found"

    def rows(self) -> Sequence[tuple[object, ...]]:
        which: dict[str, list[Finished]] = {}
        for x in self.r.finished:
            if x.cause is not None:
                which.setdefault(_cause(x), []).append(x)
        rows = []
        for cause, some in sorted(which.items(), key=lambda kv: -len(kv[1])):
            gaps = [100 * x.gap_share for x in some if x.gap_share is not None]
            rows.append((cause, len(some), f"{np.median(gaps):.2g}" if gaps else "–", ", ".join(x.name for x in some)))
        return rows


class Values(BatchSection):
    heading = "Values of every specimen"

    @property
    def unusable(self) -> int:
        return sum(not s.usable for found in self.r.shrunk.values() for s in found.values())

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Columns and rows."""
        names, ranked = self.r.quantities(), {x.name: x for x in self.r.unusual}
        group = [self.r.group] if self.r.group else []
        rows = []
        for x in self.r.finished:
            odd = ranked.get(x.name)
            row = [x.name, *([self.r.lots.get(x.name, "–")] if group else [])]
            row += ["–" if odd is None else f"{odd.distance:.1f}", _gap(x)]
            for q in names:
                have, lot = x.quantities.get(q), self.r.shrunk.get(q, {}).get(x.name)
                text = "–" if have is None else f"{number(have.median, have.high - have.low)}"
                if have is not None and lot is not None and lot.usable:
                    text += f" ({number(lot.q50, lot.q95 - lot.q05)})"
                row.append(text)
            rows.append(row)
        return ["specimen", *group, "distance", "gap (%)", *map(self.r.label, names)], rows


class Specimens(BatchSection):
    heading = "Specimens"

    def rows(self) -> Sequence[tuple[object, ...]]:
        rows = []
        for x in self.r.finished:
            links = [_link(x.name, "report.html", "report")] if x.quantities else []
            links += [_link(x.name, "diagnosis.html", "diagnosis")] if x.cause is not None else []
            cause = "–" if x.cause is None else f"{_cause(x)} ({x.probability or 0.0:.2f})"
            rows.append((x.name, Markup(" · ").join(links), x.message or "–", _gap(x), cause, f"{x.seconds:.0f}"))
        return rows


def _link(name: str, file: str, text: str) -> Markup:
    return Markup('<a href="specimens/{}/{}">{}</a>').format(quote(name), file, text)


def _gap(x: Finished) -> str:
    return "–" if x.gap_share is None else f"{100 * x.gap_share:.2g}"


def _cause(x: Finished) -> str:
    return (f"{x.cause} + {x.second_cause}" if x.second_cause else str(x.cause)).replace("_", " ")


@house_style()
def write_batch_page(result: Batch, out: Path, made: Provenance) -> Path:
    """The page across specimens; returns its path. made : from what and when."""
    page = Page(
        f"{len(result.finished) + len(result.failures)} specimens",
        footer="The numbers of this page are in batch.csv (and batch.xlsx), the reasons of failures in failures.csv; "
        "sheet.pdf is one page for a customer.",
        made=made,
    )
    page.script(asset("sort.js"))
    sections = {
        Answer: True,
        Parameters: bool(result.quantities()),
        Lots: bool(result.lot_populations),
        Causes: any(x.cause is not None for x in result.finished),
        Values: bool(result.quantities()),
        Specimens: True,
    }
    page.add(*(section(result) for section, shown in sections.items() if shown))
    return page.write(out / "batch.html")


@styled
def unusual_figure(result: Batch) -> Figure:
    """Every specimen by its robust distance from the others."""
    shown = result.unusual[:RANKED]
    figure, ax = one_panel(6.4, 0.19 * len(shown) + 0.9)
    draw_unusual(ax, shown)
    ax.set_xlabel("robust distance")
    return figure


def draw_unusual(ax: Axes, shown: Sequence[Unusual]) -> None:
    """Bars of some specimens' distances, the first on top; those that stand out in orange."""
    at = np.arange(len(shown))
    ax.barh(at, [x.distance for x in shown], color=[ORANGE if x.notable else MODEL for x in shown], height=0.65)
    ax.axvline(1.0, color=MEASURED, linewidth=0.8, linestyle=":")
    ax.set_yticks(at, [x.name for x in shown])
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.grid(axis="y", visible=False)


@styled
def parameters_figure(result: Batch) -> Figure:
    """Each quantity against specimen: intervals over the population's band."""
    names = result.quantities()
    specimens = [x.name for x in result.finished]
    wide = float(np.clip(0.16 * len(specimens) + 1.5, 4.0, 11.0))
    figure, axes = subplots(len(names), 1, wide, 1.25 * len(names) + 0.8, sharex=True)
    outliers = result.outliers()
    for ax, name in zip(axes[:, 0], names):
        if name in result.populations and not result.populations[name].doubt:
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
