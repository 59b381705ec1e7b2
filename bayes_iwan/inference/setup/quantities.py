"""Every quantity that a posterior is asked for: sampled ones, the paper's, and what the loops and laws say.

Single gamma components are hardly determined even by clean data; quantiles of the slip force, k(α), α(u), stiffness
and dissipated energy are. So these stand in the summary beside the sampled parameters and the paper's.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.setup.loop_scales import loop_energy_mJ
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model, Motion
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.simulator import Derived, inner_effects
from bayes_iwan.models.slip_force import SlipForce

CHUNK = 1024  # draws predicted at a time, to stay in memory
SLIP_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
_NODES = 320  # of the table that slip-force quantiles are read from


def quantities(problem: Problem, z: Array, loops: Sequence[Loop] | None = None) -> dict[str, Derived]:
    """All reported quantities at the draws z (draws, ndim), by name; quantities of a test are named `name[file]`.

    loops : the tests to report on, held-out ones included (default: those fitted).
    """
    loops = problem.loops if loops is None else tuple(loops)
    motion = motion_of(loops)
    parts = [_some(problem, z[i : i + CHUNK], loops, motion) for i in range(0, len(z), CHUNK)]
    text = problem.units.text
    return {
        name: Derived(text(q.unit), np.concatenate([p[name].values for p in parts])) for name, q in parts[0].items()
    }


def sampled_and_derived(problem: Problem, z: Array) -> dict[str, Derived]:
    """The sampled parameters and those that follow from them (the paper's) alone, which cost no prediction."""
    values = problem.prior.values(z)
    out = {p.name: Derived(p.unit, values[p.name]) for p in problem.prior.parameters}
    for name, quantity in problem.model.derived(problem.parameter_values_of(values)).items():
        out.setdefault(name, Derived(problem.units.text(quantity.unit), quantity.values))
    return out


def _some(problem: Problem, z: Array, loops: Sequence[Loop], motion: Motion) -> dict[str, Derived]:
    out = sampled_and_derived(problem, z)
    parameter_values, model = problem.parameter_values(z), problem.model
    alpha = None
    if isinstance(model, Model):
        family = model.slip_family
        out.setdefault("mean_slip_force_N", Derived("N", family.mean(parameter_values)))
        for share, x in zip(SLIP_SHARES, slip_quantiles(family, parameter_values, SLIP_SHARES).T):
            out[f"slip_force_q{round(100 * share):02d}_N"] = Derived("N", x)
        alpha = model.alpha(parameter_values, motion, inner_effects(problem.effects))

    force = problem.force(parameter_values, motion)
    energy, stiffness, loss = loop_quantities(motion.displacement_mm, force)
    for j, loop in enumerate(loops):
        u = loop.displacement_mm
        down = np.argmin(np.where(np.roll(u, 1) > np.roll(u, -1), np.abs(u), np.inf))  # u nearest zero where it falls
        out[f"dissipated_energy_mJ[{loop.file}]"] = Derived("mJ", energy[:, j])
        out[f"equivalent_stiffness_N_mm[{loop.file}]"] = Derived("N/mm", stiffness[:, j])
        out[f"loss_factor[{loop.file}]"] = Derived("-", loss[:, j])
        if alpha is None:
            continue
        places = (("minus_A", np.argmin(u)), ("0_up", 0), ("plus_A", np.argmax(u)), ("0_down", down))
        for place, i in places:
            out[f"alpha_{place}[{loop.file}]"] = Derived("-", alpha[:, j, i])
    return out


class LoopQuantities(NamedTuple):
    """What an isolator's designer reads off a loop; arrays shaped as the forces without their last axis.

    energy_mJ : dissipated a cycle, ∮F du. stiffness_N_mm : real part of the first harmonic of force over that of
    displacement. loss_factor : energy / (π · stiffness · |first harmonic of displacement|²), the tangent of the loss
    angle.
    """

    energy_mJ: Array
    stiffness_N_mm: Array
    loss_factor: Array


def loop_quantities(displacement_mm: Array, force_N: Array) -> LoopQuantities:
    """The quantities of periodic loops on a uniform phase grid: displacement ([1,] tests, samples), force (…, tests,
    samples)."""
    samples = force_N.shape[-1]
    energy = loop_energy_mJ(displacement_mm, force_N)
    turn = np.exp(-2j * np.pi * np.arange(samples) / samples)
    u1 = displacement_mm @ turn * (2.0 / samples)
    ratio = (force_N @ turn * (2.0 / samples)) / u1
    return LoopQuantities(energy, ratio.real, energy / (np.pi * ratio.real * np.abs(u1) ** 2))


def slip_quantiles(family: SlipForce, parameter_values: ParameterValues, shares: Sequence[float]) -> Array:
    """Slip force (N) below which each share of the elements slips at rest, (draws, shares)."""
    top = family.mean(parameter_values) / (1.0 - max(shares))  # Markov's inequality: no quantile is larger
    phi = top[:, None] * np.linspace(0.0, 1.0, _NODES) ** 2
    below = np.maximum.accumulate(1.0 - family.survival(phi, parameter_values), axis=1)
    return np.stack([np.interp(shares, row, at) for row, at in zip(below, phi)])
