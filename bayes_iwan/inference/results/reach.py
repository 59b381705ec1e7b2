"""What the loops of a campaign reach, and which reported quantities lie beyond: those the family of slip forces alone
extrapolates.

After a reversal the displacement must move by the finest step that the trusted harmonics resolve before anything is
seen, so elements of the least slip forces cannot be distinguished from ones that slip at once. Elements of the largest
slip forces never slip at the largest amplitude: they act as a spring beside the parallel one, and only the family of
slip forces says which part of the spring they are. So kp and the mean slip force are as good as that family is.
"""

import math
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import SLIP_SHARES
from bayes_iwan.models import Model

#: where more of the elements than this never slip, kp and the mean slip force are called extrapolated
NEVER_SLIP = 1e-3
#: k(1) is called extrapolated where the least slip force that loops resolve is this part of the lower quartile
LEAST_PART = 0.12
#: draws that this is asked of, and slip forces at which their distribution is tabulated
_DRAWS, _NODES = 200, 400


@dataclass(frozen=True)
class Reach:
    """What the fitted loops reach, each the median over draws.

    step_mm : least step that the trusted harmonics resolve after a reversal
    lowest_N, highest_N : slip forces of the elements that slip within that step, and at the largest amplitude at all
    part : lowest_N over the lower quartile of the slip forces
    never_slip : share of the elements beyond highest_N, mean over draws: an expected share, not a typical one
    needed_mm : amplitude at which all but NEVER_SLIP of them would slip
    amplitudes_mm : least and largest amplitude
    quantiles_N : slip force below which each of SLIP_SHARES of the elements slips
    """

    step_mm: float
    lowest_N: float
    highest_N: float
    part: float
    never_slip: float
    needed_mm: float
    amplitudes_mm: tuple[float, float]
    quantiles_N: tuple[float, ...]


def reach_of(problem: Problem, z: Array) -> Reach | None:
    """The reach of a problem's loops at a point z (ndim,) or over draws (draws, ndim); None for a simulator without
    slip forces.

    Within a phase of π/H after a reversal, H the highest trusted harmonic, the displacement has moved A(1 − cos(π/H)).
    Elements up to φ = k(1)·step/2 have slipped by then. Those beyond k(1)·A never slip.
    """
    model = problem.model
    if not isinstance(model, Model):
        return None
    z = np.atleast_2d(z)
    values = problem.parameter_values(z[np.linspace(0, len(z) - 1, min(len(z), _DRAWS)).astype(int)])
    step = min(_step_mm(x) for x in problem.loops)
    amplitudes = [x.amplitude_mm for x in problem.loops]
    k1 = values["k1_N_mm"]
    highest = k1 * max(amplitudes)
    top = 20.0 * max(float(np.median(highest)), problem.scales.slip_N)
    phi = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, _NODES)]) * top
    below = np.maximum.accumulate(1.0 - model.slip_family.survival(phi, values), axis=1)
    wanted = (0.25, 1.0 - NEVER_SLIP, *SLIP_SHARES)
    at = np.median([np.interp(wanted, row, phi) for row in below], axis=0)
    beyond = [1.0 - np.interp(end, phi, row) for end, row in zip(highest, below)]
    lowest = 0.5 * float(np.median(k1)) * step
    return Reach(
        step_mm=step,
        lowest_N=lowest,
        highest_N=float(np.median(highest)),
        part=lowest / max(float(at[0]), 1e-9 * top),
        never_slip=float(np.mean(beyond)),
        needed_mm=float(at[1] / np.median(k1)),
        amplitudes_mm=(min(amplitudes), max(amplitudes)),
        quantiles_N=tuple(float(x) for x in at[2:]),
    )


def _step_mm(loop: Loop) -> float:
    order = int(np.max(np.nonzero(np.isfinite(loop.noise_N))[0]))
    return loop.amplitude_mm * (1.0 - math.cos(math.pi / max(order, 1)))


def extrapolated(problem: Problem, z: Array) -> dict[str, str]:
    """By name of the quantities that no loop determines: one sentence why, and which range would.

    z : a point (ndim,) or draws (draws, ndim). Empty for a simulator without slip forces.
    """
    reach = reach_of(problem, z)
    if reach is None:
        return {}
    units = problem.units
    length, force = units.text("mm"), units.text("N")
    fine = (
        f"Extrapolated below a slip force of {reach.lowest_N:.3g} {force}: no step under {reach.step_mm:.2g} {length} "
        f"is resolved after a reversal; amplitudes below {reach.amplitudes_mm[0]:.3g} {length} would determine it"
    )
    share = f"{100.0 * reach.never_slip:.2g} % of the elements never slip"
    wider = (
        f"tests at {reach.needed_mm:.2g} {length} would determine it"
        if reach.needed_mm > reach.amplitudes_mm[1]
        else f"amplitudes above {reach.amplitudes_mm[1]:.3g} {length} would determine it"
    )
    beyond = f"at the largest amplitude, {reach.amplitudes_mm[1]:.3g} {length}; {wider}"
    out = {}
    if reach.part > LEAST_PART:
        out["k1_N_mm"] = fine
    for tenth, at in zip(SLIP_SHARES, reach.quantiles_N):
        name = f"slip_force_q{round(100 * tenth):02d}_N"
        if at < reach.lowest_N:
            out[name] = fine
        if at > reach.highest_N:
            out[name] = f"Extrapolated: elements above {reach.highest_N:.3g} {force} never slip {beyond}"
    if reach.never_slip > NEVER_SLIP:
        for name in ("kp_N_mm", "mean_slip_force_N"):
            out[name] = f"Extrapolated by the family of slip forces: {share} {beyond}"
    return out
