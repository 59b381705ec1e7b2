"""Draws as wide as the tests disagree.

A model whose form is a little wrong fits each test best by other values. A likelihood knows this only as far as its
discrepancy and the embedded model error describe it; with many tests the posterior becomes narrower than the values
that are found with one test less differ. So the optimum is found again without each test in turn. In the coordinates
x = QᵀF of the optimum's tangents (:mod:`bayes_iwan.sampling.moves.manifold`), in which the posterior is nearly standard
normal, the jackknife covariance of these optima (Efron & Stein, Ann. Stat. 9, 1981, 586)

    J = (T − 1)/T Σ (x₍ₜ₎ − x̄)(x₍ₜ₎ − x̄)ᵀ = U diag(w) Uᵀ

is compared with the unit matrix, and draws are stretched to U diag(√max(w, 1)) Uᵀ x. Solving QᵀF(z) = x leads back, so
that a stretched draw still lies on the curved sheet that the posterior is. Where tests agree as well as the posterior
says, nothing changes. `analyses/coverage_rig.py` counts how much more truths the intervals hold then.
"""

from dataclasses import replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.solving.point import most_probable
from bayes_iwan.inference.solving.posterior_draws import least_squares_of
from bayes_iwan.sampling.moves.manifold import Manifold, Places

_STAGES = 2  # of the way to a stretched draw, since the sheet curves: each by the Jacobian where it starts
_TOGETHER = 1024  # draws whose Jacobians are held at a time


def stretched(problem: Problem, optimum: Array, z: Array) -> tuple[Array, Array]:
    """Draws of a posterior, as wide as its tests disagree.

    optimum : (ndim,) z of the posterior's maximum; z : (n, ndim) draws. Returns the draws (n, ndim) and the factors
    (free,) by which they were stretched, the largest last, all 1 where they stay as they are. A draw that cannot be
    solved for goes as far as it can. Noise parameters keep their values.
    """
    manifold = Manifold(least_squares_of(problem, optimum))
    at = manifold.places(optimum[None])
    stretch, factors = _stretch(problem, optimum, manifold, at)
    if factors[-1] == 1.0:
        return z, factors
    out = z.copy()
    for first in range(0, len(z), _TOGETHER):
        part = slice(first, first + _TOGETHER)
        out[part] = _moved(manifold, at.tangent[0], stretch, z[part])
    return out, factors


def _stretch(problem: Problem, optimum: Array, manifold: Manifold, at: Places) -> tuple[Array, Array]:
    """The symmetric matrix (free, free) by which x is multiplied, and its eigenvalues; at : the optimum's place."""
    tests, k = len(problem.loops), len(manifold.free)
    if tests < 2:
        return np.eye(k), np.ones(k)
    nuisance, without = manifold.target.nuisance, []
    for t in range(tests):
        kept = [i for i in range(tests) if i != t]
        loops, likelihood = tuple(problem.loops[i] for i in kept), problem.likelihood.of_tests(kept)
        z = most_probable(replace(problem, loops=loops, likelihood=likelihood), optimum[None])[0][0].copy()
        z[nuisance.columns] = nuisance.centre
        without.append(z)
    x = manifold.target.values(np.stack(without), manifold.free) @ at.tangent[0].T
    apart = x - x.mean(axis=0)
    w, u = np.linalg.eigh((tests - 1) / tests * apart.T @ apart)
    factors = np.sqrt(np.maximum(w, 1.0))
    return np.asarray(u * factors @ u.T), factors


def _moved(manifold: Manifold, tangent: Array, stretch: Array, z: Array) -> Array:
    """Draws z (n, ndim) where x, as seen along tangents (free, m), is stretched."""
    out, way = z.copy(), np.arange(len(z))
    here = manifold.places(z)
    x = here.values @ tangent.T
    change = x @ stretch - x
    for stage in range(1, _STAGES + 1):
        here = here if stage == 1 else manifold.places(out[way])
        turn = tangent @ here.tangent.transpose(0, 2, 1)  # from a place's own tangents to the optimum's
        slope = turn @ np.linalg.inv(here.back)
        sound = np.isfinite(slope).all(axis=(1, 2)) & (np.abs(np.linalg.det(turn)) > 1e-12)
        way, here, slope = way[sound], here.some(np.flatnonzero(sound)), slope[sound]
        start = replace(here, tangent=np.broadcast_to(tangent, here.tangent.shape), back=np.linalg.inv(slope))
        reached, met = manifold.reached(start, (x + (stage / _STAGES) * change)[way])
        way = way[met]
        out[np.ix_(way, manifold.free)] = reached[np.ix_(met, manifold.free)]
    return out
