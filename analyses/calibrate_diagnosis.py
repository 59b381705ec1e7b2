"""Fit the constants that turn evidence into probabilities, on cases from the virtual rig.

    python analyses/calibrate_diagnosis.py --sets 120:1 120:2 --out calibration [--workers 2] [--write]

Each set (cases:seed) is made on the rig and searched once; the tables of ln evidence are kept. The constants minimise
the log score of the true hypotheses by differential evolution, from the shipped ones among others, then by Powell's
method. With --cross each set is also scored with constants fitted to the others, which is what a new case may expect.
--write replaces the package's calibration.json; what is shipped came of 100:51001 50:51002 200:880501 100:990317,
then "--sets 200:60607 --sought temper within", because a better search had left the answers too modest.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import differential_evolution, minimize
from tqdm import tqdm

from bayes_iwan import executors
from bayes_iwan.campaign import read_campaign
from bayes_iwan.effects import catalogue
from bayes_iwan.gap.attribution import CALIBRATION, Calibration, Table, attribute, calibration
from bayes_iwan.gap.data import gap_data
from bayes_iwan.gap.diagnosis import write_json
from bayes_iwan.gap.saved_fits import LOOPS
from bayes_iwan.gap.search import search
from bayes_iwan.inference.scales import scales_of
from bayes_iwan.validation import sealed as withheld
from bayes_iwan.validation.estimates import binned, share
from runs import each

#: weight of each kind of case: those outside the catalogue are few, and what is outside is wider than the rig's own
WEIGHT = {"none": 1.0, "single": 1.0, "outside": 2.0, "pair": 1.0}
#: a series compliance is hardly visible in any loop (gap-notes §0): its cases would teach the constants to guess
UNTAUGHT = ("rig_compliance",)
#: no answer costs more than −ln of this
LOWEST = 1e-3
#: constants sought: name and box. Medians of shares are sought by their logarithm
BOX = {
    "small": (np.log(3e-4), np.log(6e-3)),
    "small sd": (0.3, 1.2),
    "large": (np.log(0.01), np.log(0.1)),
    "large sd": (0.3, 1.2),
    "law": (0.01, 0.2),
    "law of speed": (0.03, 0.6),
    "law of contact": (0.02, 0.3),
    "law spread": (0.1, 1.0),
    "temper": (0.1, 1.0),
    "within": (0.05, 1.0),
    "linear": (1.0, 30.0),
    "none": (-3.0, 40.0),
    "unknown": (-8.0, 30.0),
    "unlisted": (-30.0, 20.0),
    "pair": (-45.0, -4.0),
    "rough pair": (-40.0, 0.0),
    "compliance": (-300.0, -20.0),
    "direction": (-5.0, 25.0),
}
#: the most that an answer claims: of those that the fitted constants are surest of, so many are right (printed)
SURE = 0.97
#: evaluations of the local search that follows
POLISH = 600
#: nats within which causes are told apart no more; it does not enter the log score
APART = 30.0


@dataclass(frozen=True)
class Case:
    """One searched case: the hypothesis that is true ((), ("unknown",), (a,) or (a, b) sorted) and its table."""

    name: str
    kind: str
    true: tuple[str, ...]
    table: Table


def constants(x: np.ndarray, apart: float = APART) -> Calibration:
    """Calibration from the numbers sought, in the order of BOX."""
    v = dict(zip(BOX, (float(one) for one in x)))
    speed = v["law of speed"]  # laws of sliding speed are the ones that nature writes otherwise
    return Calibration(
        small=(float(np.exp(v["small"])), v["small sd"]),
        large=(float(np.exp(v["large"])), v["large sd"]),
        law=v["law"],
        law_spread=v["law spread"],
        laws={"stribeck_weakening": speed, "rate_strengthening": speed, "end_stop": v["law of contact"]},
        temper=v["temper"],
        within=v["within"],
        linear=v["linear"],
        none=v["none"],
        unknown=v["unknown"],
        unlisted=v["unlisted"],
        pair=v["pair"],
        rough_pair=v["rough pair"],
        apart=apart,
        sure=SURE,
        effect={"rig_compliance": v["compliance"], "direction_dependent_friction": v["direction"]},
    )


def numbers_of(c: Calibration) -> np.ndarray:
    """The numbers sought that make up a calibration, within BOX: where the search starts."""
    laws, effect = c.laws or {}, c.effect or {}
    x = (
        np.log(c.small[0]),
        c.small[1],
        np.log(c.large[0]),
        c.large[1],
        c.law,
        laws.get("stribeck_weakening", c.law),
        laws.get("end_stop", c.law),
        c.law_spread,
        c.temper,
        c.within,
        c.linear,
        c.none,
        c.unknown,
        c.unlisted,
        c.pair,
        c.rough_pair,
        effect.get("rig_compliance", 0.0),
        effect.get("direction_dependent_friction", 0.0),
    )
    low, high = np.array(list(BOX.values())).T
    return np.clip(x, low, high)


def searched(campaign: Path) -> dict[str, Any]:
    """ln evidence over the discrepancy grid of every hypothesis of a case."""
    loops = [x for x in read_campaign(campaign).loops(**LOOPS) if x.role != "held-out"]
    found = search(gap_data(loops), scales_of(loops), {}, catalogue.variants(), np.random.default_rng(0))
    table = Table.of(found)
    return {
        "log_z": [[list(k), v.tolist()] for k, v in table.log_z.items()],
        "unlisted": [[k, v.tolist()] for k, v in table.unlisted.items()],
    }


def table_of(kept: dict[str, Any]) -> Table:
    """The table that `searched` kept."""
    return Table({tuple(k): np.array(v) for k, v in kept["log_z"]}, {k: np.array(v) for k, v in kept["unlisted"]})


def cases_of(n: int, seed: int, out: Path, workers: int) -> list[Case]:
    """Make a set (unless made), search its cases (unless searched), and pair each table with its truth."""
    folder = out / f"cases_{n}_{seed}"
    if not (folder / "commitments.json").is_file():
        with executors.opened(workers) as executor:
            withheld.make(n, folder, seed=seed, executor=executor)
    truths = withheld.read_truths(withheld.truth_folder(folder) / "truth.json")
    names = sorted(truths)
    jobs = [(out / f"tables_{n}_{seed}" / f"{name}.json", searched, folder / name) for name in names]
    tables = [table_of(x) for x in each(jobs, workers, f"searching set {seed}")]
    return [
        Case(f"{seed}/{name}", truths[name]["kind"], true_hypothesis(truths[name]), table)
        for name, table in zip(names, tables)
    ]


def true_hypothesis(truth: dict[str, Any]) -> tuple[str, ...]:
    if truth["kind"] == "outside":
        return ("unknown",)
    return tuple(sorted(e["name"] for e in truth["effects"]))


def log_score(cases: Sequence[Case], c: Calibration) -> float:
    """Weighted mean of −ln probability of the true hypothesis."""
    total = weight = 0.0
    for case in cases:
        if case.kind == "single" and case.true[0] in UNTAUGHT:
            continue
        h = attribute(case.table, None, c).hypotheses
        p = sum(np.exp(w) for k, w in h.items() if (k[:1] if k[:1] == ("unknown",) else k) == case.true)
        total -= WEIGHT[case.kind] * np.log(max(float(p), LOWEST))
        weight += WEIGHT[case.kind]
    return total / weight


def fit(cases: Sequence[Case], rounds: int, seed: int, what: str, sought: Sequence[str]) -> Calibration:
    """The constants of least log score; those not sought stay as they are shipped."""
    whole, at = numbers_of(calibration()), [list(BOX).index(name) for name in sought]

    def complete(x: np.ndarray) -> Calibration:
        filled = whole.copy()
        filled[at] = x
        return constants(filled)

    def cost(x: np.ndarray) -> float:
        return log_score(cases, complete(x))

    box = [BOX[name] for name in sought]
    bar = tqdm(total=rounds, desc=f"fitting {what}", disable=None)
    best = differential_evolution(
        cost,
        box,
        maxiter=rounds,
        popsize=3,
        rng=np.random.default_rng(seed),
        polish=False,
        x0=whole[at],
        callback=lambda intermediate_result: bool(bar.update()) and False,
    )
    bar.close()
    near = minimize(cost, best.x, method="Powell", bounds=box, options={"maxfev": POLISH, "xtol": 1e-2, "ftol": 1e-4})
    return complete(near.x if near.fun < best.fun else best.x)


def scores(cases: Sequence[Case], c: Calibration) -> dict[str, Any]:
    """Log score and shares right, with intervals, of these constants on these cases."""
    given = {case.name: attribute(case.table, None, c) for case in cases}
    of = {kind: [case for case in cases if case.kind == kind] for kind in WEIGHT}
    single = of["single"]
    return {
        "log score, nats": log_score(cases, c),
        "no effect: called none": share([given[k.name].cause == "none" for k in of["none"]]),
        "single: first answer right": share([given[k.name].cause == k.true[0] for k in single]),
        "single: in the set": share(
            [k.true[0] in (given[k.name].cause, *given[k.name].cannot_tell_apart) for k in single]
        ),
        "outside: called unknown": share([given[k.name].cause == "unknown" for k in of["outside"]]),
        "pairs: both named": share(
            [{given[k.name].cause, given[k.name].second_cause} == set(k.true) for k in of["pair"]]
        ),
    }


def told(title: str, s: dict[str, Any]) -> None:
    print(title)
    for name, value in s.items():
        print(f"  {name:30s} {value if isinstance(value, float) else value.text()}", flush=True)


def figure(parts: dict[str, list[tuple[float, bool]]]) -> Figure:
    """Stated probability of the verdict against how often it was right."""
    fig = Figure(figsize=(4.6, 4.3), layout="constrained")
    ax = fig.add_subplot()
    ax.plot([0, 1], [0, 1], color="#888888", lw=1)
    for (label, points), colour in zip(parts.items(), ("#2266aa", "#cc6611")):
        found = binned([p for p, _ in points], [r for _, r in points], np.linspace(0, 1, 6).tolist())
        for i, (x, e) in enumerate(found):
            ax.errorbar(
                [x],
                [e.value],
                [[e.value - e.low], [e.high - e.value]],
                fmt="o",
                color=colour,
                capsize=3,
                label=f"{label} ({len(points)} cases)" if i == 0 else None,
            )
    ax.set_xlabel("stated probability of the verdict")
    ax.set_ylabel("share right")
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    return fig


def verdicts(cases: Sequence[Case], c: Calibration) -> list[tuple[float, bool]]:
    """Stated probability and whether right, of cases with one true answer."""
    out = []
    for case in cases:
        if case.kind != "pair":
            a = attribute(case.table, None, c)
            out.append((a.probability, a.cause == (case.true[0] if case.true else "none")))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="+", default=["120:1", "120:2"], metavar="CASES:SEED")
    parser.add_argument("--cross", action="store_true", help="also score each set with constants from the others")
    parser.add_argument("--rounds", type=int, default=40, help="rounds of differential evolution")
    parser.add_argument(
        "--sought",
        nargs="+",
        choices=list(BOX),
        default=list(BOX),
        metavar="CONSTANT",
        help="fit these and leave the others as shipped (default: all)",
    )
    parser.add_argument("--out", type=Path, default=Path("calibration"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--seed", type=int, default=1, help="of the fit")
    parser.add_argument("--write", action="store_true", help=f"replace {CALIBRATION.name} of the package")
    args = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    args.out.mkdir(parents=True, exist_ok=True)
    sets = []
    for text in args.sets:
        n, _, seed = text.partition(":")
        if not (n.isdigit() and seed.isdigit() and int(n) > 0):
            parser.error(f"--sets {text}: write CASES:SEED, for example 120:1")
        sets.append(cases_of(int(n), int(seed), args.out, args.workers))
    everything = [case for some in sets for case in some]
    best = fit(everything, args.rounds, args.seed, "all", args.sought)
    inside = scores(everything, best)
    told(f"in sample, {len(everything)} cases:", inside)
    result: dict[str, Any] = {"constants": asdict(best), "in sample": _plain(inside), "out of sample": []}
    parts = {"in sample": verdicts(everything, best)}
    if args.cross:
        parts["out of sample"] = []
        for i, some in enumerate(sets):
            others = [case for k, one in enumerate(sets) if k != i for case in one]
            c = fit(others, args.rounds, args.seed, f"all but {args.sets[i]}", args.sought)
            outside = scores(some, c)
            told(f"out of sample, set {args.sets[i]}, constants from the others:", outside)
            result["out of sample"].append({"set": args.sets[i], "scores": _plain(outside), "constants": asdict(c)})
            parts["out of sample"] += verdicts(some, c)
    write_json(args.out / "fitted.json", result)
    for part, points in parts.items():
        surest = [right for p, right in points if p > 0.95 * best.sure]
        print(f"surest answers, {part}: {share(surest).text()} right")
    figure(parts).savefig(args.out / "reliability.png", dpi=130)
    print(json.dumps(asdict(best)))
    if args.write:
        best.save()
        print(f"written: {CALIBRATION}")


def _plain(s: dict[str, Any]) -> dict[str, Any]:
    return {k: v if isinstance(v, float) else vars(v) for k, v in s.items()}


if __name__ == "__main__":
    main()
