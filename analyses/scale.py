"""Time and memory against the size of the work: tests, samples, walkers, candidates, campaigns, cores; slopes stated.

    python analyses/scale.py [--quick] [--diagnoses] [--out scale.json]

Every size goes over at least a decade. A slope is that of ln time (or ln memory) against ln size by least squares over
the upper half of the sizes, where what does not grow no longer counts: 1 is in proportion. The cost of a batch follows
from the processor seconds of one campaign, the efficiency on all cores that are here, and what is done once.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import bayes_iwan
from bayes_iwan import executors
from bayes_iwan.campaign import Loop, Record, average, read_campaign
from bayes_iwan.diagnosis import diagnosis
from bayes_iwan.diagnosis.assessment.assessed_search import weighed
from bayes_iwan.diagnosis.fits.data import GapData, gap_data
from bayes_iwan.diagnosis.fits.evidence import base_problem
from bayes_iwan.diagnosis.search.model_search import search
from bayes_iwan.diagnosis.search.search_result import Search
from bayes_iwan.effects import catalogue
from bayes_iwan.files import write_json, write_whole
from bayes_iwan.inference.results.population import SpecimenDraws, population
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.virtual_rig.simulate import PlannedTest, VirtualRig, records, with_noise
from bayes_iwan.virtual_rig.sizing import size_fault, surroundings
from bayes_iwan.virtual_rig.specimen import paper_specimen
from kill_runs import CONFIG, made_up

HERE = Path(__file__).parent
#: what is wrong with the specimen that is searched for causes
PLANTED = ("viscous_damping", "cubic_stiffness")


def seconds(work: Callable[[], object], least: float = 0.3) -> float:
    """Processor seconds of one call: the mean of as many as fill `least`, after one that is not counted."""
    work()
    calls, began = 0, time.process_time()
    while calls == 0 or time.process_time() - began < least:
        work()
        calls += 1
    return (time.process_time() - began) / calls


def cost_of(work: Callable[[], object]) -> tuple[float, float]:
    """Processor seconds and peak memory (MB) of one call, in a process of its own."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        with open("/proc/self/statm") as file:
            before = int(file.read().split()[1]) * resource.getpagesize() / 2**20
        began = time.process_time()
        work()
        took = time.process_time() - began
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        os.write(write, f"{took:.4f} {most - before:.1f}".encode())
        os._exit(0)
    os.close(write)
    with open(read) as file:
        told = file.read().split()
    os.waitpid(pid, 0)
    return float(told[0]), float(told[1])


def slope(sizes: list[float], values: list[float]) -> float:
    n = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[-n - 1 :]), np.log(np.maximum(values[-n - 1 :], 1e-9)), 1)[0])


def told(name: str, sizes: list[float], values: list[float], unit: str) -> dict[str, object]:
    row = ", ".join(f"{s:g}: {v:.3g}" for s, v in zip(sizes, values))
    print(f"{name:42s} slope {slope(sizes, values):5.2f}   {row} {unit}", flush=True)
    return {"sizes": sizes, "values": values, "unit": unit, "slope": slope(sizes, values)}


def loops_of(n: int, phases: int = 128, harmonics: int = 50) -> tuple[Loop, ...]:
    """As many loops as asked for: those of the rope spring again and again, each moved a little in frequency."""
    some = read_campaign(HERE.parent / "data" / "rope_spring").loops(n_phase=phases, n_harmonics=harmonics)
    out = []
    for i in range(n):
        x = some[i % len(some)]
        scale = 1.0 + 0.001 * (i // len(some))
        out.append(replace(x, file=f"t{i}.csv", frequency_hz=x.frequency_hz * scale, role="fit"))
    return tuple(out)


def evaluations(problem: Problem, n: int) -> Callable[[], object]:
    z = problem.prior.draw(np.random.default_rng(0), n)
    return lambda: problem.log_prob(z)


def long_record(samples: int) -> Record:
    """A record of so many samples at 2 kHz and 20 Hz."""
    t = np.arange(samples) / 2000.0
    u = 0.5 * np.sin(2 * np.pi * 20.0 * t)
    force = 5.0 * u + np.tanh(np.cos(2 * np.pi * 20.0 * t) / 0.1)
    return Record(
        "long.csv", 20.0, 0.5, "fit", {}, t, u, force + 0.01 * np.random.default_rng(0).standard_normal(samples)
    )


def planted(plan: list[PlannedTest], names: Sequence[str]) -> GapData:
    """A campaign on the virtual rig with these faults planted in the specimen, each at 10 % of the friction force."""
    rig, rng = VirtualRig(paper_specimen(seed=3), seed=3), np.random.default_rng(3)
    sound = surroundings(rig, plan)
    faults = tuple(size_fault(n, 0.1, rig, plan, rng, sound=sound) for n in names)
    setup = with_noise(rig.setup, 0.005, sound[0].friction_rms_N, sound[0].largest_mm)
    made = records(replace(rig, setup=setup, faults=faults).run_all(plan))
    return gap_data([average(r) for r in made])


def two_faults(tests: int) -> GapData:
    """So many tests of a specimen with a dashpot and a hardening spring."""
    frequencies, amplitudes = (8.0, 20.0, 12.0, 30.0, 16.0), (0.4, 0.9, 0.6, 0.3)
    few = tests <= 4
    grid = [(f, a) for f in frequencies[: 2 if few else None] for a in amplitudes[: 2 if few else None]]
    return planted([PlannedTest(f, a, cycles=24) for f, a in grid[:tests]], PLANTED)


def exact(data: GapData) -> GapData:
    """The same tests of a specimen that is the base model itself, at its medians: noise is all that is missed."""
    problem = base_problem(data, DiagnoseSettings(), scales_of(data.loops))
    rng, made = np.random.default_rng(4), []
    for loop, force_N in zip(data.loops, problem.predict(np.zeros((1, problem.ndim)))[0]):
        n = 24 * len(force_N)
        time_s = np.arange(n) / (len(force_N) * loop.frequency_hz)
        noise_N = 0.005 * np.sqrt(np.mean(force_N**2)) * rng.standard_normal(n)
        made.append(
            Record(
                loop.file, loop.frequency_hz, loop.amplitude_mm, "fit", {}, time_s,
                np.tile(loop.displacement_mm, 24), np.tile(force_N, 24) + noise_N,
            )
        )  # fmt: skip
    return gap_data([average(r) for r in made])


def diagnoses(quick: bool) -> dict[str, object]:
    """All of a quick diagnosis but its page, against the number of tests (three amplitudes at more and more
    frequencies): of a rig's specimen with a dashpot, of a sound one, which differs a little from the model as every
    specimen does, and of one that is the model itself, where the search stops at the base."""
    sizes = [3, 6] if quick else [3, 6, 9, 18, 36]
    times: dict[str, list[float]] = {"a dashpot": [], "a sound specimen's gap": [], "nothing": []}
    for tests in sizes:
        frequencies = np.round(np.geomspace(8.0, 30.0, max(tests // 3, 2))[: tests // 3], 1)
        plan = [PlannedTest(float(f), a, cycles=24) for f in frequencies for a in (0.3, 0.6, 0.9)]
        sound = planted(plan, ())
        for what, data in zip(times, (planted(plan, PLANTED[:1]), sound, exact(sound))):
            began = time.process_time()
            found = weighed(diagnosis.searched(data, DiagnoseSettings(), 0), 0)
            times[what].append(time.process_time() - began)
            chosen = " and ".join(found.search.chosen) or "nothing"
            print(f"    {tests} tests, {what}: {times[what][-1]:.1f} s, {len(found.search.fits)} sets refitted, "
                  f"found {chosen}", flush=True)  # fmt: skip
    return {
        f"diagnosis, {what}": told(f"diagnosis against tests, {what} to find", sizes, t, "s")
        for what, t in times.items()
    }


def searched(data: GapData, effects: int | None = None, executor: Executor | None = None) -> Search:
    """The search over so many of the catalogue's effects, those that are planted first."""
    kinds = catalogue.variants()
    order = sorted(kinds, key=lambda name: name not in PLANTED)[:effects]
    some = {name: kinds[name] for name in order}
    return search(data, scales_of(data.loops), DiagnoseSettings(), some, np.random.default_rng(0), executor=executor)


def candidates(quick: bool) -> dict[str, object]:
    """The search for two planted causes against the number of effects that it may name."""
    data = two_faults(4)
    sizes = [2, 5, 11, 23] if not quick else [2, 4]
    times = []
    for n in sizes:
        began = time.process_time()
        found = searched(data, n)
        times.append(time.process_time() - began)
        print(f"    {n} effects: {len(found.fits)} sets refitted, found {' and '.join(found.chosen)}", flush=True)
    return {"candidates": told("search against candidate effects", sizes, times, "s")}


def side_by_side(quick: bool) -> dict[str, object]:
    """Wall time of a whole search in this process and with two others, by number of tests."""
    sizes, alone, helped = [4] if quick else [4, 20], [], []
    for tests in sizes:
        data = two_faults(tests)
        for workers, times in ((1, alone), (2, helped)):
            with executors.opened(workers) as executor:
                searched(data, 3, executor)  # started, and their compiled code loaded
                began = time.monotonic()
                searched(data, None, executor)
                times.append(time.monotonic() - began)
        print(f"search, {tests} tests: {alone[-1]:.1f} s here, {helped[-1]:.1f} s with two processes", flush=True)
    return {"search": {"tests": sizes, "one_s": alone, "two_s": helped}}


def batches(quick: bool) -> dict[str, object]:
    """A real batch of `identify --quick` with all its files over small campaigns, by one process and by two."""
    sizes = [2, 5, 10, 20] if not quick else [2, 4]
    tmp = Path(tempfile.mkdtemp(prefix="scale"))
    found: dict[str, object] = {}
    try:
        config = write_whole(tmp / "config.toml", CONFIG)
        for n in sizes:
            for i in range(n):
                made_up(tmp / f"{n}" / f"specimen{i:02}", 5.0 + 0.05 * i, i)
        for workers in (1, 2):
            wall = []
            for n in sizes:
                with executors.opened(workers) as executor:
                    out, began = tmp / f"{n}-{workers}", time.monotonic()
                    bayes_iwan.batch(
                        tmp / f"{n}", out, quick=True, config=config, seed=1, workers=executor, progress=False
                    )
                    wall.append(time.monotonic() - began)
                shutil.rmtree(out)
            found[f"batch, {workers} workers"] = told(
                f"batch --quick, {workers} process{'es' * (workers - 1)}", sizes, wall, "s wall"
            )
    finally:
        shutil.rmtree(tmp)
    return found


def _piece(repeats: int, seed: int) -> float:
    """A piece of pure evaluation, the same for every seed but for its numbers."""
    problem = make_problem(loops_of(4))
    z = problem.prior.draw(np.random.default_rng(seed), 160)
    return float(np.sum([problem.log_prob(z)[0] for _ in range(repeats)]))


def cores(repeats: int) -> tuple[dict[str, object], float]:
    """Pieces on one process and on two, and on two against one the share of the time that is not lost."""
    pieces = {str(i): i for i in range(8)}
    wall = []
    for workers in (1, 2):
        with executors.opened(workers) as executor:
            executors.run({str(i): i for i in range(workers)}, _piece, 1, workers=executor, progress=False)  # started
            began = time.monotonic()
            executors.run(pieces, _piece, repeats, workers=executor, progress=False)
            wall.append(time.monotonic() - began)
    share = wall[0] / (2.0 * wall[1])
    load = os.getloadavg()[0]
    print(
        f"8 pieces: {wall[0]:.1f} s on one core, {wall[1]:.1f} s on two: {100 * share:.0f} % of twice the speed "
        f"({os.cpu_count()} cores here, load {load:.1f}: a busy machine has no second core to give)"
    )
    return {"cores": {"wall_s": wall, "share": share, "load": load}}, min(share, 1.0)


def batch_cost(campaign_s: float, once_s: float, share: float, campaigns: int = 1000) -> dict[str, object]:
    """Hours for a batch: the campaigns' own seconds on all cores, and what one process does at the end."""
    out: dict[str, object] = {"campaign_s": campaign_s, "once_s": once_s, "share": share}
    for n in (2, 16, 256):
        hours = (campaigns * campaign_s / (n * share) + once_s) / 3600.0
        last = campaign_s / 3600.0  # the last campaign begun is waited for
        print(
            f"    {campaigns} campaigns of {campaign_s:.0f} s on {n:3d} cores: {hours + last:7.2f} h "
            f"({once_s:.0f} s of it done once; {3600 * last:.0f} s waiting for the last)"
        )
        out[f"hours on {n}"] = hours + last
    return out


def one_campaign(small: bool, quick: bool) -> float:
    """Processor seconds of `identify` (or of `identify --quick`) with all its files, of the rope spring's twelve tests
    (small: of two)."""
    tmp = Path(tempfile.mkdtemp(prefix="scale"))
    try:
        campaign: Path = made_up(tmp / "campaign", 5.5, 7) if small else HERE.parent / "data" / "rope_spring"
        config = write_whole(tmp / "config.toml", CONFIG) if small else None
        began = time.process_time()
        with executors.serial(), warnings.catch_warnings():
            warnings.simplefilter("ignore", bayes_iwan.NotConverged)
            bayes_iwan.identify(campaign, tmp / "out", config=config, seed=1, progress=False, quick=quick)
        took = time.process_time() - began
        size = sum(p.stat().st_size for p in (tmp / "out").rglob("*") if p.is_file()) / 2**20
        print(f"one campaign {'quick' if quick else 'sampled'}: {took:.0f} s, {size:.1f} MB of files", flush=True)
        return took
    finally:
        shutil.rmtree(tmp)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a decade of each size, and records of a million samples")
    parser.add_argument(
        "--campaign-s", type=float, help="processor seconds of one sampled campaign (default: identify here)"
    )
    parser.add_argument("--diagnoses", action="store_true", help="only the diagnosis, by tests and by candidates")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    found: dict[str, Any] = {}
    if args.diagnoses:
        with executors.serial():
            found = diagnoses(args.quick) | candidates(args.quick)
        if args.out is not None:
            write_json(args.out, found)
        return
    with executors.serial():
        sizes = [2, 5, 10, 20, 50]
        problems = [make_problem(loops_of(n)) for n in sizes]
        found["tests"] = told(
            "evaluation against tests",
            sizes,
            [1e3 * seconds(evaluations(p, 160)) for p in problems],
            "ms for 160 draws",
        )
        sizes = [32, 64, 128, 256, 512]
        problems = [make_problem(loops_of(4, n, 14)) for n in sizes]
        found["phases"] = told(
            "evaluation against samples of a loop",
            sizes,
            [1e3 * seconds(evaluations(p, 160)) for p in problems],
            "ms for 160 draws",
        )
        problem = make_problem(loops_of(4))
        sizes = [20, 40, 80, 160, 320, 640]
        found["walkers"] = told(
            "evaluation against walkers", sizes, [1e3 * seconds(evaluations(problem, n)) for n in sizes], "ms"
        )
        found["walkers, memory"] = told(
            "memory against walkers",
            [160, 640, 2560, 10240],
            [cost_of(evaluations(problem, n))[1] for n in (160, 640, 2560, 10240)],
            "MB",
        )
        sizes = [10**5, 3 * 10**5, 10**6] + ([] if args.quick else [3 * 10**6, 10**7])
        average(long_record(10**4))  # what is loaded once
        costs = [cost_of(partial(average, long_record(n))) for n in sizes]
        found["samples"] = told("averaging against samples of a record", sizes, [t for t, _ in costs], "s")
        memory = [m for _, m in costs]
        found["samples, memory"] = told("memory of averaging, beside the record", sizes, memory, "MB")
        own = sizes[-1] * 24 / 2**20
        print(f"    the largest record itself is {own:.0f} MB: {memory[-1] / own:.1f} times its size more")
        sizes = [3, 10, 30, 100]
        rng = np.random.default_rng(0)
        some = [
            SpecimenDraws(str(i), np.exp(rng.normal(1.6, 0.02, 320)), np.exp(rng.normal(1.5, 1.0, 400)))
            for i in range(100)
        ]
        found["population"] = told(
            "population of one quantity, campaigns",
            sizes,
            [seconds(lambda n=n: population(some[:n])) for n in sizes],
            "s",
        )
        found |= candidates(args.quick) | diagnoses(args.quick)
        per_quantity = found["population"]["values"][-1] * 10.0  # of 1,000 campaigns, in proportion
    told_cores, share = cores(20 if args.quick else 200)
    found |= told_cores | side_by_side(args.quick) | batches(args.quick)
    once = 10.0 * per_quantity
    found["batch of 1,000, quick"] = batch_cost(one_campaign(args.quick, True), once, share)
    found["batch of 1,000"] = batch_cost(args.campaign_s or one_campaign(args.quick, False), once, share)
    if args.out is not None:
        write_json(args.out, found)


if __name__ == "__main__":
    main()
