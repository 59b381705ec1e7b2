"""The result of a diagnosis: the gap as a budget of named causes and an unexplained part."""

from dataclasses import dataclass
from html import escape
from typing import Any

from bayes_iwan.campaign import Campaign
from bayes_iwan.campaign.loops.clipping import Limit
from bayes_iwan.diagnosis.answer.imitation import Edge, Imitation
from bayes_iwan.diagnosis.answer.localisation import Where
from bayes_iwan.diagnosis.answer.next_test import NextTest
from bayes_iwan.diagnosis.assessment.assessed_search import Weighed
from bayes_iwan.diagnosis.assessment.budget import GapBudget, Verdict
from bayes_iwan.diagnosis.assessment.sampled_fit import Sampling
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.gap_size import GapSize
from bayes_iwan.diagnosis.fits.residuals import Residual
from bayes_iwan.diagnosis.search.search_result import Search
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.screen import Listed, Named, on_screen, screen, wrapped


@dataclass(frozen=True)
@on_screen
class EffectParameter:
    """A parameter of an effect: mean, standard deviation, 5 and 95 % quantiles, unit."""

    mean: float
    sd: float
    q05: float
    q95: float
    unit: str


@dataclass(frozen=True)
@on_screen
class Moved:
    """A parameter of the specimen without and with the named causes in the model; sd of the difference, unit."""

    before: float
    after: float
    sd: float
    unit: str


@dataclass(frozen=True, repr=False)
@on_screen
class Diagnosis:
    """What the model misses, as a budget of named causes and an unexplained part.

    Attributes
    ----------
    verdict
        the headline: its kind, the named causes and the probability of each effect.
    budget
        the gap as a sum: before, each cause's share, the unexplained part; RMS in N and shares with 90 % intervals.
    before, residual, where
        gap, residual and place of what the base model misses.
    after_residual
        the residual with all named causes.
    parameters
        of each named effect, as reported: mean, sd, 5 and 95 % quantiles, unit.
    moved
        the specimen's own parameters without and with the causes.
    not_testable
        effects that these tests would not have shown at their usual size.
    expected_nats
        ln evidence that each effect of usual size would have, by name.
    imitations
        dependences that a freedom of the base and an effect explain, and which of these the tests tell apart.
    edges
        base parameters far from what their priors hold plausible.
    clipped
        where a channel was limited by its amplifier, as far as the fitted tests tell.
    needs_clock
        effects that were omitted because the records have no clock.
    next_test
        the test that would settle what is open, None where nothing is.
    sampling
        quality of the draws behind the named effects' numbers; None where they are Laplace's approximation, by
        `quick` or since nothing is named.
    found
        what stands behind all this.
    """

    campaign: Campaign
    seed: int
    quick: bool
    settings: DiagnoseSettings
    data: GapData
    found: Weighed
    verdict: Verdict
    budget: GapBudget
    before: GapSize
    residual: Residual
    where: Where
    after_residual: Residual
    parameters: dict[str, dict[str, EffectParameter]]
    moved: dict[str, Moved]
    not_testable: tuple[str, ...]
    expected_nats: dict[str, float]
    imitations: tuple[Imitation, ...]
    edges: tuple[Edge, ...]
    clipped: tuple[Limit, ...]
    needs_clock: tuple[str, ...]
    next_test: NextTest | None
    sampling: Sampling | None

    def __repr__(self) -> str:
        said = "\n".join(wrapped(f"  {s}") for s in self.sentences()).splitlines()
        return screen((f"diagnosis of {self.campaign.name}:",), said, where=".sentences()")

    def _repr_html_(self) -> str:
        said = "".join(f"<li>{escape(s)}</li>" for s in self.sentences())
        return f"<p>diagnosis of {escape(self.campaign.name)}</p><ul>{said}</ul>"

    def to_dict(self) -> dict[str, Any]:
        """What `diagnosis.json` holds."""
        from bayes_iwan.diagnosis.answer.diagnosis_json import to_dict

        return Named(to_dict(self))

    def sentences(self) -> tuple[str, ...]:
        """The answer in plain words."""
        return Listed(self.to_dict()["sentences"])

    @property
    def search(self) -> Search:
        """All fits behind the diagnosis."""
        return self.found.search

    @property
    def fit(self) -> Fit:
        """The model with all named causes (the base where none is named)."""
        return self.after_residual.fit
