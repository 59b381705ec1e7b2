"""Cases of a study (`study_draws.py`, `study_fits.py`) and how an answer to them is scored."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan import former_names
from bayes_iwan.diagnosis.assessment import verdict
from bayes_iwan.diagnosis.assessment.budget import NO_CAUSE, Gaps, gaps_of
from bayes_iwan.diagnosis.assessment.calibration import (
    Calibration,
    SetProbabilities,
    set_probabilities,
)
from bayes_iwan.diagnosis.assessment.indicators import Figures, chosen_share, three_sets
from bayes_iwan.diagnosis.constants import LEAST_OF_FRICTION, USUAL_GAP
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM, any_alike
from bayes_iwan.effects import catalogue
from bayes_iwan.virtual_rig.faults import OUTSIDE
from bayes_iwan.withheld.true_gaps import by_set

FIGURES = tuple(f.name for f in fields(Figures))
#: laws by effect, for which of them look alike
EFFECTS: Mapping[str, Any] = catalogue.variants() | {e.name: (e,) for e in catalogue.UNLISTED}


@dataclass(frozen=True)
class Case:
    """A case as `study_fits.py` keeps it."""

    path: str
    kind: str
    family: str
    tests: int
    effects: tuple[dict[str, Any], ...]
    noise: float
    figures: tuple[Figures, ...]
    gap_resolved: Mapping[frozenset[str], float]
    stored: Mapping[str, Any] = field(repr=False)

    @property
    def sets(self) -> SetProbabilities:
        """Probability of every set that the search fitted."""
        return set_probabilities(by_set(self.stored["scores"]), self.tests)

    @property
    def true(self) -> frozenset[str]:
        return frozenset(e["name"] for e in self.effects)

    @property
    def visible(self) -> frozenset[str]:
        """Effects whose part that no parameter imitates is larger than noise and a sound specimen's usual gap; none
        where the base leaves no gap (bursts of noise are the records' own scatter)."""
        if self.gap_resolved[frozenset()] < LEAST_OF_FRICTION:
            return frozenset()
        least = max(self.noise, USUAL_GAP)
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
    return [c for c in (case_of(json.loads(p.read_text())) for p in kept) if c.kind != "measured"]


def case_of(stored: Mapping[str, Any]) -> Case:
    """A case as it was stored, shares on held-out tests by the present rule where the tests' powers were kept."""
    truth = stored["truth"]
    some: list[dict[str, Any]] = [
        {k: float("nan") if v is None else v for k, v in f.items() if k in FIGURES}
        for f in ({former_names.FIGURES.get(k, k): v for k, v in f.items()} for f in stored["figures"])
    ]
    figures = [Figures(**f) for f in some]
    return Case(
        path=stored["path"],
        kind=stored["kind"],
        family=stored["family"],
        tests=stored["tests"],
        effects=tuple(truth["effects"]),
        noise=float(truth.get("noise", {}).get("share_of_friction", 0.0)),
        figures=tuple(
            replace(f, held_out=held_out_share(stored, f)) if f.has_held_out and "held_out" in stored else f
            for f in figures
        ),
        gap_resolved=by_set(stored["gap_resolved"]),
        stored=stored,
    )


def held_out_share(stored: Mapping[str, Any], f: Figures, kept: Callable[[frozenset[str]], bool] = bool) -> float:
    """What an effect removes on held-out tests by the package's present rule; kept : compared sets besides the base and
    those of the three gaps that count (others do not)."""
    names = frozenset(stored["chosen"])
    always = three_sets(names)
    shares = []
    for u in stored["held_out"]:
        power_N2, scores = (
            {k: np.array(v) for k, v in by_set(u[what]).items() if k in always or kept(k)}
            for what in ("power_N2", "trained")
        )
        shares.append(chosen_share(power_N2, scores, partial(any_alike, EFFECTS, f.name)))
    return float(np.nanmean(shares))


@dataclass(frozen=True)
class Answer:
    """What is said of a case: named effects (of the base's form not counted), what they are tied with or one of,
    the probability of every effect, and that of an unknown cause."""

    named: frozenset[str]
    together: frozenset[str]
    probabilities: Mapping[str, float]
    unknown: float
    left: float

    @property
    def flagged(self) -> bool:
        return self.unknown >= 0.5


def answer(case: Case, c: Calibration) -> Answer:
    """What constants say of a case, by the package's own rules."""
    sets = case.sets
    named = verdict.named_by(case.figures, sets)
    p = verdict.contributing(case.figures, sets)
    left = case.gap_resolved[frozenset(named) | verdict.usual_form(case.figures)]
    unknown = verdict.unknown_cause_probability(c.unknown_cause(left), case.figures, sets)
    tied = {n for f in case.figures if f.name in named for n in verdict.candidates_of(f, c)}
    tied |= {n for some in verdict.one_of(case.figures, named, sets, c) for n in some.names}
    return Answer(
        frozenset(named) - MODEL_FORM,
        frozenset(tied),
        {n: v for n, v in p.items() if n not in NO_CAUSE | MODEL_FORM},
        unknown,
        left / max(case.gap_resolved[frozenset()], 1e-12),
    )


#: of a case and its answer, what is counted: name -> how many right of how many
Counts = Mapping[str, tuple[float, float]]


def counts(case: Case, a: Answer) -> Counts:
    """What a case adds to each figure of the score; all but the first group are better when larger."""
    out: dict[str, tuple[float, float]] = {}
    listed, foreign, one = case.visible - case.foreign, case.visible & case.foreign, case.kind.startswith("one_record")
    false = bool(a.named - case.true)
    out["false names, all cases"] = (false, 1)
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


def share_pairs(case: Case) -> list[tuple[Gaps, Gaps, float]]:
    """Of each true effect of the best set: its gaps on the fitted tests and on held-out tests, and its true share."""
    names = frozenset(case.stored["chosen"])
    keys = [frozenset(), names, *(names - {n} for n in names), *(frozenset({n}) for n in names)]
    some = [by_set(u["power_N2"]) for u in case.stored.get("held_out", case.stored.get("unseen", ()))]
    if not names or not some or any(k not in x for k in keys for x in some):
        return []
    found = gaps_of(names, {k: np.concatenate([np.array(x[k]) for x in some]) for k in keys})
    gap_N = by_set(case.stored["gap_N"])
    fitted = gaps_of(names, {k: np.array([gap_N[k] ** 2]) for k in keys})
    assessed = {f.name for f in case.figures if f.has_held_out}
    true = {e["name"]: float(e["share"]) for e in case.effects}
    return [(fitted[n], found[n], true[n]) for n in sorted(names & case.true & assessed - MODEL_FORM)]


def has_unlisted_cause(case: Case, named: frozenset[str]) -> bool:
    """Is something visible there that is not named?"""
    return bool(case.visible - named)


def groups(case: Case, index: int, folds: int) -> str:
    """What is held out together with a case: all foreign causes of its family, else every so many cases."""
    return case.family if case.foreign else f"{index % folds}"
