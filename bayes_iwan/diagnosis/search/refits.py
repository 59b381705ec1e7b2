"""Refits of one campaign's models and what is asked of a fitted one, here or side by side in other processes, to which
the data travel once."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit, FitError, fit_model
from bayes_iwan.diagnosis.search.base_fit import cheapest
from bayes_iwan.diagnosis.search.candidates import Candidate, candidate, on_top, weighed_alike
from bayes_iwan.effects.base import Effect
from bayes_iwan.executors import Rounds
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models.user_file import UserFiles

#: most steps of a refit; nearly all have arrived before
ITERATIONS = 25
#: effects that are tried in one piece of work: the fit beneath travels with each
TOGETHER = 4

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Refit:
    """A model to refit from starts (n, ndim), and from the n that cost least of draws (m, ndim) from its prior."""

    problem: Problem
    starts: Array
    draws: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class _Common:
    """What all pieces of work share. own_files comes first, since the base may be of a user's own class."""

    own_files: UserFiles
    data: GapData
    base: Problem
    effects: tuple[Effect, ...]

    def problem(self, places: Sequence[int]) -> Problem:
        """The base with the effects at these places of all."""
        return self.base.with_effects([self.effects[i] for i in places])

    def fit(self, places: Sequence[int], parts: Sequence[Any]) -> Fit:
        """A fit from what travels of it."""
        return Fit(self.problem(places), *parts)


class Refits:
    """Refits of models that extend `base`; effects : all that may be in them."""

    def __init__(self, executor: Executor | None, data: GapData, base: Problem, effects: Sequence[Effect]) -> None:
        self._common = _Common(UserFiles.of((base.model, *effects)), data, base, tuple(effects))
        self._place = {id(e): i for i, e in enumerate(self._common.effects)}
        self._rounds = Rounds(executor, self._common)

    def __call__(self, some: Sequence[Refit]) -> Iterator[Fit | None]:
        """The fits in their order, None where a model has no finite force; the same bits wherever they are made."""
        pieces = [(self._places(x.problem), x.starts, x.draws) for x in some]
        for one, parts in zip(some, self._rounds.results(pieces, _refitted)):
            yield None if parts is None else Fit(one.problem, *parts)

    def asked(self, work: Callable[[GapData, Fit], Answer], fits: Sequence[Fit]) -> list[Answer]:
        """work(data, fit) of every fit; work is a function of a module."""
        return list(self._rounds.results([(*self._travelling(f), work) for f in fits], _asked))

    def candidates(self, smaller: Fit, tried: Sequence[Effect], gap_N: float) -> list[Candidate]:
        """See :func:`.candidates.candidate`, of each of these effects on top of a fit that leaves a gap."""
        places, fit = [self._place[id(e)] for e in tried], self._travelling(smaller)
        pieces = [(*fit, places[i : i + TOGETHER], gap_N) for i in range(0, len(places), TOGETHER)]
        found = [x for several in self._rounds.results(pieces, _promised) for x in several]
        return [Candidate(e, on_top(smaller, e), *x) for e, x in zip(tried, found)]

    def _places(self, problem: Problem) -> tuple[int, ...]:
        return tuple(self._place[id(e)] for e in problem.effects)

    def _travelling(self, fit: Fit) -> tuple[tuple[int, ...], tuple[Any, ...]]:
        """A fit's effects, and its fields but the first, the problem, which is there already where the fit goes."""
        return self._places(fit.problem), _parts(fit)


def _parts(fit: Fit) -> tuple[Any, ...]:
    return tuple(getattr(fit, f.name) for f in fields(Fit)[1:])


# what is done with a piece of work, in whatever process: places of the effects, then what it is done with


def _refitted(common: _Common, piece: tuple[tuple[int, ...], Array, Array]) -> tuple[Any, ...] | None:
    places, starts, draws = piece
    problem = common.problem(places)
    if len(draws):
        starts = np.concatenate([starts, cheapest(common.data, problem, draws, len(starts))])
    try:
        return _parts(fit_model(common.data, problem, starts, ITERATIONS))
    except FitError:
        return None


def _asked(common: _Common, piece: tuple[Any, ...]) -> Any:
    *fit, work = piece
    return work(common.data, common.fit(*fit))


def _promised(common: _Common, piece: tuple[Any, ...]) -> list[tuple[Array, float, float]]:
    """Starts, gain and score of each effect tried."""
    *fit, tried, gap_N = piece
    smaller = common.fit(*fit)
    alike = weighed_alike(common.data, smaller)
    found = [candidate(common.data, smaller, alike, gap_N, common.effects[i]) for i in tried]
    return [(x.starts, x.gain, x.score) for x in found]
