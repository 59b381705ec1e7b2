"""Rules of the model search, each as what leaves it out: `study_fits.py --without RULE`, `ablate_diagnosis.py search`.

    python analyses/search_rules.py sample FITS/*.pickle --seed 41

prints numbers of cases drawn at random, so many of each kind (:data:`SAMPLE`), which are searched again with each rule
left out.
"""

from __future__ import annotations

import argparse
import pickle
from pathlib import Path
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
    return Refit(one.problem, one.starts, one.starts[:0])


def first_singles(found: FittedSets) -> None:
    """The SINGLE_MOST most promising alone, whatever they promise."""
    names = list(dict.fromkeys(x.name for x in found.offered(found.base)))[: model_search.SINGLE_MOST]
    found.add([x for x in found.offered(found.base) if x.name in names], found.base)


def once_without(found: FittedSets, fit: Fit, name: str) -> Fit:
    known = found.fits.get(fit.names - {name})
    return known if known is not None else _without(found, fit, name)


def never_sound(found: FittedSets) -> bool:
    return False


_without = FittedSets.without
NONE: frozenset[str] = frozenset()

RULES: dict[str, list[Patch]] = {
    "nothing": [],
    "newtons of a candidate": [(candidates, "sound_gap_N", lambda data: np.inf)],
    "a step of the effect's own parameters": [(candidates, "stepped_on", lambda rows, point, *_: (point, np.inf))],
    "starts from other sets, and from the prior": [(FittedSets, "_start", one_start)],
    "newtons of a candidate, starts from other sets": [
        (candidates, "sound_gap_N", lambda data: np.inf),
        (FittedSets, "_start", one_start),
    ],
    "base fitted again": [(model_search, "fit_base_again", lambda found: False)],
    "exchanging": [(model_search, "ROUNDS", 0)],
    "a second round of exchanging": [(model_search, "ROUNDS", 1)],
    "a smaller set fitted again from each larger one": [(FittedSets, "without", once_without)],
    "singles beyond the seven most promising": [(model_search, "fit_singles", first_singles)],
    "what is flexible last": [(x, "LAST", NONE) for x in (fitted_sets, model_search)],
    "a sound gap ends the search": [(model_search, "as_sound", never_sound)],
    "two of each size grow": [(model_search, "BEAM", 1)],
    "four are tried with each": [(model_search, "BRANCH", 2)],
    "two laws of an effect": [(candidates, "LAWS_MOST", 1)],
    "two starts of an effect": [(candidates, "EFFECT_STARTS", 1)],
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
