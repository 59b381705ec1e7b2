"""Numbers of a diagnosis as they stand in cells and sentences; what is missing is a dash."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_iwan.diagnosis.answer import wording


def newton(x: float | None) -> str:
    return "–" if x is None or x != x else wording.force(x)


def force_range(pair: Sequence[float] | None) -> str:
    return "–" if not pair else f"{newton(pair[0])} to {newton(pair[1])}"


def percent(x: float | None) -> str:
    return "–" if x is None or x != x else wording.percent(x)


def percent_range(pair: Sequence[float] | None) -> str:
    return "–" if not pair else f"{percent(pair[0])} to {percent(pair[1])}"


def digits(x: float | None) -> str:
    return "–" if x is None or x != x else wording.plain(x, 4)
