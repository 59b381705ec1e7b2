"""Forces of an exported device for a given motion, computed in each simulator; for export_round_trip.py and tests.

Each function takes the folder of an export and returns a :data:`export_courses.Force`. Raises
Unavailable, with what to install, where a simulator is missing.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from export_courses import Force


class Unavailable(RuntimeError):
    """A simulator that is not here; the message says what to install."""


def needed(module: str, package: str) -> ModuleType:
    """A simulator's module. Raises Unavailable."""
    try:
        return importlib.import_module(module)
    except (ImportError, RuntimeError, SystemExit) as error:
        raise Unavailable(f"pip install {package} ({' '.join(str(error).split())[:80]})") from None


def exported(folder: Path, name: str) -> ModuleType:
    """A Python file of an export; those that import `isolator` find the one beside them."""
    for stale in ("isolator", name):
        sys.modules.pop(stale, None)
    sys.path.insert(0, str(folder))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(folder))


def fmu_force(fmu: Path, rejects: bool = False) -> Force:
    """By fmpy: inputs are set after each step, then the force is read. rejects : each step is first tried at another
    length with other inputs, taken back, and then made in up to three parts of random lengths."""
    needed("fmpy", "fmpy")
    from fmpy import extract, instantiate_fmu, read_model_description

    described, unzipped = read_model_description(str(fmu)), extract(str(fmu))
    of = {v.name: v.valueReference for v in described.modelVariables}
    inputs = [of[n] for n in ("displacement", "velocity", "acceleration")]

    def force(d, h, u, v, a, amplitude_m):
        slave = instantiate_fmu(unzipped, described, fmi_type="CoSimulation")
        three = described.fmiVersion.startswith("3")
        get, put = (slave.getFloat64, slave.setFloat64) if three else (slave.getReal, slave.setReal)
        (slave.setInt32 if three else slave.setInteger)([of["draw"]], [d])
        put([of["amplitude"]], [amplitude_m])
        if three:
            slave.enterInitializationMode(startTime=0.0)
        else:
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
        slave.exitInitializationMode()
        rng, time, out, before = np.random.default_rng(1), 0.0, np.empty(len(u)), (0.0, v[0] - h * a[0], a[0])
        put(inputs, before)
        for i in range(len(u)):
            now, ends = (u[i], v[i], a[i]), [(i + 1) * h]
            if rejects:
                saved = slave.getFMUState() if three else slave.getFMUstate()
                slave.doStep(time, h * rng.uniform(0.3, 1.7))
                put(inputs, (u[i] + rng.normal() * np.std(u), -v[i], a[i]))
                get([of["force"]])
                (slave.setFMUState if three else slave.setFMUstate)(saved)
                (slave.freeFMUState if three else slave.freeFMUstate)(saved)
                ends = [time + (ends[0] - time) * x for x in sorted(rng.uniform(0.05, 0.95, 2))] + ends
            start = time
            for end in ends:
                slave.doStep(time, end - time)
                time = end
                put(inputs, between(h, (end - start) / h, before, now) if end < ends[-1] else now)
                out[i] = get([of["force"]])[0]
            before = now
        slave.terminate()
        slave.freeInstance()
        return out

    return force


def between(h: float, x: float, start: tuple[float, ...], end: tuple[float, ...]) -> tuple[float, float, float]:
    """Motion at the share x of a step: the polynomial of degree 5 through position, velocity, acceleration there."""
    powers = np.zeros((6, 6))
    powers[[0, 1, 2], [0, 1, 2]] = 1.0, 1.0, 2.0
    powers[3:] = [[1] * 6, [0, 1, 2, 3, 4, 5], [0, 0, 2, 6, 12, 20]]
    c = np.linalg.solve(powers, [start[0], h * start[1], h**2 * start[2], end[0], h * end[1], h**2 * end[2]])
    p = np.polynomial.Polynomial(c)
    return float(p(x)), float(p.deriv()(x) / h), float(p.deriv(2)(x) / h**2)


MJCF = """<mujoco><option timestep="0.001" gravity="0 0 0"/>{extension}
<worldbody><body name="mass">{plugin}<joint name="isolator" type="slide" axis="1 0 0"/><geom size="0.01" mass="1"/>
</body></worldbody></mujoco>"""


def mujoco_force(folder: Path) -> Force:
    """By mj_forward at each sample, the force from Python's callback."""
    mujoco = needed("mujoco", "mujoco")
    wrapped = exported(folder, "isolator_mujoco")

    def force(d, h, u, v, a, amplitude_m):
        model = mujoco.MjModel.from_xml_string(MJCF.format(extension="", plugin=""))
        wrapped.install(wrapped.Device(model, joint="isolator", draw=d, amplitude_m=amplitude_m))
        try:
            return _followed(mujoco, model, h, u, v, a)
        finally:
            wrapped.install()

    return force


def _followed(mujoco, model, h, u, v, a):
    data, out = mujoco.MjData(model), np.empty(len(u))
    for i in range(len(u)):
        data.time, data.qpos[0], data.qvel[0], data.qacc[0] = (i + 1) * h, u[i], v[i], a[i]
        if i == 0:
            data.time, data.qvel[0] = 0.0, v[0] - h * a[0]
            data.qpos[0] = 0.0
            mujoco.mj_forward(model, data)
            data.time, data.qpos[0], data.qvel[0], data.qacc[0] = h, u[0], v[0], a[0]
        mujoco.mj_forward(model, data)
        out[i] = -data.qfrc_passive[0]
    return out


def plugin_force(folder: Path, text: list[str] | None = None) -> Force:
    """The same by the plugin in C, built against the installed headers; loaded once a process. A model that uses it is
    left in text."""
    mujoco = needed("mujoco", "mujoco")
    home = Path(mujoco.__file__).parent
    library = folder / "libisolator_plugin.so"
    if not library.exists():
        command = ["cc", "-std=c99", "-O2", "-shared", "-fPIC", f"-I{home / 'include'}", "-o", str(library)]
        command += [str(folder / "isolator_plugin.c"), *map(str, home.glob("libmujoco.so.*")), "-lm"]
        subprocess.run(command, check=True)
    mujoco.mj_loadPluginLibrary(str(library))
    name = re.search(r'plugin.name = "(.+)"', (folder / "isolator_plugin.c").read_text(encoding="utf-8")).group(1)

    def model_text(keys):
        config = "".join(f'<config key="{k}" value="{x}"/>' for k, x in keys.items())
        instance = f'<instance name="device">{config}</instance>'
        extension = f'<extension><plugin plugin="{name}">{instance}</plugin></extension>'
        return MJCF.format(extension=extension, plugin='<plugin instance="device"/>')

    def force(d, h, u, v, a, amplitude_m):
        keys = {"joint": "isolator", "draw": d, "amplitude": amplitude_m}
        return _followed(mujoco, mujoco.MjModel.from_xml_string(model_text(keys)), h, u, v, a)

    if text is not None:
        text.append(model_text({"joint": "isolator"}))
    return force


def drake_force(folder: Path) -> Force:
    """By Drake's simulator, the motion from a source that reads it at the samples."""
    needed("pydrake.all", "drake")
    from pydrake.all import DiagramBuilder, LeafSystem, LogVectorOutput, Simulator

    wrapped = exported(folder, "isolator_drake")

    class Source(LeafSystem):
        def __init__(self, h, columns):
            LeafSystem.__init__(self)
            self.h, self.columns = h, columns
            self.DeclareVectorOutputPort("motion", 3, self.read)

        def read(self, context, output):
            output.SetFromVector(self.columns[min(round(context.get_time() / self.h), len(self.columns) - 1)])

    def force(d, h, u, v, a, amplitude_m):
        start = [[0.0, v[0] - h * a[0], a[0]]]
        builder = DiagramBuilder()
        source = builder.AddSystem(Source(h, np.concatenate([start, np.stack([u, v, a], axis=1)])))
        device = builder.AddSystem(wrapped.IsolatorSystem(h, d, amplitude_m))
        builder.Connect(source.get_output_port(), device.get_input_port())
        log = LogVectorOutput(device.get_output_port(), builder, publish_period=h)
        diagram = builder.Build()
        simulator = Simulator(diagram)
        simulator.AdvanceTo(h * len(u) + 1e-9 * h)
        return log.FindLog(simulator.get_context()).data()[0][1 : len(u) + 1]

    return force


def opensees_force(folder: Path, turns: bool = False) -> Force:
    """By OpenSees' own materials, strained step by step; turns : also at the turning points within steps."""
    ops = needed("openseespy.opensees", "openseespy, and on Debian libblas3 liblapack3")
    wrapped = exported(folder, "isolator_opensees")

    def force(d, h, u, v, a, amplitude_m):
        ops.wipe()
        wrapped.add(ops, 1, d)
        ops.testUniaxialMaterial(1)
        out = np.empty(len(u))
        before = 0.0, v[0] - h * a[0]
        for i, now in enumerate(zip(u.tolist(), v.tolist())):
            for at in wrapped.path(*zip(before, now), h)[1:] if turns else now[:1]:
                ops.setStrain(at)
            out[i] = ops.getStress()
            before = now
        return out

    return force
