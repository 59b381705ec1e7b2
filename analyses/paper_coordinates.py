"""Logs of the paper's numbers as coordinates: what a sampler without better ones would use. For the benchmark only.

y = (ln kp, F₀, ln ki, ln ku, ln tᵢ, ln ηᵢ, ln g₁, ln g₂, ln k̃ₙ, ln λ, ln β, ln of the noise numbers), g₃ = 1 − g₁ − g₂,
components in the order of their means tᵢηᵢ. The posterior over y is that over z times |det dz/dy|, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Model
from bayes_iwan.models.normal_force import from_paper_hunt_crossley, paper_hunt_crossley
from bayes_iwan.models.slip_force import Gammas
from bayes_iwan.models.stiffness import from_paper_stiffness, paper_stiffness


@dataclass(frozen=True)
class PaperCoordinates:
    """The map for a problem with the paper's whole model and nothing fixed, tied or added.

    Raises ValueError for another problem.
    """

    problem: Problem

    def __post_init__(self) -> None:
        model = self.problem.model
        if not (
            isinstance(model, Model)
            and isinstance(model.slip_family, Gammas)
            and model.normal_force == "hunt_crossley"
            and not self.problem.effects
            and model.stiffness == "saturating"
            and all(p.free for p in self.problem.prior.parameters)
        ):
            raise ValueError(
                "the paper's coordinates are those of its whole model: gamma slip forces, Hunt–Crossley "
                "normal force, saturating stiffness, no effects, nothing fixed or tied"
            )

    @property
    def model(self) -> Model:
        assert isinstance(self.problem.model, Model)  # __post_init__ has seen to it
        return self.problem.model

    @property
    def components(self) -> int:
        return len(self.model.slip_family.names) // 3

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers whose logs are y's columns (force_zero_N itself, which may be negative)."""
        each = range(1, self.components + 1)
        return (
            "kp_N_mm",
            "force_zero_N",
            "ki_N_mm",
            "ku_N_mm",
            *(f"t{i}_N" for i in each),
            *(f"eta{i}" for i in each),
            *(f"g{i}" for i in each[:-1]),
            "kn_1_mm",
            "lambda_s_m",
            "beta",
            *(p.name for p in self.problem.likelihood.parameters),
        )

    def y_of(self, z: Array) -> Array:
        """y (draws, ndim) of z; NaN where k̃ₙ or λ is negative, of which there is no log."""
        parameter_values = self.problem.parameter_values(z)
        paper = (
            dict(parameter_values)
            | paper_stiffness(parameter_values)
            | paper_hunt_crossley(parameter_values, self.model.reference)
        )
        with np.errstate(invalid="ignore"):
            return np.stack([paper[n] if n == "force_zero_N" else np.log(paper[n]) for n in self.names], axis=1)

    def _sampled(self, y: Array) -> tuple[ParameterValues, NDArray[np.bool_]]:
        """Sampled values by name, and which rows are possible: Σg < 1 and components in order."""
        v = {n: x if n == "force_zero_N" else np.exp(x) for n, x in zip(self.names, np.atleast_2d(y).T)}
        last = self.components
        rest = 1.0 - np.sum([v[f"g{i}"] for i in range(1, last)], axis=0) if last > 1 else np.ones(len(y))
        means = np.stack([v[f"t{i}_N"] * v[f"eta{i}"] for i in range(1, last + 1)])
        possible = (rest > 0.0) & np.all(np.diff(means, axis=0) > 0.0, axis=0)
        parameter_values = (
            v | {f"g{last}": np.where(possible, rest, 1.0)} | from_paper_stiffness(v["ki_N_mm"], v["ku_N_mm"])
        )
        parameter_values |= from_paper_hunt_crossley(v["kn_1_mm"], v["lambda_s_m"], v["beta"], self.model.reference)
        return self.model.values(parameter_values), possible

    def z_of(self, y: Array) -> Array:
        """z (draws, ndim) of y; NaN where y is impossible."""
        values, possible = self._sampled(y)
        return np.where(possible[:, None], self.problem.prior.scores(values), np.nan)

    def log_jacobian(self, y: Array) -> Array:
        """ln |det dz/dy|, (draws,); −∞ where y is impossible.

        With z of one value x each, dz/dx = p(x)/N(z). In logs the maps (ki, ku) → (k1, b), (t, η) → (mean, ratios, η)
        and (k̃ₙ, λ, β) → (slope, rate, β) have determinant ±1, so that dx/dy is a product of single derivatives.
        """
        x, possible = self._sampled(y)
        ratio = x["stiffness_ratio"]
        out = np.log(ratio * np.abs(np.expm1(ratio) - ratio * np.exp(ratio)) / np.expm1(ratio) ** 2)
        logged = ["kp_N_mm", "k1_N_mm", "mean_slip_force_N", "normal_force_slope", "normal_force_rate", "beta"]
        logged += [n for n in self.problem.names if n.startswith(("slip_ratio_", "eta", "share_"))]
        logged += [p.name for p in self.problem.likelihood.parameters]
        for name in logged:
            out = out + np.log(np.abs(x[name]))
        for p in self.problem.prior.parameters:
            z = p.score(x[p.name])
            out = out + p.log_density(x[p.name]) + 0.5 * z * z + 0.5 * np.log(2.0 * np.pi)
        return np.where(possible & np.isfinite(out), out, -np.inf)

    def log_prob(self, y: Array) -> Array:
        """Log posterior density over y, (draws,)."""
        with np.errstate(all="ignore"):
            jacobian = self.log_jacobian(y)
            out = np.full(len(jacobian), -np.inf)
            good = np.isfinite(jacobian)
            if good.any():
                out[good] = jacobian[good] + self.problem.log_prob(self.z_of(y[good]))
        return np.where(np.isfinite(out), out, -np.inf)
