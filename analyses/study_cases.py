"""Cases of a study (`study_draws.py`, `study_fits.py`) and how an answer to them is scored."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.diagnosis.assessment.assessed_search import Weighed, assessed
from bayes_iwan.diagnosis.assessment.budget import NO_CAUSE
from bayes_iwan.diagnosis.assessment.calibration import Calibration
from bayes_iwan.diagnosis.assessment.verdict import verdict_of
from bayes_iwan.diagnosis.constants import LEAST_OF_FRICTION, USUAL_GAP
from bayes_iwan.diagnosis.fits.gap_size import Share
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from bayes_iwan.threads import linear_algebra
from bayes_iwan.virtual_rig.faults import OUTSIDE


@dataclass(frozen=True)
class Case:
    """A case as `study_fits.py` keeps it; seconds : of the processor, to search and weigh it."""

    path: str
    kind: str
    family: str
    truth: Mapping[str, Any]
    found: Weighed = field(repr=False)
    seconds: float

    def assessed(self) -> Case:
        """The case by the package's present rules of assessment, its fits as they were kept."""
        with linear_algebra().limit(limits=1):
            return replace(self, found=assessed(self.found.search, self.found.models, self.found.held_out))

    @property
    def gap(self) -> float:
        """What the base model misses, beyond noise, over the friction force."""
        return self.found.models.sizes[frozenset()].all.resolved_share

    @property
    def effects(self) -> Sequence[Mapping[str, Any]]:
        return tuple(self.truth["effects"])

    @property
    def true(self) -> frozenset[str]:
        return frozenset(e["name"] for e in self.effects)

    @property
    def visible(self) -> frozenset[str]:
        """Effects whose part that no parameter imitates is larger than noise and a sound specimen's usual gap; none
        where the base leaves no gap (bursts of noise are the records' own scatter)."""
        if self.gap < LEAST_OF_FRICTION:
            return frozenset()
        least = max(self.truth.get("noise", {}).get("share_of_friction", 0.0), USUAL_GAP)
        return frozenset(e["name"] for e in self.effects if e["size"] * e["visible_share"] > least)

    @property
    def foreign(self) -> frozenset[str]:
        return self.true & frozenset(OUTSIDE)

    @property
    def sound(self) -> bool:
        return self.kind in ("none", "own_model")


#: halves of a study: constants are fitted and rules chosen on the even cases, the odd ones show what that is worth
HALVES = {"even": (0,), "odd": (1,), "all": (0, 1)}


def read_cases(paths: Iterable[Path], half: str = "all") -> list[Case]:
    """Cases of a study, measured campaigns left out; half : those with an even or an odd number alone."""
    kept = [p for p in sorted(paths) if half == "all" or int(p.stem.split("_")[-1]) % 2 in HALVES[half]]
    return [c.assessed() for c in (pickle.loads(p.read_bytes()) for p in kept) if c.kind != "measured"]


@dataclass(frozen=True)
class Answer:
    """What is said of a case: named effects (of the base's form not counted), what they are tied with or one of,
    the probability of every effect, that of an unknown cause, the size of the unexplained part over the friction force,
    the share of each named effect, and named ones that neither are there nor tied with one that is."""

    named: frozenset[str]
    together: frozenset[str]
    probabilities: Mapping[str, float]
    unknown: float
    left: float
    shares: Mapping[str, Share] = field(default_factory=dict)
    astray: frozenset[str] = frozenset()

    @property
    def flagged(self) -> bool:
        return self.unknown >= 0.5


def answer(case: Case, c: Calibration) -> Answer:
    """What the package says of a case, with these constants; effects that no fitted set has, of which it says 0, left
    out."""
    with linear_algebra().limit(limits=1):
        v = verdict_of(case.found, c)
    said = {n for x in v.causes for n in (x.name, *x.tied_with)} | {n for x in v.one_of for n in x.names}
    astray = {x.name for x in v.causes if not {x.name, *x.tied_with} & case.true}
    tried = frozenset().union(*case.found.sets) - NO_CAUSE - MODEL_FORM
    return Answer(
        frozenset(v.names) - MODEL_FORM,
        frozenset(said),
        {n: p for n, p in v.probabilities.items() if n in tried},
        v.probabilities["unknown"],
        case.found.models.sizes[frozenset(v.names)].all.resolved_share,
        {x.name: x.share for x in v.causes},
        frozenset(astray) - MODEL_FORM,
    )


#: of a case and its answer, what is counted: name -> how many right of how many
Counts = Mapping[str, tuple[float, float]]


def counts(case: Case, a: Answer) -> Counts:
    """What a case adds to each figure of the score; all but the first group are better when larger."""
    out: dict[str, tuple[float, float]] = {}
    listed, foreign, one = case.visible - case.foreign, case.visible & case.foreign, case.kind.startswith("one_record")
    false = bool(a.named - case.true)
    out["false names, all cases"] = (false, 1)
    out["the same, tied with no true one"] = (bool(a.astray), 1)
    if case.kind == "outside":
        out["false names, foreign alone"] = (false, 1)
    if case.sound:
        out["alarms, sound"] = (bool(a.named) or a.flagged, 1)
        out["names, sound"] = (bool(a.named), 1)
    if one:
        out["false names, one record"] = (false, 1)
    if case.kind == "single" and listed:
        out["singles named"] = (case.true <= a.named, 1)
        out["singles named or in a set"] = (case.true <= a.named | a.together, 1)
    if case.kind in ("pair", "triple") and listed:
        out["effects of pairs and triples named"] = (len(listed & a.named), len(listed))
        out["the same, or in a set"] = (len(listed & (a.named | a.together)), len(listed))
    if case.kind == "known_beside_outside" and listed:
        out["known beside foreign named"] = (len(listed & a.named), len(listed))
    if foreign and not one:
        out["foreign flagged"] = (a.flagged, 1)
    return out


def log_loss(case: Case, a: Answer) -> list[float]:
    """Of each effect with a probability, and each true one without."""
    right = [p if n in case.true else 1.0 - p for n, p in a.probabilities.items()]
    return [-float(np.log(max(p, 0.01))) for p in right] + [
        4.6 for n in case.visible - case.foreign if n not in a.probabilities
    ]


def summed(some: Sequence[Counts]) -> dict[str, tuple[float, float]]:
    keys = dict.fromkeys(k for x in some for k in x)
    return {k: (sum(x[k][0] for x in some if k in x), sum(x[k][1] for x in some if k in x)) for k in keys}


def table(some: Sequence[Counts]) -> list[str]:
    return [
        f"  {k:40s} {right:4.0f} of {of:4.0f}  {100 * right / of:5.1f} %" for k, (right, of) in summed(some).items()
    ]


def share_pairs(case: Case, a: Answer) -> list[tuple[Share, float]]:
    """The share of each true effect that is named, as said and as it is."""
    return [(a.shares[e["name"]], float(e["share"])) for e in case.effects if e["name"] in a.named]


def has_unlisted_cause(case: Case, named: frozenset[str]) -> bool:
    """Is something visible there that is not named?"""
    return bool(case.visible - named)


def groups(case: Case, index: int, folds: int) -> str:
    """What is held out together with a case: all foreign causes of its family, else every so many cases."""
    return case.family if case.foreign else f"{index % folds}"
