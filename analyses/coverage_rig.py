"""Coverage of the intervals where the model is slightly wrong: sound specimens on the virtual rig.

    python analyses/coverage_rig.py --cases 24 --out coverage [--laplace] [--forms embedded plain first] [--workers 2]

The rig shares no code with the model: its sliders differ from each other, its slip forces follow other laws, its
normal force and contact stiffness have slightly other shapes, and its sensors are filtered and noisy. The truth of
kp and k(1) is that of the specimen in series with its sound fixture, which no loop tells apart, that of the slip
forces' mean and quartiles is the specimen's own; that of each test's dissipated energy comes from a run without noise
and sensors. An interval that is right covers it as often as it says. Both are counted: the posterior's own intervals,
and those that are reported, with between-test variance and what no smooth law has. --laplace takes the normal
approximation at the most probable point instead of the sampler. --forms: `embedded` lets the model's form bend, `plain`
does not, `blunt` has the first version's limit of the gamma shapes, `first` its likelihood, too (commit b18e0bc), whose
widths the others are compared with.
How the misfits of two tests correlate is told too: that of tests of one amplitude, and that of tests of one frequency;
and the coverage by the number of tests, on which between-test variance hangs.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import average, in_band
from bayes_iwan.files import write_json
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.setup.scales import loop_energy_mJ
from bayes_iwan.inference.setup.settings import SamplingSettings
from bayes_iwan.inference.solving.intervals import Widening, widenings
from bayes_iwan.inference.solving.point import laplace_scale, most_probable
from bayes_iwan.rig import cases as rig_cases
from bayes_iwan.rig import simulate as rig
from bayes_iwan.validation.estimates import share
from runs import each
from sbc import short_posterior

LEVELS = (0.5, 0.9, 0.95)
#: numbers of tests by which coverage is told
TESTS = ((2, 5), (6, 7), (8, 20))
GRID = {"n_phase": 64, "n_harmonics": 24}
QUARTILES = (25, 50, 75)
NAMES = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N", *(f"slip_force_q{q}_N" for q in QUARTILES), "energy")


#: the first version's limit of the gamma shapes
BLUNT = {f"eta{i}": {"upper": 16.0} for i in (1, 2, 3)}
#: configuration of each form
FORMS: dict[str, dict[str, Any]] = {
    "embedded": {"model": {"embedded": True}},
    "plain": {"model": {"embedded": False}},
    "blunt": {"model": {"embedded": False}, "parameters": BLUNT},
    "first": {
        "model": {"embedded": False},
        "likelihood": {"kind": "matern"},
        "parameters": {
            "noise_scale": {"prior": {"dist": "lognorm", "s": 0.3, "scale": 1.0}},
            **BLUNT,
        },
    },
}


def simulated(seed: int, index: int) -> dict[str, Any]:
    """A sound case: its averaged loops as recorded, the truths, and the share of its elements below each slip force."""
    case = rig_cases.draw_case(np.random.default_rng([seed, index]), "none")
    tests = tuple(t for t in case.tests if t.role == "fit")
    at: dict[str, Any] = dict(setup=case.setup, seed=case.seed)
    loops = [in_band(average(r, **GRID)) for r in rig.records(rig.simulate_tests(case.specimen, tests, **at))]
    clean = [average(r, **GRID) for r in rig.records(rig.simulate_tests(case.specimen, tests, clean=True, **at))]
    s, compliance = case.specimen, case.setup.fixture_compliance_mm_N
    soft, stiff = (1.0 / (1.0 / k + compliance) for k in (s.parallel_N_mm, s.parallel_N_mm + s.contact_N_mm))
    truth = {"kp_N_mm": soft, "k1_N_mm": stiff - soft, "mean_slip_force_N": float(s.slip_share_N.sum())}
    slip = s.slip_share_N / s.stiffness_share
    order = np.argsort(slip)
    share = np.cumsum(s.stiffness_share[order]) - 0.5 * s.stiffness_share[order]
    truth |= {f"slip_force_q{q}_N": float(np.interp(q / 100, share, slip[order])) for q in QUARTILES}
    energy = [float(loop_energy_mJ(x.displacement_mm, x.force_N)) for x in clean]
    truth |= {f"dissipated_energy_mJ[{x.file}]": e for x, e in zip(loops, energy)}
    return {"loops": loops, "truth": truth, "elements": (slip[order], share)}


def laplace(problem: Problem, seed: int) -> tuple[Array, dict[str, Array]]:
    """The most probable point (ndim,) found from prior draws, and each quantity's normal distribution there.

    1000 even quantiles of each, log-normal and to first order: draws in all coordinates would leave the thin bent sheet
    that the posterior is, and with it the energies.
    """
    first = problem.prior.draw(np.random.default_rng([seed, 3]), 320)
    optima, _, _ = most_probable(problem, first[np.argsort(problem.goal(first))[:8]])
    z, n, step = optima[0], problem.ndim, 1e-4
    spread = laplace_scale(problem, z)
    found = quantities(problem, np.concatenate([z[None], z + step * np.eye(n), z - step * np.eye(n)]))
    even = stats.norm.ppf((np.arange(1000) + 0.5) / 1000)
    out = {}
    for name, quantity in found.items():
        if np.all(quantity.values > 0.0):
            x = np.log(quantity.values)
            sd = np.linalg.norm(spread.T @ (x[1 : n + 1] - x[n + 1 :]) / (2.0 * step))
            with np.errstate(over="ignore"):  # a number that no loop determines may be anything
                out[name] = np.exp(x[0] + even * sd)
    return z, out


def needed(widening: Widening, draws: Array, truth: float) -> float:
    """The least level whose interval holds the truth."""
    low, high = 0.0, 1.0 - 1e-9
    for _ in range(30):
        level = 0.5 * (low + high)
        ends = widening.interval(draws, level)
        low, high = (low, level) if ends[0] <= truth <= ends[1] else (level, high)
    return high


def one_case(seed: int, index: int, forms: list[str], budget_s: float | None) -> dict[str, Any]:
    """Each form's levels that intervals need to hold the truths, and how far the medians are off; budget_s None:
    Laplace."""
    made = simulated(seed, index)
    out: dict[str, Any] = {"index": index, "tests": len(made["loops"])}
    for form in forms:
        problem = make_problem(made["loops"], FORMS[form])
        told: dict[str, Any] = {"converged": True}
        if budget_s is None:
            at, found = laplace(problem, index)
        else:
            draws, told = short_posterior(problem, index, SamplingSettings(budget_s=budget_s))
            z = draws[np.linspace(0, len(draws) - 1, 1000).round().astype(int)]
            found = {n: q.values for n, q in quantities(problem, z).items()}
            at = most_probable(problem, z[[int(np.argmax(problem.log_prob(z)))]])[0][0]  # as the package judges them
        numbers = judged(problem, at, found, made["truth"])
        off = [share_off(numbers[f"slip_force_q{q}_N"], made, q) for q in QUARTILES]
        out[form] = told | {"numbers": numbers, "pairs": pairs(problem, at), "share_off": off}
    return out


def judged(problem: Problem, at: Array, found: dict[str, Array], truth: dict[str, float]) -> dict[str, Any]:
    """By quantity: the least levels that hold the truth, alone and as reported, relative error and 90 % widths."""
    widened = widenings(problem, at)
    out = {}
    for name, true in truth.items():
        x, w = found[name], widened[name]
        w = w if np.all(x > 0.0) else replace(w.alone(), relative=False)
        alone = w.alone()
        row = {"alone": needed(alone, x, true), "reported": needed(w, x, true)}
        row["error"] = float(w.centre(x) / true - 1.0)
        for which, widening in (("alone", alone), ("reported", w)):
            low, high = widening.interval(x)
            row[f"width_{which}"] = (high - low) / true
        out[name] = row
    return out


def share_off(row: dict[str, float], made: dict[str, Any], q: int) -> float:
    """By how much the share of the elements below the reported quantile differs from q per cent."""
    slip, share = made["elements"]
    reported = made["truth"][f"slip_force_q{q}_N"] * (1.0 + row["error"])
    return float(np.interp(reported, slip, share) - q / 100)


def pairs(problem: Problem, z: Array) -> list[tuple[float, float, float]]:
    """Of every two tests: distance in ln f, in ln A, and the correlation of their residuals, each over its amplitude's
    root as the default likelihood has it, harmonics from the first on."""
    residual = problem.residual(z[None])[0]
    residual = residual - residual.mean(axis=1, keepdims=True)
    unit = residual / np.linalg.norm(residual, axis=1, keepdims=True)
    f, a = (np.log([getattr(x, n) for x in problem.loops]) for n in ("frequency_hz", "amplitude_mm"))
    return [
        (float(abs(f[i] - f[j])), float(abs(a[i] - a[j])), float(unit[i] @ unit[j]))
        for i in range(len(f))
        for j in range(i)
    ]


def correlations(cases: list[dict[str, Any]], same: float = 0.05) -> dict[str, float]:
    """Mean correlation of two tests' misfits: of one amplitude, of one frequency, and of neither; NaN without any."""
    every = np.array([p for c in cases for p in c["pairs"]]).reshape(-1, 3)
    near_f, near_a = every[:, 0] < same, every[:, 1] < same
    groups = {"one amplitude": near_a & ~near_f, "one frequency": near_f & ~near_a, "neither": ~near_f & ~near_a}
    return {name: float(every[rows, 2].mean()) if rows.any() else float("nan") for name, rows in groups.items()}


def rows_of(cases: list[dict[str, Any]], name: str) -> list[dict[str, float]]:
    """Case by case; energies test by test."""
    wanted = "dissipated_energy" if name == "energy" else name
    return [r for c in cases for n, r in c["numbers"].items() if n.startswith(wanted)]


def covered(cases: list[dict[str, Any]], name: str, level: float, which: str = "reported") -> list[bool]:
    """Does the interval hold the truth?"""
    return [r[which] <= level for r in rows_of(cases, name)]


def figure(cases: list[dict[str, Any]], names: list[str]) -> Figure:
    """Nominal against found coverage, one line for each quantity."""
    fig = Figure(figsize=(5, 4.6), layout="constrained")
    ax = fig.add_subplot()
    ax.plot([0, 1], [0, 1], color="#888888", lw=1, label="stated = found")
    levels = np.linspace(0.05, 0.99, 48)
    for name, colour in zip(names, ("#2266aa", "#cc6611", "#559955", "#884499", "#aa4466", "#777722", "#333333")):
        for which, style in (("reported", "-"), ("alone", ":")):
            label = name if which == "reported" else None
            found = [np.mean(covered(cases, name, x, which)) for x in levels]
            ax.plot(levels, found, style, color=colour, lw=1.3, label=label)
    ax.set_xlabel("stated probability of the interval")
    ax.set_ylabel("share of intervals that hold the truth")
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1.02)
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    ax.set_title(f"{len(cases)} sound specimens on the virtual rig; dotted: posterior alone", fontsize=9)
    return fig


def by_tests(cases: list[dict[str, Any]], name: str) -> list[str]:
    """Coverage of specimens with few, some and many tests."""
    out = []
    for low, high in TESTS:
        some = [c for c in cases if low <= c["tests"] <= high]
        if some:
            found = " / ".join(f"{100 * np.mean(covered(some, name, level)):.0f}" for level in LEVELS)
            out.append(f"{low} to {high} tests: {found} of {len(some)}")
    return out


def table_of(cases: list[dict[str, Any]], form: str) -> dict[str, Any]:
    """Coverage and widths of one form, printed line by line."""
    late, walked = sum(not c["converged"] for c in cases), sum(not c.get("independent", True) for c in cases)
    print(f"{form}: {len(cases)} cases, {late} posteriors short of convergence, {walked} sampled by ensembles")
    table: dict[str, Any] = {"short_of_convergence": late}
    for name in NAMES:
        rows = rows_of(cases, name)
        table[name] = {"median_error": float(np.median([abs(r["error"]) for r in rows]))}
        for which in ("alone", "reported"):
            found = {level: share(covered(cases, name, level, which)) for level in LEVELS}
            width = float(np.median([r[f"width_{which}"] for r in rows]))
            print(
                f"{name:18s} {which:8s} "
                + "   ".join(f"{100 * k:.0f} %: {e.text()}" for k, e in found.items())
                + f"   median 90 % width {100 * width:.2f} %"
            )
            table[name][which] = {"coverage": {str(k): vars(e) for k, e in found.items()}, "median_width": width}
    for name in ("kp_N_mm", "mean_slip_force_N"):
        print(f"{name:18s} reported, 50 / 90 / 95 %, " + "; ".join(by_tests(cases, name)))
    off = np.median(np.abs([c["share_off"] for c in cases]), axis=0)
    table["share_off"] = dict(zip(QUARTILES, off.tolist()))
    print("share of the elements below a reported quartile, off by (median): "
          + ", ".join(f"{q} %: {100 * x:.1f} %" for q, x in table["share_off"].items()))  # fmt: skip
    table["correlation"] = correlations(cases)
    print("misfits' correlation between tests: " + ", ".join(f"{k} {v:.2f}" for k, v in table["correlation"].items()))
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=["plain"])
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of sampling for each posterior, at most")
    parser.add_argument("--laplace", action="store_true", help="normal approximation at the most probable point")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--out", type=Path, default=Path("coverage"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    args = parser.parse_args()
    name = f"{'_'.join(args.forms)}{'_laplace' if args.laplace else ''}_{args.seed}"
    budget = None if args.laplace else args.budget
    jobs = [
        (args.out / "cases" / f"{name}_{i:03d}.json", one_case, args.seed, i, args.forms, budget)
        for i in range(args.cases)
    ]
    cases = list(each(jobs, args.workers, "cases"))
    tables = {form: table_of([c[form] | {"tests": c["tests"]} for c in cases], form) for form in args.forms}
    if "first" in args.forms:
        for form in args.forms:
            ratio = (
                tables[form]["kp_N_mm"]["reported"]["median_width"]
                / tables["first"]["kp_N_mm"]["alone"]["median_width"]
            )
            print(f"width of kp's 90 % interval as reported over the first version's: {form} {ratio:.2f}")
    write_json(args.out / "coverage.json", {"seed": args.seed, "forms": tables, "cases": cases})
    figure([c[args.forms[0]] for c in cases], list(NAMES)).savefig(args.out / "coverage.png", dpi=130)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
