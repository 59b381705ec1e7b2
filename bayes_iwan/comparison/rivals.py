"""Identification problems of the rival models: Bouc–Wen and its asymmetric generalisation, beside the Iwan families.

A rival takes the place of the forward model in a :class:`~bayes_iwan.inference.problem.Problem`: the same loops,
likelihood, noise and sampler, other numbers and priors. Laws that it does not have (slip forces, normal force) it
names none of, so whatever asks for these must be given an Iwan model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.defaults import default_parameters
from bayes_iwan.inference.likelihood import make_likelihood
from bayes_iwan.inference.parameters import Parameter, Prior, configured
from bayes_iwan.inference.problem import Problem
from bayes_iwan.inference.scales import Scales, scales_of
from bayes_iwan.physics import Model, Motion, Reference
from bayes_iwan.physics.bouc_wen import RIVALS, BoucWen, GeneralizedBoucWen


@dataclass(frozen=True)
class _Names:
    """A law without formulas: the numbers it reads, for tables."""

    name: str
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class RivalModel:
    """A rival in the shape in which a problem asks for its model."""

    rival: BoucWen | GeneralizedBoucWen
    reference: Reference
    effects: tuple[Any, ...] = ()
    grip: str = "none"
    stiffness: str = "none"

    @property
    def slip(self) -> str:
        return self.rival.name

    @property
    def names(self) -> tuple[str, ...]:
        return self.rival.names

    @property
    def slip_family(self) -> _Names:
        own = [(n, u) for n, u in zip(self.rival.names, self.rival.units) if n.startswith("bw_")]
        return _Names(self.rival.name, tuple(n for n, _ in own), tuple(u for _, u in own))

    @property
    def grip_law(self) -> _Names:
        return _Names("none")

    @property
    def stiffness_law(self) -> _Names:
        return _Names("none")

    def force(self, numbers: Mapping[str, Array], motion: Motion) -> Array:
        """Force in N, (draws, loops, samples); NaN where the model has no steady loop."""
        return self.rival.force(numbers, motion)


def rival_parameters(rival: BoucWen | GeneralizedBoucWen, scales: Scales) -> tuple[Parameter, ...]:
    """The rival's numbers with weakly informative priors on the campaign's own scales, as wide as the Iwan models'."""
    s = scales
    shared = {p.name: p for p in default_parameters(Model(s.reference), s)}
    out = [
        shared["kp_N_mm"],
        shared["force_zero_N"],
        Parameter(
            "bw_k_N_mm",
            "k",
            "N/mm",
            "initial stiffness of the hysteretic part",
            stats.lognorm(s=1.0, scale=s.stiff_N_mm),
        ),
        Parameter(
            "bw_force_N", "Z", "N", "ultimate force of the hysteretic part", stats.lognorm(s=0.8, scale=1.2 * s.slip_N)
        ),
        Parameter("bw_n", "n", "-", "sharpness of the knee", stats.lognorm(s=0.7, scale=1.0), 0.1, 10.0),
    ]
    if isinstance(rival, BoucWen):
        out.append(Parameter("bw_share", "σ", "-", "share of Wen's dissipative term", stats.uniform(0.5, 1.0)))
    else:
        out += [
            Parameter(
                f"bw_b{i}",
                f"b{i}",
                "-",
                f"asymmetry term {i} of Song & Der Kiureghian over the first",
                stats.norm(scale=0.4),
            )
            for i in range(2, 7)
        ]
    return tuple(out)


def rival_problem(name: str, loops: Sequence[Loop], config: Mapping[str, Any]) -> Problem:
    """The identification problem of a rival by name ("bouc_wen", "generalized_bouc_wen")."""
    rival = RIVALS[name]
    fitted = tuple(x for x in loops if x.role != "held-out")
    if not fitted:
        raise ValueError('no test is left to fit: every test has role = "held-out"')
    scales = scales_of(fitted)
    likelihood = make_likelihood(config.get("likelihood", {}).get("kind", "correlated"), fitted, scales)
    parameters = (*rival_parameters(rival, scales), *likelihood.parameters)
    own = {p.name for p in parameters}
    changed = {k: v for k, v in config.get("parameters", {}).items() if k in own}
    model = cast(Model, RivalModel(rival, scales.reference))
    return Problem(fitted, scales, model, Prior(configured(parameters, changed)), likelihood)
