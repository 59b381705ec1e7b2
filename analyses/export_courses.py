"""The exported step against the package's own forward model: steady cycles, a random record, a staircase, a shock."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.export.laws import OF_THE_RIG
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Motion
from bayes_iwan.models.simulator import FORCE_ZERO, inner_effects, recorded_force

#: samples of a cycle at the highest frequency with which the forward model follows a record
FINE = 800
#: and one that is straight between a solver's steps
FINE_STRAIGHT = 8000
#: forces in N (n,) of parameter set d for a motion: step (s), u (m), v (m/s), a (m/s²), amplitude A (m)
Force = Callable[[int, float, Array, Array, Array, float], Array]


@dataclass(frozen=True, kw_only=True)
class Course:
    """A motion as a function of time: u(t) in mm from rest at u = 0 with its derivatives, s; its highest frequency sets
    the step. settled_s: from when on force is compared (a steady cycle, after its first ones)."""

    name: str
    seconds: float
    highest_hz: float
    amplitude_mm: float
    displacement_mm: Callable[[Array], Array]
    settled_s: float = 0.0

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """u (m), v (m/s), a (m/s²) at t, derivatives by central differences a thousandth of a cycle apart."""
        d = 1e-3 / self.highest_hz
        before, now, after = (1e-3 * self.displacement_mm(x) for x in (t - d, t, t + d))
        return now, (after - before) / (2.0 * d), (after - 2.0 * now + before) / d**2


def courses(frequency_hz: float, amplitude_mm: float, seed: int = 0) -> tuple[Course, ...]:
    """The four motions about a frequency and an amplitude."""
    w, a, period = 2.0 * np.pi * frequency_hz, amplitude_mm, 1.0 / frequency_hz
    rng = np.random.default_rng(seed)
    hz, phase = frequency_hz * rng.uniform(0.2, 1.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)

    def begun(t: Array) -> Array:
        x = np.clip(t / period, 0.0, 1.0)
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)

    def random(t: Array) -> Array:
        return 0.25 * a * begun(t) * np.sin(2.0 * np.pi * hz * t[..., None] + phase).sum(axis=-1)

    levels = np.array([0.0, 0.3, 0.7, 1.0, 0.6, -0.2, -0.9, -0.4, 0.2, 0.0])

    def staircase(t: Array) -> Array:
        x = np.clip(t / period, 0.0, len(levels) - 1.001)
        i = x.astype(int)
        rise = np.clip(2.0 * (x - i), 0.0, 1.0)  # half of the time it rests
        rise = rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2)
        return a * (levels[i] + (levels[i + 1] - levels[i]) * rise)

    def shock(t: Array) -> Array:
        return a * begun(4.0 * t) * np.exp(-0.15 * w * t) * np.cos(w * t - 0.5 * np.pi)

    one = {"highest_hz": frequency_hz, "amplitude_mm": a}
    return (
        Course(
            name="steady cycles",
            seconds=4 * period,
            settled_s=3 * period,
            displacement_mm=lambda t: a * np.sin(w * t),
            **one,
        ),
        Course(name="random record", seconds=20 * period, displacement_mm=random, **one),
        # steps of a level take half a period, so they are twice as quick as the steady cycle
        Course(
            name="staircase", seconds=9 * period, displacement_mm=staircase, **one | {"highest_hz": 2 * frequency_hz}
        ),
        Course(name="shock", seconds=6 * period, displacement_mm=shock, **one | {"highest_hz": 4 * frequency_hz}),
    )


def forward(problem: Problem, values: ParameterValues, course: Course, fine: int = FINE) -> tuple[Array, Array, Array]:
    """Time (n,), force and friction (draws, n) in N of our own forward model from rest; effects of the rig and the
    channels' zero omitted. Effects that are filters over closed loops are not defined on a record."""
    n = round(course.seconds * course.highest_hz * fine)
    t = np.arange(n + 1) * course.seconds / n
    u, v, a = course.at(t)
    motion = Motion(
        displacement_mm=1e3 * u[None, None],
        velocity_m_s=v[None, None],
        acceleration_m_s2=a[None, None],
        frequency_hz=np.array([course.highest_hz]),
        amplitude_mm=np.array([course.amplitude_mm]),
        cycle=np.zeros(1),
        test=np.zeros(1, dtype=np.int64),
        periodic=False,
        step_s=t[1:2] - t[0],
    )
    values = {n: x for n, x in values.items() if n != FORCE_ZERO}
    effects = [e for e in problem.effects if not isinstance(e, OF_THE_RIG)]
    force = recorded_force(problem.model, effects, values, motion)[:, 0]
    friction = problem.model.friction_force(values, motion, inner_effects(effects))[:, 0]
    return t, force, friction


@dataclass(frozen=True)
class Difference:
    """Exported less our own: largest over the draws of the RMS over the RMS friction force, and of the work over the
    work of friction."""

    course: str
    steps: int
    rms: float
    energy: float


def straight(course: Course, steps: int) -> Course:
    """The course as a solver's steps describe it: through its positions at `steps` a cycle, straight between them. Our
    model rounds corners within its samples, so it needs many of them here (FINE_STRAIGHT)."""
    n = round(course.seconds * course.highest_hz * steps)
    t = np.arange(n + 1) * course.seconds / n
    u = course.displacement_mm(t)
    return replace(course, displacement_mm=lambda x: np.interp(x, t, u))


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Our own forward model on a course at `steps` equal steps a cycle of its highest frequency: step (s), motion after
    each step (steps,) as :meth:`Course.at`, force and friction there (draws, steps) in N."""

    course: Course
    steps: int
    step_s: float
    motion: tuple[Array, Array, Array]
    force_N: Array
    friction_N: Array


def reference(problem: Problem, values: ParameterValues, course: Course, steps: int, fine: int = FINE) -> Reference:
    """Our model follows the course with `fine` samples a cycle."""
    every = fine // steps
    t, ours, friction = forward(problem, values, course, every * steps)
    use = slice(every, None, every)
    return Reference(
        course=course,
        steps=steps,
        step_s=float(t[1] - t[0]) * every,
        motion=course.at(t[use]),
        force_N=ours[:, use],
        friction_N=friction[:, use],
    )


def compare(force: Force, ours: Reference) -> Difference:
    """How far `force` differs from our own forward model."""
    h, (u, v, a) = ours.step_s, ours.motion
    kept = h * np.arange(1, len(u) + 1) >= ours.course.settled_s - 1e-9
    rms, energy = [], []
    for d, (own, friction) in enumerate(zip(ours.force_N[:, kept], ours.friction_N[:, kept])):
        difference = force(d, h, u, v, a, 1e-3 * ours.course.amplitude_mm)[kept] - own
        rms.append(np.sqrt(np.mean(difference**2) / np.mean(friction**2)))
        energy.append(abs(np.sum(difference * v[kept])) / np.sum(np.abs(friction * v[kept])))
    return Difference(ours.course.name, ours.steps, float(np.max(rms)), float(np.max(energy)))


def module(folder: Path) -> ModuleType:
    """The exported isolator.py of a folder, which compiles its C."""
    spec = importlib.util.spec_from_file_location(f"isolator_{abs(hash(str(folder)))}", folder / "isolator.py")
    assert spec is not None and spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def in_c(isolator: ModuleType) -> Force:
    """Forces of the exported C step."""

    def force(d: int, h: float, u: Array, v: Array, a: Array, amplitude_m: float) -> Array:
        return np.array(isolator.Isolator(d, amplitude_m).run(h, u, v, a))

    return force
