"""Fit the constants of the unexplained part and score a study; families of foreign causes are held out in turn.

    python analyses/study_draws.py --out /work/cache/draws --seed 4101
    python analyses/study_fits.py /work/cache/draws/4101_*.pickle --out /work/cache/fits
    python analyses/calibrate_diagnosis.py fit /work/cache/fits/*.pickle [--write]
    python analyses/calibrate_diagnosis.py score /work/cache/fits/*.pickle

`fit` finds the constants by maximum likelihood with a pull to those of an earlier study, scores every case with
constants fitted without its family of foreign causes (a sound or listed case: without every fifth of those), and prints
that. --write replaces the package's calibration.json. `score` counts what the shipped constants say. Both take half a
minute for 100 cases.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from bayes_iwan.diagnosis.assessment.calibration import CALIBRATION, Calibration, calibration, ln_size
from study_cases import (
    HALVES,
    Answer,
    Case,
    answer,
    counts,
    groups,
    has_unlisted_cause,
    log_loss,
    read_cases,
    share_pairs,
    summed,
    table,
)

#: pull of slope and intercept, per squared unit, to what 300 campaigns of an earlier study gave
PULL, EARLIER = 0.5, (1.95, -1.30)
FOLDS = 5


def fitted(cases: Sequence[Case], given: Sequence[Answer]) -> Calibration:
    """Constants of maximum likelihood, with a pull to earlier ones, of the unexplained part beside what is named."""
    some = [(case, a) for case, a in zip(cases, given) if not case.kind.startswith("one_record")]
    x = np.array([ln_size(a.left) for _, a in some])
    y = np.array([has_unlisted_cause(case, a.named) for case, a in some], float)

    def cost(w: np.ndarray) -> float:
        t = np.clip(w[0] * x + w[1], -30, 30)
        return float(np.sum(np.logaddexp(0.0, t) - y * t) + PULL * np.sum((w - np.array(EARLIER)) ** 2))

    slope, intercept = minimize(cost, np.array(EARLIER), method="L-BFGS-B").x
    return replace(calibration(), unexplained=float(slope), unexplained_bias=float(intercept))


def held_out_in_turn(cases: Sequence[Case]) -> list[Calibration]:
    """For every case constants that know nothing of its group."""
    group = [groups(case, i, FOLDS) for i, case in enumerate(cases)]
    pairs = list(zip(cases, answers(cases, [calibration()] * len(cases))))
    fits = {g: fitted(*zip(*[x for x, other in zip(pairs, group) if other != g])) for g in dict.fromkeys(group)}
    return [fits[g] for g in group]


def answers(cases: Sequence[Case], constants: Sequence[Calibration]) -> list[Answer]:
    return [answer(case, c) for case, c in zip(cases, constants)]


def print_score(title: str, cases: Sequence[Case], constants: Sequence[Calibration]) -> list[Answer]:
    given = answers(cases, constants)
    print(title)
    print(*table([counts(case, a) for case, a in zip(cases, given)]), sep="\n")
    losses = [x for case, a in zip(cases, given) for x in log_loss(case, a)]
    print(f"  mean log loss of an effect {np.mean(losses):.3f}")
    stated = np.array([p for a in given for p in a.probabilities.values()])
    right = np.array([n in case.true for case, a in zip(cases, given) for n in a.probabilities], float)
    bins = np.digitize(stated, [0.1, 0.3, 0.5, 0.7, 0.9])
    for k in np.unique(bins):
        at = bins == k
        print(f"  stated {stated[at].mean():.2f}: found {right[at].mean():.2f} ({int(right[at].sum())} of {at.sum()})")
    said = [x for case, a in zip(cases, given) for x in share_pairs(case, a)]
    if said:
        held = sum(s.low <= true <= s.high for s, true in said)
        print(f"  true share in the 90 % interval: {held} of {len(said)}; ", end="")
        print(f"median width of the interval {100 * np.median([s.high - s.low for s, _ in said]):.0f} points")
    return given


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["fit", "score"])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--each", action="store_true", help="one line a case")
    parser.add_argument("--half", choices=HALVES, default="all")
    args = parser.parse_args()
    cases = read_cases(args.cases, args.half)
    print(f"{len(cases)} cases, {summed([{c.kind: (1, 1)} for c in cases])}")
    if args.what == "score":
        given = print_score("shipped constants", cases, [calibration()] * len(cases))
    else:
        c = fitted(cases, answers(cases, [calibration()] * len(cases)))
        print(f"slope {c.unexplained:.3f}, intercept {c.unexplained_bias:.3f}")
        print_score("in sample", cases, [c] * len(cases))
        given = print_score("families held out in turn", cases, held_out_in_turn(cases))
        if args.write:
            c.save()
            print(f"written: {CALIBRATION}")
    if args.each:
        for case, a in zip(cases, given):
            said = ", ".join(f"{n} {a.probabilities[n]:.2f}" for n in sorted(a.named)) or "-"
            there = (
                ", ".join(f"{n}{'' if n in case.visible else ' (hardly visible)'}" for n in sorted(case.true)) or "-"
            )
            print(f"{Path(case.path).stem} {case.kind:20s} {there:60s} -> {said}  unknown {a.unknown:.2f}")


if __name__ == "__main__":
    main()
