"""Figures of loops: measured cycles, predictive bands, residuals; one panel a test."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.report.axes import band, ticked
from bayes_iwan.report.identification.predictive import Predictive, measured_cycles, predict
from bayes_iwan.report.style import BLACK, MODEL, into_given_axes, narrow, series, styled, subplots

_DOTTED = (0, (1.2, 1.6))
#: tests of which a page shows a panel each: more are neither looked at nor light
MOST = 12


def test_name(loop: Loop, role: bool = True) -> str:
    """'10 Hz, 0.3 mm', with '(held out)' where it was; nominal values, and other stated numbers if there are any."""
    name = f"{loop.record.frequency_hz:.4g} Hz, " if loop.record.clock else ""
    name += f"{loop.record.amplitude_mm:g} mm"
    extras = ", ".join(f"{key} {value:g}" for key, value in list(loop.extras.items())[:1])
    name += f", {extras}" if extras else ""
    return name + (" (held out)" if role and loop.role == "held-out" else "")


def some_tests(loops: Sequence[Loop]) -> list[int]:
    """At most :data:`MOST` tests, spread evenly over frequency and, within one, amplitude, ends included; in order."""
    order = sorted(range(len(loops)), key=lambda t: (loops[t].record.frequency_hz, loops[t].record.amplitude_mm))
    some = np.linspace(0, len(order) - 1, min(MOST, len(order))).round().astype(int)
    return sorted(order[i] for i in some)


def _grid(loops: Sequence[Loop]) -> tuple[int, int, list[int]]:
    """Rows, columns and each test's place: frequency by amplitude where that fills a grid, else in order."""
    f = sorted({x.record.frequency_hz for x in loops})
    a = sorted({x.record.amplitude_mm for x in loops})
    cells = [f.index(x.record.frequency_hz) * len(a) + a.index(x.record.amplitude_mm) for x in loops]
    if len(f) * len(a) == len(loops) == len(set(cells)) and len(a) in (2, 3, 4) and not narrow():
        return len(f), len(a), cells
    columns = min(2 if narrow() else 3, len(loops))
    return math.ceil(len(loops) / columns), columns, list(range(len(loops)))


def _panels(loops: Sequence[Loop], height: float, share_x: bool = False) -> tuple[Figure, list[Axes]]:
    rows, columns, cells = (1, len(loops), list(range(len(loops)))) if into_given_axes() else _grid(loops)
    tall = height * rows + 0.7 if rows > 1 else max(height + 0.7, 3.2)
    figure, axes = subplots(rows, columns, 3.1 * columns + 0.4 if columns > 1 else 5.0, tall, sharex=share_x)
    flat = list(axes.ravel())
    for i, ax in enumerate(flat):
        if i not in cells:
            ax.remove()
    kept = [flat[c] for c in cells]
    ticked(kept)
    return figure, kept


def _branches(displacement_mm: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sample indices upward from the lowest point and downward from the highest, both ends included."""
    n = len(displacement_mm)
    low, high = int(np.argmin(displacement_mm)), int(np.argmax(displacement_mm))
    up = (low + np.arange((high - low) % n + 1)) % n
    down = (high + np.arange((low - high) % n + 1)) % n
    return up, down


def draw_loop(ax: Axes, p: Predictive, t: int, friction: bool, cycles: bool = True) -> None:
    """One test's loop on `ax`: measured cycles in grey, bands of one more cycle, median, measured average."""
    loop = p.loops[t]
    line = np.polyfit(p.displacement_mm[t], p.spring_N[t], 1) if friction else np.zeros(2)
    if cycles:
        for u, force in measured_cycles(loop, 12):
            friction_N = force - p.zero_N[t] - np.polyval(line, u)
            ax.plot(u, friction_N, color="#999999", linewidth=0.5, rasterized=True, zorder=1)
    off = np.polyval(line, p.displacement_mm[t])
    for branch in _branches(p.displacement_mm[t]):
        u = p.displacement_mm[t, branch]
        band(ax, u, p.cycle_N[:, t, branch] - off[branch], median=False)
    closed = np.r_[np.arange(len(off)), 0]
    u = p.displacement_mm[t, closed]
    ax.plot(u, (p.median_N[t] - off)[closed], color=MODEL)
    ax.plot(u, (p.measured_N[t] - off)[closed], color=BLACK, linestyle=_DOTTED, linewidth=1.1)


def _labels(figure: Figure, axes: Sequence[Axes], x: str, y: str) -> None:
    """One label a side for all panels, or each panel's own where it stands in a figure of the caller's."""
    if into_given_axes():
        for ax in axes:
            ax.set(xlabel=x, ylabel=y)
    else:
        figure.supxlabel(x)
        figure.supylabel(y)


def _key(figure: Figure, axes: Sequence[Axes], lines: Sequence[Artist], half: str, most_of: str) -> None:
    """The key of lines and of the bands that hold half and 90 % of something."""
    bands = [Patch(label=x, color=MODEL, alpha=a, linewidth=0) for x, a in ((half, 0.6), (most_of, 0.22))]
    handles = [*lines, *bands]
    most = 5 if figure.get_figwidth() > 6.5 else 3 if figure.get_figwidth() > 4.5 else 2
    if into_given_axes():
        axes[0].legend(handles=handles, loc="best")
        return
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), most))


@styled
def loops_figure(
    posterior: Posterior,
    friction: bool = False,
    loops: Sequence[Loop] | None = None,
    cycles: bool = True,
    predictive: Predictive | None = None,
) -> Figure:
    """Every test's measured cycles with the 50 and 90 % posterior predictive bands of one more cycle.

    friction : the total force less the median parallel spring, for measured and predicted alike.
    """
    p = predict(posterior, loops) if predictive is None else predictive
    figure, axes = _panels(p.loops, 2.25)
    for t, ax in enumerate(axes):
        draw_loop(ax, p, t, friction, cycles)
        ax.set_title(test_name(p.loops[t]))
        ax.locator_params(axis="x", nbins=5 if figure.get_figwidth() > 4.5 else 3)
    _labels(figure, axes, "displacement u (mm)", "friction force (N)" if friction else "force (N)")
    lines = [Line2D([], [], label="measured cycles", color="#999999", linewidth=0.8)] if cycles else []
    lines += [Line2D([], [], label="measured, average", color=BLACK, linestyle=_DOTTED)]
    _key(figure, axes, [*lines, Line2D([], [], label="model, median", color=MODEL)], "50 % of cycles", "90 %")
    return figure


@styled
def residuals_figure(
    posterior: Posterior, loops: Sequence[Loop] | None = None, predictive: Predictive | None = None
) -> Figure:
    """Measured − median prediction along the cycle, with the bands in which an averaged loop was to be expected."""
    p = predict(posterior, loops) if predictive is None else predictive
    figure, axes = _panels(p.loops, 1.65, share_x=True)
    median = p.median_N
    for t, ax in enumerate(axes):
        x = p.loops[t].phase
        band(ax, x, p.loop_N[:, t] - median[t], median=False)
        ax.plot(x, p.measured_N[t] - median[t], color=BLACK, linewidth=1.0)
        ax.axhline(0.0, color="#777777", linewidth=0.6)
        ax.set_title(test_name(p.loops[t]))
        ax.set_xlim(0, 1)
        ax.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "0.25", "0.5", "0.75", "1"])
        ax.locator_params(axis="y", nbins=5)
    along, off = "phase (cycles from the upward crossing of mid-stroke)", "residual: measured − predicted force (N)"
    _labels(figure, axes, along, off)
    _key(figure, axes, [Line2D([], [], label="residual", color=BLACK)], "50 % expected", "90 % expected")
    return figure


def _largest(loops: Sequence[Loop]) -> list[int]:
    """Tests of the amplitude that most frequencies share (the largest such), by frequency: the paper's choice."""
    count = Counter(x.record.amplitude_mm for x in loops)
    best = max(count, key=lambda a: (count[a], a))
    chosen = [t for t, x in enumerate(loops) if x.record.amplitude_mm == best]
    return sorted(chosen, key=lambda t: loops[t].record.frequency_hz)


@styled
def paper_fig3(posterior: Posterior, test: int | None = None, predictive: Predictive | None = None) -> Figure:
    """The paper's Figs. 3 and 7: one test's total force and friction force, with bands (default: mid frequency)."""
    p = predict(posterior) if predictive is None else predictive
    chosen = _largest(p.loops)
    t = chosen[len(chosen) // 2] if test is None else test
    figure, axes = subplots(1, 2, 7.2, 3.2)
    for ax, friction, letter in zip(axes[0], (False, True), "ab"):
        draw_loop(ax, p, t, friction)
        ax.set_title(f"{letter}. " + ("force without its linear portion" if friction else "total force"), loc="left")
        ax.set(xlabel="displacement u (mm)", ylabel="friction force (N)" if friction else "force (N)")
    figure.suptitle(test_name(p.loops[t]))
    return figure


@styled
def frequencies_figure(posterior: Posterior, predictive: Predictive | None = None, model: bool = True) -> Figure:
    """The paper's Figs. 4 (`model=False`) and 12: friction loops at one amplitude, every frequency, test and model."""
    p = predict(posterior) if predictive is None else predictive
    figure, axes = subplots(1, 1, 5.6, 4.0)
    ax = axes[0, 0]
    chosen = _largest(p.loops)
    for i, t in enumerate(chosen):
        style = series(i)
        u, off = p.displacement_mm[t], p.spring_N[t]
        closed = np.r_[np.arange(len(u)), 0]
        name, line = f"{p.loops[t].record.frequency_hz:.4g} Hz", "-" if model else style["linestyle"]
        measured = (p.measured_N[t] - off)[closed]
        ax.plot(u[closed], measured, color=style["color"], lw=1.3, label=f"{name}, test", ls=line)
        if model:
            for branch in _branches(u):
                band(ax, u[branch], p.force_N[:, t, branch] - off[branch], style["color"], levels=(0.9,), median=False)
            median = (p.median_N[t] - off)[closed]
            ax.plot(u[closed], median, color=style["color"], linestyle=(0, (4, 2)), label=f"{name}, model")
    ax.set_title(f"amplitude {p.loops[chosen[0]].record.amplitude_mm:g} mm", loc="left")
    ax.set(xlabel="displacement u (mm)", ylabel="friction force (N)")
    beside = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    ax.legend(**({"loc": "best"} if into_given_axes() else beside))
    return figure
