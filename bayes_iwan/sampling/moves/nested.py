"""Independent proposals for a posterior that curves along a few of its parameters only: these are drawn, the others
solved for.

Where the data leave some parameters about as free as their prior and the model is far from linear in them, the
posterior's manifold turns so far that no one place's tangents serve all of it. Given these parameters v, though, the
manifold of the others is nearly flat. So v is drawn from a mixture; the nearest known place gives the tangents Q of the
others' manifold; and with x standard t, QᵀF = x is solved for ("randomise, then optimise" of the others alone). The
density of what is proposed,

    q(v) · t(x) · |det QᵀF′|,

is known, whatever Q is: that decides only how many proposals are wasted. They are accepted by their weights p/q
(Tierney, Ann. Stat. 22, 1994, 1701). A place to which no proposal leads has q = 0: a walker leaves it by other moves.
The prior has a share in v's mixture, so that the weight of v is never more than a multiple of its likelihood
(Hesterberg, Technometrics 37, 1995, 185).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.moves.manifold import TOLERANCE, Manifold, Places
from bayes_iwan.sampling.moves.metropolis import KnownDensityMove, LeastSquares
from bayes_iwan.sampling.nuisance import t_draws, t_log_density

#: the manifold curves along a parameter if its own second derivative, over a posterior standard deviation, is this
#: share of the first; and how many may
_CURVING, _MOST = 0.15, 8
_STEP = 0.02  # of the second differences, in standard deviations
#: share of v's mixture that the prior has; the others are components about known places, as wide as the posterior seems
#: from there (times the first number) and a share of the whole (the second)
_PRIOR_SHARE, _LOCAL, _WHOLE = 0.1, 0.7, 0.1
KNOWN = 256  # places from which the others are solved for
_NU, _NU_OTHERS = 4.0, 12.0  # degrees of freedom of v's and x's t distributions
_WIDER = 1.05  # scale of x's over what was found
#: to what a place on a manifold is met; places nearer than the last are one place
_TOLERANCE, _SAME = 10.0 * TOLERANCE, 1e-2


class NestedMove(KnownDensityMove):
    """Independent proposals of a least-squares posterior, by way of the parameters along which it curves.

    For any user of emcee whose posterior is thin and made of residuals, and that local steps sample slowly.

    curving : coordinates v (see :func:`curving_parameters`); known : draws (k, ndim) of the posterior, as from a
    warm-up.
    """

    def __init__(self, target: LeastSquares, curving: NDArray[np.int64], known: Array) -> None:
        super().__init__(target)
        self.curving, self.known = np.asarray(curving, np.int64), known
        self._manifold = Manifold(target, self.curving)
        self._places = self._manifold.places(known)
        width = len(self.curving)
        whole = np.cov(known[:, self.curving].T).reshape(width, width) + 1e-6 * np.eye(width)
        back = Manifold(target).places(known).back[:, np.searchsorted(target.free, self.curving)]
        local = _LOCAL**2 * (_WHOLE * whole + (1.0 - _WHOLE) * back @ back.transpose(0, 2, 1))
        self._root = np.linalg.cholesky(whole)
        self._means = np.concatenate([np.zeros((1, width)), known[:, self.curving]])
        self._scales = np.concatenate([np.eye(width)[None], np.linalg.cholesky(local)])
        self._inverse = np.linalg.inv(self._scales)
        share = np.full(len(self._means), (1.0 - _PRIOR_SHARE) / len(known))
        share[0] = _PRIOR_SHARE
        self._share = share
        self._log_norm = np.log(share) - np.log(np.diagonal(self._scales, axis1=1, axis2=2)).sum(axis=1)

    def draw(self, n: int, random: np.random.RandomState) -> tuple[Array, Array]:
        which = random.choice(len(self._share), size=n, p=self._share)
        v = self._means[which] + np.einsum(
            "nij,nj->ni", self._scales[which], t_draws(random, (n, len(self.curving)), _NU)
        )
        unit = t_draws(random, (n, len(self._manifold.free)), _NU_OTHERS)
        z, log_q = np.zeros((n, self.target.ndim)), np.full(n, -np.inf)
        found, near = self._near(v)
        if len(found) == 0:
            return z, log_q
        there, met = self._manifold.reached(near, _WIDER * unit[found], _TOLERANCE)
        rows = found[met]
        z[rows] = there[met]
        log_q[rows] = self._log_v(v[rows]) + self._log_others(
            near.some(np.flatnonzero(met)), self._manifold.places(there[met])
        )
        return z, np.where(np.isfinite(log_q), log_q, -np.inf)

    def log_density(self, z: Array) -> Array:
        out = np.full(len(z), -np.inf)
        found, near = self._near(z[:, self.curving])
        if len(found) == 0:
            return out
        place = self._manifold.places(z[found])
        back, met = self._manifold.reached(near, near.seen(place.values), _TOLERANCE)
        density = self._log_v(z[found][:, self.curving]) + self._log_others(near, place)
        led = met & (np.max(np.abs(back - place.z), axis=1, initial=0.0) < _SAME) & np.isfinite(density)
        out[found[led]] = density[led]
        return out

    def _log_v(self, v: Array) -> Array:
        """ln of the mixture's density (n,) at v (n, curving)."""
        unit = np.einsum("kij,nkj->nki", self._inverse, v[:, None] - self._means)
        return np.asarray(logsumexp(t_log_density(unit, _NU) + self._log_norm, axis=1))

    def _log_others(self, near: Places, place: Places) -> Array:
        """ln of the density (n,) with which the others are where they are at these places, given v."""
        unit = near.seen(place.values) / _WIDER
        turn = np.linalg.slogdet(near.tangent @ place.tangent.transpose(0, 2, 1))[1]
        with np.errstate(invalid="ignore"):  # where F′ is not finite
            turn += place.log_det
        return np.asarray(t_log_density(unit, _NU_OTHERS) - unit.shape[1] * np.log(_WIDER) + turn)

    def _near(self, v: Array) -> tuple[NDArray[np.int64], Places]:
        """Places near v (n, curving), for those of them where F is finite: the nearest known one's, v in its place."""
        own, known = (np.linalg.solve(self._root, x.T).T for x in (v, self.known[:, self.curving]))
        rows = np.flatnonzero(np.max(np.abs(v), axis=1) <= self.target.limit)
        apart = np.sum(known**2, axis=1) - 2.0 * own[rows] @ known.T
        start = self._places.some(np.argmin(apart, axis=1))
        start.z[:, self.curving] = v[rows]
        values = self.target.values(start.z, self._manifold.free)
        sound = np.flatnonzero(np.isfinite(values).all(axis=1))
        return rows[sound], replace(start, values=values).some(sound)


def curving_parameters(target: LeastSquares, z: Array) -> NDArray[np.int64]:
    """Along which free coordinates the manifold curves most, as seen from places z (n, ndim): those whose second
    derivative is a good share of the first, a standard deviation long; none where it is nearly flat, or where it curves
    along all."""
    manifold = Manifold(target)
    known, k = manifold.places(z), len(manifold.free)
    sd = np.linalg.norm(known.back, axis=2)
    moved = np.repeat(known.z[:, None], 2 * k, axis=1)
    for sign, first in ((1.0, 0), (-1.0, k)):
        moved[:, np.arange(first, first + k), manifold.free] += sign * _STEP * sd
    values = target.values(moved.reshape(-1, z.shape[1]), manifold.free).reshape(len(z), 2 * k, -1)
    ahead, behind = values[:, :k], values[:, k:]
    slope = np.linalg.norm(ahead - behind, axis=2) / (2.0 * _STEP)
    curvature = np.linalg.norm(ahead + behind - 2.0 * known.values[:, None], axis=2) / _STEP**2
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(np.median(curvature / slope, axis=0), nan=0.0, posinf=0.0)
    most = np.argsort(-share, kind="stable")[:_MOST]
    chosen = np.sort(manifold.free[most[share[most] > _CURVING]])
    return chosen if len(chosen) < k else chosen[:0]
