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


@dataclass(frozen=True)
class _Piece:
    """A refit as it travels: its problem is the base with these effects."""

    effects: tuple[Effect, ...]
    starts: Array
    draws: Array
    iterations: int


class Refits:
    """Refits of models that extend `base`; effects : all that may be in them."""

    def __init__(self, executor: Executor | None, data: GapData, base: Problem, effects: Sequence[Effect]) -> None:
        self._rounds = Rounds(executor, _Common(UserFiles.of((base.model, *effects)), data, base))

    def __call__(self, some: Sequence[Refit]) -> Iterator[Fit | None]:
        """The fits in their order, None where a model has no finite force; the same bits wherever they are made."""
        pieces = [_Piece(effects_of(x.problem), x.starts, x.draws, x.iterations) for x in some]
        for one, found in zip(some, self._rounds.results(pieces, _refitted)):
            yield None if found is None else Fit(one.problem, *found)


def _refitted(common: _Common, piece: _Piece) -> tuple[Any, ...] | None:
    """A fit's fields but the first, the problem, which is there already where the fit goes."""
    problem, starts = extended(common.base, piece.effects), piece.starts
    if len(piece.draws):
        starts = np.concatenate([starts, cheapest(common.data, problem, piece.draws, len(starts))])
    try:
        fit = fit_model(common.data, problem, starts, piece.iterations)
    except FitError:
        return None
    return tuple(getattr(fit, f.name) for f in fields(Fit)[1:])
