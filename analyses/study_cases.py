"""What a study keeps of a case (`calibrate_diagnosis.py study`), what constants name there, and how it is scored."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayes_iwan.gap.judging.budget import NO_CAUSE, Share, contributing, left_unnamed, rest_without_name
from bayes_iwan.gap.judging.calibration import Calibration, rest_figures
from bayes_iwan.gap.judging.guards import Figures
from bayes_iwan.gap.judging.verdict import helping, named_by, one_of
from bayes_iwan.gap.searching.base import USUAL_GAP
from bayes_iwan.gap.searching.found import OWN_FORM
from bayes_iwan.rig import cases as rig_cases
from bayes_iwan.validation.true_gaps import by_set, removed

#: power of a line at half a test's frequency over its background that no sound specimen reaches
CLEAR_LINE = 20.0
#: share of the gap from which a known effect beside a foreign one is counted apart
QUARTER = 0.25
#: foreign causes of whose kind a pattern without a cause stands (:mod:`bayes_iwan.effects.unlisted`), if by another law
WITH_PATTERN = frozenset({"quadratic_drag", "sensor_hysteresis", "cell_hysteresis"})


def figures_of(case: dict[str, Any]) -> list[Figures]:
    return [Figures(**f) for f in case["figures"]]


def truths(case: dict[str, Any]) -> set[str]:
    return {e["name"] for e in case["truth"]["effects"]}


def has_outside(case: dict[str, Any]) -> bool:
    return case["truth"]["kind"] in ("outside", "known_beside_outside")


def tags(case: dict[str, Any]) -> set[str]:
    """What is left out together with a case: the laws of its faults, an outside kind among them."""
    return {f"{e['name']}:{e['law']}" for e in case["truth"]["effects"]}


def named_in(case: dict[str, Any], c: Calibration) -> frozenset[str]:
    """What these constants name, less what does not make the gap smaller."""
    given, put_in, along = figures_of(case), by_set(case["share"]), by_set(case["along"])
    told = by_set(case["told"])

    def made(names: Sequence[str]) -> tuple[dict[str, float], dict[str, float]]:
        key = frozenset(names)
        return {n: min(put_in[key][n], told[key][n]) for n in names}, along[key]

    return frozenset(helping(named_by(given, c), made, given[0].before if given else 0.0))


def rest_row(case: dict[str, Any], c: Calibration) -> np.ndarray:
    """(figures,) of what is left beside the effects that these constants name."""
    return rest_figures(left_unnamed(named_in(case, c), by_set(case["gap_share"])), case["subharmonic"])


def rest_has_cause(case: dict[str, Any], c: Calibration) -> float:
    """The probability that these constants state."""
    return rest_without_name(c.unknown_rest(rest_row(case, c)), figures_of(case), c)


def rest_is_real(case: dict[str, Any], c: Calibration) -> bool:
    """Does a true effect, listed or not, that these constants do not name make a part of the gap that can be seen: more
    than noise, and more than a sound specimen's own gap or with a line that no sound specimen has?"""
    gap, named = by_set(case["gap_N"])[frozenset()], named_in(case, c)
    usual = USUAL_GAP * case["truth"]["friction_rms_N"]
    least = max(case["noise_N"], usual if case["subharmonic"] < CLEAR_LINE else 0.0)
    return any(share * gap > least for n, share in case["true_share"].items() if n not in named)


def score(cases: Sequence[dict[str, Any]], constants: Sequence[Calibration]) -> dict[str, tuple[float, float]]:
    """Counts (right, of) of the targets, each case with its own constants."""
    out: dict[str, list[float]] = {}

    def count(what: str, right: bool) -> None:
        out.setdefault(what, [0.0, 0.0])
        out[what][0] += right
        out[what][1] += 1

    for case, c in zip(cases, constants):
        given, true, kind = figures_of(case), truths(case), case["truth"]["kind"]
        named = {n for n in named_in(case, c) if n not in OWN_FORM}
        flagged = rest_has_cause(case, c) >= 0.5
        apart = {n for f in given if f.name in named for n, v in f.rivals.items() if v > -c.apart}
        if flagged:
            apart |= {n for some in one_of(given, sorted(named), c) for n in some.names}
        gap = by_set(case["gap_N"])[frozenset()]
        visible = {n for n, share in case["true_share"].items() if share * gap > case["noise_N"]}
        listed = {n for n in visible if n not in rig_cases.OUTSIDE}
        usual = USUAL_GAP * case["truth"]["friction_rms_N"]
        clear = {n for n in visible if case["true_share"][n] * gap > usual}
        false = {n for n in named - true if not ({r for f in given if f.name == n for r, v in f.rivals.items()
                                                  if v > -c.apart} & true)}  # fmt: skip
        count("false names (a name neither true nor tied with a true one), of all cases", bool(false))
        count("strict false names, of all cases", bool(named - true))
        if kind == "none":
            count("none: false alarm", bool(named) or flagged)
        if kind == "single" and listed:
            for what in ("visible", *(("larger than a sound specimen's gap",) if clear else ())):
                count(f"single, {what}: named", true <= named)
                count(f"single, {what}: named or in the set", true <= named | apart)
            if named:
                count("single, visible: something named, a rest flagged beside it", flagged)
            else:
                count("single, visible: nothing named, called unknown", flagged)
        if kind in ("pair", "triple"):
            for n in listed:
                count("pairs and triples: visible effect found", n in named)
                count("pairs and triples: visible effect found or in a set", n in named | apart)
                if n in clear:
                    count("pairs and triples: effect larger than a sound specimen's gap found", n in named)
        if kind == "known_beside_outside":
            for n in listed:
                count("known beside unknown: known named", n in named)
                count("known beside unknown: known named or in a set", n in named | apart)
                stands = "one" if WITH_PATTERN & set(case["true_share"]) else "none"
                count(
                    f"known beside unknown for which {stands} of the patterns without a cause stands: named", n in named
                )
                part = "a quarter of the gap or more" if case["true_share"][n] >= QUARTER else "less of the gap"
                count(f"known beside unknown: known that makes {part} named", n in named)
                if n in clear:
                    count("known beside unknown: known larger than a sound specimen's gap named", n in named)
            if visible - listed:
                count("known beside unknown: rest flagged", flagged)
            if clear - listed:
                count("known beside unknown: rest larger than a sound specimen's gap flagged", flagged)
        if kind == "outside" and visible:
            count("outside: flagged", flagged)
            count("outside: something named", bool(named))
        share = by_set(case["told"]).get(frozenset(named), {})
        gone = removed(by_set(case["true_gap_N"]), frozenset(named & true))
        for e in case["truth"]["effects"]:
            if e["name"] in named:
                if (own := case.get("named", {}).get(e["name"])) is not None:
                    wide = Share(own["value"], own["low"], own["high"]).widened(c.law_sd(own["value"]))
                    for what, at in (
                        ("true share", gone[e["name"]]),
                        ("share on tests left out", own["left_out"]),
                        ("share found on unseen tests", own["found"]),
                    ):
                        if np.isfinite(at):
                            count(f"{what} in the 90 % interval", wide.low <= at <= wide.high)
                count("share of a true cause within 10 points", abs(share[e["name"]] - gone[e["name"]]) <= 0.1)
                made_by_it = case["true_share"][e["name"]]
                count("the same against Shapley's value over all faults", abs(share[e["name"]] - made_by_it) <= 0.1)
    return {k: (v[0], v[1]) for k, v in out.items()}


def reliability(cases: Sequence[dict[str, Any]], constants: Sequence[Calibration]) -> tuple[float, list[str]]:
    """Calibration error of the probabilities that effects contribute and that the rest has a cause (mean distance of
    stated and found in bins, weighted by their counts), and a line for each bin."""
    stated, right = [], []
    for case, c in zip(cases, constants):
        p, _ = contributing(figures_of(case), c)
        true = truths(case)
        for name, value in p.items():
            if name not in NO_CAUSE | OWN_FORM:
                stated.append(value)
                right.append(name in true)
        stated.append(rest_has_cause(case, c))
        right.append(rest_is_real(case, c))
    return reliability_lines(np.array(stated), np.array(right, float))


def reliability_lines(x: np.ndarray, y: np.ndarray) -> tuple[float, list[str]]:
    """Mean distance of stated (n,) and found (n,) in bins, weighted by their counts, and a line for each bin."""
    bins = np.digitize(x, [0.1, 0.3, 0.5, 0.7, 0.9])
    lines, error = [], 0.0
    for k in np.unique(bins):
        at = bins == k
        error += float(at.mean() * abs(x[at].mean() - y[at].mean()))
        lines.append(f"  stated {x[at].mean():.2f}: found {y[at].mean():.2f} ({int(y[at].sum())} of {int(at.sum())})")
    return error, lines
