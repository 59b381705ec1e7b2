"""Figures of the sampling itself: traces, ranks, autocorrelation time against run length."""

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import rankdata

from bayes_iwan.arrays import Array
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.report.axes import decimal_ticks
from bayes_iwan.report.style import one_panel, series, styled, subplots
from bayes_iwan.sampling.checkpoint import NAME, CheckpointError, read_checkpoint
from bayes_iwan.sampling.convergence import autocorrelation_time


@dataclass(frozen=True)
class History:
    """Production draws z (ensembles, stored, walkers, ndim), `thin` steps of the sampler apart."""

    z: Array
    thin: float


def history(posterior: Posterior, folder: str | os.PathLike[str] | None = None) -> History:
    """All production draws from the checkpoint in `folder` where there is one, else those that the posterior kept."""
    path = None if folder is None else Path(folder) / NAME
    ensembles = posterior.z.shape[0]
    if path is not None and path.is_file():
        with contextlib.suppress(CheckpointError):  # the posterior stands without the file it was drawn through
            found = read_checkpoint(path)
            counted = int(posterior.timings.get("steps", 0))
            draws = found.draws[-counted or None :]
            if found.names[: posterior.ndim] == posterior.names and len(draws) >= 4:
                z = np.moveaxis(draws.reshape(len(draws), ensembles, -1, draws.shape[2]), 0, 1)
                return History(z, 1.0)
    z = posterior.z.reshape(ensembles, posterior.walkers, -1, posterior.ndim)
    return History(np.moveaxis(z, 1, 2), float(posterior.thin))


def worst_names(posterior: Posterior, count: int = 6) -> tuple[str, ...]:
    """The sampled parameters with the largest R-hat, the hardest to sample first."""
    r_hat = {row.name: row.r_hat for row in posterior.convergence}
    free = [n for n in posterior.names if n in r_hat] or list(posterior.names)
    return tuple(sorted(free, key=lambda n: -float(np.nan_to_num(r_hat.get(n, 0.0), nan=np.inf)))[:count])


@styled
def traces_figure(posterior: Posterior, names: Sequence[str] | None = None, run: History | None = None) -> Figure:
    """Traces and rank histograms, one line of panels a number (default: the six hardest); one colour an ensemble.

    A trace is the median and the 90 % range of the ensemble's walkers along the run.
    """
    names = tuple(names) if names is not None else worst_names(posterior)
    run = history(posterior) if run is None else run
    ensembles, stored = run.z.shape[:2]
    figure, axes = subplots(len(names), 2, 7.2, 1.05 * len(names) + 0.7, width_ratios=(2.4, 1), sharex="col")
    bins = 20
    shown = np.linspace(0, stored - 1, min(stored, 120)).astype(int)
    for row, name in zip(axes, names):
        parameter = posterior.problem.prior[name]
        z = run.z[..., posterior.names.index(name)]
        x = parameter.value(z[:, shown])
        ranks = (rankdata(z).reshape(z.shape) - 0.5) / z.size
        for e in range(ensembles):
            style = series(e)
            low, middle, high = np.quantile(x[e], [0.05, 0.5, 0.95], axis=1)
            steps = run.thin * (1 + shown)
            row[0].fill_between(steps, low, high, color=style["color"], alpha=0.13, linewidth=0)
            row[0].plot(steps, middle, linewidth=0.9, **style)
            height, _ = np.histogram(ranks[e], bins=bins, range=(0, 1))
            row[1].stairs(height * bins / height.sum(), np.linspace(0, 1, bins + 1), linewidth=1.0, **style)
        row[1].axhline(1.0, color="#777777", linewidth=0.6)
        row[1].set_ylim(0.0, 2.0)
        row[0].set_ylabel(parameter.symbol, rotation=0, ha="right", va="center")
        row[0].locator_params(axis="y", nbins=4)
    axes[0, 0].set_title("walkers' median and 90 % range, one colour an ensemble", loc="left")
    axes[0, 1].set_title("ranks (1: even share)", loc="left")
    axes[-1, 0].set_xlabel("step of production")
    axes[-1, 1].set_xlabel("rank among all draws")
    return figure


@styled
def tau_figure(posterior: Posterior, run: History | None = None) -> Figure:
    """Autocorrelation time of every sampled parameter, estimated from ever longer parts of the run, and as long as it
    may be for a run to stop."""
    run = history(posterior) if run is None else run
    stored = run.z.shape[1]
    lengths = np.unique(np.geomspace(max(4, stored // 30), stored, 10).astype(int))
    taus = posterior.settings.sampling.taus
    tau = run.thin * np.array(
        [[autocorrelation_time(run.z[:, :n, :, i]) for i in range(posterior.ndim)] for n in lengths]
    )
    steps = run.thin * lengths
    figure, ax = one_panel(5.4, 3.0)
    for rank, i in enumerate(np.argsort(-tau[-1])):
        if rank < 3:
            symbol = posterior.problem.prior.free[i].symbol
            ax.plot(steps, tau[:, i], marker="o", markersize=3, label=symbol, **series(rank))
        else:
            ax.plot(steps, tau[:, i], color="#BBBBBB", linewidth=0.6)
    ax.plot(steps, steps / taus, color="#777777", linestyle=(0, (2, 2)), linewidth=0.9, label=f"steps / {taus:g}")
    ax.set(xscale="log", yscale="log")
    for axis, low, high in ((ax.xaxis, steps[0], steps[-1]), (ax.yaxis, *ax.get_ylim())):
        decimal_ticks(axis, low, high)
    ax.set(xlabel="steps of production", ylabel="autocorrelation time (steps)")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
