"""The catalogue: every effect by name, its variants, and strengths brought to the fitted specimen's scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayes_iwan.effects import channels as effects_channels
from bayes_iwan.effects import friction as effects_friction
from bayes_iwan.effects import mounting as effects_rig
from bayes_iwan.effects import specimen as effects_specimen
from bayes_iwan.effects import unlisted as effects_unlisted
from bayes_iwan.effects.base import Effect, EffectError
from bayes_iwan.effects.paper import missing_terms

BUILT_IN: tuple[type[Effect], ...] = (
    *effects_specimen.EFFECTS,
    *effects_friction.EFFECTS,
    *effects_rig.EFFECTS,
    *effects_channels.EFFECTS,
)
#: names, in the order of the signal; an effect with variants (50 and 60 Hz) is one name
NAMES: tuple[str, ...] = tuple(dict.fromkeys(e.name for e in BUILT_IN))
#: shapes without a cause, which stand for "unknown"
UNLISTED: tuple[type[Effect], ...] = effects_unlisted.EFFECTS


def variants(
    extra: Sequence[type[Effect]] = (),
    model: Mapping[str, str] | None = None,
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
