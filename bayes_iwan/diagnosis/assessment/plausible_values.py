"""Numbers that no such cause has: a fit may want them, but then the effect stands for something else."""

from __future__ import annotations

import numpy as np

from bayes_iwan.diagnosis.constants import CLOCK_SPREAD, LARGEST_SCORE, LONGEST_PERIODS
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.effects.base import Effect


def implausible(effect: Effect, fit: Fit, data: GapData) -> str:
    """Why the fitted numbers of an effect are not plausible, "" where they are.

    A time constant must lie where the tested periods can tell it, and an effect of time in a channel needs frequencies
    that differ; a strength must have the sign that the effect's remedy supposes; every number must be within what its
    prior holds possible.
    """
    values = fit.problem.prior.values(fit.z[None])
    hz = np.array([x.frequency_hz for x in data.loops])
    for p in effect.parameters:
        if p.name not in fit.problem.names:
            continue
        z = float(fit.z[fit.problem.names.index(p.name)])
        short = p.name.split(".", 1)[1]
        value = float(values[p.name][0])
        if p.name != effect.strength_name and abs(z) > LARGEST_SCORE:
            return f"{short} of {value:.3g} {p.unit} is beyond what is possible"
        if p.unit == "s" and not effect.evolving:
            period_s = 1.0 / hz.min()
            if abs(value) > LONGEST_PERIODS * period_s:
                return f"{short} of {value:.3g} s is longer than {LONGEST_PERIODS:g} of the tested periods"
        if p.name == effect.strength_name and not effect.signed and value < 0.0:
            return f"{short} of {value:.3g} {p.unit} is negative"
    if of_time(effect) and hz.max() < CLOCK_SPREAD * hz.min():
        return f"it follows from how the force follows frequency, and all tests are within a factor {CLOCK_SPREAD:g}"
    return ""


def replaced(less: Fit, whole: Fit) -> str:
    """Why an effect, which a larger fit has, only stands for a number of the base: that is at the edge of its prior
    without the effect and is not with it; "" where none is."""
    after = dict(zip(whole.problem.names, whole.z))
    for name, z in zip(less.problem.names, less.z):
        if abs(z) > LARGEST_SCORE and abs(after[name]) < LARGEST_SCORE - 1.0:
            return f"it replaces {name}, which is at the edge of its prior without it"
    return ""


def of_time(effect: Effect) -> bool:
    """Is an effect a delay, a lag or a filter of signals that repeat with the cycle?"""
    return not effect.evolving and effect.strength[2] in ("s", "Hz")
