"""The embedded model error: parameters inside the model let its laws deviate a little from their form.

A real specimen's slip forces are no exact gamma mixture, its stiffness follows the normal force by no exact Eq. (12),
and its normal force has no sharp corner at u = A. Each of these three laws has a few parameters of deviation
(:mod:`.series`). Their priors are narrow and centred on zero, where the paper's model holds. The intervals of stiffness
and slip force then allow for such deviations.

An additive discrepancy cannot do that: added to the force, it explains a loop's residual, but does not say that a slip
force was off by as much.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.models import series
from bayes_iwan.models.kernels import pointwise
from bayes_iwan.models.kernels.sliders import OCTAVES
from bayes_iwan.models.motion import Motion
from bayes_iwan.models.slip_force import SlipForce

#: terms of the deviation of the slip forces' density. The more, the more truths the intervals of the slip forces'
#: quartiles hold (`analyses/guide/measured.md`)
SLIP_TERMS = 12
#: times the slip forces of the family that further elements have: without them intervals of kp and of the mean slip
#: force are too narrow, since the tail of the slip forces may be another
LARGER = 2, 4
DEVIATION_NAMES = tuple(f"slip_deviation{k}" for k in range(1, SLIP_TERMS + 1))
TAIL_NAMES = tuple(f"slip_larger{s}" for s in LARGER)
SLIP_NAMES = (*DEVIATION_NAMES, *TAIL_NAMES)
STIFFNESS_NAME, CORNER_NAME = "stiffness_exponent", "normal_force_corner"
NAMES = (*SLIP_NAMES, STIFFNESS_NAME, CORNER_NAME)
#: the corner's deviation is felt within this share of the amplitude from u = A
CORNER_WIDTH = 0.05


@dataclass(frozen=True)
class DeviatingSlipForce:
    """A family of slip forces whose density deviates by Σ c_k times functions of it, some of which are further elements
    (:func:`.series.linear_deviations`).

    With the stiffness of the family's own elements given, the friction force is linear in c_k.
    """

    base: SlipForce

    @property
    def name(self) -> str:
        return self.base.name

    @property
    def names(self) -> tuple[str, ...]:
        return self.base.names

    @property
    def units(self) -> tuple[str, ...]:
        return self.base.units

    def table(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        table, top = self.base.table(parameter_values)
        c = np.stack([parameter_values[name] for name in SLIP_NAMES], axis=1)
        if np.any(c != 0.0):
            table = series.with_deviations(table, top, *np.split(c, [SLIP_TERMS], axis=1))
            table /= elements(parameter_values)[:, None, None]
        return table, top

    def table_and_slopes(self, parameter_values: ParameterValues) -> tuple[Array, Array]:
        """The table and what it changes by for each c_k where the family's elements stay, (draws, 1 + deviations,
        cells, 4), and its top (draws,)."""
        table, top = self.base.table(parameter_values)
        tables = series.linear_deviations(table, top, SLIP_TERMS, len(LARGER))
        c = np.stack([parameter_values[name] for name in SLIP_NAMES], axis=1)
        if np.any(c != 0.0):
            tables[:, 0] += np.einsum("dk,dkij->dij", c, tables[:, 1:])
            tables /= elements(parameter_values)[:, None, None, None]
        return tables, top

    def survival(self, phi: Array, parameter_values: ParameterValues) -> Array:
        w, cubic, width = self._cells(phi, parameter_values)
        return np.where(w > 1.0, 0.0, (cubic[1] + w * (2.0 * cubic[2] + w * 3.0 * cubic[3])) / width)

    def density(self, phi: Array, parameter_values: ParameterValues) -> Array:
        w, cubic, width = self._cells(phi, parameter_values)
        return np.where(w > 1.0, 0.0, np.maximum(-(2.0 * cubic[2] + w * 6.0 * cubic[3]) / width**2, 0.0))

    def _cells(self, phi: Array, parameter_values: ParameterValues) -> tuple[Array, Array, Array]:
        """Place within the table's cell, above 1 beyond the table, its cubic (4, …) and width in N, (draws, phi)."""
        tables, top = self.table(parameter_values)
        share = series.cell_width(tables.shape[1])
        start = 2.0**-OCTAVES + np.concatenate([[0.0], np.cumsum(share[:-1])])
        x = np.asarray(phi) / top[:, None]
        cell = np.maximum(np.searchsorted(start, x, side="right") - 1, 0)
        cubic = np.take_along_axis(tables, cell[..., None], axis=1)
        w = np.maximum((x - start[cell]) / share[cell], 0.0)
        return w, np.moveaxis(cubic, -1, 0), share[cell] * top[:, None]

    def mean(self, parameter_values: ParameterValues) -> Array:
        return self.base.mean(parameter_values) * friction(parameter_values) / elements(parameter_values)


def elements(values: Mapping[str, Array]) -> Array:
    """(…) all elements, or their stiffness, over the family's own; NaN where none would be left."""
    return _over_the_familys(values, (1,) * len(LARGER))


def friction(values: Mapping[str, Array]) -> Array:
    """(…) force of all elements, all slipping, over that of the family's own; NaN where none would be left."""
    return _over_the_familys(values, LARGER)


def _over_the_familys(values: Mapping[str, Array], each: Sequence[int]) -> Array:
    further = [x * values[name] for x, name in zip(each, TAIL_NAMES)]
    whole = 1.0 + np.sum(further, axis=0)
    return np.where(whole > 0.0, whole, np.nan)


def corner(motion: Motion) -> Array:
    """(1 or draws, loops, samples): 1 where u = A, falling off within CORNER_WIDTH of the amplitude."""
    a = motion.amplitude_mm[:, None]
    return 1.0 / (1.0 + ((a - motion.displacement_mm) / (CORNER_WIDTH * a)) ** 2)


def deviate_normal_force(alpha: Array, motion: Motion, parameter_values: ParameterValues) -> None:
    """α times exp(normal_force_corner) about its corner at u = A, in place."""
    pointwise.times_exponential(alpha, corner(motion), parameter_values[CORNER_NAME])


def deviate_stiffness(k: Array, alpha: Array, parameter_values: ParameterValues) -> None:
    """k·α^stiffness_exponent, in place: k(1) is what it was."""
    pointwise.times_power(k, alpha, parameter_values[STIFFNESS_NAME])
