"""The page and figures of a comparison of model families."""

import os
from dataclasses import astuple
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.comparison.families import DECIDES, LEAST, Comparison
from bayes_iwan.report.axes import numbered_cells
from bayes_iwan.report.page import Finding, Page, Section, Table, provenance
from bayes_iwan.report.style import BLUE, ORANGE, house_style, on_phone, one_panel, styled, subplots


@styled
def ranking_figure(comparison: Comparison) -> Figure:
    """Differences of expected log predictive density from the best family, with standard errors; residual shares."""
    rows = comparison.rows()
    n = len(rows)
    beside = {} if on_phone() else {"sharey": True, "width_ratios": (1.5, 1)}
    figure, axes = subplots(1, 2, 7.6, 0.32 * n + 1.2, **beside)
    left, right = axes[0]
    at = np.arange(n)
    left.axvline(0.0, color="#777777", linewidth=0.7)
    difference, error = [r.difference for r in rows], [r.difference_se for r in rows]
    left.errorbar(difference, at, xerr=error, fmt="o", color=BLUE, elinewidth=1.2, markersize=4.5)
    spread = abs(min(difference))
    if spread > 1500.0:  # poor families would squeeze the good ones into one point
        left.set_xscale("symlog", linthresh=10.0)
        left.set_xlim(-1.8 * spread, 10.0)
        ticks = [0.0, *(-(10.0**k) for k in range(1, int(np.log10(spread)) + 1))]
        left.set_xticks(ticks, ["0", *(f"−{-t:,.0f}".replace(",", " ") for t in ticks[1:])])
        left.minorticks_off()
    for ax in (left, right) if on_phone() else (left,):
        ax.set_yticks(at, [fill(r.label, 22) if on_phone() else r.label for r in rows])
        ax.set_ylim(n - 0.4, -0.6)
    left.set_xlabel("difference of expected log\npredictive density ± SE")
    shares = [100.0 * r.residual_share for r in rows]
    right.barh(at, shares, color=ORANGE, height=0.55)
    for i, share in enumerate(shares):
        right.text(share, i, f" {share:.2g} %", va="center", size="small")
    right.set(xlim=(0.0, 1.25 * max(shares)), xlabel="RMS residual /\nRMS friction force (%)")
    right.grid(axis="y", visible=False)
    return figure


@styled
def tests_figure(comparison: Comparison) -> Figure:
    """Where families gain and lose: log predictive density of each test when it is held out, less the best family's."""
    entries = [e for e in comparison.entries if e.tests is not None]
    best = entries[0]
    files = [x.file.removesuffix(".gz").removesuffix(".csv") for x in best.posterior.problem.loops]
    pointwise = [e.tests.pointwise for e in entries if e.tests is not None]
    table = np.array(pointwise) - pointwise[0]
    figure, ax = one_panel(7.6, 0.36 * len(entries) + 1.4)
    reach = max(float(np.quantile(np.abs(table), 0.9)), 1.0)
    texts = [[f"{x:+.1f}".replace("-", "−") if i else "0" for x in row] for i, row in enumerate(table)]
    labels = [e.family.label for e in entries]
    numbered_cells(ax, table, texts, labels, files, cmap="PuOr", vmin=-reach, vmax=reach, alpha=0.6)
    ax.set_xticks(ax.get_xticks(), files, rotation=30, ha="right")
    return figure


def comparison_table(comparison: Comparison) -> Table:
    """The ranking for compare.csv."""
    columns = ("rank", "family", "label", "ranked_by", "elpd", "elpd_se", "difference", "difference_se", "elpd_loo",
               "loo_pareto_k_holds", "elpd_held_out_tests", "residual_share", "parameters", "seconds",
               "converged")  # fmt: skip
    ranked = enumerate(comparison.rows(), start=1)
    rows = tuple((i, r.name, r.label, comparison.by, *astuple(r)[2:]) for i, r in ranked)
    return Table("compare", columns, rows)


class ComparisonSection(Section[Comparison]):
    template, ranking, tests = "comparison.html", staticmethod(ranking_figure), staticmethod(tests_figure)


class Answer(ComparisonSection):
    """Which family predicts best, which are tied with it, and what the words mean."""

    heading = "Answer"

    @property
    def found(self) -> list[Finding]:
        rows = self.r.rows()
        best, *others = rows
        tied = [r.label for r in others if abs(r.difference) < max(DECIDES * r.difference_se, LEAST)]
        said = f"{best.label} predicts best and misses {100 * best.residual_share:.2g} % of the friction force."
        if tied:
            said += f" Tied with it on these tests: {', '.join(tied)}."
        elif others:
            worse = -others[0].difference
            said += f" Every other one predicts worse, the next ({others[0].label}) by {worse:.0f} nats."
        return [Finding(said[0].upper() + said[1:], True), *map(Finding, self.r.warnings())]


class Ranking(ComparisonSection):
    heading = "Ranking"

    def rows(self) -> list[tuple[object, ...]]:
        def signed(x: float) -> str:
            return "–" if not np.isfinite(x) else f"{x:+.1f}".replace("-", "−")

        rows: list[tuple[object, ...]] = []
        for i, r in enumerate(self.r.rows()):
            off = (signed(r.difference), f"{r.difference_se:.1f}") if i else ("0", "–")
            loo = signed(r.loo) + ("" if r.loo_holds else " (k too high)")
            share, seconds = f"{100 * r.residual_share:.2g} %", f"{r.seconds:.0f}"
            ended = "converged" if r.converged else "short"
            rows.append((r.label, *off, loo, signed(r.held_out), share, r.parameters, seconds, ended))
        return rows


@house_style()
def comparison_report(comparison: Comparison, out_dir: str | os.PathLike[str]) -> Path:
    """Write compare.html and compare.csv into out_dir; returns the page's path."""
    out, first = Path(out_dir), comparison.entries[0]
    comparison_table(comparison).write_csv(out)
    title = f"Model families compared: {'loops' if comparison.campaign is None else comparison.campaign.name}"
    subtitle = f"{len(comparison.entries)} families, ranked by expected log predictive density"
    made, units = provenance(comparison.campaign, first.posterior.seed), first.posterior.problem.units
    page = Page(title, subtitle, "The numbers of this page are in compare.csv.", units, made)
    page.add(Answer(comparison), Ranking(comparison))
    if comparison.answers():
        page.add(ComparisonSection(comparison, "Reasoning", "The paper's reasoning"))
    if first.tests is not None and len(comparison.entries) > 1:
        page.add(ComparisonSection(comparison, "WhereFamiliesLose", "Where families gain and lose"))
    return page.write(out / "compare.html")
