"""Numbers of a diagnosis as they stand in cells and sentences; what is missing is a dash."""

from __future__ import annotations

from collections.abc import Sequence


def newton(x: float | None) -> str:
    if x is None or x != x:
        return "–"
    return f"{x:.3g} N" if abs(x) >= 0.1 or x == 0 else f"{1e3 * x:.3g} mN"


def force_range(pair: Sequence[float] | None) -> str:
    return "–" if not pair else f"{newton(pair[0])} to {newton(pair[1])}"


def percent(x: float | None) -> str:
    if x is None or x != x:
        return "–"
    return f"{100 * x:.1f} %" if abs(x) < 0.1 else f"{100 * x:.0f} %"


def percent_range(pair: Sequence[float] | None) -> str:
    return "–" if not pair else f"{percent(pair[0])} to {percent(pair[1])}"


def digits(x: float | None) -> str:
    return "–" if x is None or x != x else f"{x:.4g}"
