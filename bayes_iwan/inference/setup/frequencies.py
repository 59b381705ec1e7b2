"""Tests of one frequency, together."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_iwan.campaign import Loop

#: tests whose frequencies differ by less than this are of one frequency
SAME_FREQUENCY = 0.02


def by_frequency(loops: Sequence[Loop]) -> dict[str, tuple[Loop, ...]]:
    """Fitted loops grouped by frequency, by names such as f10Hz, lowest first."""
    groups: list[list[Loop]] = []
    for loop in sorted((x for x in loops if x.role != "held-out"), key=lambda x: x.frequency_hz):
        if groups and abs(loop.frequency_hz / groups[-1][0].frequency_hz - 1.0) < SAME_FREQUENCY:
            groups[-1].append(loop)
        else:
            groups.append([loop])
    return {f"f{group[0].frequency_hz:.4g}Hz": tuple(group) for group in groups}
