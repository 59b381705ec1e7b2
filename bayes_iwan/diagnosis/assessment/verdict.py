"""From a weighed search to a verdict: which effects are named, how sure, and whether the unexplained part has its own
cause."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from bayes_iwan.campaign import Loop
from bayes_iwan.diagnosis.assessment.assessed_search import Weighed
from bayes_iwan.diagnosis.assessment.budget import (
    NO_CAUSE,
    Cause,
    Gaps,
    Kind,
    OneOf,
    Suspect,
    Verdict,
    gaps_of,
    least_share,
    subsets,
    vagueness,
)
from bayes_iwan.diagnosis.assessment.calibration import Calibration, SetProbabilities, any_of
from bayes_iwan.diagnosis.assessment.indicators import Figures, three_sets
from bayes_iwan.diagnosis.constants import (
    LINE_STANDS,
    NOT_REPEATING,
    PROBABLE,
    REFUSED,
    SHOWN_BY_RECORD,
    SUREST,
    SUSPECT,
    SUSPECTS_MOST,
)
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.held_out_tests import HELD_OUT, HeldOut, held_out_gaps
from bayes_iwan.diagnosis.search.base_fit import gap_rms_N
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from bayes_iwan.threads import alongside

MAINS = "mains_interference"


def refused(f: Figures) -> str:
    """Why an effect is not named, however probable: "" where nothing speaks against it."""
    if f.name in NO_CAUSE:
        return "it stands for no cause"
    if f.tests < 2 and f.name not in SHOWN_BY_RECORD:
        return "one record tells no cause"
    if f.has_held_out and f.held_out <= 0.0:
        return "on held-out tests it removes nothing"
    if f.removes < least_share(f.name, f.before):
        return "it removes too little"
    return f.odd


def beside_unlisted(p: float, unlisted: float) -> float:
    """The probability p of an effect among those that are listed, where with probability `unlisted` there is a cause
    that is not: what is not sure of the effect may be due to that one as well, so p (1 − unlisted (1 − p))."""
    return p * (1.0 - unlisted * (1.0 - p))


def unlisted_probability(found: Weighed, c: Calibration) -> float:
    """Probability that what the best set of all leaves has a cause of its own."""
    best = frozenset(found.search.chosen)
    found.models.find([best])
    by_size = c.unknown_cause(found.models.sizes[best].all.resolved_share)
    return unknown_cause_probability(by_size, found.figures, found.sets)


def named_by(given: Sequence[Figures], sets: SetProbabilities, unlisted: float = 0.0) -> tuple[str, ...]:
    """Effects of the best set that probably contribute."""
    p = contributing(given, sets, unlisted)
    return tuple(f.name for f in given if not refused(f) and p.get(f.name, 0.0) >= PROBABLE)


def large_enough(found: Weighed, names: tuple[str, ...]) -> tuple[str, ...]:
    """Those of the named effects that remove as much as one must without the others of the best set, too."""
    found.models.find(subsets(names))
    sizes = found.models.sizes
    gaps = gaps_of(names, {k: sizes[k].power_N2 for k in subsets(names)})
    least = {f.name: least_share(f.name, f.before) for f in found.figures}
    some = tuple(n for n in names if gaps[n].share >= least[n])
    return some if some == names else large_enough(found, some)


def candidates_of(f: Figures, c: Calibration) -> tuple[str, ...]:
    """An effect and what else could be in its place, the likeliest first."""
    there = {n: v for n, v in f.alternatives.items() if n not in NO_CAUSE and v > -c.apart}
    return tuple(sorted(there, key=lambda n: -there[n]))


def one_of(
    given: Sequence[Figures], named: Sequence[str], sets: SetProbabilities, c: Calibration, unlisted: float = 0.0
) -> tuple[OneOf, ...]:
    """Places that some cause probably fills, one of the catalogue's effects or of the base's form, though none is
    likely enough to be named (:func:`beside_unlisted`)."""
    out: list[OneOf] = []
    for f in given:
        some = candidates_of(f, c)
        if {f.name, *some} & {*named, *NO_CAUSE} or MODEL_FORM >= {*some} or f.removes < least_share(f.name, f.before):
            continue
        if any({*some} == {*x.names} for x in out):
            continue
        p = beside_unlisted(any_of(sets, some), unlisted)
        if len(some) > 1 and p >= PROBABLE and not (f.has_held_out and f.held_out <= 0.0):
            out.append(OneOf(some, p, f.fitted, f.along))
    return tuple(out)


def contributing(given: Sequence[Figures], sets: SetProbabilities, unlisted: float = 0.0) -> dict[str, float]:
    """Probability that each effect contributes (:func:`beside_unlisted`); at most REFUSED where something speaks
    against it, or where the best set lacks it."""
    free = {f.name for f in given if f.name in NO_CAUSE or not refused(f)}
    every = {n: beside_unlisted(any_of(sets, {n}), unlisted) for n in frozenset().union(*sets)}
    return {n: p if n in free else min(p, REFUSED) for n, p in every.items()}


def unknown_cause_probability(by_size: float, given: Iterable[Figures], sets: SetProbabilities) -> float:
    """Probability that the unexplained part has a cause of its own: by its size
    (:meth:`Calibration.unknown_cause`), or because a pattern is there that no listed cause makes and that removes as
    much as a named cause must."""
    none = 1.0 - by_size
    for f in given:
        if f.name in NO_CAUSE and f.removes >= least_share(f.name, f.before):
            none *= 1.0 - any_of(sets, {f.name})
    return min(1.0 - none, SUREST)


def cycles_differ(data: GapData, named: Collection[str]) -> bool:
    """Do cycles differ as no law that repeats makes them, every second one or from one to the next? Averaged loops do
    not hold that, so it speaks against no effect that explains them. Mains interference makes it, too."""
    if MAINS in named:
        return False
    return bool(data.subharmonic.max() > LINE_STANDS or data.not_repeating > NOT_REPEATING)


def resembled(given: Iterable[Figures]) -> Figures | None:
    """The pattern without a cause that fits best; none that removes too little, or nothing on held-out tests."""
    some = [f for f in given if f.name in NO_CAUSE and not f.held_out <= 0.0]
    some = [f for f in some if f.removes >= least_share(f.name, f.before)]
    return max(some, key=lambda f: f.gain, default=None)


def verdict_of(found: Weighed, c: Calibration, held_out: Sequence[Loop] = ()) -> Verdict:
    """Name causes, give each its share of the gap, and say whether the unexplained part needs a cause of its own."""
    unlisted = unlisted_probability(found, c)
    named = large_enough(found, named_by(found.figures, found.sets, unlisted))
    p = contributing(found.figures, found.sets, unlisted)
    probabilities = {n: p.get(n, 0.0) for n in found.search.effects if n not in NO_CAUSE}
    causes = _causes(found, named, probabilities, c, held_out)
    by_size = c.unknown_cause(found.models.sizes[frozenset(named)].all.resolved_share)
    unknown = unknown_cause_probability(by_size, found.figures, found.sets)
    differ = cycles_differ(found.search.data, named)
    unknown = SUREST if differ else unknown
    free = {n for f in found.figures if not refused(f) for n in candidates_of(f, c)}
    listed = beside_unlisted(any_of(found.sets, free), unlisted)
    probabilities |= {"none": (1.0 - listed) * (1.0 - unknown), "unknown": unknown}
    flagged = unknown >= PROBABLE
    kind = (Kind.PARTLY if flagged else Kind.EXPLAINED) if causes else (Kind.UNKNOWN if flagged else Kind.NONE)
    loops = found.search.data.loops
    cornered, theirs = tuple(x.file for x in loops if x.corners_gap), max(x.corners_gap for x in loops)
    if kind is not Kind.NONE and not differ and found.models.sizes[frozenset()].all.share <= theirs:
        none = probabilities["none"]
        sound = dict.fromkeys(probabilities, 0.0) | {"none": none, "drive": 1.0 - none}
        return Verdict(Kind.DRIVE, (), False, sound, cornered, theirs)
    left, before = (found.models.sizes[k].all for k in (frozenset(named), frozenset[str]()))
    sought = flagged and before.resolved_share > 0.0  # else there is nothing that one of them could explain
    some = one_of(found.figures, named, found.sets, c, unlisted) if sought else ()
    alone = suspects(found, named, c) if sought and not some and left.rms_N > SUSPECT * before.rms_N else ()
    return Verdict(kind, causes, flagged, probabilities, cornered, theirs, some, alone)


def suspects(found: Weighed, named: Sequence[str], c: Calibration) -> tuple[Suspect, ...]:
    """What alone would remove most of the gap and is not named, as far as the search has fitted it: whoever must find
    the cause starts there, though evidence, which follows the quiet harmonics, does not speak for it."""
    search, before = found.search, found.models.sizes[frozenset()].all.rms_N
    least = search.base.log_evidence - c.apart
    out = NO_CAUSE | frozenset(named)
    alone = [f for k, f in search.fits.items() if len(k) == 1 and not k & out and f.log_evidence > least]
    removed = {
        f.name: 1.0 - gap_N / before for f, gap_N in zip(alone, alongside(partial(gap_rms_N, search.data), alone))
    }
    most = sorted((n for n, share in removed.items() if share >= SUSPECT), key=lambda n: -removed[n])
    return tuple(Suspect(n, removed[n]) for n in most[:SUSPECTS_MOST])


def _causes(
    found: Weighed, named: Sequence[str], probabilities: Mapping[str, float], c: Calibration, held_out: Sequence[Loop]
) -> tuple[Cause, ...]:
    if not named:
        return ()
    whole, models = frozenset(named), found.models
    keys = three_sets(whole)
    parts = held_out_gaps(models.predict(keys), found.search.data, held_out)
    counted: tuple[HeldOut, ...] = tuple(u for u in parts if u.by == HELD_OUT) or parts
    fitted = gaps_of(named, {k: models.sizes[k].power_N2 for k in keys})
    predicted = _predicted(named, counted, keys)
    in_turn = _predicted(named, tuple(u for u in parts if u.by != HELD_OUT), keys)
    fit = models.fits[whole]
    before_along = models.sizes[frozenset()].along.rms_N
    out = []
    for f in found.figures:
        if f.name not in named:
            continue
        effect = next(e for e in fit.effects if e.name == f.name)
        single = effect.strength_name in fit.problem.names  # else its numbers belong to single records
        on_fitted, on_held_out = fitted[f.name], predicted.get(f.name) if single else None
        vague = vagueness(on_fitted, in_turn.get(f.name) if single else None)
        along_N = [models.sizes[k].along.rms_N for k in (whole - {f.name}, whole)]
        along = (along_N[0] - along_N[1]) / before_along if effect.evolving and before_along > 0.0 else None
        out.append(
            Cause(
                name=f.name,
                law=str(getattr(effect, "law", "")),
                probability=probabilities[f.name],
                share=vague.share(on_fitted.share),
                vague=vague,
                held_out=None if on_held_out is None else on_held_out.measured,
                held_out_by=" and ".join(dict.fromkeys(u.by for u in counted)) if on_held_out else "",
                tied_with=tuple(n for n in candidates_of(f, c) if n not in named),
                figures=f,
                gaps=on_held_out or on_fitted,
                along=along,
            )
        )
    return tuple(sorted(out, key=lambda x: -x.share.value))


def _predicted(named: Sequence[str], parts: Sequence[HeldOut], keys: Sequence[frozenset[str]]) -> dict[str, Gaps]:
    """The three gaps of each effect on held-out tests; nothing where there are none."""
    if not parts:
        return {}
    return gaps_of(named, {k: np.concatenate([u.power_N2[k] for u in parts]) for k in keys})
