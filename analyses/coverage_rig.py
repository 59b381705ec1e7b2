"""Coverage of the posterior's intervals where the model is slightly wrong: sound specimens on the virtual rig.

    python analyses/coverage_rig.py --cases 24 --out coverage [--workers 2]

The rig shares no code with the model: its sliders differ from each other, its slip forces follow other laws, its
normal force and contact stiffness have slightly other shapes, and its sensors are filtered and noisy. The truth of
kp and k(1) is that of the specimen in series with its sound fixture, which no loop tells apart, that of the mean slip
force is the specimen's own; that of each test's dissipated energy comes from a run without noise and sensors. An
interval that is right covers it as often as it says.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.campaign.averaging import average
from bayes_iwan.gap.diagnosis import write_json
from bayes_iwan.inference.likelihood import KINDS
from bayes_iwan.inference.problem import make_problem
from bayes_iwan.inference.quantities import loop_quantities
from bayes_iwan.inference.scales import loop_energy_mJ
from bayes_iwan.rig import cases as rig_cases
from bayes_iwan.rig import simulate as rig
from bayes_iwan.validation.estimates import share
from runs import each
from sbc import short_posterior

LEVELS = (0.5, 0.9, 0.95)
GRID = {"n_phase": 64, "n_harmonics": 24}


def simulated(seed: int, index: int) -> dict[str, Any]:
    """A sound case: its averaged loops as recorded, and the truths."""
    case = rig_cases.draw_case(np.random.default_rng([seed, index]), "none")
    tests = tuple(t for t in case.tests if t.role == "fit")
    at = dict(setup=case.setup, seed=case.seed)
    loops = [average(r, **GRID) for r in rig.records(rig.simulate_tests(case.specimen, tests, **at))]
    clean = [average(r, **GRID) for r in rig.records(rig.simulate_tests(case.specimen, tests, clean=True, **at))]
    s, compliance = case.specimen, case.setup.fixture_compliance_mm_N
    soft, stiff = (1.0 / (1.0 / k + compliance) for k in (s.parallel_N_mm, s.parallel_N_mm + s.contact_N_mm))
    truth = {"kp_N_mm": soft, "k1_N_mm": stiff - soft, "mean_slip_force_N": float(s.slip_share_N.sum())}
    energy = [float(loop_energy_mJ(x.displacement_mm, x.force_N)) for x in clean]
    return {"loops": loops, "truth": truth, "energy": energy}


def one_case(seed: int, index: int, kind: str, budget_s: float) -> dict[str, Any]:
    """Posterior quantiles at which the truths lie, and how far the medians are off."""
    made = simulated(seed, index)
    problem = make_problem(made["loops"], {"likelihood": {"kind": kind}})
    draws, told = short_posterior(problem, index, budget_s)
    z = draws[np.linspace(0, len(draws) - 1, 1000).round().astype(int)]
    values = problem.prior.values(z)
    energy = loop_quantities(problem.motion, problem.predict(z))[0]
    at = {n: (values[n], true) for n, true in made["truth"].items()}
    at |= {f"energy {t}": (energy[:, t], true) for t, true in enumerate(made["energy"])}
    return {
        "index": index,
        "tests": len(problem.loops),
        **told,
        "quantile": {n: float(np.mean(v < true)) for n, (v, true) in at.items()},
        "error": {n: float(np.median(v) / true - 1.0) for n, (v, true) in at.items()},
        "sd": {n: float(np.std(v) / true) for n, (v, true) in at.items()},
    }


def covered(cases: list[dict[str, Any]], name: str, level: float) -> list[bool]:
    """Does the central interval hold the truth, case by case (energies: test by test)?"""
    q = [v for c in cases for n, v in c["quantile"].items() if n == name or (name == "energy" and n.startswith(name))]
    return [abs(v - 0.5) <= 0.5 * level for v in q]


def figure(cases: list[dict[str, Any]], names: list[str]) -> Figure:
    """Nominal against found coverage, one line for each quantity."""
    fig = Figure(figsize=(5, 4.6), layout="constrained")
    ax = fig.add_subplot()
    ax.plot([0, 1], [0, 1], color="#888888", lw=1, label="stated = found")
    levels = np.linspace(0.05, 0.99, 48)
    for name, colour in zip(names, ("#2266aa", "#cc6611", "#559955", "#884499")):
        ax.plot(levels, [np.mean(covered(cases, name, x)) for x in levels], color=colour, lw=1.3, label=name)
        for level in LEVELS:
            e = share(covered(cases, name, level))
            ax.plot([level, level], [e.low, e.high], color=colour, lw=0.8, alpha=0.7)
    ax.set_xlabel("stated probability of the interval")
    ax.set_ylabel("share of intervals that hold the truth")
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1.02)
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    ax.set_title(f"{len(cases)} sound specimens on the virtual rig; bars: 95 % intervals", fontsize=9)
    return fig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--likelihood", choices=KINDS, default="correlated")
    parser.add_argument("--budget", type=float, default=20.0, help="seconds of sampling for each posterior, at most")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--out", type=Path, default=Path("coverage"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    args = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    jobs = [
        (
            args.out / "cases" / f"{args.likelihood}_{args.seed}_{i:03d}.json",
            one_case,
            args.seed,
            i,
            args.likelihood,
            args.budget,
        )
        for i in range(args.cases)
    ]
    cases = list(each(jobs, args.workers, "cases"))
    late = sum(not c["converged"] for c in cases)
    print(f"{len(cases)} cases, {args.likelihood} likelihood, {late} posteriors short of convergence")
    names = ["kp_N_mm", "k1_N_mm", "mean_slip_force_N", "energy"]
    table: dict[str, Any] = {}
    for name in names:
        found = {level: share(covered(cases, name, level)) for level in LEVELS}
        error = [abs(v) for c in cases for n, v in c["error"].items() if n.startswith(name)]
        sd = [v for c in cases for n, v in c["sd"].items() if n.startswith(name)]
        print(
            f"{name:18s} "
            + "   ".join(f"{100 * k:.0f} %: {e.text()}" for k, e in found.items())
            + f"   median |error| {100 * np.median(error):.2f} %, sd {100 * np.median(sd):.2f} %"
        )
        table[name] = {
            "coverage": {str(k): vars(e) for k, e in found.items()},
            "median_error": float(np.median(error)),
            "median_sd": float(np.median(sd)),
        }
    write_json(
        args.out / "coverage.json",
        {
            "likelihood": args.likelihood,
            "seed": args.seed,
            "table": table,
            "short_of_convergence": late,
            "cases": cases,
        },
    )
    figure(cases, names).savefig(args.out / "coverage.png", dpi=130)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
