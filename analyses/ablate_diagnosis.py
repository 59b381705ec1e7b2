"""What every rule and constant of assessment and search brings: each switched off in turn, on the same cases.

    python analyses/ablate_diagnosis.py assessment /work/cache/fits/*.pickle --out analyses/ablation_assessment.csv
    python analyses/study_fits.py CASES --without RULE --out /work/cache/RULE          (searched anew)
    python analyses/ablate_diagnosis.py search FITS /work/cache/RULE --out analyses/ablation_searching.csv

`assessment` takes minutes: every case is assessed anew from its fits and answered by what ships, less one rule.
`search` compares folders of cases that were searched without a rule (`search_rules.py`). Of each: how many names are
right and false, what is flagged, alarms, log loss, and what changes against all rules on, with a 90 % interval from
resampled cases (the same ones for both). Constants are the shipped ones: take cases that these were not fitted to.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import calibrate_diagnosis as calibrate
from bayes_iwan.diagnosis.assessment import assessed_search, budget, calibration, indicators, verdict
from bayes_iwan.diagnosis.assessment.indicators import Figures, figures_of
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.gap_size import GapSize
from bayes_iwan.diagnosis.fits.held_out_tests import HeldOut, share_by_test
from bayes_iwan.diagnosis.search.search_result import Search
from study_cases import HALVES, Answer, Case, counts, log_loss, read_cases, share_pairs

#: what is added up of a case: right names, false names, unexplained parts flagged, alarms
SUMS = {
    "right": ("singles named", "effects of pairs and triples named", "known beside foreign named"),
    "false": ("false names, all cases",),
    "flagged": ("foreign flagged",),
    "alarms": ("alarms, sound",),
    "in a set": ("singles named or in a set", "the same, or in a set"),
}
RESAMPLED = 2000

Patch = tuple[Any, str, Any]
Names = frozenset[str]
Sizes = Mapping[Names, GapSize]
#: changes the figures of a search, from its gaps and what is missed on held-out tests
Change = Callable[[Figures, Search, Sizes, Sequence[HeldOut]], Figures]


def without_reason(where: Any, name: str, reason: str) -> Patch:
    """What a function speaks against, but for one reason (a part of its text)."""
    whole = getattr(where, name)

    def some(*given: Any) -> str:
        why = str(whole(*given))
        return "" if reason in why else why

    return (where, name, some)


def changed_by(change: Change) -> Patch:
    """Figures of another kind."""

    def figures(search: Search, sizes: Sizes, fit: Fit, held_out: Sequence[HeldOut]) -> tuple[Figures, ...]:
        return tuple(change(f, search, sizes, held_out) for f in figures_of(search, sizes, fit, held_out))

    return (assessed_search, "figures_of", figures)


def of_best_set(f: Figures, search: Search, sizes: Sizes, held_out: Sequence[HeldOut]) -> Figures:
    """What an effect removes on held-out tests from what the best set of all tests leaves without it."""
    if not f.has_held_out:
        return f
    names = Names(search.chosen)
    shares = [share_by_test(u.power_N2[names - {f.name}], u.power_N2[names]).mean() for u in held_out]
    return replace(f, held_out=float(np.mean(shares)))


def switched_off() -> dict[str, list[Patch]]:
    """What is patched for each rule."""
    out: dict[str, list[Patch]] = {
        "rule: places where one of several contributes": [(verdict, "one_of", lambda *given: ())],
        "rule: patterns without a cause make it unknown": [(verdict, "NO_CAUSE", Names())],
        "rule: what is not sure may be an unlisted cause's": [(verdict, "beside_unlisted", lambda p, unlisted: p)],
        "rule: what a record shows by itself": [(verdict, "SHOWN_BY_RECORD", Names())],
        "rule: share of what changes along the record": [changed_by(lambda f, *given: replace(f, along=None))],
        "rule: what could be in its place is tied": [changed_by(lambda f, *given: replace(f, alternatives={}))],
        "rule: plausible where it misses least in newtons": [changed_by(plausible_in_evidence)],
        "held out: sets that the other tests chose": [changed_by(of_best_set)],
    }
    for title, where, name, reason in (
        ("one record names nothing", verdict, "refused", "one record"),
        ("held-out share above zero", verdict, "refused", "held-out tests"),
        ("least share", verdict, "refused", "too little"),
        ("within the prior", indicators, "implausible", "plausible"),
        ("no longer than the tested periods", indicators, "implausible", "longer"),
        ("frequencies that differ", indicators, "implausible", "frequency"),
        ("not only a number of the base", indicators, "replaced", "replaces"),
    ):
        out[f"rule: {title}"] = [without_reason(where, name, reason)]
    for nats in (10.0, 20.0, 50.0):
        tied = replace(calibration.calibration(), apart=nats)
        out[f"apart {nats:g}"] = [(calibrate, "calibration", lambda tied=tied: tied)]
    for where, name, values in (
        (calibration, "COARSENED", (1e9, 1.0, 0.5, 0.2)),
        (verdict, "PROBABLE", (0.65, 0.8)),
        (verdict, "REFUSED", (0.0, 1.0)),
        (calibration, "SUREST", (0.999,)),
        (budget, "LEAST_SHARE", (0.0,)),
        (budget, "LEAST_OF_FRICTION", (1e-12,)),
        (budget, "LEAST_MODEL_FORM", (0.02,)),
        (indicators, "LARGEST_SCORE", (3.0, 6.0)),
    ):
        for value in values:
            out[f"{name} {value:g}"] = [(where, name, value)]
    return out


def plausible_in_evidence(f: Figures, search: Search, sizes: Sizes, held_out: Sequence[HeldOut]) -> Figures:
    """An effect's numbers are asked where its evidence is best alone."""
    best = search.fit(search.chosen)
    effect = next(e for e in best.effects if e.name == f.name)
    less = search.fit(Names(search.chosen) - {f.name})
    return replace(f, odd=indicators.implausible(effect, best, search.data) or indicators.replaced(less, best))


@contextmanager
def patched(patches: Sequence[Patch]) -> Any:
    with ExitStack() as stack:
        for where, name, value in patches:
            stack.enter_context(patch.object(where, name, value))
        yield


def once(work: Callable[..., tuple[HeldOut, ...]]) -> Callable[..., tuple[HeldOut, ...]]:
    """The same, each made once: rules change which sets are asked of, not what these miss."""
    made: dict[tuple[int, ...], tuple[Sequence[Fit], tuple[HeldOut, ...]]] = {}

    def of(fits: Sequence[Fit], *more: Any) -> tuple[HeldOut, ...]:
        at = tuple(map(id, fits))  # of fits that are kept with what was made
        if at not in made:
            made[at] = (fits, work(fits, *more))
        return made[at][1]

    return of


def scored(cases: Sequence[Case]) -> dict[str, np.ndarray]:
    """(cases,) of each sum, of cases assessed by the present rules; and the log loss."""
    return sums_of(cases, calibrate.answers([c.assessed() for c in cases], [calibrate.calibration()] * len(cases)))


def sums_of(cases: Sequence[Case], given: Sequence[Answer]) -> dict[str, np.ndarray]:
    """The same of answers."""
    each = [counts(case, a) for case, a in zip(cases, given)]
    out = {k: np.array([sum(x[w][0] for w in what if w in x) for x in each], float) for k, what in SUMS.items()}
    out["log loss"] = np.array([sum(log_loss(case, a)) for case, a in zip(cases, given)])
    said = [share_pairs(case, a) for case, a in zip(cases, given)]
    out["shares held"] = np.array([sum(s.low <= true <= s.high for s, true in x) for x in said], float)
    return out


def row(
    name: str, off: dict[str, np.ndarray], on: dict[str, np.ndarray], seconds: tuple[float, float]
) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    at = rng.integers(0, len(on["right"]), (RESAMPLED, len(on["right"])))
    out: dict[str, Any] = {"without": name}
    for k in on:
        change = (off[k] - on[k])[at].sum(axis=1)
        low, high = np.quantile(change, [0.05, 0.95])
        out |= {
            k: round(float(off[k].sum()), 1),
            f"{k} change": f"{off[k].sum() - on[k].sum():+.1f} ({low:+.1f} to {high:+.1f})",
        }
    return out | {"seconds a case": round(seconds[0], 1), "seconds before": round(seconds[1], 1)}


def write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    for r in rows:
        print(f"{r['without']:45s} right {r['right']:4.0f} {r['right change']:24s} false {r['false']:3.0f} "
              f"{r['false change']:24s} flagged {r['flagged']:3.0f} alarms {r['alarms']:2.0f} "
              f"in a set {r['in a set change']:22s} log loss {r['log loss change']:26s} "
              f"shares {r['shares held']:3.0f} {r['shares held change']} {r['seconds a case']} s")  # fmt: skip


def seconds_of(cases: Sequence[Case]) -> float:
    return float(np.mean([c.seconds for c in cases]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["assessment", "search"])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--half", choices=HALVES, default="all")
    args = parser.parse_args()
    if args.what == "assessment":
        cases = read_cases(args.cases, args.half)
        took, rows = seconds_of(cases), []
        # what is suspected is counted nowhere
        with patched([(verdict, "held_out_gaps", once(verdict.held_out_gaps)), (verdict, "suspects", lambda *_: ())]):
            on = scored(cases)
            for name, patches in ({"nothing": []} | switched_off()).items():
                with patched(patches):
                    rows.append(row(name, scored(cases), on, (took, took)))
    else:
        rows = []
        for folder in args.cases:
            kept, found = ({p.name for p in x.glob("*.pickle")} for x in (args.cases[0], folder))
            before, after = (read_cases(x / n for n in kept & found) for x in (args.cases[0], folder))
            times = seconds_of(after), seconds_of(before)
            rows.append(row(f"{folder.name} ({len(after)} cases)", scored(after), scored(before), times))
    write(args.out, rows)
    print(json.dumps({"rows": len(rows), "written": str(args.out)}))


if __name__ == "__main__":
    main()
