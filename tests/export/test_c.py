"""The step in C: the package's own forward model for any motion, and a state that a solver can trust."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

import export_courses as rt
import export_targets as simulators
from bayes_iwan.effects.mounting import FreePlay
from bayes_iwan.export.device import steady_loops
from bayes_iwan.models import sine_motion

pytestmark = pytest.mark.usefixtures("compiler")

PARTS = (
    {},
    {"embedded": True},
    {"slip": "uniform", "normal_force": "polynomial3", "embedded": True},
    {"slip": "power_law", "normal_force": "hunt_crossley_no_speed", "stiffness": "constant"},
    {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant"},
)


@pytest.mark.parametrize("parts", PARTS, ids=str)
def test_every_motion_gives_the_forward_models_force(problem_of, exported, parts, draws):
    problem = problem_of(**parts)
    z = draws(problem, 4)
    force = rt.in_c(rt.module(exported(problem, z)))
    values = problem.parameter_values(z)
    for course in rt.courses(20.0, 1.0):
        for steps in (20, 100):
            found = rt.compare(force, rt.reference(problem, values, course, steps))
            assert found.rms < 1e-3 and found.energy < 1e-3, found


@pytest.fixture(scope="module")
def device(problem_of, exported, draws):
    problem = problem_of(embedded=True)
    return rt.module(exported(problem, draws(problem, 3)))


def wild(n, seed=0):
    """Steps of a random walk, with velocities to match."""
    u = 1e-4 * np.cumsum(np.random.default_rng(seed).standard_normal(n))
    return u, np.gradient(u, 1e-3)


def test_a_saved_state_goes_on_as_the_first_did(device):
    u, v = wild(600)
    one = device.Isolator(1)
    one.run(1e-3, u[:300], v[:300])
    saved = one.save()
    first = one.run(1e-3, u[300:], v[300:])
    one.restore(saved)
    assert one.run(1e-3, u[300:], v[300:]) == first
    other = device.Isolator(1)
    other.restore(saved)
    assert other.run(1e-3, u[300:], v[300:]) == first


def test_repeated_and_rejected_times_leave_no_trace(device):
    u, v = wild(200)
    plain, asked = device.Isolator(), device.Isolator()
    for i in range(200):
        t = 1e-3 * (i + 1)
        wanted = plain.at(t, u[i], v[i])
        asked.at(t + 5e-4, 2.0 * u[i], -v[i])  # tried, and rejected
        asked.at(t, u[i] + 1e-5, -v[i])  # asked again with another motion
        assert asked.at(t, u[i], v[i]) == wanted == asked.at(t, u[i], v[i])
    with pytest.raises(ValueError, match="before the last accepted step"):
        asked.at(0.0, 0.0, 0.0)


def test_steps_and_times_may_be_mixed(device):
    u, v = wild(100)
    one, other = device.Isolator(), device.Isolator()
    wanted = one.run(1e-3, u, v)
    other.run(1e-3, u[:50], v[:50])
    assert other.at(51e-3, u[50], v[50]) == pytest.approx(wanted[50], rel=1e-12)
    with pytest.raises(ValueError, match="not a state of this device"):
        other.restore(b"short")


@pytest.mark.parametrize(
    "bad", [(float("nan"), 0.0, 0.0), (1e-3, float("inf"), 0.0), (-1e-3, 0.0, 0.0), (1e-3, 1e300, 0.0)]
)
def test_what_is_no_step_is_refused_and_changes_nothing(device, bad):
    one = device.Isolator()
    one.step(1e-3, 1e-4, 0.1)
    before = one.save()
    with pytest.raises(ValueError, match="not a step"):
        one.step(*bad)
    assert one.save() == before
    with pytest.raises(ValueError, match="draw must be 0"):
        device.Isolator(99)


def test_columns_of_different_lengths_are_refused(device, problem_of, exported, draws):
    """A velocity of np.diff is one short: what was missing was zero."""
    one = device.Isolator()
    before = one.save()
    for columns in ([0.0, 1e-4], [0.1]), ([0.0, 1e-4], [0.1, 0.1], [0.0]):
        with pytest.raises(ValueError, match=r"must be as long as each other, not 2, "):
            one.run(1e-3, *columns)
    assert one.save() == before
    problem = problem_of(normal_force="constant", stiffness="constant")
    springs = simulators.exported(exported(problem, draws(problem, 1), "opensees"), "isolator_opensees")
    with pytest.raises(ValueError, match=r"must be as long as each other, not 3, 2"):
        springs.path([0.0, 1e-4, 2e-4], [0.1, 0.1], 1e-3)


def test_wild_motions_give_finite_forces_within_a_bounded_memory(device):
    for seed in range(5):
        u, v = wild(20000, seed)
        one = device.Isolator(2)
        assert np.isfinite(one.run(1e-3, u, v)).all()
        pieces = np.frombuffer(one.save())[one.size - 64 * 6 - 1]
        assert 1 <= pieces <= 64


def test_twenty_thousand_cycles_do_not_drift(device):
    t = np.arange(1, 2001) / 200.0  # 100 cycles at 10 Hz, 20 steps each
    u, v = 8e-4 * np.sin(20 * np.pi * t), 8e-4 * 20 * np.pi * np.cos(20 * np.pi * t)
    one = device.Isolator()
    first = np.array(one.run(0.005, u, v))[-20:]
    for _ in range(200):
        last = np.array(one.run(0.005, u, v))[-20:]
    assert np.abs(last - first).max() < 1e-9 * np.abs(first).max()
    assert np.frombuffer(one.save())[one.size - 64 * 6 - 1] < 10, "equal cycles do not fill the memory"


def test_closed_cycles_never_give_energy(device):
    rng, phase = np.random.default_rng(0), np.arange(1, 201) / 200
    one = device.Isolator(1)
    for _ in range(200):
        mean, size, hz = rng.uniform(-0.5, 0.5), 10 ** rng.uniform(-2, 0), rng.uniform(1.0, 30.0)
        u = 1e-3 * (mean + size * np.sin(2 * np.pi * phase))
        v = 1e-3 * size * 2 * np.pi * hz * np.cos(2 * np.pi * phase)
        one.run(1 / hz / 200, u, v)
        force = np.array(one.run(1 / hz / 200, u, v))
        work = np.sum(0.5 * (force + np.roll(force, 1)) * (u - np.roll(u, 1)))
        assert work > -1e-6 * np.std(force) * np.ptp(u)


@pytest.mark.parametrize("softness", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize("play", [0.0, 1.0])
def test_a_play_is_crossed_as_identified_and_gives_no_energy(softness, play, problem_of, exported, draws):
    problem = problem_of(embedded=True)
    problem = problem.with_effects([FreePlay(problem.scales)])
    z = draws(problem, 1)
    z[:, [problem.names.index(f"free_play.{n}") for n in ("play_mm", "softness")]] = play, softness
    fine, w, amplitude = 2000, 2 * np.pi * 12.0, 0.9
    motion = replace(sine_motion(frequency_hz=12.0, amplitude_mm=amplitude, samples=fine), cycle=np.array([9.5]))
    values = problem.parameter_values(z)
    ours, friction = steady_loops(problem, values, motion)[0, 0], problem.friction_force(values, motion)
    one = rt.module(exported(problem, z)).Isolator(0, 1e-3 * amplitude)
    for n in (20, 200):
        t = np.arange(1, 10 * n + 1) / n / 12.0
        u, v = 1e-3 * amplitude * np.sin(w * t), 1e-3 * amplitude * w * np.cos(w * t)
        one.start()
        force = np.array(one.run(1 / 12.0 / n, u, v))[-n:]
        assert np.std(force - np.roll(ours[:: fine // n], -1)) < 1e-3 * np.std(friction)
    for size in (0.02, 0.1, 0.4):
        one.run(1 / 12.0 / n, size * u[-n:], size * v[-n:])
        force = np.array(one.run(1 / 12.0 / n, size * u[-n:], size * v[-n:]))
        work = np.sum(0.5 * (force + np.roll(force, 1)) * size * (u[-n:] - np.roll(u[-n:], 1)))
        assert work > -3e-4 * np.std(force) * np.ptp(size * u)


MAIN = r"""
#include "isolator.c"
#include <stdio.h>
#include <stdlib.h>
int main(void)
{
    isolator_track track;
    double force = 0.0, u = 0.0, sum = 0.0;
    int i, set;
    for (set = 0; set < ISOLATOR_SETS; set++) {
        isolator_track_start(isolator_set(set), &track, 0.0);
        for (i = 1; i < 60000; i++) {
            u += 1e-4 * ((double)rand() / RAND_MAX - 0.5);
            const double v = 0.1 * ((double)rand() / RAND_MAX - 0.5);
            if (!isolator_at(isolator_set(set), &track, 1e-3 * i, u, v, 0.0, &force)) {
                return 1;
            }
            if (i % 7 == 0) {
                isolator_at(isolator_set(set), &track, 1e-3 * i - 5e-4, u * (i % 1001 ? 1.0 : NAN), 1e9, 0.0, &force);
            }
            sum += force;
        }
    }
    printf("%g\n", sum);
    return !isfinite(sum);
}
"""


def test_it_is_strict_c99_and_clean_under_the_sanitizers(problem_of, exported, tmp_path, draws):
    problem = problem_of(embedded=True)
    folder = exported(problem, draws(problem, 3))
    (folder / "main.c").write_text(MAIN)
    strict = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-g", "-O1"]
    sanitized = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    out = str(tmp_path / "main")
    done = subprocess.run([*strict, *sanitized, "main.c", "-o", out, "-lm"], cwd=folder, capture_output=True, text=True)
    if "cannot find" in done.stderr and "san" in done.stderr:
        pytest.skip("no libasan: apt-get install libasan8 libubsan1")
    assert done.returncode == 0, done.stderr
    ran = subprocess.run([out], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    allocated = subprocess.run(["grep", "-c", "malloc", "isolator.c"], cwd=folder, capture_output=True, text=True)
    assert allocated.stdout.strip() == "0"
