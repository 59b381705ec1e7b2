"""Sampling a posterior with emcee until it has converged: one run, whatever the moves.

A pilot brings the walkers to the posterior, fits the moves to it and chooses their mixture; then all is frozen, and
only draws from then on count. Where the posterior is a sum of squares, walkers take steps along its manifold and, where
it curves along a few parameters only, independent proposals between; these walkers never know of one another. Where
such steps lead nowhere (a simulator with jumps), walkers move by differential evolution and snooker moves, and the
first half of their steps does not count.

Walkers advance in blocks of steps, each with random numbers of its own that follow from the seed, so draws are the same
wherever a block is computed. Block by block they go into a checkpoint; a run that goes on from it draws the very same.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from emcee.moves import Move, StretchMove
from numpy.typing import NDArray
from tqdm import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Rounds
from bayes_iwan.sampling.blocks import Advanced, Checked, Piece, Schedule, advanced, generator
from bayes_iwan.sampling.chains import Chains, Stop
from bayes_iwan.sampling.checkpoint import Checkpoint, CheckpointError, Snapshot, not_ours
from bayes_iwan.sampling.convergence import Convergence, convergence_of
from bayes_iwan.sampling.moves.differential import DifferentialMove
from bayes_iwan.sampling.moves.manifold import LEAST, ManifoldMove
from bayes_iwan.sampling.moves.metropolis import LeastSquares
from bayes_iwan.sampling.moves.nested import KNOWN, NestedMove, curving_parameters
from bayes_iwan.sampling.moves.snooker import SnookerMove
from bayes_iwan.sampling.plan import BatchFunction, Plan, SamplingError

STAGE = "production"
WALKERS = 16  # of each ensemble whose walkers are independent of each other
_TOGETHER = 32  # of these that advance together: calls of few rows cost more each
BLOCK = 25  # steps between two commits
_JUMPS = 10  # of these, independent proposals, where there are any
#: blocks of a stage of the pilot; stages without and with independent proposals
_WARM_UP, _STAGES, _JUMPING = 2, 2, 3
_LEAST_JUMPS = 0.01  # acceptance below which independent proposals do not pay
#: autocorrelation times that each independent walker takes at least
LEAST_TAUS = 10.0
FIRST_CHECK = 100


def sample(
    log_prob: BatchFunction,
    target: LeastSquares,
    starts: Array,
    plan: Plan,
    *,
    n_ensembles: int = 4,
    n_walkers: int = 40,
    executor: Executor | None = None,
) -> Chains:
    """Draw from a posterior until converged or the budget is used up.

    Parameters
    ----------
    log_prob
        ln p at z (n, ndim), (n,); −∞ where impossible.
    target
        the same as a sum of squares.
    starts
        where walkers start (members, ndim), best first; ensembles start at different ones.
    plan
        what is asked.
    n_walkers
        of each ensemble, where walkers move by each other; at least twice ndim and two.
    executor
        from :func:`bayes_iwan.executors.opened`, for walkers in other processes as well; log_prob and target must be
        picklable then. The draws are the same.

    Raises
    ------
    SamplingError
        no usable start, or log_prob returns NaN, +∞ or a wrong shape.
    CheckpointError
        a checkpoint that belongs to another run.
    """
    return EnsembleRun(log_prob, target, np.asarray(starts, float), plan, n_ensembles, n_walkers, executor).chains()


def taus_of_each(taus: float) -> float:
    """Autocorrelation times that walkers take which are independent of each other, where `taus` are asked of an
    ensemble."""
    return min(taus, max(LEAST_TAUS, taus / WALKERS))


class EnsembleRun:
    """All walkers, the schedule of their moves, and how many blocks of steps they have taken."""

    def __init__(
        self,
        log_prob: BatchFunction,
        target: LeastSquares,
        starts: Array,
        plan: Plan,
        n_ensembles: int,
        n_walkers: int,
        executor: Executor | None,
    ) -> None:
        self.log_prob_of = Checked(log_prob)
        self.target, self.plan, self._executor = target, plan, executor
        self.n_ensembles, self.n_walkers = n_ensembles, max(n_walkers, 2 * target.ndim + 2)
        if n_ensembles < 2:
            raise SamplingError(f"n_ensembles is {n_ensembles}; R-hat compares at least two")
        if starts.ndim != 2 or starts.shape[1] != target.ndim:
            raise SamplingError(f"starts have shape {starts.shape}; it must be (members, {target.ndim})")
        levels = self.log_prob_of(starts)
        if not np.isfinite(levels).any():
            raise SamplingError(
                f"none of the {len(starts)} starts has a finite log-probability: there is nowhere to start from; "
                "check the data, the bounds and the priors"
            )
        self._starts = starts[np.isfinite(levels)]
        self.blocks, self.independent = 0, True
        self.schedule: Schedule = ()
        self._began = time.monotonic()

    @property
    def walkers(self) -> int:
        """Of an ensemble."""
        return WALKERS if self.independent else self.n_walkers

    @property
    def late(self) -> bool:
        budget = self.plan.budget_s
        return budget is not None and time.monotonic() - self._began > budget

    def _random(self, stream: int) -> np.random.RandomState:
        """Random numbers of the pilot."""
        return generator((self.plan.seed, 35, stream))

    def _use(self, *entries: tuple[Sequence[tuple[Move, float]], int]) -> None:
        """Have blocks taken by these moves; they travel once to each process."""
        self.schedule = entries
        self._rounds = Rounds(self._executor, (self.log_prob_of, self.schedule))

    def _place(self, z: Array) -> None:
        self.z, self.log_prob = z, self.log_prob_of(z)

    def block(self) -> Advanced:
        """Some steps of all walkers."""
        n = len(self.z)
        size = _TOGETHER if self.independent else self.walkers
        parts = [slice(first, min(first + size, n)) for first in range(0, n, size)]
        seed = (self.plan.seed, 34, self.blocks)
        pieces = [Piece(self.z[part], self.log_prob[part], (*seed, part.start)) for part in parts]
        ends = list(self._rounds.results(pieces, advanced))
        out = Advanced(
            np.concatenate([e.z for e in ends], axis=1),
            np.concatenate([e.log_prob for e in ends], axis=1),
            tuple(np.mean([e.accepted for e in ends], axis=0)),
        )
        self.z, self.log_prob = out.z[-1], out.log_prob[-1]
        self.blocks += 1
        return out

    def pilot(self, bar: tqdm[object]) -> None:
        """Bring the walkers to the posterior and choose their moves."""
        which = np.arange(self.n_ensembles)[:, None] + self.n_ensembles * np.arange(WALKERS)
        self._place(self._starts[which.ravel() % len(self._starts)])
        self.z = self.target.integrated(self.z, self._random(1)).z
        self.log_prob = self.log_prob_of(self.z)
        manifold = ManifoldMove(self.target)
        jumps: NestedMove | None = None
        curving = curving_parameters(self.target, np.unique(self._starts[: len(self.z)], axis=0))
        recent: list[Array] = []
        for stage in range(_STAGES + (_JUMPING if len(curving) else 0)):
            if stage >= _STAGES:
                jumps = self._nested(curving, np.concatenate(recent))
            recent = recent[-1:] if stage == 1 else recent  # the first steps are on the way
            for _ in range(_WARM_UP):
                self._use(*_entries(manifold, jumps))
                done = self.block()
                recent.append(done.z.reshape(-1, self.target.ndim))
                manifold = manifold.adapted(done.accepted[0], self.target)
                bar.update(len(done.z))
            self.target = self.target.fitted(np.concatenate(recent[-_WARM_UP:]))
        if jumps is not None and done.accepted[1] < _LEAST_JUMPS:
            jumps = None
        if manifold.scale > LEAST:
            self._use(*_entries(ManifoldMove(self.target, manifold.scale), jumps))
            return
        self.independent = False
        self._disperse(np.concatenate(recent))
        self._use(_BY_EACH_OTHER)

    def _nested(self, curving: NDArray[np.int64], z: Array) -> NestedMove:
        """Independent proposals learnt from draws (n, ndim) of the pilot."""
        return NestedMove(self.target, curving, z[self._random(4).permutation(len(z))[:KNOWN]])

    def _disperse(self, z: Array) -> None:
        """Put walkers that move by each other at different places among these (n, ndim) and the starts."""
        random, need = self._random(3), self.n_ensembles * self.n_walkers
        some = np.unique(np.concatenate([self._starts, z]), axis=0)
        chosen = some[random.choice(len(some), size=need, replace=len(some) < need)]
        near = chosen + 0.02 * random.standard_normal(chosen.shape)
        level = self.log_prob_of(near)
        self._place(np.where(np.isfinite(level)[:, None], near, chosen))

    def by_ensemble(self, x: Array) -> Array:
        """(ensembles, steps, walkers, …) of (steps, all walkers, …)"""
        return np.moveaxis(x.reshape(len(x), self.n_ensembles, self.walkers, *x.shape[2:]), 0, 1)

    def convergence(self, z: Array, other: Array) -> Convergence:
        """Of draws (steps, all walkers, …) and further quantities of them."""
        draws = self.by_ensemble(np.concatenate([z, other], axis=2))
        return convergence_of(draws, self.plan.every_name, independent=self.independent)

    def counted(self, x: Array) -> Array:
        """The steps of x (steps, …) that count."""
        return x if self.independent else x[len(x) // 2 :]

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
        taus = taus_of_each(plan.chain_taus) if self.independent else plan.chain_taus
        z = log_prob = other = np.empty((0, 0, 0))
        with tqdm(disable=plan.quiet, unit="step") as bar:
            try:
                if plan.resumed is not None:
                    file, found = Checkpoint.resume(plan.resumed, stamp, plan.names, (STAGE,))
                    self._restored(found, plan.resumed)
                    z, log_prob = found.draws[STAGE], found.log_prob[STAGE]
                    other = plan.evaluated(z)
                else:
                    bar.set_description("pilot")
                    self.pilot(bar)
                    n = len(self.z)
                    z, log_prob = np.empty((0, n, self.target.ndim)), np.empty((0, n))
                    other = np.empty((0, n, len(plan.quantity_names)))
                    if plan.checkpoint is not None:
                        file = Checkpoint.create(plan.checkpoint, stamp, plan.names, {STAGE: n}, self.state())
                bar.set_description("sampling")
                next_check = FIRST_CHECK
                while next_check <= len(z) - BLOCK:  # where an uninterrupted run would have looked
                    next_check = int(1.15 * next_check)
                while stop is None:
                    steps = len(z)
                    planned, late = steps >= next_check, self.late
                    if steps >= 16 and (planned or late or steps >= plan.max_steps):
                        result = self.convergence(self.counted(z), self.counted(other))
                        short = plan.shortfall(result, taus)
                        while next_check <= steps:
                            next_check = int(1.15 * next_check)
                        bar.set_postfix_str(
                            f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                        )
                        stop, said = plan.ended(short, steps, late)
                    if stop is None:
                        done = self.block()
                        if file is not None:
                            file.append(STAGE, done.z, done.log_prob)
                            file.commit(self.state())
                        z, log_prob = np.concatenate([z, done.z]), np.concatenate([log_prob, done.log_prob])
                        other = np.concatenate([other, plan.evaluated(done.z)])
                        bar.update(len(done.z))
            except KeyboardInterrupt:
                stop, said = Stop.INTERRUPTED, "interrupted" if len(z) else "interrupted before any draw counts"
            finally:
                if file is not None:
                    file.close()
        steps = len(z)
        z, log_prob, other = self.counted(z), self.counted(log_prob), self.counted(other)
        if stop is Stop.INTERRUPTED and len(z) >= 8:
            result = self.convergence(z, other)
            short = plan.shortfall(result, taus)
        return Chains(
            names=plan.names,
            quantity_names=plan.quantity_names,
            draws=self.by_ensemble(z),
            log_prob=self.by_ensemble(log_prob),
            quantities=self.by_ensemble(other),
            n_steps=steps,
            convergence=result,
            converged=not short,
            message=said if not short else f"not converged: {said}; {short}",
            stop=stop,
            seed=plan.seed,
            seconds=time.monotonic() - self._began,
            independent=self.independent,
        )

    def state(self) -> dict[str, NDArray[Any]]:
        """What the run goes on from."""
        nuisance = self.target.nuisance
        out: dict[str, NDArray[Any]] = {
            "z": self.z, "log_prob": self.log_prob, "blocks": np.array(self.blocks), "centre": nuisance.centre,
            "root": nuisance.root, "independent": np.array(self.independent),
        }  # fmt: skip
        for moves, _ in self.schedule:
            move = moves[0][0]
            if isinstance(move, ManifoldMove):
                out["scale"] = np.array(move.scale)
            if isinstance(move, NestedMove):
                own = move.target.nuisance
                out |= {"curving": move.curving, "known": move.known, "own_centre": own.centre, "own_root": own.root}
        return out

    def _restored(self, found: Snapshot, path: Path) -> None:
        """Be as the run was that wrote a checkpoint. Raises CheckpointError where its state makes no sense."""
        try:
            self.restore(found.state)
            if self.z.shape != found.draws[STAGE].shape[1:] or not np.isfinite(self.z).all():
                raise ValueError(f"walkers of shape {self.z.shape}")
        except (KeyError, ValueError, TypeError, IndexError, np.linalg.LinAlgError) as error:
            raise not_ours(path, error) from None

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Be as an earlier run was."""
        self.z, self.log_prob, self.blocks = state["z"].copy(), state["log_prob"].copy(), int(state["blocks"])
        self.independent = bool(state["independent"])
        self.target = self.target.with_nuisance(state["centre"], state["root"])
        if self.independent:
            manifold = ManifoldMove(self.target, float(state["scale"]))
            jumps = None
            if "curving" in state:
                own = self.target.with_nuisance(state["own_centre"], state["own_root"])
                jumps = NestedMove(own, state["curving"], state["known"])
            self._use(*_entries(manifold, jumps))
        else:
            self._use(_BY_EACH_OTHER)


#: walkers that move by each other
_BY_EACH_OTHER: tuple[Sequence[tuple[Move, float]], int] = (
    [(DifferentialMove(), 0.7), (SnookerMove(), 0.2), (StretchMove(), 0.1)],
    BLOCK,
)


def _entries(manifold: ManifoldMove, jumps: NestedMove | None) -> list[tuple[Sequence[tuple[Move, float]], int]]:
    """The schedule of a block."""
    if jumps is None:
        return [([(manifold, 1.0)], BLOCK)]
    return [([(manifold, 1.0)], BLOCK - _JUMPS), ([(jumps, 1.0)], _JUMPS)]
