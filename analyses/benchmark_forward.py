"""How fast the forward model is, how exact, what the machine could do, and what the usual ways cost.

    python analyses/benchmark_forward.py [--draws 256] [--repeats 20] [--out runs/benchmark_forward.json]

The call timed is the one the samplers make: Model.force on nine loops (three amplitudes, three frequencies) of 128
samples, for many draws at a time. Times are the best of some repeats, in nanoseconds a sample and draw; on one thread
they are processor time, which other work on the machine disturbs less than the clock on the wall.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numba as nb
import numpy as np

from bayes_iwan.models import Model, Motion, Reference, sine_motion
from bayes_iwan.models.kernels import sliders
from bayes_iwan.models.paper_parameters import table_1
from jenkins_elements import element_force, equal_probability_sliders

LOOPS, SAMPLES = 9, 128
#: floating-point operations a sample, counted in the source: sliders, α, k, and the draw's table shared by its samples
FLOPS = {"sliders": 39, "alpha": 47, "k": 43, "table": 32_600 / (LOOPS * SAMPLES)}
#: bytes a sample that must go to memory: the force, written once and fetched before (the rest stays in cache)
BYTES = 16
EQUAL = 20_000  # elements that are as exact as the sliders


def scattered(draws: int, reference: Reference) -> dict[str, np.ndarray]:
    """Table 1, each number scattered by some 20 %, the weights kept."""
    rng = np.random.default_rng(0)
    return {
        name: value * np.exp((0.0 if name in ("g1", "g2", "g3") else 0.2) * rng.standard_normal(draws))
        for name, value in table_1(reference).items()
    }


def best(call: Callable[[], object], repeats: int, clock: Callable[[], float] = time.process_time) -> float:
    """Shortest of some times, s."""
    times = []
    for _ in range(repeats):
        start = clock()
        call()
        times.append(clock() - start)
    return min(times)


@nb.njit(error_model="numpy", fastmath={"contract"})
def _fma_lanes(turns, lanes, out):
    """turns × 64 multiply-adds on independent numbers, in vectors."""
    a = np.ones(64)
    for _ in range(turns):
        for _ in range(16):  # long enough in registers for loads and stores not to matter
            for j in range(64):
                a[j] = a[j] * lanes + 1e-9
    out[0] = a.sum()


@nb.njit(error_model="numpy", fastmath={"contract"})
def _copy(a, b):
    for i in range(a.size):
        b[i] = a[i]


def machine(repeats: int) -> dict[str, float]:
    """Multiply-add rate (flop/s) of vectors in cache, and copying rate (B/s, fetch before write counted), one core."""
    out, turns = np.zeros(1), 20_000
    _fma_lanes(1, 0.999, out)
    flops = 2.0 * 64 * 16 * turns / best(lambda: _fma_lanes(turns, 0.999, out), repeats)
    a, b = np.ones(16_000_000), np.ones(16_000_000)
    _copy(a, b)
    return {"flop_s": flops, "bytes_s": 24.0 * a.size / best(lambda: _copy(a, b), max(3, repeats // 4))}


def numpy_elements(model: Model, parameter_values: dict[str, np.ndarray], motion: Motion, count: int) -> np.ndarray:
    """(a) the plain numpy way: α and k at once, then all draws, loops and elements at each step.

    Returns the force, (draws, loops, samples).
    """
    u, a = motion.displacement_mm[0], motion.amplitude_mm[:, None]
    y = np.maximum(a - u, 0.01 * a)
    slope, rate, beta = (
        parameter_values[n][:, None, None] for n in ("normal_force_slope", "normal_force_rate", "beta")
    )
    alpha = np.maximum(
        1.0
        + slope / beta * (y**beta - a**beta)
        + rate * y**beta * np.abs(motion.velocity_m_s[0]) / model.reference.speed_m_s,
        0.05,
    )
    z = parameter_values["stiffness_ratio"][:, None, None]
    k = parameter_values["k1_N_mm"][:, None, None] * np.expm1(-z * alpha) / np.expm1(-z)
    phi = np.stack(
        [
            equal_probability_sliders(
                lambda f, d=d: model.slip_family.survival(f, {n: v[d : d + 1] for n, v in parameter_values.items()})[0],
                count,
                30.0,
            )
            for d in range(len(beta))
        ]
    )[:, None, :]
    x = np.zeros((*alpha.shape[:2], count))
    out = np.empty_like(alpha)
    for step in range(-SAMPLES // 4, SAMPLES):  # a quarter cycle of run-in reaches one end of the stroke ...
        i = step if step >= 0 else step % SAMPLES
        limit = (alpha[..., i] / k[..., i])[..., None] * phi
        e = np.clip(u[:, i, None] - x, -limit, limit)
        x = u[:, i, None] - e
        if step >= 0:
            out[..., i] = k[..., i] * e.mean(axis=-1)
    return out + parameter_values["kp_N_mm"][:, None, None] * u


def python_loop(u, alpha, k, phi, steps: int) -> float:
    """(b) as published Python Iwan codes: one loop, numpy over the sliders inside a Python loop in time; s a step."""
    x, force = np.zeros_like(phi), np.empty(steps)
    start = time.process_time()
    for i in range(steps):
        e = u[i] - x
        limit = alpha[i] / k[i] * phi
        e = np.clip(e, -limit, limit)
        x = u[i] - e
        force[i] = k[i] * np.mean(e)
    return (time.process_time() - start) / steps


def errors(
    model: Model, parameter_values: dict[str, np.ndarray], motion: Motion, draws: int, counts
) -> dict[str, float]:
    """RMS error over RMS friction force, worst of some draws and all loops: sliders against 20,000 elements, and
    fewer elements against the sliders."""
    some = {name: value[:draws] for name, value in parameter_values.items()}
    ours = model.friction_force(some, motion)
    alpha = model.alpha(some, motion)
    k = model.stiffness_law.k(some, alpha)
    worst = {}
    for count in counts:
        share = []
        for d in range(draws):
            one = {name: value[d : d + 1] for name, value in some.items()}
            phi = equal_probability_sliders(lambda f, one=one: model.slip_family.survival(f, one)[0], count, 40.0)
            for j in range(motion.loops):
                force = element_force(
                    motion.displacement_mm[0, j], alpha[d, j], k[d, j], phi, np.full(count, 1.0 / count), passes=2
                )
                share.append(np.sqrt(np.mean((force - ours[d, j]) ** 2) / np.mean(ours[d, j] ** 2)))
        worst[str(count)] = float(max(share))
    return worst


def cold_start() -> float:
    """Processor seconds from starting Python to the first force, with nothing compiled."""
    code = (
        "from bayes_iwan.models import *; from bayes_iwan.models.paper_parameters import table_1; "
        "r = Reference(1.0, 0.1); "
        "Model(r).force(table_1(r), sine_motion(frequency_hz=10.0, amplitude_mm=1.0))"
    )
    with tempfile.TemporaryDirectory() as empty:
        start = os.times()
        subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "NUMBA_CACHE_DIR": empty})
        end = os.times()
    return end.children_user + end.children_system - start.children_user - start.children_system


def run(draws: int, repeats: int, exact: int = EQUAL) -> dict[str, object]:
    """All figures but the cold start's; `exact` elements are those that the sliders are held against."""
    reference = Reference(1.0, 2e-3 * np.pi * 20.0)
    model, parameter_values = Model(reference), scattered(draws, reference)
    motion = sine_motion(
        frequency_hz=np.tile([10.0, 15.0, 20.0], 3), amplitude_mm=np.repeat([0.3, 0.6, 1.0], 3), samples=SAMPLES
    )
    per = 1e9 / (draws * LOOPS * SAMPLES)
    model.force(parameter_values, motion)
    result: dict[str, object] = {"machine": f"{platform.machine()}, {nb.config.NUMBA_NUM_THREADS} cores"}

    nb.set_num_threads(1)
    alpha = model.alpha(parameter_values, motion)
    k = model.stiffness_law.k(parameter_values, alpha)
    tables, top = model.slip_family.table(parameter_values)
    tables, out, zero = tables[:, None], np.empty_like(alpha)[:, None], np.zeros(draws)
    result["stage_ns"] = {
        "alpha": per * best(lambda: model.alpha(parameter_values, motion), repeats),
        "k": per * best(lambda: model.stiffness_law.k(parameter_values, alpha), repeats),
        "table": per * best(lambda: model.slip_family.table(parameter_values), repeats),
        "sliders": per
        * best(
            lambda: sliders.friction(
                motion.displacement_mm, motion.slope_mm, alpha, k, zero, True, tables, top, zero, out
            ),
            repeats,
        ),
    }
    force_ns: dict[str, float] = {}
    for threads in range(1, nb.config.NUMBA_NUM_THREADS + 1):
        nb.set_num_threads(threads)
        force_ns[str(threads)] = per * best(
            lambda: model.force(parameter_values, motion),
            repeats,
            time.process_time if threads == 1 else time.perf_counter,
        )
    nb.set_num_threads(1)
    ours = force_ns["1"]
    result["force_ns"] = force_ns
    result["error"] = errors(model, parameter_values, motion, min(draws, 4), (128, 2000, exact))

    limits = machine(repeats)
    result["limits"] = {
        **limits,
        "flops_a_sample": sum(FLOPS.values()),
        "share_of_arithmetic": sum(FLOPS.values()) / ours * 1e9 / limits["flop_s"],
        "share_of_memory": BYTES / ours * 1e9 / limits["bytes_s"],
    }

    usual: dict[str, float] = {}
    for count in (128, exact):
        few = min(draws, max(1, 2000 // count))
        some = {name: value[:few] for name, value in parameter_values.items()}
        whole = best(lambda some=some, count=count: numpy_elements(model, some, motion, count), 2)
        one = {name: value[:1] for name, value in parameter_values.items()}
        nodes = best(
            lambda one=one, count=count: equal_probability_sliders(
                lambda f: model.slip_family.survival(f, one)[0], count, 30.0
            ),
            2,
        )
        # finding the elements' slip forces is not held against it
        usual[f"numpy_{count}_ns"] = 1e9 * (whole - few * nodes) / (few * LOOPS * SAMPLES)
        phi = np.linspace(0.01, 3.0, count)
        step = min(python_loop(motion.displacement_mm[0, 8], alpha[0, 8], k[0, 8], phi, SAMPLES) for _ in range(3))
        usual[f"python_loop_{count}_ns"] = 1e9 * step
    result["usual_ways"] = usual
    result["ratio"] = {name.removesuffix("_ns"): value / ours for name, value in usual.items()}
    result["exact"] = exact
    return result


def report(r) -> str:
    stage, force, error, limits, usual, ratio = (
        r[n] for n in ("stage_ns", "force_ns", "error", "limits", "usual_ways", "ratio")
    )
    exact = r["exact"]
    lines = [
        f"Forward model on {r['machine']}; ns a sample and draw, nine loops of {SAMPLES} samples",
        "  whole call        " + ", ".join(f"{v:.1f} on {t} thread{'s' * (t != '1')}" for t, v in force.items()),
        "  on one thread     " + ", ".join(f"{name} {v:.1f}" for name, v in stage.items()),
        f"  cold start        {r['cold_start_s']:.1f} s processor time to the first force, nothing compiled",
        "  error (RMS share) "
        + f"sliders against {exact} elements {error[str(exact)]:.1e}; "
        + ", ".join(f"{n} elements {error[n]:.1e}" for n in ("2000", "128")),
        f"  limits            {limits['flops_a_sample']:.0f} flop a sample: {limits['share_of_arithmetic']:.0%} "
        f"of the {limits['flop_s'] / 1e9:.0f} Gflop/s a vector loop reaches here; {BYTES} B a sample: "
        f"{limits['share_of_memory']:.0%} of {limits['bytes_s'] / 1e9:.0f} GB/s",
        "  the usual ways    ns a sample and draw, and how many times slower",
    ]
    for count, note in ((exact, "equal accuracy"), (128, f"error {error['128']:.1%}")):
        lines += [
            f"    numpy elements, {count:6d} ({note}): {usual[f'numpy_{count}_ns']:12,.0f}  × "
            f"{ratio[f'numpy_{count}']:,.0f}",
            f"    Python loop,    {count:6d} ({note}): {usual[f'python_loop_{count}_ns']:12,.0f}  × "
            f"{ratio[f'python_loop_{count}']:,.0f}",
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    args = parser.parse_args()
    result = run(args.draws, args.repeats) | {"cold_start_s": cold_start()}
    print(report(result))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
