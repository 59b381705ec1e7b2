"""The elements' stiffness as a function of the normal force."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.models.kernels import pointwise


class Stiffness(Protocol):
    """A law for k(α); `names` are the parameters it reads."""

    @property
    def name(self) -> str: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    def k(self, parameter_values: ParameterValues, alpha: Array) -> Array:
        """Stiffness in N/mm, shaped as alpha (draws, loops, samples)."""


@dataclass(frozen=True)
class ConstantStiffness:
    """k = k1 whatever the normal force."""

    name = "constant"
    names = ("k1_N_mm",)

    def k(self, parameter_values: ParameterValues, alpha: Array) -> Array:
        return np.broadcast_to(parameter_values["k1_N_mm"][:, None, None], alpha.shape).copy()


@dataclass(frozen=True)
class Saturating:
    """Eq. (12), k = k_u(1 − exp(−k_i α/k_u)), by k1 = k(1) and stiffness_ratio z = k_i/k_u > 0."""

    name = "saturating"
    names = ("k1_N_mm", "stiffness_ratio")

    def k(self, parameter_values: ParameterValues, alpha: Array) -> Array:
        alpha = np.ascontiguousarray(alpha)
        out, ratio = np.empty_like(alpha), parameter_values["stiffness_ratio"]
        pointwise.saturating(alpha, parameter_values["k1_N_mm"] / -np.expm1(-ratio), ratio, out)
        return out


def paper_stiffness(parameter_values: ParameterValues) -> dict[str, Array]:
    """The paper's k_i and k_u (N/mm) from k1 and z."""
    final = parameter_values["k1_N_mm"] / -np.expm1(-parameter_values["stiffness_ratio"])
    return {"ki_N_mm": final * parameter_values["stiffness_ratio"], "ku_N_mm": final}


def from_paper_stiffness(ki: Array, ku: Array) -> dict[str, Array]:
    """k1 and z from the paper's k_i and k_u (N/mm)."""
    ki, ku = (np.atleast_1d(np.asarray(x, float)) for x in (ki, ku))
    return {"k1_N_mm": -ku * np.expm1(-ki / ku), "stiffness_ratio": ki / ku}


def elasticity(ratio: Array) -> Array:
    """d ln k / d ln α at α = 1, in (0, 1): z/(e^z − 1). Unlike z it is what loops determine."""
    return ratio / np.expm1(ratio)


def ratio_of_elasticity(value: Array) -> Array:
    """The inverse of :func:`elasticity`; value in (0, 1)."""
    out = np.empty_like(value)
    pointwise.solve_elasticity(np.ascontiguousarray(value), out)
    return out


_ALL: tuple[Stiffness, ...] = (ConstantStiffness(), Saturating())
LAWS: dict[str, Stiffness] = {law.name: law for law in _ALL}
