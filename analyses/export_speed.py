"""What a simulated second at 1 kHz costs: the exported step in each simulator, beside what these bring themselves.

    python analyses/export_speed.py [RUN]

RUN is a folder of `bayes-iwan identify` (default: data/rope_spring, identified quickly). Beside it a constant normal
force with stop elements for errors of 1e-2 to 1e-5, which the step's cost must not follow.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import bayes_iwan as bi
import export_courses as rt
from export_round_trip import CLASSICAL
from export_targets import MJCF, Unavailable, exported, fmu_force, needed, opensees_force, plugin_force

N, H = 1000, 1e-3


def best_of(run: Callable[[], object], seconds: float = 1.0) -> float:
    """The shortest of some runs, ms."""
    run()
    took, until = [], time.perf_counter() + seconds
    while len(took) < 3 or time.perf_counter() < until:
        start = time.perf_counter()
        run()
        took.append(1e3 * (time.perf_counter() - start))
    return min(took)


def tell(what: str, ms: float) -> None:
    print(f"| {what} | {ms:.3g} |", flush=True)


def mujoco_steps(model_text: str, install: Callable | None = None) -> Callable[[], object]:
    """A simulated second of a mass that is driven at 10 Hz."""
    mujoco = needed("mujoco", "mujoco")
    model = mujoco.MjModel.from_xml_string(model_text)
    data = mujoco.MjData(model)
    drive = 5.0 * np.sin(20.0 * np.pi * H * np.arange(N))

    def run():
        mujoco.mj_resetData(model, data)
        if install is not None:
            install(model)
        for force in drive:
            data.qfrc_applied[0] = force
            mujoco.mj_step(model, data)

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="?")
    args = parser.parse_args()
    spring = Path(__file__).parents[1] / "data" / "rope_spring"
    posterior = bi.load(args.run) if args.run else bi.identify(spring, quick=True, seed=1, progress=False)
    classical = bi.identify(spring, quick=True, seed=1, progress=False, config=CLASSICAL)
    work = Path(tempfile.mkdtemp())
    for target in ("c", "fmu", "mujoco", "drake"):
        posterior.export(target, work / target, draws=1)
    t = H * np.arange(1, N + 1)
    w, amplitude = 20.0 * np.pi, float(posterior.problem.motion.amplitude_mm.max())
    u, v, a = (1e-3 * amplitude * x for x in (np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)))
    print(
        f"{posterior.problem.model.name}; a simulated second at 1 kHz (10 Hz, {amplitude:g} mm), ms\n\n"
        "| what | ms |\n|---|---|"
    )
    course = rt.Course(
        name="",
        seconds=1.0,
        highest_hz=10.0,
        amplitude_mm=amplitude,
        displacement_mm=lambda t: amplitude * np.sin(w * t),
    )
    values = {n: x[:1] for n, x in posterior.parameter_values().items()}
    tell(
        "our record kernel (numba), all samples at once",
        best_of(lambda: rt.forward(posterior.problem, values, course, 100)),
    )
    step = rt.in_c(rt.module(work / "c"))
    tell("C step, from C", best_of(lambda: step(0, H, u, v, a, 1e-3 * amplitude)))
    device = rt.module(work / "c").Isolator()

    def one_by_one():
        device.start()
        for i in range(N):
            device.step(H, u[i], v[i], a[i])

    tell("C step, one call from Python each", best_of(one_by_one))
    for what, run in (
        ("FMU, FMI 2.0, by fmpy", lambda: fmu_force(work / "fmu" / "isolator_fmi2.fmu")),
        ("FMU, FMI 3.0, by fmpy", lambda: fmu_force(work / "fmu" / "isolator_fmi3.fmu")),
    ):
        try:
            force = run()
            tell(what, best_of(lambda force=force: force(0, H, u, v, a, 1e-3 * amplitude)))
        except Unavailable as error:
            print(f"| {what} | {error} |")
    try:
        in_mujoco(work)
    except Unavailable as error:
        print(f"| MuJoCo | {error} |")
    try:
        in_opensees(classical, work, u, v, a)
    except Unavailable as error:
        print(f"| OpenSees | {error} |")


def in_mujoco(work: Path) -> None:
    """A mass in MuJoCo alone, with its own friction, with the callback and with the plugin."""
    plain = MJCF.format(extension="", plugin="")
    tell("MuJoCo: a mass on nothing", best_of(mujoco_steps(plain)))
    tell(
        "MuJoCo: with its own frictionloss and stiffness",
        best_of(mujoco_steps(plain.replace('axis="1 0 0"', 'axis="1 0 0" frictionloss="1.2" stiffness="5490"'))),
    )
    wrapped = exported(work / "mujoco", "isolator_mujoco")
    tell(
        "MuJoCo: with the device, Python's callback",
        best_of(mujoco_steps(plain, lambda model: wrapped.install(wrapped.Device(model, joint="isolator")))),
    )
    wrapped.install()
    text: list[str] = []
    plugin_force(work / "mujoco", text)
    tell("MuJoCo: with the device, plugin", best_of(mujoco_steps(text[0])))


def in_opensees(classical: bi.Posterior, work: Path, u: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
    """OpenSees' own materials, the springs that a stated error asks for, and the C step of the same model."""
    ops = needed("openseespy.opensees", "openseespy, and on Debian libblas3 liblapack3")

    def strained(define: Callable[[], object]) -> Callable[[], object]:
        def run():
            ops.wipe()
            define()
            ops.testUniaxialMaterial(1)
            for at in u:
                ops.setStrain(float(at))
                ops.getStress()

        return run

    tell("OpenSees: its ElasticPP", best_of(strained(lambda: ops.uniaxialMaterial("ElasticPP", 1, 2e4, 1e-4))))
    own = ("Steel02", 1, 1.2, 2e4, 0.3, 18.0, 0.925, 0.15)
    tell("OpenSees: its Steel02", best_of(strained(lambda: ops.uniaxialMaterial(*own))))
    for error in (1e-2, 1e-3, 1e-4, 1e-5):
        folder = work / f"opensees{error:g}"
        classical.export("opensees", folder, draws=0, error=error)
        springs = len(exported(folder, "isolator_opensees").SETS[0][1])
        force = opensees_force(folder)
        tell(f"OpenSees: {springs} springs, error {error:g}", best_of(lambda force=force: force(0, H, u, v, a, 1.0)))
    classical.export("c", work / "classical", draws=0)
    step = rt.in_c(rt.module(work / "classical"))
    tell("C step of that model, error 0", best_of(lambda: step(0, H, u, v, a, 1e-3)))


if __name__ == "__main__":
    main()
