"""Do proposals lead everywhere? Short random walks from draws, under the posterior, and how many leave what is reached.

A weight corrects what is proposed too seldom, not what is never proposed: places that no branch's map leads to, behind
a fold or where solving fails. Draws by importance have none of these, and their weights look well. A Metropolis walk of
a draw goes there, if the posterior does, for it asks the posterior alone. Its steps are normal in the map's coordinates
as they are about the draw, so that they follow a thin sheet; it takes some 40 evaluations.
"""

from __future__ import annotations

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.independent.source import Source

_WALKS, _STEPS = 128, 40
_SIZE = np.array([0.1, 0.3, 0.6])  # of steps, in standard deviations


def unreached(source: Source, z: Array, log_weight: Array, seed: int) -> float:
    """Share of walks from weighed draws z (n, ndim) that end where no proposal leads."""
    rng = np.random.default_rng([seed, 26])
    weight = np.exp(log_weight - log_weight.max())
    z = z[rng.choice(len(z), _WALKS, p=weight / weight.sum())]
    branch = source.branches[0]
    free, held = branch.map.free, branch.held
    own = np.argmax([b.log_density(z) for b in source.branches], axis=0)
    scale = np.empty((len(z), len(free), len(free)))
    for k in np.unique(own):
        scale[own == k] = source.branches[k].map.scale(z[own == k])
    log_p = branch.log_prob(z)
    for _ in range(_STEPS):
        size = rng.choice(_SIZE, (len(z), 1))
        new = z.copy()
        new[:, free] += size * np.einsum("nij,nj->ni", scale, rng.standard_normal((len(z), len(free))))
        new[:, held] += size * (rng.standard_normal((len(z), len(held))) @ branch.noise.root.T)
        there = branch.log_prob(new)
        gone = np.log(rng.random(len(z))) < there - log_p
        z[gone], log_p[gone] = new[gone], there[gone]
    led_to = np.any([np.isfinite(b.log_density(z)) for b in source.branches], axis=0)
    return float(np.mean(~led_to))
