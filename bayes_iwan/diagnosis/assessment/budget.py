"""The gap as a sum: which share of it every named effect removes, and what is left.

Three gaps say what an effect does, each over the base model's, on the same tests: with all named effects, without this
one, with this one alone. Effects overlap, so an effect removes one share as the only one and another as the last one.
Its share is the mean of both. What makes a share vague has three parts (:class:`Vague`): no number in them is tuned.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.constants import LEAST_MODEL_FORM, LEAST_OF_FRICTION, LEAST_SHARE
from bayes_iwan.diagnosis.fits.gap_size import Gap, GapSize, Share, shrink
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM
from bayes_iwan.effects.catalogue import UNLISTED
from bayes_iwan.screen import on_screen

#: half width of a 90 % interval in standard deviations
NINETY = 1.645
#: names of patterns that stand for no cause: what they remove belongs to the unexplained part
NO_CAUSE = frozenset(e.name for e in UNLISTED)


class Kind(StrEnum):
    """The headline of a diagnosis."""

    NONE = "none"
    EXPLAINED = "explained"
    PARTLY = "partly_explained"
    UNKNOWN = "unknown"
    #: a gap no larger than what channels make of a drive with corners: nothing can be said of the specimen
    DRIVE = "drive"


@dataclass(frozen=True)
class Vague:
    """What makes a share vague, each as a part of the gap.

    data : half width of its 90 % interval by how it varies between tests (jackknife)
    overlap : half of how far apart it is as the only effect and as the last one
    law_below : by how much less it removes on frequencies and amplitudes held out in turn than on the fitted tests;
        where none can be held out, as law_above
    law_above : what all named effects leave, which may be this effect's too, by a law that is not quite nature's
    """

    data: float
    overlap: float
    law_below: float
    law_above: float

    def share(self, value: float) -> Share:
        """The share with its 90 % interval, value − √(data² + overlap²) − law_below to value + √(data² + overlap²) +
        law_above, within −1 … 1: what the law leaves open is no chance error, so it is added."""
        chance = float(np.hypot(self.data, self.overlap))
        return Share(value, max(value - chance - self.law_below, -1.0), min(value + chance + self.law_above, 1.0))


@dataclass(frozen=True)
class Gaps:
    """RMS gaps over the base model's, on the same tests: with all named effects, with all but one, and with that one
    alone; sd : of the one's share, from how it varies between tests (jackknife)."""

    with_all: float
    without: float
    alone: float
    sd: float

    @property
    def share(self) -> float:
        """What the effect removes, the mean of the only one and the last one."""
        return 0.5 * (self.first + self.last)

    @property
    def overlap(self) -> float:
        """Half of how far these two lie apart."""
        return 0.5 * abs(self.first - self.last)

    @property
    def last(self) -> float:
        """What the effect removes as the last one."""
        return self.without - self.with_all

    @property
    def first(self) -> float:
        """What it removes as the only one."""
        return 1.0 - self.alone

    @property
    def measured(self) -> Share:
        """The share on these tests with the interval that data and overlap leave open."""
        return Vague(NINETY * self.sd, self.overlap, 0.0, 0.0).share(self.share)


@dataclass(frozen=True)
@on_screen
class Cause:
    """A named effect: how probable, which share of the gap it removes, and which effects are tied with it.

    share : on the fitted tests, vague : what its interval is made of; held_out : on whole frequencies and amplitudes
    held out (or on held-out tests, as `held_out_by` says); None where no other test can show it: its parameters belong
    to single records
    gaps : the three gaps, on the tests of `held_out`, or the fitted ones where that is None
    along : share that it removes of what changes along the record, where that is what it acts on
    """

    name: str
    law: str
    probability: float
    share: Share
    vague: Vague
    held_out: Share | None
    held_out_by: str
    tied_with: tuple[str, ...]
    figures: Figures
    gaps: Gaps
    along: float | None = None


@dataclass(frozen=True)
@on_screen
class OneOf:
    """Effects of which one probably contributes, though these tests cannot tell which, the likeliest first; share : of
    the gap that the best of them removes beside what else the best set has; along : of what changes along the records,
    None where it does not act there."""

    names: tuple[str, ...]
    probability: float
    share: float
    along: float | None = None


@dataclass(frozen=True)
class Suspect:
    """An effect that alone would remove this share of a gap, most of which has no name, though no evidence speaks for
    it."""

    name: str
    share: float


@dataclass(frozen=True)
@on_screen
class Unexplained:
    """What is left beside the named causes.

    probability : that it has a cause of its own; share : of the gap; of_friction : of the RMS friction force
    where : sentences on where it sits; resembles : name of a pattern without a cause that fits it, on
        held-out tests too, if one does; resembling : share of the gap that it removes as the last one
    """

    probability: float
    share: Share
    of_friction: float
    where: tuple[str, ...]
    resembles: str | None
    resembling: float


@dataclass(frozen=True)
@on_screen
class GapBudget:
    """The gap as a sum: before = causes + unexplained, in RMS newtons; after : what is left with all causes in."""

    before: Gap
    after: Gap
    causes: tuple[Cause, ...]
    unexplained: Unexplained


@dataclass(frozen=True)
@on_screen
class Verdict:
    """The headline: its kind, the named causes (largest share first), and whether the unexplained part has a cause
    without a name.

    probabilities : that each effect contributes, of "none" and of "unknown" (an unexplained part that has a cause)
    one_of : places that are probably filled, where no effect is likely enough to be named
    suspects : where most of the gap has no name, what alone would remove most of it, the largest share first
    cornered : files of the tests whose drive has corners; corners_gap : share of the friction force that channels may
    make the model miss of such a drive
    """

    kind: Kind
    causes: tuple[Cause, ...]
    unknown_cause: bool
    probabilities: dict[str, float]
    cornered: tuple[str, ...] = ()
    corners_gap: float = 0.0
    one_of: tuple[OneOf, ...] = ()
    suspects: tuple[Suspect, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.causes)

    @property
    def cause(self) -> str:
        """The largest named cause, else "drive", "none" or "unknown"."""
        if self.causes:
            return self.causes[0].name
        if self.kind is Kind.DRIVE:
            return "drive"
        return "unknown" if self.unknown_cause else "none"


def subsets(names: Iterable[str]) -> list[frozenset[str]]:
    """Every subset, the empty one first."""
    some = sorted(names)
    return [frozenset(c) for k in range(len(some) + 1) for c in combinations(some, k)]


def shares_of(names: Iterable[str], gap_N: Mapping[frozenset[str], float]) -> dict[str, float]:
    """Share of the gap of each effect of a set, from the gaps that its subsets leave: the mean of what it removes as
    the only one and as the last one."""
    whole, before = frozenset(names), gap_N[frozenset()]
    if before <= 0.0:
        return dict.fromkeys(whole, 0.0)
    return {
        n: float(0.5 * (before - gap_N[frozenset({n})] + gap_N[whole - {n}] - gap_N[whole]) / before) for n in whole
    }


def unexplained_share(names: Iterable[str], sizes: Mapping[frozenset[str], GapSize]) -> Share:
    """Share of the gap that all named effects together leave."""
    removed = shrink(sizes[frozenset()], sizes[frozenset(names)])
    return Share(1.0 - removed.value, max(1.0 - removed.high, 0.0), min(1.0 - removed.low, 1.0))


def gaps_of(names: Iterable[str], power_N2: Mapping[frozenset[str], Array]) -> dict[str, Gaps]:
    """The three gaps of each effect of a set, from squared gaps by test (tests,) of the base, the set, the set without
    it and it alone."""
    whole = frozenset(names)
    tests = len(power_N2[whole])
    less = range(tests) if tests > 1 else ()
    mean_N2 = {k: [p.mean(), *(np.delete(p, t).mean() for t in less)] for k, p in power_N2.items()}
    rms = {k: np.sqrt(np.maximum(p, 0.0)) for k, p in mean_N2.items()}
    before = np.maximum(rms[frozenset()], 1e-300)
    out = {}
    for n in whole:
        with_all, without, alone = (rms[k] / before for k in (whole, whole - {n}, frozenset({n})))
        shares = 0.5 * (1.0 - alone + without - with_all)[1:]
        sd = float(np.sqrt((tests - 1) / tests * np.sum((shares - shares.mean()) ** 2))) if less else 0.0
        out[n] = Gaps(float(with_all[0]), float(without[0]), float(alone[0]), sd)
    return out


def vagueness(fitted: Gaps, held_out: Gaps | None) -> Vague:
    """What makes an effect's share on the fitted tests vague; held_out : its gaps on tests held out in turn, None
    where there are none."""
    left = float(np.clip(fitted.with_all, 0.0, 1.0))
    lost = left if held_out is None else max(fitted.share - float(np.clip(held_out.share, -1.0, 1.0)), 0.0)
    return Vague(NINETY * (held_out or fitted).sd, fitted.overlap, lost, left)


def least_share(name: str, gap: float) -> float:
    """Share of the gap that an effect must remove to be named; gap : over the friction force."""
    return max(LEAST_MODEL_FORM if name in MODEL_FORM else LEAST_SHARE, LEAST_OF_FRICTION / max(gap, LEAST_OF_FRICTION))
