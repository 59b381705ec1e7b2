"""What tells an effect that contributes from one that merely absorbs: a few figures for each effect of the chosen set.

A flexible rest and a wrong law together invite effects that absorb what is not theirs. So evidence alone names nothing:
the shrink on whole frequencies and amplitudes left out, the constancy of the effect's strength between halves of the
tests, and its lead over effects of another kind speak with it (:mod:`bayes_iwan.gap.judging.calibration` weighs them).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_iwan.effects.base import Effect
from bayes_iwan.gap.fitting.data import GapData
from bayes_iwan.gap.fitting.evidence import Fit
from bayes_iwan.gap.fitting.gap_size import moved_shares
from bayes_iwan.gap.fitting.leave_out import Unseen, halves, refitted
from bayes_iwan.gap.searching.base import WORTH_NATS, changes, gap_parts_N, newton_nats
from bayes_iwan.gap.searching.ends import SPREAD
from bayes_iwan.gap.searching.found import LAST, Search, look_alike
from bayes_iwan.gap.searching.search import TIED_NATS
from bayes_iwan.threads import alongside

#: strengths on two halves of the tests that differ by so many prior standard deviations are still called the same:
#: nature's law is not quite the catalogue's
LOOSE = 0.2
#: a rival beside which an effect still gains this share of its nats, and WORTH_NATS, does not stand in for it: both act
COMPANION = 0.5
#: share of what an effect removes that counts as removed on tests left out where none can be: by cases of one record
#: each (`calibrate_diagnosis.py unjudged`)
UNJUDGED = 0.3
#: nats that a rival may be behind for each share of the base's gap that it leaves more: evidence counts every harmonic
#: by its noise, and between two laws that are both a little off it counts differences that no newton bears out
NATS_OF_GAP = 600.0


@dataclass(frozen=True)
class Figures:
    """One effect of the chosen set.

    gain : nats over the set without it; lead : nats over the best effect of another kind in its place (no look-alike)
    rivals : ln evidence of each effect in its place, itself included, less its own, as far as the gap bears it out, or
        the part of it that changes along the record where that is what the effect acts on
    fitted : share of the whole gap that it removes (Shapley value in the chosen set), on the fitted tests; unseen :
        share of the gap without it that it removes on tests left out (the mean over frequencies and amplitudes; the
        fitted one where no test can judge it)
    by_test : the mean over tests left out of the share of each one's gap that it removes, or of the part that changes
        along the record where that is what it acts on; UNJUDGED of what it removes of the fitted tests where the others
        do not tell its strength (where no test can judge it: the share that it removes of what all others leave of that
        part)
    differs : by how many standard deviations its strength differs between halves of the tests (larger split)
    moved : RMS force that it moves over the friction force; gap : RMS gap without it over the friction force, before :
        the base's own
    tests : how many were fitted
    judged : could any test be left out? Else `unseen` and `by_test` are only what was fitted
    """

    name: str
    gain: float
    lead: float
    rivals: dict[str, float]
    fitted: float
    unseen: float
    by_test: float
    differs: float
    moved: float
    gap: float
    before: float
    tests: int
    judged: bool = True


def guard_figures(
    search: Search,
    nearest: Mapping[frozenset[str], Fit],
    unseen: Sequence[Unseen],
    share: Mapping[str, float],
    judged: Iterable[str],
) -> tuple[Figures, ...]:
    """The figures of every effect of the chosen set that is judged.

    nearest : by subset of those, the fit that misses least in newtons; unseen : what they miss on tests left out;
    share : of the gap, by effect (:func:`.budget.shares`)
    """
    judged = tuple(judged)
    if not judged:
        return ()
    data, whole = search.data, search.fit(judged)
    without = {n: search.fit(set(judged) - {n}) for n in judged}
    sets = dict.fromkeys((whole.names, *(f.names for f in without.values()), frozenset()))
    differs = _differences(whole, data)
    moved = moved_shares(whole, data)
    level = float(np.sqrt(np.mean(data.level_N**2)))
    parts_of = partial(gap_parts_N, data)
    parts = dict(zip(sets, alongside(parts_of, [nearest[k] for k in sets])))
    before, before_along = parts[frozenset()]
    out = []
    asked = search.fit(search.chosen)  # rivals were sought beside all that was chosen
    asked_N, asked_along = parts_of(asked)  # as its rivals' is found: not from where its subsets end, too
    for name in judged:
        effect = next(e for e in whole.effects if e.name == name)
        acts_along = effect.evolving and changes(data, before_along)
        less, others = without[name], search.fit(asked.names - {name})
        there = {n: f for n, f in search.rivals(name).items() if not companion(search, asked, others, f, n)}
        rivals = {
            n: borne_out(
                f.log_evidence - asked.log_evidence + newton_nats(data, gap_N) - newton_nats(data, asked_N),
                max(
                    (gap_N - asked_N) / before if before > 0.0 else np.inf,
                    (along_N - asked_along) / before_along if acts_along else 0.0,
                ),
                n in LAST or look_alike(search.effects, name, n),
            )
            for (n, f), (gap_N, along_N) in zip(there.items(), alongside(parts_of, [*there.values()]))
        }
        others_nats = [v for n, v in rivals.items() if not look_alike(search.effects, name, n)]
        fitted = float(np.clip(share[name], -1.0, 1.0))
        left_along, kept_along = parts[less.names][1], parts[whole.names][1]
        acted = max(fitted, 1.0 - kept_along / left_along) if acts_along and left_along > 0.0 else fitted
        gain = whole.log_evidence - less.log_evidence
        predicts = bool(unseen) and effect.strength_name in whole.problem.names
        last = less.names, whole.names
        out.append(
            Figures(
                name,
                gain,
                min(gain, -max(others_nats, default=-np.inf)),
                rivals,
                fitted,
                _mean([u.shrink(*last) for u in unseen], fitted) if predicts else fitted,
                _mean([_by_test(u, *last, effect, acted) for u in unseen], acted) if predicts else acted,
                differs.get(name, 0.0),
                moved[name],
                parts[less.names][0] / level,
                before / level,
                data.tests,
                bool(unseen),
            )
        )
    return tuple(out)


def in_company(
    chosen: Sequence[Figures], weight: float, others: Sequence[tuple[float, Sequence[Figures]]]
) -> tuple[Figures, ...]:
    """The chosen set's figures, each the mean over the company in which its effect could be: other ends of the search
    with their weights, nothing of it where it is not in them. An end has it too where it could stand in the place of
    another as well."""
    if not others:
        return tuple(chosen)
    out = []
    for f in chosen:
        places = [(w, _place(f.name, figures)) for w, figures in others]
        there = [(weight, f), *((w, g) for w, g in places if g is not None)]
        present = sum(w for w, _ in there)
        whole = present + sum(w for w, g in places if g is None)
        gain, lead, fitted, unseen, by_test = (
            sum(w * getattr(g, figure) for w, g in there) / whole
            for figure in ("gain", "lead", "fitted", "unseen", "by_test")
        )
        differs = sum(w * g.differs for w, g in there) / present  # a strength that is not there is not steady
        out.append(replace(f, gain=gain, lead=lead, fitted=fitted, unseen=unseen, by_test=by_test, differs=differs))
    return tuple(out)


def _place(name: str, figures: Sequence[Figures]) -> Figures | None:
    """The place that an effect fills among others, or could fill as well as what does."""
    could = [f for f in figures if f.rivals.get(name, -np.inf) > -SPREAD]
    return max(could, key=lambda f: (f.name == name, f.rivals[name]), default=None)


def companion(search: Search, whole: Fit, less: Fit, rival: Fit, name: str) -> bool:
    """Does the effect that is judged gain nats beside this rival, too? Then the rival does not take its place. Of two
    that look alike nature seldom has both: what one gains beside the other is the difference between two laws."""
    both = search.fits.get(whole.names | {name})
    (judged,) = whole.names - less.names
    if both is None or look_alike(search.effects, judged, name):
        return False
    gain, beside = whole.log_evidence - less.log_evidence, both.log_evidence - rival.log_evidence
    return beside > max(COMPANION * gain, WORTH_NATS)


def borne_out(nats: float, more: float, alike: bool) -> float:
    """Nats by which a rival is ahead or behind (negative): no more behind than NATS_OF_GAP for the share that it leaves
    more of the gap; a look-alike, or what bends the base's own form, that is ahead by less than TIED_NATS is tied,
    since the search took the one that commits itself most."""
    if nats >= 0.0:
        return 0.0 if alike and nats < TIED_NATS else nats
    return max(nats, -NATS_OF_GAP * max(more, 0.0))


def _by_test(unseen: Unseen, less: frozenset[str], whole: frozenset[str], effect: Effect, acted: float) -> float:
    """Mean over the tests left out of what an effect removes there, UNJUDGED of what it removes of the fitted ones
    where the others do not tell its strength."""
    found = unseen.by_test(less, whole, along=effect.evolving)
    return float(np.mean(np.where(unseen.tells(whole, effect.name), found, UNJUDGED * acted)))


def _mean(values: Sequence[float], otherwise: float) -> float:
    """Over what was left out; parameters of single tests (a mains line) no other test can judge."""
    finite = [x for x in values if np.isfinite(x)]
    return float(np.mean(finite)) if finite else otherwise


def _differences(whole: Fit, data: GapData) -> dict[str, float]:
    """By how many standard deviations each strength differs between halves of the tests, the largest of the splits."""
    out: dict[str, float] = {}
    for split in halves(data):
        parts = [refitted(whole, data.part(sorted(part))) for part in split]
        for effect in whole.effects:
            name = effect.strength_name
            if name not in whole.problem.names:
                continue
            at = [f.problem.names.index(name) for f in parts]
            z = [float(f.z[i]) for f, i in zip(parts, at)]
            variance = sum(float(f.covariance[i, i]) for f, i in zip(parts, at)) + LOOSE**2
            out[effect.name] = max(out.get(effect.name, 0.0), abs(z[0] - z[1]) / float(np.sqrt(variance)))
    return out
