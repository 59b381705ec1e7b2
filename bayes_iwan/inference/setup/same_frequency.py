"""Tests of one frequency, together."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.timing.groups import groups_of


def by_frequency(loops: Sequence[Loop]) -> dict[str, tuple[Loop, ...]]:
    """Fitted loops grouped by frequency, by names such as f10Hz (of the lowest in it), lowest first; within a group in
    the campaign's order."""
    fitted = [x for x in loops if x.role != "held-out"]
    parts = groups_of([x.frequency_hz for x in fitted]) if fitted else []
    lowest = {min(fitted[i].frequency_hz for i in part): part for part in parts}
    return {f"f{low:.4g}Hz": tuple(fitted[i] for i in sorted(part)) for low, part in sorted(lowest.items())}
