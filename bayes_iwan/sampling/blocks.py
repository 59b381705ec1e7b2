"""A block of steps that walkers take together: the same draws wherever it is computed."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import emcee
import numpy as np
from emcee.moves import Move

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.plan import BatchFunction, SamplingError

#: moves with their weights, and how many steps of a block they are used for, one entry after the other
Schedule = Sequence[tuple[Sequence[tuple[Move, float]], int]]


@dataclass(frozen=True)
class Piece:
    """Walkers that advance together, z (n, ndim) and ln p there (n,), and the seed of their block."""

    z: Array
    log_prob: Array
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Advanced:
    """z (steps, n, ndim) and ln p (steps, n) after each step; of each entry of the schedule the share accepted."""

    z: Array
    log_prob: Array
    accepted: tuple[float, ...]


def advanced(shared: tuple[BatchFunction, Schedule], piece: Piece) -> Advanced:
    """A block of steps by emcee."""
    log_prob, schedule = shared
    state = emcee.State(piece.z, log_prob=piece.log_prob, random_state=generator(piece.seed).get_state())
    z, level, accepted = [], [], []
    for moves, steps in schedule:
        own = [(copy.copy(move), weight) for move, weight in moves]
        sampler = emcee.EnsembleSampler(*piece.z.shape, log_prob, moves=own, vectorize=True)
        sampler.log_prob_fn = log_prob  # emcee's wrapper prints a traceback on Ctrl-C
        *_, state = sampler.sample(state, iterations=steps, skip_initial_state_check=True)
        z.append(sampler.get_chain())
        level.append(sampler.get_log_prob())
        accepted.append(float(np.mean(sampler.acceptance_fraction)))
    return Advanced(np.concatenate(z), np.concatenate(level), tuple(accepted))


def generator(seed: Sequence[int]) -> np.random.RandomState:
    """Random numbers as emcee takes them, of their own for each seed."""
    return np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))


@dataclass(frozen=True)
class Checked:
    """A log-probability whose shape and values are checked."""

    function: Callable[[Array], Array]

    def __call__(self, z: Array) -> Array:
        values = np.asarray(self.function(z), dtype=float)
        if values.shape != (len(z),):
            raise SamplingError(f"log_prob(z) returned shape {values.shape} for z of shape {z.shape}; it must be (n,)")
        if np.isnan(values).any() or np.isposinf(values).any():
            bad = z[np.isnan(values) | np.isposinf(values)][0]
            raise SamplingError(f"log_prob is NaN or +inf at z = {np.array2string(bad)}; it must be -inf there")
        return values
