"""In which ways does the discrepancy hang together between tests? Evidence of the base model on the rig, way by way.

    python analyses/discrepancy_between_tests.py --seed 777 --out runs/discrepancy_between [--workers 2]

Cases are drawn on the virtual rig: sound ones, single effects, foreign causes, both. The base model is fitted to each
beside a discrepancy that hangs together in one way only, for 37 ways: lengths of its correlation in ln f and ln A, and
the share that each test has to itself. Printed: the ways that gain most when they are offered one after the other,
beside the first (that and the five that follow are `bayes_iwan.diagnosis.fits.discrepancy_size.BETWEEN`), and by how
much a case is short of its best way. An interrupted run goes on.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.fits import evidence
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.discrepancy_size import BETWEEN
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.virtual_rig import cases as rig_cases
from runs import each

WAYS = [*product((0.4, 0.8, 3.0, 10.0), (0.25, 0.5, 2.0), (0.3, 0.1, 0.03)), (0.8, 0.5, 1.0)]
#: cases of each kind
KINDS = {"known_beside_outside": 16, "outside": 22, "none": 10, "single": 12}
OFFERED = 8


def one_case(seed: int, kind: str, index: int) -> dict[str, object]:
    """ln evidence of the base model beside a discrepancy of each way."""
    case = rig_cases.draw_case(np.random.default_rng([seed, index]), kind, laws="other")
    loops = [average(r, **LOOPS) for r in rig_cases.simulate(case)[0] if r.role != "held-out"]
    data, scales, found = gap_data(loops), scales_of(loops), []
    for way in WAYS:
        evidence.BETWEEN = (way,)
        base = fit_base(data, DiagnoseSettings(), scales, np.random.default_rng(1))
        found.append(base.log_evidence)
    return {"kind": kind, "faults": [f.name for f in case.faults], "log_evidence": found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=777)
    parser.add_argument("--cases", type=float, default=1.0, help="of the usual numbers of cases, so many times")
    parser.add_argument("--out", type=Path, default=Path("runs/discrepancy_between"))
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    jobs = [
        (args.out / f"{args.seed}_{kind}_{i:03d}.json", one_case, args.seed, kind, i)
        for kind, count in KINDS.items()
        for i in range(max(round(args.cases * count), 1))
    ]
    cases = list(each(jobs, args.workers, "cases"))
    log_z = np.array([c["log_evidence"] for c in cases])
    gained = log_z - log_z[:, [WAYS.index(BETWEEN[0])]]
    chosen = [WAYS.index(BETWEEN[0])]
    print(f"nats that the best way for each case gains over {BETWEEN[0]}: {gained.max(axis=1).sum():.0f}")
    for kind in KINDS:
        its = gained[[c["kind"] == kind for c in cases]].max(axis=1)
        print(f"  {kind}: {len(its)} cases, median {np.median(its):.0f}, most {its.max():.0f}")
    for _ in range(OFFERED):
        chosen.append(max(range(len(WAYS)), key=lambda w: float(gained[:, [*chosen, w]].max(axis=1).sum())))
        best = gained[:, chosen].max(axis=1)
        short = (gained.max(axis=1) - best).max()
        print(f"with {WAYS[chosen[-1]]}: {best.sum():.0f}; a case is short of its best way by {short:.0f} at most")


if __name__ == "__main__":
    main()
