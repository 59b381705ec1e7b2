"""A block of steps that walkers take together: the same draws wherever it is computed."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import emcee
import numpy as np
from emcee.moves import Move
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.plan import SamplingError

#: moves with their weights
Moves = Sequence[tuple[Move, float]]


def _as_they_are(z: Array, _: int) -> Array:
    return z


@dataclass(frozen=True)
class Density:
    """What is sampled. Walkers move in some of the coordinates; the others are drawn given these, from their
    conditional density, whenever a walker is offered a place.

    function : (x (n, walked), random) → (n, 1 + drawn): ln p with the drawn coordinates integrated out, −∞ where
    impossible, and a draw of these. walked, drawn : their places among all coordinates. blocks : places among the
    walked, those first that others follow. joined : some of the walked may be walked in less what the drawn add to
    them; (z (…, ndim), 1) → z with it, (z, −1) → z without.
    """

    function: Callable[[Array, np.random.RandomState], Array]
    walked: NDArray[np.int64]
    drawn: NDArray[np.int64]
    blocks: tuple[NDArray[np.int64], ...]
    joined: Callable[[Array, int], Array] = _as_they_are

    @property
    def ndim(self) -> int:
        """All coordinates."""
        return len(self.walked) + len(self.drawn)

    def __call__(self, x: Array, random: np.random.RandomState) -> Array:
        """The function, its shape and values checked."""
        found = np.asarray(self.function(x, random), dtype=float)
        wanted = (len(x), 1 + len(self.drawn))
        if found.shape != wanted:
            raise SamplingError(f"log_prob(z) returned shape {found.shape} for {len(x)} places; it must be {wanted}")
        wrong = np.isnan(found[:, 0]) | np.isposinf(found[:, 0])
        if wrong.any():
            raise SamplingError(f"log_prob is NaN or +inf at z = {np.array2string(x[wrong][0])}; it must be -inf there")
        return found

    def whole(self, x: Array, drawn: Array) -> Array:
        """All coordinates (…, ndim) of x (…, walked) and those drawn there (…, drawn)."""
        z = np.empty((*x.shape[:-1], self.ndim))
        z[..., self.walked], z[..., self.drawn] = x, drawn
        return self.joined(z, 1)

    def apart(self, z: Array) -> Array:
        """x (…, walked) of all coordinates (…, ndim)."""
        return self.joined(z, -1)[..., self.walked]


@dataclass(frozen=True)
class Places:
    """Where walkers are: x (…, n, walked), the coordinates drawn there (…, n, drawn), and ln p (…, n)."""

    x: Array
    drawn: Array
    log_prob: Array

    def some(self, part: slice | NDArray[np.int64]) -> "Places":
        """Some of the walkers."""
        return Places(self.x[part], self.drawn[part], self.log_prob[part])

    @property
    def last(self) -> "Places":
        """Of several steps, the last."""
        return Places(self.x[-1], self.drawn[-1], self.log_prob[-1])


def advanced(shared: tuple[Density, Moves, int], piece: tuple[Places, tuple[int, ...]]) -> tuple[Places, float]:
    """A block of so many steps by emcee, and the share of them that was accepted; of a piece: walkers that advance
    together, and the seed of their block."""
    (density, moves, steps), (start, seed) = shared, piece
    random, blobs = generator((*seed, 1)), start.drawn if len(density.drawn) else None
    if len(density.drawn) == 1:
        blobs = start.drawn[:, 0]  # as emcee keeps a single one
    state = emcee.State(start.x, log_prob=start.log_prob, blobs=blobs, random_state=generator(seed).get_state())
    own = [(copy.copy(move), weight) for move, weight in moves]
    sampler = emcee.EnsembleSampler(*start.x.shape, None, moves=own, vectorize=True)
    sampler.log_prob_fn = lambda x: density(x, random)  # emcee's wrapper prints a traceback on Ctrl-C
    for _ in sampler.sample(state, iterations=steps, skip_initial_state_check=True):
        pass
    x, log_prob = sampler.get_chain(), sampler.get_log_prob()
    drawn = np.zeros((*log_prob.shape, 0)) if blobs is None else sampler.get_blobs().reshape(*log_prob.shape, -1)
    return Places(x, drawn, log_prob), float(np.mean(sampler.acceptance_fraction))


def generator(seed: Sequence[int]) -> np.random.RandomState:
    """Random numbers as emcee takes them, of their own for each seed."""
    return np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))
