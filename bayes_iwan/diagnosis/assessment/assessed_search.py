"""A finished search weighed: the figures of its effects, and fits and gaps of the sets that are spoken of."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bayes_iwan.diagnosis.assessment.calibration import SetProbabilities, set_probabilities
from bayes_iwan.diagnosis.assessment.indicators import Figures, figures_of, three_sets
from bayes_iwan.diagnosis.fits.evidence import Fit, fit_model, in_newtons, predicting
from bayes_iwan.diagnosis.fits.gap_size import GapSize, gap_size
from bayes_iwan.diagnosis.fits.held_out_tests import HeldOut, held_out_gaps
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.diagnosis.search.search_result import Search, part
from bayes_iwan.screen import on_screen
from bayes_iwan.threads import alongside

Names = frozenset[str]


class Models:
    """Fits of sets of effects and the gaps that they leave, each found once.

    fits; nearest, the same models where they miss least in newtons; predicting, as they predict held-out tests; sizes,
    what they miss in newtons
    """

    def __init__(self, search: Search, seed: int) -> None:
        self.search, self.seed = search, seed
        self.fits: dict[Names, Fit] = {}
        self.nearest: dict[Names, Fit] = {}
        self.predicting: dict[Names, Fit] = {}
        self.sizes: dict[Names, GapSize] = {}

    def find(self, sets: Iterable[Names]) -> None:
        """Fit what is not there yet, the smaller sets first: a larger one starts where they ended, too."""
        data = self.search.data
        for names in sorted(dict.fromkeys(sets), key=lambda k: (len(k), sorted(k))):
            if names in self.fits:
                continue
            fit = self.search.fits.get(names) or self._refitted(names)
            smaller = [f for k, f in self.nearest.items() if k < names]
            nearest = in_newtons(data, fit, smaller=smaller)
            friction_N = self.sizes[Names()].friction_N if self.sizes else None
            self.fits[names], self.nearest[names] = fit, nearest
            self.sizes[names] = gap_size(residual_of(data, nearest), self.seed, friction_N=friction_N)

    def predict(self, sets: Iterable[Names]) -> list[Fit]:
        """These models as they predict tests that they have not seen."""
        new = [k for k in dict.fromkeys(sets) if k not in self.predicting]
        data = self.search.data
        found = alongside(lambda k: predicting(data, self.fits[k], self.nearest[k]), new)
        self.predicting |= zip(new, found)
        return [self.predicting[k] for k in dict.fromkeys(sets)]

    def _refitted(self, names: Names) -> Fit:
        larger = min((f for k, f in self.search.fits.items() if names < k), key=lambda f: len(f.names))
        problem = larger.problem.with_effects([e for e in larger.effects if e.name in names])
        return fit_model(self.search.data, problem, np.array([part(larger, problem)]), 20)


@dataclass(frozen=True)
@on_screen
class Weighed:
    """Everything behind a verdict but the calibration's constants.

    search : its chosen effects are those of the best set
    figures : of every effect of that set
    models : fits and gaps of it and of what it is compared with
    held_out : what the compared sets miss on held-out tests; sets : probability of every fitted set
    """

    search: Search
    figures: tuple[Figures, ...]
    models: Models
    held_out: tuple[HeldOut, ...]
    sets: SetProbabilities


def weighed(search: Search, seed: int) -> Weighed:
    """Figures of the effects of the best set, fits and gaps behind them."""
    models, whole = Models(search, seed), frozenset(search.chosen)
    models.find(three_sets(whole))
    compared = [search.fits[k] for k in dict.fromkeys(three_sets(whole)) if k in search.fits]
    held_out = held_out_gaps(compared, search.data) if whole else ()
    return assessed(search, models, held_out)


def assessed(search: Search, models: Models, held_out: tuple[HeldOut, ...]) -> Weighed:
    """The same from fits that are there."""
    figures = figures_of(search, models.sizes, models.nearest[frozenset(search.chosen)], held_out)
    return Weighed(search, figures, models, held_out, set_probabilities(search.scores, search.data.tests))
