"""Search and weigh the campaigns of a study and keep what a verdict is made from: one pickle a case.

    python analyses/study_fits.py /work/cache/draws/4101_*.pickle --out /work/cache/fits [--workers 2]
    python analyses/study_fits.py ../shared/data/mr_damper_off ... --out /work/cache/fits

A case is a pickle of `study_draws.py`, or the folder of a campaign (whose truth nobody knows). --without RULE searches
without a rule of `search_rules.py`, for `ablate_diagnosis.py`; --shuffle SEED takes the cases in random order, so that
those done are a fair sample wherever it stops.
"""

from __future__ import annotations

import argparse
import pickle
import random
import time
from pathlib import Path

from bayes_iwan.campaign import average, read_campaign
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS, loops_of
from bayes_iwan.diagnosis.assessment.assessed_search import weighed
from bayes_iwan.diagnosis.diagnosis import searched
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.executors import Failure, finished
from bayes_iwan.files import write_whole
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.threads import linear_algebra
from search_rules import RULES
from study_cases import Case


def fitted(rule: str, path: str) -> bytes:
    """One case, searched and weighed without a rule, pickled."""
    for where, name, value in RULES[rule]:
        setattr(where, name, value)
    if Path(path).is_dir():
        loops = [x for x in loops_of(read_campaign(path)) if x.role != "held-out"]
        drawn = {"kind": "measured", "family": Path(path).name, "truth": {"effects": []}}
    else:
        drawn = pickle.loads(Path(path).read_bytes())
        loops = [average(r, **LOOPS) for r in drawn["records"]]
    began = time.process_time()
    with linear_algebra().limit(limits=1):
        found = weighed(searched(gap_data(loops), DiagnoseSettings(), 0), 0)
    seconds = time.process_time() - began
    return pickle.dumps(Case(path, drawn["kind"], drawn["family"], drawn["truth"], found, seconds))


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
    pieces = {str(args.out / f"{p.stem}.pickle"): str(p) for p in args.cases}
    left = {k: v for k, v in pieces.items() if not Path(k).is_file()}
    for path, result in finished(left, fitted, args.without, workers=args.workers, what="fits", unit="case"):
        if isinstance(result, Failure):
            print(f"{path}: {result}", flush=True)
        else:
            write_whole(path, result)


if __name__ == "__main__":
    main()
