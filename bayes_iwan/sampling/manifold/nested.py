"""Proposals for a posterior that only a few of its numbers bend: these are drawn first, the others solved for.

Where the data leave some numbers about as free as their prior and the model is far from linear in them, the posterior's
sheet turns so far that no one place's tangents serve all of it (see `independent.residual_map`). Given these numbers v,
though, the sheet of the others hardly bends. So v is drawn from a mixture; from the nearest place that is known the
others are led to the middle of their sheet there, whose tangents Q are taken; and from there, with x standard t,
QᵀF = x is solved for ("randomise, then optimise" of the others alone). The density of what is proposed,

    q(v) · t(x) · |det QᵀF′|,

is known, whatever the middle is: that decides only how many proposals are wasted. So they are independent proposals of
a Markov chain, accepted by their weights p/q (Tierney, Ann. Stat. 22, 1994, 1701). A place to which no proposal leads
has q = 0: a chain leaves it by other steps.

v's mixture is fitted to draws that a chain has made before any counts, and then is frozen. The prior itself has a share
in it, so that the weight of v is never more than a multiple of its likelihood (Hesterberg, Technometrics 37, 1995,
185).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.held import t_draws, t_log_density
from bayes_iwan.sampling.common.mixture import StudentMixture, fit_mixture
from bayes_iwan.sampling.manifold.sheet import Places, Sheet

#: a number bends the sheet if its own second derivative, over a posterior standard deviation, is this share of the
#: first; and how many may
_BENT, _MOST = 0.15, 8
_STEP = 0.02  # of the second differences, in standard deviations
_COMPONENTS = 8
#: shares of v's mixture that the prior has, and components about known places, as wide as the posterior seems from
#: there, and a little of the whole, times this: they follow what bends too much for the others
_PRIOR_SHARE, _PLACES_SHARE, _SEEN, _WHOLE = 0.1, 0.4, 0.7, 0.1
_MATERIAL, _KNOWN = 4000, 256  # draws that the mixture is fitted to; places from which the others are solved for
_NU, _NU_OTHERS = 4.0, 12.0  # degrees of freedom of v's and x's t distributions
_WIDER_V, _WIDER = 1.1, 1.05  # their scales over what was found
#: to what the middle of a sheet and a place on it are met; places nearer than this are one place
_NEAR, _TOLERANCE, _SAME = 1e-1, 1e-3, 1e-2
_TOGETHER = 256  # proposals that are solved for at a time


@dataclass(frozen=True)
class Proposed:
    """Places z (n, ndim), ln p there (n,), its integral over the held numbers (n,), and the logarithm of that over the
    density with which z is proposed (n,), −∞ where nothing was found."""

    z: Array
    log_prob: Array
    log_total: Array
    log_weight: Array


class Nested:
    """Where proposals come from: the numbers v, what they are drawn from, and places from which the others are solved
    for. Laid out by :meth:`fitted`."""

    def __init__(self, whole: Sheet, v: NDArray[np.int64], mixture: StudentMixture, known: Array) -> None:
        self._v, self._mixture, self._held = v, mixture, whole.held
        self._sheet = whole.given(v)
        self._known = self._sheet.places(known)
        self._root = np.linalg.cholesky(np.cov(known[:, v].T).reshape(len(v), len(v)) + 1e-6 * np.eye(len(v)))

    @classmethod
    def fitted(cls, whole: Sheet, v: NDArray[np.int64], z: Array, rng: np.random.Generator) -> Nested:
        """From draws z (n, ndim), which may hang together."""
        some = z[rng.permutation(len(z))]
        fit, known = fit_mixture(some[:_MATERIAL, v], _COMPONENTS, rng, nu=_NU), some[:_KNOWN]
        back = whole.places(known).back[:, np.searchsorted(whole.free, v)]
        wide = _WHOLE * np.cov(some[:, v].T).reshape(len(v), len(v)) + (1.0 - _WHOLE) * back @ back.transpose(0, 2, 1)
        share = 1.0 - _PRIOR_SHARE - _PLACES_SHARE
        mixture = StudentMixture(
            np.concatenate([[_PRIOR_SHARE], share * fit.weights, np.full(len(known), _PLACES_SHARE / len(known))]),
            np.concatenate([np.zeros((1, len(v))), fit.means, known[:, v]]),
            np.concatenate([np.eye(len(v))[None], _WIDER_V * fit.scales, _SEEN * np.linalg.cholesky(wide)]),
            _NU,
        )
        return cls(whole, v, mixture, known)

    def propose(self, n: int, rng: np.random.Generator) -> Proposed:
        """n independent proposals."""
        v, unit = self._mixture.sample(n, rng), t_draws(rng, (n, len(self._sheet.free)), _NU_OTHERS)
        held, chance = self._held.chances(n, rng), rng.random(n)
        log_v = self._mixture.log_density(v)
        z = np.zeros((n, self._known.z.shape[1]))
        log_prob, log_total, log_weight = (np.full(n, -np.inf) for _ in range(3))
        for first in range(0, n, _TOGETHER):
            part = np.arange(first, min(first + _TOGETHER, n))
            found, middle = self._middle(v[part])
            there, met = self._sheet.reached(middle, _WIDER * unit[part[found]], _TOLERANCE)
            rows, place = part[found[met]], self._sheet.places(there[met])
            density = log_v[rows] + self._log_density(middle.some(np.flatnonzero(met)), place)
            sound = np.isfinite(density)
            rows = rows[sound]
            if len(rows):
                log_total[rows], z[rows], log_prob[rows] = self._held.integrated(
                    self._sheet.log_prob, place.z[sound], held[rows], chance[rows]
                )
                log_weight[rows] = log_total[rows] - density[sound]
        return Proposed(z, log_prob, log_total, log_weight)

    def log_weight(self, z: Array, log_total: Array) -> Array:
        """The logarithm of the weights (n,) of places z (n, ndim) where a chain is; ∞ for those never proposed."""
        out = np.full(len(z), np.inf)
        found, middle = self._middle(z[:, self._v])
        place = self._sheet.places(z[found])
        back, met = self._sheet.reached(middle, middle.seen(place.values), _TOLERANCE)
        density = self._mixture.log_density(z[found][:, self._v]) + self._log_density(middle, place)
        led = met & (np.max(np.abs(back - place.z), axis=1, initial=0.0) < _SAME) & np.isfinite(density)
        out[found[led]] = log_total[found[led]] - density[led]
        return out

    def _log_density(self, middle: Places, place: Places) -> Array:
        """ln of the density (n,) with which the others are where they are at these places, given v."""
        unit = middle.seen(place.values) / _WIDER
        turn = np.linalg.slogdet(middle.tangent @ place.tangent.transpose(0, 2, 1))[1]
        with np.errstate(invalid="ignore"):  # where F′ is not finite
            turn += place.log_det
        return t_log_density(unit, _NU_OTHERS) - unit.shape[1] * np.log(_WIDER) + turn

    def _middle(self, v: Array) -> tuple[NDArray[np.int64], Places]:
        """The middles of the others' sheets given v (n, bent): of which these are found, and the places."""
        own, known = (np.linalg.solve(self._root, x.T).T for x in (v, self._known.z[:, self._v]))
        rows = np.flatnonzero(np.max(np.abs(v), axis=1) <= self._sheet.limit)
        apart = np.sum(known**2, axis=1) - 2.0 * own[rows] @ known.T
        start = self._known.some(np.argmin(apart, axis=1))
        start.z[:, self._v] = v[rows]
        start = replace(start, values=self._sheet.values(start.z))
        z, met = self._sheet.reached(start, np.zeros((len(rows), len(self._sheet.free))), _NEAR)
        return rows[met], self._sheet.places(z[met])

    def counting(self) -> Nested:
        """The same with evaluations counted from none."""
        out = copy.copy(self)
        out._sheet = self._sheet.counting()
        return out

    @property
    def n_evaluations(self) -> int:
        return self._sheet.n_evaluations

    def state(self) -> dict[str, NDArray]:
        """What it is made of, for a checkpoint."""
        mixture = {name: getattr(self._mixture, name) for name in ("weights", "means", "scales")}
        return {"bent": self._v, "known": self._known.z, **mixture}

    @classmethod
    def restored(cls, whole: Sheet, state: Mapping[str, NDArray]) -> Nested:
        """What :meth:`state` was said of, on the same sheet."""
        mixture = StudentMixture(state["weights"], state["means"], state["scales"], _NU)
        return cls(whole, np.asarray(state["bent"], np.int64), mixture, state["known"])


def bending(sheet: Sheet, z: Array) -> NDArray[np.int64]:
    """Which of a sheet's free numbers bend it most, as seen from places z (n, ndim): those whose second derivative is
    a good share of the first, a standard deviation long; none where the sheet is nearly flat, or all of it bends."""
    known, k = sheet.places(z), len(sheet.free)
    sd = np.linalg.norm(known.back, axis=2)
    moved = np.repeat(known.z[:, None], 2 * k, axis=1)
    for sign, first in ((1.0, 0), (-1.0, k)):
        moved[:, np.arange(first, first + k), sheet.free] += sign * _STEP * sd
    values = sheet.values(moved.reshape(-1, z.shape[1])).reshape(len(z), 2 * k, -1)
    ahead, behind = values[:, :k], values[:, k:]
    slope = np.linalg.norm(ahead - behind, axis=2) / (2.0 * _STEP)
    bend = np.linalg.norm(ahead + behind - 2.0 * known.values[:, None], axis=2) / _STEP**2
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(np.median(bend / slope, axis=0), nan=0.0, posinf=0.0)
    most = np.argsort(-share, kind="stable")[:_MOST]
    chosen = np.sort(sheet.free[most[share[most] > _BENT]])
    return chosen if len(chosen) < k else chosen[:0]


def jumped(weight: Array, proposed: Array, log_chance: Array) -> NDArray[np.int64]:
    """Chains (n,) that are offered independent proposals one after the other: the last one (steps, n) that each has
    accepted by then, −1 for none yet.

    weight (n,), proposed (steps, n) : logarithms of weights; log_chance (steps, n) : of uniform random numbers.
    """
    at, taken = weight.copy(), np.full(len(weight), -1)
    out = np.empty(proposed.shape, np.int64)
    for i, (new, chance) in enumerate(zip(proposed, log_chance)):
        gone = np.isfinite(new) & (chance < new - at)
        at[gone], taken[gone] = new[gone], i
        out[i] = taken
    return out
