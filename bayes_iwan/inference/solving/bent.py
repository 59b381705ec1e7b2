"""The same problem with a form that may bend: how far it moves every number, and how much better it explains the loops.

A posterior of the Iwan model as it stands takes its form for true. Beside it stands the same model whose form may bend
a little (:mod:`bayes_iwan.physics.laws.embedded`): its most probable point, reached from the plain model's, its normal
approximation there, and its evidence. Neither is the truth; numbers are reported for both, averaged by evidence
(Hoeting, Madigan, Raftery & Volinsky, Statistical Science 14, 1999, 382). The bent form's posterior itself is some
thirty numbers on thin bent sheets: its point costs a second, its sampling minutes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.parameters import Prior
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.solving.point import laplace_scale, most_probable
from bayes_iwan.physics import Model
from bayes_iwan.physics.models.sampled import embedded_parameters


@dataclass(frozen=True)
class Bent:
    """problem : the bent form's, z (ndim,) its most probable point; weight : its probability against the plain form,
    both equally probable before the loops."""

    problem: Problem
    z: Array
    weight: float


def may_bend(problem: Problem) -> bool:
    """Is there a form beside the sampled one: is it the Iwan model, not bent yet and without effects?"""
    return isinstance(problem.model, Model) and not problem.model.embedded and not problem.effects


def bent_form(problem: Problem, z: Array) -> Bent | None:
    """The bent form of a plain problem with the most probable point z (ndim,); None where there is no form to bend."""
    model = problem.model
    if not may_bend(problem) or not isinstance(model, Model):
        return None
    prior = Prior((*problem.prior.parameters, *embedded_parameters()))
    bent = replace(problem, model=replace(model, embedded=True), prior=prior)
    start = np.zeros((1, bent.ndim))
    start[0, [bent.names.index(name) for name in problem.names]] = z
    optima, _, _ = most_probable(bent, start)
    odds = log_evidence(bent, optima[0]) - log_evidence(problem, z)
    return Bent(bent, optima[0], float(1.0 / (1.0 + np.exp(-np.clip(odds, -500.0, 500.0)))))


def log_evidence(problem: Problem, z: Array) -> float:
    """Laplace's approximation of the logarithm of the evidence, from a maximum z (ndim,)."""
    root = laplace_scale(problem, z)
    volume = 0.5 * problem.ndim * np.log(2.0 * np.pi) + np.sum(np.log(np.diag(root)))
    return float(problem.log_prob(z[None])[0] + volume)
