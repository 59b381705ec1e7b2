"""How sure the diagnosis is of what is true, and how often a name is false the more it names.

    python analyses/risk_coverage.py FITS/*.pickle --out analyses/pictures/risk_coverage.svg

FITS are cases of `study_fits.py`. Every case is answered with constants that know nothing of its family of causes
(`calibrate_diagnosis.py`), or --shipped with the package's, on cases that these were not fitted to. Printed: the mean
probability on true effects, and false names by kind of case, strictly
counted: an effect that is not in the campaign, whatever it resembles. Drawn: for every threshold of the probability
the share of visible true effects that are named (coverage) against the share of names that are false (risk).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import calibrate_diagnosis as calibrate
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.verdict import contributing, refused, unlisted_probability
from bayes_iwan.diagnosis.constants import PROBABLE
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from study_cases import HALVES, Answer, Case, counts, read_cases, summed


def could_be_named(case: Case) -> list[tuple[float, bool]]:
    """Probability of every effect that nothing speaks against, and whether it is true."""
    found = case.found
    p = contributing(found.figures, found.sets, unlisted_probability(found, calibration()))
    some = [f for f in found.figures if not refused(f) and f.name not in MODEL_FORM]
    return [(p[f.name], f.name in case.true) for f in some]


def curve(cases: Sequence[Case]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) thresholds, falling; share of visible true effects named and share of names false at each."""
    every = sorted((x for case in cases for x in could_be_named(case)), reverse=True)
    p, true = (np.array(x, float) for x in zip(*every))
    visible = sum(len(case.visible - case.foreign) for case in cases)
    return p, np.cumsum(true) / visible, np.cumsum(1.0 - true) / np.arange(1, len(p) + 1)


def on_true(cases: Sequence[Case], answers: Sequence[Answer]) -> np.ndarray:
    """Probability of every visible true effect of the catalogue, 0 where none is stated."""
    return np.array(
        [a.probabilities.get(n, 0.0) for case, a in zip(cases, answers) for n in sorted(case.visible - case.foreign)]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--half", choices=HALVES, default="all")
    parser.add_argument("--shipped", action="store_true", help="answer with the shipped constants")
    args = parser.parse_args()
    cases = read_cases(args.cases, args.half)
    constants = [calibration()] * len(cases) if args.shipped else calibrate.held_out_in_turn(cases)
    answers = calibrate.answers(cases, constants)
    several = [(c, a) for c, a in zip(cases, answers) if not c.kind.startswith("one_record")]
    for title, some in (("all", list(zip(cases, answers))), ("more than one test", several)):
        p = on_true(*zip(*some))
        print(f"mean probability on {len(p)} visible true effects, {title}: {100 * p.mean():.1f} %")
    print("false names, strictly counted:")
    for kind in dict.fromkeys(c.kind for c in cases):
        false, of = summed([counts(c, a) for c, a in zip(cases, answers) if c.kind == kind])["false names, all cases"]
        print(f"  {kind:24s} {false:.0f} of {of:.0f}")
    p, coverage, risk = curve(cases)
    for at in (0.9, 0.8, 0.65, PROBABLE, 0.3):
        n = int(np.sum(p >= at))
        named, false = 100 * coverage[n - 1], 100 * risk[n - 1]
        print(f"named from {at:.2f}: {named:.0f} % of true effects, {false:.0f} % of {n} names false")
    figure, ax = plt.subplots(figsize=(5.2, 3.4), layout="constrained")
    ax.step(100 * coverage, 100 * risk, where="post")
    n = int(np.sum(p >= PROBABLE))
    ax.plot(100 * coverage[n - 1], 100 * risk[n - 1], "o", label=f"named from {PROBABLE:g}, as shipped")
    ax.set(xlabel="visible true effects that are named (%)", ylabel="names that are false (%)", ylim=(0, None))
    ax.legend()
    figure.savefig(args.out, metadata={"Date": None} if args.out.suffix == ".svg" else None)


if __name__ == "__main__":
    main()
