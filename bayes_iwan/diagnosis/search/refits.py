"""Refits of one campaign's models and what is asked of a fitted one, here or side by side in other processes, to which
the data travel once."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, fields
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
    draws: Array
    iterations: int = ITERATIONS


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


@dataclass(frozen=True)
class _Piece:
    """A refit as it travels: its problem is the base with the effects at these places of all."""

    effects: tuple[int, ...]
    starts: Array
    draws: Array
    iterations: int


@dataclass(frozen=True)
class _Fitted:
    """A fit as it travels, without its problem, and what is asked of it: work(data, fit), or candidates on top of it
    (the effects at the places `tried`)."""

    effects: tuple[int, ...]
    parts: tuple[Any, ...]
    work: Callable[[GapData, Fit], Any] | None = None
    tried: tuple[int, ...] = ()
    gap_N: float = 0.0

    def fit(self, common: _Common) -> Fit:
        return Fit(common.problem(self.effects), *self.parts)


class Refits:
    """Refits of models that extend `base`; effects : all that may be in them. None is made twice: rounds of exchanges
    ask again for what the last one tried."""

    def __init__(self, executor: Executor | None, data: GapData, base: Problem, effects: Sequence[Effect]) -> None:
        self._common = _Common(UserFiles.of((base.model, *effects)), data, base, tuple(effects))
        self._place = {id(e): i for i, e in enumerate(self._common.effects)}
        self._rounds = Rounds(executor, self._common)
        self._made: dict[tuple[object, ...], Fit | None] = {}
        #: is there another process, which would have nothing to do while this one refits a single model?
        self.helped = executor is not None

    def __call__(self, some: Sequence[Refit]) -> Iterator[Fit | None]:
        """The fits in their order, None where a model has no finite force; the same bits wherever they are made."""
        keys = [self._key(x) for x in some]
        new = {key: x for key, x in zip(keys, some) if key not in self._made}
        pieces = [_Piece(self._places(x.problem), x.starts, x.draws, x.iterations) for x in new.values()]
        found = zip(new.items(), self._rounds.results(pieces, _refitted))
        for key in keys:
            if key not in self._made:
                (made, one), parts = next(found)
                self._made[made] = None if parts is None else Fit(one.problem, *parts)
            yield self._made[key]

    def asked(self, work: Callable[[GapData, Fit], Answer], fits: Sequence[Fit]) -> list[Answer]:
        """work(data, fit) of every fit; work is a function of a module."""
        pieces = [_Fitted(self._places(f.problem), _parts(f), work) for f in fits]
        return list(self._rounds.results(pieces, _asked))

    def candidates(self, smaller: Fit, tried: Sequence[Effect], gap_N: float) -> list[Candidate]:
        """See :func:`.candidates.candidate`, of each of these effects on top of a fit that leaves a gap."""
        places, parts = [self._place[id(e)] for e in tried], _parts(smaller)
        some = [tuple(places[i : i + TOGETHER]) for i in range(0, len(places), TOGETHER)]
        pieces = [_Fitted(self._places(smaller.problem), parts, None, x, gap_N) for x in some]
        found = [x for several in self._rounds.results(pieces, _promised) for x in several]
        return [Candidate(e, on_top(smaller, e), *x) for e, x in zip(tried, found)]

    def _places(self, problem: Problem) -> tuple[int, ...]:
        return tuple(self._place[id(e)] for e in problem.effects)

    def _key(self, one: Refit) -> tuple[object, ...]:
        return self._places(one.problem), one.starts.tobytes(), one.draws.tobytes(), one.iterations


def _parts(fit: Fit) -> tuple[Any, ...]:
    """A fit's fields but the first, the problem, which is there already where the fit goes."""
    return tuple(getattr(fit, f.name) for f in fields(Fit)[1:])


def _refitted(common: _Common, piece: _Piece) -> tuple[Any, ...] | None:
    problem, starts = common.problem(piece.effects), piece.starts
    if len(piece.draws):
        starts = np.concatenate([starts, cheapest(common.data, problem, piece.draws, len(starts))])
    try:
        return _parts(fit_model(common.data, problem, starts, piece.iterations))
    except FitError:
        return None


def _asked(common: _Common, piece: _Fitted) -> Any:
    assert piece.work is not None
    return piece.work(common.data, piece.fit(common))


def _promised(common: _Common, piece: _Fitted) -> list[tuple[Array, float, float]]:
    """Starts, gain and score of each effect tried."""
    smaller = piece.fit(common)
    alike = weighed_alike(common.data, smaller)
    found = [candidate(common.data, smaller, alike, piece.gap_N, common.effects[i]) for i in piece.tried]
    return [(x.starts, x.gain, x.score) for x in found]
