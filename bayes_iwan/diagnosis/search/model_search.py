"""Which set of effects, together with the base model, explains the data best.

One score says it (:func:`.found.score`), for taking in, exchanging, dropping and ranking alike. Sets grow effect by
effect, several of each size side by side, so that two effects that only help together are found from either of them;
then each effect of the best set is dropped and exchanged as long as that scores more.

A base that is not at its optimum is the commonest false gap, so it starts from many points and again from the
optima of the best extended models.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_iwan.diagnosis.constants import BEAM, BRANCH, CHANGING, MOST_EFFECTS, PROMISE, ROUNDS, SINGLE_MOST
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.search.base_fit import has_gap, sound_gap_N
from bayes_iwan.diagnosis.search.candidates import Candidate
from bayes_iwan.diagnosis.search.fitted_sets import FittedSets, Report, silent
from bayes_iwan.diagnosis.search.search_result import LAST, Search, look_alike, part
from bayes_iwan.effects.catalogue import Maker
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models import Simulator


def fit_singles(found: FittedSets) -> None:
    """Refit every single effect that promises anything; where the base misses more than it does of a sound specimen,
    the first ones anyway, and those of which a first step tells little."""
    ranked: dict[str, int] = {}
    gap_N, along_N = found.gap_parts_N(found.base)
    changing = along_N > CHANGING * gap_N
    chosen = []
    for one in found.offered(found.base):
        rank = ranked.setdefault(one.name, len(ranked))
        asked = rank < SINGLE_MOST or one.effect.sudden or (changing and one.effect.evolving)
        if one.gain > PROMISE or (asked and not as_sound(found)):
            chosen.append(one)
    found.add(chosen, found.base)


def fit_base_again(found: FittedSets) -> bool:
    """The base from its part of the best extended optima: was it short of its optimum?"""
    base = found.base
    leaders = sorted((f for f in found.fits.values() if f.effects), key=lambda f: -f.log_evidence)[:4]
    before = base.log_evidence
    better = found.keep(base.problem, np.array([base.z, *(part(f, base.problem) for f in leaders)]), 40)
    return better is not None and better.log_evidence > before + 1.0


def as_sound(found: FittedSets) -> bool:
    """Does the base miss no more than it does of a sound specimen?"""
    return found.gap_parts_N(found.base)[0] <= sound_gap_N(found.data)


def promising(offered: Sequence[Candidate], most: int) -> list[Candidate]:
    """The candidates that promise anything, at most so many."""
    return [x for x in offered[:most] if x.score > PROMISE]


def grow(found: FittedSets, most: int) -> Fit:
    """Fit larger and larger sets: the best few of each size, each with the effects that promise most there. The best
    of all."""
    best = found.best([frozenset(), *found.sets(1)])[0]
    if not best.effects and as_sound(found):  # only what helps alone grows
        return best
    for size in range(1, most):
        for fit in found.best(found.sets(size), BEAM):
            found.add(promising(found.offered(fit), BRANCH), fit)
        larger = found.best([best.names, *found.sets(size + 1)])[0]
        if larger.names == best.names:
            break
        best = larger
    return best


def add_model_form(found: FittedSets, current: Fit) -> Fit:
    """The set with model-form effects, as many of them as score more."""
    while True:
        found.add(promising(found.offered(current, last=True), BRANCH), current)
        more = [k for k in found.fits if current.names < k and len(k) == len(current.names) + 1]
        larger = found.best([current.names, *(k for k in more if k - current.names <= LAST)])[0]
        if larger.names == current.names:
            return current
        current = larger


def settle(found: FittedSets, current: Fit) -> Fit:
    """Each effect in turn dropped, and exchanged for what resembles it and what promises most in its place, as long as
    that scores more."""
    for _ in range(ROUNDS):
        before = current.names
        for name in sorted(before):
            if name not in current.names:
                continue
            less = found.without(current, name)
            offered = [x for last in (False, True) for x in found.offered(less, last) if x.name != name]
            alike = [x for x in offered if look_alike(found.effects, name, x.name)]
            others = promising([x for x in offered if x not in alike], BRANCH)
            found.add([x for x in (*alike, *others) if less.names | {x.name} not in found.fits], less, current)
            exchanged = [k for k in found.fits if less.names < k and len(k) == len(current.names)]
            current = found.best([less.names, *exchanged])[0]
        if current.names == before:
            break
    return current


def search(
    data: GapData,
    scales: Scales,
    settings: DiagnoseSettings,
    kinds: Mapping[str, tuple[Maker, ...]],
    rng: np.random.Generator,
    report: Report = silent,
    most: int = MOST_EFFECTS,
    simulator: Simulator | None = None,
    executor: Executor | None = None,
) -> Search:
    """Fit the base and every single effect, then sets of up to `most` effects; the base alone where it misses nothing.

    executor : from :func:`bayes_iwan.executors.opened`, to refit the candidates of a step side by side.
    """
    found = FittedSets(data, scales, settings, kinds, rng, report, simulator, executor)
    if not has_gap(data, found.base):
        return Search(data, scales, settings, found.fits, (), {frozenset(): 0.0}, found.effects, found.failed)
    fit_singles(found)
    if fit_base_again(found):  # the base was short of its optimum: once more from there
        fit_singles(found)
    grown = grow(found, most)
    if grown.effects or not as_sound(found):
        settle(found, add_model_form(found, grown))
    current = found.best(found.fits)[0]
    for name in current.names:  # what is assessed beside it
        found.without(current, name)
    scores = dict(zip(found.fits, found.scores(list(found.fits.values()))))
    gain = {n: scores[current.names] - scores[current.names - {n}] for n in current.names}
    order = tuple(sorted(gain, key=lambda n: -gain[n]))
    return Search(data, scales, settings, found.fits, order, scores, found.effects, found.failed)
