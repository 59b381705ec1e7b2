"""Figures of the identified laws with their uncertainty: the paper's Figs. 8 (slip forces), 9 (k(α)), 10 (α(u))."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.models import Model, ModelError, sine_motion
from bayes_iwan.models.normal_force import ALPHA_FLOOR
from bayes_iwan.models.simulator import inner_effects
from bayes_iwan.report.axes import band, ticked
from bayes_iwan.report.style import PRIOR, one_panel, series, styled, subplots


def _model(posterior: Posterior) -> Model:
    """The Iwan model that was identified; other simulators have no such laws."""
    model = posterior.problem.model
    if not isinstance(model, Model):
        raise ModelError(f"the simulator {model.name} has no laws of slip force, stiffness and normal force to draw")
    return model


def _posterior_values(posterior: Posterior, n: int = 400) -> ParameterValues:
    return posterior.problem.parameter_values(posterior.flat_z(n))


def _prior_values(posterior: Posterior, n: int = 400, seed: int = 0) -> ParameterValues:
    z = posterior.problem.prior.draw(np.random.default_rng([seed, 41]), n)
    return posterior.problem.parameter_values(z)


def _reach(posterior: Posterior, parameter_values: ParameterValues) -> float:
    """Slip force that nearly all elements stay below, N."""
    family = _model(posterior).slip_family
    phi = np.linspace(0.0, 12.0 * posterior.problem.scales.slip_N, 500)
    survival = np.median(family.survival(phi, parameter_values), axis=0)
    return float(phi[min(int(np.searchsorted(-survival, -0.01)), len(phi) - 1)])


def _prior_lines(ax: Axes, x: Array, draws: Array) -> None:
    """Median and 90 % interval of the prior's draws (draws, len(x))."""
    low, middle, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
    ax.plot(x, middle, color=PRIOR, linestyle=(0, (4, 2)), linewidth=0.9, label="prior, median and 90 %")
    for end in (low, high):
        ax.plot(x, end, color=PRIOR, linestyle=(0, (1, 1.5)), linewidth=0.8)


@styled
def slip_density_figure(posterior: Posterior, prior: bool = True) -> Figure:
    """Fig. 8: the density of slip forces, and beside it the cumulative share of elements, which loops determine."""
    parameter_values = _posterior_values(posterior)
    family = _model(posterior).slip_family
    phi = np.linspace(0.0, _reach(posterior, parameter_values), 241)[1:]
    figure, axes = subplots(1, 2, 7.2, 3.1)
    left, right = axes[0]
    density = family.density(phi, parameter_values)
    below = 1.0 - family.survival(phi, parameter_values)
    band(left, phi, density, label="posterior")
    band(right, phi, below, label="posterior")
    if prior:
        from_prior = _prior_values(posterior)
        _prior_lines(left, phi, family.density(phi, from_prior))
        _prior_lines(right, phi, 1.0 - family.survival(phi, from_prior))
    # the density may be singular at the origin: show what carries weight
    left.set_ylim(0.0, 1.35 * float(np.quantile(density[:, len(phi) // 12 :], 0.98)))
    right.set_ylim(0.0, 1.02)
    left.set_title("a. density", loc="left")
    left.set_ylabel("density of slip forces (1/N)")
    right.set_title("b. cumulative", loc="left")
    right.set_ylabel("share of elements below")
    for ax in (left, right):
        ax.set(xlabel="slip force at rest φ (N)", xlim=(0.0, float(phi[-1])))
    right.legend(loc="lower right")
    return figure


def _alpha_range(posterior: Posterior, parameter_values: ParameterValues) -> tuple[float, float]:
    """The α that the measured loops visit, by the median draw."""
    problem = posterior.problem
    alpha = np.median(_model(posterior).alpha(parameter_values, problem.motion, inner_effects(problem.effects)), axis=0)
    return float(alpha.min()), float(alpha.max())


@styled
def stiffness_figure(posterior: Posterior, prior: bool = True) -> Figure:
    """Fig. 9: the elements' stiffness against the relative normal force; shaded where the tests went."""
    parameter_values = _posterior_values(posterior)
    model = _model(posterior)
    low, high = _alpha_range(posterior, parameter_values)
    alpha = np.linspace(0.0, max(1.2, 1.25 * high), 121)
    loaded = np.maximum(alpha, ALPHA_FLOOR)
    figure, ax = one_panel(4.6, 3.1)
    ax.axvspan(low, high, color="#DDDDDD", linewidth=0, label="α in the tests")

    def k(of: ParameterValues) -> Array:
        return model.k(of, np.tile(loaded, (len(of["kp_N_mm"]), 1, 1)))[:, 0]

    drawn = k(parameter_values)
    band(ax, alpha, drawn, label="posterior")
    ax.set_ylim(0.0, 1.15 * float(np.quantile(drawn, 0.99)))
    if prior:
        _prior_lines(ax, alpha, k(_prior_values(posterior)))
    ax.set(xlim=(0.0, float(alpha[-1])), xlabel="relative normal force α (-)", ylabel="element stiffness k(α) (N/mm)")
    ax.legend(loc="lower right")
    return figure


@styled
def normal_force_figure(posterior: Posterior) -> Figure:
    """Fig. 10: relative normal force along the largest stroke, on the way out and back, at each frequency tested."""
    problem = posterior.problem
    parameter_values = _posterior_values(posterior)
    amplitude, clock = problem.scales.length_mm, problem.loops[0].record.clock
    frequencies = sorted({round(float(f), 3) for f in problem.motion.frequency_hz})
    if len(frequencies) > 4:  # lines beyond that cannot be distinguished
        frequencies = [frequencies[i] for i in np.linspace(0, len(frequencies) - 1, 4).astype(int)]
    samples = 128
    motion = sine_motion(
        frequency_hz=np.array(frequencies), amplitude_mm=np.full(len(frequencies), amplitude), samples=samples
    )
    alpha = _model(posterior).alpha(parameter_values, motion, inner_effects(problem.effects))
    u = motion.displacement_mm[0, 0]
    figure, axes = subplots(1, 2, 7.2, 3.1, sharey=True)
    up = np.r_[np.arange(3 * samples // 4, samples), np.arange(samples // 4 + 1)]
    down = np.arange(samples // 4, 3 * samples // 4 + 1)
    for ax, branch, title in zip(axes[0], (up, down), ("a. stretching (u rising)", "b. shortening (u falling)")):
        for i, f in enumerate(frequencies):
            style, label = series(i), f"{f:.3g} Hz" if clock else None
            colour, line = style["color"], style["linestyle"]
            band(ax, u[branch], alpha[:, i, branch], colour, levels=(0.9,), line=line, label=label)
        ax.axhline(1.0, color="#777777", linewidth=0.6)
        ax.set_title(title, loc="left")
        ax.set_xlabel("displacement u (mm)")
    ticked(list(axes[0]))
    axes[0, 0].set_ylabel("relative normal force α (-)")
    if clock:
        axes[0, 1].legend(loc="best")
    return figure
