"""A mass on the exported isolator under base excitation, in MuJoCo, Drake and an FMU, against design_isolator.py.

    python analyses/export_mass.py [RUN] [--mass 1.0] [--base-mm 0.2] [--points 16] [--out export_mujoco.png]

RUN is a folder of `bayes-iwan identify` (default: data/rope_spring, identified quickly). A sine of the base is stepped
from low to high; u is the isolator's stretch, and A of Eq. (11) the largest |u| of the last cycle, as there. It follows
64 stop elements, the export all.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import bayes_iwan as bi
import export_courses as rt
from bayes_iwan.report.style import BLUE, ORANGE, save, styled, subplots
from design_isolator import STEP_S, element_values, sweep
from export_targets import MJCF, Unavailable, exported, needed

CYCLES, SETTLED = 40, 5
#: position and velocity after a step that begins with the base's acceleration (m/s²), and the force (N) at its start:
#: step(h, base_m_s2, amplitude_m)
Step = Callable[[float, float, float], tuple[float, float, float]]


def transmissibility(step: Step, hz: np.ndarray, base_m: float, mass_kg: float) -> np.ndarray:
    """RMS acceleration of the mass over the base's at each frequency, as design_isolator.sweep takes it."""
    out, amplitude = np.empty(len(hz)), base_m
    for i, f in enumerate(hz):
        w, steps = 2.0 * np.pi * f, max(int(np.ceil(1.0 / (f * STEP_S))), 100)
        h, squares = 1.0 / (f * steps), 0.0
        for cycle in range(CYCLES):
            high = 0.0
            for s in range(steps):
                u, _, force = step(h, -w * w * base_m * np.sin(w * h * s), amplitude)
                high = max(high, abs(u))
                squares += (force / mass_kg) ** 2 if cycle >= CYCLES - SETTLED else 0.0
            amplitude = max(high, 0.01 * base_m)
        out[i] = np.sqrt(2.0 * squares / (SETTLED * steps)) / (w * w * base_m)
    return out


def c_step(folder: Path, mass_kg: float, draw: int = 0) -> Step:
    """The C step and semi-implicit Euler in Python."""
    device, x = rt.module(folder).Isolator(draw), [0.0, 0.0, 0.0]

    def step(h, base, amplitude):
        device.amplitude_m = amplitude
        force = device.step(x[2], x[0], x[1])
        x[1] += h * (-force / mass_kg - base)
        x[0] += h * x[1]
        x[2] = h
        return x[0], x[1], force

    return step


def mujoco_step(folder: Path, mass_kg: float) -> Step:
    """MuJoCo's own integrator, the device by Python's callback."""
    mujoco = needed("mujoco", "mujoco")
    wrapped = exported(folder, "isolator_mujoco")
    text = MJCF.format(extension="", plugin="").replace('mass="1"', f'mass="{mass_kg}"')
    model = mujoco.MjModel.from_xml_string(text)
    data, device = mujoco.MjData(model), wrapped.Device(model, joint="isolator")
    wrapped.install(device)

    def step(h, base, amplitude):
        model.opt.timestep, device.isolator.amplitude_m = h, amplitude
        data.qfrc_applied[0] = -mass_kg * base
        mujoco.mj_step(model, data)
        return data.qpos[0], data.qvel[0], device.force_N

    return step


def drake_ratio(folder: Path, hz: float, base_m: float, mass_kg: float, amplitude_m: float) -> float:
    """Transmissibility at one frequency in Drake, from rest, A at its steady value."""
    needed("pydrake.all", "drake")
    from pydrake.all import DiagramBuilder, LeafSystem, LogVectorOutput, Simulator

    wrapped = exported(folder, "isolator_drake")
    w, steps = 2.0 * np.pi * hz, max(int(np.ceil(1.0 / (hz * STEP_S))), 100)
    h = 1.0 / (hz * steps)

    class Mass(LeafSystem):
        """m·ü = −F − m·a_base in discrete time: semi-implicit Euler."""

        def __init__(self):
            LeafSystem.__init__(self)
            self.DeclareVectorInputPort("force", 1)
            self.DeclareDiscreteState(2)
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=h, offset_sec=0.0, update=self.update)
            self.DeclareVectorOutputPort("motion", 3, self.motion, {self.all_state_ticket()})

        def update(self, context, discrete_state):
            u, v = context.get_discrete_state_vector().value()
            base = -w * w * base_m * np.sin(w * context.get_time())
            v += h * (-self.get_input_port().Eval(context)[0] / mass_kg - base)
            discrete_state.set_value([u + h * v, v])

        def motion(self, context, output):
            output.SetFromVector([*context.get_discrete_state_vector().value(), 0.0])

    builder = DiagramBuilder()
    mass, device = builder.AddSystem(Mass()), builder.AddSystem(wrapped.IsolatorSystem(h, 0, amplitude_m))
    builder.Connect(mass.get_output_port(), device.get_input_port())
    builder.Connect(device.get_output_port(), mass.get_input_port())
    log = LogVectorOutput(device.get_output_port(), builder, publish_period=h)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(CYCLES / hz)
    force = log.FindLog(simulator.get_context()).data()[0][-SETTLED * steps :]
    return float(np.sqrt(2.0 * np.mean((force / mass_kg) ** 2)) / (w * w * base_m))


@styled
def figure(hz: np.ndarray, curves: dict[str, np.ndarray]):
    """Transmissibility of all, design_isolator.py as a line."""
    made, axes = subplots(1, 1, 5.6, 3.6)
    ax = axes if not hasattr(axes, "ravel") else axes.ravel()[0]
    marks = iter((("o", ORANGE, 9), ("x", "#333333", 5), ("s", "#2a9d5c", 5)))
    for name, ratio in curves.items():
        if name.startswith("design"):
            ax.plot(hz, ratio, color=BLUE, label=name)
        else:
            mark, colour, size = next(marks)
            ax.plot(hz, ratio, mark, color=colour, label=name, fillstyle="none", markersize=size)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ticks = [f for f in (5, 10, 20, 40) if hz[0] <= f * 1.01 and f <= hz[-1] * 1.01]
    ax.set_xticks(ticks, [str(f) for f in ticks])
    low, high = min(x.min() for x in curves.values()), max(x.max() for x in curves.values())
    levels = [x for x in (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20) if 0.9 * low <= x <= 1.1 * high]
    ax.set_yticks(levels, [f"{x:g}" for x in levels])
    ax.minorticks_off()
    ax.axhline(1.0, color="#777777", linewidth=0.7)
    ax.set_xlabel("frequency (Hz)")
    ax.set_ylabel("RMS acceleration, mass over base (-)")
    ax.legend(fontsize=8)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="?")
    parser.add_argument("--mass", type=float, default=1.0, help="kg")
    parser.add_argument("--base-mm", type=float, default=0.2)
    parser.add_argument("--points", type=int, default=16)
    parser.add_argument("--out", default="export_mujoco.png")
    args = parser.parse_args()
    spring = Path(__file__).parents[1] / "data" / "rope_spring"
    posterior = bi.load(args.run) if args.run else bi.identify(spring, quick=True, seed=1, progress=False)
    work = Path(tempfile.mkdtemp())
    for target in ("mujoco", "drake"):
        posterior.export(target, work / target, draws=0)
    hz, base = np.geomspace(5.0, 40.0, args.points), 1e-3 * args.base_mm
    phi, p = element_values(_point(posterior), 1)
    ratio, peak = sweep(hz, CYCLES, args.base_mm, args.mass, phi, p)
    curves = {"design_isolator.py (64 elements)": ratio[0]}
    curves["C step"] = transmissibility(c_step(work / "mujoco", args.mass), hz, base, args.mass)
    try:
        curves["MuJoCo"] = transmissibility(mujoco_step(work / "mujoco", args.mass), hz, base, args.mass)
    except Unavailable as error:
        print(f"MuJoCo: {error}")
    try:
        curves["Drake, each from rest"] = np.array(
            [drake_ratio(work / "drake", f, base, args.mass, 1e-3 * a) for f, a in zip(hz, peak[0])]
        )
    except Unavailable as error:
        print(f"Drake: {error}")
    for name, found in curves.items():
        print(f"{name:34s} resonance {hz[np.argmax(found)]:.3g} Hz, {found.max():.4g}; largest difference "
              f"from the first {100 * np.max(np.abs(found / ratio[0] - 1.0)):.2g} %")  # fmt: skip
    save(figure(hz, curves), args.out)
    print(args.out)


def _point(posterior):
    """The posterior with its point estimate as the only draw."""
    from dataclasses import replace

    return replace(posterior, z=posterior.point.z[None, None])


if __name__ == "__main__":
    main()
