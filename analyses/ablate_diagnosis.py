"""What every rule and constant of assessment and search brings: each switched off in turn, on the same cases.

    python analyses/ablate_diagnosis.py assessment /work/cache/fits/*.json --out analyses/ablation_assessment.csv
    python analyses/study_fits.py CASES --set BEAM=1 --out /work/cache/BEAM=1          (searched anew)
    python analyses/ablate_diagnosis.py search FITS /work/cache/BEAM=1 --out analyses/ablation_searching.csv

`assessment` takes seconds: the constants of the probabilities are fitted anew without the rule, families of foreign
causes held out in turn, and every case is answered. `search` compares folders of cases that were searched with another
constant. Of each: how many names are right and false, what is flagged, alarms, log loss, and what changes against all
rules on, with a 90 % interval from resampled cases (the same ones for both).
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import calibrate_diagnosis as calibrate
from bayes_iwan.diagnosis.assessment import budget, calibration, verdict
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.fits.held_out_tests import share_by_test
from bayes_iwan.withheld.true_gaps import by_set
from study_cases import HALVES, Answer, Case, counts, held_out_share, log_loss, read_cases

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


def refused_but(reason: str) -> list[Patch]:
    """What is refused, but for one reason (a part of its text)."""
    whole = verdict.refused

    def some(f: Figures) -> str:
        why = whole(f)
        return "" if reason in why else why

    return [(verdict, "refused", some)]


def each_with(change: Callable[[Figures], Figures]) -> Callable[[Case], Case]:
    """A case whose effects have other figures."""
    return lambda case: replace(case, figures=tuple(change(f) for f in case.figures))


def held_out_by(share: Callable[[Case, Figures], float]) -> Callable[[Case], Case]:
    """A case whose shares on held-out tests are found otherwise."""
    return lambda case: replace(
        case, figures=tuple(replace(f, held_out=share(case, f)) if f.has_held_out else f for f in case.figures)
    )


def of_best_set(case: Case, f: Figures) -> float:
    """What an effect removes from what the best set of all tests leaves without it."""
    names = frozenset(case.stored["chosen"])
    parts = [by_set(u["power_N2"]) for u in case.stored["held_out"]]
    return float(np.mean([share_by_test(np.array(p[names - {f.name}]), np.array(p[names])).mean() for p in parts]))


def fitted_alone(case: Case) -> Case:
    """A case where an effect is asked for its share of the whole gap, also where it acts along the record."""
    gap_N, names = by_set(case.stored["gap_N"]), frozenset(case.stored["chosen"])
    return each_with(lambda f: replace(f, fitted=(gap_N[names - {f.name}] - gap_N[names]) / gap_N[frozenset()]))(case)


def not_odd(reason: str) -> Callable[[Figures], Figures]:
    return lambda f: replace(f, odd="") if reason in f.odd else f


def switched_off() -> dict[str, tuple[list[Patch], Callable[[Case], Case] | None]]:
    """What is patched for each rule, and how cases change."""
    out: dict[str, tuple[list[Patch], Callable[[Case], Case] | None]] = {}
    for title, reason in {
        "one record names nothing": "one record",
        "held-out share above zero": "held-out tests",
        "least share": "too little",
        "own form needs a gap": "every specimen",
    }.items():
        out[f"rule: {title}"] = (refused_but(reason), None)
    for title, reason in {
        "plausible numbers": "",
        "within the prior": "beyond",
        "no longer than the tested periods": "longer",
        "frequencies that differ": "frequency",
        "not only a number of the base": "replaces",
    }.items():
        out[f"rule: {title}"] = ([], each_with(not_odd(reason)))
    out["rule: patterns without a cause make it unknown"] = ([(verdict, "NO_CAUSE", frozenset())], None)
    out["rule: what a record shows by itself"] = ([(verdict, "SHOWN_BY_RECORD", frozenset())], None)
    out["rule: share of what changes along the record"] = ([], fitted_alone)
    out["held out: sets that the other tests chose"] = ([], held_out_by(of_best_set))
    out["held out: other sets"] = (
        [],
        held_out_by(lambda case, f: held_out_share(case.stored, f, lambda k: False)),
    )
    for nats in (10.0, 20.0, 50.0):
        tied = replace(calibration.calibration(), apart=nats)
        out[f"apart {nats:g}"] = ([(calibrate, "calibration", lambda tied=tied: tied)], None)
    for where, name, values in (
        (calibration, "COARSENED", (1e9, 2.0, 1.0, 0.5, 0.2)),
        (verdict, "NAMED", (0.4, 0.5, 0.8)),
        (verdict, "REFUSED", (0.0, 0.1, 0.5, 1.0)),
        (calibration, "SUREST", (0.999,)),
        (budget, "LEAST_SHARE", (0.0, 0.05)),
        (budget, "LEAST_OF_FRICTION", (1e-12,)),
        (budget, "LEAST_MODEL_FORM", (0.02,)),
    ):
        for value in values:
            out[f"{name} {value:g}"] = ([(where, name, value)], None)
    return out


@contextmanager
def patched(patches: Sequence[Patch]) -> Any:
    with ExitStack() as stack:
        for where, name, value in patches:
            stack.enter_context(patch.object(where, name, value))
        yield


def scored(cases: Sequence[Case]) -> dict[str, np.ndarray]:
    """(cases,) of each sum, with constants that know nothing of a case's family; and the log loss."""
    return sums_of(cases, calibrate.answers(cases, calibrate.held_out_in_turn(cases)))


def sums_of(cases: Sequence[Case], given: Sequence[Answer]) -> dict[str, np.ndarray]:
    """The same of answers."""
    each = [counts(case, a) for case, a in zip(cases, given)]
    out = {k: np.array([sum(x[w][0] for w in what if w in x) for x in each], float) for k, what in SUMS.items()}
    out["log loss"] = np.array([sum(log_loss(case, a)) for case, a in zip(cases, given)])
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
              f"{r['seconds a case']} s")  # fmt: skip


def seconds_of(cases: Sequence[Case]) -> float:
    return float(np.mean([c.stored["cpu_s"] for c in cases]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["assessment", "search"])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--half", choices=HALVES, default="all")
    args = parser.parse_args()
    if args.what == "assessment":
        cases = read_cases(args.cases, args.half)
        on, took = scored(cases), seconds_of(cases)
        rows = [row("nothing", on, on, (took, took))]
        for name, (patches, change) in switched_off().items():
            with patched(patches):
                rows.append(row(name, scored([change(c) for c in cases] if change else cases), on, (took, took)))
    else:
        rows = []
        for folder in args.cases:
            shared = {p.name for p in folder.glob("*.json")} & {p.name for p in args.cases[0].glob("*.json")}
            whole = read_cases(args.cases[0].glob("*.json"))
            constants = dict(zip((c.path for c in whole), calibrate.held_out_in_turn(whole)))
            both = []
            for x in (args.cases[0], folder):
                cases = read_cases(x / n for n in sorted(shared))
                given = calibrate.answers(cases, [constants[c.path] for c in cases])
                both.append((sums_of(cases, given), seconds_of(cases)))
            name = f"{folder.name} ({len(shared)} cases)"
            rows.append(row(name, both[1][0], both[0][0], (both[1][1], both[0][1])))
    write(args.out, rows)
    print(json.dumps({"rows": len(rows), "written": str(args.out)}))


if __name__ == "__main__":
    main()
