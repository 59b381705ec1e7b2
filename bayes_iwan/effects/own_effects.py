"""Effects of a user's own, from a Python file."""

from __future__ import annotations

import os

from bayes_iwan.effects.base import Effect, EffectError
from bayes_iwan.models.user_file import classes_in


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
        if not (isinstance(effect.name, str) and effect.name.isidentifier()):
            raise EffectError(f"{path}: {effect.__name__}.name = {effect.name!r} must be one word, as a variable's")
        if not (
            isinstance(effect.strength, tuple)
            and len(effect.strength) == 4
            and all(isinstance(x, str) for x in effect.strength)
        ):
            raise EffectError(f"{path}: {effect.__name__}.strength must be four texts: name, symbol, unit, description")
    return found
