"""Draws as wide as the tests disagree.

A model whose form is a little wrong fits each test best by other values. A likelihood knows this only as far as its
discrepancy and the embedded model error describe it; with many tests the posterior becomes narrower than the values
that are found with one test less differ. To first order, the mean of coordinates u without test t differs by
−δ_t, δ_t = cov(u, ℓ_t), ℓ_t = ln p(test t | the other tests) at each draw. So the jackknife covariance

    J = T/(T − 1) Σ (δ_t − δ̄)(δ_t − δ̄)ᵀ

follows from the draws alone (the Bayesian infinitesimal jackknife: Giordano & Broderick, arXiv 2305.06466). In straight
coordinates (:mod:`bayes_iwan.sampling.straightening`), whose covariance is the unit matrix, J = U diag(w) Uᵀ, and draws
are stretched to U diag(√max(w, 1)) Uᵀ u; the slip forces' deviations are then drawn anew given the others, so that
loops stay as near to the measured ones as the straight coordinates are straight. Where tests agree as well as the
posterior says, nothing changes. `analyses/coverage_rig.py` counts how much more truths the intervals hold then.
"""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.marginal import Marginal
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models.parameter import Z_LIMIT
from bayes_iwan.sampling.blocks import generator
from bayes_iwan.sampling.straightening import Straightening

_TOGETHER = 1024  # draws predicted at a time
_LOOKED_AT = 2048  # draws that J is reckoned from at most


def stretched(problem: Problem, z: Array, seed: int) -> tuple[Array, float]:
    """Draws z (n, ndim) of a posterior, as wide as its tests disagree, and the largest factor; the same and 1 where
    they agree, and for a single test. A draw that cannot be moved stays. Noise parameters keep their place among the
    others."""
    marginal = Marginal(problem, also=())
    moved = np.flatnonzero([problem.names[i] not in problem.noise_names for i in marginal.walked])
    if len(problem.loops) < 2:
        return z, 1.0
    x = marginal.density.apart(z)
    straight = Straightening.fitted(x, marginal.blocks)
    u = straight.straight(x)
    some = np.linspace(0, len(z) - 1, min(len(z), _LOOKED_AT)).astype(int)
    w, turn = np.linalg.eigh(between_tests(u[np.ix_(some, moved)], without_each_test(problem, z[some])))
    factors = np.sqrt(np.maximum(w, 1.0))
    if factors[-1] == 1.0:
        return z, 1.0
    u[:, moved] = u[:, moved] @ (turn * factors) @ turn.T
    x = np.clip(straight.back(u), -Z_LIMIT, Z_LIMIT)
    found, random = np.empty((len(x), 1 + len(marginal.drawn))), generator((seed, 38))
    for first in range(0, len(x), _TOGETHER):
        found[first : first + _TOGETHER] = marginal(x[first : first + _TOGETHER], random)
    possible, out = np.isfinite(found[:, 0]), z.copy()
    out[possible] = marginal.density.whole(x[possible], found[possible, 1:])
    return out, float(factors[-1])


def without_each_test(problem: Problem, z: Array) -> Array:
    """ln p(test t | the other tests) at draws z (n, ndim): (n, tests)."""
    tests, out = len(problem.loops), np.empty((len(z), len(problem.loops)))
    others = [[i for i in range(tests) if i != t] for t in range(tests)]
    likelihoods = [problem.likelihood.of_tests(kept) for kept in others]
    for first in range(0, len(z), _TOGETHER):
        part = slice(first, first + _TOGETHER)
        values, residual = problem.parameter_values(z[part]), problem.residual(z[part])
        whole = problem.likelihood.log_likelihood(residual, values)
        for t, (kept, likelihood) in enumerate(zip(others, likelihoods)):
            out[part, t] = whole - likelihood.log_likelihood(np.ascontiguousarray(residual[:, kept]), values)
    return out


def between_tests(u: Array, level: Array) -> Array:
    """J (k, k) of coordinates u (n, k) with ln p of each test given the others, level (n, tests)."""
    tests = level.shape[1]
    change = (u - u.mean(axis=0)).T @ (level - level.mean(axis=0)) / len(u)
    change -= change.mean(axis=1, keepdims=True)
    return np.asarray(tests / (tests - 1.0) * change @ change.T)
