"""Search and weigh the campaigns of a study and keep what the assessment needs: one JSON a case.

    python analyses/study_fits.py /work/cache/draws/4101_*.pickle --out /work/cache/fits [--workers 2]
    python analyses/study_fits.py ../shared/data/mr_damper_off ... --out /work/cache/fits

A case is a pickle of `study_draws.py`, or the folder of a campaign (whose truth nobody knows). --without RULE searches
without a rule of `search_rules.py`, for `ablate_diagnosis.py`; --shuffle SEED takes the cases in random order, so that
those done are a fair sample wherever it stops.
"""

from __future__ import annotations

import argparse
import json
import pickle
import random
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.campaign import average, read_campaign
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.assessment.assessed_search import weighed
from bayes_iwan.diagnosis.assessment.indicators import ranked_by_training
from bayes_iwan.diagnosis.diagnosis import searched
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from bayes_iwan.executors import Failure, finished
from bayes_iwan.files import finite, write_whole
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.threads import linear_algebra
from search_rules import RULES


def named(names: frozenset[str]) -> str:
    """As JSON holds a set."""
    return "+".join(sorted(names))


def fitted(rule: str, path: str) -> dict[str, Any]:
    """One case: searched and weighed, without a rule."""
    for where, name, value in RULES[rule]:
        setattr(where, name, value)
    if Path(path).is_dir():
        loops = [x for x in read_campaign(path).loops(**LOOPS) if x.role != "held-out"]
        case = {
            "kind": "measured",
            "foreign": None,
            "family": Path(path).name,
            "truth": {"kind": "measured", "effects": []},
        }
    else:
        case = pickle.loads(Path(path).read_bytes())
        loops = [average(r, **LOOPS) for r in case.pop("records")]
    began = time.process_time()
    with linear_algebra().limit(limits=1):
        data = gap_data(loops)
        search = searched(data, DiagnoseSettings(), 0)
        took = time.process_time() - began
        found = weighed(search, 0)
    took_all = time.process_time() - began
    whole = frozenset(search.chosen)
    beside = (whole & MODEL_FORM, *(frozenset(some) | (whole & MODEL_FORM) for some in ([n] for n in search.chosen)))
    subsets = {whole, *beside, *found.models.sizes}
    for k in range(2 ** len(whole)):
        subsets.add(frozenset(n for i, n in enumerate(sorted(whole)) if k >> i & 1))
    found.models.find(subsets)
    base = search.base
    return case | {
        "path": path,
        "tests": data.tests,
        "chosen": list(search.chosen),
        "figures": [asdict(f) for f in found.figures],
        "scores": {named(k): v for k, v in search.scores.items()},
        "evidence": {named(k): f.log_evidence for k, f in search.fits.items()},
        "gap_N": {named(k): s.all.rms_N for k, s in found.models.sizes.items()},
        "gap_share": {named(k): s.all.share for k, s in found.models.sizes.items()},
        "gap_resolved": {named(k): s.all.resolved_share for k, s in found.models.sizes.items()},
        "along_N": {named(k): s.along.rms_N for k, s in found.models.sizes.items()},
        "noise_N": found.models.sizes[frozenset()].all.noise_N,
        "held_out": [
            {
                "by": u.by,
                "power_N2": {named(k): v.tolist() for k, v in u.power_N2.items()},
                "trained": {named(k): v.tolist() for k, v in ranked_by_training(search, u).items()},
            }
            for u in found.held_out
        ],
        "base_z": dict(zip(base.problem.names, base.z.tolist())),
        "whole_z": dict(zip(search.fit(whole).problem.names, search.fit(whole).z.tolist())),
        "subharmonic": found.subharmonic,
        "fits": len(search.fits),
        "search_s": took,
        "cpu_s": took_all,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--without", choices=list(RULES), default="nothing", metavar="RULE")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--shuffle", type=int, metavar="SEED")
    args = parser.parse_args()
    if args.shuffle is not None:
        args.cases.sort()
        random.Random(args.shuffle).shuffle(args.cases)
    args.out.mkdir(parents=True, exist_ok=True)
    pieces = {str(args.out / f"{p.stem}.json"): str(p) for p in args.cases}
    left = {k: v for k, v in pieces.items() if not Path(k).is_file()}
    for path, result in finished(left, fitted, args.without, workers=args.workers, what="fits", unit="case"):
        if isinstance(result, Failure):
            print(f"{path}: {result}", flush=True)
        else:
            write_whole(path, json.dumps(finite(result), default=np.ndarray.tolist))


if __name__ == "__main__":
    main()
