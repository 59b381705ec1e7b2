"""What several figures draw on their axes: plain numbers on logarithmic ones, bands of draws, tables of cells."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import NullLocator
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.report.style import MODEL


def decimal_ticks(axis: Axis, low: float, high: float, most: int = 6) -> None:
    """Plain numbers on a logarithmic axis: 1, 2 and 5 times powers of ten, or these powers alone where there are many.

    Matplotlib's own are formulas, dozens to a panel, each as dear to draw as all else.
    """
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [float(f"{m}e{k}") for k in powers for m in (1, 2, 5)]
    ticks = [t for t in ticks if low * 0.999 <= t <= high * 1.001]
    if len(ticks) > most:
        ticks = [t for t in ticks if f"{t:e}".startswith("1.0")][:: 1 + len(ticks) // (3 * most)]
    if len(ticks) < 2:
        ticks = sorted({float(f"{t:.2g}") for t in np.geomspace(low, high, 3)})
    axis.set_ticks(ticks, [f"{t:g}" for t in ticks])
    axis.set_minor_locator(NullLocator())


def ticked(axes: Sequence[Axes]) -> None:
    """Numbers on both axes of every panel, also of those that share theirs with a neighbour."""
    for ax in axes:
        ax.tick_params(labelbottom=True, labelleft=True)


def band(
    axes: Axes,
    x: Array,
    draws: Array,
    color: str = MODEL,
    levels: Sequence[float] = (0.9, 0.5),
    line: LineStyleType = "-",
    label: str | None = None,
    median: bool = True,
) -> None:
    """Central intervals of draws (draws, len(x)) at each x, wide ones pale, and the median."""
    for level, shade in zip(levels, (0.22, 0.42)):
        low, high = np.quantile(draws, [0.5 - level / 2, 0.5 + level / 2], axis=0)
        axes.fill_between(x, low, high, color=color, alpha=shade, linewidth=0)
    if median:
        axes.plot(x, np.median(draws, axis=0), color=color, linestyle=line, label=label)


def numbered_cells(
    axes: Axes,
    values: Array,
    texts: Sequence[Sequence[str]],
    rows: Sequence[str],
    columns: Sequence[str],
    bold: NDArray[np.bool_] | None = None,
    **mesh: Any,
) -> None:
    """A table of coloured cells (rows, columns) with a text in each, rows from the top down; bold : which of them."""
    n, m = values.shape
    axes.pcolormesh(np.arange(m + 1), np.arange(n + 1), values, edgecolors="white", linewidth=1.0, **mesh)
    for i, row in enumerate(texts):
        for j, text in enumerate(row):
            weight = "bold" if bold is not None and bold[i, j] else "normal"
            axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", size="small", weight=weight)
    axes.set_xticks(np.arange(m) + 0.5, columns)
    axes.set_yticks(np.arange(n) + 0.5, rows)
    axes.set_ylim(n, 0)
    axes.grid(visible=False)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
