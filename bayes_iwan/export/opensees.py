"""The opensees target: elastic-perfectly-plastic springs in parallel, where the model allows it."""

from dataclasses import replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect
from bayes_iwan.export.c_code import filled, template
from bayes_iwan.export.card import Card
from bayes_iwan.export.device import Device, ExportError, elements, steady_loops, without_zero
from bayes_iwan.export.laws import LAWS
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model
from bayes_iwan.models.embedded_error import CORNER_NAME
from bayes_iwan.models.simulator import recorded_force

NAMES: tuple[str, ...] = ("isolator_opensees.py",)
#: largest difference of the backbone over the mean slip force
ERROR = 5e-5
#: what the card says in the place of the step's
DISCRETISATION = (
    "slip forces are lumped into as many springs as a stated error of the backbone asks. From the forward model, on a "
    "motion that is straight between the solver's steps: below 0.1 % of the friction force (RMS) and of the energy at "
    "20 steps a cycle and more, with the default error (analyses/export_round_trip.py)"
)
STEP = (
    "a material sees displacements and no velocity, so it follows straight lines between the solver's steps and misses "
    "where a motion turns within one. Of a smooth motion that is up to 3.6 % of the friction force at 20 steps a "
    "cycle, 1.8 % at 50, 0.2 % at 100 and 150, below 0.1 % at 250 (any material without velocity, any springs). "
    "Where a motion is prescribed, path() puts its turning points in: below 0.1 % at 20 steps then"
)


def files(
    device: Device, problem: Problem, z: Array, card: Card, *, approximate: bool, error: float
) -> tuple[dict[str, str], tuple[str, ...]]:
    """isolator_opensees.py, and what the card says of it. Raises ExportError for what springs cannot do, with the error
    that dropping it would cost, unless `approximate`."""
    if not 0.0 < error < 0.5:
        raise ExportError(f"error must lie between 0 and 0.5 of the mean slip force, not {error:g}")
    laws = dropped(device, problem)
    if laws:
        cost = cost_of_dropping(problem, z)
        what = ", ".join(laws)
        if not approximate:
            raise ExportError(
                f"OpenSees' springs have a constant normal force, so this would be dropped: {what}. The force on the "
                f"tested loops would then differ by {100 * cost:.3g} % of friction's RMS; give --approximate to accept "
                "that, or export to fmu or c"
            )
        notes: tuple[str, ...] = (
            f"dropped as asked (--approximate): {what}. On the tested loops the force differs by {100 * cost:.3g} % of "
            "friction's RMS for that",
        )
    else:
        notes = ("exact but for the number of springs: normal force and stiffness are constant",)
    values, counts = [], []
    for i in range(device.sets):
        stiffness, pulled, pushed = springs(device, i, error)
        spring = 1e3 * float(device.parameters["kp_N_mm"][i])
        rows = ", ".join(f"({k:.9g}, {a:.9g}, {b:.9g})" for k, a, b in zip(stiffness, pulled, pushed))
        values.append(f"    ({spring:.9g}, [{rows}]),")
        counts.append(len(stiffness))
    notes += (
        f"{min(counts)} to {max(counts)} springs, so many that the backbone is within {100 * error:.2g} % of the mean "
        "slip force; set error= for fewer or more",
    )
    text = replace(card, target=notes).text()
    return {
        NAMES[0]: filled(template(NAMES[0]), {"CARD": text, "VALUES": "\n".join(["one line each", *values])})
    }, notes


def springs(device: Device, index: int, error: float) -> tuple[Array, Array, Array]:
    """Stiffness (N/m) and the stretches (m) at which each spring yields when pulled and when pushed, of one set."""
    phi, share = elements(device, index, error)
    k = float(device.parameters["k1_N_mm"][index])
    asymmetry = sum(float(device.parameters[n][index]) for n in device.parameters if n.endswith("friction_asymmetry"))
    stretch = 1e-3 * phi / k
    return 1e3 * k * share, stretch * (1.0 + asymmetry), stretch * (1.0 - asymmetry)


def dropped(device: Device, problem: Problem) -> list[str]:
    """What parallel springs cannot do, in words."""
    out = []
    if device.stages["alpha"]:
        out.append(f"the normal force's law ({problem.model.name})")
    elif device.stages["stiffness"] or device.stages["slip"]:
        out.append("changing stiffness or friction")
    return out + [e.name for e in problem.effects if type(e) in LAWS and _moving(e)]


def cost_of_dropping(problem: Problem, z: Array) -> float:
    """RMS over the RMS friction force, all tests together, by which the point's loops change without these laws."""
    model, motion, values = problem.model, problem.motion, problem.parameter_values(z[:1])
    assert isinstance(model, Model)
    still = Model(model.reference, model.slip, "constant", "constant", embedded=model.embedded)
    kept = [e for e in problem.effects if type(e) in LAWS and not _moving(e)]
    at_rest = {n: np.zeros_like(x) if n == CORNER_NAME else x for n, x in values.items()}
    change = recorded_force(still, kept, without_zero(at_rest), motion) - steady_loops(problem, values, motion)
    return float(np.sqrt(np.mean(change**2) / np.mean(problem.friction_force(values, motion) ** 2)))


def _moving(effect: Effect) -> bool:
    """Has the effect a law beside what a spring's two yield forces can hold?"""
    return bool(set(LAWS[type(effect)].stages) - {"asymmetry"})
