"""Checks of the predictive distribution: p-values per loop region, leave-one-out probability integral transform."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import special

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.comparison.frequencies import p_text
from bayes_iwan.comparison.loo import smoothed_log_weights
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.discrepancy import Correlated
from bayes_iwan.inference.setup.likelihood import Independent
from bayes_iwan.report.axes import numbered_cells
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import Predictive, predict
from bayes_iwan.report.style import BLUE, ORANGE, RED, one_panel, styled, subplots

_RISING = ("after lower\nreversal", "stretching,\nmid-stroke", "before upper\nreversal")
REGIONS = (*_RISING, "after upper\nreversal", "shortening,\nmid-stroke", "before lower\nreversal")


def region_of(displacement_mm: Array) -> NDArray[np.int64]:
    """The region of each sample of a loop (samples,), an index of REGIONS: by direction and third of the stroke."""
    u = np.asarray(displacement_mm, dtype=float)
    n = len(u)
    low, high = int(np.argmin(u)), int(np.argmax(u))
    rising = (np.arange(n) - low) % n < (high - low) % n
    third = np.clip(((u - u.min()) / max(float(np.ptp(u)), 1e-300) * 3.0).astype(int), 0, 2)
    return np.where(rising, third, 5 - third)


@dataclass(frozen=True)
class RegionChecks:
    """Posterior predictive p-values: the chance that a loop of the model's own would miss by more than the measured
    one does, mean square in the region, (tests, regions). Near 0: the model misses there more than it admits."""

    loops: tuple[Loop, ...]
    p_value: Array


def region_checks(posterior: Posterior, predictive: Predictive | None = None) -> RegionChecks:
    """p-values per test and loop region, residuals of each draw against replicates of the same draw.

    Residuals are taken about their mean over the loop: the force channel's zero drifts, and would drown the regions.
    """
    p = predict(posterior, n=800) if predictive is None else predictive
    observed, again = p.measured_N - p.force_N, p.loop_N - p.force_N
    observed = (observed - observed.mean(axis=-1, keepdims=True)) ** 2
    again = (again - again.mean(axis=-1, keepdims=True)) ** 2
    out = np.empty((len(p.loops), len(REGIONS)))
    for t in range(len(p.loops)):
        region = region_of(p.displacement_mm[t])
        for r in range(len(REGIONS)):
            here = region == r
            out[t, r] = np.mean(again[:, t, here].mean(axis=1) >= observed[:, t, here].mean(axis=1))
    return RegionChecks(p.loops, out)


@styled
def regions_figure(posterior: Posterior, checks: RegionChecks | None = None) -> Figure:
    """Predictive p-values by test and loop region, the number in each cell; low ones (a gap) orange and bold."""
    checks = region_checks(posterior) if checks is None else checks
    n = len(checks.loops)
    figure, ax = one_panel(7.2, 0.3 * n + 1.2)
    colours = LinearSegmentedColormap.from_list(
        "p", [(0.0, RED), (0.05, ORANGE), (0.12, "#FFFFFF"), (0.88, "#FFFFFF"), (1.0, BLUE)]
    )
    p, tests = checks.p_value, [test_name(x) for x in checks.loops]
    texts, bold = [list(map(p_text, row)) for row in p], (p < 0.05) | (p > 0.95)
    numbered_cells(ax, p, texts, tests, REGIONS, bold, cmap=colours, vmin=0, vmax=1, alpha=0.55)
    ax.set_title("chance that the model's own loops miss by more than the measured one", loc="left")
    return figure


def loo_pit(posterior: Posterior, n: int = 600) -> Array:
    """(data,) probability integral transform of each datum given all others, by Pareto-smoothed importance sampling, on
    the likelihood's own independent data: uniform if the predictive distribution is right.

    These are the rotated, whitened harmonics for the correlated likelihood (real and imaginary part of one omitted
    together) and, for the independent ones, as many samples as the loops' harmonics have parts. The mean forces are not
    among them: the correlated likelihood gives them next to no weight on purpose, which would show as intervals that
    are too wide.
    """
    problem = posterior.problem
    z = posterior.flat_z(n)
    parameter_values = problem.parameter_values(z)
    residual = problem.residual(z)
    log_p = problem.likelihood.pointwise(residual, parameter_values)
    if isinstance(problem.likelihood, Correlated):
        rows = problem.likelihood.rows(residual, parameter_values)
        parts = rows.reshape(len(z), 2, -1)  # real parts, imaginary parts; padding is zero in every draw
        used = np.any(parts[:, 0] != 0.0, axis=0)
        oscillating = np.any(parts[:, 1][:, used] != 0.0, axis=0)  # a mean has no imaginary part
        probability = special.ndtr(parts[:, :, used][:, :, oscillating])
        log_p = log_p[:, oscillating]
    else:
        assert isinstance(problem.likelihood, Independent)
        weight = problem.likelihood.weights
        scaled = residual / parameter_values["noise_N"][:, None, None]
        if problem.likelihood.name == "laplace":
            scaled = scaled * weight
            tail = 0.5 * np.exp(-np.abs(scaled))
            cdf = np.where(scaled < 0, tail, 1.0 - tail)
        else:
            cdf = special.ndtr(scaled * np.sqrt(weight))
        each = log_p.shape[1]
        some = np.linspace(0, each - 1, round(problem.likelihood.count * each)).astype(int)
        probability, log_p = cdf.reshape(len(z), 1, -1)[:, :, some], log_p[:, some]
    if probability.shape[2] != log_p.shape[1]:
        raise ValueError(f"LOO-PIT: {probability.shape[2]} data but {log_p.shape[1]} log-likelihoods")
    log_w, _ = smoothed_log_weights(-log_p.T)
    return np.einsum("dn,npd->pd", np.exp(log_w), probability).ravel()


@styled
def loo_pit_figure(posterior: Posterior, pit: Array | None = None) -> Figure:
    """The distribution of the LOO-PIT against the uniform one: histogram, and the distribution function less uniform
    with the band that 95 % of right models stay within."""
    pit = np.sort(loo_pit(posterior) if pit is None else pit)
    n = len(pit)
    figure, axes = subplots(1, 2, 7.2, 2.7)
    left, right = axes[0]
    bins = 20
    left.hist(pit, bins=bins, range=(0, 1), color=BLUE, alpha=0.6, density=True)
    half = 1.96 * np.sqrt((bins - 1) / n)
    left.axhspan(1 - half, 1 + half, color="#777777", alpha=0.2, linewidth=0)
    left.axhline(1.0, color="#777777", linewidth=0.7)
    left.set_title("a. histogram (grey: 95 % of each bar)", loc="left")
    left.set(xlabel="LOO-PIT", ylabel="density")
    bound = 1.358 / np.sqrt(n)  # Kolmogorov's 95 % point
    right.fill_between([0, 1], [-bound, -bound], [bound, bound], color="#777777", alpha=0.2, linewidth=0)
    right.step(np.r_[0, pit, 1], np.r_[0, np.arange(1, n + 1) / n, 1] - np.r_[0, pit, 1], where="post", color=BLUE)
    right.axhline(0.0, color="#777777", linewidth=0.7)
    right.set_title("b. distribution − uniform (grey: 95 %)", loc="left")
    right.set(xlabel="LOO-PIT", ylabel="difference")
    return figure
