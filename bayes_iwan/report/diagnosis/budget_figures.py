"""Figures of a diagnosis' answer: the budget of the gap, the causes' probabilities, the residual with and without."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.answer.result import Moved
from bayes_iwan.diagnosis.answer.wording import title
from bayes_iwan.diagnosis.assessment.budget import GapBudget, OneOf
from bayes_iwan.diagnosis.constants import PROBABLE
from bayes_iwan.report.diagnosis.gap_figures import panel_a_test
from bayes_iwan.report.style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PRIOR,
    RED,
    SKY,
    blank,
    letters_on,
    narrow,
    one_panel,
    styled,
)


def _waterfall(ax: Axes, budget: GapBudget, one_of: Sequence[OneOf] = ()) -> None:
    """Bars from the gap down to the unexplained part, in percent of the gap; hatched, what of it one of several effects
    removes; the noise beside them for scale."""
    before = budget.before.rms_N
    rows: list[tuple[str, float, float, str, tuple[float, float] | None]] = [("gap", 0.0, 1.0, BLACK, None)]
    top = 1.0
    for c in budget.causes:
        rows.append((fill(title(c.name), 22), top - c.share.value, c.share.value, BLUE, (c.share.low, c.share.high)))
        top -= c.share.value
    share, colour = budget.unexplained.share, ORANGE if budget.unexplained.probability >= 0.5 else GREEN
    rows.append(("unexplained", 0.0, share.value, colour, (share.low, share.high) if budget.causes else None))
    hatched = []
    for x in one_of:
        some = f"{title(x.names[0])} or {title(x.names[1]) if len(x.names) == 2 else f'{len(x.names) - 1} others'}"
        hatched.append(len(rows))
        rows.append((fill(f"of it one of: {some}", 22), max(top - x.share, 0.0), min(x.share, top), SKY, None))
    if before > 0.0:
        rows.append(("noise", 0.0, budget.before.noise_N / before, PRIOR, None))
    y = np.arange(len(rows))[::-1]
    for i, (k, (_, left, width, colour, interval)) in enumerate(zip(y, rows)):
        (bar,) = ax.barh(k, min(width, 1.15), 0.62, left=left, color=colour)
        if i in hatched:
            bar.set(hatch="///", edgecolor="white", linewidth=0.0)
        text = f"{100 * width:.0f} %" + (f"  ({100 * interval[0]:.0f} to {100 * interval[1]:.0f})" if interval else "")
        text += ", longer than shown" if width > 1.15 else ""
        end = min(max(left + width, left), 1.15)
        if width >= 0.4 and i not in hatched:  # space inside the bar
            at, side, shift, colour = left, "left", 3, letters_on(colour)
        elif end > 0.62:
            at, side, shift, colour = left, "right", -3, "black"
        else:
            at, side, shift, colour = end, "left", 3, "black"
        ax.annotate(text, (at, k), xytext=(shift, 0), textcoords="offset points", va="center", ha=side, size="small",
                    color=colour)  # fmt: skip
    falls = 1 + len(budget.causes)
    for k, (_, left, _, _, _) in zip(y[1:falls], rows[1:falls]):
        ax.plot([left, left], [k - 1.31, k + 0.31], color="#8A8A8A", linewidth=0.6, zorder=0)
    ax.set_yticks(y, [r[0] for r in rows])
    ax.set_xlim(0.0, 1.18)
    ax.set_xticks(np.linspace(0, 1, 5), [f"{p} %" for p in (0, 25, 50, 75, 100)])
    ax.grid(axis="y", visible=False)


@dataclass(frozen=True)
class CycleResidual:
    """Residual along a cycle, (n,) each, N: by the model alone, by one with the causes (None: none is named), and
    what a right model would leave (sd). name : of the test, and of the cycles where it is not their average."""

    name: str
    before_N: Array
    after_N: Array | None
    expected_N: Array


@styled
def headline_figure(
    budget: GapBudget, shown: Sequence[CycleResidual], causes: str, one_of: Sequence[OneOf] = ()
) -> Figure:
    """The answer in one picture: the budget, and where the gap shows most the residual with and without the named
    causes: one average cycle, or two that are apart in the record, one below the other."""
    small, n = narrow(), len(shown)
    height = 2.4 * (n + 1) if small else 2.8 if n == 1 else 3.6
    figure = blank(7.8, height, "constrained")
    grid = figure.add_gridspec(n + 1, 1) if small else figure.add_gridspec(n, 2, width_ratios=[1.05, 1.2])
    ax = figure.add_subplot(grid[0, 0] if small else grid[:, 0])
    _waterfall(ax, budget, one_of)
    ax.set_title("what makes the gap", loc="left")
    right: list[Axes] = []
    for i, one in enumerate(shown):
        first = right[0] if right else None
        place = grid[i + 1, 0] if small else grid[i, 1]
        right.append(_cycle_residual(figure.add_subplot(place, sharex=first, sharey=first), one, causes))
    right[0].set_title(f"where it shows most:{chr(10) if small else ' '}{shown[0].name}", loc="left")
    for below, one in zip(right[1:], shown[1:]):
        below.set_title(one.name, loc="left")
    right[-1].set_xlabel("phase of the cycle")
    low, high = right[0].get_ylim()
    if len(shown) == 1:
        right[0].set_ylim(low, high + 0.5 * (high - low))
        right[0].legend(loc="upper left")
        right[0].set_ylabel("measured − model (N)")
    else:
        for above in right[:-1]:
            above.tick_params(labelbottom=False)
        key = right[0].get_legend_handles_labels()
        figure.legend(*key, loc="outside lower right", ncols=2 if small else 3)
        right[-1].set_ylabel("measured − model (N)", y=1.1)
    return figure


def _cycle_residual(ax: Axes, one: CycleResidual, causes: str) -> Axes:
    """One cycle's residual with and without the causes over what a right model leaves."""
    phase, band = np.arange(len(one.before_N)) / len(one.before_N), 2 * one.expected_N
    ax.fill_between(phase, -band, band, color="#DDDDDD", linewidth=0, label="a right model leaves (2 sd)")
    ax.plot(phase, one.before_N, color=RED, linestyle=(0, (5, 1.5)), label="model alone")
    if one.after_N is not None:
        ax.plot(phase, one.after_N, color=BLUE, label=fill(f"with {causes}", 24 if narrow() else 40))
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "1"])
    return ax


@styled
def shares_figure(budget: GapBudget) -> Figure:
    """Share of the gap that each named cause removes, on the fitted tests and on held-out tests."""
    causes = budget.causes
    figure, ax = one_panel(6.2, 0.42 * len(causes) + 1.1)
    y = np.arange(len(causes))[::-1]
    least = 0.0
    for i, (k, c) in enumerate(zip(y, causes)):
        ax.plot([c.share.low, c.share.high], [k + 0.12] * 2, color=BLUE, linewidth=2.2)
        ax.plot(c.share.value, k + 0.12, "o", color=BLUE, label=None if i else "on the fitted tests")
        if c.held_out is not None:
            ax.plot([c.held_out.low, c.held_out.high], [k - 0.14] * 2, color=RED, linewidth=1.2)
            ax.plot(c.held_out.value, k - 0.14, "D", color=RED, markerfacecolor="white", markersize=5)
            least = min(least, c.held_out.low)
    if any(c.held_out is not None for c in causes):
        ax.plot([], [], "D", color=RED, markerfacecolor="white", label="on held-out tests of the fit")
    ax.axvline(0.0, color=BLACK, linewidth=0.6)
    ax.set_yticks(y, [c.name.replace("_", " ") for c in causes])
    ax.set(
        ylim=(-0.7, len(causes) - 0.4),
        xlim=(min(-0.05, 1.05 * least), 1.03),
        xlabel="share of the gap that it removes, with 90 % intervals",
    )
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@styled
def probabilities_figure(probabilities: Mapping[str, float], named: Sequence[str] = (), most: int = 10) -> Figure:
    """Probability that each effect contributes, that none does, and that the unexplained part has a cause without a
    name."""
    ranked = sorted(probabilities.items(), key=lambda x: -x[1])
    always = {"none": "none: the model suffices", "unknown": "unknown: something else is there"}
    always |= {"drive": "the drive: no cause found"}
    keep = [x for x in ranked if x[0] in always or x[1] >= 0.005][:most]
    keep += [x for x in ranked if x[0] in always and x not in keep]
    figure, ax = one_panel(6.2, 0.3 * len(keep) + 0.8)
    y = np.arange(len(keep))[::-1]
    for k, (name, p) in zip(y, keep):
        colour = {"none": GREEN, "unknown": ORANGE, "drive": ORANGE}.get(name, BLUE if name in named else PRIOR)
        ax.barh(k, p, 0.68, color=colour, alpha=0.85, edgecolor="white")
        text = f"{p:.2f}" if p >= 0.005 else "< 0.01"
        ax.annotate(text, (p, k), xytext=(3, 0), textcoords="offset points", va="center", size="small")
    ax.set_yticks(y, [always.get(name, title(name)) for name, _ in keep])
    ax.set_xlim(0.0, 1.08)
    ax.set_xticks(np.linspace(0, 1, 6))
    ax.axvline(PROBABLE, color=BLACK, linewidth=0.6, linestyle=(0, (4, 2)))
    ax.set_xlabel(f"probability (named from {PROBABLE:g} on)")
    ax.grid(axis="y", visible=False)
    return figure


@styled
def before_after_figure(shown: Sequence[CycleResidual], causes: str) -> Figure:
    """Residual along the cycle of every test with the base model and with the causes in it; grey: a right model."""
    figure, axes = panel_a_test(len(shown), height=1.7)
    for ax, one in zip(axes, shown):
        _cycle_residual(ax, one, causes)
        ax.set_title(one.name, loc="left")
        ax.locator_params(axis="y", nbins=4)
    figure.supxlabel("phase of the cycle (0: upward through the middle)")
    figure.supylabel("measured − model (N)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2 if narrow() else 3)
    return figure


@styled
def moved_figure(moved: Mapping[str, Moved]) -> Figure:
    """Change of each of the specimen's parameters once the cause is in, in standard deviations."""
    names = list(moved)
    change = [(moved[n].after - moved[n].before) / max(moved[n].sd, 1e-300) for n in names]
    figure, ax = one_panel(6.2, 0.25 * len(names) + 0.8)
    y = np.arange(len(names))[::-1]
    ax.axvspan(-1, 1, color="#DDDDDD", linewidth=0)
    ax.axvline(0.0, color=BLACK, linewidth=0.6)
    ax.hlines(y, 0.0, change, color=BLUE, linewidth=1.2)
    ax.plot(change, y, "o", color=BLUE)
    ax.set_yticks(y, names)
    ax.set(ylim=(-0.6, len(names) - 0.4), xlabel="change in standard deviations (grey: within one)")
    return figure
