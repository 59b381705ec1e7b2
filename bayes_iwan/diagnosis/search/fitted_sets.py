"""What a search has fitted so far: the best fit of every set of effects, its score, and what could be added.

An effect starts from the smaller model's optima at several strengths and extra parameters: those that promise most
once the smaller model's own parameters may move (one Gauss–Newton step).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import islice
from operator import gt

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.search.base_fit import BASE_POINTS, fit_base, newton_nats, quick_gap_N, sound_gap_N
from bayes_iwan.diagnosis.search.candidates import Candidate, failing, in_place, on_top
from bayes_iwan.diagnosis.search.refits import Refit, Refits
from bayes_iwan.diagnosis.search.search_result import LAST, alike_pairs, look_alike, part, score
from bayes_iwan.effects.base import TYPICAL_SHARE, Effect
from bayes_iwan.effects.by_test import ByTest
from bayes_iwan.effects.catalogue import Maker, ordered
from bayes_iwan.inference.setup.loop_error import harmonics_of
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models import Simulator
from bayes_iwan.threads import alongside

Report = Callable[[str], None]


def silent(what: str) -> None:
    """No progress shown."""


class FittedSets:
    """The fits found so far, and what is asked of them, each once.

    fits : the best of every set of effects; effects : every law on offer by effect; failed : effects that cannot be
    used, and why
    """

    def __init__(
        self,
        data: GapData,
        scales: Scales,
        settings: DiagnoseSettings,
        kinds: Mapping[str, tuple[Maker, ...]],
        rng: np.random.Generator,
        report: Report,
        simulator: Simulator | None,
        executor: Executor | None,
    ) -> None:
        self.data, self.rng, self.report = data, rng, report
        self.fits: dict[frozenset[str], Fit] = {}
        self._gaps: dict[tuple[frozenset[str], float], float] = {}
        self._offers: dict[tuple[frozenset[str], float, bool], list[Candidate]] = {}  # found once for each fit
        self.failed: dict[str, str] = {}
        report("base model")
        base = fit_base(data, settings, scales, rng, simulator)
        self.fits[frozenset()] = base
        self.effects: dict[str, tuple[Effect, ...]] = {}
        every = [k for some in kinds.values() for k in some]
        scaled = iter(list(alongside(lambda k: calibrated(k, scales, data, base.problem, base.z), every)))
        for name, classes in kinds.items():
            some = tuple(islice(scaled, len(classes)))
            wrong = [w for w in (failing(data, base, e) for e in some) if w]
            if wrong and len(wrong) == len(some):
                self.failed[name] = wrong[0]
            else:
                self.effects[name] = some
        self.refits = Refits(executor, data, base.problem, [e for some in self.effects.values() for e in some])

    @property
    def base(self) -> Fit:
        return self.fits[frozenset()]

    # ---- the score

    def gaps_N(self, fits: Sequence[Fit]) -> list[float]:
        """RMS gaps, N; found once for each fit, several side by side."""
        new = {(f.names, f.log_evidence): f for f in fits if (f.names, f.log_evidence) not in self._gaps}
        self._gaps |= zip(new, self.refits.asked(quick_gap_N, list(new.values())))
        return [self._gaps[f.names, f.log_evidence] for f in fits]

    def scores(self, fits: Sequence[Fit]) -> list[float]:
        """See :func:`.found.score`."""
        sound_N, tests = sound_gap_N(self.data), self.data.tests
        return [
            score(f.log_evidence, newton_nats(gap_N, sound_N, tests), f.names, alike_pairs(self.effects, f.names))
            for f, gap_N in zip(fits, self.gaps_N(fits))
        ]

    def ranked(self, some: Iterable[frozenset[str]]) -> list[Fit]:
        """The fits of some sets, that of the best score first."""
        fits = [self.fits[k] for k in some]
        return [fits[i] for i in np.argsort(-np.array(self.scores(fits)))]

    def sets(self, size: int) -> list[frozenset[str]]:
        """The fitted sets of a size that have nothing of LAST."""
        return [k for k in self.fits if len(k) == size and not k & LAST]

    # ---- refits

    def _keep(self, some: Sequence[Refit]) -> None:
        """Refit models and remember each that is the best of its set."""
        found, fits = self.refits(some), list[Fit | None]()
        for one in some:
            self.report("+".join(e.name for e in one.problem.effects) or "base model")
            fits.append(next(found))
        for fit in fits:  # when all are there: whoever refits them is asked again
            old = None if fit is None else self.fits.get(fit.names)
            if fit is not None and (old is None or gt(*self.scores([fit, old]))):
                self.fits[fit.names] = fit

    def add(self, some: Sequence[Candidate], smaller: Fit) -> None:
        """Refit candidates, from where each promised most and from where it was best beside the base alone."""
        self._keep([self._start(one, smaller) for one in some])

    def exchange(self, some: Sequence[Candidate], smaller: Fit, old: Fit) -> None:
        """The same, and by each of their laws from where it does what the effect did that is in the larger fit."""
        models = []
        for one in some:
            for law in (e for e in self.effects[one.name] if e.possible(self.data)):
                problem = on_top(smaller, law)
                starts = in_place(self.data, old, problem, law)[None]
                if law is one.effect:
                    starts = np.concatenate([self._start(one, smaller).starts, starts])
                models.append(Refit(problem, starts))
        self._keep(models)

    def _start(self, one: Candidate, smaller: Fit) -> Refit:
        starts, draws = one.starts, np.empty(0)
        alone = self.fits.get(frozenset({one.name}))
        if smaller.effects and alone is not None:
            z = dict(zip(smaller.problem.names, smaller.z)) | dict(zip(alone.problem.names, alone.z))
            starts = np.concatenate([starts, np.array([[z.get(n, 0.0) for n in one.problem.names]])])
        if one.effect.sudden and not smaller.effects:  # the base may have adapted too far to lead there
            draws = one.problem.prior.draw(self.rng, BASE_POINTS)
        return Refit(one.problem, starts, draws)

    def offered(self, smaller: Fit, last: bool = False) -> list[Candidate]:
        """Candidates on top of a fit, LAST alone or all others, each effect by its most promising law, the most
        promising first; of two look-alikes that solve for the specimen's motion one, since one within the other costs
        most."""
        at = (smaller.names, smaller.log_evidence, last)
        if at not in self._offers:
            solved = [e for e in smaller.effects if "around" in e.stages]
            tried = [
                e
                for n, some in self.effects.items()
                if n not in smaller.names
                and (n in LAST) == last
                and not ("around" in some[0].stages and any(look_alike(self.effects, n, e.name) for e in solved))
                for e in some
                if e.possible(self.data)
            ]
            found = self.refits.candidates(smaller, tried, *self.gaps_N([smaller]))
            by_name = {c.name: c for c in sorted(found, key=lambda c: c.score)}
            self._offers[at] = sorted(by_name.values(), key=lambda c: -c.score)
        return self._offers[at]

    def without(self, fit: Fit, name: str) -> Fit:
        """The fit of the same set less one effect, from this fit's optimum too."""
        problem = fit.problem.with_effects([e for e in fit.effects if e.name != name])
        self._keep([Refit(problem, part(fit, problem)[None])])
        return self.fits.get(fit.names - {name}, self.base)


def calibrated(kind: Maker, scales: Scales, data: GapData, base: Problem, z: Array) -> Effect:
    """An effect whose strength has the prior share of the friction force on the base model fitted at z (ndim,).

    The share is that of the RMS change of force, its mean included, over the RMS friction force of all tests.
    """
    files = tuple(x.file for x in data.loops)
    effect = kind(scales, files)
    guess = effect.first_guess()
    trial = np.unique(np.minimum(guess * np.logspace(-3.0, 3.0, 61), 0.999 * effect.limit))
    values = {n: np.full(len(trial), v[0]) for n, v in base.prior.values(z[None]).items()}
    for p in effect.parameters:
        values[p.name] = np.full(len(trial), float(p.value(np.zeros(1))[0]))
    if isinstance(effect, ByTest):
        return replace(effect, strength_value=float(TYPICAL_SHARE * np.sqrt(2.0) * friction_rms_N(base, z)))
    for i, name in enumerate(effect.strength_names):
        values[name] = trial * (-1.0) ** i  # a series: as if its coefficients took turns
    extended = base.with_effects(ordered((*base.effects, effect)))
    parameter_values = base.parameter_values_of(values)
    plain = harmonics_of(base.force(parameter_values, data.steady_motion), data.harmonics_N.shape[1])
    added = effect.recorded(data, parameter_values)
    if added is not None:
        change = added.mean(axis=2)
    else:
        motion = data.block_motion if effect.evolving else data.steady_motion
        moved = harmonics_of(extended.force(parameter_values, motion), data.harmonics_N.shape[1])
        change = moved - plain[:, motion.test]
    power = np.abs(change[..., 0]) ** 2 + 0.5 * np.sum(np.abs(change[..., 1:]) ** 2, axis=-1)
    share = np.sqrt(power.mean(axis=1)) / friction_rms_N(base, z)
    share = np.maximum.accumulate(np.where(np.isfinite(share), share, 0.0))
    if share[-1] <= 1e-9:
        return replace(effect, strength_value=float(guess))
    grows = np.r_[True, np.diff(share) > 0] & (share > 0)
    at = np.exp(np.interp(np.log(TYPICAL_SHARE), np.log(share[grows]), np.log(trial[grows])))
    return replace(effect, strength_value=float(min(at, 0.5 * effect.limit)))


def friction_rms_N(problem: Problem, z: Array) -> float:
    """RMS friction force over all fitted tests at z (ndim,), N."""
    return float(np.sqrt(np.mean(problem.friction_force(problem.parameter_values(z[None])) ** 2)))
