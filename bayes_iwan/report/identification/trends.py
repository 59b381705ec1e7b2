"""Figures of what a designer reads off loops, against frequency and amplitude: energy, stiffness, loss factor."""

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.quantities import LoopQuantities, loop_quantities
from bayes_iwan.models import sine_motion
from bayes_iwan.report.axes import band, ticked
from bayes_iwan.report.identification.predictive import Predictive, predict
from bayes_iwan.report.style import narrow, points, series, styled, subplots

_WHAT = (
    ("energy_mJ", "dissipated energy (mJ/cycle)"),
    ("stiffness_N_mm", "equivalent stiffness (N/mm)"),
    ("loss_factor", "loss factor (-)"),
)


def _model_values(posterior: Posterior, frequency_hz: Array, amplitude_mm: Array, n: int) -> LoopQuantities:
    problem = posterior.problem
    motion = sine_motion(frequency_hz=frequency_hz, amplitude_mm=amplitude_mm)
    force = problem.force(problem.parameter_values(posterior.flat_z(n)), motion)
    return loop_quantities(motion.displacement_mm[0], force)


def _distinct(values: Array, most: int = 4) -> Array:
    """Values that differ by more than 2 %, at most `most` of them, spread out."""
    ordered = np.sort(values)
    kept = [ordered[0]]
    for v in ordered[1:]:
        if v > 1.02 * kept[-1]:
            kept.append(v)
    chosen = np.array(kept)
    return chosen if len(chosen) <= most else chosen[np.linspace(0, len(chosen) - 1, most).astype(int)]


@styled
def trends_figure(posterior: Posterior, predictive: Predictive | None = None, n: int = 120) -> Figure:
    """Energy, stiffness and loss factor: lines with 90 % bands predicted, points measured, whiskers what the
    likelihood allows a measurement to differ by."""
    p = predict(posterior) if predictive is None else predictive
    f, a = np.array([(x.frequency_hz, x.amplitude_mm) for x in p.loops]).T
    measured, again = (loop_quantities(p.displacement_mm, force) for force in (p.measured_N, p.loop_N))
    stated_f, stated_a = np.array([(x.record.frequency_hz, x.record.amplitude_mm) for x in p.loops]).T
    sides = [("amplitude (mm)", a, f, "Hz", stated_f), ("frequency (Hz)", f, a, "mm", stated_a)]
    clock = p.loops[0].record.clock
    sides = [s for s in sides if len(_distinct(s[1])) > 1 and (clock or s[3] == "Hz")] or sides[:1]
    figure, axes = subplots(3, len(sides), 3.6 * len(sides) + 0.6, 6.9, sharex="col", sharey="row")
    for column, (label, x, other, unit, nominal) in enumerate(sides):
        grid = np.linspace(max(0.6 * x.min(), 1e-6), 1.12 * x.max(), 25)
        for i, level in enumerate(_distinct(other)):
            held = np.full_like(grid, level)
            pair = (held, grid) if unit == "Hz" else (grid, held)
            lines = _model_values(posterior, *pair, n)
            near = np.abs(other / level - 1.0) < 0.02
            for row, (name, title) in enumerate(_WHAT):
                ax = axes[row, column]
                band(ax, grid, getattr(lines, name), series(i)["color"], levels=(0.9,), line=series(i)["linestyle"])
                low, high = np.quantile(getattr(again, name)[:, near], [0.05, 0.95], axis=0)
                middle, half = getattr(measured, name)[near], 0.5 * (high - low)
                label_of = f"{float(np.median(nominal[near])):g} {unit}" if row == 0 and clock else None
                ax.errorbar(x[near], middle, half, ls="none", ms=4.5, elinewidth=0.9, label=label_of, **points(i))
                ax.set_ylabel(title if column == 0 else "")
        axes[-1, column].set_xlabel(label)
        if clock:
            above = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 2 if narrow() else 4}
            axes[0, column].legend(columnspacing=1.2, handletextpad=0.2, **above)
    ticked(list(axes.ravel()))
    for ax in axes[:, 0]:
        ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    return figure
