"""Fit the constants that turn figures into probabilities; laws and outside causes of the cases are left out in turn.

    python analyses/calibrate_diagnosis.py study --cases 200 --seed 71 --out runs/study [--workers 2]
    python analyses/calibrate_diagnosis.py fit runs/study/*.json [--half-real runs/half_real/answers.json] [--write]
    python analyses/calibrate_diagnosis.py study --kind known_beside_outside --cases 60 --seed 73 --out runs/study
    python analyses/calibrate_diagnosis.py study --records 1 --cases 80 --seed 72 --out runs/one
    python analyses/calibrate_diagnosis.py unjudged runs/one/*.json

`study` draws cases on the virtual rig (laws that the catalogue does not have, one to three faults, some from outside
the catalogue), searches each and keeps its figures, one JSON file a case, so an interrupted run goes on. `fit` finds
the constants by maximum likelihood with a weak pull to zero, scores every case with constants fitted without its fault
kinds' laws (and without its outside kind), and prints both. Effects put into real recordings (`half_real.py`) count
beside the rig's, each real source left out in turn. --write replaces the package's calibration.json. `unjudged` tells
how much of a fitted share counts where no test can be left out (`UNJUDGED`), from cases that are seen by the record of
their largest test alone (what their effects make of a gap is that of the whole case, and not asked there).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict
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
    shares,
    subsets,
    unseen_shares,
)
from bayes_iwan.gap.judging.calibration import (
    CALIBRATION,
    EFFECT_FIGURES,
    REST_FIGURES,
    Calibration,
    calibration,
    effect_figures,
)
from bayes_iwan.gap.judging.guards import UNJUDGED, Figures
from bayes_iwan.gap.judging.verdict import helpful
from bayes_iwan.gap.judging.weighing import Weighed, weighed
from bayes_iwan.gap.searching.found import OWN_FORM
from bayes_iwan.gap.telling.saved_fits import LOOPS
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.rig import cases as rig_cases
from bayes_iwan.validation.true_gaps import by_name, made, true_gaps_N
from half_real import places
from study_cases import (
    figures_of,
    has_outside,
    named_in,
    reliability,
    reliability_lines,
    rest_is_real,
    rest_row,
    score,
    tags,
    truths,
)

#: nats within which rivals for one place cannot be told apart
APART = 30.0
#: nats that one place may cost: beyond, the search missed the truth, which no power mends
SEARCH_MISSED = 3.0
#: below this a share is small: what nature's law puts it off by is told as a part of the share
SMALL_SHARE = 1.0 / 3.0
#: pull of every weight to zero, per squared unit: a figure that tells nothing gets no weight
PULL = 0.1


def named_shares(found: Weighed, unseen: Sequence[Record]) -> dict[str, dict[str, float]]:
    """Of what today's constants name: share of the gap with its interval (no error of the law in it), share on tests
    left out, and what it removes on tests that the diagnosis never saw."""
    named = helpful(found, calibration())
    if not named:
        return {}
    keys = subsets(named)
    share = found.told_shares(named)
    loops = [average(r, **LOOPS) for r in unseen]
    removed = left_out([found.predicting[k] for k in keys], found.search.data, loops)
    of = {u.by: unseen_shares(named, [u]) for u in removed}
    left = unseen_shares(named, [u for u in removed if u.by != HELD_OUT])
    whole = found.fits[frozenset(named)]
    predict = {e.name for e in whole.effects if e.strength_name in whole.problem.names}  # not numbers of single tests
    return {
        n: {
            "value": share[n].value,
            "low": share[n].low,
            "high": share[n].high,
            "left_out": left[n].value if n in predict and n in left else float("nan"),
            "found": of[HELD_OUT][n].value if n in predict and n in of[HELD_OUT] else float("nan"),
        }
        for n in named
    }


def study(shared: dict[str, Any], index: int) -> dict[str, Any]:
    """One case: drawn, run, searched and weighed."""
    rng = np.random.default_rng([shared["seed"], index])
    case = rig_cases.draw_case(rng, shared["kind"], laws=shared["laws"])
    given, unseen = rig_cases.simulate(case)
    records = [r for r in given if r.role != "held-out"]
    if shared["records"] is not None:
        records = sorted(records, key=lambda r: (r.amplitude_mm, r.frequency_hz))[-shared["records"] :]
    loops = [average(r, **LOOPS) for r in records]
    began = time.process_time()
    found = weighed(searched(gap_data(loops), DiagnoseSettings(), 0), 0)
    took = time.process_time() - began

    def key(names: frozenset[str]) -> str:
        return "+".join(sorted(names))

    true_N = true_gaps_N(case, 0)
    if case.faults:  # with all of them as the search found it, from more starts
        true_N[frozenset(f.name for f in case.faults)] = found.gap_N[frozenset()]
    return {
        "truth": case.truth(f"{shared['seed']}/{index}"),
        "tests": len(loops),
        "true_gap_N": by_name(true_N),
        "true_share": made(true_N),
        "noise_N": found.sizes[frozenset()].all.noise_N,
        "figures": [asdict(f) for f in found.figures],
        "gap_N": by_name(found.gap_N),
        "gap_share": {key(k): s.all.resolved_share for k, s in found.sizes.items()},
        "share": {key(k): {n: s.value for n, s in shares(k, found.sizes).items()} for k in found.fits if k},
        "told": {key(k): {n: s.value for n, s in found.told_shares(k).items()} for k in found.fits if k},
        "along": {key(k): found.along(k) for k in found.fits if k},
        "named": named_shares(found, unseen),
        "subharmonic": found.subharmonic,
        "cpu_s": took,
    }


def run_study(cases: int, seed: int, kind: str | None, laws: str, records: int | None, out: Path, workers: int) -> None:
    out.mkdir(parents=True, exist_ok=True)
    wanted = {out / f"{seed}_{i:04d}.json": i for i in range(cases)}
    pieces = {str(path): i for path, i in wanted.items() if not path.is_file()}
    with opened(workers=workers) as executor:
        for path, result in finished(
            pieces,
            study,
            {"seed": seed, "kind": kind, "laws": laws, "records": records},
            executor=executor,
            what="cases",
            unit="case",
        ):
            if isinstance(result, Failure):
                print(f"{path}: {result}")
                continue
            write_whole(path, json.dumps(result))


# ---- fit


Place = tuple[str, Figures, bool]


def place_rows(cases: Sequence[dict[str, Any]], real: Sequence[Place] = ()) -> tuple[np.ndarray, np.ndarray]:
    """(n, figures), (n,): every place of every case, and whether any true effect stands among its nearest rivals; the
    places of real recordings after those."""
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
    some = [(f, true) for _, f, true in real if f.name not in NO_CAUSE | OWN_FORM]
    rows += [effect_figures(f) for f, _ in some]
    right += [true for _, true in some]
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


def law_fit(cases: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Sd of a share beyond its interval, at most and as a part of the share, such that nine of ten shares found on
    tests left out lie within: of all shares, and of the small ones."""
    needed, stated = [], []
    for case in cases:
        for n, s in case.get("named", {}).items():
            if n in truths(case) and np.isfinite(at := s["left_out"]):
                width = s["high"] - s["value"] if at > s["value"] else s["value"] - s["low"]
                needed.append(np.sqrt(max((at - s["value"]) ** 2 - width**2, 0.0)) / NINETY)
                stated.append(s["value"])
    off, share = np.array(needed), np.array(stated)
    small, shipped = share < SMALL_SHARE, calibration()
    most = float(np.quantile(off, 0.9)) if off.size else shipped.law
    return most, float(np.quantile(off[small] / share[small], 0.9)) if small.any() else shipped.law_of_share


def fitted(cases: Sequence[dict[str, Any]], real: Sequence[Place] = ()) -> Calibration:
    """Constants of maximum likelihood: places first, then rivals, then the rest beside what they name."""
    old = calibration()
    effect, bias = logistic_fit(*place_rows(cases, real))
    within = within_fit(cases)
    law = law_fit(cases)
    half = Calibration(effect, bias, old.rest, old.rest_bias, within, APART, old.usual, *law)
    rest = np.array([rest_row(case, half) for case in cases])
    weights, rest_bias = logistic_fit(rest, np.array([float(rest_is_real(case, half)) for case in cases]))
    return Calibration(effect, bias, weights, rest_bias, within, APART, old.usual, *law)


def unjudged_lines(cases: Sequence[dict[str, Any]]) -> list[str]:
    """Log loss of the places of cases that no test left out can judge, by the share of what is fitted that counts;
    what is named with the shipped one and if all counted; stated and found frequency with the shipped one."""
    whole = [case | {"figures": [f | {"judged": True} for f in case["figures"]]} for case in cases]
    rows, right = place_rows(whole)
    c, at = calibration(), EFFECT_FIGURES.index("by_test")

    def log_odds(share: float) -> np.ndarray:
        counted = rows.copy()
        counted[:, at] *= share
        return counted @ np.array(c.effect) + c.effect_bias

    out = [f"{len(cases)} cases, {len(rows)} places, something is there in {int(right.sum())}"]
    for share in np.linspace(0.0, 1.0, 11):
        t = log_odds(share)
        out.append(f"{share:.1f} of it counts: log loss {np.mean(np.logaddexp(0.0, t) - right * t):.3f}")
    for share, some in ((UNJUDGED, cases), (1.0, whole)):
        named = [named_in(case, c) - OWN_FORM for case in some]
        true = sum(len(n & truths(case)) for n, case in zip(named, some))
        wrong = sum(bool(n - truths(case)) for n, case in zip(named, some))
        out.append(
            f"{share:.1f} of it counts: {true} of {sum(map(len, named))} names right, {wrong} cases with a false one"
        )
    stated = 1.0 / (1.0 + np.exp(-log_odds(UNJUDGED)))
    return [*out, f"with the shipped {UNJUDGED}:", *reliability_lines(stated, right)[1]]


def left_out_in_turn(cases: Sequence[dict[str, Any]], real: Sequence[Place], folds: int) -> list[Calibration]:
    """For every case constants fitted without its laws: laws are dealt into folds, and a fold's constants know no case
    that has any of the fold's laws."""
    every = sorted(set().union(*(tags(case) for case in cases)))
    fold = {tag: i % folds for i, tag in enumerate(np.random.default_rng(0).permutation(every).tolist())}
    fits = {k: fitted([case for case in cases if all(fold[t] != k for t in tags(case))], real) for k in range(folds)}
    none = {i: k for k, i in enumerate([i for i, case in enumerate(cases) if not tags(case)])}
    return [fits[min(fold[t] for t in tags(case))] if tags(case) else fits[none[i] % folds]
            for i, case in enumerate(cases)]  # fmt: skip


def real_reliability(cases: Sequence[dict[str, Any]], real: Sequence[Place]) -> list[str]:
    """Stated and found frequency of the places of real recordings, with constants that know no case of their source."""
    sources = dict.fromkeys(source for source, _, _ in real)
    known = {s: fitted(cases, [x for x in real if x[0] != s]) for s in sources}
    some = [(known[s].contributes(f), true) for s, f, true in real if f.name not in NO_CAUSE | OWN_FORM]
    return reliability_lines(np.array([p for p, _ in some]), np.array([float(true) for _, true in some]))[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    below = parser.add_subparsers(dest="what", required=True)
    one = below.add_parser("study")
    one.add_argument("--cases", type=int, default=200)
    one.add_argument("--seed", type=int, default=71)
    one.add_argument("--kind", choices=rig_cases.KINDS, help="of every case (drawn as their shares say)")
    one.add_argument("--laws", choices=("catalogue", "other", "all"), default="other")
    one.add_argument("--records", type=int, help="of each case only so many tests are seen, its largest (all)")
    one.add_argument("--out", type=Path, default=Path("runs/study"))
    one.add_argument("--workers", type=int, default=1)
    two = below.add_parser("fit")
    two.add_argument("files", nargs="+", type=Path)
    two.add_argument("--half-real", type=Path, help="answers.json of half_real.py, whose places count as well")
    two.add_argument("--folds", type=int, default=8)
    two.add_argument("--write", action="store_true", help="replace the package's calibration.json")
    three = below.add_parser("score", help="score the shipped constants on a study that they were not fitted to")
    three.add_argument("files", nargs="+", type=Path)
    four = below.add_parser("unjudged", help="what a share counts for that no test left out has borne out")
    four.add_argument("files", nargs="+", type=Path)
    args = parser.parse_args()
    if args.what == "study":
        run_study(args.cases, args.seed, args.kind, args.laws, args.records, args.out, args.workers)
        return
    cases = [json.loads(p.read_text()) for p in args.files]
    older = [str(p) for p, case in zip(args.files, cases)
             if "told" not in case or any("tests" not in f for f in case["figures"])]  # fmt: skip
    if older:
        raise SystemExit(f"{older[0]}: of an older study, whose figures are not today's; run `study` again")
    if args.what == "unjudged":
        print(*unjudged_lines(cases), sep="\n")
        return
    if args.what == "score":
        _print("shipped constants", cases, [calibration()] * len(cases))
        return
    real = places(json.loads(args.half_real.read_text())) if args.half_real else []
    c = fitted(cases, real)
    print(f"{len(cases)} cases; constants: {len(asdict(c)['effect']) + len(asdict(c)['rest']) + 5}")
    print("effect:", dict(zip(EFFECT_FIGURES, np.round(c.effect, 3))), "bias", round(c.effect_bias, 3))
    print("rest:", dict(zip(REST_FIGURES, np.round(c.rest, 3))), "bias", round(c.rest_bias, 3), "within", c.within)
    print("law", round(c.law, 3), "and of a share", round(c.law_of_share, 3))
    _print("in sample", cases, [c] * len(cases))
    _print(
        f"laws and outside kinds left out in turn, {args.folds} folds", cases, left_out_in_turn(cases, real, args.folds)
    )
    if real:
        print("real recordings, stated and found for places, each source left out in turn")
        print(*real_reliability(cases, real), sep="\n")
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
