"""What a posterior predicts for measured tests: the arrays behind every loop figure, the viewer and the checks."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.predictions import shown_noise
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.simulator import FORCE_ZERO, straight_part


@dataclass(frozen=True)
class Predictive:
    """Predictions for some tests, from `draws` posterior draws; arrays (…, tests, samples), N and mm.

    measured_N : (tests, samples) measured averages less zero_N, (tests,), which makes the mean residual of each test
        zero: the force channel's zero drifts from test to test, the likelihood gives it no weight, nor do figures.
    median_N : (tests, samples) the posterior's median, which residuals are taken from.
    force_N : what the model says, (draws, tests, samples); every draw's mean over a loop moved to their median's.
    loop_N : the same with the likelihood's noise and discrepancy, as an averaged loop would be measured again; on tests
        that were not fitted the discrepancy is carried over from those that were.
    cycle_N : with the cycle-to-cycle scatter on top, as one more cycle would be measured.
    spring_N : (tests, samples) median parallel spring and force zero. Force less this is the friction force; taking
        the same line off measured and predicted leaves the residual what it is.
    """

    loops: tuple[Loop, ...]
    displacement_mm: Array
    measured_N: Array
    median_N: Array
    force_N: Array
    loop_N: Array
    cycle_N: Array
    spring_N: Array
    zero_N: Array

    def residual_N(self) -> Array:
        """Measured − median prediction, (tests, samples)."""
        return self.measured_N - self.median_N

    def some(self, tests: Sequence[int]) -> "Predictive":
        """The same of some tests."""
        rows = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "loops"}
        chosen = {k: x[:, tests] if x.ndim == 3 else x[tests] for k, x in rows.items()}
        return Predictive(tuple(self.loops[t] for t in tests), **chosen)


def predict(posterior: Posterior, loops: Sequence[Loop] | None = None, n: int = 300, seed: int = 0) -> Predictive:
    """Predictions from n draws of a posterior for `loops` (default: all of its campaign, held-out tests too)."""
    problem = posterior.problem
    chosen = tuple(posterior.loops if loops is None else loops)
    z = posterior.flat_z(n)
    parameter_values = problem.parameter_values(z)
    rng, motion = np.random.default_rng([seed, 31]), motion_of((*chosen, *problem.loops))
    force = problem.force(parameter_values, motion)
    median = np.median(force[:, : len(chosen)], axis=0)
    residual_N, force = problem.measured_N - force[:, len(chosen) :], force[:, : len(chosen)]
    force += median.mean(axis=-1, keepdims=True) - force.mean(axis=-1, keepdims=True)
    again, files = np.empty_like(force), [x.file for x in problem.loops]
    if fitted := [i for i, x in enumerate(chosen) if x.file in files]:
        likelihood = problem.likelihood.of_tests([files.index(chosen[i].file) for i in fitted])
        again[:, fitted] = likelihood.replicate(force[:, fitted], parameter_values, rng)
    if other := [i for i, x in enumerate(chosen) if x.file not in files]:
        held_out = [chosen[i] for i in other]
        again[:, other] = force[:, other] + problem.likelihood.carried_over(residual_N, parameter_values, held_out, rng)
    loop = force + shown_noise(again - force, chosen)
    scatter = np.stack([x.force_scatter_N for x in chosen])
    u = np.stack([x.displacement_mm for x in chosen])
    slope = problem.model.spring_N_mm(parameter_values)
    if slope is None:
        spring = straight_part(median, u)
    else:
        spring = float(np.median(slope)) * u + float(np.median(parameter_values[FORCE_ZERO]))
    measured = np.stack([x.force_N for x in chosen])
    zero = np.mean(measured - median, axis=1)
    cycle = loop + rng.standard_normal(loop.shape) * scatter
    return Predictive(chosen, u, measured - zero[:, None], median, force, loop, cycle, spring, zero)


def measured_cycles(loop: Loop, most: int = 40) -> list[tuple[Array, Array]]:
    """Displacement from the loop's middle (mm) and force (N) of single cycles of the record, evenly chosen."""
    index, phase = loop.averager.index, loop.averager.phase - loop.averager.shift
    whole = np.floor(phase).astype(int)
    cycles = [np.flatnonzero(whole == c) for c in np.unique(whole)]
    cycles = [c for c in cycles if len(c) > 0.8 * len(index) / max(loop.n_cycles, 1)]
    chosen = np.unique(np.linspace(0, len(cycles) - 1, min(most, len(cycles))).astype(int))
    every = (index[cycles[c]] for c in chosen)
    return [(loop.record.displacement_mm[at] - loop.offset_mm, loop.record.force_N[at]) for at in every]
