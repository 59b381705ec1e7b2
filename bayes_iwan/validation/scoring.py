"""What a set of answers is worth: answers compared with truths, each figure with an interval.

A truth's *labels*: "none" for a sound case, "unknown" for an effect outside the catalogue, else the effects'
names. Only cases with one label enter the confusion matrix, the probability scores and the reliability diagram;
pairs are scored apart. Intervals are at 95 %: Clopper–Pearson for shares, bootstrap over cases for the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.rig.faults import CATALOGUE, MAIN_PARAMETER
from bayes_iwan.validation.estimates import Estimate, binned, bootstrap, findable, share
from bayes_iwan.validation.sealed import WithheldError, check_seals, read_json, read_truths

LABELS = ("none", "unknown", *CATALOGUE)
LOWEST_PROBABILITY = 1e-3  # an answer of 0 that comes true costs −ln of this, not infinity
Floats = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class CaseScore:
    """One case: truth and answer side by side.

    `labels` the truth's; `named` the verdict's cause, `second` its second cause; `stated` the probability of the
    verdict; `top3` the three most probable labels; `confusable` what the answer cannot tell apart, the verdict
    included; `log_score` in nats and `brier` for cases with one label, else nan; `size` of the (first) effect as
    a share of friction, nan without one; `visible` the part of it that no other specimen imitates, nan if the truth
    does not say; `noise` as a share of friction; `size_error` (found − true)/sd and
    `size_ratio` found/true of the true effect's main number, nan if the answer gives none; `shrink_predicted`,
    `shrink_found` of the named cause on unseen tests, nan if either is missing; `one_frequency` whether all tests
    were at one frequency; `answered` False for a missing answer, which is scored as a uniform guess of "none".
    """

    name: str
    kind: str
    labels: tuple[str, ...]
    named: str
    second: str | None
    stated: float
    top3: tuple[str, ...]
    confusable: tuple[str, ...]
    log_score: float
    brier: float
    size: float
    visible: float
    noise: float
    size_error: float
    size_ratio: float
    shrink_predicted: float
    shrink_found: float
    one_frequency: bool
    answered: bool

    @property
    def right(self) -> bool:
        return self.named in self.labels

    @property
    def in_set(self) -> bool:
        """The (first) truth is the verdict or among what the answer cannot tell from it."""
        return self.labels[0] in self.confusable

    @property
    def leaves_gap(self) -> bool:
        """What the effect leaves once the specimen's numbers have moved is above the noise of the force channel."""
        return not self.visible <= self.noise


def labels_of(truth: Mapping[str, Any]) -> tuple[str, ...]:
    """The labels by which a truth is scored."""
    if truth["kind"] == "none":
        return ("none",)
    if truth["kind"] == "outside":
        return ("unknown",)
    return tuple(e["name"] for e in truth["effects"])


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else float("nan")


def _fit_frequencies(truth: Mapping[str, Any]) -> set[float]:
    tests = truth.get("design", {}).get("tests", [])
    return {t["frequency_hz"] for t in tests if t.get("role", "fit") == "fit"}


def score_case(
    name: str, truth: Mapping[str, Any], answer: Mapping[str, Any] | None, shrink_found: float = float("nan")
) -> CaseScore:
    """Compare one answer (the content of a `diagnosis.json`, or None) with the truth."""
    labels = labels_of(truth)
    probabilities = dict.fromkeys(LABELS, 1 / len(LABELS))
    verdict: Mapping[str, Any] = {"cause": "none"}
    if answer is not None:
        probabilities = {k: float(v) for k, v in answer["probabilities"].items()}
        verdict = answer["verdict"]
    named = verdict["cause"]
    everything = sorted(set(probabilities) | set(LABELS))
    p = np.array([max(probabilities.get(label, 0.0), 0.0) for label in everything])
    ranked = [everything[i] for i in np.argsort(-p, kind="stable")]
    log_score = brier = float("nan")
    if len(labels) == 1:
        true = np.array([label == labels[0] for label in everything], dtype=float)
        log_score = -float(np.log(max(float(p @ true), LOWEST_PROBABILITY)))
        brier = float(np.sum((p - true) ** 2))
    effects = truth.get("effects", [])
    size_error = size_ratio = float("nan")
    entries = {e["name"]: e for e in (answer or {}).get("effects", [])}
    if truth["kind"] == "single" and effects[0]["name"] in entries:
        main = MAIN_PARAMETER.get(effects[0]["name"], "")
        found = entries[effects[0]["name"]].get("parameters", {}).get(main)
        true_value = _number(effects[0].get("parameters", {}).get(main))
        if found and np.isfinite(true_value):
            mean, sd = _number(found.get("mean")), _number(found.get("sd"))
            size_error = (mean - true_value) / sd if sd > 0 else float("nan")
            size_ratio = mean / true_value if true_value else float("nan")
    predicted = entries.get(named, {}).get("shrink_expected")
    return CaseScore(
        name=name,
        kind=truth["kind"],
        labels=labels,
        named=named,
        second=verdict.get("second_cause"),
        stated=probabilities.get(named, 0.0),
        top3=tuple(ranked[:3]),
        confusable=tuple(dict.fromkeys([named, *verdict.get("cannot_tell_apart", [])])),
        log_score=log_score,
        brier=brier,
        size=_number(effects[0].get("size")) if effects else float("nan"),
        visible=_number(effects[0].get("size")) * _number(effects[0].get("visible_share")) if effects else float("nan"),
        noise=_number(truth.get("noise", {}).get("share_of_friction"))
        if isinstance(truth.get("noise"), Mapping)
        else float("nan"),
        size_error=size_error,
        size_ratio=size_ratio,
        shrink_predicted=_number(predicted),
        shrink_found=shrink_found,
        one_frequency=len(_fit_frequencies(truth)) == 1,
        answered=answer is not None,
    )


def summarise(cases: Sequence[CaseScore], seed: int = 0) -> dict[str, Estimate]:
    """The score table: what is measured, by name, in the order in which it is read."""
    rng = np.random.default_rng(seed)
    one = [c for c in cases if len(c.labels) == 1]
    of = {kind: [c for c in cases if c.kind == kind] for kind in ("none", "single", "pair", "outside")}
    several = [c for c in of["single"] if not c.one_frequency]
    single_f = [c for c in of["single"] if c.one_frequency]
    clear = [c for c in of["single"] if c.leaves_gap]
    errors = [c.size_error for c in of["single"] if np.isfinite(c.size_error)]
    right_errors = [c.size_error for c in of["single"] if np.isfinite(c.size_error) and c.right]
    ratios = [abs(c.size_ratio - 1) for c in of["single"] if np.isfinite(c.size_ratio) and c.right]
    shrinks = [c for c in cases if np.isfinite(c.shrink_predicted) and np.isfinite(c.shrink_found)]
    return {
        "first answer right (none, single and outside cases)": share([c.right for c in one]),
        "truth among the three most probable": share([c.labels[0] in c.top3 for c in one]),
        "single effects: first answer right": share([c.right for c in of["single"]]),
        "single effects: truth among the three most probable": share([c.labels[0] in c.top3 for c in of["single"]]),
        "single effects, several frequencies: first answer right": share([c.right for c in several]),
        "single effects, one frequency: first answer right": share([c.right for c in single_f]),
        "single effects: truth in the set that cannot be told apart": share([c.in_set for c in of["single"]]),
        "single effects, one frequency: truth in that set": share([c.in_set for c in single_f]),
        "single effects: causes in that set": bootstrap([len(c.confusable) for c in of["single"]], rng),
        "single effects, gap above noise: first answer right": share([c.right for c in clear]),
        "single effects, gap above noise: truth in the set": share([c.in_set for c in clear]),
        "single effects, gap above noise, one frequency: truth in the set": share(
            [c.in_set for c in clear if c.one_frequency]
        ),
        "single effects, gap above noise: causes in the set": bootstrap([len(c.confusable) for c in clear], rng),
        "single effects: called none": share([c.named == "none" for c in of["single"]]),
        "single effects: called unknown": share([c.named == "unknown" for c in of["single"]]),
        "no effect: a cause is named (false alarm)": share([c.named in CATALOGUE for c in of["none"]]),
        "no effect: called unknown": share([c.named == "unknown" for c in of["none"]]),
        "outside the catalogue: called unknown": share([c.named == "unknown" for c in of["outside"]]),
        "outside the catalogue: called none": share([c.named == "none" for c in of["outside"]]),
        "outside the catalogue: a wrong cause named": share([c.named in CATALOGUE for c in of["outside"]]),
        "pairs: first cause is one of the two": share([c.right for c in of["pair"]]),
        "pairs: both causes named": share([{c.named, c.second} == set(c.labels) for c in of["pair"]]),
        "not pairs: a second cause named": share([c.second is not None for c in one]),
        "log score, nats": bootstrap([c.log_score for c in one], rng),
        "Brier score": bootstrap([c.brier for c in one], rng),
        "stated probability less share right": bootstrap([c.stated - c.right for c in one], rng),
        "expected calibration error (ten bins)": bootstrap([c.stated + 2.0 * c.right for c in one], rng, _calibration),
        "effect's size in its 90 % interval, cause right": share([abs(e) < 1.645 for e in right_errors]),
        "effect's size within 2 sd, whatever was named": share([abs(e) < 2 for e in errors]),
        "effect's size, cause right: median |error|, sd": bootstrap(np.abs(right_errors).tolist(), rng, np.median),
        "effect's size, cause right: median |error| as share of size": bootstrap(ratios, rng, np.median),
        "shrink: predicted within 10 points of found": share(
            [abs(c.shrink_predicted - c.shrink_found) <= 0.1 for c in shrinks]
        ),
        "shrink: median predicted − found": bootstrap(
            [c.shrink_predicted - c.shrink_found for c in shrinks], rng, np.median
        ),
    }


def _calibration(answers: Floats, axis: int, bins: int = 10) -> Floats:
    """Mean distance of stated probability and share right over bins, weighed by their answers, along the last axis.

    answers : stated + 2 where right: one number a case, for the bootstrap.
    """
    right = answers >= 2.0
    miss = answers - 3.0 * right  # stated less 1 where right
    which = np.minimum(np.round((answers - 2.0 * right) * bins, 9).astype(int), bins - 1)
    by_bin = [np.abs(np.sum(np.where(which == k, miss, 0.0), axis=axis)) for k in range(bins)]
    return np.asarray(np.sum(by_bin, axis=0) / answers.shape[axis])


def confusion(cases: Sequence[CaseScore]) -> tuple[tuple[str, ...], tuple[str, ...], Floats]:
    """Truths (rows), verdicts (columns) and how often each met each; one-label cases, labels that occur."""
    one = [c for c in cases if len(c.labels) == 1]
    order = {label: i for i, label in enumerate(LABELS)}
    used = {c.labels[0] for c in one} | {c.named for c in one}
    labels = tuple(sorted(used, key=lambda label: (order.get(label, len(order)), label)))
    place = {label: i for i, label in enumerate(labels)}
    rows = tuple(label for label in labels if label in {c.labels[0] for c in one})
    row_place = {label: i for i, label in enumerate(rows)}
    counts = np.zeros((len(rows), len(labels)))
    for c in one:
        counts[row_place[c.labels[0]], place[c.named]] += 1
    return rows, labels, counts


def reliability(cases: Sequence[CaseScore], bins: int = 5) -> list[tuple[float, Estimate]]:
    """Stated probability of the verdict against how often it was right, in bins of equal width; one-label cases."""
    one = [c for c in cases if len(c.labels) == 1]
    return binned([c.stated for c in one], [c.right for c in one], np.linspace(0, 1, bins + 1).tolist())


@dataclass(frozen=True)
class Score:
    """A scored set: the cases, the table, and other people's tables for comparison.

    `findable_size`, `findable_to_noise`, `findable_visible`: sizes of single effects that are found in half and
    in 80 % of cases, as a share of friction, over the noise, and (the visible part alone) over the noise.
    """

    cases: tuple[CaseScore, ...]
    summary: Mapping[str, Estimate]
    findable_size: Mapping[float, Estimate]
    findable_to_noise: Mapping[float, Estimate]
    findable_visible: Mapping[float, Estimate]
    baselines: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)

    def table(self) -> str:
        """The score as text, one line a figure; baselines' values beside it."""
        width = max(len(k) for k in self.summary)
        names = list(self.baselines)
        lines = []
        if names:
            lines.append(" " * (width + 2) + f"{'these answers':42s}" + "".join(f"{n:>14s}" for n in names))
        for key, figure in self.summary.items():
            line = f"{key:{width}s}  {figure.text(percent='shrink' in key or 'share of size' in key):42s}"
            for name in names:
                other = self.baselines[name].get(key)
                line += f"{'' if other is None or other.n == 0 else other.brief():>14s}"
            lines.append(line.rstrip())
        for what, found in (
            ("size of friction found", self.findable_size),
            ("size over noise found", self.findable_to_noise),
            ("visible size over noise found", self.findable_visible),
        ):
            for target, figure in found.items():
                value = "not within the sizes tried"
                if np.isfinite(figure.value):
                    scale, unit = (100, " %") if "friction" in what else (1, "")
                    value = (
                        f"{scale * figure.value:.1f}{unit} ({scale * figure.low:.1f} to "
                        f"{scale * figure.high:.1f}{unit}), n = {figure.n}"
                    )
                label = f"{what} in {100 * target:.0f} % of single cases"
                lines.append(f"{label:{width}s}  {value}")
        missing = [c.name for c in self.cases if not c.answered]
        if missing:
            lines.append(f"not answered, scored as a uniform guess of none: {', '.join(missing)}")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON; nan becomes None."""

        def plain(value: Any) -> Any:
            if isinstance(value, Mapping):
                return {str(k): plain(v) for k, v in value.items()}
            if isinstance(value, list | tuple):
                return [plain(v) for v in value]
            if isinstance(value, Estimate | CaseScore):
                return plain(asdict(value))
            if isinstance(value, float | np.floating):
                return float(value) if np.isfinite(value) else None
            return value

        rows, columns, counts = confusion(self.cases)
        return {
            "schema": 1,
            "summary": plain(self.summary),
            "findable_size": plain(self.findable_size),
            "findable_to_noise": plain(self.findable_to_noise),
            "findable_visible": plain(self.findable_visible),
            "baselines": plain(self.baselines),
            "confusion": {"truth": list(rows), "verdict": list(columns), "counts": counts.astype(int).tolist()},
            "cases": [plain(c) for c in self.cases],
        }


def score_answers(
    truths: Mapping[str, Mapping[str, Any]],
    answers: Mapping[str, Mapping[str, Any]],
    *,
    shrink_found: Mapping[str, float] | None = None,
    baselines: Mapping[str, Mapping[str, Mapping[str, Any]]] | None = None,
    seed: int = 0,
) -> Score:
    """Score answers against truths whose seals have been checked.

    Parameters: both by case name; `shrink_found`, by case, of the named cause on unseen tests; `baselines`, other
    sets of answers by name, scored beside.
    """
    strange = sorted(set(answers) - set(truths))
    if strange:
        raise WithheldError(f"answers to cases that have no truth: {', '.join(strange)}")
    found = shrink_found or {}
    cases = tuple(score_case(n, truths[n], answers.get(n), found.get(n, float("nan"))) for n in sorted(truths))
    single = [c for c in cases if c.kind == "single" and np.isfinite(c.size)]
    noisy = [c for c in single if c.noise > 0]
    visible = [c for c in noisy if c.visible > 0]
    return Score(
        cases=cases,
        summary=summarise(cases, seed),
        findable_size=findable([c.size for c in single], [c.right for c in single], seed),
        findable_to_noise=findable([c.size / c.noise for c in noisy], [c.right for c in noisy], seed),
        findable_visible=findable([c.visible / c.noise for c in visible], [c.right for c in visible], seed),
        baselines={
            name: summarise([score_case(n, truths[n], other.get(n)) for n in sorted(truths)], seed)
            for name, other in (baselines or {}).items()
        },
    )


FindShrink = Callable[[Path, Path, str], float | None]


def score(
    directory: Path | str,
    truth: Path | str,
    *,
    answers: Path | str | None = None,
    find_shrink: FindShrink | None = None,
    baselines: Mapping[str, Mapping[str, Mapping[str, Any]]] | None = None,
    seed: int = 0,
) -> Score:
    """Check the commitments, then score `answers.json` (by default `directory/answers/answers.json`).

    `find_shrink(diagnosis_folder, unseen_campaign, cause)` predicts the unseen tests with the diagnosed model,
    with and without the cause, and returns the shrink found there; it is called for every case with a named cause
    and an unseen campaign in the folder of truths. Raises `WithheldError` if a seal is broken.
    """
    directory, truth = Path(directory), Path(truth)
    answers_path = Path(answers) if answers is not None else directory / "answers" / "answers.json"
    truths = read_truths(truth)
    check_seals(directory, truths)
    content = read_json(answers_path)
    if not isinstance(content, dict) or not isinstance(content.get("answers"), dict):
        raise WithheldError(f"{answers_path}: no answers in it")
    given = content["answers"]
    found: dict[str, float] = {}
    for name, diagnosis in given.items():
        unseen = truth.parent / "unseen" / name
        cause = diagnosis["verdict"]["cause"]
        if find_shrink is None or cause not in CATALOGUE or not (unseen / "campaign.toml").is_file():
            continue
        value = find_shrink(answers_path.parent / name, unseen, cause)
        if value is not None and np.isfinite(value):
            found[name] = float(value)
    return score_answers(truths, given, shrink_found=found, baselines=baselines, seed=seed)
