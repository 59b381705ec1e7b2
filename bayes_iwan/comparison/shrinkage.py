"""What the other specimens of a lot say of one: its posterior shrunk towards the lot's population.

A specimen's finished draws are weighted by the population that all others of its lot show, over the prior they were
drawn under: the hierarchical posterior, without sampling again. Whether the draws can carry these weights is checked by
Pareto's k and by how many of them are left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayes_iwan.arrays import Array
from bayes_iwan.comparison.loo import TRUSTED, smoothed_log_weights
from bayes_iwan.inference.results.population import Population, SpecimenDraws
from bayes_iwan.screen import on_screen

#: effective draws below which shrunk quantiles are not given
LEAST_DRAWS = 40.0


@dataclass(frozen=True, kw_only=True)
@on_screen
class Shrunk:
    """One quantity of one specimen with what its lot says of it: quantiles, and how far the weights may be trusted.

    effective : number of draws that the weights leave; pareto_k : of the weights. usable : may the quantiles be used?
    """

    q05: float
    q50: float
    q95: float
    effective: float
    pareto_k: float

    @property
    def usable(self) -> bool:
        return self.effective >= LEAST_DRAWS and self.pareto_k < TRUSTED


def shrunk(specimens: Sequence[SpecimenDraws], found: Population) -> Mapping[str, Shrunk]:
    """Each specimen of a population shrunk towards what the others show, by name."""
    out = {}
    for i, one in enumerate(specimens):
        z, prior = found.coordinate.z(one.draws), found.coordinate.z(one.prior)
        own = -0.5 * ((z - np.mean(prior)) / max(float(np.std(prior)), 1e-12)) ** 2
        log_w, k = smoothed_log_weights(_log_density(z, found, i) - own)
        weight = np.exp(log_w)
        order = np.argsort(one.draws)
        upto = np.cumsum(weight[order]) - 0.5 * weight[order]
        low, middle, high = map(float, np.interp([0.05, 0.5, 0.95], upto, one.draws[order]))
        effective = float(1.0 / np.sum(weight**2))
        out[one.name] = Shrunk(q05=low, q50=middle, q95=high, effective=effective, pareto_k=float(k))
    return out


def _log_density(z: Array, found: Population, which: int) -> Array:
    """ln of the density of one specimen's z, (draws,), learnt from the others alone."""
    p = found.from_others[which]
    mean, tau = np.broadcast_arrays(found.mean[:, None], found.tau[None, :])
    kept = p > 1e-6 * p.max()
    terms = np.log(p[kept]) - np.log(tau[kept]) - 0.5 * ((z[:, None] - mean[kept]) / tau[kept]) ** 2
    return logsumexp(terms, axis=1)
