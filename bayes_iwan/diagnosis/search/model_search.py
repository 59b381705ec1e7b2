"""Which set of effects, together with the base model, explains the data best.

One score says it (:func:`.found.score`), for taking in, exchanging, dropping and ranking alike. Sets grow effect by
effect, several of each size side by side, so that two effects that only help together are found from either of them;
then each effect of the best set is dropped and exchanged if that scores more.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_iwan.diagnosis.constants import BEAM, BRANCH, MOST_EFFECTS, PROMISE, SINGLE_MOST
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.search.base_fit import gap_of, sound_gap_N
from bayes_iwan.diagnosis.search.candidates import Candidate
from bayes_iwan.diagnosis.search.fitted_sets import FittedSets, Report, silent
from bayes_iwan.diagnosis.search.search_result import LAST, Search, look_alike
from bayes_iwan.effects.catalogue import Maker
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models import Simulator


def fit_singles(found: FittedSets) -> None:
    """Refit every single effect that promises anything. Where the base misses more than it does of a sound specimen,
    the first ones anyway, and those of which a first step tells little: where that much changes along the record, all
    that acts there, since one step of a fade that recovers leads nowhere. Once more from a better base: one that is not
    at its optimum is the commonest false gap."""
    base, missing = found.base, not as_sound(found)
    found.add(tried_alone(found.offered(base), missing, missing and changes_along(found)), base)
    for fit in found.ranked(found.sets(1))[:BEAM]:
        found.without(fit, *fit.names)
    if found.base.log_evidence > base.log_evidence + 1.0:
        fit_singles(found)


def tried_alone(offered: Sequence[Candidate], missing: bool, changing: bool) -> list[Candidate]:
    """The candidates that are refitted as single effects; missing : is more than a sound specimen's gap there,
    changing : does as much change along the record?"""
    return [
        x
        for i, x in enumerate(offered)
        if x.gain > PROMISE or (missing and (i < SINGLE_MOST or x.effect.sudden)) or (changing and x.effect.evolving)
    ]


def as_sound(found: FittedSets) -> bool:
    """Does the base miss no more than it does of a sound specimen?"""
    return found.gaps_N([found.base])[0] <= sound_gap_N(found.data)


def changes_along(found: FittedSets) -> bool:
    """Does more than a sound specimen's gap of the base change along the record?"""
    return gap_of(found.data, found.base).along.rms_N > sound_gap_N(found.data)


def promising(offered: Sequence[Candidate], most: int) -> list[Candidate]:
    """The candidates that promise anything, at most so many."""
    return [x for x in offered[:most] if x.score > PROMISE]


def grow(found: FittedSets, most: int) -> Fit:
    """Fit larger and larger sets: the best few of each size, each with the effects that promise most there. The best
    of all."""
    best = found.ranked([frozenset(), *found.sets(1)])[0]
    for size in range(1, most):
        for fit in found.ranked(found.sets(size))[:BEAM]:
            found.add(promising(found.offered(fit), BRANCH), fit)
        larger = found.ranked([best.names, *found.sets(size + 1)])[0]
        if larger.names == best.names:
            break
        best = larger
    return best


def add_model_form(found: FittedSets, current: Fit) -> Fit:
    """The set with model-form effects, as many of them as score more."""
    while True:
        found.add(promising(found.offered(current, last=True), BRANCH), current)
        more = [k for k in found.fits if current.names < k and len(k) == len(current.names) + 1]
        larger = found.ranked([current.names, *(k for k in more if k - current.names <= LAST)])[0]
        if larger.names == current.names:
            return current
        current = larger


def settle(found: FittedSets, current: Fit) -> Fit:
    """Each effect in turn dropped, and exchanged for what resembles it and what promises most in its place, where that
    scores more."""
    for name in sorted(current.names):
        less = found.without(current, name)
        offered = [x for last in (False, True) for x in found.offered(less, last) if x.name != name]
        alike = [x for x in offered if look_alike(found.effects, name, x.name)]
        others = promising([x for x in offered if x not in alike], BRANCH)
        new = [x for x in others if less.names | {x.name} not in found.fits]
        found.exchange([*alike, *new], less, current)
        exchanged = [k for k in found.fits if less.names < k and len(k) == len(current.names)]
        current = found.ranked([less.names, *exchanged])[0]
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
    """Fit the base and every single effect, then sets of up to `most` effects.

    executor : from :func:`bayes_iwan.executors.opened`, to refit the candidates of a step side by side.
    """
    found = FittedSets(data, scales, settings, kinds, rng, report, simulator, executor)
    fit_singles(found)
    if found.ranked(found.fits)[0].effects or not as_sound(found):  # only what helps alone grows
        settle(found, add_model_form(found, grow(found, most)))
    current = found.ranked(found.fits)[0]
    for name in current.names:  # what is assessed beside it
        found.without(current, name)
    scores = dict(zip(found.fits, found.scores(list(found.fits.values()))))
    gain = {n: scores[current.names] - scores[current.names - {n}] for n in current.names}
    order = tuple(sorted(gain, key=lambda n: -gain[n]))
    return Search(data, scales, settings, found.fits, order, scores, found.effects, found.failed)
