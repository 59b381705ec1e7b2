"""The Metropolis step that moves on least-squares posteriors share, and what they know of such a posterior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.nuisance import Integrated, Nuisance, NuisanceFunction

Rows = Callable[[Array], Array]


@dataclass(frozen=True)
class LeastSquares:
    """A posterior of z (ndim,) that is a sum of squares but for its nuisance parameters.

    Parameters
    ----------
    rows
        z (n, ndim) → (n, k), whitened residuals: −½|rows|² − ½|z|² is ln p but for what depends on the nuisance
        parameters alone. Approximate rows make poorer proposals, not another posterior.
    log_prob
        z (n, ndim), nuisance parameters (n, count, columns) in the place of z's own → ln p (n, count), exact.
    nuisance
        the coordinates that scale the residuals, and where they lie.
    ndim
        of z.
    limit
        z lies within ±limit.
    """

    rows: Rows
    log_prob: NuisanceFunction
    nuisance: Nuisance
    ndim: int
    limit: float

    @property
    def free(self) -> NDArray[np.int64]:
        """The coordinates that are no nuisance parameters."""
        return np.setdiff1d(np.arange(self.ndim), self.nuisance.columns)

    def values(self, z: Array, free: NDArray[np.int64]) -> Array:
        """F (n, k + free) at z (n, ndim): −½|F|² is ln p but for the nuisance parameters and for what is not free."""
        with np.errstate(all="ignore"):
            return np.concatenate([self.rows(z), z[:, free]], axis=1)

    def integrated(self, z: Array, random: np.random.RandomState, keep: bool = False) -> Integrated:
        """ln p with the nuisance parameters integrated out; keep : z's own are among the draws."""
        return self.nuisance.integrated(self.log_prob, z, random, keep)

    def fitted(self, z: Array) -> LeastSquares:
        """The same with the nuisance parameters where draws z (n, ndim) have them."""
        return replace(self, nuisance=self.nuisance.fitted(z[:, self.nuisance.columns]))

    def with_nuisance(self, centre: Array, root: Array) -> LeastSquares:
        """The same with the nuisance parameters about this centre. Raises ValueError for other shapes."""
        own = self.nuisance
        if centre.shape != own.centre.shape or root.shape != own.root.shape:
            raise ValueError(f"nuisance parameters of shapes {centre.shape} and {root.shape}")
        return replace(self, nuisance=replace(own, centre=centre, root=root))


@dataclass(frozen=True)
class Candidates:
    """What a step offers: the current places with nuisance parameters drawn anew, z and log_prob; the candidates'; and
    the logarithm of the Metropolis–Hastings ratio (n,), −∞ where there is no candidate."""

    z: Array
    log_prob: Array
    new_z: Array
    new_log_prob: Array
    log_ratio: Array


class MetropolisMove(Move):  # type: ignore[misc]
    """A move in which each walker takes its own step and knows nothing of the others."""

    #: walkers stay independent of each other
    independent = True

    def candidates(self, z: Array, random: np.random.RandomState) -> Candidates:
        """Offers for walkers at z (n, ndim)."""
        raise NotImplementedError

    def propose(self, model: Any, state: State) -> tuple[State, NDArray[np.bool_]]:
        """One step of every walker, as `emcee.EnsembleSampler` calls it."""
        random = model.random
        offer = self.candidates(np.array(state.coords), random)
        with np.errstate(invalid="ignore", divide="ignore"):
            accepted = np.log(random.random_sample(len(offer.z))) < offer.log_ratio
        z = np.where(accepted[:, None], offer.new_z, offer.z)
        log_prob = np.where(accepted, offer.new_log_prob, offer.log_prob)
        return State(z, log_prob=log_prob, random_state=random.get_state()), accepted


class KnownDensityMove(MetropolisMove):
    """Independent proposals whose density q is known: accepted by the ratio of weights p/q."""

    def __init__(self, target: LeastSquares) -> None:
        self.target = target
        self._last: tuple[Array, Array] | None = None  # where walkers may be after the last step, and ln q there

    def __getstate__(self) -> dict[str, Any]:
        """Densities are not handed on: they follow from where the walkers are."""
        return self.__dict__ | {"_last": None}

    def draw(self, n: int, random: np.random.RandomState) -> tuple[Array, Array]:
        """Proposals z (n, ndim) without nuisance parameters, and ln q there (n,), −∞ where there is none."""
        raise NotImplementedError

    def log_density(self, z: Array) -> Array:
        """ln q (n,) at z (n, ndim), whatever the nuisance parameters; −∞ where no proposal leads."""
        raise NotImplementedError

    def candidates(self, z: Array, random: np.random.RandomState) -> Candidates:
        """Offers for walkers at z (n, ndim)."""
        target, free = self.target, self.target.free
        log_total, z, log_prob = target.integrated(z, random, keep=True)
        log_q = self._log_density_of(z, z[:, free])
        new_z, new_log_q = self.draw(len(z), random)
        new_log_prob, log_ratio = log_prob.copy(), np.full(len(z), -np.inf)
        there = np.flatnonzero(np.isfinite(new_log_q))
        if len(there):
            total, new_z[there], new_log_prob[there] = target.integrated(new_z[there], random)
            led = np.isfinite(log_q[there])  # a walker at a place that is never proposed leaves it by other moves
            log_ratio[there[led]] = (total - new_log_q[there] - log_total[there] + log_q[there])[led]
        self._last = np.concatenate([z[:, free], new_z[:, free]]), np.concatenate([log_q, new_log_q])
        return Candidates(z, log_prob, new_z, new_log_prob, log_ratio)

    def _log_density_of(self, z: Array, free: Array) -> Array:
        """:meth:`log_density`, taken from the last step where a walker is still there or was led there."""
        out, unknown, n = np.empty(len(z)), np.ones(len(z), bool), len(z)
        if self._last is not None and len(self._last[1]) == 2 * n:
            for part in (slice(0, n), slice(n, 2 * n)):
                same = unknown & np.all(self._last[0][part] == free, axis=1)
                out[same] = self._last[1][part][same]
                unknown &= ~same
        rows = np.flatnonzero(unknown)
        if len(rows):
            out[rows] = self.log_density(z[rows])
        return out
