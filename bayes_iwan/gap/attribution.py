"""From fits to probabilities over causes, and what these tests could not have shown.

Hypotheses are models with a discrepancy of a certain size beside them. The base with a small discrepancy is *none*
(any real specimen differs a little from the family); the base with a large one is *unknown*; a named effect must
close the gap down to a small one; a pair likewise. Evidence over-counts when all models are a little wrong, so it is
tempered, and the constants below were fitted to cases from the virtual rig (`analyses/calibrate_diagnosis.py`).
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from bayes_iwan.arrays import Array
from bayes_iwan.gap.evidence import LENGTHS, SHARES, Fit
from bayes_iwan.gap.search import Search

CALIBRATION = Path(__file__).with_name("calibration.json")
#: grid on which evidence is integrated over the discrepancy's share; between the fits' own points it is interpolated
FINE = np.geomspace(SHARES[0], SHARES[-1], 67)
#: share of a cause's probability that goes to unknown (or none) where it does not shrink the gap
DOUBT = 0.9
#: a cause as probable as this is told beside "none" or "unknown"
NOT_EXCLUDED = 0.05
#: nats that an effect costs which explains nothing
IDLE_COST = 5.0


@dataclass(frozen=True)
class Calibration:
    """Constants of the answer, fitted to cases from the virtual rig.

    small, large : median and sd of ln share of the two discrepancies; law : share of the base's own gap that a named
    effect may leave, since nature's law is not the catalogue's (laws : by name where it is another), law_spread : sd
    of its logarithm; temper : power of the evidence between kinds of answer (none, unknown, one cause, two), within :
    among causes, beyond `linear` nats it counts by its asinh; none, unknown, unlisted, pair : ln prior odds against
    one named effect, unlisted those of a shape without a cause; rough_pair : added for pairs with one of `laws`, whose
    law's own error a second effect likes to mend; effect : the same for effects that absorb a specimen's own oddities;
    apart : nats within which causes cannot be told apart; sure : the most that any answer may claim, as often as the
    surest answers proved right.
    """

    small: tuple[float, float] = (0.0025, 0.7)
    large: tuple[float, float] = (0.03, 0.9)
    law: float = 0.08
    law_spread: float = 0.5
    laws: dict[str, float] | None = None
    temper: float = 0.6
    within: float = 0.6
    linear: float = 8.0
    none: float = 3.0
    unknown: float = 1.0
    unlisted: float = 0.0
    pair: float = -4.0
    rough_pair: float = 0.0
    effect: dict[str, float] | None = None
    apart: float = 3.0
    sure: float = 0.92

    @property
    def log_small(self) -> Array:
        return _log_normal(SHARES, *self.small)

    def log_named(self, names: tuple[str, ...], gap_share: float) -> tuple[float, float]:
        """Median and sd of ln share of the discrepancy beside named effects, for a base model that needs `gap_share`
        on its own: a sound specimen's and the law's own error together."""
        law = max((self.laws or {}).get(n, self.law) for n in names)
        median = float(np.hypot(self.small[0], law * gap_share))
        own = (self.small[0] / median) ** 2
        return median, float(np.sqrt(own * self.small[1] ** 2 + (1.0 - own) * self.law_spread**2))

    def score(self, nats: Array, temper: float) -> Array:
        """Tempered evidence against the best: linear near zero, growing slowly far below."""
        return temper * self.linear * np.arcsinh(np.asarray(nats) / self.linear)

    def save(self, path: Path = CALIBRATION) -> None:
        path.write_text(json.dumps(asdict(self), indent=1) + "\n")


@cache
def calibration() -> Calibration:
    """The calibration shipped with the package."""
    stored = json.loads(CALIBRATION.read_text())
    return Calibration(**{**stored, "small": tuple(stored["small"]), "large": tuple(stored["large"])})


def _log_normal(shares: Array, median: float, sd: float) -> Array:
    p = -0.5 * ((np.log(shares) - np.log(median)) / sd) ** 2
    return p - np.logaddexp.reduce(p)


@dataclass(frozen=True)
class Table:
    """What the probabilities are made from: ln evidence over the discrepancy grid of every model, by causes.

    Keys are tuples of names: () the base, (a,) one effect, (a, b) a pair, sorted. Effects with variants are averaged;
    effects that promised nothing and were not refitted stand as the base with the cost of a number it does not need.
    unlisted : the same of shapes that stand for no cause.
    """

    log_z: dict[tuple[str, ...], Array]
    unlisted: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Search) -> Table:
        out: dict[tuple[str, ...], Array] = {(): found.base.log_z}
        for name, fits in found.singles.items():
            idle = found.base.log_z - IDLE_COST
            stack = np.stack([f.log_z for f in fits] + [idle] * (len(found.effects[name]) - len(fits)))
            out[(name,)] = np.logaddexp.reduce(stack, axis=0) - np.log(len(stack))
        for key, fit in found.pairs.items():
            out[key] = fit.log_z
        return cls(out, {n: f.log_z for n, f in found.unlisted.items()})

    @cached_property
    def by_share(self) -> Array:
        """ln evidence over FINE, lengths averaged: causes, then shapes, (models, shares)."""
        rough = np.stack([*self.log_z.values(), *self.unlisted.values()])
        over_lengths = np.logaddexp.reduce(rough, axis=2) - np.log(len(LENGTHS))
        return PchipInterpolator(np.log(SHARES), over_lengths, axis=1)(np.log(FINE))

    def evidence(self, c: Calibration) -> dict[tuple[str, ...], float]:
        """ln evidence of every hypothesis; ("unknown",) is the base with a large misfit, ("unknown", shape) a shape."""
        keys = [*self.log_z, *(("unknown", n) for n in self.unlisted)]
        own = {k: c.log_named(k, self.gap_share) if k else c.small for k in keys}
        prior = {form: _log_normal(FINE, *form) for form in {*own.values(), c.large}}
        rows = np.concatenate(
            [
                self.by_share + np.stack([prior[own[k]] for k in keys]),
                self.by_share[keys.index(())][None] + prior[c.large],
            ]
        )
        top = rows.max(axis=1)
        values = top + np.log(np.exp(rows - top[:, None]).sum(axis=1))
        return dict(zip([*keys, ("unknown",)], values.tolist()))

    @cached_property
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
    hypotheses: dict[tuple[str, ...], float]  # ln probability of every hypothesis, ("unknown",) included
    shape: str | None = None  # the shape without a cause that "unknown" looks like, if any

    @property
    def probability(self) -> float:
        return self.probabilities[self.cause]


def attribute(
    table: Table, sizes: dict[tuple[str, ...], dict[str, float]] | None = None, constants: Calibration | None = None
) -> Attribution:
    """Weigh the hypotheses: first the kinds of answer by the best of each kind, then causes within their kind.

    sizes : for pairs, the size of each effect, which decides the first cause.
    """
    c = constants or calibration()
    offsets = c.effect or {}
    total = table.evidence(c)
    kinds: dict[str, dict[tuple[str, ...], float]] = {"none": {}, "unknown": {}, "one": {}, "two": {}}
    for key in total:
        kind = "none" if not key else "unknown" if key[0] == "unknown" else ("one", "two")[len(key) - 1]
        prior = {"none": c.none, "unknown": c.unlisted if len(key) == 2 else c.unknown, "one": 0.0, "two": c.pair}[kind]
        total[key] += prior + sum(offsets.get(n, 0.0) for n in key)
        if kind == "two" and any(n in (c.laws or {}) for n in key):
            total[key] += c.rough_pair
        kinds[kind][key] = total[key]
    best = max(total.values())
    weight: dict[tuple[str, ...], float] = {}
    for some in kinds.values():
        if some:
            first = max(some.values())
            inside = c.score(np.array(list(some.values())) - first, c.within)
            inside += float(c.score(np.array(first - best), c.temper)) - np.logaddexp.reduce(inside)
            weight |= dict(zip(some, inside.tolist()))
    normal = float(np.logaddexp.reduce(list(weight.values())))
    weight = {k: w - normal for k, w in weight.items()}
    p: dict[str, float] = {"none": 0.0, "unknown": 0.0} | {k[0]: 0.0 for k in table.log_z if len(k) == 1}
    for key, w in weight.items():
        name = key[0] if key else "none"
        if key in kinds["two"]:
            name = max(key, key=lambda n: (sizes or {}).get(key, {}).get(n, 0.0))
        p[name] += float(np.exp(w))
    p = _not_too_sure(p, c.sure)
    cause = max(p, key=lambda n: p[n])
    leader = max(weight, key=lambda k: weight[k])
    second = None
    if leader in kinds["two"] and cause in leader:
        second = leader[0] if leader[1] == cause else leader[1]
        near = {n for k, v in kinds["two"].items() if v > total[leader] - c.apart for n in k}
    else:
        near = {k[0] for k, v in kinds["one"].items() if v > total.get((cause,), best) - c.apart}
    if cause in ("none", "unknown"):
        near = {n for n in p if p[n] > NOT_EXCLUDED and n not in ("none", "unknown")}
    members = tuple(sorted(near | ({cause} - {"none", "unknown"}), key=lambda n: -p[n]))
    shape = max(kinds["unknown"], key=lambda k: total[k])
    return Attribution(p, cause, second, members, weight, shape[1] if len(shape) == 2 else None)


def doubted(given: Attribution, instead: str) -> Attribution:
    """The same answer where the cause, once in the model, leaves the gap as it was: then it is no cause, however much
    evidence it gathered, and most of its probability goes to `instead`, "unknown" or "none"."""
    p = dict(given.probabilities)
    moved = DOUBT * p[given.cause]
    p[given.cause] -= moved
    p[instead] += moved
    return Attribution(p, max(p, key=lambda n: p[n]), None, (), given.hypotheses, given.shape)


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
