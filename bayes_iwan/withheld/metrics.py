"""The figures of a set of scored cases: what is named, what is flagged, whether probabilities and shares hold.

A cause is *visible* if what it leaves, once the specimen's parameters have moved, is above the noise of the force
channel. Shares of the gap are in RMS, shared among overlapping causes by Shapley's value. Intervals are at 95 %:
Clopper–Pearson for shares of cases, bootstrap over cases for the others.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from bayes_iwan.virtual_rig.faults import CATALOGUE
from bayes_iwan.withheld.case_score import CaseScore, Marginal
from bayes_iwan.withheld.estimates import Estimate, binned, bootstrap, share

#: shares of the gap are right within this
SHARE_POINTS = 0.10
#: bins of stated probability, of the calibration error and of the reliability diagram
ERROR_BINS, BINS = 10, 5


def summarise(cases: Sequence[CaseScore], seed: int = 0) -> dict[str, Estimate]:
    """The score table: what is measured, by name, in the order in which it is read."""
    rng = np.random.default_rng(seed)

    def kind(*names: str) -> list[CaseScore]:
        return [c for n in names for c in cases if c.kind == n]

    single, both = kind("single"), kind("pair", "triple")
    beside, outside = kind("known_beside_outside"), kind("outside")
    clear = [c for c in single if c.visible]
    alone = [c for c in clear if c.one_frequency]
    parts = [(c, cause) for c in both for cause in c.truth.causes]
    clear_parts = [(c, cause) for c, cause in parts if c.truth.seen(cause)]
    known_seen = [c for c in beside if all(c.truth.seen(k) for k in c.truth.listed)]
    unlisted_seen = [c for c in beside if all(c.truth.seen(k) for k in c.truth.causes if not k.listed)]
    whole = kind("single", "pair", "triple")
    answered = [c for c in cases if c.answered]
    shares = [(named, true) for c in cases for named, true in c.shares]
    marginals = [m for c in answered for m in c.marginals]
    causes = [m for c in answered for m in c.stated]
    return {
        "single, gap visible: named": share([c.found for c in clear]),
        "single, gap visible: named or in the set": share([c.in_set for c in clear]),
        "single, gap visible, one frequency: named or in the set": share([c.in_set for c in alone]),
        "single, gap visible: names in the set": bootstrap([len(c.answer.in_sets) for c in clear if c.found], rng),
        "single, all: named": share([c.found for c in single]),
        "single, all: named or in the set": share([c.in_set for c in single]),
        "pairs and triples: effects named": share([p.name in c.answer.names for c, p in parts]),
        "pairs and triples: effects named or in a set": share([p.name in c.answer.in_sets for c, p in parts]),
        "pairs and triples: visible effects named": share([p.name in c.answer.names for c, p in clear_parts]),
        "pairs and triples: all of a case's effects named": share([c.found for c in both]),
        "known beside unknown: known one named": share([c.found for c in beside]),
        "known beside unknown: known one named, if visible": share([c.found for c in known_seen]),
        "known beside unknown: unknown cause flagged": share([c.answer.unknown_cause for c in beside]),
        "known beside unknown: unknown cause flagged, if visible": share(
            [c.answer.unknown_cause for c in unlisted_seen]
        ),
        "known beside unknown: both": share([c.found and c.answer.unknown_cause for c in beside]),
        "outside alone: called unknown": share([c.answer.kind == "unknown" for c in outside]),
        "outside alone, gap visible: called unknown": share([c.answer.kind == "unknown" for c in outside if c.visible]),
        "outside alone: called none": share([c.answer.kind == "none" for c in outside]),
        "no fault: a cause named or a unknown cause flagged (false alarm)": share(
            [c.answer.kind != "none" for c in kind("none")]
        ),
        "no fault: a cause named": share([bool(c.answer.names) for c in kind("none")]),
        "all cases: a false name": share([bool(c.false_names) for c in cases]),
        "all cases: a false name, none of the set true": share([c.far_off for c in cases]),
        "all cases: a name that is no effect of the rig": share([bool(c.answer.names - set(CATALOGUE)) for c in cases]),
        "listed causes alone: a unknown cause flagged": share([c.answer.unknown_cause for c in whole]),
        "share of the gap: within 10 points": share([abs(n.share - t) <= SHARE_POINTS for n, t in shares]),
        "share of the gap: in its 90 % interval": share([n.share_low <= t <= n.share_high for n, t in shares]),
        "share of the gap: stated less true": bootstrap([n.share - t for n, t in shares], rng),
        "share on held-out tests: in its 90 % interval": share([c for case in cases for c in case.held_out]),
        "share found on sealed tests: in its 90 % interval": share([c for case in cases for c in case.sealed]),
        "probability that an effect contributes: less frequency": _bias(marginals, rng),
        "probability that an effect contributes: calibration error": _error(marginals, rng),
        "probability of causes named: less frequency": _bias(causes, rng),
        "probability of causes named: calibration error": _error(causes, rng),
        "log score, nats a case": bootstrap([c.log_score for c in cases], rng),
        "Brier score, sum over labels": bootstrap([c.brier for c in cases], rng),
    }


def _bias(marginals: Sequence[Marginal], rng: np.random.Generator) -> Estimate:
    return bootstrap([m.stated - m.true for m in marginals], rng)


def _error(marginals: Sequence[Marginal], rng: np.random.Generator) -> Estimate:
    return bootstrap([m.stated + 2.0 * m.true for m in marginals], rng, calibration_error)


def calibration_error(answers: np.ndarray, axis: int) -> np.ndarray:
    """Mean distance of stated probability and frequency over bins, weighed by their answers, along the last axis.

    answers : stated + 2 where true: one number each, for the bootstrap.
    """
    true = answers >= 2.0
    miss = answers - 3.0 * true  # stated less 1 where true
    which = np.minimum(np.round((answers - 2.0 * true) * ERROR_BINS, 9).astype(int), ERROR_BINS - 1)
    by_bin = [np.abs(np.sum(np.where(which == k, miss, 0.0), axis=axis)) for k in range(ERROR_BINS)]
    return np.asarray(np.sum(by_bin, axis=0) / answers.shape[axis])


def reliability(cases: Sequence[CaseScore]) -> list[tuple[float, Estimate]]:
    """Probability stated of causes named against how often they were true, in bins of equal width."""
    said = [m for c in cases if c.answered for m in c.stated]
    return binned([m.stated for m in said], [m.true for m in said], np.linspace(0, 1, BINS + 1).tolist())


def confusion(cases: Sequence[CaseScore]) -> tuple[tuple[str, ...], tuple[str, ...], np.ndarray]:
    """Truths (rows), verdicts (columns), and how often each met each, over cases of at most one cause.

    A verdict that names several counts once for each.
    """
    order = {label: i for i, label in enumerate(("none", "unknown", *CATALOGUE))}
    met: dict[tuple[str, str], int] = {}
    for c in cases:
        if c.kind in ("none", "single", "outside"):
            row = {"none": "none", "outside": "unknown"}.get(c.kind) or c.truth.causes[0].name
            for column in sorted(c.answer.names) or [c.answer.kind]:
                met[row, column] = met.get((row, column), 0) + 1

    def ordered(labels: set[str]) -> tuple[str, ...]:
        return tuple(sorted(labels, key=lambda label: (order.get(label, len(order)), label)))

    rows, columns = ordered({r for r, _ in met}), ordered({r for r, _ in met} | {c for _, c in met})
    counts = np.array([[met.get((r, c), 0) for c in columns] for r in rows], dtype=float)
    return rows, columns, counts.reshape(len(rows), len(columns))


def by_law(cases: Sequence[CaseScore]) -> dict[str, tuple[Estimate, Estimate]]:
    """Visible listed causes named, and named or in a set, by "name:law"."""
    seen = [(c, k) for c in cases for k in c.truth.listed if c.truth.seen(k)]
    return _by_label(
        (f"{k.name}:{k.law or '?'}", k.name in c.answer.names, k.name in c.answer.in_sets) for c, k in seen
    )


def by_outside(cases: Sequence[CaseScore]) -> dict[str, tuple[Estimate, Estimate]]:
    """Visible causes from outside the catalogue flagged as unknown, and cases of theirs with a false name, by name."""
    seen = [(c, k) for c in cases for k in c.truth.causes if not k.listed and c.truth.seen(k)]
    return _by_label((k.name, c.answer.unknown_cause, bool(c.false_names)) for c, k in seen)


def _by_label(hits: Iterable[tuple[str, bool, bool]]) -> dict[str, tuple[Estimate, Estimate]]:
    """Shares of the first and of the second hits, by label."""
    of: dict[str, list[tuple[bool, bool]]] = {}
    for label, *both in hits:
        of.setdefault(label, []).append((both[0], both[1]))
    return {label: (share([a for a, _ in some]), share([b for _, b in some])) for label, some in sorted(of.items())}
