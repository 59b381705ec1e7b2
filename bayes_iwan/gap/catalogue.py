"""The catalogue: every effect by name, its variants, and strengths brought to the fitted specimen's scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..inference.defaults import Scales, model_numbers
from ..inference.likelihood import harmonics_of
from ..inference.problem import Problem
from . import effects_channels, effects_friction, effects_rig, effects_specimen, effects_unlisted
from .data import GapData
from .effects import TYPICAL_SHARE, Effect, EffectError
from .effects_paper import missing_terms

Array = NDArray[np.float64]

BUILT_IN: tuple[type[Effect], ...] = (*effects_specimen.EFFECTS, *effects_friction.EFFECTS, *effects_rig.EFFECTS,
                                      *effects_channels.EFFECTS)
#: names, in the order of the signal; an effect with variants (50 and 60 Hz) is one name
NAMES: tuple[str, ...] = tuple(dict.fromkeys(e.name for e in BUILT_IN))
#: shapes without a cause, which stand for "unknown"
UNLISTED: tuple[type[Effect], ...] = effects_unlisted.EFFECTS


def variants(extra: Sequence[type[Effect]] = (), model: Mapping[str, str] | None = None,
             ) -> dict[str, tuple[type[Effect], ...]]:
    """Effect classes by name; extra are a user's own; model is the base's [model] table: what the paper adds and that
    base lacks is offered too. Raises EffectError if a name is taken."""
    out: dict[str, tuple[type[Effect], ...]] = {}
    for effect in (*BUILT_IN, *missing_terms(model or {})):
        out[effect.name] = (*out.get(effect.name, ()), effect)
    for effect in extra:
        if effect.name in (*out, "none", "unknown", *(e.name for e in UNLISTED)):
            raise EffectError(f"an effect named {effect.name!r} exists already; choose another name")
        out[effect.name] = (effect,)
    return out


def ordered(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which the signal meets them."""
    return tuple(sorted(effects, key=lambda e: e.order))


def calibrated(kind: type[Effect], scales: Scales, data: GapData, base: Problem, z: Array) -> Effect:
    """An effect whose strength has the prior share of the friction force on the base model fitted at z (ndim,).

    The share is that of the RMS change of force, its mean included, over the RMS friction force of all tests.
    """
    files = tuple(x.file for x in data.loops)
    effect = kind(scales, files)
    guess = effect.first_guess()
    trial = np.minimum(guess * np.logspace(-3.0, 3.0, 61), 0.999 * kind.limit)
    trial = np.unique(trial)
    values = {n: np.full(len(trial), v[0]) for n, v in base.prior.values(z[None]).items()}
    for p in effect.parameters:
        values[p.name] = np.full(len(trial), float(p.value(np.zeros(1))[0]))
    if effect.strength_name not in values:                 # strengths that are no single number: hums
        return replace(effect, strength_value=float(TYPICAL_SHARE * np.sqrt(2.0) * friction_rms_N(base, z)))
    values[effect.strength_name] = trial
    model = replace(base.model, effects=ordered((*cast(tuple[Effect, ...], base.model.effects), effect)))
    numbers = model_numbers(model, values)
    plain = harmonics_of(base.model.force(numbers, data.steady_motion), data.harmonics_N.shape[1])
    added = effect.recorded(data, numbers)
    if added is not None:
        change = added.mean(axis=2)
    else:
        motion = data.block_motion if effect.evolving else data.steady_motion
        moved = harmonics_of(model.force(numbers, motion), data.harmonics_N.shape[1])
        change = moved - plain[:, motion.test]
    power = np.abs(change[..., 0]) ** 2 + 0.5 * np.sum(np.abs(change[..., 1:]) ** 2, axis=-1)
    share = np.sqrt(power.mean(axis=1)) / friction_rms_N(base, z)
    share = np.maximum.accumulate(np.where(np.isfinite(share), share, 0.0))
    if share[-1] <= 1e-9:
        return replace(effect, strength_value=float(guess))
    grows = np.r_[True, np.diff(share) > 0] & (share > 0)
    at = np.exp(np.interp(np.log(TYPICAL_SHARE), np.log(share[grows]), np.log(trial[grows])))
    return replace(effect, strength_value=float(min(at, 0.5 * kind.limit)))


def friction_rms_N(problem: Problem, z: Array) -> float:
    """RMS friction force over all fitted tests at z (ndim,), N."""
    return float(np.sqrt(np.mean(problem.model.friction_force(problem.numbers(z[None]), problem.motion) ** 2)))

