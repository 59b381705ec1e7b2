"""Figures of a scored set of answers, each a function that returns a matplotlib figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_iwan.validation.estimates import Estimate, binned
from bayes_iwan.validation.scoring import CaseScore, Score, confusion, reliability

_BLUE, _ORANGE, _GREY = "#2266aa", "#cc6611", "#888888"


def confusion_figure(score: Score) -> Figure:
    """Truth (rows) against verdict (columns), counts; right answers on outlined squares."""
    rows, columns, counts = confusion(score.cases)
    fig = Figure(figsize=(2.6 + 0.36 * len(columns), 2.4 + 0.32 * len(rows)), layout="constrained")
    ax = fig.add_subplot()
    totals = counts.sum(axis=1, keepdims=True)
    ax.imshow(counts / np.maximum(totals, 1), cmap="Blues", vmin=0, vmax=1.3, aspect="auto")
    for (i, j), n in np.ndenumerate(counts):
        if n:
            right = rows[i] == columns[j]
            ax.text(j, i, f"{n:.0f}", ha="center", va="center", fontsize=9, fontweight="bold" if right else "normal",
                    color="white" if n > 0.8 * totals[i, 0] else "black")  # fmt: skip
    for i, row in enumerate(rows):
        j = columns.index(row)
        ax.plot(
            [j - 0.5, j + 0.5, j + 0.5, j - 0.5, j - 0.5], [i - 0.5, i - 0.5, i + 0.5, i + 0.5, i - 0.5],
            color=_ORANGE, lw=1.2,
        )  # fmt: skip
    ax.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=60, ha="right")
    ax.set_yticks(range(len(rows)), [f"{r.replace('_', ' ')} ({n:.0f})" for r, n in zip(rows, totals[:, 0])])
    ax.set_xlabel("verdict")
    ax.set_ylabel("truth (cases)")
    ax.set_title("Cases with one truth; outlined: right", fontsize=10)
    ax.tick_params(labelsize=8)
    return fig


def _shares(
    ax: Axes, points: Sequence[tuple[float, Estimate]], label: str, colour: str, shift: float = 1.0,
    counts: bool = True,
) -> None:  # fmt: skip
    for i, (x, found) in enumerate(points):
        value, low, high = found.value, found.low, found.high
        ax.errorbar(
            [x * shift], [value], [[value - low], [high - value]], fmt="o", color=colour, capsize=3, ms=5,
            label=label if i == 0 else None,
        )  # fmt: skip
        if not counts:
            continue
        ax.annotate(
            f"{found.n}", (x * shift, high), textcoords="offset points", xytext=(0, 3), ha="center",
            fontsize=7, color=colour,
        )  # fmt: skip


def reliability_figure(score: Score) -> Figure:
    """Stated probability of the verdict against how often it was right, and how often each was stated."""
    one = [c for c in score.cases if len(c.labels) == 1]
    fig = Figure(figsize=(5, 5.4), layout="constrained")
    top, bottom = fig.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    top.plot([0, 1], [0, 1], color=_GREY, lw=1, label="stated = found")
    _shares(top, reliability(score.cases), "share right, 95 % interval, cases", _BLUE)
    top.set_ylim(0, 1.08)
    top.set_ylabel("share of verdicts that were right")
    top.legend(loc="upper left", fontsize=8, frameon=False)
    bottom.hist([c.stated for c in one], bins=np.linspace(0, 1, 21).tolist(), color=_BLUE)
    bottom.set_xlabel("stated probability of the verdict")
    bottom.set_ylabel("cases")
    bottom.set_xlim(0, 1)
    return fig


def _sized(cases: Sequence[CaseScore]) -> list[CaseScore]:
    return [c for c in cases if c.kind == "single" and np.isfinite(c.size) and c.size > 0]


def accuracy_figure(score: Score, bins: int = 5) -> Figure:
    """Share of single effects found, against their size over friction, over noise, and as far as visible."""
    sized = _sized(score.cases)
    noisy = [c for c in sized if c.noise > 0]
    visible = [c for c in noisy if c.visible > 0]
    panels = [
        (sized, [100 * c.size for c in sized], "size, % of RMS friction force", score.findable_size, 100),
        (noisy, [c.size / c.noise for c in noisy], "size over noise", score.findable_to_noise, 1),
        (visible, [c.visible / c.noise for c in visible], "visible part of the size over noise",
         score.findable_visible, 1),
    ]  # fmt: skip
    panels = [p for p in panels if p[0]]
    fig = Figure(figsize=(4.2 * max(len(panels), 1), 4), layout="constrained")
    if not panels:
        fig.text(0.5, 0.5, "no single effects of known size", ha="center")
        return fig
    axes = fig.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (cases, values, text, found, scale) in zip(axes, panels):
        edges = np.quantile(values, np.linspace(0, 1, bins + 1)).tolist()
        right = [c.right for c in cases]
        top3 = [c.labels[0] in c.top3 for c in cases]
        _shares(ax, binned(values, right, edges), "first answer right (cases)", _BLUE, 0.975)
        _shares(ax, binned(values, top3, edges), "among the three most probable", _ORANGE, 1.025, False)
        ax.set_xscale("log")
        ticks = [t for t in (0.1, 0.3, 1, 2, 4, 6, 10, 20, 30, 50, 100) if 0.9 * min(values) < t < 1.1 * max(values)]
        ax.set_xticks(ticks, [str(t) for t in ticks], minor=False)
        ax.set_xticks([], minor=True)
        ax.set_xlabel(text)
        ax.set_ylim(0, 1.1)
        most = found[0.8].value * scale
        if np.isfinite(most):
            ax.axvline(most, color=_GREY, ls="--", lw=1)
            ax.annotate("80 % found", (most, 0.02), fontsize=7, color=_GREY, rotation=90, ha="right")
    axes[0].set_ylabel("share of cases")
    axes[0].legend(fontsize=8, frameon=False, loc="lower right")
    return fig


def shrink_figure(score: Score) -> Figure:
    """Shrink that was predicted against shrink found on tests that no diagnosis saw."""
    cases = [c for c in score.cases if np.isfinite(c.shrink_predicted) and np.isfinite(c.shrink_found)]
    fig = Figure(figsize=(5, 4.8), layout="constrained")
    ax = fig.add_subplot()
    low = 100 * min([0.0, *(c.shrink_found for c in cases), *(c.shrink_predicted for c in cases)])
    low = max(low, -100.0)  # one disaster must not squeeze the rest into a corner
    ax.plot([low, 100], [low, 100], color=_GREY, lw=1, label="predicted = found")
    for hit, colour, label in ((True, _BLUE, "right cause"), (False, _ORANGE, "wrong cause")):
        some = [c for c in cases if c.right == hit]
        ax.plot(
            [100 * c.shrink_predicted for c in some], [max(100 * c.shrink_found, low) for c in some], "o",
            color=colour, ms=5, alpha=0.8, label=f"{label} ({len(some)})",
        )  # fmt: skip
    ax.axhline(0, color=_GREY, lw=0.5)
    ax.set_xlabel("predicted shrink of the gap, %")
    ax.set_ylabel("shrink found on unseen tests, %")
    ax.legend(fontsize=8, frameon=False)
    return fig


def size_error_figure(score: Score) -> Figure:
    """Error of each effect's size in posterior standard deviations, by effect."""
    cases = [c for c in score.cases if np.isfinite(c.size_error)]
    names = sorted({c.labels[0] for c in cases}, reverse=True)
    fig = Figure(figsize=(7, 1.6 + 0.28 * max(len(names), 1)), layout="constrained")
    ax = fig.add_subplot()
    ax.axvspan(-2, 2, color="#dde6f0", zorder=0)
    ax.axvspan(-1, 1, color="#c3d4e8", zorder=0)
    for c in cases:
        y = names.index(c.labels[0])
        ax.plot(
            [np.clip(c.size_error, -8, 8)], [y], "<" if c.size_error < -8 else ">" if c.size_error > 8 else "o",
            color=_BLUE if c.right else _ORANGE, ms=5, alpha=0.8,
        )  # fmt: skip
    for colour, label in ((_BLUE, "cause right"), (_ORANGE, "another cause named")):
        ax.plot([], [], "o", color=colour, ms=5, label=label)
    ax.set_yticks(range(len(names)), [n.replace("_", " ") for n in names])
    ax.set_xlim(-8.4, 8.4)
    ax.set_xlabel("(found − true) / posterior sd; bands ±1, ±2; arrows: beyond ±8")
    ax.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2)
    ax.set_ylim(-0.6, max(len(names), 1) - 0.4)
    return fig


def figures(score: Score) -> dict[str, Figure]:
    """All figures by file stem."""
    return {
        "confusion": confusion_figure(score),
        "reliability": reliability_figure(score),
        "accuracy": accuracy_figure(score),
        "shrink": shrink_figure(score),
        "size_error": size_error_figure(score),
    }
