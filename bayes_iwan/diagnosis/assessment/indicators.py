"""What tells an effect that contributes from one that merely absorbs: a few figures for each effect of the best set.

All of them compare sets that the search has fitted. Of those, the best with an effect and the best without it say what
its evidence is, other effects included; the same once more for every group of held-out tests, where the sets are ranked
by the other tests alone, says what it does where nothing was fitted, the choice of the set not either.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.constants import (
    CLOCK_SPREAD,
    LARGEST_SCORE,
    LEAST_OF_FRICTION,
    LONGEST_PERIODS,
    SHOWN_BY_RECORD,
)
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.gap_size import GapSize, moved_shares
from bayes_iwan.diagnosis.fits.held_out_tests import HeldOut, share_by_test
from bayes_iwan.diagnosis.search.base_fit import newton_nats, sound_gap_N
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM, Search, alike_pairs, any_alike, score
from bayes_iwan.effects.base import Effect
from bayes_iwan.screen import on_screen

Names = frozenset[str]


@dataclass(frozen=True)
@on_screen
class Figures:
    """One effect of the best set.

    gain : nats of score over the best set with the others and without it
    alternatives : score of the best set with each other effect in its place, less the score of the best set; itself at
    0
    fitted : share of the gap of the base that it removes last, in newtons; along : of the part that changes along the
        record, None where it does not act there
    alone : share of the gap that it removes as the only effect
    held_out : mean over held-out tests of the share of the gap that it removes there, 0 where the other tests would not
        have chosen it or what resembles it; nan where no test can be held out for it
    moved : RMS force that it moves, before : RMS gap of the base, both over the friction force
    tests : how many were fitted
    odd : why its numbers are not plausible, or why there is nothing to explain; "" where neither speaks against it
    """

    name: str
    gain: float
    alternatives: dict[str, float]
    fitted: float
    alone: float
    held_out: float
    moved: float
    before: float
    tests: int
    odd: str = ""
    along: float | None = None

    @property
    def has_held_out(self) -> bool:
        """Could any test be held out?"""
        return bool(np.isfinite(self.held_out))

    @property
    def removes(self) -> float:
        """Share that it removes last, of the gap or of the part that changes along the record, whichever is more."""
        return max(self.fitted, self.along or 0.0)


def three_sets(names: Names) -> list[Names]:
    """The sets behind the shares of each effect of a set: the base, each alone, all but each, all."""
    return [Names(), *(frozenset({n}) for n in sorted(names)), *(names - {n} for n in sorted(names)), names]


def figures_of(
    search: Search, sizes: Mapping[Names, GapSize], whole_in_newtons: Fit, held_out: Sequence[HeldOut]
) -> tuple[Figures, ...]:
    """The figures of every effect of the best set.

    sizes : gap of the base, the best set, it without each effect and each effect alone; whole_in_newtons : the best set
    where it misses least; held_out : what these miss on held-out tests
    """
    whole, none = frozenset(search.chosen), Names()
    if not whole:
        return ()
    data, best, top = search.data, search.fit(whole), search.scores[whole]
    level = float(np.sqrt(np.mean(data.level_N**2)))
    before, left = sizes[none].all.rms_N, sizes[whole].all.rms_N
    least_N = LEAST_OF_FRICTION * level
    changes = sizes[none].along.rms_N >= least_N
    moved, ranked = moved_shares(best, data), [ranked_by_training(search, u) for u in held_out]

    def of_gap(part_N: float) -> float:
        return float(part_N / before) if before > 0.0 else 0.0

    out = []
    for effect in best.effects:
        name = effect.name
        less = whole - {name}
        less_along_N = float(sizes[less].along.rms_N - sizes[whole].along.rms_N)
        share_along = less_along_N / sizes[none].along.rms_N if changes and effect.evolving else None
        of_cycles = name not in SHOWN_BY_RECORD and all(e.evolving for e in search.effects[name])
        predicts = bool(held_out) and effect.strength_name in best.problem.names
        has = partial(any_alike, search.effects, name)
        out.append(
            Figures(
                name=name,
                gain=top - search.scores.get(less, -np.inf),
                alternatives={name: 0.0}
                | {
                    next(iter(k - less)): v - top for k, v in search.scores.items() if less < k and len(k) == len(whole)
                },
                fitted=of_gap(sizes[less].all.rms_N - left),
                alone=of_gap(before - sizes[frozenset({name})].all.rms_N),
                held_out=float(np.mean([chosen_share(u.power_N2, x, has) for u, x in zip(held_out, ranked)]))
                if predicts
                else float("nan"),
                moved=moved[name],
                before=before / level,
                tests=data.tests,
                along=share_along,
                # numbers are reported from the one fit, shares from the other
                odd=("" if sizes[none].all.resolved_share else "the base misses no more than noise may make")
                or (
                    "what it removes does not change from cycle to cycle"
                    if of_cycles and less_along_N < least_N
                    else ""
                )
                or implausible(effect, best, data)
                or implausible(effect, whole_in_newtons, data)
                # of the base's form it is what a number at the edge says
                or ("" if name in MODEL_FORM else replaced(search.fit(less), best)),
            )
        )
    return tuple(out)


def ranked_by_training(search: Search, held_out: HeldOut) -> dict[Names, Array]:
    """By set, (n,) the score that it has by the tests that each held-out one is predicted from."""
    sound_N = sound_gap_N(search.data)
    return {
        k: np.array(
            [
                score(nats, newton_nats(float(np.sqrt(gap_N2)), sound_N, int(tests)), k, alike_pairs(search.effects, k))
                for nats, gap_N2, tests in trained.T
            ]
        )
        for k, trained in held_out.trained.items()
    }


def chosen_share(power_N2: Mapping[Names, Array], scores: Mapping[Names, Array], has: Callable[[Names], bool]) -> float:
    """Mean over held-out tests of the share that an effect removes there, of sets that the other tests chose: the best
    with it over the best without; nothing where these tests would have chosen none with it.

    power_N2 : by set, (n,) squared gaps; scores : by set, (n,) by the tests that each was predicted from; has : is the
    effect, or what resembles it, in a set? Fewer tests may take one for the other.
    """
    without = [k for k in scores if not has(k)]
    out = []
    for t in range(len(scores[Names()])):
        top = max(scores, key=lambda k: scores[k][t])
        other = max(without, key=lambda k: scores[k][t])
        out.append(share_by_test(power_N2[other], power_N2[top])[t] if has(top) else 0.0)
    return float(np.mean(out))


def implausible(effect: Effect, fit: Fit, data: GapData) -> str:
    """Why the fitted numbers of an effect are not plausible, "" where they are.

    A time constant must lie where the tested periods can tell it (how long a change along the record takes is not
    meant), and an effect of time in a channel needs frequencies that differ at one amplitude. A number that is no
    strength must be within what its prior holds plausible, but towards an end of what it can be it may go as far as it
    likes: without a memory a law is one, too.
    """
    values = fit.problem.prior.values(fit.z[None])
    hz = np.array([x.frequency_hz for x in data.loops])
    for p in effect.parameters:
        if p.name not in fit.problem.names:
            continue
        z = float(fit.z[fit.problem.names.index(p.name)])
        short = p.name.split(".", 1)[1]
        value = float(values[p.name][0])
        endless = np.isinf(p.prior.support()[int(z > 0.0)])
        if p.name not in effect.strength_names and endless and abs(z) > LARGEST_SCORE:
            return f"{short} of {f'{value:.3g} {p.unit}'.removesuffix(' -')} is beyond what is plausible"
        if p.unit == "s" and (p.name == effect.strength_name or not effect.evolving):
            period_s = 1.0 / hz.min()
            if abs(value) > LONGEST_PERIODS * period_s:
                return f"{short} of {value:.3g} s is longer than {LONGEST_PERIODS:g} of the tested periods"
    of_one_amplitude = [hz[some] for some in groups_of([x.amplitude_mm for x in data.loops])]
    if of_time(effect) and max(np.ptp(np.log(some)) for some in of_one_amplitude) < np.log(CLOCK_SPREAD):
        return f"it follows from how the force follows frequency: tests of one amplitude are within {CLOCK_SPREAD:g}"
    return ""


def replaced(less: Fit, whole: Fit) -> str:
    """Why an effect, which a larger fit has, only stands for a number of the base: that is at the edge of its prior
    without the effect and is not with it; "" where none is."""
    after = dict(zip(whole.problem.names, whole.z))
    for p, z in zip(less.problem.prior.free, less.z):
        if not p.owner and abs(z) > LARGEST_SCORE and abs(after[p.name]) < LARGEST_SCORE - 1.0:
            return f"it replaces {p.name}, which is at the edge of its prior without it"
    return ""


def of_time(effect: Effect) -> bool:
    """Is an effect a delay, a lag or a filter of signals that repeat with the cycle?"""
    return not effect.evolving and effect.strength[2] in ("s", "Hz")
