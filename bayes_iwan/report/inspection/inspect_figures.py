"""Figures of a campaign before any model: the paper's Figs. 3 and 4 from the records, noise, drift and the drive."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.folders.inspect import CycleMean, Inspection
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.report.axes import decimal_ticks
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import measured_cycles
from bayes_iwan.report.style import narrow, one_panel, panels, points, series, styled, subplots

CYCLES = 12  # cycles drawn behind a loop
COLUMNS = 3


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    return panels(count, 2 if narrow() else COLUMNS, (3.4, height), (0.4, 0.4), (5.0, 3.0))


def _closed(values: np.ndarray) -> np.ndarray:
    return np.append(values, values[0])


@styled
def loops(tests: Sequence[Inspection], units: Units, linear: bool = True) -> Figure:
    """Every test's loop; without its straight part where `linear` is false (the paper's Fig. 3)."""
    figure, axes = _panels(len(tests), 2.6)
    for ax, test in zip(axes, tests):
        slope = 0.0 if linear else test.slope_N_mm
        mean = float(test.loop.harmonics_N[0].real)
        zero = 0.0 if linear else mean
        for u, force in measured_cycles(test.loop, CYCLES):
            ax.plot(u, force - zero - slope * u, color="#999999", linewidth=0.5, rasterized=True)
        u, force = test.loop.displacement_mm, test.loop.force_N - zero - slope * test.loop.displacement_mm
        ax.plot(_closed(u), _closed(force), color="black", linewidth=1.3)
        ax.set_title(units.text(test_name(test.loop)))
        ax.set_xlabel(units.text("displacement (mm)"))
        ax.locator_params(axis="x", nbins=3 if narrow() else 5)
        ax.set_ylabel(units.text("force (N)" if linear else "force less the straight part (N)"))
    return figure


@styled
def overlays(tests: Sequence[Inspection], units: Units) -> Figure:
    """Loops without their straight part over one another, a panel an amplitude (the paper's Fig. 4)."""
    groups = grouped(tests)
    figure, axes = _panels(len(groups), 2.8)
    for ax, (amplitude, members) in zip(axes, groups):
        slope = float(np.mean([m.slope_N_mm for m in members]))
        for k, m in enumerate(sorted(members, key=lambda m: m.loop.frequency_hz)):
            u = m.loop.displacement_mm
            force = m.loop.force_N - m.loop.harmonics_N[0].real - slope * u
            ax.plot(_closed(u), _closed(force), label=f"{m.loop.record.frequency_hz:.4g} Hz", **series(k))
        ax.set_title(units.text(f"{amplitude:g} mm, less {slope:.3g} N/mm"))
        ax.set_xlabel(units.text("displacement (mm)"))
        ax.locator_params(axis="x", nbins=5)
        ax.set_ylabel(units.text("force less a common line (N)"))
        ax.legend(loc="upper right")
    return figure


def grouped(tests: Sequence[Inspection]) -> list[tuple[float, list[Inspection]]]:
    """Tests by stated amplitude (to 5 %), smallest first."""
    out: list[tuple[float, list[Inspection]]] = []
    for test in sorted(tests, key=lambda t: t.loop.record.amplitude_mm):
        amplitude = test.loop.record.amplitude_mm
        if out and abs(amplitude / out[-1][0] - 1) < 0.05:
            out[-1][1].append(test)
        else:
            out.append((amplitude, [test]))
    return out


@styled
def trends(tests: Sequence[Inspection], units: Units) -> Figure:
    """Energy lost a cycle, equivalent stiffness and loss factor against amplitude, a line a frequency."""
    figure, axes = subplots(1, 3, 10.6, 3.2)
    frequencies = sorted({t.loop.record.frequency_hz for t in tests})
    labels = ("energy lost a cycle (mJ)", "equivalent stiffness (N/mm)", "loss factor")
    for ax, key, label in zip(axes[0], ("energy_mJ", "stiffness_N_mm", "loss_factor"), labels):
        for k, f in enumerate(frequencies):
            some = sorted((t for t in tests if t.loop.record.frequency_hz == f), key=lambda t: t.loop.amplitude_mm)
            x = [t.loop.amplitude_mm for t in some]
            found: list[CycleMean] = [getattr(t, key) for t in some]
            y = np.array([e.value for e in found])
            half = np.nan_to_num(np.array([e.high - e.value for e in found]))
            line = points(k) | {"linestyle": series(k)["linestyle"]}
            ax.errorbar(x, y, half, linewidth=0.8, capsize=2.5, label=f"{f:g} Hz", **line)
        ax.set(xlabel=units.text("amplitude (mm)"), ylabel=units.text(label))
        ax.set_ylim(bottom=0)
    if tests[0].loop.record.clock:
        axes[0, 0].legend(ncols=2 if len(frequencies) > 4 else 1)
    return figure


@styled
def noise(tests: Sequence[Inspection], units: Units) -> Figure:
    """Spectrum of what is left of the force between cycles, with the mains lines that were found."""
    figure, axes = _panels(len(tests), 2.3)
    for ax, test in zip(axes, tests):
        amplitude = np.sqrt(np.maximum(test.spectrum_N2_Hz, 1e-300))
        ax.loglog(*_thinned(test.spectrum_hz, amplitude), color="black", linewidth=0.9)
        for hz in (line.frequency_hz for line in test.lines):
            ax.axvline(hz, color=series(1)["color"], linewidth=1.0, linestyle=(0, (4, 2)))
            ax.text(hz, 0.98, f" {hz:.4g} Hz", transform=ax.get_xaxis_transform(), va="top")
        decimal_ticks(ax.xaxis, *ax.get_xlim())
        decimal_ticks(ax.yaxis, *ax.get_ylim())
        ax.set_title(units.text(f"{test_name(test.loop)}: {test.noise_N:.2g} N"))
        clock = test.loop.record.clock
        ax.set(
            xlabel="frequency (Hz)" if clock else "periods in one cycle",
            ylabel=units.text("noise (N/√Hz)" if clock else "noise (N, per root of a period in a cycle)"),
        )
    return figure


def _thinned(hz: Array, amplitude: Array, most: int = 240) -> tuple[Array, Array]:
    """A spectrum with no more points than a logarithmic axis can show: RMS of those that fall together."""
    if hz.size <= most:
        return hz, amplitude
    cell = np.unique(np.floor(np.log(hz / hz[0]) / np.log(hz[-1] / hz[0]) * most), return_inverse=True)[1]
    count = np.bincount(cell)
    return np.bincount(cell, hz) / count, np.sqrt(np.bincount(cell, amplitude**2) / count)


@styled
def drift(tests: Sequence[Inspection], units: Units) -> Figure:
    """Energy, drive and force cycle by cycle, over their medians: what changes, and whether the drive did."""
    figure, axes = _panels(len(tests), 2.3)
    for ax, test in zip(axes, tests):
        each = test.cycles
        changing = (each.amplitude_mm, each.force_amplitude_N, test.energy_by_cycle_mJ)
        for k, (values, label) in enumerate(zip(changing, ("displacement", "force", "energy"))):
            ax.plot(each.number, 100 * (values / np.median(values) - 1), label=label, **series(k))
        ax.set_title(units.text(test_name(test.loop)))
        ax.set(xlabel="cycle", ylabel="off the median (%)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@styled
def drive(tests: Sequence[Inspection], units: Units) -> Figure:
    """Harmonics of the displacement over its strongest, one line a test; what noise hides is omitted."""
    figure, ax = one_panel(6.4, 3.2)
    orders = np.arange(2, 11)
    for k, test in enumerate(tests):
        percent = 100 * np.where(test.drive_harmonics[1:10] > 1e-7, test.drive_harmonics[1:10], np.nan)
        line, label = points(k) | {"linestyle": series(k)["linestyle"]}, units.text(test_name(test.loop, role=False))
        ax.plot(orders, percent, linewidth=0.8, label=label, **line)
    ax.set_yscale("log")
    decimal_ticks(ax.yaxis, *ax.get_ylim())
    ax.set_xticks(orders)
    ax.set(xlim=(1.5, 10.5), xlabel="harmonic of the drive", ylabel="share of the strongest harmonic (%)")
    if len(tests) <= 12:
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
