"""The device as stages in time: what a problem with its effects, and some draws, become before a target is written."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from string import Template

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Campaign
from bayes_iwan.effects.base import Effect
from bayes_iwan.errors import InputError
from bayes_iwan.export.laws import CYCLE_STATES, LAWS, OF_THE_RIG, Law
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model, Motion, embedded_error, normal_force, slip_force
from bayes_iwan.models.motion import Y_FLOOR
from bayes_iwan.models.normal_force import ALPHA_FLOOR
from bayes_iwan.models.simulator import FORCE_ZERO, recorded_force

#: in the order of the step
STAGES = ("before", "alpha", "stiffness", "slip", "asymmetry", "specimen", "force")


class ExportError(InputError):
    """What cannot be exported; the message says what, and what to do."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """What is exported: a problem, its point estimate and draws z (1 + draws, ndim), and where they come from;
    unexplained : RMS in N, and as a share of the friction force."""

    problem: Problem
    z: Array
    campaign: Campaign | None
    method: str
    seed: int
    unexplained: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Device:
    """An identified device, for any motion in time.

    parameters : (sets,) or (sets, n) each, by C name; set 0 is the point estimate, the others draws. tables, top_N :
    (sets, cells, 4) cubics of L(φ) = E[min(Φ, φ)] and (sets,) where they end, as the sliders' kernel reads them. stages
    : C statements of each stage, in order. states : length and value at rest of what the stages remember. named,
    omitted : effects in the device with a note each ("" where its law is as identified), and those omitted, with the
    reason.
    """

    parameters: dict[str, Array] = field(default_factory=dict)
    tables: Array
    top_N: Array
    stages: dict[str, tuple[str, ...]] = field(default_factory=lambda: dict.fromkeys(STAGES, ()))
    states: dict[str, tuple[int, float]] = field(default_factory=dict)
    named: dict[str, str] = field(default_factory=dict)
    omitted: dict[str, str] = field(default_factory=dict)

    @property
    def sets(self) -> int:
        return len(self.top_N)

    @property
    def constant_normal_force(self) -> bool:
        """Do normal force and stiffness stay what they are at rest?"""
        return not any(self.stages[s] for s in ("alpha", "stiffness", "slip"))


def device_of(problem: Problem, z: Array, tested_hz: tuple[float, float]) -> Device:
    """The device of a problem at coordinates z (sets, ndim). Raises ExportError for what has no law in time."""
    model = problem.model
    if not isinstance(model, Model):
        raise ExportError(
            f"{model.name} is a simulator of your own, which cannot be written in C: it turns whole motions into "
            "force, not steps. Export its draws with --to json, and call it from Python"
        )
    values = problem.parameter_values(z)
    kept, named, omitted = [], {}, {}
    for effect in problem.effects:
        assert isinstance(effect, Effect)
        if isinstance(effect, OF_THE_RIG):
            omitted[effect.name] = "belongs to the rig or its channels, not to the device"
        elif (law := LAWS.get(type(effect))) is None:
            raise ExportError(
                f"the effect {effect.name} has no law in time to export; identify without it, or add its C to "
                "bayes_iwan/export/laws.py"
            )
        else:
            kept.append((effect, law))
            named[effect.name] = law.note
    parameters, stages = _base(model, values, bool(kept))
    parameters["length_mm"] = np.full(len(z), problem.scales.length_mm)
    parameters["speed_m_s"] = np.full(len(z), problem.scales.speed_m_s)
    states: dict[str, tuple[int, float]] = {}
    for effect, law in kept:
        _add(effect, law, values, tested_hz, parameters, stages, states)
    if kept and stages["alpha"]:  # of all of them, as in the model
        stages["alpha"].append(f"alpha = fmax(alpha, {ALPHA_FLOOR!r});")
    if any("turned" in code for code in stages["before"]):
        states |= CYCLE_STATES
        stages["before"].insert(0, "const int turned = half_cycle(p, s, s->time_s + h, u);")
    tables, top = model.slip_family.table(values)
    for effect, _ in kept:
        tables = effect.slip_table(tables, top, values)
    scalars = np.concatenate([np.atleast_2d(x.T).ravel() for x in parameters.values()])
    if not (np.isfinite(scalars).all() and np.isfinite(tables).all() and np.all(top > 0.0)):
        raise ExportError("some draws give no finite force (slip forces or laws out of range); export fewer draws")
    return Device(
        parameters=parameters,
        tables=np.ascontiguousarray(tables),
        top_N=top,
        states=states,
        named=named,
        stages={name: tuple(code) for name, code in stages.items()},
        omitted=omitted,
    )


def _base(model: Model, values: ParameterValues, floored: bool) -> tuple[dict[str, Array], dict[str, list[str]]]:
    """Parameters and stages of the Iwan model itself; floored : is α held above its floor after effects?"""
    ell, speed = model.reference.length_mm, model.reference.speed_m_s
    sets = len(values["kp_N_mm"])
    names = [n for n in model.names if n not in (*model.slip_family.names, *embedded_error.SLIP_NAMES)]
    parameters = {n: np.asarray(values[n], float) for n in names}
    parameters["amplitude_mm"] = np.full(sets, ell)
    stages: dict[str, list[str]] = {name: [] for name in STAGES}
    alpha, law = stages["alpha"], model.normal_force_law
    if isinstance(law, normal_force.HuntCrossley):
        beta = parameters["beta"]
        parameters["beta"] = np.where(np.abs(beta) < 1e-12, 1e-12, beta)
        rate = f"p->normal_force_rate / {speed!r}" if law.speed else "0.0"
        alpha.append(
            f"""{{
    const double centre = exp(p->beta * log(A / {ell!r}));
    const double rise = expm1(p->beta * log(fmax(A - u, {Y_FLOOR!r} * A) / A));
    alpha = 1.0 + p->normal_force_slope * centre / p->beta * rise + {rate} * centre * (1.0 + rise) * fabs(v);
    alpha = fmax(alpha, {ALPHA_FLOOR!r});
}}"""
        )
    elif isinstance(law, normal_force.Polynomial):
        sum_ = "0.0"
        for name in reversed(law.names):
            sum_ = f"(p->{name} + {sum_}) * u / {ell!r}"
        alpha.append(f"alpha = fmax(1.0 + {sum_}, {ALPHA_FLOOR!r});")
    elif not isinstance(law, normal_force.Constant):
        raise ExportError(f"the normal force {law.name!r} has no law in C yet; add it to bayes_iwan/export/device.py")
    if model.stiffness == "saturating":
        stages["stiffness"].append("k = p->k1_N_mm * expm1(-p->stiffness_ratio * alpha) / expm1(-p->stiffness_ratio);")
    if model.embedded:
        at_corner = f"(A - u) / ({embedded_error.CORNER_WIDTH!r} * A)"
        alpha.append(f"alpha *= exp(p->{embedded_error.CORNER_NAME} / (1.0 + {at_corner} * {at_corner}));")
        stages["stiffness"].append(f"k *= exp(p->{embedded_error.STIFFNESS_NAME} * log(alpha));")
    if law.name == "constant" and not floored:  # α is 1, so k is k(1) whatever the law of the stiffness
        if not (model.embedded and np.any(parameters[embedded_error.CORNER_NAME] != 0.0)):
            alpha.clear()
            stages["stiffness"].clear()
    return parameters, stages


def _add(
    effect: Effect,
    law: Law,
    values: ParameterValues,
    tested_hz: tuple[float, float],
    parameters: dict[str, Array],
    stages: dict[str, list[str]],
    states: dict[str, tuple[int, float]],
) -> None:
    """An effect's parameters, states and C, under names of its own."""
    short = {p.name.split(".", 1)[1]: p.name for p in effect.parameters}
    own = law.numbers(effect, values, tested_hz) if law.numbers else {n: values[full] for n, full in short.items()}
    used = {n: x for n, x in own.items() if any(f"${n}" in code for code in law.stages.values())}
    parameters |= {f"{effect.name}_{n}": np.asarray(x, float) for n, x in used.items()}
    states |= {f"{effect.name}_{n}": state for n, state in law.states.items()}
    fields = {n: f"p->{effect.name}_{n}" for n in used}
    for stage, code in law.stages.items():
        text = Template(code).substitute(fields)
        for name in sorted(law.states, key=len, reverse=True):
            text = text.replace(f"@{name}", f"s->{effect.name}_{name}")
        stages[stage].append(text)
        if stage == "slip":
            stages[stage].append(f"slip = fmax(slip, {ALPHA_FLOOR!r});")


def elements(device: Device, index: int, error: float) -> tuple[Array, Array]:
    """Stop elements that stand for set `index` at α = 1: their yield forces φ (n,) in N and shares (n,) of k(1).

    The backbone of n elements is straight between its n corners, so it is L(φ) read at the corners: as few as keep the
    difference within `error` of the mean slip force. Their sum falls short of 1 by the share that slips at once.
    """
    phi, value = limited_mean(device.tables[index], device.top_N[index])
    mean, corners = value[-1], [0.0]
    at = 0
    while at < len(phi) - 1:
        low, high = at + 1, len(phi) - 1
        while low < high:  # the farthest node to which a chord stays close enough: the error grows with its length
            middle = (low + high + 1) // 2
            chord = value[at] + (phi[at : middle + 1] - phi[at]) * (value[middle] - value[at]) / (phi[middle] - phi[at])
            low, high = (middle, high) if np.max(value[at : middle + 1] - chord) <= error * mean else (low, middle - 1)
        at = low
        corners.append(float(phi[at]))
    corner = np.array(corners)
    # where the deviations make the density negative elements would have a negative stiffness
    slope = np.append(np.minimum.accumulate(np.diff(np.interp(corner, phi, value)) / np.diff(corner)), 0.0)
    share = slope[:-1] - slope[1:]
    return corner[1:], share


#: places at which each cell of a table is read
PLACES = 8


def limited_mean(table: Array, top: float) -> tuple[Array, Array]:
    """φ (n,) in N from 0 to the table's end, PLACES a cell, and L(φ) there."""
    octaves = slip_force.OCTAVES
    per_octave = len(table) // octaves
    octave, place = np.divmod(np.arange(PLACES * len(table) + 1) / PLACES, per_octave)
    phi = top * np.ldexp(1.0 + place / per_octave, octave.astype(int) - octaves)
    w = np.arange(PLACES) / PLACES
    value = table @ np.stack([w**0, w, w**2, w**3])
    return np.append(0.0, phi), np.concatenate([[0.0], value.ravel(), [table[-1].sum()]])


def rows_of(table: Array) -> Array:
    """A table (cells, 4) with the parabola through 0 for what lies below its octaves before it, (cells + 1, 4)."""
    octaves = slip_force.OCTAVES
    low, slope = table[0, 0], table[0, 1] * (len(table) // octaves)
    return np.vstack([[0.0, 2.0 * low - slope, slope - low, 0.0], table])


def effects_text(named: Mapping[str, str]) -> str:
    """Effects and their notes in one line."""
    return "; ".join(f"{n} ({note})" if note else n for n, note in named.items()) or "none"


# ---- forces on the tested loops by the package's own forward model: what a model card says of a choice


def steady_loops(problem: Problem, values: ParameterValues, motion: Motion) -> Array:
    """Force (draws, loops, samples) of our own forward model, the rig's effects and the channel's zero omitted."""
    effects = [e for e in problem.effects if not isinstance(e, OF_THE_RIG)]
    return recorded_force(problem.model, effects, without_zero(values), motion)


def without_zero(values: ParameterValues) -> ParameterValues:
    """The values without the force channel's zero, which is no part of the device."""
    return {n: x for n, x in values.items() if n != FORCE_ZERO}


def fixed_amplitude(problem: Problem, values: ParameterValues, amplitude_mm: float) -> Array:
    """(tests,) RMS over the RMS friction force by which the tested loops change where A of Eq. (11) stays at one value
    instead of each test's own amplitude, the largest over the draws."""
    motion = problem.motion
    own = steady_loops(problem, values, motion)
    fixed = steady_loops(problem, values, replace(motion, amplitude_mm=np.full(motion.loops, amplitude_mm)))
    friction = problem.friction_force(values, motion)
    change = np.sqrt(np.mean((fixed - own) ** 2, axis=2) / np.mean(friction**2, axis=2))
    return np.asarray(change.max(axis=0))
