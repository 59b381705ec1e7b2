"""What a diagnosis says of a case, as it is scored: from `diagnosis.json` of schema 3, 2 or 1.

Schemas 3 and 2 differ in names alone. They say how probable it is that each effect contributes, that none does
("none") and that an unknown cause is there ("unknown_cause"): not exclusive, so they need not sum to 1. Schema 1's
probabilities were of exclusive labels ("none", "unknown", one cause): they sum to 1.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_iwan import former_names
from bayes_iwan.withheld.sealed import WithheldError
from bayes_iwan.withheld.truths import json_number

KINDS = ("none", "explained", "partly_explained", "unknown", "drive")
#: probabilities are rounded when they are written
_ROUNDING = 1e-3


@dataclass(frozen=True)
class Named:
    """A cause that a verdict names, with what it says of it; nan for what it does not say."""

    name: str
    probability: float
    share: float
    share_low: float
    share_high: float
    share_held_out: float
    alike: frozenset[str]


@dataclass(frozen=True)
class Answer:
    """A verdict: its kind, the causes it names, whether it says that a cause is unknown, and marginal probabilities.

    `unexplained` is that share of the gap, nan where not said; `one_of` effects of which one is said
    to contribute, though it cannot be said which.
    """

    kind: str
    causes: tuple[Named, ...]
    unknown_cause: bool
    unexplained: float
    probabilities: Mapping[str, float]
    one_of: tuple[frozenset[str], ...] = ()

    @property
    def names(self) -> frozenset[str]:
        return frozenset(c.name for c in self.causes)

    @property
    def in_sets(self) -> frozenset[str]:
        """The causes named, all that are tied with them, and those that are only named together."""
        return self.names.union(*(c.alike for c in self.causes), *self.one_of)


def read_answer(name: str, answer: Mapping[str, Any]) -> Answer:
    """An answer from the content of its `diagnosis.json`.

    Raises `WithheldError` that names the case if it is not of either schema, if a probability lies outside 0 to 1, if
    exclusive ones do not sum to 1, or if the verdict contradicts itself.
    """
    try:
        answer = former_names.diagnosis_of(answer)
        probabilities = {str(k): json_number(v) for k, v in answer["probabilities"].items()}
        verdict = answer["verdict"]
        new = "kind" in verdict
        outside = {k: p for k, p in probabilities.items() if not 0.0 <= p <= 1.0}
        if outside or not probabilities:
            label, p = next(iter(outside.items()), ("any", float("nan")))
            raise WithheldError(f"the answer to {name} is refused: the probability of {label} is {p:g}, not in 0 to 1")
        return _second(name, answer, probabilities) if new else _first(name, verdict, probabilities)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, WithheldError):
            raise
        raise WithheldError(f"the answer to {name} is of no known form ({type(error).__name__}: {error})") from None


def _second(name: str, answer: Mapping[str, Any], probabilities: Mapping[str, float]) -> Answer:
    verdict = answer["verdict"]
    kind, unknown = verdict["kind"], bool(verdict["unknown_cause"])
    causes = tuple(_named(c) for c in verdict["causes"])
    refused = ""
    if kind not in KINDS:
        refused = f"there is no verdict {kind!r}"
    elif not {"none", "unknown_cause"} <= set(probabilities):
        refused = "it gives no probability of none and of unknown_cause"
    elif bool(causes) != (kind in ("explained", "partly_explained")):
        refused = f"its verdict is {kind} and it names {len(causes)} causes"
    elif unknown != (kind in ("partly_explained", "unknown")):
        refused = f"its verdict is {kind} and unknown_cause is {str(unknown).lower()}"
    elif probabilities["none"] + max((p for k, p in probabilities.items() if k != "none"), default=0.0) > 1 + _ROUNDING:
        refused = "none and some cause have probabilities that sum to more than 1"
    elif any(math.isfinite(c.probability) and not 0.0 <= c.probability <= 1.0 for c in causes):
        refused = "a cause's probability is not in 0 to 1"
    if refused:
        raise WithheldError(f"the answer to {name} is refused: {refused}")
    unexplained = json_number((answer.get("unexplained") or {}).get("share"))
    one_of = tuple(frozenset(map(str, some["names"])) for some in verdict.get("one_of") or ())
    return Answer(kind, causes, unknown, unexplained, probabilities, one_of)


def _named(cause: Mapping[str, Any]) -> Named:
    low, high = cause.get("share_interval") or (float("nan"), float("nan"))
    probability, share, held_out = map(
        json_number, (cause["probability"], cause.get("share"), cause.get("share_held_out"))
    )
    alike = frozenset(cause.get("tied_with") or ())
    return Named(str(cause["name"]), probability, share, json_number(low), json_number(high), held_out, alike)


def _first(name: str, verdict: Mapping[str, Any], probabilities: dict[str, float]) -> Answer:
    if abs((total := sum(probabilities.values())) - 1.0) > _ROUNDING:
        raise WithheldError(f"the answer to {name} is refused: its probabilities sum to {total:g}")
    cause, second = verdict["cause"], verdict.get("second_cause")
    alike = frozenset(verdict.get("tied_with") or ())
    nothing = float("nan")
    named = [n for n in (cause, second) if n and n not in ("none", "unknown")]
    causes = tuple(
        Named(n, probabilities.get(n, 0.0), nothing, nothing, nothing, nothing, alike if n == cause else frozenset())
        for n in named
    )
    kind = "explained" if causes else str(cause)
    marginal = {k: p for k, p in probabilities.items() if k != "unknown"}
    marginal |= {"none": probabilities.get("none", 0.0), "unknown_cause": probabilities.get("unknown", 0.0)}
    return Answer(kind, causes, cause == "unknown", nothing, marginal)
