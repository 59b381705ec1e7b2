"""The gap and where it sits, known before anything is said of its causes."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_iwan.campaign import Campaign
from bayes_iwan.diagnosis.answer.localisation import Where, where
from bayes_iwan.diagnosis.fits.evidence import in_newtons
from bayes_iwan.diagnosis.fits.gap_size import GapSize, gap_size
from bayes_iwan.diagnosis.fits.residuals import Residual, residual_of
from bayes_iwan.diagnosis.search.search_result import Search


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


class ProgressListener:
    """Called at a diagnosis' stages, so that others can begin on what is known: what is drawn of the gap needs no
    verdict. This one does nothing."""

    def searched(self) -> None:
        """No other process has anything left to do."""

    def located(self, found: Located) -> None:
        """The gap is known; causes are weighed next."""
