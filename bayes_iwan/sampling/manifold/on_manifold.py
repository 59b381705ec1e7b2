"""Sampling a least-squares posterior that is a thin bent sheet, by chains that turn along it (see :mod:`.sheet`).

For what importance sampling does not fit: a chain sees the posterior from where it is, so the sheet may bend as much as
it likes between here and there. Where a few numbers do most of the bending, two steps of five are jumps: these numbers
are proposed whatever they were before, the others solved for (see :mod:`.nested`). A jump leads far, but leaves places
that are proposed too seldom as seldom; turns lead from there.

Chains start at all maxima that were found, those of an ensemble at others than the next one's. In a warm-up they learn
how far a step may turn, where the held numbers lie and where to jump to; then all is frozen, and only draws from then
on count. All walkers are independent of each other: ensembles are kept for R-hat alone, and a walker that never leaves
its branch is seen by the autocorrelation time, from which the ensemble's mean is taken off.

Some walkers go together, in one thread or process, with random numbers of their own for each block of steps, so that
the draws are the same wherever they go. Processes are faster: half the time goes into calls that only one thread can
make at a time. Block by block they go into a checkpoint; a run that goes on from it draws the
very same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm.auto import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Rounds
from bayes_iwan.sampling.common.chains import Chains, Stop
from bayes_iwan.sampling.common.checkpoint import Checkpoint
from bayes_iwan.sampling.common.convergence import convergence_of
from bayes_iwan.sampling.common.held import Held, HeldFunction
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.manifold.nested import Nested, bending, jumped
from bayes_iwan.sampling.manifold.sheet import Rows, Sheet, Walkers

#: what a checkpoint's fingerprint says of this way of sampling
METHOD = {"method": "manifold"}
_STAGE = "production"  # as ensembles name it, so that pages find the whole run
WALKERS = 16  # of each ensemble
_TOGETHER = 32  # walkers on one thread: fewer cost more each, for calls of few rows are dear
#: autocorrelation times that each walker takes at least; all of an ensemble together take as many as are asked
LEAST_TAUS = 10.0
_BLOCK = 25  # steps between two commits
_JUMPS = 10  # of a block's steps, where some numbers bend the sheet
#: blocks of a stage of the warm-up; stages without jumps, the first to find the way, and with them, each with what was
#: learnt in all but the first
_WARM_UP, _STAGES, _JUMPING = 2, 2, 3
_REFRESH = 5  # jumps before the held numbers are drawn anew
_LEAST_JUMPS = 0.02  # acceptance of jumps below which they are not worth their cost
_ACCEPTANCE, _HASTE = 0.38, 1.5  # what the angles are fitted to, and how fast
_LEAST, _MOST = 0.15, 1.1  # scale of the angles: below this the chains hardly move, above it draws are independent
_HELD_DRAWS = 64
_DEPTH = 12.0  # maxima so many nats below the best are no starts
FIRST_CHECK = 100


def taus_of_each(taus: float) -> float:
    """Autocorrelation times that a run of walkers that are independent takes, where `taus` are asked of an ensemble."""
    return min(taus, max(LEAST_TAUS, taus / WALKERS))


def sample_on_manifold(
    rows: Rows,
    held_log_prob: HeldFunction,
    optima: Array,
    optima_log_prob: Array,
    held: NDArray[np.int64],
    held_root: Array,
    plan: Plan,
    *,
    limit: float,
    n_ensembles: int = 4,
    executor: Executor | None = None,
) -> Chains | None:
    """Draw from a posterior until converged or the budget is used up; None where steps must be too short to lead
    anywhere.

    Parameters
    ----------
    rows : z (n, ndim) → (n, k), residuals that are whitened with z's own held numbers: −½|rows|² − ½|z|² is ln p but
        for what depends on the held numbers alone; the nearer, the better.
    held_log_prob : z (n, ndim), held numbers (n, count, held) → ln p (n, count) of z with these in place of its own.
    optima, optima_log_prob : maxima of ln p (k, ndim), best first, and ln p there (k,).
    held, held_root : the coordinates that scale the residuals (the noise's), and the lower triangular root of their
        covariance at the first maximum.
    plan : what is asked; its autocorrelation times are of the steps of all walkers of an ensemble, for these are
        independent here. A run ends after whole blocks of 25 steps. Where this way does not fit there is no checkpoint
        left.
    limit : z lies within ±limit.
    executor : from :func:`bayes_iwan.executors.opened`, for walkers in other processes as well; rows and held_log_prob
        must be picklable then.

    The same seed gives the same draws. Ctrl-C ends the run with the draws that are there.
    """
    began = time.monotonic()
    names, n = plan.names, n_ensembles * WALKERS
    taus = taus_of_each(plan.chain_taus)
    run = ManifoldRun.at(rows, held_log_prob, optima[0], held, held_root, limit, plan.seed, executor)
    stamp = {**METHOD, **plan.fingerprint, "seed": str(plan.seed), "ensembles": str(n_ensembles)}
    file: Checkpoint | None = None
    z, log_prob, other = np.empty((0, n, len(names))), np.empty((0, n)), np.empty((0, n, len(plan.quantity_names)))
    stop: Stop | None = None
    said, short, result, before = "", "no draws yet", None, 0

    def late() -> bool:
        return plan.budget_s is not None and time.monotonic() - began > plan.budget_s

    def by_ensemble(x: Array) -> Array:
        """(ensembles, steps, walkers, …) of (steps, all walkers, …)"""
        return np.moveaxis(x.reshape(len(x), n_ensembles, WALKERS, *x.shape[2:]), 0, 1)

    with tqdm(disable=plan.quiet, unit="step") as bar:
        try:
            if plan.resumed is not None:
                file, found = Checkpoint.resume(plan.resumed, stamp, names, (_STAGE,))
                run.restore(found.state)
                before = int(found.state["evaluations"])
                z, log_prob = found.draws[_STAGE], found.log_prob[_STAGE]
                other = plan.evaluated(z)
            else:
                bar.set_description("warm-up")
                near = optima[optima_log_prob > optima_log_prob[0] - _DEPTH]
                which = np.arange(n_ensembles)[:, None] + n_ensembles * np.arange(WALKERS)
                if not run.warm_up(near[which.ravel() % len(near)], late, bar):
                    return None
                if plan.checkpoint is not None:
                    file = Checkpoint.create(plan.checkpoint, stamp, names, {_STAGE: n}, run.state(before))
            bar.set_description("sampling")
            next_check = FIRST_CHECK
            while next_check <= len(z) - _BLOCK:  # where an uninterrupted run would have looked
                next_check = int(1.15 * next_check)
            while stop is None:
                steps = len(z)
                planned, over = steps >= next_check, late()
                if steps >= 8 and (planned or over or steps >= plan.max_steps):
                    result = convergence_of(
                        by_ensemble(np.concatenate([z, other], axis=2)), plan.every_name, independent=True
                    )
                    short = plan.shortfall(result, taus)
                    while next_check <= steps:
                        next_check = int(1.15 * next_check)
                    bar.set_postfix_str(
                        f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                    )
                    stop, said = plan.ended(short, steps, over)
                if stop is None:
                    fresh, level = run.block()
                    values = plan.evaluated(fresh)
                    if file is not None:
                        file.append(_STAGE, fresh, level)
                        file.commit(run.state(before))
                    z, log_prob, other = (
                        np.concatenate(pair) for pair in ((z, fresh), (log_prob, level), (other, values))
                    )
                    bar.update(len(fresh))
        except KeyboardInterrupt:
            stop, said = Stop.INTERRUPTED, "interrupted" if len(z) else "interrupted in warm-up, before any draw counts"
        finally:
            if file is not None:
                file.close()
    if stop is Stop.INTERRUPTED and len(z) >= 8:
        result = convergence_of(by_ensemble(np.concatenate([z, other], axis=2)), plan.every_name, independent=True)
        short = plan.shortfall(result, taus)
    if run.hurried:
        said += "; the time budget cut warm-up short, so that more time gives other draws"
    return Chains(
        names=names,
        quantity_names=plan.quantity_names,
        draws=by_ensemble(z),
        log_prob=by_ensemble(log_prob),
        quantities=by_ensemble(other),
        thin=1,
        n_steps=len(z),
        n_evaluations=before + run.n_evaluations,
        acceptance=float(np.mean(np.any(np.diff(z, axis=0) != 0.0, axis=2))) if len(z) > 1 else 0.0,
        convergence=result,
        converged=not short,
        message=said if not short else f"not converged: {said}; {short}",
        stop=stop,
        seed=plan.seed,
        seconds=time.monotonic() - began,
        independent=True,
    )


class ManifoldRun:
    """All walkers, the scale of their angles, where they jump to, and how many blocks of steps they have taken.

    hurried : was the warm-up cut short?
    """

    def __init__(self, sheet: Sheet, seed: int, executor: Executor | None = None) -> None:
        self.sheet, self.seed, self._executor = sheet, seed, executor
        self.walkers = Walkers(np.empty((0, 0)), np.empty(0), np.empty(0))
        self.nested: Nested | None = None
        self.scale, self.blocks, self.acceptance, self.jumps, self.hurried = 0.3, 0, 0.0, 0.0, False
        self._used = 0  # evaluations of blocks, and of jumps that were learnt anew since
        self._share()

    @classmethod
    def at(
        cls,
        rows: Rows,
        held_log_prob: HeldFunction,
        optimum: Array,
        held: NDArray[np.int64],
        held_root: Array,
        limit: float,
        seed: int,
        executor: Executor | None = None,
    ) -> ManifoldRun:
        """Before its warm-up, about an optimum (ndim,); the rest as for :func:`sample_on_manifold`."""
        known = Held(held, optimum[held], held_root, _HELD_DRAWS)
        return cls(Sheet(rows, held_log_prob, known, len(optimum), limit), seed, executor)

    @property
    def n_evaluations(self) -> int:
        return self.sheet.n_evaluations + self._used + (self.nested.n_evaluations if self.nested is not None else 0)

    def _share(self) -> None:
        """Have blocks taken with what is known now; it travels once to each process."""
        self._rounds = Rounds(self._executor, (self.sheet, self.nested))

    def warm_up(self, starts: Array, late: Callable[[], bool], bar: tqdm) -> bool:
        """From starts (n, ndim) to where draws count; False where steps must be too short to lead anywhere."""
        rng = np.random.default_rng([self.seed, 31])
        bent = bending(self.sheet, np.unique(starts, axis=0))
        self.walkers = self.sheet.begin(starts, rng)
        z: list[Array] = []
        for stage in range(_STAGES + _JUMPING if len(bent) else _STAGES):
            for _ in range(_WARM_UP):
                self.hurried |= late()
                if self.hurried:
                    break
                z.append(self.block()[0])
                self.scale = float(
                    np.clip(self.scale * np.exp(_HASTE * (self.acceptance - _ACCEPTANCE)), _LEAST, _MOST)
                )
                bar.update(_BLOCK)
            if z:
                z = z[-_WARM_UP // 2 :] if stage == 0 else z  # the first steps are on the way
                self._learn(np.concatenate(z), bent if stage > 0 else bent[:0], rng)
            self.walkers = self.sheet.begin(self.walkers.z, np.random.default_rng([self.seed, 32, stage]))
        return self.hurried or self.scale > _LEAST

    def _learn(self, z: Array, bent: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Take the held numbers' spread, and where to jump to, from draws (steps, n, ndim)."""
        flat = z.reshape(-1, z.shape[2])
        self.sheet.held = self.sheet.held.learnt(flat[:, self.sheet.held.columns])
        if self.nested is not None:
            self._used += self.nested.n_evaluations
            bent = bent if self.jumps > _LEAST_JUMPS else bent[:0]
        self.nested = Nested.fitted(self.sheet, bent, flat, rng) if len(bent) else None
        self._share()

    def block(self) -> tuple[Array, Array]:
        """Some steps of all: z (steps, n, ndim) and ln p (steps, n)."""
        parts = [slice(first, first + _TOGETHER) for first in range(0, len(self.walkers.z), _TOGETHER)]
        seed, all_of = (self.seed, 34, self.blocks), _arrays(self.walkers)
        pieces = [_Piece(Walkers(*(x[part] for x in all_of)), self.scale, (*seed, part.start)) for part in parts]
        ends = list(self._rounds.results(pieces, _advanced))
        self.walkers = Walkers(*(np.concatenate(x) for x in zip(*(_arrays(e.walkers) for e in ends))))
        self.acceptance, self.jumps = (float(np.mean(x)) for x in zip(*((e.accepted, e.jumped) for e in ends)))
        self._used += sum(e.n_evaluations for e in ends)
        self.blocks += 1
        return np.concatenate([e.z for e in ends], axis=1), np.concatenate([e.log_prob for e in ends], axis=1)

    def state(self, before: int) -> dict[str, NDArray]:
        """What the run goes on from; before : evaluations of the runs before."""
        return {
            "z": self.walkers.z,
            "log_prob": self.walkers.log_prob,
            "log_total": self.walkers.log_total,
            "centre": self.sheet.held.centre,
            "root": self.sheet.held.root,
            "scale": np.array(self.scale),
            "blocks": np.array(self.blocks),
            "hurried": np.array(self.hurried),
            "evaluations": np.array(before + self.n_evaluations),
            **({} if self.nested is None else self.nested.state()),
        }

    def restore(self, state: Mapping[str, NDArray]) -> None:
        """Be as an earlier run was."""
        self.walkers = Walkers(*(state[name].copy() for name in ("z", "log_prob", "log_total")))
        held = self.sheet.held
        self.sheet.held = Held(held.columns, state["centre"], state["root"], held.count)
        self.scale, self.blocks, self.hurried = float(state["scale"]), int(state["blocks"]), bool(state["hurried"])
        self.nested = Nested.restored(self.sheet, state) if "bent" in state else None
        self._share()


@dataclass(frozen=True)
class _Piece:
    """Walkers that go together, the scale of their angles, and the seed of their random numbers in this block."""

    walkers: Walkers
    scale: float
    seed: tuple[int, ...]


@dataclass(frozen=True)
class _Advanced:
    """Where they were after each step of a block, z (steps, n, ndim) and ln p (steps, n), and are in the end; shares of
    steps and jumps that were accepted, and evaluations."""

    z: Array
    log_prob: Array
    walkers: Walkers
    accepted: float
    jumped: float
    n_evaluations: int


def _advanced(known: tuple[Sheet, Nested | None], piece: _Piece) -> _Advanced:
    """A block of steps."""
    sheet, own = known[0].counting(), Walkers(*(x.copy() for x in _arrays(piece.walkers)))
    rng = np.random.default_rng(piece.seed)
    if known[1] is None:
        z, log_prob, went = sheet.advance(own, _BLOCK, piece.scale, rng)
        return _Advanced(z, log_prob, own, went, 0.0, sheet.n_evaluations)
    nested = known[1].counting()
    z, log_prob, went = sheet.advance(own, _BLOCK - _JUMPS, piece.scale, rng)
    jumps, levels, gone = jump(sheet, nested, own, _JUMPS, rng)
    used = sheet.n_evaluations + nested.n_evaluations
    return _Advanced(np.concatenate([z, jumps]), np.concatenate([log_prob, levels]), own, went, gone, used)


def _arrays(walkers: Walkers) -> tuple[Array, Array, Array]:
    return walkers.z, walkers.log_prob, walkers.log_total


def jump(
    sheet: Sheet, nested: Nested, walkers: Walkers, steps: int, rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Offer independent proposals to all walkers: where they are after each, z (steps, n, ndim) and ln p (steps, n),
    and the share that was accepted."""
    n = len(walkers.z)
    new = nested.propose(steps * n, rng)
    log_chance = np.log(rng.random((steps, n)))
    with np.errstate(invalid="ignore"):  # of places that were not found
        log_density = new.log_total - new.log_weight
    own = walkers.log_total - nested.log_weight(walkers.z, walkers.log_total)
    z, log_prob, went = np.empty((steps, *walkers.z.shape)), np.empty((steps, n)), 0.0
    for first in range(0, steps, _REFRESH):
        sheet.refresh(walkers, rng)
        part = slice(first, min(first + _REFRESH, steps))
        offered = np.arange(part.start * n, part.stop * n)
        taken = jumped(walkers.log_total - own, new.log_weight[offered].reshape(-1, n), log_chance[part])
        went += float(np.sum(np.diff(taken, axis=0, prepend=-1) != 0)) / (steps * n)
        which, stays = offered[0] + taken * n + np.arange(n), taken < 0
        z[part] = np.where(stays[:, :, None], walkers.z, new.z[which])
        log_prob[part] = np.where(stays, walkers.log_prob, new.log_prob[which])
        walkers.z, walkers.log_prob = z[part][-1].copy(), log_prob[part][-1].copy()
        walkers.log_total = np.where(stays[-1], walkers.log_total, new.log_total[which[-1]])
        own = np.where(stays[-1], own, log_density[which[-1]])
    return z, log_prob, went
