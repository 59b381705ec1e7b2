"""Sampling a posterior with emcee until it has converged: one run, whatever the posterior.

Walkers are led to the posterior (:mod:`bayes_iwan.sampling.annealing`), then move by proposals that are learnt from
draws (:mod:`bayes_iwan.sampling.proposals`): at first from where all of them were led to, then from the later half of
the walkers' own, whenever these are half as many again and those since are not half of the effective draws that are
asked for, or not as many autocorrelation times. Draws count from the last time on. No walker ever knows of another one
that production moves, so they are as many chains.

Walkers advance in blocks of steps, each with random numbers of its own that follow from the seed, so draws are the same
wherever a block is computed. Block by block they go into a checkpoint; a run that goes on from it draws the very same.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Rounds
from bayes_iwan.sampling.annealing import Advance, annealed, guess_about, guess_from
from bayes_iwan.sampling.blocks import Density, Moves, Places, advanced, generator
from bayes_iwan.sampling.chains import Chains, Stop
from bayes_iwan.sampling.checkpoint import Checkpoint, CheckpointError, Snapshot, not_ours
from bayes_iwan.sampling.convergence import Convergence, convergence_of
from bayes_iwan.sampling.plan import Plan, SamplingError
from bayes_iwan.sampling.proposals import learnt_moves
from bayes_iwan.threads import linear_algebra

BLOCK = 25  # steps between two commits
POPULATION = 256  # walkers that are led to the posterior, at least
_TOGETHER = 32  # walkers that advance together: calls of few rows cost more each
_LEARNT = 10_000  # draws that moves are learnt from at most
_AGAIN = 1.5  # times the draws before moves are learnt anew
_LOOKED_AT = 800  # steps at most that convergence is reckoned from, evenly thinned
FIRST_CHECK = 100
#: times the draws at which to look next, at least and at most: where they would be enough by those so far
_MORE = 1.15, 2.0


def sample(
    density: Density,
    starts: Array,
    roots: Array,
    plan: Plan,
    *,
    n_ensembles: int = 4,
    n_walkers: int = 16,
    executor: Executor | None = None,
) -> Chains:
    """Draw from a posterior until converged or the budget is used up.

    Parameters
    ----------
    density
        what is sampled, over coordinates z (ndim,).
    starts
        optima (members, ndim).
    roots
        (members, ndim, ndim), root @ root.T about the posterior's covariance at each, or one (ndim, ndim) for all.
    plan
        what is asked.
    n_walkers
        of each ensemble.
    executor
        from :func:`bayes_iwan.executors.opened`, for walkers in other processes as well; the density must be picklable
        then. The draws are the same.

    Raises
    ------
    SamplingError
        no usable start, or a density that is NaN, +∞ or of a wrong shape.
    CheckpointError
        a checkpoint that belongs to another run.
    """
    return EnsembleRun(density, np.asarray(starts, float), roots, plan, n_ensembles, n_walkers, executor).chains()


def draws_of_one_like_it(density: Density, known: Array, seed: tuple[int, ...]) -> Array:
    """z (POPULATION, ndim) of a posterior, from draws `known` (n, ndim) of one that is like it: walkers are led there
    from about these. Nobody asks whether they have converged.

    Raises SamplingError where none of the known draws is possible.
    """
    with linear_algebra().limit(limits=1):
        guess = guess_from(density, known, generator((*seed, 36)))
        *_, (_, at) = annealed(density, guess, POPULATION, (*seed, 35), _leading(None, seed), lambda: False)
    return density.whole(at.x, at.drawn)


def _leading(executor: Executor | None, seed: tuple[int, ...]) -> Advance:
    """How walkers are moved on their way."""

    def advance(at: Places, moves: Moves, steps: int, density: Density, stage: int) -> Places:
        return _advanced(Rounds(executor, (density, moves, steps)), at, (*seed, 33, stage)).last

    return advance


def _advanced(rounds: Rounds[Any], at: Places, seed: tuple[int, ...]) -> Places:
    """Where walkers have been in a block of steps from where they are (steps, n, …)."""
    pieces = [(at.some(slice(first, first + _TOGETHER)), (*seed, first)) for first in range(0, len(at.x), _TOGETHER)]
    ends = list(rounds.results(pieces, advanced))
    return Places(*(np.concatenate([getattr(e, f) for e, _ in ends], axis=1) for f in ("x", "drawn", "log_prob")))


class EnsembleRun:
    """All walkers, their moves, and what they have drawn."""

    def __init__(
        self, density: Density, starts: Array, roots: Array, plan: Plan, n_ensembles: int, n_walkers: int,
        executor: Executor | None,
    ) -> None:  # fmt: skip
        self.density, self.plan, self._executor = density, plan, executor
        if n_ensembles < 2:
            raise SamplingError(f"n_ensembles is {n_ensembles}; R-hat compares at least two")
        if starts.ndim != 2 or starts.shape[1] != density.ndim:
            raise SamplingError(f"starts have shape {starts.shape}; it must be (members, {density.ndim})")
        self.n_ensembles, self.walkers = n_ensembles, n_walkers
        self._guess = guess_about(density, starts, roots)
        self._began = time.monotonic()
        self.at: Places
        self._led: Array  # places (n, walked) that walkers were led to
        self._hurried = False  # there, since time was up
        #: of every block: z (steps, all walkers, ndim), ln p (steps, all walkers), further quantities
        self.z: list[Array] = []
        self.log_prob: list[Array] = []
        self.other: list[Array] = []
        self.learnt = 0  # blocks after which the moves were learnt; draws since then count
        self.look = FIRST_CHECK  # counted steps at which to look whether the run has converged
        self.seen = np.inf, 0.0  # autocorrelation time and least effective size when it was looked last

    @property
    def blocks(self) -> int:
        return len(self.z)

    @property
    def steps(self) -> int:
        """That count."""
        return BLOCK * (self.blocks - self.learnt)

    @property
    def late(self) -> bool:
        budget = self.plan.budget_s
        return budget is not None and time.monotonic() - self._began > budget

    def _learn(self) -> None:
        """Moves from what is known; they travel once to each process."""
        random = generator((self.plan.seed, 35, 2 + self.learnt))
        if self.learnt:
            known = np.concatenate(self.z[self.learnt // 2 : self.learnt]).reshape(-1, self.density.ndim)
            known = self.density.apart(known[random.permutation(len(known))[:_LEARNT]])
        else:
            known = self._led
        try:
            moves = learnt_moves(known, self.density.blocks, random)
        except np.linalg.LinAlgError as error:  # from draws that no run has drawn
            if self.plan.resumed is None:
                raise
            raise not_ours(self.plan.resumed, error) from None
        self._rounds = Rounds(self._executor, (self.density, moves, BLOCK))

    def block(self) -> None:
        """Some steps of all walkers."""
        out = _advanced(self._rounds, self.at, (self.plan.seed, 34, self.blocks))
        self.at = out.last
        self._keep(self.density.whole(out.x, out.drawn), out.log_prob)

    def _keep(self, z: Array, log_prob: Array) -> None:
        other = self.plan.evaluated(z)  # first: Ctrl-C may come here
        self.z.append(z)
        self.log_prob.append(log_prob)
        self.other.append(other)

    def _started(self, bar: tqdm) -> None:
        """Walkers are led to the posterior; some of them go on."""
        need = self.n_ensembles * self.walkers

        def late() -> bool:
            self._hurried = self._hurried or self.late
            return self._hurried

        bar.set_description("walkers on their way")
        advance, seed = _leading(self._executor, (self.plan.seed,)), (self.plan.seed, 35, 0)
        way = annealed(self.density, self._guess, max(need, POPULATION), seed, advance, late)
        for beta, at in way:
            self.at = at
            bar.set_postfix_str(f"{beta:.0%} there")
        self._led = self.at.x
        self.at = self.at.some(np.linspace(0, len(self._led) - 1, need).round().astype(int))

    def counted(self, blocks: list[Array]) -> Array:
        """(ensembles, steps, walkers, …) of the blocks that count."""
        width = blocks[0].shape[2:] if blocks else ()
        some = blocks[self.learnt :] if self.steps else []
        x = np.concatenate([np.empty((0, self.n_ensembles * self.walkers, *width)), *some])
        return np.moveaxis(x.reshape(len(x), self.n_ensembles, self.walkers, *width), 0, 1)

    def convergence(self) -> Convergence:
        """Of the draws that count and further quantities of them."""
        draws = np.concatenate([self.counted(self.z), self.counted(self.other)], axis=3)
        thin = -(-self.steps // _LOOKED_AT)
        return convergence_of(draws[:, ::thin], self.plan.every_name, thin, self.plan.by_r_hat)

    def chains(self) -> Chains:
        """The whole run."""
        plan = self.plan
        if plan.checkpoint is not None and plan.checkpoint.exists() and not plan.resume:
            raise CheckpointError(
                f"{plan.checkpoint}: a checkpoint exists already; resume it, delete it, or name another folder"
            )
        file: Checkpoint | None = None
        stop: Stop | None = None
        said, short, result = "", "no draws yet", None
        # sums of linear algebra keep their order: moves, so draws, are the same on any number of threads
        with tqdm(disable=plan.quiet, unit="step") as bar, linear_algebra().limit(limits=1):
            try:
                file = self._opened(bar)
                while stop is None:
                    again, late = self._again(), self.late
                    if self.steps >= 16 and (self.steps >= self.look or late or self.steps >= plan.max_steps):
                        result = self.convergence()
                        short, self.seen = plan.shortfall(result), (result.worst_tau, result.least_ess)
                        more = max(_MORE[0], plan.target_ess / result.least_ess)  # where that is NaN, the least
                        self.look = int(min(more, _MORE[1]) * self.steps)
                        bar.set_postfix_str(
                            f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                        )
                        stop, said = plan.ended(short, self.steps, late)
                    if stop is None:
                        if again and (self.steps == 0 or not self._near):
                            self.learnt, self.look = self.blocks, FIRST_CHECK
                            self._learn()
                        self.block()
                        if file is not None:
                            file.commit(self.z[-1], self.log_prob[-1], self.state())
                        bar.set_description("sampling")
                        bar.update(BLOCK)
            except KeyboardInterrupt:
                stop, said = Stop.INTERRUPTED, "interrupted" if self.steps else "interrupted before any draw counts"
            finally:
                if file is not None:
                    file.close()
        if stop is Stop.INTERRUPTED and self.steps >= 16:
            result = self.convergence()
            short = plan.shortfall(result)
        return Chains(
            draws=self.counted(self.z),
            log_prob=self.counted(self.log_prob),
            quantities=self.counted(self.other),
            n_steps=self.steps,
            convergence=result,
            converged=not short,
            message=said if not short else f"not converged: {said}; {short}",
            stop=stop,
            seed=plan.seed,
        )

    def _again(self) -> bool:
        """Are there so many more draws than the moves were learnt from?"""
        return self.blocks == max(1, self.learnt + 1, math.ceil(_AGAIN * self.learnt))

    @property
    def _near(self) -> bool:
        """Would as many draws again be enough? An effective size from fewer autocorrelation times than are asked for
        knows nothing of slower changes yet."""
        tau, ess = self.seen
        return not self.steps < self.plan.chain_taus * tau and 2.0 * ess >= self.plan.target_ess

    def _opened(self, bar: tqdm) -> Checkpoint | None:
        """The checkpoint, where there is one, and the walkers where it leaves them, else at their starts."""
        plan, walkers = self.plan, self.n_ensembles * self.walkers
        stamp = {**plan.fingerprint, "seed": str(plan.seed), "ensembles": str(self.n_ensembles)}
        if plan.resumed is not None:
            file, found = Checkpoint.resume(plan.resumed, stamp, plan.names)
            try:
                self._restored(found, plan.resumed)
                self._learn()
            except CheckpointError:
                file.close()
                raise
        else:
            self._started(bar)
            file = None
            if plan.checkpoint is not None and not self._hurried:  # else it would be another run that goes on
                file = Checkpoint.create(plan.checkpoint, stamp, plan.names, walkers, self.state())
            self._learn()
        return file

    def state(self) -> dict[str, NDArray[Any]]:
        """What the run goes on from."""
        own = {name: getattr(self.at, name) for name in ("x", "drawn", "log_prob")}
        numbers = {"learnt": self.learnt, "look": self.look, "seen": self.seen}
        return own | {"led": self._led} | {name: np.array(x) for name, x in numbers.items()}

    def _restored(self, found: Snapshot, path: Path) -> None:
        """Be as an earlier run was."""
        state: Mapping[str, NDArray[Any]] = found.state
        try:
            self.at = Places(*(np.asarray(state[name], float).copy() for name in ("x", "drawn", "log_prob")))
            self._led = np.asarray(state["led"], float)
            self.learnt, self.look = int(state["learnt"]), int(state["look"])
            self.seen = float(state["seen"][0]), float(state["seen"][1])
            n, d, z = len(self.at.x), len(self.density.walked), found.draws
            shapes = [self.at.x.shape, self.at.drawn.shape, self.at.log_prob.shape, z.shape[1:]]
            if shapes != [(n, d), (n, self.density.ndim - d), (n,), (n, self.density.ndim)]:
                raise ValueError(f"arrays of shapes {shapes}")
            if n != self.n_ensembles * self.walkers or len(z) % BLOCK:
                raise ValueError(f"{n} walkers, {len(z)} steps")
            if self._led.shape[1:] != (d,) or not 0 <= self.learnt * BLOCK <= len(z):
                raise ValueError(f"learnt after {self.learnt} blocks from {self._led.shape}")
            if not all(np.isfinite(some).all() for some in (self.at.x, self.at.drawn, self._led, z)):
                raise ValueError("numbers that are not finite")
        except (KeyError, ValueError, TypeError, IndexError, OverflowError) as error:
            raise not_ours(path, error) from None
        for first in range(0, len(z), BLOCK):
            self._keep(z[first : first + BLOCK], found.log_prob[first : first + BLOCK])
