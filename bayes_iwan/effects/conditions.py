"""Effects of what was stated for each test: a pressure, a temperature, a normal force, any further number.

A condition x of each test acts through ξ = ((x/x₀)^q − 1)/q, x₀ the geometric mean over the tests: with exp(p ξ), q → 0
is a power law (x/x₀)^p, q = 1 an exponential one. A condition that is not positive everywhere (a temperature in °C)
acts through ξ = (x − x̄)/max|x − x̄|.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Records, form
from bayes_iwan.effects.law_families import about
from bayes_iwan.models import Motion


@dataclass(frozen=True)
class FollowsCondition(Effect):
    """condition : name of the number that was stated for every test; values : it in the fitted tests, which set x₀.

    A motion that states no such number (a test that is only planned) is taken to be at x₀.
    """

    condition: str = ""
    values: tuple[float, ...] = ()

    signed = True
    what = ""

    def first_guess(self) -> float:
        return 0.3

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.what}_follows_{self.condition}"

    def possible(self, data: Records) -> bool:
        return len(set(self.values)) > 1

    @property
    def positive(self) -> bool:
        return min(self.values) > 0.0

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        if not self.positive:
            return {}
        return {"form": form("q", "0: a power law, 1: exponential", about(0.0, 0.4), -1.5, 1.5)}

    def condition_of(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        """ξ of each loop, (draws, loops, 1)."""
        all_of = np.array(self.values)
        if self.condition not in motion.conditions:
            return np.zeros((1, motion.loops, 1))
        at = motion.conditions[self.condition]
        if not self.positive:
            centre = all_of.mean()
            return ((at - centre) / np.abs(all_of - centre).max())[None, :, None]
        q = self.get(parameter_values, "form")
        q = np.where(np.abs(q) < 1e-7, 1e-7, q)
        return np.expm1(q * (np.log(at) - np.log(all_of).mean())[:, None]) / q

    def factor(self, motion: Motion, parameter_values: ParameterValues) -> Array:
        return np.exp(self.get(parameter_values, self.strength[0]) * self.condition_of(motion, parameter_values))


class SlipFollowsCondition(FollowsCondition):
    what = "slip_forces"
    law = "slip forces × exp(p ξ) of the stated condition (a power law for q = 0), the stiffness × its share s of it"
    strength = ("exponent", "p", "-", "exponent with which the slip forces follow the condition")
    statement = "the slip forces follow a condition that the campaign states for each test"
    physics = (
        "Friction follows what presses, warms or wets the contact: proportional to the pressure for rough bodies, its "
        "power ⅔ for round ones, less where a seal's own preload adds to it."
    )
    reference = "Bowden & Tabor, The Friction and Lubrication of Solids, ch. V; Archard, Proc. R. Soc. A 243 (1957) 190"
    signature = "loops of one shape, of a height that follows the condition"
    bench = "one frequency and amplitude over the whole range of the condition, up and down again"
    remedy = "Give the model's slip forces this dependence, or quote them for the condition of use."

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            **super().extra_parameters(),
            "of_stiffness": form("s", "share of it that the stiffness follows", about(0.0, 0.5), -2.0, 2.0),
        }

    def slip(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return alpha * self.factor(motion, parameter_values)

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return k * self.factor(motion, parameter_values) ** self.get(parameter_values, "of_stiffness")


class StiffnessFollowsCondition(FollowsCondition):
    what = "stiffness"
    law = "stiffness of the elements × exp(p ξ) of the stated condition"
    strength = ("exponent", "p", "-", "exponent with which the elements' stiffness follows the condition")
    statement = "the stiffness follows a condition that the campaign states for each test"
    physics = "The bodies or their contacts are stiffer under pressure, softer when warm."
    reference = (
        "Johnson, Contact Mechanics, ch. 7 and 13; Ferry, Viscoelastic Properties of Polymers, ch. 11 (temperature)"
    )
    signature = "slopes after reversals follow the condition, the loop's height does not"
    bench = "small amplitudes over the whole range of the condition"
    remedy = "Give the model's stiffness this dependence, or quote it for the condition of use."

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return k * self.factor(motion, parameter_values)


class ZeroFollowsCondition(FollowsCondition):
    what = "force_zero"
    order = 2
    law = "force zero + F·ξ of the stated condition"
    strength = ("force_N", "F", "N", "shift of the force's zero where ξ grows by one")
    statement = "the force's zero follows a condition that the campaign states for each test"
    physics = "What presses or warms the specimen also pushes on the force cell, and not all of it was taken off."
    reference = "ISO 376 (influence quantities on force transducers)"
    signature = "loops of one shape and height, shifted along the force axis"
    bench = "the cell's reading at rest over the whole range of the condition"
    remedy = "Take the reading at rest off each test."

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return force_N + self.get(parameter_values, "force_N") * self.condition_of(motion, parameter_values)


EFFECTS: tuple[type[FollowsCondition], ...] = (SlipFollowsCondition, StiffnessFollowsCondition, ZeroFollowsCondition)


def conditions_of(extras: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, ...]]:
    """Numbers that every test states and that differ between tests, by name; extras : those of each test."""
    shared = [n for n in (extras[0] if extras else ()) if all(n in x and np.isfinite(x[n]) for x in extras)]
    values = {n: tuple(float(x[n]) for x in extras) for n in shared}
    return {n: v for n, v in values.items() if len(set(v)) > 1}


def following(
    conditions: Mapping[str, tuple[float, ...]], fits: Callable[[type[Effect]], bool] = lambda kind: True
) -> dict[str, tuple[Callable[..., Effect], ...]]:
    """What may follow each condition, by the name of the effect: makers that take (scales, tests); fits : those that
    the simulator has stages for."""
    return {
        f"{kind.what}_follows_{name}": (partial(kind, condition=name, values=values),)
        for name, values in conditions.items()
        for kind in EFFECTS
        if fits(kind)
    }
