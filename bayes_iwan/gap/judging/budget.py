"""The gap as a sum: which share of it every named effect removes, on the fitted tests and on tests left out, and the
rest.

A model's gap is not additive in its effects, so shares are Shapley values: the mean of what an effect removes over all
orders in which the effects of the set can be added (Shapley 1953; Lindeman, Merenda & Gold 1980 for regression). They
sum to what the whole set removes. What is said of a named cause is the mean of this and of the same asked from the
records' side (:mod:`bayes_iwan.gap.judging.taken_out`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from math import factorial

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.effects.catalogue import UNLISTED
from bayes_iwan.gap.fitting.evidence import Fit, FitError, extended, fit_model
from bayes_iwan.gap.fitting.gap_size import Gap, GapSize
from bayes_iwan.gap.fitting.leave_out import Unseen
from bayes_iwan.gap.judging.calibration import SUREST, Calibration
from bayes_iwan.gap.judging.guards import Figures
from bayes_iwan.gap.searching.base import LEAST_OF_FRICTION
from bayes_iwan.gap.searching.found import OWN_FORM, Search

#: half width of a 90 % interval in standard deviations
NINETY = 1.645
#: a cause as probable as this is named, and several together that share a place: a false name costs more than a missed
#: one. A rest is flagged from 0.5 on. Chosen with the next on 800 campaigns of the rig (analyses/measured.md)
NAMED = 0.55
#: and it must have this probability of its own, however many share its place: else they are said together
OWN_PROBABILITY = 0.25
#: share of the gap that an effect must remove to be judged or named
LEAST_SHARE = 0.02
#: the same of a cause in the base's own form: it always removes some
LEAST_OWN_FORM = 0.2
#: names of patterns that stand for no cause: what they remove belongs to the rest
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
class Share:
    """A share of the gap with its 90 % interval: noise of the records, how it varies between tests (jackknife), and
    where it is said of a cause, that nature's law is not quite ours."""

    value: float
    low: float
    high: float

    def about(self, value: float) -> Share:
        """The same interval about another value."""
        moved = value - self.value
        return Share(value, max(self.low + moved, -1.0), min(self.high + moved, 1.0))

    def widened(self, sd: float) -> Share:
        """With a further independent error of this standard deviation."""
        low, high = (float(np.hypot(x, NINETY * sd)) for x in (self.value - self.low, self.high - self.value))
        return Share(self.value, max(self.value - low, -1.0), min(self.value + high, 1.0))


@dataclass(frozen=True)
class Cause:
    """A named effect: how probable, which share of the gap it removes, and what it cannot be told from.

    share : on the fitted tests; held_out : on whole frequencies and amplitudes left out of the fit (or on held-out
    tests, as `held_out_by` says) whose fit tells its strength; None where no other test can judge it: its parameters
    belong to single records, or no other test tells its strength
    along : share that it removes of what changes along the record, where that is what it acts on
    """

    name: str
    law: str
    probability: float
    share: Share
    held_out: Share | None
    held_out_by: str
    cannot_tell_apart: tuple[str, ...]
    figures: Figures
    along: float | None = None


@dataclass(frozen=True)
class OneOf:
    """Effects of which one probably contributes, though these tests cannot tell which, the likeliest first; share : of
    the gap that the one removes."""

    names: tuple[str, ...]
    probability: float
    share: float


@dataclass(frozen=True)
class Suspect:
    """An effect that alone would remove this share of a gap, most of which has no name, though no evidence speaks for
    it."""

    name: str
    share: float


@dataclass(frozen=True)
class RestOfGap:
    """What is left beside the named causes.

    probability : that it has a cause of its own; share : of the gap; of_friction : of the RMS friction force
    where : sentences on where it sits; looks_like : name of a pattern without a cause that fits it, if one does
    subharmonic : power of a line at half a test's frequency over its background
    """

    probability: float
    share: Share
    of_friction: float
    where: tuple[str, ...]
    looks_like: str | None
    subharmonic: float


@dataclass(frozen=True)
class GapBudget:
    """The gap as a sum: before = causes + rest, in RMS newtons; after : what is left with all causes in."""

    before: Gap
    after: Gap
    causes: tuple[Cause, ...]
    rest: RestOfGap


@dataclass(frozen=True)
class Verdict:
    """The headline: its kind, the named causes (largest share first), and whether the rest has a cause without a name.

    probabilities : that each effect contributes, of "none" and of "unknown" (a rest that has a cause)
    one_of : places that are probably filled, where no effect is likely enough to be named
    suspects : where most of the gap has no name, what alone would remove most of it, the largest share first
    cornered : files of the tests whose drive has corners; corners_gap : share of the friction force that channels may
    make the model miss of such a drive
    """

    kind: Kind
    causes: tuple[Cause, ...]
    unknown_rest: bool
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
        return "unknown" if self.unknown_rest else "none"


def subsets(names: Iterable[str]) -> list[frozenset[str]]:
    """Every subset, the empty one first."""
    some = sorted(names)
    return [frozenset(c) for k in range(len(some) + 1) for c in combinations(some, k)]


def fits_of_subsets(search: Search) -> dict[frozenset[str], Fit]:
    """A fit of every subset of the chosen set: those of the search, the others refitted from the next larger one."""
    out: dict[frozenset[str], Fit] = {}
    for names in sorted(subsets(search.chosen), key=len, reverse=True):
        known = search.fits.get(names)
        larger = [f for k, f in out.items() if names < k and len(k) == len(names) + 1]
        starts: dict[tuple[str, ...], list[Array]] = {}
        problems = {}
        for fit in larger:
            problem = extended(fit.problem, [e for e in fit.effects if e.name in names])
            at = [fit.problem.names.index(n) for n in problem.names]
            starts.setdefault(problem.names, []).append(fit.z[at])
            problems[problem.names] = problem
        tried = [known] if known is not None else []
        if known is None:
            for key, problem in problems.items():
                try:
                    tried.append(fit_model(search.data, problem, np.array(starts[key]), 20))
                except FitError:
                    continue
        out[names] = max(tried, key=lambda f: f.log_evidence) if tried else search.base
    return out


def shapley(names: Iterable[str], value: Callable[[frozenset[str]], Array]) -> dict[str, Array]:
    """Shapley value of each name; value(set) is any array of numbers that the set as a whole achieves."""
    names = frozenset(names)
    n = len(names)
    out = {}
    for name in names:
        total: Array = np.zeros(())
        for some in subsets(names - {name}):
            weight = factorial(len(some)) * factorial(n - len(some) - 1) / factorial(n)
            total = total + weight * (value(some | {name}) - value(some))
        out[name] = total
    return out


def shares(names: Iterable[str], sizes: Mapping[frozenset[str], GapSize]) -> dict[str, Share]:
    """Share of the gap that each of the named effects removes on the tests that `sizes` speak of."""
    names = frozenset(names)
    tests = len(sizes[frozenset()].files)
    power = {k: np.array([t.rms_N**2 for t in s.tests]) for k, s in sizes.items()}
    draws = {k: np.sqrt(s.plausible.mean(axis=1)) for k, s in sizes.items()}
    whole = np.maximum(draws[frozenset()], 1e-3 * float(np.sqrt(power[frozenset()].mean())) + 1e-300)
    by_noise = shapley(names, lambda k: -draws[k] / whole)
    return _with_intervals(names, power, tests, {n: float(np.var(v)) for n, v in by_noise.items()})


def along_shares(names: Iterable[str], along_N: Mapping[frozenset[str], float]) -> dict[str, float]:
    """Share that each of the named effects removes of what changes along the record: Shapley values of its RMS, N."""
    before = along_N[frozenset()]
    if before <= 0.0:
        return dict.fromkeys(names, 0.0)
    return {n: float(v) for n, v in shapley(names, lambda k: np.array(-along_N[k] / before)).items()}


def rest_share(names: Iterable[str], sizes: Mapping[frozenset[str], GapSize]) -> Share:
    """Share of the gap that all named effects together leave."""
    whole = frozenset(["all"])  # as one player, so that its interval is that of the sum
    found = shares(whole, {frozenset(): sizes[frozenset()], whole: sizes[frozenset(names)]})["all"]
    return Share(1.0 - found.value, max(1.0 - found.high, 0.0), min(1.0 - found.low, 1.0))


def unseen_shares(names: Iterable[str], unseen: Iterable[Unseen]) -> dict[str, Share]:
    """The same on tests left out: the mean over what was left out, jackknifed over tests; each effect on those tests
    alone whose fit tells its strength, and not there where none does."""
    names = frozenset(names)
    found: dict[str, list[Share]] = {}
    for u in unseen:
        for name in names:
            kept = u.tells(names, name)
            if kept.any():
                power_N2 = {k: p[kept] for k, p in u.power_N2.items()}
                found.setdefault(name, []).append(_with_intervals(names, power_N2, int(kept.sum()), {})[name])
    out = {}
    for name, some in found.items():
        width = float(np.sqrt(np.mean([(0.5 * (s.high - s.low)) ** 2 for s in some])))
        value = float(np.mean([s.value for s in some]))
        out[name] = Share(value, max(value - width, -1.0), min(value + width, 1.0))
    return out


def _with_intervals(
    names: frozenset[str], power: Mapping[frozenset[str], Array], tests: int, variance: Mapping[str, float]
) -> dict[str, Share]:
    """Shapley shares of RMS gaps from squared gaps by test (tests,), with jackknife and other variances."""

    def of(keep: NDArray[np.int64]) -> dict[str, Array]:
        size = {k: np.sqrt(max(float(p[keep].mean()), 0.0)) for k, p in power.items()}
        whole = size[frozenset()]
        return shapley(names, lambda k: np.array((whole - size[k]) / whole if whole > 0.0 else 0.0))

    every = np.arange(tests)
    value = {n: float(v) for n, v in of(every).items()}
    out = {}
    less = [of(np.delete(every, t)) for t in every] if tests > 1 else []
    for name in names:
        jackknifed = np.array([float(x[name]) for x in less])
        between = (tests - 1) / tests * float(np.sum((jackknifed - jackknifed.mean()) ** 2)) if less else 0.0
        width = NINETY * float(np.sqrt(between + variance.get(name, 0.0)))
        out[name] = Share(value[name], max(value[name] - width, -1.0), min(value[name] + width, 1.0))
    return out


def contributing(given: Iterable[Figures], c: Calibration) -> tuple[dict[str, float], dict[str, float]]:
    """Probability that each effect contributes, rivals for one place sharing its probability; and, by chosen effect,
    that anything contributes in its place."""
    p: dict[str, float] = {}
    places = {}
    for f in given:
        places[f.name] = c.contributes(f)
        for name, share in c.among(f).items():
            p[name] = 1.0 - (1.0 - p.get(name, 0.0)) * (1.0 - places[f.name] * share)
    return p, places


def rest_without_name(by_size: float, given: Iterable[Figures], c: Calibration) -> float:
    """Probability that the rest has a cause of its own: by its size and lines (:meth:`Calibration.unknown_rest`), or
    because a pattern is there that no listed cause makes and that removes as much as a named cause must."""
    none = 1.0 - by_size
    for f in given:
        if f.name in NO_CAUSE and f.fitted >= least_share(f.name, f.before):
            none *= 1.0 - c.contributes(f) * c.among(f)[f.name]
    return min(1.0 - none, SUREST)


def least_share(name: str, gap: float) -> float:
    """Share of the gap that an effect must remove to be named; gap : over the friction force."""
    return max(LEAST_OWN_FORM if name in OWN_FORM else LEAST_SHARE, LEAST_OF_FRICTION / max(gap, LEAST_OF_FRICTION))


def left_unnamed(named: frozenset[str], gap: Mapping[frozenset[str], float]) -> float:
    """The gap beside the named effects, of gaps by set of effects. What causes in the base's own form explain
    (:data:`OWN_FORM`) is a specimen's usual difference from the model and not left."""
    return gap[named | (max(gap, key=len) & OWN_FORM)]
