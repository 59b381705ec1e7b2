"""Between-test variance: how far every quantity moves when one test is left out.

A posterior says how well the loops determine a number if model and likelihood are right. How far the tests disagree
about it is seen without either: leave one test out, fit the others again, and see where it goes. The
delete-one-test jackknife (Tukey 1958; Efron & Stein 1981) turns that into a variance, (T − 1)/T · Σ (q₍ₜ₎ − q̄)². Each
fit starts at the whole's optimum, a few Gauss–Newton steps away from its own.
"""

from __future__ import annotations

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.parameters import Z_LIMIT
from bayes_iwan.inference.setup.problem import Problem

#: step of the central differences, in prior standard deviations
_STEP = 1e-4
#: parts of a Gauss–Newton step that are tried, and the longest step of any coordinate
_PARTS = np.array([1.0, 0.5, 0.2, 0.05])
_LONGEST = 1.0


def left_out_optima(problem: Problem, z: Array, iterations: int = 4) -> Array:
    """(tests, ndim): the most probable point without each test, from that with all of them, z (ndim,).

    The parameters of the noise stay as they are. Each iteration is a Gauss–Newton step of every fit, halved until the
    posterior rises. Raises ValueError for fewer than two tests.
    """
    tests, ndim = len(problem.loops), problem.ndim
    if tests < 2:
        raise ValueError("between-test variance needs at least two tests")
    noise = {p.name for p in problem.likelihood.parameters}
    free = np.array([i for i, name in enumerate(problem.names) if name not in noise])
    others = [[s for s in range(tests) if s != t] for t in range(tests)]
    likelihoods = [problem.likelihood.of_tests(which) for which in others]
    out = np.tile(z, (tests, 1))
    step = _STEP * np.eye(ndim)[free]

    def cost(t: int, trial: Array) -> Array:
        parameter_values = problem.parameter_values(trial)
        residual = problem.residual(trial)[:, others[t]]
        rows = likelihoods[t].rows(residual, parameter_values)
        return 0.5 * np.sum(rows**2, axis=1) + 0.5 * np.sum(trial**2, axis=1)

    for _ in range(iterations):
        moves = np.zeros((tests, len(free)))
        for t in range(tests):
            at = out[t]
            residual = problem.residual(np.concatenate([at[None], at + step, at - step]))[:, others[t]]
            parameter_values = {k: np.repeat(v, len(residual)) for k, v in problem.parameter_values(at[None]).items()}
            rows = likelihoods[t].rows(residual, parameter_values)
            n = len(free)
            jacobian = (rows[1 : n + 1] - rows[n + 1 :]).T / (2.0 * _STEP)
            precision = jacobian.T @ jacobian + np.eye(n)
            moves[t] = -np.linalg.solve(precision, jacobian.T @ rows[0] + at[free])
        moves /= np.maximum(1.0, np.max(np.abs(moves), axis=1, keepdims=True) / _LONGEST)
        for t in range(tests):
            trial = np.repeat(out[t][None], 1 + len(_PARTS), axis=0)
            trial[1:, free] += _PARTS[:, None] * moves[t]
            trial = np.clip(trial, -Z_LIMIT, Z_LIMIT)
            values = cost(t, trial)
            out[t] = trial[int(np.nanargmin(values))]
    return out


def jackknife_variance(values: Array) -> Array:
    """(…,): (T − 1)/T · Σ (q₍ₜ₎ − q̄)² of values (tests, …) that were found without each test."""
    tests = len(values)
    return (tests - 1) / tests * np.sum((values - values.mean(axis=0)) ** 2, axis=0)
