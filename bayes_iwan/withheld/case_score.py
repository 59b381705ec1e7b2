"""One withheld case, scored: its truth and its answer side by side."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_iwan.virtual_rig.faults import CATALOGUE
from bayes_iwan.withheld.answers import Answer, Named, read_answer
from bayes_iwan.withheld.truths import Truth

LOWEST_PROBABILITY = 1e-3  # an answer of 0 that comes true costs −ln of this, not infinity
#: what stands for a missing answer: nothing is named, every probability is a coin's
SILENT = Answer("none", (), False, float("nan"), {})


@dataclass(frozen=True)
class Marginal:
    """A probability that was stated, and whether it came true."""

    label: str
    stated: float
    true: bool


@dataclass(frozen=True)
class CaseScore:
    """Truth and answer of one case; `sealed`: whether the share found on sealed tests lies in each cause's interval."""

    name: str
    truth: Truth
    answer: Answer
    answered: bool
    sealed: tuple[bool, ...]

    @property
    def kind(self) -> str:
        return self.truth.kind

    @property
    def found(self) -> bool:
        """Every listed cause is named."""
        return bool(self.truth.listed) and all(c.name in self.answer.names for c in self.truth.listed)

    @property
    def in_set(self) -> bool:
        """Every listed cause is named or among what is tied with a named one."""
        return bool(self.truth.listed) and all(c.name in self.answer.in_sets for c in self.truth.listed)

    @property
    def visible(self) -> bool:
        """All its causes leave a gap above the noise."""
        return bool(self.truth.causes) and all(self.truth.seen(c) for c in self.truth.causes)

    @property
    def one_frequency(self) -> bool:
        return self.truth.frequencies == 1

    @property
    def false_names(self) -> frozenset[str]:
        """Effects of the catalogue that are named and not there."""
        return self.answer.names & set(CATALOGUE) - {c.name for c in self.truth.causes}

    @property
    def far_off(self) -> bool:
        """A false name whose look-alikes hold no true cause either."""
        true = {c.name for c in self.truth.causes}
        return any(c.name in self.false_names and not c.alike & true for c in self.answer.causes)

    @property
    def shares(self) -> tuple[tuple[Named, float], ...]:
        """True causes that are named with a share of the gap, and their true shares."""
        true = {n: x for n, x in self.truth.shares(self.answer.names).items() if np.isfinite(x)}
        return tuple((n, true[n.name]) for n in self.answer.causes if n.name in true and np.isfinite(n.share))

    @property
    def held_out(self) -> tuple[bool, ...]:
        """For each named cause with a share on held-out tests: whether that lies in the interval stated for it."""
        return tuple(
            n.share_low <= n.share_held_out <= n.share_high for n in self.answer.causes if np.isfinite(n.share_held_out)
        )

    @property
    def marginals(self) -> tuple[Marginal, ...]:
        """Probabilities that each effect contributes, against whether it does; causes too small to be seen omitted."""
        hidden = {c.name for c in self.truth.listed if not self.truth.seen(c)}
        true = {c.name for c in self.truth.listed}
        p = self.answer.probabilities
        return tuple(Marginal(n, p.get(n, 0.0), n in true) for n in CATALOGUE if n not in hidden)

    @property
    def stated(self) -> tuple[Marginal, ...]:
        """Probabilities of the causes named, against whether they are there."""
        true = {c.name for c in self.truth.causes}
        said = [n for n in self.answer.causes if n.name in CATALOGUE and np.isfinite(n.probability)]
        return tuple(Marginal(n.name, n.probability, n.name in true) for n in said)

    def _labels(self) -> tuple[Marginal, ...]:
        """All that is stated: effects, none, an unknown cause. One too small to be seen is not asked for."""
        p = self.answer.probabilities
        more = [Marginal("none", p.get("none", 0.0), self.kind == "none")]
        unlisted = [c for c in self.truth.causes if not c.listed]
        if all(self.truth.seen(c) for c in unlisted):
            more.append(Marginal("unknown_cause", p.get("unknown_cause", 0.0), bool(unlisted)))
        return (*self.marginals, *more)

    @property
    def log_score(self) -> float:
        """−ln of what the answer gave to what is true, summed over labels, in nats; ln 2 each for a missing answer."""
        if not self.answered:
            return len(self._labels()) * float(np.log(2.0))
        p = np.array([m.stated if m.true else 1.0 - m.stated for m in self._labels()])
        return -float(np.sum(np.log(np.maximum(p, LOWEST_PROBABILITY))))

    @property
    def brier(self) -> float:
        """Squared distance of stated from true, summed over labels."""
        return float(sum(((m.stated if self.answered else 0.5) - m.true) ** 2 for m in self._labels()))


def score_case(
    name: str, truth: Truth, answer: Mapping[str, object] | None, found: Mapping[str, float] | None = None
) -> CaseScore:
    """Compare one answer (the content of a `diagnosis.json`, or None) with the truth.

    found : share of the gap that each named cause removes on sealed tests, by cause.
    """
    read, found = SILENT if answer is None else read_answer(name, answer), found or {}
    asked = [c for c in read.causes if c.name in found and np.isfinite(c.share_low)]
    sealed = tuple(c.share_low <= found[c.name] <= c.share_high for c in asked)
    return CaseScore(name, truth, read, answer is not None, sealed)
