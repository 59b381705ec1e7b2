"""Model families fitted to one campaign and ranked by how well they predict what they have not seen."""

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from bayes_iwan import executors, former_names
from bayes_iwan.arguments import CAMPAIGN, path_of, seed_of
from bayes_iwan.campaign import Campaign, Loop, read_campaign
from bayes_iwan.comparison.loo import Loo, leave_tests_out, psis_loo
from bayes_iwan.errors import InputError, few, nearest
from bayes_iwan.inference.identify import identify_problem
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.config import Config, settings_of
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.settings import IdentifySettings, ModelSettings, SamplingSettings, SearchSettings
from bayes_iwan.models import Simulator
from bayes_iwan.models.bouc_wen import OTHER_MODELS
from bayes_iwan.models.user_file import UserFiles, load_simulator
from bayes_iwan.screen import Listed, on_screen, screen


class CompareError(InputError):
    """A comparison that cannot be made; the message says why and what to do."""


@dataclass(frozen=True)
@on_screen
class Family:
    """A model family: what to call it, and the parts of its model, or a simulator instead. asks : what the paper argues
    by eye, whether its own model is better than this one."""

    name: str
    label: str
    model: ModelSettings = field(default_factory=ModelSettings)
    asks: str = ""
    simulator: Simulator | None = None

    def problem(self, loops: Sequence[Loop], settings: IdentifySettings) -> Problem:
        # the embedded model error would make all forms alike: forms are compared as they are written
        mine = replace(settings, model=replace(self.model, embedded=False))
        own = {p.name for p in make_problem(loops, replace(mine, parameters={}), self.simulator).prior.parameters}
        # a configuration's parameters may belong to another family: those that this one lacks do not apply to it
        chosen = {k: v for k, v in settings.parameters.items() if k in own}
        return make_problem(loops, replace(mine, parameters=chosen), self.simulator)


def _iwan(name: str, label: str, asks: str = "", **parts: Any) -> Family:
    return Family(name, label, ModelSettings(**parts), asks)


def _other(name: str, label: str, asks: str) -> Family:
    return Family(name, label, asks=asks, simulator=OTHER_MODELS[name])


_NO_SPEED = {"normal_force": "hunt_crossley_no_speed"}
_CLASSICAL = {"normal_force": "constant", "stiffness": "constant"}
_ALL = (
    _iwan("gamma3", "the paper's model: three gammas, Eqs. 11, 12"),
    _iwan("gamma2", "two-gamma slip forces", "Are three gammas better than two?", slip="gamma2"),
    _iwan("gamma1", "one-gamma slip forces", "Are three gammas better than one?", slip="gamma1"),
    _iwan("uniform", "uniform slip forces", "Are three gammas better than a uniform distribution?", slip="uniform"),
    _iwan("gaussian", "Gaussian slip forces", "Are three gammas better than a Gaussian distribution?", slip="gaussian"),
    _iwan("power_law", "power-law slip forces", "Are three gammas better than a power law?", slip="power_law"),
    _iwan("no_speed", "normal force without speed", "Does the speed term of the normal force pay?", **_NO_SPEED),
    _iwan("constant_normal_force", "constant normal force (classical Iwan)",
          "Does a normal force that varies pay at all?", **_CLASSICAL),
    _iwan("polynomial2", "normal force a quadratic in u", normal_force="polynomial2"),
    _iwan("polynomial3", "normal force a cubic in u", "Is Eq. (11) better than a cubic polynomial?",
          normal_force="polynomial3"),
    _iwan("constant_stiffness", "element stiffness constant",
          "Does a stiffness that depends on the normal force pay?", stiffness="constant"),
    _other("bouc_wen", "Bouc–Wen", "Is the generalized Iwan model better than Bouc–Wen?"),
    _other("generalized_bouc_wen", "generalized Bouc–Wen, asymmetric",
           "Is it better than an asymmetric generalized Bouc–Wen model?"),
)  # fmt: skip
FAMILIES: dict[str, Family] = {family.name: family for family in _ALL}

#: standard errors of a difference, and the difference itself (nats), below which nothing is decided
DECIDES, LEAST = 2.0, 4.0

#: short runs: a comparison needs predictive densities to a fraction of their standard error, not tails of parameters
SHORT = IdentifySettings(
    model=ModelSettings(embedded=False),
    search=SearchSettings(members=100, evaluations=4000, second_search=False, starts=16),
    sampling=SamplingSettings(ensembles=2, walkers=64, budget_s=20.0, r_hat=1.03, ess=150.0, taus=20.0, draws=4096),
)


@dataclass(frozen=True)
@on_screen
class Entry:
    """One family's fit. residual_share : RMS residual of the median prediction over RMS friction force.

    loo : ArviZ's, datum by datum. tests : whole tests held out (None with fewer than three tests).
    """

    family: Family
    posterior: Posterior = field(repr=False)  # what it says of itself may need draws of its own
    parameters: int
    residual_share: float
    loo: Loo
    tests: Loo | None
    seconds: float


@dataclass(frozen=True)
@on_screen
class Row:
    """One line of the ranking, in the order of compare.csv.

    difference : elpd − that of the best, with the standard error of the difference.
    """

    name: str
    label: str
    elpd: float
    elpd_se: float
    difference: float
    difference_se: float
    loo: float
    loo_holds: bool
    held_out: float
    residual_share: float
    parameters: int
    seconds: float
    converged: bool


@dataclass(frozen=True, repr=False)
@on_screen
class Comparison:
    """Families ranked by how well they predict, best first; made by :func:`bayes_iwan.compare`, which has an example.

    Attributes
    ----------
    campaign
        whose tests were fitted; None for loops that came from no campaign.
    by
        "loo" or "tests", which of the two predictive densities ranks them.
    entries
        a family each, with its posterior, residual and predictive densities.
    """

    campaign: Campaign | None
    by: str
    entries: tuple[Entry, ...]

    def __repr__(self) -> str:
        return screen((), self._ranking(), (*self._answers(), *self.warnings()), ".rows()")

    def __str__(self) -> str:
        return "\n".join([*self._ranking(), *self._answers(), *self.warnings()])

    @property
    def converged(self) -> bool:
        """Whether the chains of every family have."""
        return all(e.posterior.converged for e in self.entries)

    def warnings(self) -> tuple[str, ...]:
        """What a reader of the ranking must know, one sentence each."""
        out, rows = [], self.rows()
        if self.by == "loo" and (poor := sum(not r.loo_holds for r in rows)):
            out.append(f"The Pareto k of {poor} families are too high: rank by held-out tests (--by tests).")
        if short := [r.label for r in rows if not r.converged]:
            out.append(f"Not converged, so that their density is some nats off: {', '.join(short)}.")
        return Listed(out)

    def _ranking(self) -> list[str]:
        return [
            f"{row.label:44s} {row.difference:+8.1f} ± {row.difference_se:5.1f}  residual "
            f"{100 * row.residual_share:5.2f} %  {row.parameters:2d} parameters {row.seconds:4.0f} s"
            for row in self.rows()
        ]

    def _answers(self) -> list[str]:
        return [f"{question} {answer}" for question, answer in self.answers()]

    def ranked(self, entry: Entry) -> Loo:
        """The predictive density that an entry is ranked by."""
        return entry.loo if self.by == "loo" or entry.tests is None else entry.tests

    def difference(self, first: Entry, second: Entry) -> tuple[float, float]:
        """elpd(first) − elpd(second) and its standard error over the data or tests they share."""
        d = self.ranked(first).pointwise - self.ranked(second).pointwise
        return float(d.sum()), float(np.sqrt(len(d)) * d.std(ddof=1)) if len(d) > 1 else float("nan")

    def __getitem__(self, name: str) -> Entry:
        for entry in self.entries:
            if entry.family.name == name:
                return entry
        raise KeyError(f"{name!r}{nearest(name, (x.family.name for x in self.entries))}")

    def rows(self) -> tuple[Row, ...]:
        """The ranking as a table, best first: differences in nats to the best, with standard errors."""
        best = self.entries[0]
        out = []
        for e in self.entries:
            ranked = self.ranked(e)
            difference, se = self.difference(e, best) if e is not best else (0.0, 0.0)
            held_out = float("nan") if e.tests is None else e.tests.elpd
            out.append(
                Row(e.family.name, e.family.label, ranked.elpd, ranked.se, difference, se, e.loo.elpd, e.loo.holds,
                    held_out, e.residual_share, e.parameters, e.seconds, e.posterior.converged)
            )  # fmt: skip
        return Listed(out)

    def answers(self) -> tuple[tuple[str, str], ...]:
        """The paper's questions, those whose families were fitted, each with an answer and the figure behind it."""
        fitted = {e.family.name: e for e in self.entries}
        out = []
        for name, family in FAMILIES.items():
            if family.asks and {"gamma3", name} <= set(fitted):
                d, se = self.difference(fitted["gamma3"], fitted[name])
                decided = "Yes" if d > 0.0 else "No, on the contrary"
                word = decided if abs(d) > max(LEAST, DECIDES * se) else "These tests do not tell"
                said = f"{word}: difference of expected log predictive density {d:+.1f} ± {se:.1f}"
                out.append((family.asks, said.replace("-", "−")))
        return tuple(out)


def compare_families(
    campaign: Campaign | str | os.PathLike[str] | Sequence[Loop],
    families: str | Sequence[str] | None = None,
    *,
    config: Config = None,
    seed: int = 0,
    by: str = "auto",
    simulator: Simulator | str | os.PathLike[str] | None = None,
    workers: executors.Workers = None,
    progress: bool = True,
) -> Comparison:
    """Fit the named families (default: all) to a campaign and rank them.

    campaign : a campaign, its folder, or loops. config : as for `identify`, without [model];
    its [search] and [sampling] tables replace :data:`SHORT` where given. by : "loo" ranks by ArviZ's
    leave-one-datum-out density, "tests" by whole tests held out, "auto" by the first if its Pareto k hold for every
    family, else by the second. simulator : a model of your own that is compared too, or the Python file that defines it
    (its code is run). workers : that fit families side by side (:data:`bayes_iwan.executors.Workers`).
    Raises CompareError for unknown families or rankings.
    """
    own = load_simulator(simulator) if isinstance(simulator, str | os.PathLike) else simulator
    mine = {} if own is None else {own.name: Family(own.name, f"{own.name} (your own)", simulator=own)}
    known = mine | FAMILIES
    names = list(known) if families is None else [families] if isinstance(families, str) else list(families)
    names = [*(n for n in mine if n not in names), *names]
    for name in names:
        if name not in known:
            said = former_names.renamed(name, former_names.FAMILIES)
            raise CompareError(f"{name} {said}" if said else f"no family {name!r}{nearest(name, known)}")
    if len(set(names)) < 2:
        raise CompareError(f"a comparison needs at least two families, not {few(names) or 'none'}; name another")
    if by not in (ways := ("auto", "loo", "tests")):
        raise CompareError(f"by = {by!r} is not known{nearest(by, ways)}")
    seed = seed_of(seed)
    settings = settings_of(config, {"model": "since each family has its own"})
    if settings.search == SearchSettings():
        settings = replace(settings, search=SHORT.search)
    if settings.sampling == SamplingSettings():
        settings = replace(settings, sampling=SHORT.sampling)
    source, loops = _loops(campaign, settings)
    # a family travels with the file of the user's that its simulator comes from
    common = (UserFiles.of([] if own is None else [own]), loops, settings, seed)
    entries, pieces = [], {n: known[n] for n in names}
    fitted = executors.run(pieces, _entry, common, workers=workers, what="comparing", unit="family", progress=progress)
    for name, entry in fitted.items():
        if isinstance(entry, executors.Failure):
            raise CompareError(f"family {name} cannot be fitted: {entry}")
        entries.append(entry)
    if by == "auto":
        by = "loo" if all(e.loo.holds for e in entries) or entries[0].tests is None else "tests"
    if by == "tests" and entries[0].tests is None:
        raise CompareError("ranking by held-out tests needs at least three tests that are fitted")
    unranked = Comparison(source, by, tuple(entries))
    order = sorted(entries, key=lambda e: -float(unranked.ranked(e).pointwise.sum()))
    return Comparison(source, by, tuple(order))


def _loops(
    campaign: Campaign | str | os.PathLike[str] | Sequence[Loop], settings: IdentifySettings
) -> tuple[Campaign | None, tuple[Loop, ...]]:
    if isinstance(campaign, list | tuple) and all(isinstance(x, Loop) for x in campaign):
        return None, tuple(campaign)
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(path_of(campaign, "campaign", f"{CAMPAIGN}, or averaged loops"))
    return campaign, campaign.loops(**asdict(settings.loops))


def _entry(common: tuple[UserFiles, Sequence[Loop], IdentifySettings, int], family: Family) -> Entry:
    began = time.monotonic()
    _, loops, settings, seed = common
    # a predictive density is that of the posterior itself
    settings = replace(settings, sampling=replace(settings.sampling, between_tests=False))
    problem = family.problem(loops, settings)
    posterior = identify_problem(problem, seed, config=settings, loops=problem.loops, progress=False)
    z = posterior.flat_z(1000)
    chains = 2
    pointwise = np.concatenate([problem.pointwise(z[i : i + 250]) for i in range(0, len(z), 250)])
    kept = len(pointwise) // chains * chains
    loo = psis_loo(pointwise[:kept].reshape(chains, -1, pointwise.shape[1]))
    tests = leave_tests_out(posterior, seed=seed) if len(problem.loops) > 2 else None
    return Entry(family, posterior, problem.ndim, posterior.residual_size().share, loo, tests, time.monotonic() - began)
