"""Rules of the model search, each as what leaves it out: `study_fits.py --without RULE`, `ablate_diagnosis.py search`.

    python analyses/search_rules.py sample FITS/*.pickle --seed 41

prints numbers of cases drawn at random, so many of each kind (:data:`SAMPLE`), which are searched again with each rule
left out.
"""

from __future__ import annotations

import argparse
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.search import candidates, fitted_sets, model_search
from bayes_iwan.diagnosis.search.candidates import Candidate
from bayes_iwan.diagnosis.search.fitted_sets import FittedSets
from bayes_iwan.diagnosis.search.refits import Refit

#: cases of each kind that are searched again
SAMPLE = {"single": 10, "pair": 9, "triple": 4, "outside": 8, "known_beside_outside": 7, "none": 2}

Patch = tuple[Any, str, Any]


def one_start(found: FittedSets, one: Candidate, smaller: Fit, instead_of: Fit | None) -> Refit:
    return Refit(one.problem, one.starts)


def first_singles(found: FittedSets) -> None:
    """The SINGLE_MOST most promising alone, whatever they promise."""
    found.add(found.offered(found.base)[: model_search.SINGLE_MOST], found.base)


def once_without(found: FittedSets, fit: Fit, name: str) -> Fit:
    known = found.fits.get(fit.names - {name})
    return known if known is not None else _without(found, fit, name)


_without = FittedSets.without
NONE: frozenset[str] = frozenset()
STEADY = SimpleNamespace(along=SimpleNamespace(rms_N=0.0))

RULES: dict[str, list[Patch]] = {
    "nothing": [],
    "newtons of a candidate": [(candidates, "sound_gap_N", lambda data: np.inf)],
    "a step of the effect's own parameters": [(candidates, "stepped_on", lambda rows, point, *_: (point, np.inf))],
    "starts from other sets, and from the prior": [(FittedSets, "_start", one_start)],
    "newtons of a candidate, starts from other sets": [
        (candidates, "sound_gap_N", lambda data: np.inf),
        (FittedSets, "_start", one_start),
    ],
    "a smaller set, the base too, fitted again from larger ones": [(FittedSets, "without", once_without)],
    "exchanging": [(model_search, "settle", lambda found, current: current)],
    "singles beyond the seven most promising": [(model_search, "fit_singles", first_singles)],
    "all that acts along a record that changes": [(model_search, "gap_of", lambda data, fit: STEADY)],
    "a sound gap ends the search": [(model_search, "as_sound", lambda found: False)],
    "what is flexible last": [(x, "LAST", NONE) for x in (fitted_sets, model_search)],
    "two of each size grow": [(model_search, "BEAM", 1)],
    "four are tried with each": [(model_search, "BRANCH", 2)],
}


def sample(paths: list[Path], seed: int) -> list[str]:
    """Stems of the cases to search again."""
    rng = np.random.default_rng(seed)
    kinds = {p.stem: pickle.loads(p.read_bytes()).kind for p in sorted(paths)}
    out = []
    for kind, n in SAMPLE.items():
        out += rng.choice([s for s, k in kinds.items() if k == kind], n, replace=False).tolist()
    return sorted(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["sample"])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--seed", type=int, default=41)
    args = parser.parse_args()
    print(*sample(args.cases, args.seed), sep="\n")


if __name__ == "__main__":
    main()
