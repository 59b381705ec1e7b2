"""Each effect's law in time against its law over closed loops, once the motion is steady; and effects without one."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

import export_courses as rt
from bayes_iwan.effects import catalogue, conditions, friction, lag, mounting, paper_stages, specimen_forces
from bayes_iwan.effects.base import Effect
from bayes_iwan.export.device import ExportError, device_of, steady_loops
from bayes_iwan.export.laws import LAWS, OF_THE_RIG
from bayes_iwan.models import sine_motion

HZ, AMPLITUDE, FINE = 12.0, 0.9, 1000
STRICT = "cc -std=c99 -Wall -Wextra -Werror -pedantic -fsyntax-only".split()
#: laws with slow parts need many cycles until they are steady
SLOW = {specimen_forces.MaxwellBranch: 300, lag.NormalForceLagFromStart: 300}


def made(kind, problem):
    """The effect on a problem's scales."""
    more = {"condition": "pressure_bar", "values": (1.0, 2.0)} if issubclass(kind, conditions.FollowsCondition) else {}
    return kind(problem.scales, tuple(x.file for x in problem.loops), None, **more)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("kind", LAWS, ids=lambda kind: kind.__name__)
def test_a_law_in_time_is_the_effects_own_once_steady(kind, problem_of, exported, draws):
    classical = (
        {"normal_force": "constant", "stiffness": "constant"} if kind in paper_stages.EFFECTS else {"embedded": True}
    )
    problem = problem_of(**classical)
    problem = problem.with_effects([made(kind, problem)])
    z, cycles, w = draws(problem, 3, seed=2), SLOW.get(kind, 20), 2 * np.pi * HZ
    folder = exported(problem, z)
    subprocess.run([*STRICT, "isolator.c"], cwd=folder, check=True)
    isolator = rt.module(folder)
    motion = sine_motion(frequency_hz=HZ, amplitude_mm=AMPLITUDE, samples=FINE)
    motion = replace(motion, cycle=np.array([cycles - 0.5]))
    values = problem.parameter_values(z)
    ours, friction = steady_loops(problem, values, motion)[:, 0], problem.friction_force(values, motion)[:, 0]
    for steps in (20, 100):
        t, h = np.arange(1, cycles * steps + 1) / steps / HZ, 1 / HZ / steps
        u, v = 1e-3 * AMPLITUDE * np.sin(w * t), 1e-3 * AMPLITUDE * w * np.cos(w * t)
        for d in range(len(z)):
            force = rt.in_c(isolator)(d, h, u, v, -(w**2) * u, 1e-3 * AMPLITUDE)[-steps:]
            difference = force - np.roll(ours[d, :: FINE // steps], -1)
            assert np.sqrt(np.mean(difference**2) / np.mean(friction[d] ** 2)) < 3e-3


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("kind", [friction.FrictionFade, friction.SpringSoftening], ids=lambda kind: kind.__name__)
def test_cycles_are_counted_from_where_the_motion_begins(kind, problem_of, exported, draws):
    """At whatever time, after whatever rest, and wherever in the cycle (an infinite frequency took all friction)."""
    problem = problem_of()
    problem = problem.with_effects([made(kind, problem)])
    isolator = rt.module(exported(problem, draws(problem, 5, seed=3, size=0.5)))
    steps, w = 200, 2 * np.pi * HZ
    for d in range(5):
        widths = []
        for start_s, rest_s, phase in ((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, np.pi / 2)):
            device = isolator.Isolator(d, 1e-3 * AMPLITUDE, start_s)
            device.step(rest_s, 0.0, 0.0)
            at = w * np.arange(3 * steps + 1) / HZ / steps + phase
            u, v = 1e-3 * AMPLITUDE * np.sin(at), 1e-3 * AMPLITUDE * w * np.cos(at)
            device.step(0.0, u[0], v[0])
            widths.append(np.ptp(device.run(1 / HZ / steps, u[1:], v[1:])[-2 * steps :]))
        assert np.ptp(widths) < 5e-3 * widths[0], widths


def test_every_effect_of_the_catalogue_is_exported_or_omitted_for_a_reason():
    known = {*LAWS, *OF_THE_RIG}
    every = {*catalogue.BUILT_IN, *catalogue.FORM, *paper_stages.EFFECTS, *conditions.EFFECTS}
    assert every == known


def test_the_rigs_effects_are_omitted_and_named(problem_of, draws):
    problem = problem_of()
    with_rig = problem.with_effects(
        [made(k, problem) for k in (specimen_forces.ViscousDamping, mounting.RigCompliance)]
    )
    device = device_of(with_rig, draws(with_rig, 2), (8.0, 20.0))
    assert set(device.named) == {"viscous_damping"} and set(device.omitted) == {"rig_compliance"}


def test_an_effect_without_a_law_in_time_is_refused_in_one_line(problem_of, draws):
    class Odd(Effect):
        name, strength, physics, reference, signature = "odd", ("x", "x", "N", "odd"), "", "", ""

        def first_guess(self):
            return 1.0

        def force(self, force_N, motion, parameter_values):
            return force_N + self.get(parameter_values, "x")

    problem = problem_of()
    problem = problem.with_effects([Odd(problem.scales)])
    with pytest.raises(ExportError, match="effect odd has no law in time"):
        device_of(problem, draws(problem, 1), (8.0, 20.0))
