"""Effects with parameters of their own in every test."""

from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect
from bayes_iwan.models.parameter import Parameter


class ByTest(Effect):
    """An effect that has one number, or several, in each test, all with one prior about zero.

    parts : name, symbol, unit and description of each parameter; per_N : their size for one newton.
    """

    parts: ClassVar[tuple[tuple[str, str, str, str], ...]]

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N

    def per_N(self) -> float:
        """Size of a number, in its unit, that moves the force by about a newton."""
        return 1.0

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        prior = stats.norm(scale=1.2 * self.typical * self.per_N())
        own = tuple(
            Parameter(f"{self.name}.{part}[{test}]", symbol, unit, f"{what} in {test}", prior, owner=self.name)
            for part, symbol, unit, what in self.parts
            for test in self.tests
        )
        return (*own, *(replace(p, owner=self.name) for p in self._extra()))

    def by_test(self, parameter_values: ParameterValues) -> tuple[Array, ...]:
        """Each part as (draws, tests)."""
        return tuple(
            np.stack([parameter_values[f"{self.name}.{part}[{test}]"] for test in self.tests], axis=1)
            for part, *_ in self.parts
        )
