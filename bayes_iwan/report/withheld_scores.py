"""A scored set of answers as files: table, JSON and figures."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bayes_iwan.diagnosis.answer.saved_fits import find_shares
from bayes_iwan.files import write_json, write_whole
from bayes_iwan.report.axes import numbered_cells
from bayes_iwan.report.style import BLUE, ORANGE, PRIOR, save, styled
from bayes_iwan.withheld.estimates import Estimate, binned
from bayes_iwan.withheld.metrics import SHARE_POINTS, confusion, reliability
from bayes_iwan.withheld.scoring import Score, score


@styled
def confusion_figure(score: Score) -> Figure:
    """Truth (rows) against what was named (columns), cases of at most one cause; right answers on outlined squares."""
    rows, columns, counts = confusion(score.cases)
    fig = Figure(figsize=(2.6 + 0.36 * len(columns), 2.4 + 0.32 * len(rows)), layout="constrained")
    ax = fig.add_subplot()
    totals = counts.sum(axis=1)
    right = np.array(rows)[:, None] == np.array(columns)
    numbered_cells(
        ax, counts / np.maximum(totals, 1)[:, None], [[f"{n:.0f}" if n else "" for n in row] for row in counts],
        [f"{r.replace('_', ' ')} ({n:.0f})" for r, n in zip(rows, totals)], columns, right,
        cmap="Blues", vmin=0, vmax=2,
    )  # fmt: skip
    for i, j in np.argwhere(right):
        ax.add_patch(Rectangle((j, i), 1, 1, fill=False, edgecolor=ORANGE, linewidth=1.2))
    ax.set_xticks(ax.get_xticks(), [c.replace("_", " ") for c in columns], rotation=60, ha="right")
    ax.set_title("Cases of at most one cause; outlined: right")
    ax.set(xlabel="verdict", ylabel="truth (cases)")
    return fig


def _shares(
    ax: Axes, points: Sequence[tuple[float, Estimate]], label: str, colour: str, shift: float = 1.0,
    counts: bool = True,
) -> None:  # fmt: skip
    if not points:
        return
    x, value, low, high = np.array([(shift * at, e.value, e.low, e.high) for at, e in points]).T
    ax.errorbar(x, value, [value - low, high - value], fmt="o", color=colour, capsize=3, ms=5, label=label)
    for at, end, (_, found) in zip(x, high, points if counts else ()):
        ax.annotate(
            f"{found.n}", (at, end), textcoords="offset points", xytext=(0, 3), ha="center", size="small", color=colour
        )


@styled
def reliability_figure(score: Score) -> Figure:
    """Probability stated of each cause named against how often it was there, and how often each was stated."""
    fig = Figure(figsize=(5, 5.4), layout="constrained")
    top, bottom = fig.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    top.plot([0, 1], [0, 1], color=PRIOR, lw=1, label="stated = found")
    _shares(top, reliability(score.cases), "share true, 95 % interval, causes named", BLUE)
    top.set(ylim=(0, 1.08), ylabel="share of named causes that are there")
    top.legend(loc="upper left")
    stated = [m.stated for c in score.cases if c.answered for m in c.stated]
    bottom.hist(stated, bins=np.linspace(0, 1, 21).tolist(), color=BLUE)
    bottom.set(xlabel="stated probability that a cause contributes", ylabel="causes", xlim=(0, 1))
    return fig


@styled
def accuracy_figure(score: Score) -> Figure:
    """Share of effects found against the visible part of their size over the noise: alone, and among others."""
    fig = Figure(figsize=(8.4, 4), layout="constrained")
    panels = (
        ("single effects", [(c, k) for c in score.cases if c.kind == "single" for k in c.truth.listed]),
        ("effects beside others", [(c, k) for c in score.cases if len(c.truth.causes) > 1 for k in c.truth.listed]),
    )
    for ax, (title, all_parts) in zip(fig.subplots(1, 2, sharey=True), panels):
        parts = [(c, k) for c, k in all_parts if c.truth.noise > 0 and k.visible > 0]
        ax.set_title(f"{title} ({len(parts)})")
        ax.set(xlabel="visible part of the size over noise", ylim=(0, 1.1))
        if not parts:
            continue
        values = [k.visible / c.truth.noise for c, k in parts]
        edges = np.quantile(values, np.linspace(0, 1, 6)).tolist()
        named = [k.name in c.answer.names for c, k in parts]
        in_set = [k.name in c.answer.in_sets for c, k in parts]
        _shares(ax, binned(values, named, edges), "named", BLUE, 0.975)
        _shares(ax, binned(values, in_set, edges), "named or in a set", ORANGE, 1.025, False)
        ax.set_xscale("log")
        ax.axvline(1.0, color=PRIOR, ls="--", lw=1)
        ax.legend(loc="lower right")
    fig.axes[0].set_ylabel("share found")
    return fig


@styled
def share_figure(score: Score) -> Figure:
    """Share of the gap that each true cause was said to make, with its interval, against the share it makes."""
    parts = [(c, named, true) for c in score.cases for named, true in c.shares]
    fig = Figure(figsize=(5, 4.8), layout="constrained")
    ax = fig.add_subplot()
    reach = np.array([0.0, 100.0])
    ax.fill_between(reach, reach - 100 * SHARE_POINTS, reach + 100 * SHARE_POINTS, color="#DDDDDD", lw=0)
    ax.plot(reach, reach, color=PRIOR, lw=1, label="stated = true; band: ±10 points")
    for alone, colour, label in ((True, BLUE, "the only cause"), (False, ORANGE, "one of several")):
        some = [(n, t) for c, n, t in parts if (len(c.truth.causes) == 1) == alone]
        for n, t in some:
            ax.plot([100 * t] * 2, [100 * n.share_low, 100 * n.share_high], color=colour, lw=0.8, alpha=0.5)
        ax.plot(
            [100 * t for _, t in some], [100 * n.share for n, _ in some], "o", color=colour, ms=5, alpha=0.8,
            label=f"{label} ({len(some)})",
        )  # fmt: skip
    ax.set(xlabel="true share of the gap, %", ylabel="stated share with its 90 % interval, %")
    ax.legend()
    return fig


def figures(score: Score) -> dict[str, Figure]:
    """All figures by file stem."""
    out = {"confusion": confusion_figure(score), "reliability": reliability_figure(score)}
    return out | {"accuracy": accuracy_figure(score), "shares": share_figure(score)}


def write_score(
    directory: str | Path,
    truth: str | Path,
    *,
    answers: str | Path | None = None,
    out: str | Path | None = None,
    allow_effects_file: bool = False,
    excluded: Sequence[str] = (),
) -> str:
    """Check the seals, score, write `score.txt`, `score.json` and figures into `out` if given; returns the table and,
    case by case, what was true and what was said."""
    result = score(
        directory, truth, answers=answers, find_shares=partial(find_shares, allow_own_files=allow_effects_file),
        allow_effects_file=allow_effects_file, excluded=excluded,
    )  # fmt: skip
    table = result.table() + "\n\n" + result.case_table()
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "score.txt", table + "\n")
        write_json(folder / "score.json", result.as_dict())
        for name, figure in figures(result).items():
            for kind in ("png", "svg"):
                save(figure, folder / f"{name}.{kind}")
    return table
