"""Which figures tell an effect that contributes from one that absorbs: logistic laws of other figures, same cases.

    python analyses/figures_tried.py /work/cache/fits/*.json --out analyses/figures_tried.csv

Families of foreign causes are held out in turn; every law is fitted anew. `steady`: the strength is the same without
any part of the tests. `lead`: score over the best set without the effect, other effects in its place included. `fixed`:
the share on held-out tests with the set of all tests. `explained`: what the whole set explains. `generic`: what a
pattern without a cause, or a model-form effect, scores less in the effect's place.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

import calibrate_diagnosis as calibrate
from ablate_diagnosis import patched, row, scored, seconds_of, write
from bayes_iwan.diagnosis.assessment import calibration
from bayes_iwan.diagnosis.assessment.budget import NO_CAUSE
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from study_cases import read_cases

#: one figure each, larger for a cause
TRIED: dict[str, Callable[[Figures], float]] = {
    "steady": lambda f: -min(f.differs, 5.0),
    "lead": lambda f: float(np.arcsinh(f.lead / (2.0 * max(f.tests, 6)))),
    "fixed": lambda f: float(np.clip(f.fixed, -1.0, 1.0)) if f.has_held_out else f.fitted,
    "explained": lambda f: 1.0 - min(f.left, 1.0),
    "generic": lambda f: float(
        np.arcsinh(-max((v for n, v in f.alternatives.items() if n in NO_CAUSE | MODEL_FORM), default=-f.gain) / 12.0)
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    cases = [c for c in read_cases(args.cases) if c.kind != "measured"]
    shipped, names, earlier = calibration.effect_figures, calibration.EFFECT_FIGURES, calibrate.EARLIER_EFFECT
    on, took = scored(cases), seconds_of(cases)
    rows = [row("nothing: the figures of the package", on, on, (took, took))]
    for name, tell in TRIED.items():

        def more(f: Figures, tell: Callable[[Figures], float] = tell) -> np.ndarray:
            return np.append(shipped(f), tell(f))

        patches = [(m, "effect_figures", more) for m in (calibration, calibrate)]
        patches += [(calibrate, "EFFECT_FIGURES", (*names, name))]
        patches += [(calibrate, "EARLIER_EFFECT", (*earlier[:-1], 0.0, earlier[-1]))]
        with patched(patches):
            rows.append(row(f"nothing, with {name} besides", scored(cases), on, (took, took)))
    write(args.out, rows)


if __name__ == "__main__":
    main()
