"""Does an exported device give the force that the package's own forward model gives? In every target that runs here.

    python analyses/export_round_trip.py RUN [RUN ...] [--draws 2] [--cycles 1e6] [--out table.md]

RUN is a folder of `bayes-iwan identify`; export_posteriors.py makes 20 sampled ones of either kind. Four motions
(steady cycles, a random record, a staircase, a shock), 20, 50 and 100 steps a cycle of their highest frequency; each
figure is the largest over all runs and draws. Then: json read back, a million cycles, and the work of closed cycles.
Runs that did not converge are left out, and named.

An OpenSees material sees the solver's displacements and no velocity, so between two steps its motion is straight. It is
compared with our model on that same motion; on the smooth motion at 20, 50, 100, 150 and 250 steps; and on the smooth
motion where the path also has its turning points.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import bayes_iwan as bi
import export_courses as rt
from bayes_iwan.export import exporting as export_run
from bayes_iwan.export.device import steady_loops
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model
from export_targets import Unavailable, drake_force, fmu_force, mujoco_force, opensees_force, plugin_force

STEPS = (20, 50, 100)
CLASSICAL = {"model": {"normal_force": "constant", "stiffness": "constant", "embedded": False}}


@dataclass(frozen=True)
class Row:
    """A row of the table: what is exported, what computes forces with its files, and whether the reference's motion is
    straight between the steps."""

    target: str
    forces: Callable[[Path], rt.Force]
    straight: bool = False
    steps: tuple[int, ...] = STEPS


def rows(constant: bool) -> dict[str, Row]:
    """By the name in the table; constant : is the normal force constant, so that OpenSees' springs can hold it?"""
    every = {
        "c": Row("c", lambda folder: rt.in_c(rt.module(folder))),
        "fmu, FMI 2.0": Row("fmu", lambda folder: fmu_force(folder / "isolator_fmi2.fmu")),
        "fmu, FMI 3.0": Row("fmu", lambda folder: fmu_force(folder / "isolator_fmi3.fmu")),
        "FMI 2.0, steps varied and rejected": Row("fmu", lambda f: fmu_force(f / "isolator_fmi2.fmu", True)),
        "FMI 3.0, steps varied and rejected": Row("fmu", lambda f: fmu_force(f / "isolator_fmi3.fmu", True)),
        "mujoco, Python": Row("mujoco", lambda folder: mujoco_force(folder)),
        "mujoco, plugin": Row("mujoco", lambda folder: plugin_force(folder)),
        "drake": Row("drake", lambda folder: drake_force(folder)),
    }
    springs = {
        "opensees, straight between steps": Row("opensees", lambda folder: opensees_force(folder), True),
        "opensees, smooth motion": Row("opensees", lambda folder: opensees_force(folder), steps=(*STEPS, 150, 250)),
        "opensees, smooth motion, turning points in its path": Row("opensees", lambda f: opensees_force(f, True)),
    }
    return springs if constant else every


def json_difference(posterior: bi.Posterior, folder: Path, draws: int) -> float:
    """Largest difference of forces from the file that is read back, over the RMS force."""
    model = bi.load(posterior.export("json", folder, draws=draws))
    motion = posterior.problem.motion
    source = export_run.source_of(posterior, draws, None, None)
    ours = steady_loops(posterior.problem, posterior.problem.parameter_values(source.z), motion)
    return float(np.abs(model.force(motion) - ours).max() / np.sqrt(np.mean(ours**2)))


def many_cycles(folder: Path, frequency_hz: float, amplitude_mm: float, cycles: int) -> tuple[float, float]:
    """Largest change of the force from the second cycle to the last, over its largest, and pieces of memory then."""
    device = rt.module(folder).Isolator(0)
    steps, block = 20, 1000
    t = np.arange(1, steps * block + 1) / (steps * frequency_hz)
    w = 2.0 * np.pi * frequency_hz
    u, v = 1e-3 * amplitude_mm * np.sin(w * t), 1e-3 * amplitude_mm * w * np.cos(w * t)
    first = last = np.array([])
    for i in range(max(cycles // block, 1)):
        force = np.array(device.run(1.0 / (steps * frequency_hz), u, v))
        first = force[steps : 2 * steps] if i == 0 else first
        last = force[-steps:]
    return float(np.abs(last - first).max() / np.abs(first).max()), float(
        np.frombuffer(device.save())[device.size - 6 * 64 - 1]
    )


def least_work(folder: Path, draws: int, frequency_hz: float, amplitude_mm: float) -> float:
    """Least work of a closed cycle over the RMS force times its stroke: 200 cycles a draw about random means, of random
    amplitude and shape, each after one that settles it. Negative: energy was gained."""
    isolator, rng = rt.module(folder), np.random.default_rng(5)
    phase = np.arange(1, 201) / 200
    least = np.inf
    for d in range(draws + 1):
        device = isolator.Isolator(d)
        for _ in range(200):
            mean, size, third, hz = (
                rng.uniform(-0.5, 0.5),
                10 ** rng.uniform(-2, 0),
                rng.uniform(0, 0.5),
                rng.uniform(0.2, 1.5),
            )
            w = 2.0 * np.pi * hz * frequency_hz
            u = 1e-3 * amplitude_mm * (mean + size * (np.sin(2 * np.pi * phase) + third * np.sin(6 * np.pi * phase)))
            v = 1e-3 * amplitude_mm * w * size * (np.cos(2 * np.pi * phase) + 3 * third * np.cos(6 * np.pi * phase))
            h = 1.0 / (hz * frequency_hz * len(phase))
            device.run(h, u, v)
            force = np.array(device.run(h, u, v))
            work = float(np.sum(0.5 * (force + np.roll(force, 1)) * (u - np.roll(u, 1))))
            least = min(least, work / (np.std(force) * np.ptp(u)))
    return least


Worst = dict[tuple[str, str, int], tuple[float, float]]


def round_trip(posterior: bi.Posterior, draws: int, work: Path, worst: Worst) -> set[str]:
    """Follow every motion in every row, keep the largest differences in `worst`; returns what could not be run."""
    problem = posterior.problem
    values = problem.parameter_values(export_run.source_of(posterior, draws, None, None).z)
    missing = set()
    references: dict[tuple[str, int, bool], rt.Reference] = {}
    for name, row in rows(constant(posterior)).items():
        folder = work / row.target
        if not folder.exists():
            posterior.export(row.target, folder, draws=draws)
        try:
            force = row.forces(folder)
        except Unavailable as error:
            missing.add(f"{name}: not run, {error}")
            continue
        for course in rt.courses(*fastest(problem)):
            for steps in row.steps:
                of = course.name, steps, row.straight
                if of not in references:
                    motion, fine = (rt.straight(course, steps), rt.FINE_STRAIGHT) if row.straight else (course, rt.FINE)
                    references[of] = rt.reference(problem, values, motion, steps, fine)
                found, before = rt.compare(force, references[of]), worst.get((name, course.name, steps), (0.0, 0.0))
                worst[name, course.name, steps] = max(found.rms, before[0]), max(found.energy, before[1])
    return missing


def constant(posterior: bi.Posterior) -> bool:
    model = posterior.problem.model
    return isinstance(model, Model) and model.normal_force == "constant" and model.stiffness == "constant"


def fastest(problem: Problem) -> tuple[float, float]:
    """Highest frequency and largest amplitude tested."""
    return float(problem.motion.frequency_hz.max()), float(problem.motion.amplitude_mm.max())


def table(worst: Worst) -> str:
    names = list(dict.fromkeys(name for name, _, _ in worst))
    courses = list(dict.fromkeys(course for _, course, _ in worst))
    lines = ["| target | " + " | ".join(courses) + " |", "|---|" + "---|" * len(courses)]
    for name in names:
        cells = [
            ", ".join("{:.2g}/{:.1g}".format(*(100 * x for x in worst[at])) for at in worst if at[:2] == (name, c))
            for c in courses
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--cycles", type=float, default=1e6)
    parser.add_argument("--out")
    args = parser.parse_args()
    worst: Worst = {}
    missing: set[str] = set()
    said, json_worst, work_least, changed = [], 0.0, np.inf, (0.0, 0.0)
    for name in args.runs:
        posterior = bi.load(name)
        if not (posterior.converged or posterior.quick):
            missing.add(f"{Path(name).name}: left out, {posterior.message}")
            continue
        how = "quick draws" if posterior.quick else f"sampled, {posterior.message}"
        said.append(f"{Path(name).name}: {posterior.problem.model.name}, {how}")
        print(said[-1], flush=True)
        hz, amplitude = fastest(posterior.problem)
        work = Path(tempfile.mkdtemp())
        missing |= round_trip(posterior, args.draws, work, worst)
        json_worst = max(json_worst, json_difference(posterior, work / "json", args.draws))
        if not (work / "c").exists():
            posterior.export("c", work / "c", draws=args.draws)
        work_least = min(work_least, least_work(work / "c", args.draws, hz, amplitude))
        if len(said) == 1:
            changed = many_cycles(work / "c", hz, amplitude, int(args.cycles))
        shutil.rmtree(work)
        text = f"""{len(said)} posteriors, the point and {args.draws} draws each; largest difference, % of the RMS
friction force (RMS) / % of the energy, at 20, 50 and 100 steps a cycle of the highest frequency (for OpenSees on
a smooth motion also at 150 and 250)

{table(worst)}

json read back: forces differ by {json_worst:.1e} of the RMS
{args.cycles:.0e} cycles: the force changed by {changed[0]:.1e} of its largest, {changed[1]:.0f} pieces
least work of a closed cycle: {work_least:.2e} of force times stroke
"""
        text += "\n".join([*sorted(missing), *said]) + "\n"
        if args.out:  # after each posterior, since all take an hour
            Path(args.out).write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
