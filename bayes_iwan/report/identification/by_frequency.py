"""Figures and tables of each frequency alone beside all together."""

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.comparison.frequencies import Agreement, Frequencies, p_text
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.quantities import loop_quantities
from bayes_iwan.report.axes import band, ticked
from bayes_iwan.report.identification.loops import some_tests, test_name
from bayes_iwan.report.identification.marginals import in_interval, interval, number, symbol_of, with_unit
from bayes_iwan.report.identification.tables import spread
from bayes_iwan.report.page import Cell, Table
from bayes_iwan.report.style import BLACK, MODEL, RED, narrow, panels, styled


def _draws(posterior: Posterior, name: str) -> Array:
    return np.asarray(posterior.quantities()[name].values, dtype=float)


def _interval(posterior: Posterior, name: str) -> str:
    return "{} [{}, {}]".format(*interval(_draws(posterior, name)))


def _label(frequencies: Frequencies, check: Agreement) -> str:
    return with_unit(symbol_of(frequencies.joint, check.name), check.unit)


def _alone(frequencies: Frequencies) -> list[tuple[Loop, Posterior]]:
    """Tests by frequency and amplitude, each with the posterior of its own frequency."""
    return [
        (loop, frequencies.alone[name])
        for name, loops in frequencies.groups.items()
        if name in frequencies.alone
        for loop in sorted(loops, key=lambda x: x.amplitude_mm)
    ]


@styled
def wander_figure(frequencies: Frequencies) -> Figure:
    """Each determined quantity from each frequency alone (points with 50 and 90 % intervals) over the joint posterior
    (band); the posterior check's p-value in the title, in red and marked where the frequencies do not agree."""
    checks, hz = frequencies.checks, frequencies.hz
    many = len(hz) > 4
    columns = 2 if narrow() else 3 if many else 4
    figure, axes = panels(len(checks), columns, (2.7, 1.95) if many else (2.0, 1.75), (0.3, 0.3), (0.0, 0.0))
    places = np.arange(len(hz))
    for ax, check in zip(axes, checks):
        joint = np.quantile(_draws(frequencies.joint, check.name), [0.05, 0.25, 0.5, 0.75, 0.95])
        ax.axhspan(joint[0], joint[4], color=MODEL, alpha=0.2, linewidth=0)
        ax.axhspan(joint[1], joint[3], color=MODEL, alpha=0.3, linewidth=0)
        for x, name in zip(places, frequencies.groups):
            if name not in frequencies.alone:
                middle, grey = check.estimate[x], "#777777"
                ends = [[middle - check.low[x]], [check.high[x] - middle]]
                ax.errorbar(x, middle, ends, fmt="s", color=grey, mfc="white", ms=4.5, elinewidth=1.0)
                continue
            posterior = frequencies.alone[name]
            low, first, middle, third, high = np.quantile(_draws(posterior, check.name), [0.05, 0.25, 0.5, 0.75, 0.95])
            ax.plot([x, x], [low, high], color=BLACK, linewidth=1.0)
            ax.plot([x, x], [first, third], color=BLACK, linewidth=3.2, solid_capstyle="butt")
            ax.plot(x, middle, "o", color="white", markeredgecolor=BLACK, markersize=4.5)
        bad, p = check.p_value < 0.05, p_text(check.p_value)
        above = "\n" if narrow() else ""  # two titles do not go beside each other there
        ax.set_title(_label(frequencies, check) + above, loc="left")
        said = ("✗ " if bad else "") + (f"p {p}" if p[0] == "<" else f"p = {p}")
        ax.set_title(said, loc="right", size="small", weight="bold" if bad else "normal")
        ax.set_xticks(places, [f"{f:.3g}" for f in hz], rotation=45 if many else 0)
        ax.set_xlim(-0.5, len(hz) - 0.5)
        ax.grid(axis="x", visible=False)
        ax.locator_params(axis="y", nbins=4)
    figure.supxlabel("frequency (Hz); band: all tests together, 50 and 90 %; points: each frequency alone")
    return figure


def wander_rows(frequencies: Frequencies) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of a page's table: quantity, all tests, each frequency, p. Estimates are marked ~."""
    columns = ["quantity", "all tests (posterior alone)", *(f"{f:.3g} Hz alone" for f in frequencies.hz), "agreement p"]
    rows = []
    for check in frequencies.checks:
        cells = [_label(frequencies, check), _interval(frequencies.joint, check.name)]
        for i, name in enumerate(frequencies.groups):
            if name in frequencies.alone:
                cells.append(_interval(frequencies.alone[name], check.name))
            else:
                cells.append("~ {} [{}, {}]".format(*in_interval(check.estimate[i], check.low[i], check.high[i])))
        rows.append([*cells, p_text(check.p_value)])
    return columns, rows


@styled
def alone_loops_figure(frequencies: Frequencies) -> Figure:
    """Each test's loop as its own frequency alone predicts it (50 and 90 % bands) and as all tests together do (90 %
    between the lines), both less the joint median; grey: the measured loop. Means, which drift, are taken off. Of many
    tests some, spread over frequency and amplitude."""
    every = _alone(frequencies)
    tests = [every[t] for t in some_tests([loop for loop, _ in every])]
    figure, axes = panels(len(tests), 3, (2.5, 1.6), (0.4, 0.7), (0.0, 0.0), sharex=True)

    def swing(force_N: Array) -> Array:
        return force_N - force_N.mean(axis=-1, keepdims=True)

    for ax, (loop, posterior) in zip(axes, tests):
        joint, alone = (swing(p.forces(200, loops=(loop,))[:, 0]) for p in (frequencies.joint, posterior))
        middle = np.median(joint, axis=0)
        ax.plot(loop.phase, swing(loop.force_N) - middle, color="#999999", linewidth=0.6, zorder=1)
        band(ax, loop.phase, alone - middle)
        for edge in np.quantile(joint - middle, [0.05, 0.95], axis=0):
            ax.plot(loop.phase, edge, color=RED, linestyle=(0, (4, 2)), linewidth=0.9)
        ax.set_title(test_name(loop))
        ax.set_xlim(0, 1)
        ax.set_xticks([0, 0.5, 1.0], ["0", "0.5", "1"])
        ax.locator_params(axis="y", nbins=4)
    ticked(axes)
    figure.supxlabel("phase (cycles from the upward crossing of mid-stroke)")
    figure.supylabel("force − joint median (N)")
    return figure


def loop_rows(frequencies: Frequencies) -> tuple[list[str], list[list[str]]]:
    """Columns and rows: energy, stiffness, loss factor of each test: measured, from all tests, from its frequency."""
    rows = []
    for name, title, of_loop in (
        ("dissipated_energy_mJ", "energy (mJ)", "energy_mJ"),
        ("equivalent_stiffness_N_mm", "stiffness (N/mm)", "stiffness_N_mm"),
        ("loss_factor", "loss factor", "loss_factor"),
    ):
        for loop, posterior in _alone(frequencies):
            value = getattr(loop_quantities(loop.displacement_mm, loop.force_N), of_loop)
            at = f"{name}[{loop.file}]"
            width = float(np.ptp(np.quantile(_draws(frequencies.joint, at), [0.05, 0.95])))
            both = (_interval(p, at) for p in (frequencies.joint, posterior))
            rows.append([test_name(loop), title, number(float(value), width), *both])
    return ["test", "quantity", "measured", "all tests", "its frequency alone"], rows


def frequencies_table(frequencies: Frequencies) -> Table:
    """Every quantity of every frequency alone and of all tests, for per_frequency.csv."""
    rows: list[tuple[Cell, ...]] = []
    p = {c.name: c.p_value for c in frequencies.checks}
    for label, posterior in (("all", frequencies.joint), *frequencies.alone.items()):
        for name, quantity in posterior.quantities().items():
            found = spread(np.asarray(quantity.values, dtype=float))
            rows.append((label, name, quantity.unit, *found, float(p.get(name, float("nan")))))
    columns = ("frequency", "name", "unit", "mean", "sd", "q05", "q25", "median", "q75", "q95", "agreement_p")
    return Table("per_frequency", columns, tuple(rows))
