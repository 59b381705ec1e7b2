"""Figures of the gap itself: where it is and how it grows, T tests, n samples a cycle, phase 0 the upward crossing."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from textwrap import fill

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.answer.localisation import Statistic, Where
from bayes_iwan.diagnosis.fits.gap_size import GapSize
from bayes_iwan.report.axes import decimal_ticks, ticked
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.style import BLUE, PRIOR, narrow, panels, points, series, styled, subplots

#: measured above the model is red, below it blue; equal is a grey that still shows on paper
_DIVERGING = "RdBu_r"
_TEST_MARKERS = "osD^v<>PX*"


@dataclass(frozen=True)
class GapPictures:
    """The gap of T tests as it is drawn: their loops, its place and its size."""

    loops: tuple[Loop, ...]
    where: Where
    size: GapSize

    @property
    def names(self) -> list[str]:
        """Of the tests."""
        return [test_name(x, role=False) for x in self.loops]

    @property
    def gap_N(self) -> Array:
        """(T,) RMS."""
        return np.array([g.rms_N for g in self.size.tests])


def panel_a_test(count: int, height: float = 2.2) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in rows of three or four."""
    columns = 2 if narrow() else 4 if count % 3 else 3
    return panels(count, columns, (2.5, height), (0.9, 0.6), (4.5, 0.0))


@styled
def gap_loops_figure(p: GapPictures) -> Figure:
    """Every test's measured loop, its colour and thickness telling what the model misses there; (T, n) arrays."""
    names, residual_N, shares = p.names, p.where.phase_N, p.gap_N / p.size.friction_N
    figure, axes = panel_a_test(len(names))
    limit = max(float(np.quantile(np.abs(residual_N), 0.995)), 1e-12)
    norm = TwoSlopeNorm(0.0, -limit, limit)
    colours = colormaps[_DIVERGING]
    for t, ax in enumerate(axes):
        u, f, r = (np.r_[x, x[0]] for x in (p.loops[t].displacement_mm, p.loops[t].force_N, residual_N[t]))
        ax.plot(u, f, color="#BBBBBB", linewidth=0.8, zorder=1)
        pieces = np.stack([np.stack([u[:-1], f[:-1]], axis=1), np.stack([u[1:], f[1:]], axis=1)], axis=1)
        between = 0.5 * (r[:-1] + r[1:])
        wide = 0.8 + 4.0 * np.minimum(np.abs(between) / limit, 1.0)
        ax.add_collection(LineCollection(list(pieces), colors=colours(norm(between)), zorder=2, linewidths=wide))
        digits = 1 if shares[t] < 0.1 else 0
        ax.set_title(f"{names[t]}: {100 * shares[t]:.{digits}f} %", loc="left", size="small" if narrow() else None)
        ax.locator_params(nbins=3 if narrow() else 4)
    figure.supxlabel("displacement (mm)")
    figure.supylabel("measured force (N)")
    side, few = ("top", MaxNLocator(4)) if narrow() else ("right", MaxNLocator(9))
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=axes, shrink=0.8, pad=0.02, ticks=few, location=side)
    bar.set_label("measured − model (N)")
    return figure


@styled
def gap_map_figure(p: GapPictures) -> Figure:
    """Residual along the cycle (across) in each test (down), in units of what a right model would leave.

    Above: the displacement. sticking (T, n) marks where half of the elements have begun to slip.
    """
    names, sticking = p.names, p.where.sticking
    displacement_mm = np.stack([x.displacement_mm for x in p.loops])
    tests, n = displacement_mm.shape
    ratio = p.where.phase_N / np.maximum(p.where.expected_N, 1e-12)
    limit = max(4.0, float(np.quantile(np.abs(ratio), 0.98)))
    figure, axes = subplots(
        2, 1, 7.0, max(1.9 + 0.27 * tests, 2.6), sharex=True, height_ratios=[1.0, max(0.35 * tests, 1.5)]
    )
    top, ax = axes[:, 0]
    phase = (np.arange(n) + 0.5) / n
    u = displacement_mm / np.abs(displacement_mm).max(axis=1, keepdims=True)
    top.plot(phase, u.mean(axis=0), color="black")
    top.set_ylabel("u / A")
    top.set_yticks([-1, 0, 1])
    across, norm = np.arange(n + 1) / n, TwoSlopeNorm(0.0, -limit, limit)
    mesh = ax.pcolormesh(across, np.arange(tests + 1), ratio, cmap=_DIVERGING, norm=norm, rasterized=True)
    if sticking is not None:
        for t in range(tests):
            slipping = np.flatnonzero((sticking[t] < 0.5) & (np.roll(sticking[t], 1) >= 0.5))
            ax.plot(slipping / n, np.full(len(slipping), t + 0.5), "k|", markersize=8, markeredgewidth=1.2)
    ax.set_yticks(np.arange(tests) + 0.5, [fill(n, 20) for n in names] if narrow() else list(names))
    ax.invert_yaxis()
    ax.grid(False)
    places = ("", "", "", "") if narrow() else ("\nmiddle, up", "\nupper end", "\nmiddle, down", "\nlower end")
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], [*(f"{x}{place}" for x, place in zip("0¼½¾", places)), "1"])
    ax.set_xlabel("phase of the cycle" + ("" if sticking is None else "   ( | : from here on most elements slip)"))
    figure.colorbar(mesh, ax=list(axes[:, 0]), pad=0.02, label="residual over\nwhat a right model leaves")
    return figure


@styled
def gap_harmonics_figure(p: GapPictures) -> Figure:
    """Residual harmonics of every test in step with displacement and velocity, (T, orders + 1), order 0 omitted.

    Grey: what a right model would leave, twice its standard deviation.
    """
    names, in_phase_N, quadrature_N = p.names, p.where.in_phase_N, p.where.quadrature_N
    expected_N = p.where.expected_harmonic_N
    orders = np.arange(1, in_phase_N.shape[1])
    figure, axes = subplots(1, 2, 7.4, 3.3, sharey=True)
    offsets = np.linspace(-0.34, 0.34, len(names))
    reach = 2.0 * expected_N[:, 1:].max(axis=0)
    shades = colormaps["viridis"](np.linspace(0.0, 0.9, len(names)))
    titles = ("with the displacement (stiffness)", "with the velocity (damping)")
    for ax, values, title in zip(axes[0], (in_phase_N, quadrature_N), titles):
        ax.bar(orders, 2.0 * reach, 0.86, bottom=-reach, color="#DDDDDD", label="a right model leaves (2 sd)", zorder=0)
        for t, name in enumerate(names):
            ax.vlines(orders + offsets[t], 0.0, values[t, 1:], color=shades[t], linewidth=1.0)
            mark = {"marker": _TEST_MARKERS[t % 10], "markersize": 3.2}
            ax.plot(orders + offsets[t], values[t, 1:], ls="none", color=shades[t], label=name, **mark)
        ax.axhline(0.0, color="black", linewidth=0.6)
        ax.set_title(title, loc="left")
        ax.set_xticks(orders)
        ax.set_xlabel("harmonic")
        ax.grid(axis="x", visible=False)
    ticked(list(axes[0]))
    axes[0, 0].set_ylabel("measured − model (N)")
    if len(names) <= 24:
        key, columns = axes[0, 1].get_legend_handles_labels(), 2 if narrow() else 1
        figure.legend(*key, loc="outside upper center" if narrow() else "outside right upper", ncols=columns)
    return figure


@styled
def gap_growth_figure(p: GapPictures) -> Figure:
    """The gap of each test against frequency and against amplitude, with 90 % intervals (T,); open: no finding."""
    low_N, high_N = np.array([(g.low_N, g.high_N) for g in p.size.tests]).T
    gap_N, found, f, a = p.gap_N, p.where.stands_out, p.where.frequency_hz, p.where.amplitude_mm
    figure, axes = subplots(1, 2, 7.0, 3.2, sharey=True)
    floor = max(float(np.min(np.where(gap_N > 0, gap_N, np.inf))), 1e-9) if np.any(gap_N > 0) else 1e-6
    pairs = ((axes[0, 0], f, a, "frequency (Hz)", "mm"), (axes[0, 1], a, f, "amplitude (mm)", "Hz"))
    for ax, x, other, label, unit in pairs:
        for i, members in enumerate(groups_of(list(other))):
            value, at = float(np.median(other[members])), np.array(members)[np.argsort(x[members])]
            y = np.maximum(gap_N[at], 0.5 * floor)
            style = points(i)
            ax.plot(x[at], y, color=style["color"], linewidth=0.8, linestyle=series(i)["linestyle"])
            reach = np.maximum([y - np.maximum(low_N[at], 0.3 * floor), high_N[at] - y], 0.0)
            ax.errorbar(x[at], y, reach, linestyle="none", color=style["color"], elinewidth=0.8)
            for k, t in enumerate(at):
                ax.plot(x[t], y[k], linestyle="none", markerfacecolor=style["color"] if found[t] else "white", **style)
            ax.plot([], [], label=f"{_nominal(value):g} {unit}", linestyle=series(i)["linestyle"], **style)
        ax.set(xscale="log", yscale="log")
        ticks = _apart(sorted({float(f"{v:.2g}") for v in x}))
        ax.set_xticks(ticks, [f"{v:g}" for v in ticks])
        ax.minorticks_off()
        ax.set_xlabel(label)
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)  # above: points are anywhere
    decimal_ticks(axes[0, 0].yaxis, *axes[0, 0].get_ylim())
    ticked(list(axes[0]))
    axes[0, 0].set_ylabel("gap (N RMS)")
    return figure


def _apart(values: Sequence[float], least: float = 0.11) -> list[float]:
    """Of ascending values those whose labels do not touch on a logarithmic axis over all of them: both ends, and
    between them what lies `least` of the axis from its neighbours."""
    whole = math.log(values[-1] / values[0]) if len(values) > 1 else 0.0
    kept = list(values[:1])
    for value in values[1:-1]:
        if min(math.log(value / kept[-1]), math.log(values[-1] / value)) >= least * whole:
            kept.append(value)
    return kept + list(values[1:][-1:])


def _nominal(value: float) -> float:
    """A setting as it was meant: 8 for 7.98, 17.5 for 17.5."""
    short = float(f"{value:.2g}")
    return short if abs(short / value - 1.0) < 0.01 else float(f"{value:.3g}")


@styled
def gap_cycles_figure(p: GapPictures) -> Figure:
    """The gap block by block along each record, with 90 % intervals; a missing cause that evolves shows as a slope."""
    names, size, cycle, along_N = p.names, p.size, p.size.cycle, p.size.along_N
    figure, axes = subplots(1, 1, 6.4, 3.3)
    ax = axes[0, 0]
    shades = colormaps["viridis"](np.linspace(0.0, 0.9, len(names)))
    for t, name in enumerate(names):
        ax.plot(cycle[t], along_N[t], label=name, marker=_TEST_MARKERS[t % 10], markersize=3.5, color=shades[t])
        ax.fill_between(cycle[t], size.along_low_N[t], size.along_high_N[t], color=shades[t], alpha=0.15, linewidth=0)
    ax.set_ylim(bottom=0.0)
    ax.set(xlabel="cycle number (mean of each block of cycles)", ylabel="gap (N RMS)")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


@styled
def gap_regions_figure(regions: Sequence[Statistic]) -> Figure:
    """Gap in each part of the loop with its 90 % interval; dashed: were it spread evenly."""
    figure, axes = subplots(1, 1, 6.6, 0.27 * len(regions) + 0.9)
    ax = axes[0, 0]
    y = np.arange(len(regions))[::-1]
    even = [x.gap_N**2 * x.time / max(x.share, 1e-12) for x in regions if x.share > 0.05]
    whole = float(np.sqrt(np.mean(even or [0.0])))
    for k, x in zip(y, regions):
        color, share = BLUE if x.significant else PRIOR, f"{100 * x.share:.0f} %"
        ax.plot([x.low_N, x.high_N], [k, k], color=color, linewidth=2.2)
        ax.plot(x.gap_N, k, "o", color=color, markerfacecolor=BLUE if x.significant else "white")
        ax.annotate(share, (1.01, k), xycoords=("axes fraction", "data"), va="center", size="small")
    ax.axvline(whole, color="black", linewidth=0.8, linestyle=(0, (4, 2)))
    ax.set_yticks(y, [x.name for x in regions])
    ax.set_xlim(left=0.0)
    ax.set_xlabel("gap there (N RMS), its share of the whole in %; dashed: the whole loop")
    return figure


def figures_of_gap(p: GapPictures) -> dict[str, Callable[[], Figure]]:
    """What draws each figure of the gap itself, by name."""
    out: dict[str, Callable[[], Figure]] = {
        "gap_loops": partial(gap_loops_figure, p),
        "gap_map": partial(gap_map_figure, p),
        "gap_regions": partial(gap_regions_figure, p.where.of("region")),
        "gap_harmonics": partial(gap_harmonics_figure, p),
    }
    if p.where.clock:
        out["gap_growth"] = partial(gap_growth_figure, p)
    if any(len(x) > 1 for x in p.size.cycle):
        out["gap_cycles"] = partial(gap_cycles_figure, p)
    return out
