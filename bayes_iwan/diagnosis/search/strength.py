"""Strengths of effects brought to the fitted specimen's scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.effects.base import TYPICAL_SHARE, Effect
from bayes_iwan.effects.by_test import ByTest
from bayes_iwan.effects.catalogue import Maker, ordered
from bayes_iwan.inference.setup.loop_error import harmonics_of
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.problem import Problem


def calibrated(kind: Maker, scales: Scales, data: GapData, base: Problem, z: Array) -> Effect:
    """An effect whose strength has the prior share of the friction force on the base model fitted at z (ndim,).

    The share is that of the RMS change of force, its mean included, over the RMS friction force of all tests.
    """
    files = tuple(x.file for x in data.loops)
    effect = kind(scales, files)
    guess = effect.first_guess()
    trial = np.minimum(guess * np.logspace(-3.0, 3.0, 61), 0.999 * effect.limit)
    trial = np.unique(trial)
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
