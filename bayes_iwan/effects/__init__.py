"""Physical causes outside the base model: what each is, its law, its parameters, and where it acts."""

from bayes_iwan.effects.base import Effect, EffectError

__all__ = ["Effect", "EffectError"]
