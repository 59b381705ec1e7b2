"""The catalogue: every effect by name, its variants, and strengths brought to the fitted specimen's scale."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_iwan.effects import channels as effects_channels
from bayes_iwan.effects import friction as effects_friction
from bayes_iwan.effects import mounting as effects_rig
from bayes_iwan.effects import specimen as effects_specimen
from bayes_iwan.effects import unlisted as effects_unlisted
from bayes_iwan.effects.base import Effect, EffectError, stations_of
from bayes_iwan.effects.paper import missing_terms
from bayes_iwan.physics import Simulator
from bayes_iwan.physics.simulator import OUTER, offered

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
    simulator: Simulator | None = None,
) -> dict[str, tuple[type[Effect], ...]]:
    """Effect classes by name; extra are a user's own. With a simulator, those whose stations it offers, and what the
    paper adds to an Iwan model that lacks it. Raises EffectError if a name is taken or the simulator does not offer
    what an extra effect acts on."""
    out: dict[str, tuple[type[Effect], ...]] = {}
    for effect in (*BUILT_IN, *missing_terms(simulator)):
        if simulator is not None and not offered(stations_of(effect), simulator):
            continue
        out[effect.name] = (*out.get(effect.name, ()), effect)
    for effect in extra:
        if effect.name in (*out, "none", "unknown", *(e.name for e in UNLISTED)):
            raise EffectError(f"an effect named {effect.name!r} exists already; choose another name")
        if simulator is not None and not offered(stations_of(effect), simulator):
            inside = sorted(stations_of(effect) - simulator.stations - {*OUTER})
            raise EffectError(
                f"the effect {effect.name} acts on {inside[0]}, which the simulator {simulator.name} does not offer"
            )
        out[effect.name] = (effect,)
    return out


def unlisted(simulator: Simulator) -> tuple[type[Effect], ...]:
    """Those of :data:`UNLISTED` whose stations a simulator offers."""
    return tuple(k for k in UNLISTED if offered(stations_of(k), simulator))


def ordered(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which the signal meets them."""
    return tuple(sorted(effects, key=lambda e: e.order))
