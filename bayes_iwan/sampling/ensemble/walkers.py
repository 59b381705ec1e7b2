"""The walkers of several independent ensembles, and emcee stepping them all together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import emcee
import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.plan import BatchFunction, SamplingError
from bayes_iwan.sampling.ensemble.moves import BlockMove

WeighedMoves = Sequence[tuple[BlockMove, float]]


def enough_walkers(ndim: int) -> int:
    """The least walkers an ensemble that differential evolution and stretch moves span `ndim` dimensions with."""
    return 2 * ndim + 2


class Walkers:
    """State of rungs × `ensembles` × `walkers` walkers in one emcee sampler, in blocks as `BlockMove` has them.

    powers : of the target on each rung, 1 first; ensemble e owns one block on every rung.
    """

    def __init__(
        self, log_prob: BatchFunction, ensembles: int, walkers: int, ndim: int, powers: tuple[float, ...] = (1.0,)
    ) -> None:
        if ensembles < 2:
            raise SamplingError(f"n_ensembles = {ensembles}: R-hat needs at least 2 independent ensembles, better 4")
        if walkers < enough_walkers(ndim):
            least = enough_walkers(ndim)
            raise SamplingError(f"n_walkers = {walkers} is too few for {ndim} parameters; take at least {least}")
        self.function, self.ensembles, self.walkers, self.ndim = log_prob, ensembles, walkers, ndim
        self.powers = powers
        self.blocks = ensembles * len(powers)
        self.n_evaluations = 0
        self.state: emcee.State | None = None

    def resized(self, walkers: int) -> Walkers:
        """The same with another number of walkers an ensemble: of those that are placed already, the first ones.

        The walkers of an ensemble are exchangeable, so any of them are as good.
        """
        other = Walkers(self.function, self.ensembles, walkers, self.ndim, self.powers)
        other.n_evaluations = self.n_evaluations
        if self.state is not None:
            mine = (np.arange(self.blocks)[:, None] * self.walkers + np.arange(walkers)).ravel()
            other.state = emcee.State(
                self.state.coords[mine], log_prob=self.state.log_prob[mine], random_state=self.state.random_state
            )
        return other

    def log_prob(self, z: Array) -> Array:
        """The log-probability of z (n, ndim), its shape and values checked."""
        self.n_evaluations += len(z)
        values = np.asarray(self.function(z), dtype=float)
        if values.shape != (len(z),):
            raise SamplingError(f"log_prob(z) returned shape {values.shape} for z of shape {z.shape}; it must be (n,)")
        if np.isnan(values).any() or np.isposinf(values).any():
            bad = z[np.isnan(values) | np.isposinf(values)][0]
            raise SamplingError(f"log_prob is NaN or +inf at z = {np.array2string(bad)}; it must be -inf there")
        return values

    def place(self, population: Array, seed: int) -> Array:
        """Start each ensemble from its own random share of the population's members with finite log_prob.

        Returns the population's log_prob (members,). A population with fewer of them than there are walkers is filled
        up with points between members.
        """
        if population.ndim != 2 or population.shape[1] != self.ndim:
            raise SamplingError(f"population has shape {population.shape}; it must be (members, {self.ndim})")
        rng = np.random.default_rng([seed, 1])
        values = self.log_prob(population)
        good = np.unique(population[np.isfinite(values)], axis=0)
        if len(good) == 0:
            raise SamplingError(
                f"none of the {len(population)} members of the population has a finite log-probability: "
                "there is nowhere to start from; check the data, the bounds and the priors"
            )
        if len(good) <= self.ndim:
            raise SamplingError(
                f"only {len(good)} different members of the population have a finite log-probability; "
                f"walkers need more than {self.ndim} to span all directions"
            )
        need = self.blocks * self.walkers
        z = good[rng.permutation(len(good))[:need]]
        for _ in range(100):
            missing = need - len(z)
            if missing == 0:
                break
            a, b = good[rng.integers(len(good), size=(2, missing))]
            new = a + rng.uniform(0.05, 0.5, size=(missing, 1)) * (b - a)
            z = np.concatenate([z, new[np.isfinite(self.log_prob(new)) & (a != b).any(axis=1)]])
        else:
            raise SamplingError("hardly a point between members of the population has a finite log-probability")
        # Shares are dealt out at random, so that no ensemble starts from the population's best members alone.
        z = z[rng.permutation(need)]
        generator = np.random.RandomState(np.random.MT19937(np.random.SeedSequence([seed, 2])))
        self.state = emcee.State(z, log_prob=self.log_prob(z), random_state=generator.get_state())
        return values

    def advance(
        self,
        moves: WeighedMoves,
        steps: int,
        thin: int,
        tick: Callable[[int], object],
        deadline: float | None,
    ) -> tuple[Array, Array]:
        """Take `steps` steps and return every thin-th: draws (blocks, stored, walkers, ndim) and log_prob.

        Blocks are those of power 1 first, one for each ensemble, then those of the next rung. Ends early, at a whole
        number of stored steps, after `deadline` (of time.monotonic).
        """
        assert self.state is not None
        total = self.blocks * self.walkers
        stored = steps // thin
        draws = np.empty((stored, total, self.ndim))
        values = np.empty((stored, total))
        sampler = emcee.EnsembleSampler(total, self.ndim, self.log_prob, moves=list(moves), vectorize=True)
        # without emcee's wrapper, which prints a traceback on Ctrl-C
        sampler.log_prob_fn = self.log_prob
        start = emcee.State(self.state, copy=True)
        done = 0
        for state in sampler.sample(start, iterations=stored, thin_by=thin, store=False, skip_initial_state_check=True):
            draws[done], values[done] = state.coords, state.log_prob
            done += 1
            tick(thin)
            if deadline is not None and done >= 8 and time.monotonic() > deadline:
                break
        if done:
            self.state = emcee.State(state, copy=True)
        return by_block(draws[:done], self.blocks), by_block(values[:done], self.blocks)

    @property
    def drawing(self) -> slice:
        """The walkers that draw from the target itself, in emcee's state."""
        return slice(0, self.ensembles * self.walkers)

    def rescue(self, draws: Array, values: Array, seed: Sequence[int]) -> int:
        """Put walkers left far behind, in warm-up, onto other draws of their own block; return how many.

        Far behind is more than 5·ndim/power below their block's median log_prob: the bulk of a posterior lies within
        ndim/2 ± a few sqrt(ndim/2).
        """
        assert self.state is not None
        rng = np.random.default_rng(list(seed))
        moved = 0
        for e in range(self.blocks):
            mine = slice(e * self.walkers, (e + 1) * self.walkers)
            floor = np.median(self.state.log_prob[mine]) - 5.0 * self.ndim / self.powers[e // self.ensembles]
            lost = np.flatnonzero(self.state.log_prob[mine] < floor) + e * self.walkers
            fit = np.argwhere(values[e, -(len(values[e]) // 4 + 1) :] >= floor)
            if len(lost) == 0 or len(fit) == 0:
                continue
            step, walker = fit[rng.integers(len(fit), size=len(lost))].T
            recent = slice(-(len(values[e]) // 4 + 1), None)
            self.state.coords[lost] = draws[e, recent][step, walker]
            self.state.log_prob[lost] = values[e, recent][step, walker]
            moved += len(lost)
        return moved

    def to_arrays(self) -> dict[str, NDArray]:
        """Positions, log_prob and the whole state of the random generator, for a checkpoint."""
        assert self.state is not None
        _, key, position, has_gauss, gauss = self.state.random_state
        return {
            "coords": self.state.coords,
            "log_prob": self.state.log_prob,
            "random_key": key,
            "random_rest": np.array([position, has_gauss]),
            "random_gauss": np.array(gauss),
            "n_evaluations": np.array(self.n_evaluations),
        }

    def from_arrays(self, arrays: Mapping[str, NDArray]) -> None:
        """Go back to what `to_arrays` wrote. Raises ValueError for arrays of another shape or kind."""
        total = self.blocks * self.walkers
        for key, shape, kind in (
            ("coords", (total, self.ndim), "f"),
            ("log_prob", (total,), "f"),
            ("random_key", (624,), "u"),
        ):
            if arrays[key].shape != shape or arrays[key].dtype.kind != kind:
                raise ValueError(f"{key} of shape {arrays[key].shape} and kind {arrays[key].dtype.kind}")
        if not np.isfinite(arrays["coords"]).all() or not np.isfinite(arrays["log_prob"]).all():
            raise ValueError("walkers at no numbers")
        position, has_gauss = (int(v) for v in arrays["random_rest"])
        random_state = ("MT19937", arrays["random_key"], position, has_gauss, float(arrays["random_gauss"]))
        self.state = emcee.State(arrays["coords"], log_prob=arrays["log_prob"], random_state=random_state)
        self.n_evaluations = int(arrays["n_evaluations"])


def by_block(x: Array, blocks: int) -> Array:
    """(stored, walkers of all blocks, ...) to (blocks, stored, walkers, ...)."""
    return np.moveaxis(x.reshape(len(x), blocks, x.shape[1] // blocks, *x.shape[2:]), 0, 1)


def in_one_row(x: Array) -> Array:
    """The inverse of `by_block`."""
    x = np.moveaxis(x, 1, 0)
    return x.reshape(len(x), x.shape[1] * x.shape[2], *x.shape[3:])
