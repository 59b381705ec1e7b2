"""From a finished search to a verdict: which effects are named, how sure, and whether the rest has its own cause."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_iwan.campaign import Loop
from bayes_iwan.gap.fitting.evidence import Fit, in_newtons, predicting
from bayes_iwan.gap.fitting.gap_size import GapSize, gap_size
from bayes_iwan.gap.fitting.leave_out import HELD_OUT, Unseen, left_out
from bayes_iwan.gap.fitting.residuals import residual_of
from bayes_iwan.gap.judging.budget import (
    NAMED,
    NO_CAUSE,
    OWN_PROBABILITY,
    Cause,
    Kind,
    OneOf,
    Suspect,
    Verdict,
    along_shares,
    contributing,
    fits_of_subsets,
    left_unnamed,
    rest_without_name,
    shares,
    subsets,
    unseen_shares,
)
from bayes_iwan.gap.judging.calibration import Calibration, rest_figures
from bayes_iwan.gap.judging.guards import Figures, guard_figures
from bayes_iwan.gap.searching.base import LEAST_OF_FRICTION, gap_rms_N
from bayes_iwan.gap.searching.found import OWN_FORM, Search
from bayes_iwan.threads import alongside

#: share of the gap that an effect must remove to be named, and a cause in the base's own form, which always removes
#: some
LEAST_SHARE, LEAST_OWN_FORM = 0.02, 0.2
#: share that it must remove on tests left out, of all of them or of each one's own gap on the mean
HOLDS = 0.1
#: an effect that changes along the record is named for less, if it removes this share of all that changes there: a
#: large steady gap of another cause must not hide it
LEAST_ALONG = 0.2
#: share of a nameless gap that an effect must remove alone to be suspected, and how many are said
SUSPECT, SUSPECTS_MOST = 0.5, 6
#: gap over the friction force below which no cause in the base's own form is named: so much every specimen differs
LEAST_GAP = 0.01


@dataclass(frozen=True)
class Weighed:
    """Everything behind a verdict but the calibration's constants.

    search : its chosen effects are those that remove anything; asked : all that it chose, beside which rivals stood
    figures : of every effect of the chosen set that may be named; by every subset of it: fits; in_newtons, the same
    models where they miss least in newtons; predicting, the same as they predict tests left out; sizes, what they miss
    in newtons
    subharmonic : the largest power of a line at half a test's frequency over its background
    """

    search: Search
    asked: frozenset[str]
    figures: tuple[Figures, ...]
    fits: Mapping[frozenset[str], Fit]
    in_newtons: Mapping[frozenset[str], Fit]
    predicting: Mapping[frozenset[str], Fit]
    sizes: Mapping[frozenset[str], GapSize]
    subharmonic: float

    @property
    def gap_N(self) -> dict[frozenset[str], float]:
        """RMS gap by set of effects."""
        return {k: s.all.rms_N for k, s in self.sizes.items()}

    def along(self, names: Iterable[str]) -> dict[str, float]:
        """See :func:`removed_along`."""
        return removed_along(frozenset(names), self.fits, self.sizes)


def removed_along(
    kept: frozenset[str], fits: Mapping[frozenset[str], Fit], sizes: Mapping[frozenset[str], GapSize]
) -> dict[str, float]:
    """Of each of these effects that changes along the record: the share that it removes of what changes there, 0 where
    that is less than anything is named for."""
    there = _changes(sizes)
    removed = along_shares(kept, {k: sizes[k].along.rms_N for k in subsets(kept)})
    evolving = {e.name for e in fits[kept].effects if e.evolving}
    return {n: v if there else 0.0 for n, v in removed.items() if n in evolving}


def _changes(sizes: Mapping[frozenset[str], GapSize]) -> bool:
    """Does the base's gap change along the record by as much as anything is named for?"""
    return sizes[frozenset()].along.share >= LEAST_OF_FRICTION


def weighed(search: Search, seed: int) -> Weighed:
    """Figures of the chosen effects that remove anything, fits and gaps of all their subsets."""
    fits = fits_of_subsets(search)
    nearest = {k: in_newtons(search.data, f) for k, f in fits.items()}
    held = {k: predicting(search.data, f, nearest[k]) for k, f in fits.items()}
    before = gap_size(residual_of(search.data, nearest[frozenset()]), seed)
    sizes = {
        k: before if not k else gap_size(residual_of(search.data, f), seed, friction_N=before.friction_N)
        for k, f in nearest.items()
    }
    evolving = [e.name for e in search.fit(search.chosen).effects if e.evolving]
    kept = _removing(search.chosen, evolving, sizes)
    search = replace(search, fits=dict(search.fits) | fits)
    fits = {k: f for k, f in fits.items() if k <= frozenset(kept)}
    sizes = {k: s for k, s in sizes.items() if k in fits}
    share = {n: s.value for n, s in shares(kept, sizes).items()} if kept else {}
    along = removed_along(frozenset(kept), fits, sizes) if kept else {}
    figures = guard_figures(search, nearest, held, share, along, kept)
    said = tuple(f for f in figures if f.name not in OWN_FORM or f.gap >= LEAST_GAP)
    asked, search = frozenset(search.chosen), replace(search, chosen=kept)
    return Weighed(
        search,
        asked,
        said,
        fits,
        {k: nearest[k] for k in fits},
        {k: held[k] for k in fits},
        sizes,
        float(np.max(search.data.subharmonic, initial=0.0)),
    )


def _removing(
    chosen: Sequence[str], evolving: Sequence[str], sizes: Mapping[frozenset[str], GapSize]
) -> tuple[str, ...]:
    """The chosen effects less those that remove next to nothing of the gap, neither alone nor beside the others, nor of
    what changes along the record: what raises the evidence without that is the difference between two laws, and clouds
    what is said of the others."""
    none: frozenset[str] = frozenset()
    kept = list(chosen)

    def removes(name: str, part: str) -> float:
        """Share of the gap, or of a part of it, that an effect removes, alone or last."""
        rms = {k: float(getattr(s, part).rms_N) for k, s in sizes.items()}
        whole = frozenset(kept)
        most = max(rms[none] - rms[frozenset({name})], rms[whole - {name}] - rms[whole])
        return most / rms[none] if rms[none] > 0.0 else 0.0

    there = _changes(sizes)
    while kept:
        most = {
            n: max(
                removes(n, "all") - LEAST_SHARE,
                removes(n, "along") - LEAST_ALONG if n in evolving and there else -1.0,
            )
            for n in kept
        }
        worst = min(kept, key=lambda n: most[n])
        if most[worst] >= 0.0:
            break
        kept.remove(worst)
    return tuple(kept)


def named_by(given: Sequence[Figures], c: Calibration) -> tuple[str, ...]:
    """Effects that probably contribute: the likeliest rival of each place where probably something does, where it holds
    on tests left out."""
    out = []
    for f in given:
        among = c.among(f)
        own = c.contributes(f) * among[f.name]
        holds = max(f.by_test, f.unseen) >= min(HOLDS, f.fitted)  # both are as fitted where no other test can judge it
        if f.name not in NO_CAUSE and own >= max(NAMED * max(among.values()), OWN_PROBABILITY) and holds:
            out.append(f.name)
    return tuple(out)


def one_of(given: Sequence[Figures], named: Sequence[str], c: Calibration) -> tuple[OneOf, ...]:
    """Places that some effect of the catalogue probably fills, though none is likely enough to be named."""
    out = []
    for f in given:
        among = c.among(f)
        some = tuple(n for n in sorted(among, key=lambda n: -among[n]) if n not in NO_CAUSE and f.rivals[n] > -c.apart)
        listed = sum(v for n, v in among.items() if n not in NO_CAUSE)
        if {f.name, *some} & {*named, *NO_CAUSE} or f.name in OWN_FORM or f.fitted < least_share(f.name, f.before):
            continue
        if len(some) > 1 and (p := c.contributes(f) * listed) >= NAMED:
            out.append(OneOf(some, p, f.fitted))
    return tuple(out)


def least_share(name: str, gap: float) -> float:
    """Share of the gap that an effect must remove to be named; gap : over the friction force."""
    return max(LEAST_OWN_FORM if name in OWN_FORM else LEAST_SHARE, LEAST_OF_FRICTION / max(gap, LEAST_OF_FRICTION))


def falls_short(name: str, share: float, along: float, gap: float) -> bool:
    """Does an effect make too little of the gap to be named? along : share that it removes of what changes along the
    record, 0 for a steady effect; gap : over the friction force."""
    return share < least_share(name, gap) and (along < LEAST_ALONG or share < -LEAST_SHARE)


def helping(found: Weighed, named: Sequence[str]) -> tuple[str, ...]:
    """The named effects less those that do not make the gap smaller: evidence weighs every harmonic by its noise and
    may rise where the force in newtons is missed by more. The least helpful goes first, the rest is judged anew."""
    kept, gap = list(named), found.sizes[frozenset()].all.share
    while kept:
        share, along = shares(kept, {k: found.sizes[k] for k in subsets(kept)}), found.along(kept)
        short = [n for n in kept if falls_short(n, share[n].value, along.get(n, 0.0), gap)]
        if not short:
            break
        kept.remove(min(short, key=lambda n: share[n].value - least_share(n, gap)))
    return tuple(kept)


def unknown_rest(found: Weighed, named: Sequence[str], c: Calibration) -> float:
    """Probability that what is left beside the named effects has a cause of its own."""
    left = left_unnamed(frozenset(named), {k: s.all.resolved_share for k, s in found.sizes.items()})
    return rest_without_name(c.unknown_rest(rest_figures(left, found.subharmonic)), found.figures, c)


def verdict_of(found: Weighed, c: Calibration, held_out: Sequence[Loop] = ()) -> Verdict:
    """Name causes, give each its share of the gap, and say whether the rest needs a cause of its own."""
    named = helping(found, named_by(found.figures, c))
    rest = unknown_rest(found, named, c)
    p, places = contributing(found.figures, c)
    probabilities = {n: 0.0 for n in found.search.effects if n not in NO_CAUSE} | {
        n: v for n, v in p.items() if n not in NO_CAUSE
    }
    unnamed = np.prod([1.0 - v for n, v in places.items() if n not in NO_CAUSE])
    probabilities |= {"none": float(unnamed * (1.0 - rest)), "unknown": rest}
    causes = _causes(found, named, probabilities, c, held_out)
    flagged = rest >= 0.5
    kind = (Kind.PARTLY if flagged else Kind.EXPLAINED) if causes else (Kind.UNKNOWN if flagged else Kind.NONE)
    loops = found.search.data.loops
    cornered, theirs = tuple(x.file for x in loops if x.corners_gap), max(x.corners_gap for x in loops)
    if kind is not Kind.NONE and found.sizes[frozenset()].all.share <= theirs:
        none = probabilities["none"]
        sound = dict.fromkeys(probabilities, 0.0) | {"none": none, "drive": 1.0 - none}
        return Verdict(Kind.DRIVE, (), False, sound, cornered, theirs)
    some = one_of(found.figures, [x.name for x in causes], c) if flagged else ()
    alone = suspects(found, c) if kind is Kind.UNKNOWN and not some else ()
    return Verdict(kind, causes, flagged, probabilities, cornered, theirs, some, alone)


def suspects(found: Weighed, c: Calibration) -> tuple[Suspect, ...]:
    """What alone would remove most of the gap, as far as the search has fitted it: whoever must find the cause starts
    there, though evidence, which follows the quiet harmonics, does not speak for it."""
    search, before = found.search, found.gap_N[frozenset()]
    least = search.base.log_evidence - c.apart
    alone = [f for k, f in search.fits.items() if len(k) == 1 and not k & NO_CAUSE and f.log_evidence > least]
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
    keys = subsets(named)
    share = shares(named, {k: found.sizes[k] for k in keys})
    unseen = left_out([found.predicting[k] for k in keys], found.search.data, held_out)
    judges: tuple[Unseen, ...] = tuple(u for u in unseen if u.by == HELD_OUT) or unseen
    predicted = unseen_shares(named, judges) if judges else {}
    whole, along = found.fits[frozenset(named)], found.along(named)
    out = []
    for f in found.figures:
        if f.name not in named:
            continue
        effect = next(e for e in whole.effects if e.name == f.name)
        predicts = effect.strength_name in whole.problem.names
        apart = tuple(
            n
            for n, v in sorted(f.rivals.items(), key=lambda nv: -nv[1])
            if n != f.name and n not in NO_CAUSE and v > -c.apart
        )
        by = " and ".join(dict.fromkeys(u.by for u in judges)) if predicts else ""
        held = predicted[f.name].widened(c.law) if predicts and f.name in predicted else None
        law = str(getattr(effect, "law", ""))
        said = share[f.name].widened(c.law)
        out.append(Cause(f.name, law, probabilities[f.name], said, held, by, apart, f, along.get(f.name)))
    return tuple(sorted(out, key=lambda x: -x.share.value))
