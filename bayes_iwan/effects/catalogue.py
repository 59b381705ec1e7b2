"""The catalogue: every effect by name and its laws, those of a user's own file too."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bayes_iwan.effects import along_record, friction, lag, measuring_chain, model_form, mounting, specimen_forces
from bayes_iwan.effects.base import Effect, EffectError, stages_of
from bayes_iwan.effects.conditions import EFFECTS as OF_CONDITIONS
from bayes_iwan.effects.conditions import FollowsCondition, following
from bayes_iwan.effects.empirical_patterns import EFFECTS as WITHOUT_CAUSE
from bayes_iwan.effects.paper_stages import missing_terms
from bayes_iwan.models import Model, Scales, Simulator, sine_motion
from bayes_iwan.models.paper_parameters import table_1
from bayes_iwan.models.simulator import INNER, OUTER, offered, recorded_force
from bayes_iwan.models.user_file import classes_in, place_in

#: what makes an effect from (scales, tests): its class, or one that knows the condition that it follows
Maker = Callable[..., Effect]

BUILT_IN: tuple[type[Effect], ...] = (
    *specimen_forces.EFFECTS,
    *friction.EFFECTS,
    *lag.EFFECTS,
    *mounting.EFFECTS,
    *measuring_chain.EFFECTS,
    *along_record.EFFECTS,
)
#: names, in the order of the signal; an effect with several laws is one name
NAMES: tuple[str, ...] = tuple(dict.fromkeys(e.name for e in BUILT_IN))
#: patterns without a cause, which stand for "unknown"
UNLISTED: tuple[type[Effect], ...] = WITHOUT_CAUSE
#: causes in the base's form
FORM: tuple[type[Effect], ...] = model_form.EFFECTS


def variants(
    extra: Sequence[type[Effect]] = (),
    simulator: Simulator | None = None,
    conditions: Mapping[str, tuple[float, ...]] | None = None,
) -> dict[str, tuple[Maker, ...]]:
    """What makes effects of each name, one for each law. Raises EffectError if a name is taken or the simulator does
    not offer what an extra effect acts on.

    extra : a user's own classes; simulator : only effects whose stages it offers, and what the paper adds to an Iwan
    model that lacks it; conditions : what each test states, by name
    (:func:`bayes_iwan.effects.conditions.conditions_of`), which slip forces, stiffness and zero may follow.
    """
    out: dict[str, tuple[Maker, ...]] = {}

    def fits(effect: type[Effect]) -> bool:
        return simulator is None or offered(stages_of(effect), simulator)

    for effect in filter(fits, (*BUILT_IN, *FORM, *missing_terms(simulator))):
        out[effect.name] = (*out.get(effect.name, ()), effect)
    out |= following(conditions or {}, fits)
    own: dict[str, tuple[Maker, ...]] = {}
    for effect in extra:
        if effect.name in (*out, "none", "unknown", *(e.name for e in UNLISTED)):
            raise EffectError(f"an effect named {effect.name!r} exists already; choose another name")
        if simulator is not None and not fits(effect):
            inside = sorted(stages_of(effect) - simulator.stages - {*OUTER})
            raise EffectError(
                f"the effect {effect.name} acts on {inside[0]}, which the simulator {simulator.name} does not offer"
            )
        own[effect.name] = (*own.get(effect.name, ()), effect)
    return out | own


def unlisted(simulator: Simulator) -> tuple[type[Effect], ...]:
    """Those of :data:`UNLISTED` whose stages a simulator offers."""
    return tuple(k for k in UNLISTED if offered(stages_of(k), simulator))


def ordered(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which the signal meets them."""
    return tuple(sorted(effects, key=lambda e: e.order))


def load_effects(path: str | os.PathLike[str]) -> tuple[type[Effect], ...]:
    """The Effect subclasses defined in a user's Python file. Raises EffectError naming the file and the fix."""
    found = classes_in(path, Effect, EffectError)
    if not found:
        raise EffectError(f"{path}: defines no subclass of bayes_iwan.effects.Effect")
    for effect in found:
        missing = [n for n in ("name", "strength", "physics", "reference", "signature") if not hasattr(effect, n)]
        if effect.first_guess is Effect.first_guess:
            missing.append("first_guess")
        if missing:
            raise EffectError(f"{path}: {effect.__name__} lacks {', '.join(missing)}")
        if not (isinstance(effect.name, str) and effect.name.isidentifier()):  # type: ignore[redundant-expr]
            raise EffectError(f"{path}: {effect.__name__}.name = {effect.name!r} must be one word, as a variable's")
        said: object = effect.strength
        if not (isinstance(said, tuple) and len(said) == 4 and all(isinstance(x, str) for x in said)):
            raise EffectError(f"{path}: {effect.__name__}.strength must be four texts: name, symbol, unit, description")
        try:
            wrong = _wrong_with(effect)
        except Exception as error:
            if not (place := place_in(error)):
                raise
            raise EffectError(f"{place}: {type(error).__name__}: {error}; fix the file") from error
        if wrong:
            raise EffectError(f"{path}: {effect.__name__} {wrong}")
    return found


def _wrong_with(kind: type[Effect]) -> str:
    """What keeps an effect from being used, tried on two draws of Table 1 at 10 Hz and 1 mm; "" where nothing does."""
    beside = any(getattr(kind, n) is not getattr(Effect, n) for n in ("recorded", "lines"))
    if not (stages_of(kind) or beside):
        return f"acts nowhere: give it a method {', '.join((*OUTER, *INNER))}, recorded or lines"
    scales = Scales(length_mm=1.0, speed_m_s=0.1, force_N=5.0, slip_N=1.2, soft_N_mm=6.0, stiff_N_mm=14.0)
    effect, model = kind(scales, ("test",)), Model(scales.reference)
    if not 0.0 < (guess := effect.first_guess()) < np.inf:
        return f"has first_guess = {guess}; it must be positive"
    motion, same = (sine_motion(frequency_hz=10.0, amplitude_mm=scales.length_mm) for _ in range(2))
    values = {n: np.repeat(x, 2) for n, x in table_1(scales.reference).items()}
    plain = model.force(values, motion)
    values |= {n: np.full(2, x) for n, x in effect.off.items()}
    off = np.asarray(recorded_force(model, (effect,), values, motion))
    if any(np.any(getattr(motion, n) != getattr(same, n)) for n in ("displacement_mm", "velocity_m_s")):
        return "changes the motion's arrays, which all calls share; change a copy"
    if off.shape != plain.shape:
        return f"gives arrays of shape {off.shape}, not (draws, tests, samples) {plain.shape}"
    change = float(np.abs(off - plain).max())
    if not change < 1e-6 * scales.slip_N:  # NaN is none
        return f"changes the force by {change:.3g} N at strength 0; it must change none"
    return ""


def as_stored(effect: Effect) -> dict[str, object]:
    """An effect as files name it: its class, its name and what made it."""
    said: dict[str, object] = {
        "class": type(effect).__name__, "name": effect.name, "strength_value": effect.strength_value
    }  # fmt: skip
    if isinstance(effect, FollowsCondition):
        said |= {"condition": effect.condition, "values": list(effect.values)}
    return said


def of_stored(
    stored: Sequence[Mapping[str, Any]],
    extra: Sequence[type[Effect]],
    simulator: Simulator,
    scales: Scales,
    tests: tuple[str, ...],
) -> tuple[Effect, ...]:
    """Effects that :func:`as_stored` said. Raises EffectError for one that is not in the catalogue."""
    kinds = [k for some in variants(extra, simulator).values() for k in some]
    classes = {k.__name__: k for k in (*kinds, *UNLISTED, *OF_CONDITIONS) if isinstance(k, type)}
    out = []
    for e in stored:
        if e["class"] not in classes:
            raise EffectError(f"a stored file names the effect {e['name']!r}, which is not in the catalogue")
        more = {"condition": e["condition"], "values": tuple(e["values"])} if "condition" in e else {}
        out.append(classes[e["class"]](scales, tests, e["strength_value"], **more))
    return tuple(out)
