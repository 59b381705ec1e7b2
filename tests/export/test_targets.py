"""Each simulator that is installed gives the force of the package's own forward model, its files made without it."""

import re
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import bayes_iwan as bi
import export_courses as rt
import export_targets as simulators
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.export.device import ExportError, device_of, elements, steady_loops
from bayes_iwan.export.json_file import ExportedModel
from bayes_iwan.inference.setup.problem import make_problem

CLASSICAL = {"slip": "gamma3", "normal_force": "constant", "stiffness": "constant"}


def right(force, problem, z, straight=False, steps=20):
    values = problem.parameter_values(z)
    for course in rt.courses(20.0, 1.0)[:2]:
        motion, fine = (rt.straight(course, steps), rt.FINE_STRAIGHT) if straight else (course, rt.FINE)
        found = rt.compare(force, rt.reference(problem, values, motion, steps, fine))
        assert found.rms < 1e-3 and found.energy < 1e-3, found


def available(make, folder):
    try:
        return make(folder)
    except simulators.Unavailable as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("rejects", [False, True], ids=["", "varied and rejected steps"])
def test_an_fmu(version, rejects, problem_of, exported, draws):
    pytest.importorskip("fmpy", reason="pip install fmpy")
    from fmpy.validation import validate_fmu

    problem = problem_of()
    z = draws(problem, 2)
    fmu = exported(problem, z, "fmu") / f"isolator_fmi{version}.fmu"
    assert validate_fmu(str(fmu)) == []
    right(simulators.fmu_force(fmu, rejects), problem, z)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("units", "length", "force"), [(Units("mrad", "N·m"), "rad", "N·m"), (Units(force="kPa"), "m", "kPa")]
)
def test_files_say_the_device_s_own_units(units, length, force, problem_of, exported, draws):
    """A torque over an angle, a pressure over a stroke: not m and N."""
    plain = problem_of()
    loops = tuple(replace(x, record=replace(x.record, units=units)) for x in plain.loops)
    problem = make_problem(loops, {"model": {"slip": "gamma1"}})
    folder = exported(problem, draws(problem, 1), "fmu")
    head = " ".join((folder / "isolator.c").read_text(encoding="utf-8").replace(" * ", " ").split())
    assert f"stretch in {length} (velocity {length}/s)" in head and "(N)" not in head
    for name in ("isolator_fmi2.fmu", "isolator_fmi3.fmu"):
        text = zipfile.ZipFile(folder / name).read("modelDescription.xml").decode()
        said = re.findall(r'description="[^"]*, ([^,"]*)"', text)
        assert said[:5] == [length, f"{length}/s", f"{length}/s2", force, length]


@pytest.mark.usefixtures("compiler")
def test_an_fmu_is_simulated_by_fmpy_itself(problem_of, exported, draws):
    fmpy = pytest.importorskip("fmpy", reason="pip install fmpy")
    problem = problem_of()
    folder = exported(problem, draws(problem, 1), "fmu")
    t = np.linspace(0.0, 0.2, 801)
    w = 2 * np.pi * 10.0
    columns = np.rec.fromarrays(
        [t, 5e-4 * np.sin(w * t), 5e-4 * w * np.cos(w * t), -5e-4 * w**2 * np.sin(w * t)],
        names=["time", "displacement", "velocity", "acceleration"],
    )
    forces = [
        fmpy.simulate_fmu(
            str(folder / name),
            stop_time=0.2,
            output_interval=2.5e-4,
            input=columns,
            output=["force"],
            start_values=given,
        )["force"]
        for name in ("isolator_fmi2.fmu", "isolator_fmi3.fmu")
        for given in ({}, {"amplitude": 5e-4})
    ]
    assert np.array_equal(forces[0], forces[2]) and np.array_equal(forces[1], forces[3])
    assert not np.array_equal(forces[0], forces[1]), "A is a parameter"
    motion = bi.sine_motion(frequency_hz=10.0, amplitude_mm=0.5, samples=400)
    ours = steady_loops(problem, problem.parameter_values(draws(problem, 1)), motion)[0, 0]
    # fmpy sets inputs before a step and reads outputs after it: the force is what these inputs lead to
    assert np.std(forces[1][401:801] - np.roll(ours, -1)) < 2e-3 * np.std(ours)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("name", ["mujoco_force", "plugin_force", "drake_force"])
def test_a_simulator_that_wraps_the_step(name, problem_of, exported, draws):
    problem = problem_of()
    z = draws(problem, 2)
    folder = exported(problem, z, name.split("_")[0].replace("plugin", "mujoco"))
    right(available(getattr(simulators, name), folder), problem, z)


@pytest.mark.usefixtures("compiler")
def test_a_device_on_a_tendon(problem_of, exported, draws, monkeypatch):
    """A tendon of twice the joint's position: twice the stretch, twice the force."""
    mujoco = pytest.importorskip("mujoco", "4", reason="pip install mujoco")
    problem = problem_of()
    where = simulators.exported(exported(problem, draws(problem, 1), "mujoco"), "isolator_mujoco")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.001" gravity="0 0 0"/>
        <worldbody><body><joint name="j" type="slide"/><geom size="0.02" mass="1"/></body></worldbody>
        <tendon><fixed name="t"><joint joint="j" coef="2"/></fixed></tendon></mujoco>"""
    )
    device, data = where.Device(model, tendon="t"), mujoco.MjData(model)
    alone, u, v = where.Isolator(), 0.0, 0.1
    data.qvel[0] = v
    where.install(device)
    for i in range(100):
        mujoco.mj_step(model, data)
        v -= 1e-3 * 2.0 * alone.step(1e-3 if i else 0.0, 2.0 * u, 2.0 * v) / model.body_mass[1]
        u += 1e-3 * v
        assert data.qpos[0] == pytest.approx(u, abs=1e-12)
    where.install()
    with pytest.raises(ValueError, match=r"tendon needs mujoco 4 or later, not "):
        monkeypatch.setattr(where.mujoco, "mj_name2id", lambda *_: 0)
        where.Device(object(), tendon="t")


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_reset_of_mujoco_leaves_nothing_of_the_simulation_before(steps, problem_of, exported, draws):
    mujoco = pytest.importorskip("mujoco", reason="pip install mujoco")
    problem = problem_of()
    where = simulators.exported(exported(problem, draws(problem, 1), "mujoco"), "isolator_mujoco")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="j" type="slide"/><geom size="0.02" mass="1"/></body></worldbody>
        </mujoco>"""
    )
    device, data, forces = where.Device(model, joint="j"), mujoco.MjData(model), []
    where.install(device)
    for start in (0.0, 1e-3, 0.0):
        mujoco.mj_resetData(model, data)
        data.qpos[0] = start
        for _ in range(steps):
            mujoco.mj_step(model, data)
            forces.append(device.force_N)
    where.install()
    assert forces[:steps] == forces[-steps:] != forces[steps:-steps]


def test_opensees_springs_are_the_model_where_the_normal_force_is_constant(problem_of, exported, draws):
    problem = problem_of(**CLASSICAL)
    z = draws(problem, 2)
    force = available(simulators.opensees_force, exported(problem, z, "opensees", error=1e-4))
    right(force, problem, z, straight=True)  # it sees no velocity, so it cannot know where within a step a motion turns


def test_opensees_follows_a_smooth_motion_through_its_turning_points(problem_of, exported, draws):
    problem = problem_of(**CLASSICAL)
    z = draws(problem, 2)
    folder = exported(problem, z, "opensees", error=1e-4)
    right(available(lambda where: simulators.opensees_force(where, turns=True), folder), problem, z)
    with pytest.raises(AssertionError):
        right(simulators.opensees_force(folder), problem, z)


@pytest.mark.parametrize("error", [1e-2, 1e-3, 1e-4])
def test_as_many_springs_as_the_stated_error_asks(error, problem_of, draws):
    problem = problem_of(**CLASSICAL)
    device = device_of(problem, draws(problem, 2), (8.0, 20.0))
    for i in range(device.sets):
        phi, share = elements(device, i, error)
        assert 1.0 - 10.0 * np.sqrt(error) < share.sum() < 1.0 + 1e-9 and np.all(share > -1e-12)
        at = np.linspace(0.0, 1.0, 20001) * device.top_N[i]
        backbone = np.minimum(phi, at[:, None]) @ share
        exact = problem.model.slip_family.survival(at, problem.parameter_values(draws(problem, 2)))[i]
        exact = np.concatenate([[0.0], np.cumsum(0.5 * (exact[1:] + exact[:-1]) * np.diff(at))])
        assert np.abs(backbone - exact).max() < (1.1 * error + 2e-5) * device.tables[i][-1].sum()
        assert len(phi) < 3.0 / np.sqrt(error)


def test_opensees_refuses_what_springs_cannot_do_and_says_what_it_would_cost(problem_of, exported, draws):
    problem = problem_of()
    with pytest.raises(ExportError, match=r"would be dropped: the normal force's law.* differ by [\d.]+ % of friction"):
        exported(problem, draws(problem, 1), "opensees")
    text = (exported(problem, draws(problem, 1), "opensees", approximate=True) / "isolator_opensees.py").read_text()
    assert "dropped as asked" in text


def test_json_is_read_back_as_it_was(problem_of, exported, draws):
    problem = problem_of(embedded=True)
    z = draws(problem, 5)
    path = exported(problem, z, "json") / "isolator.json"
    for given in (path, path.parent):
        model = bi.load(given)
        assert isinstance(model, ExportedModel)
        ours = steady_loops(problem, problem.parameter_values(z), problem.motion)
        assert np.array_equal(model.force(problem.motion), ours)
    assert model.covariance.shape == (len(model.names), len(model.names))
    assert model.covariance[0, 0] == pytest.approx(np.var(model.values[model.names[0]][1:], ddof=1))


@pytest.mark.parametrize("content", ["", "{}", '{"schema": "bayes_iwan.export 1"}', "[1]", '{"schema": "other 9"}'])
def test_a_damaged_json_is_refused_in_one_line(content, tmp_path):
    (tmp_path / "isolator.json").write_text(content)
    with pytest.raises(ExportError, match=r"isolator\.json: .*export") as caught:
        bi.load(tmp_path / "isolator.json")
    assert "\n" not in str(caught.value)


def test_files_are_made_without_their_simulator(problem_of, exported, monkeypatch, draws):
    for name in ("mujoco", "pydrake", "fmpy", "openseespy"):
        monkeypatch.setitem(sys.modules, name, None)
    problem = problem_of(**CLASSICAL)
    for target in ("mujoco", "drake", "opensees", "json"):
        assert list(exported(problem, draws(problem, 2), target).iterdir())
