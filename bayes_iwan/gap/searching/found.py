"""A finished search: the fits of all sets of effects that were tried, and which effects look alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import BUILT_IN, FORM
from bayes_iwan.gap.fitting.data import GapData
from bayes_iwan.gap.fitting.evidence import Fit
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.scales import Scales
from bayes_iwan.inference.setup.settings import DiagnoseSettings

#: causes in the base's own form: every specimen differs a little from the family
OWN_FORM = frozenset(e.name for e in FORM)
#: these, and others so flexible that they are sought only beside what the rest explains
LAST = frozenset(e.name for e in (*FORM, *(e for e in BUILT_IN if e.flexible)))


@dataclass(frozen=True)
class Search:
    """All fits of one campaign.

    fits : the best fit of every set of effects that was refitted, the base under the empty set
    chosen : the set that explains most for its size, the effect that gains most first
    ends : weight of the chosen set, and of others that are worth all but as much or more (:func:`.ends.ends_of`)
    effects : every law on offer by effect; failed : effects without a finite force or calibration, and why
    """

    data: GapData
    scales: Scales
    settings: DiagnoseSettings
    fits: Mapping[frozenset[str], Fit]
    chosen: tuple[str, ...]
    ends: Mapping[frozenset[str], float]
    effects: Mapping[str, tuple[Effect, ...]]
    failed: Mapping[str, str] = field(default_factory=dict)

    @property
    def base(self) -> Fit:
        return self.fits[frozenset()]

    def fit(self, names: Iterable[str]) -> Fit:
        """The best fit of a set of effects. Raises KeyError where it was not refitted."""
        return self.fits[frozenset(names)]

    def rivals(self, name: str) -> dict[str, Fit]:
        """Fits with one effect of the chosen set exchanged, by what stands in its place (itself included)."""
        others = frozenset(self.chosen) - {name}
        return {
            next(iter(key - others)): fit
            for key, fit in self.fits.items()
            if others < key and len(key) == len(others) + 1
        }


def look_alike(effects: Mapping[str, tuple[Effect, ...]], one: str, other: str) -> bool:
    """Do the catalogue's authors expect the two to be hard to tell apart?"""
    return one == other or other in effects[one][0].look_alikes or one in effects[other][0].look_alikes


def needed(
    effects: Mapping[str, tuple[Effect, ...]], stood_in: Mapping[str, frozenset[str]], names: frozenset[str]
) -> bool:
    """May a set hold all its effects? Not one that was dropped beside others, `stood_in`, which stood in for it: those
    of them that look like it if there are any, else all, while they are in the set."""
    for name in names & stood_in.keys():
        others = stood_in[name]
        alike = frozenset(n for n in others if look_alike(effects, name, n))
        if (alike or others) <= names and (others or len(names) == 1):
            return False
    return True


def part(fit: Fit, problem: Problem) -> Array:
    """(ndim,) a fit's optimum in the coordinates of a model with fewer effects."""
    return fit.z[[fit.problem.names.index(n) for n in problem.names]]
