"""Forces on the tested loops by the package's own forward model: what a model card says of a choice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.export.laws import OF_THE_RIG
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Motion
from bayes_iwan.models.simulator import FORCE_ZERO, recorded_force


def steady_loops(problem: Problem, values: ParameterValues, motion: Motion) -> Array:
    """Force (draws, loops, samples) of our own forward model, the rig's effects and the channel's zero omitted."""
    effects = [e for e in problem.effects if not isinstance(e, OF_THE_RIG)]
    return recorded_force(problem.model, effects, {n: x for n, x in values.items() if n != FORCE_ZERO}, motion)


def fixed_amplitude(problem: Problem, values: ParameterValues, amplitude_mm: float) -> Array:
    """(tests,) RMS over the RMS friction force by which the tested loops change where A of Eq. (11) stays at one value
    instead of each test's own amplitude, the largest over the draws."""
    motion = problem.motion
    own = steady_loops(problem, values, motion)
    fixed = steady_loops(problem, values, replace(motion, amplitude_mm=np.full(motion.loops, amplitude_mm)))
    friction = problem.friction_force(values, motion)
    change = np.sqrt(np.mean((fixed - own) ** 2, axis=2) / np.mean(friction**2, axis=2))
    return np.asarray(change.max(axis=0))
