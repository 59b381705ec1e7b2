"""Effective samples per second: this package's sampler against emcee's default move on logs of the paper's numbers.

Both sample one and the same posterior (the campaign's joint one, correlated likelihood) from the same dispersed
starts; the baseline's density over the logs is exact (paper_coordinates.py). Seconds are processor
seconds, so that other work on the machine disturbs the comparison little. The baseline is charged the evaluations of
the draws that it keeps alone, at the price of one log-probability in the package's own batches: its coordinates, its
moves and its burn-in are free. The package's rate is told twice: while it draws, where it is charged the share of all
its processor seconds that production's evaluations are of all (so part of what fitting the proposal costs is in it),
the tempered walkers' evaluations included; and from the starts on, with warm-up and adaptation. Rates are draws over
tau, of the numbers reported: kp, k(1) and the mean slip force, and the worst of all sampled and paper's numbers. (The
variance between ensembles would count the starts, which are posterior-like, as if the baseline had drawn them.) Where a
run is shorter than 50 autocorrelation times its tau is too low and its rate too high: that is said.

    python analyses/benchmark_sampling.py [CAMPAIGN] [--baseline-s 600] [--limit-s 300] [--out FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from bayes_iwan.sampling.common.convergence import convergence_of
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.ensemble.ensembles import sample
from bayes_iwan.sampling.ensemble.moves import StretchMove
from bayes_iwan.sampling.ensemble.run import POWERS
from bayes_iwan.sampling.ensemble.walkers import Walkers

from bayes_iwan.campaign import read_campaign
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import sampled_and_derived
from bayes_iwan.inference.setup.settings import IdentifySettings
from bayes_iwan.inference.solving.point import find_point, starting_population
from paper_coordinates import PaperCoordinates

KEY = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N")
#: of the baseline
MOST_STEPS, THIN = 200_000, 50


def numbers(problem: Problem, z: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Reported numbers (n, len(names)) at z (n, ndim)."""
    named = sampled_and_derived(problem, z)
    return np.stack([named[name].values for name in names], axis=1)


def price(problem: Problem, population: np.ndarray) -> float:
    """Processor seconds of one log-probability in batches of 128, the least of some repeats."""
    z = np.resize(population, (128, problem.ndim))
    taken = []
    for _ in range(8):
        began = time.process_time()
        for _ in range(10):
            problem.log_prob(z)
        taken.append((time.process_time() - began) / 1280)
    return min(taken)


def baseline(problem: Problem, population: np.ndarray, names: tuple[str, ...], seconds: float, seed: int) -> dict:
    """emcee's default move, four ensembles of 40 walkers, `seconds` on the clock.

    The ensembles step side by side (`StretchMove` in blocks, which is emcee's own move in each), because its chains
    are long and batches of twenty draws would make them three times as slow.
    """
    paper = PaperCoordinates(problem)
    y = paper.y_of(population)
    y = y[np.isfinite(paper.log_prob(y))]
    walkers = Walkers(paper.log_prob, 4, 40, y.shape[1])
    walkers.place(y, seed)
    until = time.monotonic() + seconds
    draws, _ = walkers.advance([(StretchMove(ensembles=4), 1.0)], MOST_STEPS, THIN, lambda n: None, until)
    draws = draws[:, draws.shape[1] // 4 :]  # the first quarter is left out as burn-in
    z = paper.z_of(draws.reshape(-1, y.shape[1]))
    values = numbers(problem, z, names).reshape(*draws.shape[:3], -1)
    calls = draws.shape[1] * THIN * draws.shape[0] * draws.shape[2]
    return result(values, names, THIN, calls * price(problem, population), calls)


def ours(
    problem: Problem, population: np.ndarray, names: tuple[str, ...], settings: dict, limit_s: float, seed: int
) -> dict:
    """The package's sampler until it has converged, or for limit_s; warm-up and adaptation are charged to it."""
    extra = tuple(n for n in names if n not in problem.names)
    s = settings.sampling
    began, clock = time.process_time(), time.perf_counter()
    plan = Plan(
        names=problem.names,
        seed=seed,
        quantities=(lambda z: numbers(problem, z, extra)) if extra else None,
        quantity_names=extra,
        target_r_hat=s.r_hat,
        target_ess=s.ess,
        chain_taus=s.taus,
        budget_s=limit_s,
    )
    chains = sample(problem.log_prob, population, plan, n_ensembles=s.ensembles, n_walkers=s.walkers)
    taken = time.process_time() - began
    clock = time.perf_counter() - clock
    both = np.concatenate([chains.draws, chains.quantities], axis=3)
    columns = [(problem.names + extra).index(n) for n in names]
    out = result(both[..., columns], names, chains.thin, taken, chains.n_evaluations)
    drawing = chains.n_steps * len(POWERS) * both.shape[0] * both.shape[2] / chains.n_evaluations
    while_drawing = {f"{k}_while_drawing": out[k] / drawing for k in ("ess_per_s_worst", "ess_per_s_key")}
    return (
        out
        | while_drawing
        | {"share_drawing": drawing, "clock_s": clock, "message": chains.message, "converged": chains.converged}
    )


def result(values: np.ndarray, names: tuple[str, ...], thin: int, seconds: float, evaluations: int) -> dict:
    """Effective sizes and rates from draws (ensembles, steps, walkers, names)."""
    d = convergence_of(values, names, thin=thin)
    key = [names.index(n) for n in KEY]
    taus = d.n_steps / d.tau_steps
    draws = taus * values.shape[0] * values.shape[2]
    return {
        "seconds": seconds,
        "steps": d.n_steps,
        "evaluations": evaluations,
        "tau_steps": dict(zip(names, np.round(d.tau_steps, 1).tolist())),
        "r_hat_worst": float(np.max(d.r_hat)),
        "ess_bulk": dict(zip(names, np.round(d.ess_bulk, 1).tolist())),
        "ess_per_s_worst": float(draws.min() / seconds),
        "ess_per_s_key": float(draws[key].min() / seconds),
        "run_in_taus": float(taus.min()),
        "note": "" if taus.min() >= 50 else "shorter than 50 tau: its tau is too low, its rate too high",
    }


def say(name: str, x: dict) -> None:
    tau = max(x["tau_steps"].values())
    print(
        f"{name}: {x['seconds']:.1f} processor seconds, {x['evaluations']} evaluations, {x['steps']} steps, "
        f"worst tau {tau:.0f} steps, R-hat {x['r_hat_worst']:.3f}, effective samples a second: worst number "
        f"{x['ess_per_s_worst']:.3f}, kp, k(1), mean slip force {x['ess_per_s_key']:.3f}. {x['note']}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", nargs="?", default="../shared/data/rope_spring")
    parser.add_argument("--baseline-s", type=float, default=600.0)
    parser.add_argument("--limit-s", type=float, default=300.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default="runs/benchmark_sampling.json")
    args = parser.parse_args()
    settings = IdentifySettings()
    began = time.perf_counter()
    problem = make_problem(read_campaign(args.campaign).loops(**asdict(settings.loops)), settings)
    problem.log_prob(np.zeros((512, problem.ndim)))  # compiled and cached before the clock starts
    read = time.perf_counter() - began
    point = find_point(problem, args.seed, settings.search)
    population = starting_population(problem, point, args.seed, 512)
    found = time.perf_counter() - began - read
    names = tuple(n for n, q in sampled_and_derived(problem, population).items() if np.ptp(q.values) > 0)
    mine = ours(problem, population, names, settings, args.limit_s, args.seed)
    say("package", mine)
    theirs = baseline(problem, population, names, args.baseline_s, args.seed)
    out = {
        "machine": {"cores": os.cpu_count(), "load": os.getloadavg(), "processor": platform.machine()},
        "point_s": found,
        "package": mine,
        "emcee default on the paper's logs": theirs,
        "ratio": {part: mine[f"ess_per_s_{part}"] / theirs[f"ess_per_s_{part}"] for part in ("worst", "key")},
        "ratio_while_drawing": {
            part: mine[f"ess_per_s_{part}_while_drawing"] / theirs[f"ess_per_s_{part}"] for part in ("worst", "key")
        },
    }
    Path(args.out).parent.mkdir(parents=True, exist_ok=True)
    Path(args.out).write_text(json.dumps(out, indent=1) + "\n")
    say("baseline", theirs)
    print(
        f"point estimate {found:.1f} s and sampling {mine['clock_s']:.1f} s on the clock; {mine['message']}; "
        f"load average {os.getloadavg()[0]:.1f}"
    )
    for what, ratio in (("while drawing", out["ratio_while_drawing"]), ("adaptation charged", out["ratio"])):
        print(f"ratio, {what}: {ratio['worst']:.0f} (worst number), {ratio['key']:.0f} (kp, k(1), mean slip force)")


if __name__ == "__main__":
    main()
