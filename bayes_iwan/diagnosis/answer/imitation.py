"""What the base model can imitate: a freedom of the base against an effect that would explain the same.

A normal force that grows with speed and a dashpot both make loops fatter with frequency. Where the base has such a
freedom, the search never sees the effect. So the base is fitted once more with the freedom at its neutral value, and
with the effect in its place; evidence and gap of the two say whether these tests tell them apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.limits import RigLimits
from bayes_iwan.diagnosis.answer.next_test import NextTest, next_test
from bayes_iwan.diagnosis.constants import EFFECT_NATS
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit, FitError, base_problem, fit_model
from bayes_iwan.diagnosis.search.base_fit import cheapest, quick_gap_N
from bayes_iwan.diagnosis.search.candidates import on_top, start_points
from bayes_iwan.diagnosis.search.search_result import Search
from bayes_iwan.effects.base import Effect
from bayes_iwan.inference.setup.priors import Prior
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import ParameterChange
from bayes_iwan.screen import on_screen
from bayes_iwan.threads import alongside

#: a dependence is said where one that explains it gains EFFECT_NATS, as an effect must, and makes the gap smaller by
#: this share of the friction force. A share of the gap does not tell: what else is left would hide the dependence
USED_SHARE = 0.003
#: two explanations are distinguished where their evidence differs by so many nats and the worse leaves so many times
#: the gap: every specimen differs from any model
TELLS_NATS, TELLS_RATIO = 10.0, 1.5
#: starts and iterations of a refit
STARTS, ITERATIONS = 4, 25
#: dependences that the text holds; the page holds all
IMITATIONS_SAID = 2
#: prior standard deviations from which a base parameter is said to lie far from what is plausible
FAR = 3.0


@dataclass(frozen=True)
class Freedom:
    """A freedom of the base model.

    name : the cause that it stands for; what : the dependence that it makes; neutral : by parameter, the value at
    which it vanishes; effects : what would explain the same
    """

    name: str
    what: str
    neutral: Mapping[str, float]
    effects: tuple[str, ...]


FREEDOMS: tuple[Freedom, ...] = (
    Freedom(
        "speed_dependent_normal_force",
        "speed dependence",
        {"normal_force_rate": 0.0},
        ("viscous_damping", "rate_strengthening", "maxwell_branch"),
    ),
    Freedom(
        "varying_normal_force",
        "asymmetry of the loops",
        {"normal_force_slope": 0.0},
        ("quadratic_stiffness", "direction_dependent_friction", "end_stop"),
    ),
    Freedom(
        "stiffness_of_normal_force",
        "stiffness after reversals",
        {"elasticity": 1e-4},
        ("quadratic_stiffness", "cubic_stiffness"),
    ),
    Freedom(
        "mixture_of_slip_forces",
        "rounding of the loops",
        {"share_1": 1.0},
        ("rig_compliance", "cubic_stiffness", "free_play"),
    ),
)


@dataclass(frozen=True)
class Explanation:
    """One explanation of a dependence: the base's own freedom or an effect in its place.

    nats : evidence over the freedom's; share : gap that it leaves, over the friction force
    """

    name: str
    nats: float
    share: float


@dataclass(frozen=True)
@on_screen
class Imitation:
    """A dependence that these tests show and that the base can imitate.

    name, what : see :class:`Freedom`; without : gap over the friction force with none of the explanations
    explanations : all that were fitted, the least gap first; tied : those that these tests do not tell from the first
    next_test : that would tell the first two, where several are tied
    """

    name: str
    what: str
    without: float
    explanations: tuple[Explanation, ...]
    tied: tuple[str, ...]
    next_test: NextTest | None

    @property
    def said(self) -> bool:
        """Do these tests leave several open? Of a single effect the verdict says what there is to say."""
        return len(self.tied) > 1


def said_in_text(some: Sequence[Imitation]) -> list[Imitation]:
    """The dependences that the text holds: of speed, then those with the most at stake."""
    said = [x for x in some if x.said]
    return sorted(said, key=lambda x: (x.what != "speed dependence", -x.without))[:IMITATIONS_SAID]


@dataclass(frozen=True)
@on_screen
class Edge:
    """A base parameter far from what its prior holds plausible: value, unit, prior standard deviations from the median,
    and the prior in words."""

    name: str
    value: float
    unit: str
    deviations: float
    prior: str


def edges_of(fit: Fit) -> tuple[Edge, ...]:
    """Base parameters beyond FAR prior standard deviations, the furthest first."""
    own = {p.name for p in fit.problem.prior.free if not p.owner}
    values = fit.problem.prior.values(fit.z[None])
    found = [
        Edge(p.name, float(values[p.name][0]), p.unit, float(z), p.prior_text())
        for p, z in zip(fit.problem.prior.free, fit.z)
        if p.name in own and abs(z) > FAR
    ]
    return tuple(sorted(found, key=lambda x: -abs(x.deviations)))


def imitations(
    search: Search, fits: Mapping[frozenset[str], Fit], named: frozenset[str], friction_N: float, limits: RigLimits
) -> tuple[Imitation, ...]:
    """Every dependence that the base can imitate and that these tests show beside the named effects. fits : of sets of
    these; friction_N : what gaps are a share of."""
    known = dict(search.fits) | dict(fits)
    own = {p.name for p in search.base.problem.prior.free if not p.owner}

    def found(freedom: Freedom) -> Imitation | None:
        return _imitation(search, known.get(named - {*freedom.effects}, search.base), freedom, friction_N, limits)

    some = alongside(found, [x for x in FREEDOMS if set(x.neutral) <= own])
    return tuple(x for x in some if x is not None)


def _imitation(search: Search, free: Fit, freedom: Freedom, friction_N: float, limits: RigLimits) -> Imitation | None:
    data = search.data
    neutral = _neutral(search, free, freedom)
    if neutral is None:
        return None
    without = quick_gap_N(data, neutral) / friction_N
    if without < USED_SHARE:
        return None
    fits = {freedom.name: free}
    for name in freedom.effects:
        some = [f for e in search.effects.get(name, ()) if (f := _with(data, neutral, e)) is not None]
        if some:
            fits[name] = max(some, key=lambda f: f.log_evidence)
    found = sorted(
        (
            Explanation(n, f.log_evidence - free.log_evidence, quick_gap_N(data, f) / friction_N)
            for n, f in fits.items()
        ),
        key=lambda x: x.share,
    )
    first = found[0]
    if not _shown(found, without, free.log_evidence - neutral.log_evidence):
        return None
    tied = tuple(x.name for x in found if _explains(x, first, without) and not _distinguished(first, x))
    following = None
    if len(tied) > 1:
        bench = [search.effects[n][0].bench for n in tied[:2] if n in search.effects]
        following = next_test(data, fits[tied[0]], fits[tied[1]], (tied[0], tied[1]), bench, limits)
    return Imitation(freedom.name, freedom.what, without, tuple(found), tied, following)


def _shown(found: Sequence[Explanation], without: float, gained: float) -> bool:
    """Do the tests show the dependence: does the best explanation gain what an effect must, and make the gap smaller?
    gained : nats of the freedom over none of them."""
    nats, share = gained + max(x.nats for x in found), min(x.share for x in found)
    return nats >= EFFECT_NATS and without - share >= USED_SHARE


def _distinguished(first: Explanation, other: Explanation) -> bool:
    """Do these tests tell another explanation from the one that leaves the least gap?"""
    return first.nats - other.nats > TELLS_NATS and other.share > TELLS_RATIO * first.share


def _explains(one: Explanation, first: Explanation, without: float) -> bool:
    """Does it do at least half of what the best does to the gap?"""
    return one.share <= first.share + 0.5 * (without - first.share)


def _neutral(search: Search, free: Fit, freedom: Freedom) -> Fit | None:
    """The model of a fit with a freedom of the base at its neutral value."""
    fixed = {n: ParameterChange(fixed=v) for n, v in freedom.neutral.items()}
    settings = replace(search.settings, parameters={**search.settings.parameters, **fixed})
    problem = base_problem(search.data, settings, search.scales, free.problem.model).with_effects(free.effects)
    at = [free.problem.names.index(n) for n in problem.names]
    return _fitted(search.data, problem, free.z[None, at], _near(problem.prior, free.z[at]))


def _near(prior: Prior, z: Array) -> Array:
    """Points (n, ndim) about z and from the prior, the same in every run."""
    rng = np.random.default_rng(0)
    return np.concatenate([z + 0.5 * rng.standard_normal((40, len(z))), prior.draw(rng, 200)])


def _with(data: GapData, neutral: Fit, effect: Effect) -> Fit | None:
    """A fit with one effect more; None where that has no finite force."""
    problem = on_top(neutral, effect)
    points = start_points(effect, problem, neutral.z[None], neutral.problem.names)
    return _fitted(data, problem, points[:1], points)


def _fitted(data: GapData, problem: Problem, start: Array, points: Array) -> Fit | None:
    try:
        starts = np.concatenate([start, cheapest(data, problem, points, STARTS)])
        return fit_model(data, problem, starts, ITERATIONS)
    except FitError:
        return None
