"""Fit the constants that turn figures into probabilities; laws and outside causes of the cases are left out in turn.

    python analyses/calibrate_diagnosis.py study --cases 200 --seed 71 --out runs/study [--workers 2]
    python analyses/calibrate_diagnosis.py fit runs/study/*.json [--write]

`study` draws cases on the virtual rig (laws that the catalogue does not have, one to three faults, some from outside
the catalogue), searches each and keeps its figures, one JSON file a case, so an interrupted run goes on. `fit` finds
the constants by maximum likelihood with a weak pull to zero, scores every case with constants fitted without its fault
kinds' laws (and without its outside kind), and prints both. --write replaces the package's calibration.json.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from bayes_iwan.campaign import Record, average
from bayes_iwan.executors import Failure, finished, opened
from bayes_iwan.files import write_whole
from bayes_iwan.gap.diagnosis import searched
from bayes_iwan.gap.fitting.data import gap_data
from bayes_iwan.gap.fitting.leave_out import HELD_OUT, left_out
from bayes_iwan.gap.judging.budget import (
    NINETY,
    NO_CAUSE,
    Share,
    contributing,
    left_unnamed,
    rest_without_name,
    shapley,
    shares,
    subsets,
    unseen_shares,
)
from bayes_iwan.gap.judging.calibration import (
    CALIBRATION,
    EFFECT_FIGURES,
    REST_FIGURES,
    USUAL_REST,
    Calibration,
    calibration,
    effect_figures,
    rest_figures,
)
from bayes_iwan.gap.judging.guards import Figures
from bayes_iwan.gap.judging.verdict import Weighed, falls_short, helping, least_share, named_by, weighed
from bayes_iwan.gap.searching.base import fit_base, gap_rms_N
from bayes_iwan.gap.searching.found import OWN_FORM
from bayes_iwan.gap.telling.saved_fits import LOOPS
from bayes_iwan.inference.setup.scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.rig import cases as rig_cases

#: nats within which rivals for one place cannot be told apart
APART = 30.0
#: nats that one place may cost: beyond, the search missed the truth, which no power mends
SEARCH_MISSED = 3.0
#: power of a line at half a test's frequency over its background that no sound specimen reaches
CLEAR_LINE = 20.0
#: pull of every weight to zero, per squared unit: a figure that tells nothing gets no weight
PULL = 0.1


def true_gaps(case: rig_cases.Case, seed: int) -> dict[frozenset[str], float]:
    """RMS gap, N, of the base model refitted to the same tests with some of the faults, by every set of them."""

    def gap_N(some: frozenset[str]) -> float:
        fewer = replace(case, faults=tuple(f for f in case.faults if f.name in some), unseen=())
        loops = [average(r, **LOOPS) for r in rig_cases.simulate(fewer)[0] if r.role != "held-out"]
        data = gap_data(loops)
        return gap_rms_N(data, fit_base(data, DiagnoseSettings(), scales_of(loops), np.random.default_rng(seed)))

    names = [f.name for f in case.faults]
    return {some: gap_N(some) for some in subsets(names)} if names else {}


def made(gap_N: dict[frozenset[str], float]) -> dict[str, float]:
    """Share of the base model's gap that each fault makes, Shapley value over all faults; what they leave of one is the
    specimen's own difference from the model."""
    whole = max(gap_N, key=len, default=frozenset())
    return removed(gap_N, whole)


def removed(gap_N: dict[frozenset[str], float], some: frozenset[str]) -> dict[str, float]:
    """Share of the gap that would be gone with each of some faults, all others there: what an answer says that names
    these and no others. Shapley value over these."""
    whole = max(gap_N, key=len, default=frozenset())
    before = gap_N.get(whole, 0.0)
    if before <= 0.0:
        return dict.fromkeys(some, 0.0)
    return {n: float(v) for n, v in shapley(some, lambda k: np.array(1.0 - gap_N[whole - k] / before)).items()}


def named_shares(found: Weighed, unseen: Sequence[Record]) -> dict[str, dict[str, float]]:
    """Of what today's constants name: share of the gap with its interval (no error of the law in it), share on tests
    left out, and what it removes on tests that the diagnosis never saw."""
    named = helping(found, named_by(found.figures, calibration()))
    if not named:
        return {}
    keys = subsets(named)
    share = shares(named, {k: found.sizes[k] for k in keys})
    loops = [average(r, **LOOPS) for r in unseen]
    removed = left_out([found.in_newtons[k] for k in keys], found.search.data, loops)
    of = {u.by: unseen_shares(named, [u]) for u in removed}
    left = unseen_shares(named, [u for u in removed if u.by != HELD_OUT])
    return {
        n: {
            "value": share[n].value,
            "low": share[n].low,
            "high": share[n].high,
            "left_out": left[n].value if n in left else float("nan"),
            "found": of[HELD_OUT][n].value,
        }
        for n in named
    }


def study(shared: dict[str, Any], index: int) -> dict[str, Any]:
    """One case: drawn, run, searched and weighed."""
    rng = np.random.default_rng([shared["seed"], index])
    case = rig_cases.draw_case(rng, laws=shared["laws"])
    given, unseen = rig_cases.simulate(case)
    loops = [average(r, **LOOPS) for r in given if r.role != "held-out"]
    began = time.process_time()
    found = weighed(searched(gap_data(loops), DiagnoseSettings(), 0), 0)
    took = time.process_time() - began

    def key(names: frozenset[str]) -> str:
        return "+".join(sorted(names))

    true_N = true_gaps(case, 0)
    return {
        "truth": case.truth(f"{shared['seed']}/{index}"),
        "tests": len(loops),
        "true_gap_N": {key(k): v for k, v in true_N.items()},
        "true_share": made(true_N),
        "noise_N": found.sizes[frozenset()].all.noise_N,
        "figures": [asdict(f) for f in found.figures],
        "gap_N": {key(k): v for k, v in found.gap_N.items()},
        "gap_share": {key(k): s.all.resolved_share for k, s in found.sizes.items()},
        "share": {key(k): {n: s.value for n, s in shares(k, found.sizes).items()} for k in found.fits if k},
        "along": {key(k): found.along(k) for k in found.fits if k},
        "named": named_shares(found, unseen),
        "subharmonic": found.subharmonic,
        "cpu_s": took,
    }


def run_study(cases: int, seed: int, laws: str, out: Path, workers: int) -> None:
    out.mkdir(parents=True, exist_ok=True)
    wanted = {out / f"{seed}_{i:04d}.json": i for i in range(cases)}
    pieces = {str(path): i for path, i in wanted.items() if not path.is_file()}
    with opened(workers=workers) as executor:
        for path, result in finished(
            pieces, study, {"seed": seed, "laws": laws}, executor=executor, what="cases", unit="case"
        ):
            if isinstance(result, Failure):
                print(f"{path}: {result}")
                continue
            write_whole(path, json.dumps(result))


# ---- fit


def figures_of(case: dict[str, Any]) -> list[Figures]:
    return [Figures(**f) for f in case["figures"]]


def truths(case: dict[str, Any]) -> set[str]:
    return {e["name"] for e in case["truth"]["effects"]}


def has_outside(case: dict[str, Any]) -> bool:
    return case["truth"]["kind"] in ("outside", "known_beside_outside")


def tags(case: dict[str, Any]) -> set[str]:
    """What is left out together with a case: the laws of its faults, an outside kind among them."""
    return {f"{e['name']}:{e['law']}" for e in case["truth"]["effects"]}


def place_rows(cases: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """(n, figures), (n,): every place of every case, and whether any true effect stands among its nearest rivals."""
    rows, right = [], []
    for case in cases:
        true = truths(case)
        for f in figures_of(case):
            if f.name in OWN_FORM:  # named by its share alone: every specimen of the rig differs from the family
                continue
            rows.append(effect_figures(f))
            near = {n for n, v in f.rivals.items() if v > -APART}
            right.append(f.name in true or (f.name not in NO_CAUSE and bool(near & true)) if f.name not in NO_CAUSE
                         else has_outside(case))  # fmt: skip
    return np.array(rows).reshape(-1, len(EFFECT_FIGURES)), np.array(right, dtype=float)


def logistic_fit(x: np.ndarray, y: np.ndarray) -> tuple[tuple[float, ...], float]:
    """Weights ≥ 0 and intercept of a logistic law by penalised maximum likelihood."""

    def cost(w: np.ndarray) -> float:
        t = np.clip(x @ w[:-1] + w[-1], -30, 30)
        return float(np.sum(np.logaddexp(0.0, t) - y * t) + PULL * np.sum(w[:-1] ** 2))

    start = np.r_[np.full(x.shape[1], 0.5), -1.0]
    box = [(0.0, None)] * x.shape[1] + [(None, None)]
    best = minimize(cost, start, method="L-BFGS-B", bounds=box)
    return tuple(float(v) for v in best.x[:-1]), float(best.x[-1])


def within_fit(cases: Sequence[dict[str, Any]]) -> float:
    """Power of the evidence among rivals for one place, from places where one of them is true."""
    places = []
    for case in cases:
        given, true = figures_of(case), truths(case)
        missed = true - {f.name for f in given}
        for f in given:
            right = [n for n in f.rivals if n == f.name and n in true] or [n for n in f.rivals if n in missed]
            if len(right) == 1 and f.name not in NO_CAUSE | OWN_FORM:
                places.append((np.array(list(f.rivals.values())), list(f.rivals).index(right[0])))

    def cost(power: float) -> float:
        return -sum(max(float(power * v[i] - np.logaddexp.reduce(power * v)), -SEARCH_MISSED) for v, i in places)

    grid = np.geomspace(0.02, 1.0, 40)
    return float(grid[np.argmin([cost(p) for p in grid])])


def sets(by_name: dict[str, Any]) -> dict[frozenset[str], Any]:
    return {frozenset(k.split("+")) if k else frozenset(): v for k, v in by_name.items()}


def named_in(case: dict[str, Any], c: Calibration) -> frozenset[str]:
    """What these constants name, less what does not make the gap smaller."""
    kept = set(named_by(figures_of(case), c))
    share, along = sets(case["share"]), sets(case.get("along", {}))
    while kept:
        gap, its, changes = figures_of(case)[0].before, share[frozenset(kept)], along.get(frozenset(kept), {})
        short = [n for n in sorted(kept) if falls_short(n, its[n], changes.get(n, 0.0), gap)]
        if not short:
            break
        kept.remove(min(short, key=lambda n: its[n] - least_share(n, gap)))
    return frozenset(kept)


def rest_row(case: dict[str, Any], c: Calibration) -> np.ndarray:
    """(figures,) of what is left beside the effects that these constants name."""
    return rest_figures(left_unnamed(named_in(case, c), sets(case["gap_share"])), case["subharmonic"])


def rest_has_cause(case: dict[str, Any], c: Calibration) -> float:
    """The probability that these constants state."""
    return rest_without_name(c.unknown_rest(rest_row(case, c)), figures_of(case), c)


def rest_is_real(case: dict[str, Any], c: Calibration) -> bool:
    """Does a true effect, listed or not, that these constants do not name make a part of the gap that can be seen: more
    than noise, and more than a sound specimen's own gap or with a line that no sound specimen has?"""
    gap, named = sets(case["gap_N"])[frozenset()], named_in(case, c)
    usual = USUAL_REST * case["truth"]["friction_rms_N"]
    least = max(case["noise_N"], usual if case["subharmonic"] < CLEAR_LINE else 0.0)
    return any(share * gap > least for n, share in case["true_share"].items() if n not in named)


def law_fit(cases: Sequence[dict[str, Any]]) -> float:
    """Sd of a share beyond its interval, such that nine of ten shares found on tests left out and on unseen tests lie
    within."""
    needed = []
    for case in cases:
        for n, s in case.get("named", {}).items():
            for at in (s["found"], s["left_out"]):
                if n in truths(case) and np.isfinite(at):
                    width = s["high"] - s["value"] if at > s["value"] else s["value"] - s["low"]
                    needed.append(np.sqrt(max((at - s["value"]) ** 2 - width**2, 0.0)) / NINETY)
    return float(np.quantile(needed, 0.9)) if needed else calibration().law


def fitted(cases: Sequence[dict[str, Any]]) -> Calibration:
    """Constants of maximum likelihood: places first, then rivals, then the rest beside what they name."""
    old = calibration()
    effect, bias = logistic_fit(*place_rows(cases))
    within = within_fit(cases)
    law = law_fit(cases)
    half = Calibration(effect, bias, old.rest, old.rest_bias, within, APART, old.usual, law)
    rest = np.array([rest_row(case, half) for case in cases])
    weights, rest_bias = logistic_fit(rest, np.array([float(rest_is_real(case, half)) for case in cases]))
    return Calibration(effect, bias, weights, rest_bias, within, APART, old.usual, law)


# ---- score


def score(cases: Sequence[dict[str, Any]], constants: Sequence[Calibration]) -> dict[str, tuple[float, float]]:
    """Counts (right, of) of the targets, each case with its own constants."""
    out: dict[str, list[float]] = {}

    def count(what: str, right: bool) -> None:
        out.setdefault(what, [0.0, 0.0])
        out[what][0] += right
        out[what][1] += 1

    for case, c in zip(cases, constants):
        given, true, kind = figures_of(case), truths(case), case["truth"]["kind"]
        named = {n for n in named_in(case, c) if n not in OWN_FORM}
        apart = {n for f in given if f.name in named for n, v in f.rivals.items() if v > -c.apart}
        flagged = rest_has_cause(case, c) >= 0.5
        gap = sets(case["gap_N"])[frozenset()]
        visible = {n for n, share in case["true_share"].items() if share * gap > case["noise_N"]}
        listed = {n for n in visible if n not in rig_cases.OUTSIDE}
        usual = USUAL_REST * case["truth"]["friction_rms_N"]
        clear = {n for n in visible if case["true_share"][n] * gap > usual}
        false = {n for n in named - true if not ({r for f in given if f.name == n for r, v in f.rivals.items()
                                                  if v > -c.apart} & true)}  # fmt: skip
        count("false names (a name neither true nor tied with a true one), of all cases", bool(false))
        count("strict false names, of all cases", bool(named - true))
        if kind == "none":
            count("none: false alarm", bool(named) or flagged)
        if kind == "single" and listed:
            for what in ("visible", *(("larger than a sound specimen's gap",) if clear else ())):
                count(f"single, {what}: named", true <= named)
                count(f"single, {what}: named or in the set", true <= named | apart)
            if named:
                count("single, visible: something named, a rest flagged beside it", flagged)
            else:
                count("single, visible: nothing named, called unknown", flagged)
        if kind in ("pair", "triple"):
            for n in listed:
                count("pairs and triples: visible effect found", n in named)
                count("pairs and triples: visible effect found or in a set", n in named | apart)
                if n in clear:
                    count("pairs and triples: effect larger than a sound specimen's gap found", n in named)
        if kind == "known_beside_outside":
            for n in listed:
                count("known beside unknown: known named", n in named)
                if n in clear:
                    count("known beside unknown: known larger than a sound specimen's gap named", n in named)
            if visible - listed:
                count("known beside unknown: rest flagged", flagged)
            if clear - listed:
                count("known beside unknown: rest larger than a sound specimen's gap flagged", flagged)
        if kind == "outside" and visible:
            count("outside: flagged", flagged)
            count("outside: something named", bool(named))
        share = sets(case["share"]).get(frozenset(named), {})
        gone = removed(sets(case["true_gap_N"]), frozenset(named & true))
        for e in case["truth"]["effects"]:
            if e["name"] in named:
                if (own := case.get("named", {}).get(e["name"])) is not None:
                    wide = Share(own["value"], own["low"], own["high"]).widened(c.law)
                    for what, at in (
                        ("true share", gone[e["name"]]),
                        ("share on tests left out", own["left_out"]),
                        ("share found on unseen tests", own["found"]),
                    ):
                        if np.isfinite(at):
                            count(f"{what} in the 90 % interval", wide.low <= at <= wide.high)
                count("share of a true cause within 10 points", abs(share[e["name"]] - gone[e["name"]]) <= 0.1)
                made_by_it = case["true_share"][e["name"]]
                count("the same against Shapley's value over all faults", abs(share[e["name"]] - made_by_it) <= 0.1)
    return {k: (v[0], v[1]) for k, v in out.items()}


def reliability(cases: Sequence[dict[str, Any]], constants: Sequence[Calibration]) -> tuple[float, list[str]]:
    """Calibration error of the probabilities that effects contribute and that the rest has a cause (mean distance of
    stated and found in bins, weighted by their counts), and a line for each bin."""
    stated, right = [], []
    for case, c in zip(cases, constants):
        p, _ = contributing(figures_of(case), c)
        true = truths(case)
        for name, value in p.items():
            if name not in NO_CAUSE | OWN_FORM:
                stated.append(value)
                right.append(name in true)
        stated.append(rest_has_cause(case, c))
        right.append(rest_is_real(case, c))
    x, y = np.array(stated), np.array(right, float)
    bins = np.digitize(x, [0.1, 0.3, 0.5, 0.7, 0.9])
    lines, error = [], 0.0
    for k in np.unique(bins):
        at = bins == k
        error += float(at.mean() * abs(x[at].mean() - y[at].mean()))
        lines.append(f"  stated {x[at].mean():.2f}: found {y[at].mean():.2f} ({int(y[at].sum())} of {int(at.sum())})")
    return error, lines


def left_out_in_turn(cases: Sequence[dict[str, Any]], folds: int) -> list[Calibration]:
    """For every case constants fitted without its laws: laws are dealt into folds, and a fold's constants know no case
    that has any of the fold's laws."""
    every = sorted(set().union(*(tags(case) for case in cases)))
    fold = {tag: i % folds for i, tag in enumerate(np.random.default_rng(0).permutation(every).tolist())}
    fits = {k: fitted([case for case in cases if all(fold[t] != k for t in tags(case))]) for k in range(folds)}
    none = {i: k for k, i in enumerate([i for i, case in enumerate(cases) if not tags(case)])}
    return [fits[min(fold[t] for t in tags(case))] if tags(case) else fits[none[i] % folds]
            for i, case in enumerate(cases)]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    below = parser.add_subparsers(dest="what", required=True)
    one = below.add_parser("study")
    one.add_argument("--cases", type=int, default=200)
    one.add_argument("--seed", type=int, default=71)
    one.add_argument("--laws", choices=("catalogue", "other", "all"), default="other")
    one.add_argument("--out", type=Path, default=Path("runs/study"))
    one.add_argument("--workers", type=int, default=1)
    two = below.add_parser("fit")
    two.add_argument("files", nargs="+", type=Path)
    two.add_argument("--folds", type=int, default=8)
    two.add_argument("--write", action="store_true", help="replace the package's calibration.json")
    three = below.add_parser("score", help="score the shipped constants on a study that they were not fitted to")
    three.add_argument("files", nargs="+", type=Path)
    args = parser.parse_args()
    if args.what == "study":
        run_study(args.cases, args.seed, args.laws, args.out, args.workers)
        return
    cases = [json.loads(p.read_text()) for p in args.files]
    if args.what == "score":
        _print("shipped constants", cases, [calibration()] * len(cases))
        return
    c = fitted(cases)
    print(f"{len(cases)} cases; constants: {len(asdict(c)['effect']) + len(asdict(c)['rest']) + 4}")
    print("effect:", dict(zip(EFFECT_FIGURES, np.round(c.effect, 3))), "bias", round(c.effect_bias, 3))
    print("rest:", dict(zip(REST_FIGURES, np.round(c.rest, 3))), "bias", round(c.rest_bias, 3), "within", c.within)
    _print("in sample", cases, [c] * len(cases))
    _print(f"laws and outside kinds left out in turn, {args.folds} folds", cases, left_out_in_turn(cases, args.folds))
    if args.write:
        c.save()
        print(f"written: {CALIBRATION}")


def _print(title: str, cases: Sequence[dict[str, Any]], constants: Sequence[Calibration]) -> None:
    print(title)
    for what, (right, of) in score(cases, constants).items():
        print(f"  {what:75s} {right:4.0f} of {of:4.0f}  {100 * right / of:5.1f} %")
    error, lines = reliability(cases, constants)
    print(f"  probabilities: calibration error {error:.3f}", *lines, sep="\n")


if __name__ == "__main__":
    main()
