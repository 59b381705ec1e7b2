"""Fit the constants that turn figures into probabilities; families of foreign causes are held out in turn.

    python analyses/study_draws.py --out /work/cache/draws --seed 4101
    python analyses/study_fits.py /work/cache/draws/4101_*.pickle --out /work/cache/fits
    python analyses/calibrate_diagnosis.py fit /work/cache/fits/*.json [--write]
    python analyses/calibrate_diagnosis.py score /work/cache/fits/*.json

`fit` finds the constants by maximum likelihood with a pull to those of an earlier study, scores every case with
constants fitted without its family of foreign causes (a sound or listed case: without every fifth of those), and prints
that. --write replaces the package's calibration.json. `score` counts what the shipped constants say. Both take seconds.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from bayes_iwan.diagnosis.assessment.budget import NO_CAUSE, vagueness
from bayes_iwan.diagnosis.assessment.calibration import (
    CALIBRATION,
    EFFECT_FIGURES,
    UNEXPLAINED_FIGURES,
    Calibration,
    calibration,
    effect_figures,
    unexplained_figures,
)
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from study_cases import (
    Answer,
    Case,
    answer,
    counts,
    groups,
    has_unlisted_cause,
    log_loss,
    place_is_true,
    read_cases,
    share_pairs,
    summed,
    table,
)

#: nats that one place may cost: beyond, the search missed the truth, which no power corrects
SEARCH_MISSED = 3.0
#: pull of every weight, per squared unit, to what 300 campaigns of an earlier study gave (a figure that is new: to 0)
PULL = 0.5
EARLIER_EFFECT, EARLIER_UNEXPLAINED = (0.75, 2.76, 3.35, -0.97), (1.95, 0.47, -1.30)
FOLDS = 5


def logistic_fit(x: np.ndarray, y: np.ndarray, earlier: Sequence[float]) -> tuple[tuple[float, ...], float]:
    """Weights ≥ 0 and intercept of a logistic law by maximum likelihood with a pull to earlier ones."""

    def cost(w: np.ndarray) -> float:
        t = np.clip(x @ w[:-1] + w[-1], -30, 30)
        return float(np.sum(np.logaddexp(0.0, t) - y * t) + PULL * np.sum((w - np.array(earlier)) ** 2))

    best = minimize(cost, np.array(earlier), method="L-BFGS-B", bounds=[(0.0, None)] * x.shape[1] + [(None, None)])
    return tuple(float(v) for v in best.x[:-1]), float(best.x[-1])


def within_fit(cases: Sequence[Case]) -> float:
    """Power of the score among effects for one place, from places where one of them is true."""
    places = []
    for case in cases:
        missed = case.true - {f.name for f in case.figures}
        for f in case.figures:
            right = [n for n in f.alternatives if n == f.name and n in case.true] or [
                n for n in f.alternatives if n in missed
            ]
            if len(right) == 1 and f.name not in NO_CAUSE | MODEL_FORM:
                places.append((np.array(list(f.alternatives.values())), list(f.alternatives).index(right[0])))

    def cost(power: float) -> float:
        return -sum(max(float(power * v[i] - np.logaddexp.reduce(power * v)), -SEARCH_MISSED) for v, i in places)

    grid = np.geomspace(0.02, 1.0, 40)
    return float(grid[np.argmin([cost(p) for p in grid])]) if places else calibration().within


def fitted(cases: Sequence[Case]) -> Calibration:
    """Constants of maximum likelihood: places first, then alternatives, then the rest beside what they name."""
    old = calibration()
    some = [(case, f) for case in cases for f in case.figures if f.name not in MODEL_FORM]
    x = np.array([effect_figures(f) for _, f in some]).reshape(-1, len(EFFECT_FIGURES))
    y = np.array([float(place_is_true(case, f, old.apart)) for case, f in some])
    effect, bias = logistic_fit(x, y, EARLIER_EFFECT)
    half = replace(old, effect=effect, effect_bias=bias, within=within_fit(cases))
    rows, real = [], []
    for case in cases:
        if case.kind.startswith("one_record"):
            continue
        a = answer(case, half)
        rows.append(unexplained_figures(a.left * case.gap_resolved[frozenset()], case.subharmonic))
        real.append(float(has_unlisted_cause(case, a.named)))
    rest, unexplained_bias = logistic_fit(
        np.array(rows).reshape(-1, len(UNEXPLAINED_FIGURES)), np.array(real), EARLIER_UNEXPLAINED
    )
    return replace(half, unexplained=rest, unexplained_bias=unexplained_bias)


def held_out_in_turn(cases: Sequence[Case]) -> list[Calibration]:
    """For every case constants that know nothing of its group."""
    group = [groups(case, i, FOLDS) for i, case in enumerate(cases)]
    fits = {g: fitted([c for c, other in zip(cases, group) if other != g]) for g in dict.fromkeys(group)}
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
    shares = [x for case in cases for x in share_pairs(case)]
    if shares:
        said = [(vagueness(fitted, held).share(fitted.share), true) for fitted, held, true in shares]
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
    args = parser.parse_args()
    cases = [c for c in read_cases(args.cases) if c.kind != "measured"]
    print(f"{len(cases)} cases, {summed([{c.kind: (1, 1)} for c in cases])}")
    if args.what == "score":
        given = print_score("shipped constants", cases, [calibration()] * len(cases))
    else:
        c = fitted(cases)
        print("effect:", dict(zip(EFFECT_FIGURES, np.round(c.effect, 3))), "bias", round(c.effect_bias, 3))
        print(
            "rest:",
            dict(zip(UNEXPLAINED_FIGURES, np.round(c.unexplained, 3))),
            "bias",
            round(c.unexplained_bias, 3),
            "within",
            c.within,
        )
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
