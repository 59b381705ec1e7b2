"""A finished search: the fits of all sets of effects that were tried, and which effects look alike."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from math import inf, isfinite

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.constants import ALIKE_NATS, EFFECT_NATS
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import BUILT_IN, FORM
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.screen import on_screen

#: causes in the base's form: every specimen differs a little from the family
MODEL_FORM = frozenset(e.name for e in FORM)
#: these, and others so flexible that they are sought only beside what the others explain
LAST = frozenset(e.name for e in (*FORM, *(e for e in BUILT_IN if e.flexible)))


@dataclass(frozen=True)
@on_screen
class Search:
    """All fits of one campaign.

    fits : the best fit of every set of effects that was refitted, the base under the empty set
    chosen : the set of the best score, the effect that gains most first
    scores : of every set, nats (:func:`score`)
    effects : every law on offer by effect; failed : effects without a finite force or calibration, and why
    """

    data: GapData
    scales: Scales
    settings: DiagnoseSettings
    fits: Mapping[frozenset[str], Fit]
    chosen: tuple[str, ...]
    scores: Mapping[frozenset[str], float]
    effects: Mapping[str, tuple[Effect, ...]]
    failed: Mapping[str, str] = field(default_factory=dict)

    @property
    def base(self) -> Fit:
        return self.fits[frozenset()]

    def fit(self, names: Iterable[str]) -> Fit:
        """The best fit of a set of effects. Raises KeyError where it was not refitted."""
        return self.fits[frozenset(names)]


def look_alike(effects: Mapping[str, tuple[Effect, ...]], one: str, other: str) -> bool:
    """Do the catalogue's authors expect the two to be hard to tell apart?"""
    return one == other or other in effects[one][0].look_alikes or one in effects[other][0].look_alikes


def any_alike(effects: Mapping[str, tuple[Effect, ...]], name: str, names: Iterable[str]) -> bool:
    """Is an effect, or what resembles it, in a set?"""
    return any(look_alike(effects, name, n) for n in names)


def alike_pairs(effects: Mapping[str, tuple[Effect, ...]], names: Iterable[str]) -> int:
    """How many pairs of a set look alike."""
    return sum(look_alike(effects, a, b) for a, b in combinations(sorted(names), 2))


def score(log_evidence: float, newtons: float, names: frozenset[str], pairs: int) -> float:
    """The score of a set of effects, nats: what a search maximises, for taking in, dropping, exchanging and ranking.

        ln evidence + newtons − EFFECT_NATS · effects − ALIKE_NATS · pairs that look alike

    newtons : :func:`.base.newton_nats` of the gap that is left; the last two terms are the prior of a set. A model
    without a force where its fit ended has the least score of all.
    """
    total = log_evidence + newtons - EFFECT_NATS * len(names) - ALIKE_NATS * pairs
    return total if isfinite(total) else -inf


def part(fit: Fit, problem: Problem) -> Array:
    """(ndim,) a fit's optimum in the coordinates of a model with fewer effects."""
    return fit.z[[fit.problem.names.index(n) for n in problem.names]]
