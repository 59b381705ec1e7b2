"""Sampling a posterior with emcee until it has converged: one run, whatever the posterior.

A pilot brings the walkers to the posterior: they move by differences of draws that are known so far, first of the
normal approximation about the optima, then more and more of their own, and by independent proposals from a mixture that
is fitted to these. Then all is frozen, and only draws from then on count. No walker ever knows of another one that
production moves, so they are as many chains.

Walkers advance in blocks of steps, each with random numbers of its own that follow from the seed, so draws are the same
wherever a block is computed. Block by block they go into a checkpoint; a run that goes on from it draws the very same.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from emcee.moves import MHMove
from numpy.typing import NDArray
from tqdm import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Rounds
from bayes_iwan.sampling.blocks import Density, Moves, Places, advanced, generator
from bayes_iwan.sampling.chains import Chains, Stop
from bayes_iwan.sampling.checkpoint import Checkpoint, CheckpointError, Snapshot, not_ours
from bayes_iwan.sampling.convergence import Convergence, convergence_of
from bayes_iwan.sampling.plan import Plan, SamplingError
from bayes_iwan.sampling.proposals import Differences, Mixture, Snooker

STAGE = "production"
BLOCK = 25  # steps between two commits
_TOGETHER = 32  # walkers that advance together: calls of few rows cost more each
#: blocks of the pilot; after each the moves are learnt anew from the later half of all draws
_PILOT = 40
_COMPONENTS, _LEARNT = 4, 4000  # of the mixture, and the draws that moves know at most
_SCATTER = 0.7  # of the pilot's starts about an optimum, in posterior standard deviations
#: of steps that are independent proposals, along differences, and snooker's
_SHARES = 0.5, 0.3, 0.2
FIRST_CHECK = 100


def sample(
    density: Density,
    starts: Array,
    root: Array,
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
        optima (members, ndim), best first; walkers start about different ones.
    root
        lower triangular (ndim, ndim), root @ root.T about the posterior's covariance at the first.
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
    return EnsembleRun(density, np.asarray(starts, float), root, plan, n_ensembles, n_walkers, executor).chains()


class EnsembleRun:
    """All walkers, their moves, and how many blocks of steps they have taken."""

    def __init__(
        self, density: Density, starts: Array, root: Array, plan: Plan, n_ensembles: int, n_walkers: int,
        executor: Executor | None,
    ) -> None:  # fmt: skip
        self.density, self.plan, self._executor = density, plan, executor
        if n_ensembles < 2:
            raise SamplingError(f"n_ensembles is {n_ensembles}; R-hat compares at least two")
        if starts.ndim != 2 or starts.shape[1] != density.ndim:
            raise SamplingError(f"starts have shape {starts.shape}; it must be (members, {density.ndim})")
        self.n_ensembles, self.walkers = n_ensembles, n_walkers
        self._starts, self._root = starts[:, density.walked], root[density.walked]
        self.blocks = 0
        self._began = time.monotonic()

    @property
    def late(self) -> bool:
        budget = self.plan.budget_s
        return budget is not None and time.monotonic() - self._began > budget

    def _random(self, stream: int) -> np.random.RandomState:
        """Random numbers of the pilot."""
        return generator((self.plan.seed, 35, stream))

    def _learn(self, known: Array, stream: int) -> None:
        """Moves from draws (n, walked); they travel once to each process."""
        random = self._random(stream)
        self.known = known[random.permutation(len(known))[:_LEARNT]]
        self._use(Mixture.fitted(self.known, _COMPONENTS, random))

    def _use(self, mixture: Mixture) -> None:
        proposals = mixture, Differences(self.known), Snooker(self.known)
        self.mixture, moves = mixture, [(MHMove(p), share) for p, share in zip(proposals, _SHARES)]
        self._rounds = Rounds(self._executor, (self.density, moves, BLOCK))

    def block(self) -> Places:
        """Some steps of all walkers."""
        pieces = [
            (self.at.some(slice(first, first + _TOGETHER)), (self.plan.seed, 34, self.blocks, first))
            for first in range(0, len(self.at.x), _TOGETHER)
        ]
        ends = list(self._rounds.results(pieces, advanced))
        self.accepted = np.mean([accepted for _, accepted in ends])
        out = Places(*(np.concatenate([getattr(e, f) for e, _ in ends], axis=1) for f in ("x", "drawn", "log_prob")))
        self.at = Places(out.x[-1], out.drawn[-1], out.log_prob[-1])
        self.blocks += 1
        return out

    def pilot(self, bar: tqdm[object]) -> None:
        """Bring the walkers to the posterior and learn their moves."""
        self.at = self._started()
        recent = [self._scattered(_LEARNT, self._random(1))]
        for stage in range(_PILOT):
            self._learn(np.concatenate(recent[len(recent) // 2 :]), 2 + stage)
            recent.append(self.block().x.reshape(-1, self.at.x.shape[1]))
            bar.update(BLOCK)
        self._learn(np.concatenate(recent[len(recent) // 2 :]), 2 + _PILOT)

    def _scattered(self, n: int, random: np.random.RandomState, scatter: float = 1.0) -> Array:
        """(n, walked) about the starts, as the normal approximation at the first one is."""
        unit = random.standard_normal((n, self._root.shape[1]))
        return np.resize(self._starts, (n, self._starts.shape[1])) + scatter * (unit @ self._root.T)

    def _started(self) -> Places:
        """Walkers scattered about the starts."""
        random, need = self._random(0), self.n_ensembles * self.walkers
        levels = self.density(self._starts, random)[:, 0]
        if not np.isfinite(levels).any():
            raise SamplingError(
                f"none of the {len(levels)} starts has a finite log-probability: there is nowhere to start from; "
                "check the data, the bounds and the priors"
            )
        self._starts = self._starts[np.isfinite(levels)]
        x, left, scatter = np.zeros((need, self._starts.shape[1])), np.arange(need), _SCATTER
        out = Places(x, np.zeros((need, len(self.density.drawn))), np.full(need, -np.inf))
        while len(left):  # where a walker would start at an impossible place it starts nearer
            x[left] = self._scattered(need, random, scatter)[left]
            found = self.density(x[left], random)
            out.log_prob[left], out.drawn[left] = found[:, 0], found[:, 1:]
            left, scatter = left[~np.isfinite(found[:, 0])], 0.7 * scatter
        return out

    def by_ensemble(self, x: Array) -> Array:
        """(ensembles, steps, walkers, …) of (steps, all walkers, …)"""
        return np.moveaxis(x.reshape(len(x), self.n_ensembles, self.walkers, *x.shape[2:]), 0, 1)

    def convergence(self, z: Array, other: Array) -> Convergence:
        """Of draws (steps, all walkers, …) and further quantities of them."""
        draws = self.by_ensemble(np.concatenate([z, other], axis=2))
        return convergence_of(draws, self.plan.every_name, independent=True)

    def chains(self) -> Chains:
        """The whole run."""
        plan = self.plan
        if plan.checkpoint is not None and plan.checkpoint.exists() and not plan.resume:
            raise CheckpointError(
                f"{plan.checkpoint}: a checkpoint exists already; resume it, delete it, or name another folder"
            )
        stamp = {**plan.fingerprint, "seed": str(plan.seed), "ensembles": str(self.n_ensembles)}
        file: Checkpoint | None = None
        stop: Stop | None = None
        said, short, result = "", "no draws yet", None
        n = self.n_ensembles * self.walkers
        z, log_prob = np.empty((0, n, self.density.ndim)), np.empty((0, n))
        with tqdm(disable=plan.quiet, unit="step") as bar:
            try:
                if plan.resumed is not None:
                    file, found = Checkpoint.resume(plan.resumed, stamp, plan.names, (STAGE,))
                    self._restored(found, plan.resumed)
                    z, log_prob = found.draws[STAGE], found.log_prob[STAGE]
                else:
                    bar.set_description("pilot")
                    self.pilot(bar)
                    if plan.checkpoint is not None:
                        file = Checkpoint.create(plan.checkpoint, stamp, plan.names, {STAGE: n}, self.state())
                other = plan.evaluated(z)
                bar.set_description("sampling")
                next_check = FIRST_CHECK
                while next_check <= len(z) - BLOCK:  # where an uninterrupted run would have looked
                    next_check = int(1.15 * next_check)
                while stop is None:
                    steps = len(z)
                    planned, late = steps >= next_check, self.late
                    if steps >= 16 and (planned or late or steps >= plan.max_steps):
                        result = self.convergence(z, other)
                        short = plan.shortfall(result)
                        while next_check <= steps:
                            next_check = int(1.15 * next_check)
                        bar.set_postfix_str(
                            f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                        )
                        stop, said = plan.ended(short, steps, late)
                    if stop is None:
                        done = self.block()
                        new = self.density.whole(done.x, done.drawn)
                        if file is not None:
                            file.append(STAGE, new, done.log_prob)
                            file.commit(self.state())
                        z, log_prob = np.concatenate([z, new]), np.concatenate([log_prob, done.log_prob])
                        other = np.concatenate([other, plan.evaluated(new)])
                        bar.update(BLOCK)
            except KeyboardInterrupt:
                stop, said = Stop.INTERRUPTED, "interrupted" if len(z) else "interrupted before any draw counts"
            finally:
                if file is not None:
                    file.close()
        if stop is Stop.INTERRUPTED and len(z) >= 16:
            result = self.convergence(z, other)
            short = plan.shortfall(result)
        return Chains(
            names=plan.names,
            quantity_names=plan.quantity_names,
            draws=self.by_ensemble(z),
            log_prob=self.by_ensemble(log_prob),
            quantities=self.by_ensemble(plan.evaluated(z)),
            n_steps=len(z),
            convergence=result,
            converged=not short,
            message=said if not short else f"not converged: {said}; {short}",
            stop=stop,
            seed=plan.seed,
            seconds=time.monotonic() - self._began,
            independent=True,
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """What the run goes on from."""
        own = {name: getattr(self.at, name) for name in ("x", "drawn", "log_prob")}
        learnt = {name: getattr(self.mixture, name) for name in ("weights", "centres", "roots")}
        return own | learnt | {"known": self.known, "blocks": np.array(self.blocks)}

    def _restored(self, found: Snapshot, path: Path) -> None:
        """Be as an earlier run was."""
        state: Mapping[str, NDArray[Any]] = found.state
        try:
            self.at = Places(*(np.asarray(state[name], float).copy() for name in ("x", "drawn", "log_prob")))
            self.blocks, n = int(state["blocks"]), len(self.at.x)
            d, k = len(self.density.walked), len(state["weights"])
            shapes = [self.at.x.shape, self.at.drawn.shape, self.at.log_prob.shape, found.draws[STAGE].shape[1:]]
            shapes += [state["centres"].shape, state["roots"].shape]
            if shapes != [(n, d), (n, self.density.ndim - d), (n,), (n, self.density.ndim), (k, d), (k, d, d)]:
                raise ValueError(f"arrays of shapes {shapes}")
            if n != self.n_ensembles * self.walkers or not np.isfinite(self.at.x).all():
                raise ValueError(f"{n} walkers")
            self.known = np.asarray(state["known"], float).reshape(-1, d)
            self._use(Mixture(*(np.asarray(state[name], float) for name in ("weights", "centres", "roots"))))
        except (KeyError, ValueError, TypeError, IndexError, np.linalg.LinAlgError) as error:
            raise not_ours(path, error) from None
