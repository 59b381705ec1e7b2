"""The generalized Iwan model: a line of stages from motion to the specimen's force.

    motion → α(u, u̇) → [normal_force] → k(α) → [stiffness] → [slip] → sliders → + parallel spring

Each stage takes and returns arrays shaped (draws, loops, samples). The bracketed stages are empty for the paper's
model. `normal_force` changes the normal force and with it the stiffness; `slip` changes what an element can carry at a
given normal force (its coefficient of friction) and leaves k alone. Every model the paper mentions is one
:class:`Model` away.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.errors import nearest
from bayes_iwan.models import embedded_error, iwan_parameters, normal_force, slip_force, stiffness
from bayes_iwan.models.kernels import sliders
from bayes_iwan.models.motion import Motion
from bayes_iwan.models.normal_force import ALPHA_FLOOR, NormalForce
from bayes_iwan.models.parameter import Parameter
from bayes_iwan.models.scales import Reference, Scales
from bayes_iwan.models.simulator import INNER, Derived, ModelError, Modifier, Simulator
from bayes_iwan.models.stiffness import Stiffness
from bayes_iwan.screen import Listed, on_screen
from bayes_iwan.threads import over_draws


@dataclass(frozen=True)
@on_screen
class Model(Simulator):
    """A generalized Iwan model by the names of its parts.

    Parameters
    ----------
    reference
        the campaign's scales (see :class:`bayes_iwan.models.scales.Reference`).
    slip
        "gamma1", "gamma2", "gamma3", "uniform", "gaussian" or "power_law".
    normal_force
        "constant" (classical Iwan), "polynomial1" … "polynomial6", "hunt_crossley_no_speed", "hunt_crossley".
    stiffness
        "constant" or "saturating" (Eq. 12).
    embedded
        whether the model error is embedded: its laws may deviate a little (see
        :mod:`bayes_iwan.models.embedded_error`).

    Raises
    ------
    ModelError
        a part of another name.

    References
    ----------
    Rajaei, Ahmadian and Tavakoli's generalized Iwan model of a friction isolator: slip forces Eq. (10), normal force
    Eq. (11), stiffness Eq. (12), force Eq. (3). The parallel-series model: Iwan, J. Applied Mechanics 33 (1966) 893.

    Examples
    --------
    >>> import numpy as np, bayes_iwan as bi
    >>> from bayes_iwan.models.paper_parameters import table_1
    >>> reference = bi.Scales(1.0, 0.063, 10.0, 1.2, 6.0, 14.0).reference
    >>> model, motion = bi.Model(reference), bi.sine_motion(frequency_hz=10.0, amplitude_mm=1.0)
    >>> parameter_values = table_1(reference)
    >>> model.force(parameter_values, motion).shape
    (1, 1, 128)
    """

    reference: Reference
    slip: str = "gamma3"
    normal_force: str = "hunt_crossley"
    stiffness: str = "saturating"
    embedded: bool = False

    stages = frozenset(INNER)

    def __post_init__(self) -> None:
        for what, name, known in (
            ("slip", self.slip, slip_force.FAMILIES),
            ("normal_force", self.normal_force, normal_force.LAWS),
            ("stiffness", self.stiffness, stiffness.LAWS),
        ):
            if name not in known:
                raise ModelError(f"model.{what} = {name!r} is not known{nearest(name, known)}")

    @property
    def name(self) -> str:
        """The parts in one word."""
        return f"{self.slip}/{self.normal_force}/{self.stiffness}" + ("/embedded" if self.embedded else "")

    @property
    def slip_family(self) -> slip_force.SlipForce:
        """The distribution of slip forces."""
        family = slip_force.FAMILIES[self.slip]
        return embedded_error.DeviatingSlipForce(family) if self.embedded else family

    @property
    def normal_force_law(self) -> NormalForce:
        """The law of the relative normal force α."""
        return normal_force.LAWS[self.normal_force]

    @property
    def stiffness_law(self) -> Stiffness:
        """The law of the elements' stiffness k(α)."""
        return stiffness.LAWS[self.stiffness]

    @property
    def names(self) -> tuple[str, ...]:
        """Numbers that `force` reads: parallel spring, then stiffness, slip forces, normal force, embedded model
        error."""
        laws = (self.stiffness_law, self.slip_family, self.normal_force_law)
        own = [name for law in laws for name in law.names]
        return Listed(("kp_N_mm", *own, *(embedded_error.NAMES if self.embedded else ())))

    def parameters(self, scales: Scales) -> tuple[Parameter, ...]:
        return iwan_parameters.default_parameters(self, scales)

    def parameter_values(self, values: ParameterValues) -> ParameterValues:
        return iwan_parameters.model_values(self, values)

    def values(self, parameter_values: ParameterValues) -> ParameterValues:
        """The inverse of :meth:`parameter_values`; gamma components are put in order of their means."""
        return iwan_parameters.sampled_values(self, parameter_values)

    def derived(self, parameter_values: ParameterValues) -> dict[str, Derived]:
        """The paper's parameters (Table 1 for the full model): kp, ki, ku, t, η, g, k̃ₙ, λ, β."""
        units = dict(zip(self.slip_family.names, self.slip_family.units)) | iwan_parameters.PAPER_UNITS
        values = iwan_parameters.paper_values(self, parameter_values)
        return {n: Derived(units.get(n, "-"), x) for n, x in values.items()}

    def alpha(self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()) -> Array:
        """Relative normal force with the normal-force effects, (draws, loops, samples)."""
        alpha = self.normal_force_law.alpha(parameter_values, motion, self.reference, len(parameter_values["kp_N_mm"]))
        if self.embedded:
            embedded_error.deviate_normal_force(alpha, motion, parameter_values)
        for effect in effects:
            alpha = effect.normal_force(alpha, motion, parameter_values)
        return np.maximum(alpha, ALPHA_FLOOR) if effects else alpha

    def k(self, parameter_values: ParameterValues, alpha: Array) -> Array:
        """Stiffness of the elements in N/mm, shaped as alpha (draws, loops, samples)."""
        k = self.stiffness_law.k(parameter_values, alpha)
        if self.embedded:
            embedded_error.deviate_stiffness(k, alpha, parameter_values)
        return k

    def friction_force(
        self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()
    ) -> Array:
        """Friction force of the elements in N, (draws, loops, samples), of a specimen moved exactly so."""
        return self._parts(parameter_values, motion, np.zeros(len(parameter_values["kp_N_mm"])), effects)[:, 0]

    def force(self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()) -> Array:
        """Friction, Eq. (3), and parallel spring, N, (draws, loops, samples)."""
        return self._parts(parameter_values, motion, parameter_values["kp_N_mm"], effects)[:, 0]

    def force_and_slopes(self, parameter_values: ParameterValues, motion: Motion) -> Array:
        """The force and its derivatives by the slip forces' deviations, N, (draws, 1 + deviations, loops, samples).

        The force is linear in these (:mod:`bayes_iwan.models.embedded_error`), so the derivatives hold at any distance.
        """
        return self._parts(parameter_values, motion, parameter_values["kp_N_mm"], slopes=True)

    def _parts(
        self, parameter_values: ParameterValues, motion: Motion, parallel: Array, effects: Sequence[Modifier] = (),
        slopes: bool = False,
    ) -> Array:  # fmt: skip
        """Friction + parallel·u, parallel (draws,) in N/mm, and its derivatives: (draws, 1 or 1 + deviations, loops,
        samples).

        A draw's result does not depend on how the draws are parted among threads.
        """
        family = self.slip_family
        each = len(embedded_error.SLIP_NAMES) if slopes else 0
        out = np.empty((len(parallel), 1 + each, motion.loops, motion.samples))

        def some_draws(part: slice) -> None:
            some = {name: value[part] for name, value in parameter_values.items()}
            moved = motion.of_draws(part)
            alpha = np.ascontiguousarray(self.alpha(some, moved, effects))
            k = self.k(some, alpha)
            for effect in effects:
                k = effect.stiffness(k, alpha, moved, some)
            k = np.ascontiguousarray(k)
            for effect in effects:  # a coefficient of friction: what k(α) does not follow
                alpha = np.maximum(effect.slip(alpha, moved, some), ALPHA_FLOOR)
            alpha = np.ascontiguousarray(alpha)
            asymmetry = np.zeros(len(alpha))
            for effect in effects:
                asymmetry = asymmetry + effect.asymmetry(some)
            if isinstance(family, embedded_error.DeviatingSlipForce) and slopes:
                tables, top = family.table_and_slopes(some)
            else:
                table, top = family.table(some)
                for effect in effects:
                    table = effect.slip_table(table, top, some)
                tables = np.ascontiguousarray(table)[:, None]
            displacement_mm = np.ascontiguousarray(moved.displacement_mm)
            sliders.friction(
                displacement_mm,
                moved.slope_mm,
                alpha,
                k,
                asymmetry,
                moved.periodic,
                tables,
                top,
                parallel[part],
                out[part],
            )

        over_draws(some_draws, len(parallel), motion.loops * motion.samples)
        return out
