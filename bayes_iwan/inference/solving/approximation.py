"""The normal approximation of a posterior about its optima, drawn along the posterior's manifold.

Normal draws of the parameters would leave the thin curved sheet that the posterior is, and with it the loops. So each
draw is a fit to loops and priors that were shifted by their noise ("randomise, then optimise": Bardsley, Solonen,
Haario & Laine, SIAM J. Sci. Comput. 36, 2014, A1895): along the optimum's tangents it is standard normal, and it lies
on the sheet. Draws for which no such fit is found, where the sheet turns over, are normal ones after all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.solving.chains import least_squares_of
from bayes_iwan.inference.solving.point import laplace_scale
from bayes_iwan.models.parameter import Z_LIMIT
from bayes_iwan.sampling.moves.manifold import Manifold
from bayes_iwan.sampling.run import generator


def approximate_draws(problem: Problem, optima: Array, count: int, seed: Sequence[int]) -> Array:
    """z (count, ndim) of the approximation about optima (k, ndim) or (ndim,), each by its Laplace evidence; noise
    parameters by their conditional posterior."""
    random, optima = generator(seed), np.atleast_2d(optima)
    roots = [laplace_scale(problem, z) for z in optima]
    evidence = problem.log_prob(optima) + [np.linalg.slogdet(root)[1] for root in roots]
    counts = random.multinomial(count, softmax(evidence))
    parts = [_about(problem, *at, random) for at in zip(optima, roots, counts.tolist()) if at[2]]
    return np.concatenate(parts)[random.permutation(count)]


def _about(problem: Problem, optimum: Array, root: Array, count: int, random: np.random.RandomState) -> Array:
    """z (count, ndim) about an optimum (ndim,), whose covariance has this root."""
    target = least_squares_of(problem, optimum)
    manifold = Manifold(target)
    tried = count + count // 2
    at = manifold.places(optimum[None]).some(np.zeros(tried, np.int64))
    drawn, met = manifold.reached(at, random.standard_normal((tried, len(manifold.free))))
    z = drawn[met][:count]
    unit = random.standard_normal((count - len(z), problem.ndim))
    normal = np.clip(optimum + unit @ root.T, -0.95 * Z_LIMIT, 0.95 * Z_LIMIT)
    return target.integrated(np.concatenate([z, normal]), random).z
