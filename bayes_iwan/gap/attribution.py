"""From fits to probabilities over causes, and what these tests could not have shown.

Hypotheses are models with a discrepancy of a certain size beside them. The base with a small discrepancy is *none*
(any real specimen differs a little from the family); the base with a large one is *unknown*; a named effect must
close the gap down to a small one; a pair likewise. Evidence over-counts when all models are a little wrong, so it is
tempered, and the constants below were fitted to cases from the virtual rig (`analyses/calibrate_diagnosis.py`).
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .evidence import LENGTHS, SHARES, Fit
from .search import Search

Array = NDArray[np.float64]

CALIBRATION = Path(__file__).with_name("calibration.json")
#: share of a cause's probability that goes to unknown (or none) where it does not shrink the gap
DOUBT = 0.9
#: nats that an effect costs which explains nothing
IDLE_COST = 5.0


@dataclass(frozen=True)
class Calibration:
    """Constants of the answer, fitted to cases from the virtual rig.

    small, large : median and sd of ln share of the two discrepancies; law : share of the base's own gap that a named
    effect may leave, since nature's law is not the catalogue's (laws : by name where it is another); temper : power of
    the evidence, beyond `linear` nats it counts by its asinh; none, unknown, pair : ln prior odds against one named
    effect; rough_pair : added for pairs with one of `laws`, whose law's own error a second effect likes to mend;
    effect : the same for effects that absorb a specimen's own oddities; apart : nats within which causes cannot be
    told apart; sure : the most that any answer may claim, as often as the surest answers proved right.
    """

    small: tuple[float, float] = (0.0025, 0.7)
    large: tuple[float, float] = (0.03, 0.9)
    law: float = 0.08
    laws: dict[str, float] | None = None
    temper: float = 0.6
    linear: float = 8.0
    none: float = 3.0
    unknown: float = 1.0
    pair: float = -4.0
    rough_pair: float = 0.0
    effect: dict[str, float] | None = None
    apart: float = 3.0
    sure: float = 0.92

    @property
    def log_small(self) -> Array:
        return _log_normal(*self.small)

    @property
    def log_large(self) -> Array:
        return _log_normal(*self.large)

    def log_named(self, names: tuple[str, ...], gap_share: float) -> Array:
        """Prior over the discrepancy beside named effects, for a base model that needs `gap_share` on its own."""
        law = max((self.laws or {}).get(n, self.law) for n in names)
        return _log_normal(float(np.hypot(self.small[0], law * gap_share)), self.small[1])

    def score(self, nats: Array) -> Array:
        """Tempered evidence against the best: linear near zero, growing slowly far below."""
        return self.temper * self.linear * np.arcsinh(np.asarray(nats) / self.linear)

    def save(self, path: Path = CALIBRATION) -> None:
        path.write_text(json.dumps(asdict(self), indent=1) + "\n")


@cache
def calibration() -> Calibration:
    """The calibration shipped with the package."""
    stored = json.loads(CALIBRATION.read_text())
    return Calibration(**{**stored, "small": tuple(stored["small"]), "large": tuple(stored["large"])})


def _log_normal(median: float, sd: float) -> Array:
    p = -0.5 * ((np.log(SHARES) - np.log(median)) / sd) ** 2
    return p - np.logaddexp.reduce(p)


@dataclass(frozen=True)
class Table:
    """What the probabilities are made from: ln evidence over the discrepancy grid of every model, by causes.

    Keys are tuples of names: () the base, (a,) one effect, (a, b) a pair, sorted. Effects with variants are averaged;
    effects that promised nothing and were not refitted stand as the base with the cost of a number it does not need.
    """

    log_z: dict[tuple[str, ...], Array]

    @classmethod
    def of(cls, found: Search) -> Table:
        out: dict[tuple[str, ...], Array] = {(): found.base.log_z}
        for name, fits in found.singles.items():
            idle = found.base.log_z - IDLE_COST
            stack = np.stack([f.log_z for f in fits] + [idle] * (len(found.effects[name]) - len(fits)))
            out[(name,)] = np.logaddexp.reduce(stack, axis=0) - np.log(len(stack))
        for key, fit in found.pairs.items():
            out[key] = fit.log_z
        return cls(out)

    def evidence(self, key: tuple[str, ...], log_prior: Array) -> float:
        """ln evidence of a hypothesis under a prior over the discrepancy's share."""
        return float(np.logaddexp.reduce((self.log_z[key] + log_prior[:, None]).ravel()) - np.log(len(LENGTHS)))

    @property
    def gap_share(self) -> float:
        """The discrepancy that the base model needs on its own (median of its posterior over the grid)."""
        weight = np.exp(self.log_z[()].max(axis=1) - self.log_z[()].max())
        return float(np.exp(np.sum(weight * np.log(SHARES)) / weight.sum()))


@dataclass(frozen=True)
class Attribution:
    """Probabilities over causes: "none", "unknown" and every effect (as the cause, or first of two); and the pair."""

    probabilities: dict[str, float]
    cause: str
    second_cause: str | None
    cannot_tell_apart: tuple[str, ...]
    hypotheses: dict[tuple[str, ...], float]        # ln weight of every hypothesis, ("unknown",) included

    @property
    def probability(self) -> float:
        return self.probabilities[self.cause]


def attribute(table: Table, sizes: dict[tuple[str, ...], dict[str, float]] | None = None,
              constants: Calibration | None = None) -> Attribution:
    """Weigh the hypotheses. sizes : for pairs, the size of each effect, which decides the first cause."""
    c = constants or calibration()
    offsets = c.effect or {}
    nats: dict[tuple[str, ...], float] = {}
    prior: dict[tuple[str, ...], float] = {}
    for key in table.log_z:
        nats[key] = table.evidence(key, c.log_named(key, table.gap_share) if key else c.log_small)
        prior[key] = {0: c.none, 1: 0.0, 2: c.pair}[len(key)] + sum(offsets.get(n, 0.0) for n in key)
        if len(key) == 2 and any(n in (c.laws or {}) for n in key):
            prior[key] += c.rough_pair
    nats["unknown",] = table.evidence((), c.log_large)
    prior["unknown",] = c.unknown
    total = {k: nats[k] + prior[k] for k in nats}
    best = max(total.values())
    weight = {k: float(c.score(np.array(v - best))) for k, v in total.items()}
    normal = np.logaddexp.reduce(list(weight.values()))
    p: dict[str, float] = {"none": 0.0, "unknown": 0.0} | {k[0]: 0.0 for k in table.log_z if len(k) == 1}
    for key, w in weight.items():
        share = float(np.exp(w - normal))
        if len(key) == 2:
            first = max(key, key=lambda n: (sizes or {}).get(key, {}).get(n, 0.0))
            p[first] += share
        else:
            p[key[0] if key else "none"] += share
    p = _not_too_sure(p, c.sure)
    leader = max(weight, key=lambda k: weight[k])
    cause = max(p, key=lambda n: p[n])
    second = None
    if len(leader) == 2 and cause in leader:
        second = leader[0] if leader[1] == cause else leader[1]
    apart = [n for n in p if n not in ("none", "unknown")
             and total.get((n,), -np.inf) > total.get((cause,), best) - c.apart]
    if second is not None:
        pairs: dict[tuple[str, ...], float] = {k: total[k] for k in total if len(k) == 2}
        near = {n for k, v in pairs.items() if v > pairs[leader] - c.apart for n in k}
        apart = [n for n in p if n in near]
    members = tuple(sorted(set(apart) | {cause}, key=lambda n: -p[n])) if cause not in ("none", "unknown") else ()
    return Attribution(p, cause, second, members, weight)


def doubted(given: Attribution, instead: str) -> Attribution:
    """The same answer where the cause, once in the model, leaves the gap as it was: then it is no cause, however much
    evidence it gathered, and most of its probability goes to `instead`, "unknown" or "none"."""
    p = dict(given.probabilities)
    moved = DOUBT * p[given.cause]
    p[given.cause] -= moved
    p[instead] += moved
    return Attribution(p, max(p, key=lambda n: p[n]), None, (), given.hypotheses)


def _not_too_sure(p: dict[str, float], sure: float) -> dict[str, float]:
    """What is held back from sure answers: half of it is for causes that no catalogue lists, half for every answer."""
    rest = 0.5 * (1.0 - sure)
    return {n: sure * v + rest / len(p) + (rest if n == "unknown" else 0.0) for n, v in p.items()}


def best_fit(found: Search, key: tuple[str, ...]) -> Fit:
    """The fit of a hypothesis (the better variant)."""
    if not key:
        return found.base
    if len(key) == 2:
        return found.pairs[key[0], key[1]]
    return max(found.singles[key[0]], key=lambda f: f.log_z.max())
