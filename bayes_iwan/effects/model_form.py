"""Causes in the model's form: where a specimen is an Iwan model, but not of the family that the base assumes.

Each frees one function of the base by a short series about it (:mod:`bayes_iwan.models.series`), all of whose
coefficients vanish together. They are named candidates: "the slip forces are not a mixture of three gammas".
"""

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect
from bayes_iwan.models import Motion, series
from bayes_iwan.models.parameter import Parameter

_ROOT = "root of the coefficients' sum of squares: "


class _Series(Effect):
    """An effect whose strength is a handful of signed coefficients, each smaller than the last by `decay`."""

    terms: ClassVar[tuple[tuple[str, str, str], ...]]  # name, symbol and description of each coefficient
    decay: ClassVar[float] = 1.0

    def first_guess(self) -> float:
        return 0.2

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        priors = [stats.norm(scale=self.typical * self.decay**i) for i in range(len(self.terms))]
        return tuple(
            Parameter(f"{self.name}.{n}", symbol, "-", text, prior, -3.0, 3.0, owner=self.name)
            for (n, symbol, text), prior in zip(self.terms, priors)
        )

    def coefficients(self, parameter_values: ParameterValues) -> Array:
        """(draws, terms)"""
        return np.stack([parameter_values[f"{self.name}.{n}"] for n, *_ in self.terms], axis=1)

    def reported(self, values: Mapping[str, Array]) -> dict[str, tuple[Array, str]]:
        size = np.sqrt(np.sum(self.coefficients(values) ** 2, axis=1))
        return {self.strength[0]: (size, "-")} | super().reported(values)


class SlipForcesFree(_Series):
    name = "slip_forces_free"
    statement = "the slip forces are not of the base's family (a mixture of three gammas)"
    law = "density × exp(Σ c_k π_k(F))/Z, π_1 … π_5 the Legendre polynomials of the share F that slips earlier"
    strength = ("deviation", "c", "-", _ROOT + "by about that share the density differs")
    terms = tuple(
        (f"c{k}", f"c{k}", f"Legendre coefficient {k} of the log density over its quantiles") for k in range(1, 6)
    )
    decay = 0.8
    physics = (
        "The elements' slip forces are spread in another way than the base's family can be: contacts of several kinds, "
        "a limit from which all slip, weak and strong ones with none between."
    )
    reference = (
        "Neyman, Skand. Aktuarietidskr. 20 (1937) 150 (smooth alternatives); Segalman, J. Appl. Mech. 72 (2005) 752"
    )
    signature = "curvature of the branches after reversals, at every frequency alike; odd harmonics"
    look_alikes = ("free_play", "rig_compliance", "cubic_stiffness")
    bench = "many amplitudes from stick to full slip: the backbone's curvature is the density itself"
    remedy = "Use the fitted slip-force density of the report in place of the gamma mixture."

    def slip_table(self, tables: Array, top: Array, parameter_values: ParameterValues) -> Array:
        return series.deviating(tables, top, self.coefficients(parameter_values))


class SlipLimit(Effect):
    """A limit that no slip force passes: no series of polynomials makes a distribution end at once."""

    name = "slip_forces_free"
    statement = SlipForcesFree.statement
    law = "min(F_slip, F_limit): the share s of elements, whose slip forces would be larger, slip at F_limit together"
    strength = ("limited_share", "s", "-", "share of the elements that slip together, last of all")
    limit = 0.99
    physics = "Contacts that hold longest all give way at once: macroslip, at a limit that the whole joint has."
    reference = "Segalman, J. Appl. Mech. 72 (2005) 752 (four-parameter Iwan model)"
    signature = "each branch ends at one sharp corner, beyond which the parallel spring is alone"
    look_alikes = SlipForcesFree.look_alikes
    bench = SlipForcesFree.bench
    remedy = 'Identify with slip = "power_law", which has such an end, or limit the slip forces at this share.'

    def first_guess(self) -> float:
        return 0.2

    def slip_table(self, tables: Array, top: Array, parameter_values: ParameterValues) -> Array:
        return series.limited(tables, top, parameter_values[self.strength_name])


class StiffnessLawFree(_Series):
    name = "stiffness_law_free"
    statement = "the elements' stiffness does not follow the normal force as Eq. (12) has it"
    law = "k(α)·exp(a·ln α + ½b·ln²α)"
    strength = ("deviation", "a, b", "-", _ROOT + "change of the elasticity d ln k / d ln α")
    terms = (
        ("exponent", "a", "change of d ln k / d ln α at α = 1"),
        ("growth", "b", "growth of d ln k / d ln α with ln α"),
    )
    order = 2  # after whatever changes α
    physics = (
        "Contacts that are squeezed harder are stiffer, by another law than a saturating one: a power of the normal "
        "force (⅓ for round bodies, near 1 for rough ones), or none."
    )
    reference = "Johnson, Contact Mechanics, ch. 7 and 13; Mindlin & Deresiewicz, J. Appl. Mech. 20 (1953) 327"
    signature = "slopes after reversals differ between the ends of the loop otherwise than friction does"
    look_alikes = ("quadratic_stiffness", "normal_force_free")
    bench = "small amplitudes about several mid-positions"
    remedy = "Use the fitted stiffness law of the report in place of Eq. (12)."

    def stiffness(self, k: Array, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        exponent, growth = (self.get(parameter_values, n) for n in ("exponent", "growth"))
        return series.deviating_stiffness(k, alpha, exponent, growth)


class NormalForceFree(_Series):
    name = "normal_force_free"
    statement = "the normal force does not follow the motion as Eq. (11) has it"
    law = "α·exp(Σ c·{u, u², |u̇|, u|u̇|, u̇, u u̇}), u and u̇ in the campaign's largest amplitude and speed"
    strength = ("deviation", "c", "-", _ROOT + "by about that share the normal force differs")
    terms = (
        ("u", "c_u", "slope over the displacement"),
        ("u2", "c_uu", "curvature over the displacement"),
        ("speed", "c_v", "growth with the speed"),
        ("u_speed", "c_uv", "growth with displacement and speed"),
        ("direction", "c_d", "difference between the directions, with velocity"),
        ("u_direction", "c_ud", "difference between the directions, with displacement and velocity"),
    )
    physics = (
        "The normal force follows displacement and velocity by another law than Hunt and Crossley's: spring and rope "
        "touch otherwise than a sphere in a hollow does."
    )
    reference = (
        "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440; Worden & Tomlinson, Nonlinearity in Structural Dynamics, ch. 7"
    )
    signature = "loops' width changes along the stroke otherwise than the base can; even and odd harmonics"
    look_alikes = ("normal_force_lag", "direction_dependent_friction", "quadratic_stiffness")
    bench = "a cell that measures the normal force"
    remedy = "Use the fitted normal force of the report in place of Eq. (11)."

    def normal_force(self, alpha: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        u, v = motion.displacement_mm / self.scales.length_mm, motion.velocity_m_s / self.scales.speed_m_s
        speed = motion.speed_m_s / self.scales.speed_m_s
        basis = np.stack([u, u * u, speed, u * speed, v, u * v])
        return series.deviating_normal_force(alpha, basis, self.coefficients(parameter_values))


EFFECTS: tuple[type[Effect], ...] = (SlipForcesFree, SlipLimit, StiffnessLawFree, NormalForceFree)
