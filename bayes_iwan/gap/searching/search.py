"""Which set of effects, together with the base model, explains the data best: refits from several starts, grown effect
by effect, with exchanges and drops.

A missed optimum of the base is the commonest false gap, so the base starts from many points and again from the
optima of the best extended models.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import Maker
from bayes_iwan.gap.fitting.data import GapData
from bayes_iwan.gap.fitting.evidence import Fit
from bayes_iwan.gap.searching.base import WORTH_NATS, changes, missed, sound_gap_N
from bayes_iwan.gap.searching.candidates import Candidate
from bayes_iwan.gap.searching.ends import ends_of
from bayes_iwan.gap.searching.explored import Explored, Report, silent
from bayes_iwan.gap.searching.found import LAST, Search, look_alike, part
from bayes_iwan.inference.setup.scales import Scales
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.physics import Simulator

#: single effects are refitted if they are among so many most promising ones or promise PROMISE nats, or are sudden
SINGLE_MOST = 7
#: a further effect is refitted if one Gauss–Newton step promises so many nats, and at most so many are
PROMISE, FURTHER_MOST = 3.0, 4
#: where this share of a gap is change along the record, all that acts there is refitted: one step of a fade that
#: recovers leads nowhere, though it may be the whole cause
CHANGING = 0.3
#: an effect is taken in if it gains WORTH_NATS, and dropped again below half of that; so many, where newtons alone
#: speak for it and not the evidence, and in between for evidence in between
NEWTONS_ALONE = 12.0
#: and so many, or this share of the base's gap, where one that looks alike is in the set: nature seldom has both
BESIDE_ALIKE, ALIKE_SHARE = 25.0, 0.1
#: rivals refitted in the place of each effect of the chosen set
RIVALS_MOST = 3
#: and only those whose first step promises this share of what the effect itself gains there
RIVAL_SHARE = 0.3
#: but this many over the number of tests whatever it promises: where so few tests tell little, an optimum lies far from
#: where one step leads, and a refit costs little
RIVALS_ASKED = 8
#: look-alikes that differ by no more are tied
TIED_NATS = 5.0
#: rounds in which a better rival takes its place, and in which the set grows again after that
EXCHANGES_MOST, ASKED_MOST = 2, 2
#: effects in a set, at most; those of LAST beside them are not counted
MOST_EFFECTS = 4
#: an effect is dropped if the gap without it is larger by at most this share of the base's gap, though alone it would
#: remove ALONE of it: the others of the set stand in for it, and nats beyond that are the difference between two laws,
#: up to BESIDE_ALIKE of them
STOOD_IN, ALONE = 0.05, 0.2


def latitude(effect: Effect) -> tuple[bool, int]:
    """How much else an effect could have explained as well: may its strength have either sign, and how many numbers
    does it have? Where two explain the same, the one that ran the greater risk of not doing so is the likelier. A
    channel's delay, say, may go either way, and half of all delays would have been of the other channel; a low-pass of
    the force only makes it late."""
    return effect.signed, len(effect.parameters)


def outdone(removes: float, cheap: bool, opposed: bool) -> bool:
    """Is one of two effects that look alike not needed? removes : of the base's gap, beside the others; cheap : it
    gains less than BESIDE_ALIKE nats there; opposed : alone it would make the gap larger."""
    if cheap:
        return removes < ALIKE_SHARE * (2.0 if opposed else 1.0)
    return opposed and removes < STOOD_IN


class _Explorer(Explored):
    """The steps that find more."""

    def singles(self) -> None:
        """Every single effect that promises anything."""
        base = self.fits[frozenset()]
        ranked: dict[str, int] = {}
        chosen, offered = [], self.offered(base)
        changing = self.changing(base)
        for one in offered:
            rank = ranked.setdefault(one.name, len(ranked))
            asked = one.effect.sudden or (changing and one.effect.evolving)
            if rank < SINGLE_MOST or one.gain > PROMISE or asked:
                chosen.append(one)
        self.add(chosen, base)

    def base_again(self) -> bool:
        """The base from its part of the best extended optima: had it missed its optimum?"""
        base = self.fits[frozenset()]
        leaders = sorted((f for f in self.fits.values() if f.effects), key=lambda f: -f.log_evidence)[:4]
        starts = [part(f, base.problem) for f in leaders]
        before = base.log_evidence
        better = self.keep(base.problem, np.array([base.z, *starts]), 40)
        return better is not None and better.log_evidence > before + 1.0

    def changing(self, fit: Fit) -> bool:
        """Is much of what a fit leaves change along the record, and more than a sound specimen's gap?"""
        gap_N, along_N = self.gap_parts_N([fit])[0]
        return along_N > max(CHANGING * gap_N, sound_gap_N(self.data))

    def grow(self, current: Fit, last: bool = False) -> Fit | None:
        """The best fit with one effect more, of LAST or of all others, if it is worth it."""
        if current.effects or last:
            chosen = []
            offered = [x for x in self.offered(current, last) if self.needed(current.names | {x.name})]
            changing = not last and self.changing(current)
            for i, one in enumerate(offered):
                alone = self.fits.get(frozenset({one.name}))
                helps = alone is not None and alone.log_evidence > self.fits[frozenset()].log_evidence + PROMISE
                asked = (one.effect.sudden and helps) or (changing and one.effect.evolving)
                if (i < FURTHER_MOST and one.worth > PROMISE) or asked:
                    chosen.append(one)
            self.add(chosen, current)
        larger = [
            f
            for k, f in self.fits.items()
            if current.names < k
            and len(k) == len(current.names) + 1
            and bool(k - current.names <= LAST) == last
            and self.needed(k)
        ]
        if not larger:
            return None
        best = self.plainest(current.names, larger)
        self.worths([best, current])
        evidence = best.log_evidence - current.log_evidence
        least = float(np.interp(evidence, (0.0, WORTH_NATS), (NEWTONS_ALONE, WORTH_NATS)))
        return best if self.worth(best) > self.worth(current) + least else None

    def plainest(self, shared: frozenset[str], fits: Sequence[Fit]) -> Fit:
        """The best of fits with one effect beside those shared; among look-alikes that are all but tied, in newtons
        too, the one that commits itself most (:func:`latitude`), of those the one that the catalogue lists first."""
        near = self.within_reach(fits)
        self.worths(near)
        best = max(near, key=self.worth)
        (name,) = best.names - shared
        tied = [
            f
            for f in near
            if self.worth(f) > self.worth(best) - TIED_NATS
            and look_alike(self.effects, name, next(iter(f.names - shared)))
        ]
        if len(tied) > 1:
            most = self.gap_N(best) + ALIKE_SHARE * self.gap_N(self.fits[frozenset()])
            tied = [f for f in tied if f is best or self.gap_N(f) <= most]
        listed = list(self.effects)

        def order(fit: Fit) -> tuple[bool, int, int]:
            (effect,) = (e for e in fit.effects if e.name not in shared)
            return *latitude(effect), listed.index(effect.name)

        return min(tied, key=order)

    def grown(self, current: Fit, most: int) -> Fit:
        """Effect after effect taken in, with exchanges on the way, while it is worth it."""
        while len(current.names - LAST) < most and (larger := self.grow(current)) is not None:
            before, current = current, self.exchange(larger)
            if self.worth(current) < self.worth(before) + 0.5 * WORTH_NATS:
                break
        return current

    def bent(self, current: Fit) -> Fit:
        """With what bends the base's own form, as much of it as is worth it."""
        while (larger := self.grow(current, last=True)) is not None:
            current = larger
        return current

    def exchange(self, current: Fit) -> Fit:
        """Each effect in turn replaced by what would do better, and dropped where it is no longer worth it."""
        if len(current.effects) > 1 and self.refits.helped:  # what is asked one by one below, side by side
            dropped = self._dropped(current)
            found = dict(zip(dropped, self.refits(list(dropped.values()))))
            self.gaps_N([f for name, f in found.items() if f is not None and name not in LAST])
        for name in sorted(current.names):
            if name not in current.names or len(current.effects) < 2:
                continue
            less = self.without(current, name)
            if self.worth(less) > self.worth(current) - 0.5 * WORTH_NATS:
                current = less
                continue
            if name in LAST:
                continue
            least = 0.5 * (self.worth(current) - self.worth(less))
            near = [x for x in self.offered(less)[:FURTHER_MOST] if self.needed(less.names | {x.name})]
            self.add([x for x in near if x.worth > least and x.name != name], less, current)
            current = self.best_beside(less, current)
        return current

    def best_beside(self, less: Fit, current: Fit) -> Fit:
        """The current fit, or a clearly better one of as many effects that has those of a smaller one, or of
        two that look alike and are all but tied the one that commits itself most."""
        same_size = [f for k, f in self.fits.items() if less.names < k and len(k) == len(current.names)]
        same_size = self.within_reach([f for f in same_size if f is current or self.needed(f.names)])
        self.worths([current, *same_size])
        better = [f for f in same_size if self.worth(f) > self.worth(current) + 1.0]
        top = max(better, key=self.worth, default=current)
        return self.plainest(less.names, [top, *(f for f in same_size if self.worth(f) < self.worth(top))])

    def pruned(self, current: Fit) -> Fit:
        """Less what the others of the set stand in for: one of two effects that look alike, unless both are needed
        (what bends the base first, which names no cause), and what leaves the gap as it is or larger; not what gains
        so many nats that others do not stand in for it, since worse effects would be taken in instead."""
        each = self.without_each(current)
        weakest_first = sorted(each, key=lambda n: -each[n].log_evidence)
        (base, base_along), whole, *left = self.gap_parts_N([self.fits[frozenset()], current, *each.values()])
        removes = {n: (gap_N - whole[0]) / base if base > 0.0 else 0.0 for n, (gap_N, _) in zip(each, left)}
        if changes(self.data, base_along):  # what acts on changes along the record is asked what it removes of those
            evolving = {e.name for e in current.effects if e.evolving}
            removes |= {
                n: max(removes[n], (along - whole[1]) / base_along)
                for n, (_, along) in zip(each, left)
                if n in evolving
            }
        for name in sorted(weakest_first, key=lambda n: n not in LAST):
            less, alone = self.without(current, name), self.fits.get(frozenset({name}))
            alike = any(look_alike(self.effects, name, n) for n in current.names - {name})
            # opposed: one is held by the other, that moves as much back
            opposed = alone is not None and self.gap_N(alone) > base
            cheap = less.log_evidence > current.log_evidence - BESIDE_ALIKE
            if alike and outdone(removes[name], cheap, opposed):
                return self.dropped(name, less)
        for name in weakest_first:
            less, alone = self.without(current, name), self.fits.get(frozenset({name}))
            helps = alone is not None and base - self.gap_N(alone) > ALONE * base
            if name in LAST or removes[name] >= (STOOD_IN if helps else 0.0):
                continue
            if self.worth(less) > self.worth(current) - BESIDE_ALIKE:
                return self.dropped(name, less)
        return current

    def dropped(self, name: str, less: Fit) -> Fit:
        """Pruned without an effect, which is remembered: it does not come back beside what stands in for it."""
        self.stood_in[name] = less.names
        return self.pruned(less)

    def rivals(self, current: Fit) -> Fit:
        """What else could stand in the place of each effect of the chosen set, and the best of those sets."""
        asked = RIVALS_ASKED // self.data.tests
        for _ in range(EXCHANGES_MOST):
            before = current
            for name in sorted(current.names):
                if name not in current.names:
                    continue
                less = self.without(current, name)
                least = RIVAL_SHARE * (self.worth(current) - self.worth(less))
                chosen: dict[str, Candidate] = {}
                others: list[str] = []
                for one in [*self.offered(less), *self.offered(less, last=True)]:
                    known = self.fits.get(less.names | {one.name})
                    if one.name in (name, *chosen) or not self.needed(less.names | {one.name}):
                        continue
                    if look_alike(self.effects, name, one.name):  # whatever a first step promises: ties are asked here
                        if known is None or known.log_evidence < current.log_evidence - TIED_NATS:
                            chosen[one.name] = one
                    elif known is None and (len(others) < asked or (one.worth > least and len(others) < RIVALS_MOST)):
                        chosen[one.name] = one
                        others.append(one.name)
                self.add(list(chosen.values()), less, current)
                current = self.best_beside(less, current)
            if current is before:
                break
        return self.fits[current.names]


def search(
    data: GapData,
    scales: Scales,
    settings: DiagnoseSettings,
    kinds: Mapping[str, tuple[Maker, ...]],
    rng: np.random.Generator,
    report: Report = silent,
    most: int = MOST_EFFECTS,
    simulator: Simulator | None = None,
    executor: Executor | None = None,
) -> Search:
    """Fit the base and every single effect, then grow a set of up to `most` effects, with exchanges on the way; the
    base alone where it misses nothing.

    executor : from :func:`bayes_iwan.executors.opened`, to refit the candidates of a step side by side.
    """
    found = _Explorer(data, scales, settings, kinds, rng, report, simulator, executor)
    if not missed(data, found.fits[frozenset()]):
        return Search(data, scales, settings, found.fits, (), {frozenset(): 1.0}, found.effects, found.failed)
    found.singles()
    if found.base_again():  # the base had missed its optimum: once more from there
        found.singles()
    current = found.grown(found.fits[frozenset()], most)
    bent = found.bent(current)
    if bent is not current:  # what stood in for the base's own form is no longer needed
        current = found.grown(found.exchange(bent), most)
    current = found.pruned(current)
    ends, asked = {current.names: current}, set[frozenset[str]]()
    while current.effects and current.names not in asked and len(asked) < ASKED_MOST:
        asked.add(current.names)
        better = found.rivals(current)
        if better.names == current.names:
            break
        current = found.pruned(found.grown(better, most))  # what an exchange opened, or made needless
        ends[current.names] = current
    for names in ends_of(found, current, most):  # passed on the way, and better than where it led
        if (
            found.worth(found.fits[names]) > found.worth(current) + 1.0
            and found.pruned(found.fits[names]).names == names
        ):
            ends[names] = found.fits[names]
    current = max(ends.values(), key=found.worth)
    if current.effects and current.names not in asked:  # an exchange may put two side by side that look alike
        current = found.pruned(found.rivals(current))
    gain = {n: current.log_evidence - found.without(current, n).log_evidence for n in current.names}
    order = tuple(sorted(gain, key=lambda n: -gain[n]))
    weights = ends_of(found, current, most)
    return Search(data, scales, settings, found.fits, order, weights, found.effects, found.failed)
