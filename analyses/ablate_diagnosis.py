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
import study_cases
from bayes_iwan.diagnosis.assessment import calibration, verdict
from bayes_iwan.diagnosis.assessment.calibration import EFFECT_FIGURES, UNEXPLAINED_FIGURES
from study_cases import Case, counts, log_loss, read_cases

#: what is added up of a case: right names, false names, unexplained parts flagged, alarms
SUMS = {
    "right": ("singles named", "effects of pairs and triples named", "known beside foreign named"),
    "false": ("false names, all cases",),
    "flagged": ("foreign flagged",),
    "alarms": ("alarms, sound",),
}
RESAMPLED = 2000

Patch = tuple[Any, str, Any]


def without_column(function: Callable[..., np.ndarray], at: int) -> Callable[..., np.ndarray]:
    def zeroed(*given: Any) -> np.ndarray:
        out = function(*given)
        out[at] = 0.0
        return out

    return zeroed


def refused_but(reason: str) -> Callable[..., str]:
    whole = verdict.refused

    def some(f: Any) -> str:
        why = whole(f)
        return "" if reason in why else why

    return some


def assessed_without_choice(case: Case) -> Case:
    """Tests are held out of the fit alone, the set stays that of all tests."""
    return replace(case, figures=tuple(replace(f, held_out=f.fixed) for f in case.figures))


def not_odd(case: Case) -> Case:
    return replace(case, figures=tuple(replace(f, odd="") for f in case.figures))


def switched_off() -> dict[str, tuple[list[Patch], Callable[[Case], Case] | None]]:
    """What is patched for each rule, and how cases change."""
    figures: dict[str, tuple[list[Patch], Callable[[Case], Case] | None]] = {}
    for i, name in enumerate(EFFECT_FIGURES):
        zeroed = without_column(calibration.effect_figures, i)
        figures[f"figure of an effect: {name}"] = (
            [(m, "effect_figures", zeroed) for m in (calibration, calibrate)],
            None,
        )
    for i, name in enumerate(UNEXPLAINED_FIGURES):
        zeroed = without_column(calibration.unexplained_figures, i)
        patches = [(m, "unexplained_figures", zeroed) for m in (study_cases, calibrate)]
        figures[f"figure of the rest: {name}"] = (patches, None)
    rules = {
        "one record names nothing": "one record",
        "held-out share above zero": "held out",
        "least share": "too little",
        "own form needs a gap": "every specimen",
    }
    refusals: dict[str, tuple[list[Patch], Callable[[Case], Case] | None]] = {
        f"rule: {title}": ([(verdict, "refused", refused_but(reason))], None) for title, reason in rules.items()
    }
    refusals["rule: numbers must be plausible"] = ([], not_odd)
    refusals["rule: the choice of the set is held out too"] = ([], assessed_without_choice)
    constants: dict[str, tuple[list[Patch], Callable[[Case], Case] | None]] = {
        "LINEAR_NATS 0.5": ([(calibration, "LINEAR_NATS", 0.5)], None),
        "LINEAR_NATS 8": ([(calibration, "LINEAR_NATS", 8.0)], None),
        "LEAST_TESTS 1": ([(calibration, "LEAST_TESTS", 1)], None),
        "USUAL_GAP / 4": ([(calibration, "USUAL_GAP", 0.001)], None),
        "USUAL_GAP x 4": ([(calibration, "USUAL_GAP", 0.016)], None),
        "within 1: other effects by the whole score": ([(calibrate, "within_fit", lambda cases: 1.0)], None),
        "NAMED 0.4": ([(verdict, "NAMED", 0.4)], None),
        "NAMED 0.7": ([(verdict, "NAMED", 0.7)], None),
        "NAMED 0.8": ([(verdict, "NAMED", 0.8)], None),
    }
    return figures | refusals | constants


@contextmanager
def patched(patches: Sequence[Patch]) -> Any:
    with ExitStack() as stack:
        for where, name, value in patches:
            stack.enter_context(patch.object(where, name, value))
        yield


def scored(cases: Sequence[Case]) -> dict[str, np.ndarray]:
    """(cases,) of each sum, with constants that know nothing of a case's family; and the log loss."""
    given = calibrate.answers(cases, calibrate.held_out_in_turn(cases))
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
              f"log loss {r['log loss change']:26s} {r['seconds a case']} s")  # fmt: skip


def seconds_of(cases: Sequence[Case]) -> float:
    return float(np.mean([c.stored["cpu_s"] for c in cases]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["assessment", "search"])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if args.what == "assessment":
        cases = [c for c in read_cases(args.cases) if c.kind != "measured"]
        on, took = scored(cases), seconds_of(cases)
        rows = [row("nothing", on, on, (took, took))]
        for name, (patches, change) in switched_off().items():
            with patched(patches):
                rows.append(row(name, scored([change(c) for c in cases] if change else cases), on, (took, took)))
    else:
        rows = []
        for folder in args.cases:
            shared = {p.name for p in folder.glob("*.json")} & {p.name for p in args.cases[0].glob("*.json")}
            whole = [c for c in read_cases(args.cases[0].glob("*.json")) if c.kind != "measured"]
            constants = dict(zip((c.path for c in whole), calibrate.held_out_in_turn(whole)))
            both = []
            for x in (args.cases[0], folder):
                cases = [c for c in read_cases(x / n for n in sorted(shared)) if c.kind != "measured"]
                given = calibrate.answers(cases, [constants[c.path] for c in cases])
                each = [counts(c, a) for c, a in zip(cases, given)]
                sums = {
                    k: np.array([sum(e[w][0] for w in what if w in e) for e in each], float) for k, what in SUMS.items()
                }
                sums["log loss"] = np.array([sum(log_loss(c, a)) for c, a in zip(cases, given)])
                both.append((sums, seconds_of(cases)))
            name = f"{folder.name} ({len(shared)} cases)"
            rows.append(row(name, both[1][0], both[0][0], (both[1][1], both[0][1])))
    write(args.out, rows)
    print(json.dumps({"rows": len(rows), "written": str(args.out)}))


if __name__ == "__main__":
    main()
