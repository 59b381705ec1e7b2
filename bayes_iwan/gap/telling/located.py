"""The gap and where it sits, known before anything is said of its causes."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_iwan.campaign import Campaign
from bayes_iwan.gap.fitting.evidence import in_newtons
from bayes_iwan.gap.fitting.gap_size import GapSize, gap_size
from bayes_iwan.gap.fitting.residuals import Residual, residual_of
from bayes_iwan.gap.searching.found import Search
from bayes_iwan.gap.telling.where import Where, where


@dataclass(frozen=True)
class Located:
    """What the base model misses: residual of its fit where it misses least, its size and its place."""

    campaign: Campaign
    residual: Residual
    size: GapSize
    where: Where


def located(campaign: Campaign, search: Search, seed: int) -> Located:
    """The gap of a finished search's base."""
    residual = residual_of(search.data, in_newtons(search.data, search.base))
    return Located(campaign, residual, gap_size(residual, seed), where(residual, seed))


class Watcher:
    """Is told of a diagnosis' stages, so that others can begin on what is known: what is drawn of the gap needs no
    verdict. This one does nothing."""

    def searched(self) -> None:
        """No other process has anything left to do."""

    def located(self, found: Located) -> None:
        """The gap is known; causes are weighed next."""
