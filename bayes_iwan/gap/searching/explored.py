"""What a search has fitted so far: the best fit of every set of effects, what it is worth, and what could be added.

An effect starts from the smaller model's optima at several strengths and extra parameters: those that promise most
once the smaller model's own parameters may move (one Gauss–Newton step).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from itertools import islice

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import Maker
from bayes_iwan.gap.fitting.data import GapData
from bayes_iwan.gap.fitting.evidence import Fit, extended
from bayes_iwan.gap.searching.base import (
    BASE_POINTS,
    NEWTON_NATS,
    fit_base,
    gap_parts_N,
    newton_nats,
    quick_gap_N,
)
from bayes_iwan.gap.searching.candidates import Candidate, failing, leading
from bayes_iwan.gap.searching.found import LAST, look_alike, needed, part
from bayes_iwan.gap.searching.refits import ITERATIONS, Refit, Refits
from bayes_iwan.gap.searching.strength import calibrated
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.scales import Scales
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.physics import Simulator
from bayes_iwan.threads import alongside

#: fits whose gaps differ by this in ln may still exchange their places, whatever their evidence
REACH = 1.6

Report = Callable[[str], None]


def silent(what: str) -> None:
    """No progress shown."""


class Explored:
    """The fits found so far, and what is asked of them, each once.

    fits : the best of every set of effects; effects : every law on offer by effect; failed : effects that cannot be
    used, and why; stood_in : effects that were dropped, and the rest of the set, which stood in for each
    """

    def __init__(
        self,
        data: GapData,
        scales: Scales,
        settings: DiagnoseSettings,
        kinds: Mapping[str, tuple[Maker, ...]],
        rng: np.random.Generator,
        report: Report,
        simulator: Simulator | None,
        executor: Executor | None,
    ) -> None:
        self.data, self.rng, self.report = data, rng, report
        self.fits: dict[frozenset[str], Fit] = {}
        self._gaps: dict[tuple[frozenset[str], float], tuple[float, float]] = {}
        self._worth: dict[tuple[frozenset[str], float], float] = {}
        self.stood_in: dict[str, frozenset[str]] = {}
        self._left: set[tuple[frozenset[str], str, float]] = set()
        self._offers: dict[tuple[frozenset[str], float, bool], list[Candidate]] = {}  # found once for each fit
        self.failed: dict[str, str] = {}
        report("base model")
        base = fit_base(data, settings, scales, rng, simulator)
        self.fits[frozenset()] = base
        self.effects: dict[str, tuple[Effect, ...]] = {}
        every = [k for some in kinds.values() for k in some]
        scaled = iter(list(alongside(lambda k: calibrated(k, scales, data, base.problem, base.z), every)))
        for name, classes in kinds.items():
            some = tuple(islice(scaled, len(classes)))
            wrong = [w for w in (failing(data, base, e) for e in some) if w]
            if wrong and len(wrong) == len(some):
                self.failed[name] = wrong[0]
            else:
                self.effects[name] = some
        self.refits = Refits(executor, data, base.problem, [e for some in self.effects.values() for e in some])

    def keep(self, problem: Problem, starts: Array, iterations: int = ITERATIONS) -> Fit | None:
        """Fit a model; remember it if it is the best of its set. None where it has no finite force."""
        (fit,) = self.refits([Refit(problem, starts, starts[:0], iterations)])
        return self._kept(fit)

    def _kept(self, fit: Fit | None) -> Fit | None:
        if fit is None:
            return None
        old = self.fits.get(fit.names)
        if old is None or self._outdoes(fit, old):
            self.fits[fit.names] = fit
        return self.fits[fit.names]

    def _outdoes(self, fit: Fit, other: Fit) -> bool:
        """By evidence; but a law with numbers of its own in every test, for each of which evidence asks, against one
        without by what both are worth: beside a rest that wanders as much evidence has nothing to say for it."""
        if _by_test(fit) == _by_test(other):
            return fit.log_evidence > other.log_evidence
        worth, others = self.worths([fit, other])
        return worth > others

    def add(self, some: Sequence[Candidate], smaller: Fit, instead_of: Fit | None = None) -> None:
        """Refit candidates, from where each promised most, from where it was best beside the base alone, and from the
        others of the set that it is tried in."""
        found, fits = self.refits([self._start(one, smaller, instead_of) for one in some]), list[Fit | None]()
        for one in some:
            self.report("+".join((*sorted(smaller.names), one.name)))
            fits.append(next(found))
        for fit in fits:  # when all are there: whoever refits them is asked again
            self._kept(fit)

    def _start(self, one: Candidate, smaller: Fit, instead_of: Fit | None) -> Refit:
        starts, draws = one.starts, one.starts[:0]
        alone = self.fits.get(frozenset({one.name}))
        if smaller.effects and alone is not None:
            z = dict(zip(smaller.problem.names, smaller.z)) | dict(zip(alone.problem.names, alone.z))
            starts = np.concatenate([starts, np.array([[z.get(n, 0.0) for n in one.problem.names]])])
        if instead_of is not None:
            z = dict(zip(one.problem.names, one.starts[0]))
            z |= {n: v for n, v in zip(instead_of.problem.names, instead_of.z) if n in smaller.problem.names}
            starts = np.concatenate([starts, np.array([[z[n] for n in one.problem.names]])])
        if one.effect.sudden and not smaller.effects:  # the base may have bent too far to lead there
            draws = one.problem.prior.draw(self.rng, BASE_POINTS)
        return Refit(one.problem, starts, draws)

    def offered(self, smaller: Fit, last: bool = False) -> list[Candidate]:
        """Candidates on top of a fit, LAST alone or all others, LAWS_MOST laws of each effect, the most promising
        first; of two look-alikes that solve for the specimen's motion one, since one within the other costs most."""
        solved = [e for e in smaller.effects if "around" in e.stations]
        on_offer = {
            n: some
            for n, some in self.effects.items()
            if n not in smaller.names
            and (n in LAST) == last
            and not ("around" in some[0].stations and any(look_alike(self.effects, n, e.name) for e in solved))
        }
        at = (smaller.names, smaller.log_evidence, last)
        if at not in self._offers:
            tried = [e for some in on_offer.values() for e in some if e.possible(self.data)]
            found = self.refits.candidates(smaller, tried, self.gap_N(smaller))
            self._offers[at] = leading(sorted(found, key=lambda c: -c.worth))
        return self._offers[at]

    def without(self, fit: Fit, name: str) -> Fit:
        """The fit of the same set less one effect, from this fit's optimum too (tried once)."""
        known, tried = self.fits.get(fit.names - {name}), (fit.names, name, fit.log_evidence)
        if known is not None and tried in self._left:
            return known
        self._left.add(tried)
        less = self._less(fit, name)
        found = self.keep(less.problem, less.starts)
        return found if found is not None else self.fits[frozenset()]

    def without_each(self, fit: Fit) -> dict[str, Fit]:
        """The same of every effect of a set, side by side."""
        list(self.refits(list(self._dropped(fit).values())))
        return {n: self.without(fit, n) for n in sorted(fit.names)}

    def _dropped(self, fit: Fit) -> dict[str, Refit]:
        """What :meth:`without` has yet to refit of a set; refits are remembered, so that they can be asked ahead."""
        names = sorted(fit.names)
        return {n: self._less(fit, n) for n in names if (fit.names, n, fit.log_evidence) not in self._left}

    def _less(self, fit: Fit, name: str) -> Refit:
        problem = extended(fit.problem, [e for e in fit.effects if e.name != name])
        starts, known = [part(fit, problem)], self.fits.get(fit.names - {name})
        if known is not None and known.problem.names == problem.names:
            starts.append(known.z)
        return Refit(problem, np.array(starts), np.zeros((0, problem.ndim)))

    def worth(self, fit: Fit) -> float:
        return self.worths([fit])[0]

    def worths(self, fits: Sequence[Fit]) -> list[float]:
        """ln evidence, and what the gap that is left is worth in newtons; once for each fit, several side by side."""
        new = {(f.names, f.log_evidence): f for f in fits if (f.names, f.log_evidence) not in self._worth}
        for (at, fit), gap_N in zip(new.items(), self.refits.asked(quick_gap_N, list(new.values()))):
            self._worth[at] = fit.log_evidence + newton_nats(self.data, gap_N)
        return [self._worth[f.names, f.log_evidence] for f in fits]

    def within_reach(self, fits: Sequence[Fit]) -> list[Fit]:
        """Of these fits those that may be worth most: no other gap can make up for more evidence."""
        least = max(f.log_evidence for f in fits) - NEWTON_NATS * self.data.tests * REACH
        return [f for f in fits if f.log_evidence >= least]

    def gap_N(self, fit: Fit) -> float:
        return self.gaps_N([fit])[0]

    def gaps_N(self, fits: Sequence[Fit]) -> list[float]:
        """See :func:`gap_rms_N`; once for each fit, and several side by side."""
        return [gap for gap, _ in self.gap_parts_N(fits)]

    def gap_parts_N(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        """See :func:`gap_parts_N`; once for each fit, and several side by side."""
        new = {(f.names, f.log_evidence): f for f in fits if (f.names, f.log_evidence) not in self._gaps}
        self._gaps |= zip(new, self.refits.asked(gap_parts_N, list(new.values())))
        return [self._gaps[f.names, f.log_evidence] for f in fits]

    def needed(self, names: frozenset[str]) -> bool:
        """Has no effect of a set been dropped because others of it stand in for it?"""
        return needed(self.effects, self.stood_in, names)


def _by_test(fit: Fit) -> frozenset[str]:
    """Effects whose strengths are numbers of single tests."""
    return frozenset(e.name for e in fit.effects if e.strength_name not in fit.problem.names)
