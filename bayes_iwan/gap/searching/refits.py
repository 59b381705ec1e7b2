"""Refits of one campaign's models, here or side by side in other processes, to which the data travel once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect, effects_of
from bayes_iwan.executors import Rounds
from bayes_iwan.gap.fitting.data import GapData
from bayes_iwan.gap.fitting.evidence import Fit, FitError, extended, fit_model
from bayes_iwan.gap.searching.candidates import cheapest
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.user_file import UserFiles

#: most steps of a refit; nearly all have arrived before
ITERATIONS = 25


@dataclass(frozen=True)
class Refit:
    """A model to refit from starts (n, ndim), and from the n that cost least of draws (m, ndim) from its prior."""

    problem: Problem
    starts: Array
    draws: Array
    iterations: int = ITERATIONS


@dataclass(frozen=True)
class _Common:
    """What all refits share. own_files comes first, since the base may be of a user's own class."""

    own_files: UserFiles
    data: GapData
    base: Problem
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class _Piece:
    """A refit as it travels: its problem is the base with the effects at these places of all."""

    effects: tuple[int, ...]
    starts: Array
    draws: Array
    iterations: int


class Refits:
    """Refits of models that extend `base`; effects : all that may be in them. None is made twice: rounds of exchanges
    ask again for what the last one tried."""

    def __init__(self, executor: Executor | None, data: GapData, base: Problem, effects: Sequence[Effect]) -> None:
        self._effects = tuple(effects)
        self._place = {id(e): i for i, e in enumerate(self._effects)}
        self._rounds = Rounds(executor, _Common(UserFiles.of((base.model, *effects)), data, base, self._effects))
        self._made: dict[tuple[object, ...], Fit | None] = {}

    def __call__(self, some: Sequence[Refit]) -> Iterator[Fit | None]:
        """The fits in their order, None where a model has no finite force; the same bits wherever they are made."""
        keys = [self._key(x) for x in some]
        new = {key: x for key, x in zip(keys, some) if key not in self._made}
        pieces = [_Piece(self._places(x), x.starts, x.draws, x.iterations) for x in new.values()]
        found = zip(new.items(), self._rounds.results(pieces, _refitted))
        for key in keys:
            if key not in self._made:
                (made, one), parts = next(found)
                self._made[made] = None if parts is None else Fit(one.problem, *parts)
            yield self._made[key]

    def _places(self, one: Refit) -> tuple[int, ...]:
        return tuple(self._place[id(e)] for e in effects_of(one.problem))

    def _key(self, one: Refit) -> tuple[object, ...]:
        return self._places(one), one.starts.tobytes(), one.draws.tobytes(), one.iterations


def _refitted(common: _Common, piece: _Piece) -> tuple[Any, ...] | None:
    """A fit's fields but the first, the problem, which is there already where the fit goes."""
    problem, starts = extended(common.base, [common.effects[i] for i in piece.effects]), piece.starts
    if len(piece.draws):
        starts = np.concatenate([starts, cheapest(common.data, problem, piece.draws, len(starts))])
    try:
        fit = fit_model(common.data, problem, starts, piece.iterations)
    except FitError:
        return None
    return tuple(getattr(fit, f.name) for f in fields(Fit)[1:])
