"""From a finished search to a verdict: which effects are named, how sure, and whether the rest has its own cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from bayes_iwan.campaign import Loop
from bayes_iwan.gap.fitting.leave_out import HELD_OUT, Unseen, left_out
from bayes_iwan.gap.judging.budget import (
    NAMED,
    NO_CAUSE,
    OWN_PROBABILITY,
    Cause,
    Kind,
    OneOf,
    Suspect,
    Verdict,
    contributing,
    least_share,
    left_unnamed,
    rest_without_name,
    shares,
    subsets,
    unseen_shares,
)
from bayes_iwan.gap.judging.calibration import Calibration, rest_figures
from bayes_iwan.gap.judging.guards import Figures
from bayes_iwan.gap.judging.weighing import LEAST_ALONG, Weighed
from bayes_iwan.gap.searching.base import gap_rms_N
from bayes_iwan.gap.searching.found import OWN_FORM
from bayes_iwan.threads import alongside

#: an effect that acts on what changes along the record may leave the whole gap larger by this share of it: how near the
#: least gap two fits come differs by as much
SPREAD_OF_GAP = 0.1
#: share of a gap, most of which has no name, that an effect must remove alone to be suspected, and how many are said
SUSPECT, SUSPECTS_MOST = 0.5, 6


def named_by(given: Sequence[Figures], c: Calibration) -> tuple[str, ...]:
    """Effects that probably contribute: the likeliest rival of each place where probably something does."""
    out = []
    for f in given:
        among = c.among(f)
        own = c.contributes(f) * among[f.name]
        if f.name not in NO_CAUSE and own >= max(NAMED * max(among.values()), OWN_PROBABILITY):
            out.append(f.name)
    return tuple(out)


def one_of(given: Sequence[Figures], named: Sequence[str], c: Calibration) -> tuple[OneOf, ...]:
    """Places that some cause probably fills, one of the catalogue's effects or of the base's own form, though none is
    likely enough to be named."""
    out = []
    for f in given:
        among = c.among(f)
        some = tuple(n for n in sorted(among, key=lambda n: -among[n]) if n not in NO_CAUSE and f.rivals[n] > -c.apart)
        if {f.name, *some} & {*named, *NO_CAUSE} or OWN_FORM >= {*some} or f.fitted < least_share(f.name, f.before):
            continue
        cause = sum(v for n, v in among.items() if n not in NO_CAUSE)
        if len(some) > 1 and (p := c.contributes(f) * cause) >= NAMED:
            out.append(OneOf(some, p, f.fitted))
    return tuple(out)


def falls_short(name: str, share: float, along: float, gap: float) -> bool:
    """Does an effect make too little of the gap to be named? along : share that it removes of what changes along the
    record, 0 for a steady effect; gap : over the friction force."""
    return share < least_share(name, gap) and (along < LEAST_ALONG or share < -SPREAD_OF_GAP)


def helping(
    names: Iterable[str], made: Callable[[Sequence[str]], tuple[Mapping[str, float], Mapping[str, float]]], gap: float
) -> tuple[str, ...]:
    """These effects less those that do not make the gap smaller: evidence weighs every harmonic by its noise and may
    rise where the force in newtons is missed by more. The least helpful goes first, the rest is judged anew.

    made : of a set of effects, the share of the gap that each removes, and of what changes along the record, by those
    that act there; gap : over the friction force
    """
    kept = list(names)
    while kept:
        share, along = made(kept)
        short = [n for n in kept if falls_short(n, share[n], along.get(n, 0.0), gap)]
        if not short:
            break
        kept.remove(min(short, key=lambda n: share[n] - least_share(n, gap)))
    return tuple(kept)


def made_by(found: Weighed, names: Sequence[str]) -> tuple[Mapping[str, float], Mapping[str, float]]:
    """What each of these effects removes, as :func:`helping` asks: put in, or as it is told where that is less."""
    put_in, told = shares(names, {k: found.sizes[k] for k in subsets(names)}), found.told_shares(names)
    return {n: min(put_in[n].value, told[n].value) for n in names}, found.along(names)


def helpful(found: Weighed, c: Calibration) -> tuple[str, ...]:
    """What is named, but for what does not make the gap smaller."""
    return helping(named_by(found.figures, c), partial(made_by, found), found.sizes[frozenset()].all.share)


def unknown_rest(found: Weighed, named: Sequence[str], c: Calibration) -> float:
    """Probability that what is left beside the named effects has a cause of its own."""
    left = left_unnamed(frozenset(named), {k: s.all.resolved_share for k, s in found.sizes.items()})
    return rest_without_name(c.unknown_rest(rest_figures(left, found.subharmonic)), found.figures, c)


def verdict_of(found: Weighed, c: Calibration, held_out: Sequence[Loop] = ()) -> Verdict:
    """Name causes, give each its share of the gap, and say whether the rest needs a cause of its own."""
    named = helpful(found, c)
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
    left = found.gap_N[frozenset(x.name for x in causes)] / max(found.gap_N[frozenset()], 1e-300)
    alone = suspects(found, [x.name for x in causes], c) if flagged and not some and left > SUSPECT else ()
    return Verdict(kind, causes, flagged, probabilities, cornered, theirs, some, alone)


def suspects(found: Weighed, named: Sequence[str], c: Calibration) -> tuple[Suspect, ...]:
    """What alone would remove most of the gap and is not named, as far as the search has fitted it: whoever must find
    the cause starts there, though evidence, which follows the quiet harmonics, does not speak for it."""
    search, before = found.search, found.gap_N[frozenset()]
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
    keys = subsets(named)
    share = found.told_shares(named)
    unseen = left_out([found.predicting[k] for k in keys], found.search.data, held_out)
    judges: tuple[Unseen, ...] = tuple(u for u in unseen if u.by == HELD_OUT) or unseen
    predicted = unseen_shares(named, judges) if judges else {}
    whole, along = found.fits[frozenset(named)], found.along(named)
    out = []
    for f in found.alone:
        if f.name not in named:
            continue
        effect = next(e for e in whole.effects if e.name == f.name)
        predicts = effect.strength_name in whole.problem.names
        apart = tuple(
            n
            for n, v in sorted(f.rivals.items(), key=lambda nv: -nv[1])
            if n != f.name and n not in NO_CAUSE and v > -c.apart
        )
        off = c.law_sd(share[f.name].value)
        held = predicted[f.name].widened(off) if predicts and f.name in predicted else None
        by = " and ".join(dict.fromkeys(u.by for u in judges)) if held is not None else ""
        law = str(getattr(effect, "law", ""))
        said = share[f.name].widened(off)
        out.append(Cause(f.name, law, probabilities[f.name], said, held, by, apart, f, along.get(f.name)))
    return tuple(sorted(out, key=lambda x: -x.share.value))
