"""A finished search weighed: the figures of its effects in the company of each end that it could have come to, fits and
gaps of all subsets of the chosen one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from bayes_iwan.gap.fitting.evidence import Fit, in_newtons, predicting
from bayes_iwan.gap.fitting.gap_size import GapSize, gap_size
from bayes_iwan.gap.fitting.leave_out import HELD_OUT, Unseen, left_out
from bayes_iwan.gap.fitting.residuals import residual_of
from bayes_iwan.gap.judging.budget import LEAST_SHARE, Share, along_shares, fits_of_subsets, shares, subsets
from bayes_iwan.gap.judging.guards import Figures, guard_figures, in_company
from bayes_iwan.gap.judging.taken_out import both_ways, gaps_without
from bayes_iwan.gap.searching.base import LEAST_OF_FRICTION
from bayes_iwan.gap.searching.found import OWN_FORM, Search
from bayes_iwan.threads import alongside

#: an effect that changes along the record is judged for less, if it removes this share of all that changes there: a
#: large steady gap of another cause must not hide it
LEAST_ALONG = 0.2
#: gap over the friction force below which no cause in the base's own form is named: so much every specimen differs
LEAST_GAP = 0.01

Names = frozenset[str]


@dataclass(frozen=True)
class Weighed:
    """Everything behind a verdict but the calibration's constants.

    search : its chosen effects are those that remove anything; asked : all that it chose, beside which rivals stood
    figures : of every effect of the chosen set that may be named, in the company of all ends of the search: from these
    come probabilities; alone : the same in the chosen set, as they are reported
    by every subset of it: fits; in_newtons, the same models where they miss least in newtons; predicting, the same as
    they predict tests left out; sizes, what they miss in newtons
    subharmonic : the largest power of a line at half a test's frequency over its background
    """

    search: Search
    asked: Names
    figures: tuple[Figures, ...]
    alone: tuple[Figures, ...]
    fits: Mapping[Names, Fit]
    in_newtons: Mapping[Names, Fit]
    predicting: Mapping[Names, Fit]
    sizes: Mapping[Names, GapSize]
    subharmonic: float

    @property
    def gap_N(self) -> dict[Names, float]:
        """RMS gap by set of effects."""
        return {k: s.all.rms_N for k, s in self.sizes.items()}

    def told_shares(self, names: Iterable[str]) -> dict[str, Share]:
        """Share of the gap that each of these effects is said to make: :func:`both_ways`."""
        keys = subsets(names)
        put_in = shares(names, {k: self.sizes[k] for k in keys})
        new = [k for k in keys if k not in self._left_N] if len(put_in) > 1 else []
        if new:
            base, whole = (self.in_newtons[k] for k in (frozenset[str](), frozenset(self.search.chosen)))
            self._left_N.update(gaps_without(self.search.data, base, whole, new))
        return both_ways(put_in, self._left_N)

    @cached_property
    def _left_N(self) -> dict[Names, float]:
        """What was found of :func:`gaps_without`."""
        return {}

    def along(self, names: Iterable[str]) -> dict[str, float]:
        """See :func:`removed_along`."""
        return removed_along(frozenset(names), self.fits, self.sizes)


def removed_along(kept: Names, fits: Mapping[Names, Fit], sizes: Mapping[Names, GapSize]) -> dict[str, float]:
    """Of each of these effects that changes along the record: the share that it removes of what changes there, 0 where
    that is less than anything is named for."""
    there = _changes(sizes)
    removed = along_shares(kept, {k: sizes[k].along.rms_N for k in subsets(kept)})
    evolving = {e.name for e in fits[kept].effects if e.evolving}
    return {n: v if there else 0.0 for n, v in removed.items() if n in evolving}


def _changes(sizes: Mapping[Names, GapSize]) -> bool:
    """Does the base's gap change along the record by as much as anything is named for?"""
    return sizes[frozenset()].along.share >= LEAST_OF_FRICTION


def weighed(search: Search, seed: int) -> Weighed:
    """Figures of the chosen effects that remove anything, fits and gaps of all their subsets."""
    models = _Models(search, seed)
    whole = frozenset(search.chosen)
    ends = {search.chosen if k == whole else tuple(sorted(k)): w for k, w in search.ends.items()}
    kept = {chosen: models.kept(chosen) for chosen in ends}
    judged = {frozenset(k) for names in kept.values() for k in (names, *combinations(names, max(len(names) - 1, 0)))}
    unseen = models.unseen(judged)
    weight: dict[tuple[str, ...], float] = {}
    for chosen, names in kept.items():
        weight[names] = weight.get(names, 0.0) + ends[chosen]
    all_fits = dict(search.fits) | models.fits
    figures: dict[tuple[str, ...], tuple[Figures, ...]] = {}
    for chosen, names in kept.items():
        if names not in figures:
            beside = replace(search, fits=all_fits, chosen=chosen)
            figures[names] = guard_figures(beside, models.nearest, unseen, models.shares(names), names)
    here = next(iter(kept.values()))
    alone = tuple(f for f in figures[here] if f.name not in OWN_FORM or f.gap >= LEAST_GAP)
    others = [(weight[k], f) for k, f in figures.items() if k != here]
    own = subsets(here)
    return Weighed(
        replace(search, fits=all_fits, chosen=here),
        whole,
        in_company(alone, weight[here], others),
        alone,
        {k: models.fits[k] for k in own},
        {k: models.nearest[k] for k in own},
        {k: models.predicting[k] for k in own},
        {k: models.sizes[k] for k in own},
        float(np.max(search.data.subharmonic, initial=0.0)),
    )


class _Models:
    """Fits of all subsets of some sets of effects and what they miss, each found once: ends share most of theirs."""

    def __init__(self, search: Search, seed: int) -> None:
        self.search, self.seed = search, seed
        self.fits: dict[Names, Fit] = {}
        self.nearest: dict[Names, Fit] = {}
        self.predicting: dict[Names, Fit] = {}
        self.sizes: dict[Names, GapSize] = {}

    def kept(self, chosen: tuple[str, ...]) -> tuple[str, ...]:
        """The effects of a set that remove anything; fits all its subsets."""
        data = self.search.data
        known = replace(self.search, fits=dict(self.search.fits) | self.fits, chosen=chosen)
        new = {k: f for k, f in fits_of_subsets(known).items() if k not in self.fits}
        self.fits |= new
        for size in sorted({len(k) for k in new}):  # the smaller sets first: a larger one starts where they ended, too
            level = {k: f for k, f in new.items() if len(k) == size}
            pieces = [(f, [self.nearest[k - {n}] for n in sorted(k)]) for k, f in level.items()]
            self.nearest |= zip(level, alongside(lambda p: in_newtons(data, p[0], smaller=p[1]), pieces))
        held = alongside(lambda p: predicting(data, *p), [(f, self.nearest[k]) for k, f in new.items()])
        self.predicting |= zip(new, held)
        for k in sorted(new, key=len):
            friction_N = self.sizes[frozenset()].friction_N if k else None
            self.sizes[k] = gap_size(residual_of(data, self.nearest[k]), self.seed, friction_N=friction_N)
        evolving = [e.name for e in self.fits[frozenset(chosen)].effects if e.evolving]
        return _removing(chosen, evolving, self.sizes)

    def shares(self, kept: tuple[str, ...]) -> dict[str, float]:
        """Of the gap, by effect that removes any of it."""
        return {n: s.value for n, s in shares(kept, self.sizes).items()} if kept else {}

    def unseen(self, judged: Iterable[Names]) -> tuple[Unseen, ...]:
        """What these sets and the base miss on tests left out of their fit."""
        sets = dict.fromkeys((frozenset(), *sorted(judged, key=sorted)))
        if len(sets) == 1:
            return ()
        found = left_out([self.predicting[k] for k in sets], self.search.data)
        return tuple(u for u in found if u.by != HELD_OUT)


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
