"""What the loops of a campaign reach, and which reported quantities lie beyond: those the family of slip forces alone
extrapolates.

After a reversal the displacement must move by the finest step that the trusted harmonics resolve before anything is
seen, so elements of the least slip forces cannot be distinguished from ones that slip at once. Elements of the largest
slip forces never slip at the largest amplitude: they act as a spring beside the parallel one, and only the family of
slip forces says which part of the spring they are. So kp and k(1), of which the loops determine the sum alone, and the
mean slip force are as good as that family is.
"""

import math
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import SLIP_SHARES
from bayes_iwan.models import Model

#: what elements that never slip leave to the family of slip forces, and the share of them from which it is marked
LEFT_TO_FAMILY, NEVER_SLIP = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N"), 1e-3
#: a further amplitude that is asked for is at least so many times the largest: two digits show that it is larger
FURTHER = 1.1
#: k(1) is called extrapolated where the least slip force that loops resolve is this part of the lower quartile
LEAST_PART = 0.12
#: draws that this is asked of, and slip forces at which their distribution is tabulated
_DRAWS, _NODES = 200, 400


@dataclass(frozen=True)
class Reach:
    """What the fitted loops reach, each the median over draws unless it is said otherwise.

    step_mm : least step that the trusted harmonics resolve after a reversal
    lowest_N, highest_N : slip forces of the elements that slip within that step, and at the largest amplitude at all
    part : lowest_N over the lower quartile of the slip forces
    never_slip : share of the elements beyond highest_N, mean over draws: an expected share, not a typical one
    needed_mm : amplitude at which that mean share would be NEVER_SLIP
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
    wanted = (0.25, *SLIP_SHARES)
    at = np.median([np.interp(wanted, row, phi) for row in below], axis=0)
    upto_mm = phi / float(np.median(k1))
    slipping = np.mean([np.interp(upto_mm * k, phi, row) for k, row in zip(k1, below)], axis=0)
    lowest = 0.5 * float(np.median(k1)) * step
    return Reach(
        step_mm=step,
        lowest_N=lowest,
        highest_N=float(np.median(highest)),
        part=lowest / max(float(at[0]), 1e-9 * top),
        never_slip=1.0 - float(np.mean([np.interp(end, phi, row) for end, row in zip(highest, below)])),
        needed_mm=float(np.interp(1.0 - NEVER_SLIP, slipping, upto_mm)),
        amplitudes_mm=(min(amplitudes), max(amplitudes)),
        quantiles_N=tuple(float(x) for x in at[1:]),
    )


def _step_mm(loop: Loop) -> float:
    order = int(np.max(np.nonzero(np.isfinite(loop.noise_N))[0]))
    return loop.amplitude_mm * (1.0 - math.cos(math.pi / max(order, 1)))


def extrapolated(problem: Problem, z: Array) -> dict[str, str]:
    """By name of the quantities that no loop determines: why, and which amplitudes are needed.

    z : a point (ndim,) or draws (draws, ndim). Empty for a simulator without slip forces.
    """
    reach = reach_of(problem, z)
    if reach is None:
        return {}
    length, force = problem.units.text("mm"), problem.units.text("N")
    least, largest = reach.amplitudes_mm
    fine = (
        f"Extrapolated below a slip force of {reach.lowest_N:.3g} {force}: no step under {reach.step_mm:.2g} {length} "
        f"is resolved after a reversal; amplitudes below {least:.3g} {length} are needed"
    )
    needed = f"tests at {max(reach.needed_mm, FURTHER * largest):.2g} {length} are needed"
    beyond = f"at the largest amplitude, {largest:.3g} {length}; {needed}"
    out = {}
    for tenth, at in zip(SLIP_SHARES, reach.quantiles_N):
        name = f"slip_force_q{round(100 * tenth):02d}_N"
        if at < reach.lowest_N:
            out[name] = fine
        if at > reach.highest_N:
            out[name] = f"Extrapolated: elements above {reach.highest_N:.3g} {force} never slip {beyond}"
    if reach.never_slip > NEVER_SLIP:
        share = f"{100.0 * reach.never_slip:.2g} % of the elements never slip"
        out |= dict.fromkeys(LEFT_TO_FAMILY, f"Extrapolated by the family of slip forces: {share} {beyond}")
    if reach.part > LEAST_PART:
        out["k1_N_mm"] = ". ".join((fine, out["k1_N_mm"])) if "k1_N_mm" in out else fine
    return out
