"""Does an exported device give the force that the package's own forward model gives? In every target that runs here.

    python analyses/export_round_trip.py [RUN ...] [--draws 20] [--cycles 1e6] [--out table.md]

RUN is a folder of `bayes-iwan identify`; without one, data/rope_spring is identified quickly (Laplace's draws), once
with the default model and once with a constant normal force (for OpenSees). Four motions (steady cycles, a random
record, a staircase, a shock), 20, 50 and 100 steps a cycle of their highest frequency; each figure is the largest over
the draws.
Then: variable and rejected steps in the FMU, a million cycles, and the work of closed cycles.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import bayes_iwan as bi
import export_courses as rt
from bayes_iwan.export import run as export_run
from bayes_iwan.export.tested import steady_loops
from bayes_iwan.models import Model
from export_targets import Unavailable, drake_force, fmu_force, mujoco_force, opensees_force, plugin_force

STEPS = (20, 50, 100)
CLASSICAL = {"model": {"normal_force": "constant", "stiffness": "constant", "embedded": False}}
#: OpenSees' springs are as many as this error of the backbone asks
SPRINGS_ERROR = 2e-4


def runs_of(names: list[str]) -> list[bi.Posterior]:
    """Posteriors of run folders, or two quick ones of the rope spring."""
    if names:
        return [bi.load(name) for name in names]
    folder = Path(__file__).parents[1] / "data" / "rope_spring"
    return [bi.identify(folder, quick=True, seed=1, progress=False, config=c) for c in (None, CLASSICAL)]


def targets(constant: bool) -> dict[str, tuple[str, Callable[[Path], rt.Force]]]:
    """Target of the export and what computes forces with its files, by the name in the table."""
    every: dict[str, tuple[str, Callable[[Path], rt.Force]]] = {
        "c": ("c", lambda folder: rt.in_c(rt.module(folder))),
        "fmu, FMI 2.0": ("fmu", lambda folder: fmu_force(folder / "isolator_fmi2.fmu")),
        "fmu, FMI 3.0": ("fmu", lambda folder: fmu_force(folder / "isolator_fmi3.fmu")),
        "fmu, steps varied and rejected": ("fmu", lambda folder: fmu_force(folder / "isolator_fmi2.fmu", rejects=True)),
        "mujoco, Python": ("mujoco", mujoco_force),
        "mujoco, plugin": ("mujoco", plugin_force),
        "drake": ("drake", drake_force),
    }
    return every | ({"opensees": ("opensees", opensees_force)} if constant else {})


def json_difference(posterior: bi.Posterior, folder: Path, draws: int) -> float:
    """Largest difference of forces from the file that is read back, over the RMS force."""
    model = bi.load(posterior.export("json", folder, draws=draws))
    motion = posterior.problem.motion
    source = export_run.source_of(posterior, draws)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--cycles", type=float, default=1e6)
    parser.add_argument("--out")
    args = parser.parse_args()
    lines = []

    def tell(text: str) -> None:
        print(text, flush=True)
        lines.append(text)

    for posterior in runs_of(args.runs):
        problem, model = posterior.problem, posterior.problem.model
        values = problem.parameter_values(export_run.source_of(posterior, args.draws).z)
        hz, amplitude = float(problem.motion.frequency_hz.max()), float(problem.motion.amplitude_mm.max())
        constant = isinstance(model, Model) and model.normal_force == "constant"
        tell(f"\n{posterior.name}, {model.name}, {args.draws} draws and the point; largest difference, % of the RMS")
        tell("friction force (RMS) / % of the energy, at 20, 50 and 100 steps a cycle of the highest frequency\n")
        courses = rt.courses(hz, amplitude)
        tell("| target | " + " | ".join(c.name for c in courses) + " |\n|---|" + "---|" * len(courses))
        work = Path(tempfile.mkdtemp())
        for name, (target, forces) in targets(constant).items():
            folder = work / target
            if not folder.exists():
                posterior.export(target, folder, draws=args.draws, error=SPRINGS_ERROR)
            try:
                force = forces(folder)
            except Unavailable as error:
                tell(f"| {name} | not run: {error} |" + " |" * (len(courses) - 1))
                continue
            cells = []
            for course in courses:
                found = [rt.compare(force, problem, values, course, n) for n in STEPS]
                cells.append(", ".join(f"{100 * x.rms:.2g}/{100 * x.energy:.1g}" for x in found))
            tell(f"| {name} | " + " | ".join(cells) + " |")
        tell(
            f"\njson read back: forces differ by {json_difference(posterior, work / 'json', args.draws):.1e} of the RMS"
        )
        changed, pieces = many_cycles(work / "c", hz, amplitude, int(args.cycles))
        tell(f"{args.cycles:.0e} cycles: the force changed by {changed:.1e} of its largest, {pieces:.0f} pieces")
        tell(f"least work of a closed cycle: {least_work(work / 'c', args.draws, hz, amplitude):.2e} of force·stroke")
        shutil.rmtree(work)
    if args.out:
        Path(args.out).write_text("\n".join(lines).strip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
