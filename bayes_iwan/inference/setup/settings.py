"""What a user may choose about an identification or a diagnosis; :mod:`.config` makes these of TOML tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from bayes_iwan.screen import Named, on_screen


@dataclass(frozen=True)
class LoopSettings:
    """The phase averaging.

    Parameters
    ----------
    n_phase
        points of an averaged loop; 128 to 512, as the motion needs, where it is not given.
    n_harmonics
        harmonics that are kept, at most n_phase/2 − 1.
    n_blocks
        blocks of consecutive cycles, for what changes along the record.
    """

    n_phase: int | None = None
    n_harmonics: int = 50
    n_blocks: int = 6


@dataclass(frozen=True)
class ModelSettings:
    """The parts of the Iwan model.

    Parameters
    ----------
    slip, normal_force, stiffness
        names as :class:`bayes_iwan.Model` takes them.
    embedded
        whether the model error is embedded: parameters inside the model let its laws deviate a little (see
        :mod:`bayes_iwan.models.embedded_error`).
    """

    slip: str = "gamma3"
    normal_force: str = "hunt_crossley"
    stiffness: str = "saturating"
    embedded: bool = True

    @property
    def without_speed(self) -> ModelSettings:
        """The same with a normal force that does not follow speed: what records without a clock can tell."""
        return replace(self, normal_force="hunt_crossley_no_speed") if self.normal_force == "hunt_crossley" else self


@dataclass(frozen=True)
class LikelihoodSettings:
    """How measured loops differ from predicted ones.

    Parameters
    ----------
    kind
        "correlated", "unweighted", "matern", "gaussian" or "laplace".
    """

    kind: str = "correlated"


@dataclass(frozen=True)
class SearchSettings:
    """The point estimate.

    Parameters
    ----------
    members, evaluations
        of the genetic algorithm: size of its population, and evaluations at most.
    second_search
        whether a second search with a population of its own says what the first one did not find.
    reach
        the search box is ± so many prior standard deviations.
    starts
        best members of a search's first population that least squares starts from, beside those of its last one.
    """

    members: int = 200
    evaluations: int = 20_000
    second_search: bool = True
    reach: float = 4.0
    starts: int = 12


@dataclass(frozen=True)
@on_screen
class SamplingSettings:
    """How the posterior is sampled, and when it has converged.

    Parameters
    ----------
    ensembles
        their number; R-hat compares them.
    walkers
        of each ensemble; each is a chain of its own.
    budget_s, max_steps
        time (s) and steps after which sampling ends, converged or not.
    r_hat, ess, taus
        when it has converged: R-hat at most, effective size at least, and steps over the autocorrelation time at
        least, each for every reported quantity that varies.
    draws
        kept in the posterior.
    between_tests
        make draws as wide as the tests disagree (:mod:`bayes_iwan.inference.solving.jackknife`).
    """

    ensembles: int = 4
    walkers: int = 16
    budget_s: float = 480.0
    max_steps: int = 200_000
    r_hat: float = 1.01
    ess: float = 400.0
    taus: float = 10.0
    draws: int = 4096
    between_tests: bool = True


@dataclass(frozen=True)
class PriorChoice:
    """A distribution of scipy.stats by name, with its arguments.

    Parameters
    ----------
    dist
        a continuous one, such as "lognorm".
    arguments
        as scipy.stats takes them by name: shapes, loc and scale.
    """

    dist: str
    arguments: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterChange:
    """What a [parameters.NAME] table changes of a parameter; None leaves as it is.

    Parameters
    ----------
    prior
        its distribution.
    lower, upper
        where that is cut, in the parameter's unit.
    fixed
        its value, which then is not sampled.
    tied
        the parameter whose value it shall have.
    """

    prior: PriorChoice | None = None
    lower: float | None = None
    upper: float | None = None
    fixed: float | None = None
    tied: str | None = None


@dataclass(frozen=True)
@on_screen
class IdentifySettings:
    """Everything that :func:`bayes_iwan.identify` takes from a configuration file; :func:`bayes_iwan.settings_of` makes
    it of tables and checks it.

    Parameters
    ----------
    loops, model, likelihood, search, sampling
        the tables of those names; see the classes in :mod:`bayes_iwan.inference.setup.settings`.
    parameters
        changes of priors, bounds and values by the parameter's name.

    Raises
    ------
    ConfigError
        from :func:`bayes_iwan.settings_of`: a table, key or value that cannot be used, in one line with the fix.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> settings = bi.settings_of({"model": {"slip": "gamma2"}, "parameters": {"beta": {"fixed": 0.5}}})
    >>> settings.model.slip, settings.sampling.ensembles, settings.parameters["beta"].fixed
    ('gamma2', 4, 0.5)
    """

    loops: LoopSettings = field(default_factory=LoopSettings)
    model: ModelSettings = field(default_factory=ModelSettings)
    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    sampling: SamplingSettings = field(default_factory=SamplingSettings)
    parameters: Mapping[str, ParameterChange] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Tables as a configuration file has them."""
        out = {f.name: asdict(getattr(self, f.name)) for f in fields(self) if f.name != "parameters"}
        return Named(out | {"parameters": {name: _table(change) for name, change in self.parameters.items()}})


@dataclass(frozen=True)
@on_screen
class DiagnoseSettings:
    """Everything that :func:`bayes_iwan.diagnose` takes from a configuration file: the base model and its priors.

    The model error is never embedded here: the effects are what lets the model deviate.

    Parameters
    ----------
    model
        the base model's parts.
    parameters
        changes of priors, bounds and values by the parameter's name; none of the noise's.

    Raises
    ------
    ConfigError
        from :func:`bayes_iwan.diagnose`, for tables that a diagnosis does not use.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> from bayes_iwan.inference.setup.settings import ModelSettings
    >>> bi.DiagnoseSettings(ModelSettings(slip="gamma2")).as_dict()["model"]
    {'slip': 'gamma2'}
    """

    model: ModelSettings = field(default_factory=ModelSettings)
    parameters: Mapping[str, ParameterChange] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Tables as a configuration file has them; of the model what differs from the paper's."""
        paper = asdict(ModelSettings())
        model = {k: v for k, v in asdict(self.model).items() if v != paper[k] and k != "embedded"}
        return Named({"model": model, "parameters": {n: _table(c) for n, c in self.parameters.items()}})


def _table(change: ParameterChange) -> dict[str, object]:
    out = {f.name: v for f in fields(change) if f.name != "prior" and (v := getattr(change, f.name)) is not None}
    if change.prior is not None:
        out["prior"] = {"dist": change.prior.dist, **change.prior.arguments}
    return out
