"""The gap that an effect makes, asked from the other side: what is left of it with the effect's part taken out of the
records.

An effect that is put into the model takes up what resembles it, of other causes, too; and beside others, which have
taken up part of its own, it finds less to take. What it makes of the force according to the whole model, taken out of
the records, leaves all other causes where they are, but errs as the whole fit shares out among its effects. The two
ways err apart, so a share is said as their mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from bayes_iwan.gap.fitting.data import GapData, predicted
from bayes_iwan.gap.fitting.evidence import Fit, extended, refitted_in_newtons
from bayes_iwan.gap.fitting.gap_size import gap_size
from bayes_iwan.gap.fitting.residuals import residual_of
from bayes_iwan.gap.judging.budget import Share, shapley
from bayes_iwan.threads import alongside

#: of the size of a gap that is compared alone, without its interval
_DRAWS = 100


def data_without(data: GapData, fit: Fit, names: Iterable[str]) -> GapData:
    """The data less what some effects of a fitted model make of them, the others as they are there."""
    out = frozenset(names)
    fewer = extended(fit.problem, [e for e in fit.effects if e.name not in out])
    whole = predicted(data, fit.problem, fit.z[None])
    less = predicted(data, fewer, fit.z[None, [fit.problem.names.index(n) for n in fewer.names]])
    made = [
        np.zeros_like(measured) if a is None else a[0] - (0.0 if b is None else b[0])
        for measured, a, b in zip((data.harmonics_N, data.trend_N, data.mains_N), whole, less)
    ]
    made[1:] = [
        np.where(np.isfinite(noise), x, 0.0) for x, noise in zip(made[1:], (data.trend_noise_N, data.mains_noise_N))
    ]
    loops, trend, mains = made
    return replace(
        data, harmonics_N=data.harmonics_N - loops, trend_N=data.trend_N - trend, mains_N=data.mains_N - mains
    )


def gaps_without(data: GapData, base: Fit, whole: Fit, sets: Iterable[frozenset[str]]) -> dict[frozenset[str], float]:
    """RMS gap of the base model, N, refitted to the data less what each set of effects makes of them. base : where it
    misses least in newtons; whole : the model that says what effects make, in which others may be."""
    theirs = dict(zip(whole.problem.names, whole.z))
    starts = [base.z, *base.optima, np.array([theirs[n] for n in base.problem.names])]

    def gap_N(out: frozenset[str]) -> float:
        less = data_without(data, whole, out) if out else data
        return gap_size(residual_of(less, refitted_in_newtons(less, base, starts)), draws=_DRAWS).all.rms_N

    some = list(sets)
    return dict(zip(some, alongside(gap_N, some)))


def both_ways(put_in: Mapping[str, Share], left_N: Mapping[frozenset[str], float]) -> dict[str, Share]:
    """The mean of the share that each effect removes, put in, and of that which goes with it, taken out (Shapley value
    over these effects of :func:`gaps_without`), such that they sum to what all remove together, as those put in do;
    intervals are theirs, about that mean."""
    if len(put_in) < 2:
        return dict(put_in)
    before = left_N[frozenset()]
    out = shapley(put_in, lambda k: np.array(1.0 - left_N[k] / before)) if before > 0.0 else dict.fromkeys(put_in, 0.0)
    moved = {n: 0.5 * (float(out[n]) - s.value) for n, s in put_in.items()}
    alike = sum(moved.values()) / len(moved)
    return {n: s.about(s.value + moved[n] - alike) for n, s in put_in.items()}
