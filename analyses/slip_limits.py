"""Sound specimens whose slip forces end at a limit (Segalman's four-parameter Iwan model): what is said of them?

    python analyses/slip_limits.py --cases 24 --seed 26001

A power law φ^χ of slip forces and a share of elements that all slip at its end are no mixture of three gammas. So
"another distribution of slip forces" is right where that leaves a gap, "none" where it does not. Normal force and
stiffness are those of Table 1, or constant in every second specimen.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

import bayes_iwan as bi
from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.assessment.assessed_search import weighed
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.verdict import verdict_of
from bayes_iwan.diagnosis.diagnosis import searched
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models.paper_parameters import table_1
from bayes_iwan.threads import linear_algebra
from study_draws import records_of

#: the limit, N, and the largest amplitude in deflections at which the last element slips there
LIMIT_N, LARGEST = 3.0, (1.2, 4.0)


def specimen(rng: np.random.Generator, constant: bool) -> tuple[bi.Model, dict[str, np.ndarray], np.ndarray]:
    """A model, its values, and amplitudes in mm."""
    reference = bi.Scales(1.0, 0.063, 10.0, 1.2, 6.0, 14.0).reference
    laws = {"normal_force": "constant", "stiffness": "constant"} if constant else {}
    model, paper = bi.Model(reference, slip="power_law", **laws), table_1(reference)
    own = {"slip_max_N": LIMIT_N, "slip_chi": rng.uniform(-0.8, 0.5), "slip_end_share": rng.uniform(0.05, 0.5)}
    values = {n: np.array([own[n]]) if n in own else paper[n] for n in model.names}
    last_mm = LIMIT_N / float(paper["k1_N_mm"][0])
    return model, values, np.round(last_mm * rng.uniform(*LARGEST) * np.array([0.3, 0.6, 1.0]), 3)


def said(records: list[bi.Record]) -> tuple[str, float]:
    """The answer in a few words, and what the base misses over the friction force."""
    with linear_algebra().limit(limits=1):
        loops = [average(r, **LOOPS) for r in records]
        found = weighed(searched(gap_data(loops), DiagnoseSettings(), 0), 0)
        verdict = verdict_of(found, calibration())
    gap = found.models.sizes[frozenset()].all.resolved_share
    return " + ".join([*sorted(verdict.names), *["unknown"] * verdict.unknown_cause]) or "none", gap


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--seed", type=int, required=True)
    args = parser.parse_args()
    answers: Counter[str] = Counter()
    for i in range(args.cases):
        rng = np.random.default_rng([args.seed, i])
        model, values, amplitudes = specimen(rng, constant=i % 2 == 1)
        answer, gap = said(records_of(model, values, amplitudes, rng))
        answers[answer] += 1
        share, chi = values["slip_end_share"][0], values["slip_chi"][0]
        print(f"{i:3d}  share {share:.2f}  chi {chi:5.2f}  largest {amplitudes[-1]:.2f} mm  gap {gap:7.2%}  {answer}")
    for answer, n in answers.most_common():
        print(f"{n:3d} of {args.cases}  {answer}")


if __name__ == "__main__":
    main()
