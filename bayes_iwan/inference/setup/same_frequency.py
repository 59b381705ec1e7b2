"""Tests of one frequency, together."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.timing.groups import groups_of


def by_frequency(loops: Sequence[Loop]) -> dict[str, tuple[Loop, ...]]:
    """Fitted loops grouped by frequency, by names such as f10Hz (of the lowest in it), lowest first."""
    fitted = sorted((x for x in loops if x.role != "held-out"), key=lambda x: x.frequency_hz)
    parts = groups_of([x.frequency_hz for x in fitted]) if fitted else []
    return {f"f{fitted[part[0]].frequency_hz:.4g}Hz": tuple(fitted[i] for i in part) for part in parts}
