"""The normal approximation of a posterior about an optimum, drawn along the posterior's manifold.

Normal draws of the parameters would leave the thin curved sheet that the posterior is, and with it the loops. So each
draw is a fit to loops and priors that were shifted by their noise ("randomise, then optimise": Bardsley, Solonen,
Haario & Laine, SIAM J. Sci. Comput. 36, 2014, A1895): along the optimum's tangents it is standard normal, and it lies
on the sheet. Draws for which no such fit is found, where the sheet turns over, are normal ones after all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.solving.chains import least_squares_of
from bayes_iwan.inference.solving.point import laplace_scale
from bayes_iwan.models.parameter import Z_LIMIT
from bayes_iwan.sampling.moves.manifold import Manifold
from bayes_iwan.sampling.run import generator


def approximate_draws(problem: Problem, optimum: Array, count: int, seed: Sequence[int]) -> Array:
    """z (count, ndim) of the approximation about an optimum (ndim,), noise parameters by their conditional
    posterior."""
    random, target = generator(seed), least_squares_of(problem, optimum)
    manifold = Manifold(target)
    tried = count + count // 2
    at = manifold.places(optimum[None]).some(np.zeros(tried, np.int64))
    drawn, met = manifold.reached(at, random.standard_normal((tried, len(manifold.free))))
    z = drawn[met][:count]
    unit = random.standard_normal((count - len(z), problem.ndim))
    normal = np.clip(optimum + unit @ laplace_scale(problem, optimum).T, -0.95 * Z_LIMIT, 0.95 * Z_LIMIT)
    return target.integrated(np.concatenate([z, normal]), random).z
