"""Where the model leaves what it means: contact that is lost, the end of the stroke, a negative density."""

from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model
from bayes_iwan.models.motion import Y_FLOOR
from bayes_iwan.models.normal_force import ALPHA_FLOOR
from bayes_iwan.models.simulator import inner_effects

#: what the floor on A − u changes at the end of the stroke is said where α changes by more
SAID = 0.1
#: a negative density is said where it takes back more than this share of the elements
NEGATIVE = 0.01
#: the form of slip forces of most components, which is advised where another one is too narrow
MOST_COMPONENTS = "gamma3"
_NODES = 400  # at which the slip forces' survival is read


@dataclass(frozen=True)
class Floors:
    """Where floors act at a point, and where the deviations make the slip forces' density negative.

    lost : by file of the tests that lose contact, the share of their samples with α at its floor
    at_end : share of the samples of all tests with A − u at its floor, 0.01 A; 0 where the law does not ask for A − u
    negative : share of the elements that a negative density takes back
    alpha_at_end, printed_at_end : α at u = A with that floor and as Eq. (11) is printed, where they differ most
    """

    lost: dict[str, float]
    at_end: float = 0.0
    alpha_at_end: float = 1.0
    printed_at_end: float = 1.0
    negative: float = 0.0


def floors_at(problem: Problem, z: Array) -> Floors:
    """Floors that act at z (ndim,); none for a simulator without a normal force."""
    model = problem.model
    if not isinstance(model, Model):
        return Floors({})
    values, motion = problem.parameter_values(z[None]), problem.motion
    alpha = model.alpha(values, motion, inner_effects(problem.effects))[0]
    share = np.mean(alpha <= ALPHA_FLOOR, axis=1)
    lost = {x.file: float(s) for x, s in zip(problem.loops, share) if s > 0.0}
    phi = 20.0 * problem.scales.slip_N * np.linspace(0.0, 1.0, _NODES) ** 2
    negative = float(np.sum(np.maximum(np.diff(model.slip_family.survival(phi, values)[0]), 0.0)))
    if "beta" not in model.normal_force_law.names:
        return Floors(lost, negative=negative)
    a = motion.amplitude_mm[:, None]
    slope, beta = float(values["normal_force_slope"][0]), float(values["beta"][0])
    change = slope * (motion.amplitude_mm / model.reference.length_mm) ** beta / beta
    most = int(np.argmax(np.abs(change)))
    printed = 1.0 - change[most]
    floored = 1.0 + change[most] * (Y_FLOOR**beta - 1.0)
    at_end = float(np.mean(a - motion.displacement_mm[0] <= Y_FLOOR * a))
    return Floors(lost, at_end, max(floored, ALPHA_FLOOR), float(printed), negative)


def floors_said(problem: Problem, z: Array) -> tuple[str, ...]:
    """One sentence for each floor that acts at z (ndim,) and matters."""
    floors, out = floors_at(problem, z), []
    if floors.lost:
        tests = ", ".join(f"{100.0 * share:.2g} % of the samples of {file}" for file, share in floors.lost.items())
        out.append(
            f"Contact is lost (normal force zero, elements carry nothing) in {tests}. How elements take up load again "
            "is the model's assumption: check slip forces by tests that keep contact."
        )
    if floors.negative > NEGATIVE:
        form = problem.model.name.split("/")[0]
        out.append(
            f"The slip forces' density is negative over {100.0 * floors.negative:.2g} % of the elements: their form "
            f"({form}) is far from what the loops show."
            + ("" if form == MOST_COMPONENTS else f" Try {MOST_COMPONENTS}.")
        )
    if abs(floors.alpha_at_end - max(floors.printed_at_end, ALPHA_FLOOR)) > SAID:
        out.append(
            f"Eq. (11) is used with A - u kept at or above {Y_FLOOR:g} A, which acts in {100.0 * floors.at_end:.2g} % "
            f"of the samples: at u = A the relative normal force is {floors.alpha_at_end:.2g}, not "
            f"{floors.printed_at_end:.2g} as printed."
        )
    return tuple(out)
