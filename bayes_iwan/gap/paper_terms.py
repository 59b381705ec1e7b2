"""Starting from a model without the paper's terms: which of them a campaign needs, one after the other.

The search over effects goes to pairs; Eqs. (11) and (12) are three terms, and one of them (k(α)) does nothing until
another has made α vary. So they are selected first, forward, and the ordinary diagnosis is made on top of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import Maker
from bayes_iwan.gap.attribution import Attribution, Table, attribute
from bayes_iwan.gap.data import GapData
from bayes_iwan.gap.evidence import SHARES, Fit, fit_model
from bayes_iwan.gap.search import Search, candidates, fit_base
from bayes_iwan.gap.strength import calibrated
from bayes_iwan.inference.scales import Scales

#: a term is taken in if it gains so many nats over the model without it
WORTH_NATS = 8.0


@dataclass(frozen=True)
class Step:
    """One term taken in: its name, the model with it and all before it, and the ln evidence gained by it."""

    name: str
    fit: Fit
    gain: float


@dataclass(frozen=True)
class Terms:
    """The terms taken in, in that order; `alone` are all terms on the bare base, as far as they were refitted."""

    bare: Fit
    steps: tuple[Step, ...]
    alone: dict[str, Fit]
    effects: dict[str, tuple[Effect, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.steps)

    @property
    def fit(self) -> Fit:
        """The model with all of them."""
        return self.steps[-1].fit if self.steps else self.bare

    def search(self, data: GapData, scales: Scales, config: dict) -> Search:
        """The same as a search: each term alone, and the first two as a pair that stands for the whole sequence."""
        pairs: dict[tuple[str, str], Fit] = {}
        if len(self.steps) > 1:
            a, b = sorted(self.names[:2])
            pairs[a, b] = self.fit
        singles: dict[str, tuple[Fit, ...]] = {n: (self.alone[n],) if n in self.alone else () for n in self.effects}
        if len(self.steps) == 1:
            singles[self.names[0]] = (self.fit,)
        return Search(data, scales, config, self.bare, singles, pairs, self.effects)

    def attribution(self, found: Search) -> Attribution:
        """Weights of bare base, terms alone and the sequence, which counts for the term taken in first."""
        table = Table.of(found)
        log_z = {k: v for k, v in table.log_z.items() if len(k) < 2} | {(self.names[0],): self.fit.log_z}
        result = attribute(replace(table, log_z=log_z))
        second = self.names[1] if len(self.steps) > 1 and result.cause == self.names[0] else None
        return replace(result, second_cause=second)


def evidence_of(fit: Fit) -> float:
    """ln evidence with any size of smooth misfit beside the model: a term must earn its place against that, too."""
    return fit.log_evidence(np.full(len(SHARES), -np.log(len(SHARES))))


def select_terms(
    data: GapData,
    scales: Scales,
    config: dict,
    kinds: Mapping[str, tuple[Maker, ...]],
    rng: np.random.Generator,
    progress: Callable[[str], None] = lambda what: None,
) -> Terms:
    """Forward selection of `kinds` on the base model: the best next term, as long as it gains WORTH_NATS."""
    progress("base model")
    bare = current = fit_base(data, config, scales, rng)
    left = dict(kinds)
    steps: list[Step] = []
    alone: dict[str, Fit] = {}
    effects: dict[str, tuple[Effect, ...]] = {}
    while left:
        on_offer = {
            name: tuple(calibrated(k, scales, data, current.problem, current.z) for k in classes)
            for name, classes in left.items()
        }
        effects = {**on_offer, **effects}
        fits = {}
        for one in candidates(data, current, on_offer):
            progress(one.name)
            fits[one.name] = fit_model(data, one.problem, one.starts)
        if not steps:
            alone = dict(fits)
        best = max(fits, key=lambda n: evidence_of(fits[n]))
        gain = evidence_of(fits[best]) - evidence_of(current)
        if gain < WORTH_NATS:
            break
        current = fits[best]
        steps.append(Step(best, current, gain))
        del left[best]
    return Terms(bare, tuple(steps), alone, effects)
