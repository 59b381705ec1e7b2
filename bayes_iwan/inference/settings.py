"""What a user may choose about an identification or a diagnosis; :mod:`.config` makes these of TOML tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any


@dataclass(frozen=True)
class LoopSettings:
    """The phase averaging: points of a loop, its harmonics, and blocks of cycles along the record."""

    n_phase: int = 128
    n_harmonics: int = 50
    n_blocks: int = 6


@dataclass(frozen=True)
class ModelSettings:
    """The parts of the Iwan model, :class:`bayes_iwan.physics.Model`; embedded: may its form bend a little?"""

    slip: str = "gamma3"
    grip: str = "hunt_crossley"
    stiffness: str = "saturating"
    embedded: bool = False


@dataclass(frozen=True)
class LikelihoodSettings:
    """kind : a name that :func:`bayes_iwan.inference.likelihood.make_likelihood` knows."""

    kind: str = "correlated"


@dataclass(frozen=True)
class SearchSettings:
    """The point estimate.

    objective : what the genetic algorithm minimises, eq8, squared or likelihood. second_opinion : differential
    evolution on the same objective. reach : the search box is ± so many prior standard deviations. starts : prior
    draws that least squares starts from, beside the searches' best members.
    """

    objective: str = "eq8"
    members: int = 200
    evaluations: int = 20_000
    second_opinion: bool = True
    reach: float = 4.0
    starts: int = 12


@dataclass(frozen=True)
class SamplingSettings:
    """How the posterior is sampled, and when it has converged.

    method : auto, independent proposals where they fit and ensembles of walkers elsewhere, or ensembles.
    ensembles : their number, or that of the independent chains. walkers : at least; twice the numbers and two where
    that is more. draws : kept in the posterior.
    """

    method: str = "auto"
    ensembles: int = 4
    walkers: int = 40
    budget_s: float = 240.0
    max_steps: int = 200_000
    r_hat: float = 1.01
    ess: float = 400.0
    taus: float = 50.0
    draws: int = 8192


@dataclass(frozen=True)
class PriorChoice:
    """A distribution of scipy.stats by name, with its arguments."""

    dist: str
    arguments: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterChange:
    """What a [parameters.NAME] table changes of a parameter; None leaves as it is."""

    prior: PriorChoice | None = None
    lower: float | None = None
    upper: float | None = None
    fixed: float | None = None
    tied: str | None = None


@dataclass(frozen=True)
class IdentifySettings:
    """Everything that `identify` takes from a configuration file."""

    loops: LoopSettings = field(default_factory=LoopSettings)
    model: ModelSettings = field(default_factory=ModelSettings)
    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    sampling: SamplingSettings = field(default_factory=SamplingSettings)
    parameters: Mapping[str, ParameterChange] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Tables as a configuration file has them."""
        out = {f.name: asdict(getattr(self, f.name)) for f in fields(self) if f.name != "parameters"}
        out["parameters"] = {name: _table(change) for name, change in self.parameters.items()}
        return out


@dataclass(frozen=True)
class DiagnoseSettings:
    """Everything that `diagnose` takes from a configuration file: the base model and its priors.

    The model is never embedded here, whatever `model.embedded` says: the gap's effects are what bends it.
    """

    model: ModelSettings = field(default_factory=ModelSettings)
    parameters: Mapping[str, ParameterChange] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Tables as a configuration file has them; of the model what differs from the paper's."""
        paper = asdict(ModelSettings())
        model = {k: v for k, v in asdict(self.model).items() if v != paper[k] and k != "embedded"}
        return {"model": model, "parameters": {n: _table(c) for n, c in self.parameters.items()}}


def _table(change: ParameterChange) -> dict[str, Any]:
    out = {f.name: v for f in fields(change) if f.name != "prior" and (v := getattr(change, f.name)) is not None}
    if change.prior is not None:
        out["prior"] = {"dist": change.prior.dist, **change.prior.arguments}
    return out
