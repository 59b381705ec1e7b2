"""The relative normal force α(u, u̇), by law; α = 1 at rest in mid-stroke."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.models.kernels import pointwise
from bayes_iwan.models.motion import Motion
from bayes_iwan.models.scales import Reference

#: α is kept at or above this: a normal force cannot pull. Where a law asks for less, contact is lost and elements carry
#: nothing (1e-6 of what they carry at rest); by Eqs. (3) and (12) they keep the deflection that they can hold as α → 0,
#: α φ/k(α) → φ/k_i
ALPHA_FLOOR = 1e-6


class NormalForce(Protocol):
    """A law for α; `names` are the parameters it reads (all dimensionless, through :class:`Reference`)."""

    @property
    def name(self) -> str: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    def alpha(self, parameter_values: ParameterValues, motion: Motion, reference: Reference, draws: int) -> Array:
        """α ≥ ALPHA_FLOOR, shape (draws, loops, samples)."""


@dataclass(frozen=True)
class Constant:
    """α = 1: the classical Iwan model."""

    name = "constant"
    names: tuple[str, ...] = ()

    def alpha(self, parameter_values: ParameterValues, motion: Motion, reference: Reference, draws: int) -> Array:
        return np.ones((draws, motion.loops, motion.samples))


@dataclass(frozen=True)
class Polynomial:
    """α = 1 + Σ_d a_d (u/ℓ)^d, d = 1…degree."""

    degree: int

    @property
    def name(self) -> str:
        return f"polynomial{self.degree}"

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"a{d}" for d in range(1, self.degree + 1))

    def alpha(self, parameter_values: ParameterValues, motion: Motion, reference: Reference, draws: int) -> Array:
        x = motion.displacement_mm / reference.length_mm
        alpha = np.ones((draws, motion.loops, motion.samples))
        for d, name in enumerate(self.names, start=1):
            alpha += parameter_values[name][:, None, None] * x**d
        return np.maximum(alpha, ALPHA_FLOOR)


@dataclass(frozen=True)
class HuntCrossley:
    """Eq. (11) as printed, α = 1 + k̃ₙ(y^β − A^β) + λk̃ₙ y^β|u̇|, y = A − u, in parameters that stay determined as β → 0:

        α = 1 + slope·((y/ℓ)^β − (A/ℓ)^β)/β + rate·(y/ℓ)^β |u̇|/v,

    normal_force_slope = k̃ₙβℓ^β, normal_force_rate = λk̃ₙℓ^β v with the reference length ℓ and speed v. `speed=False`
    leaves the last term out. sign(A − u) of Eq. (11) is +1 by the floor on y (`models.motion.Y_FLOOR`).
    """

    speed: bool = True

    @property
    def name(self) -> str:
        return "hunt_crossley" if self.speed else "hunt_crossley_no_speed"

    @property
    def names(self) -> tuple[str, ...]:
        return ("normal_force_slope", "normal_force_rate", "beta") if self.speed else ("normal_force_slope", "beta")

    def alpha(self, parameter_values: ParameterValues, motion: Motion, reference: Reference, draws: int) -> Array:
        out, zero = np.empty((draws, motion.loops, motion.samples)), math.log(reference.length_mm)
        rate = parameter_values["normal_force_rate"] / reference.speed_m_s if self.speed else np.zeros(draws)
        slope, beta = parameter_values["normal_force_slope"], parameter_values["beta"]
        moved = (motion.log_penetration, np.log(motion.amplitude_mm), zero, motion.speed_m_s)
        pointwise.hunt_crossley(*moved, slope, rate, beta, ALPHA_FLOOR, out)
        return out


def paper_hunt_crossley(parameter_values: ParameterValues, reference: Reference) -> dict[str, Array]:
    """The paper's k̃ₙ (mm^−β), λ (s/m) from normal_force_slope, normal_force_rate and β. λ is NaN where k̃ₙ = 0."""
    slope, beta = parameter_values["normal_force_slope"], parameter_values["beta"]
    out = {"kn_1_mm": slope / (beta * reference.length_mm**beta), "beta": beta}
    if "normal_force_rate" in parameter_values:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = parameter_values["normal_force_rate"] * beta / (slope * reference.speed_m_s)
        out["lambda_s_m"] = np.where(slope != 0, ratio, np.nan)
    return out


def from_paper_hunt_crossley(kn: Array, lam: Array, beta: Array, reference: Reference) -> dict[str, Array]:
    """normal_force_slope, normal_force_rate, beta from the paper's k̃ₙ, λ (s/m), β."""
    kn, lam, beta = (np.atleast_1d(np.asarray(x, float)) for x in (kn, lam, beta))
    scaled = kn * reference.length_mm**beta
    return {"normal_force_slope": scaled * beta, "normal_force_rate": lam * scaled * reference.speed_m_s, "beta": beta}


_ALL: tuple[NormalForce, ...] = (Constant(), HuntCrossley(True), HuntCrossley(False), *map(Polynomial, range(1, 7)))
LAWS: dict[str, NormalForce] = {law.name: law for law in _ALL}
