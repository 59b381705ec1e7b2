"""Sampling a least-squares posterior by importance: draws are solved for one by one, none is a step from the last.

Proposals come from residual maps (see :mod:`.residual_map`), one for each branch of the posterior, and are weighed by
the ratio of posterior to proposal density (see :mod:`.branches`). A pilot says where the proposals should lie; then
they are frozen, there is no burn-in, and a proposal costs what it costs, some 30 evaluations where the maps fit; one in
three is then worth an independent draw.

Several chains, each with proposals of its own, take the place of the ensembles. A chain is its proposals in the order
in which they came, each as often as its weight says (systematic resampling), so a heavy one is a chain that stands
still, and R-hat, effective sizes and autocorrelation times mean what they always do.

Effective sizes know only of the weights that came: converged are draws whose weights' tail is short, too (Pareto's k,
see :mod:`.weights`), and whose proposals lead wherever the posterior is (see :mod:`.reach`).

It is tried first and given up where it does not fit: where too few draws of a pilot carry the weight, or of those after
it, however long it has gone on, where they miss the optimum, or where proposals do not lead everywhere. Then it is
tried once more with spare branches, whose maps fold elsewhere, and given up for good (None) if they do not serve
either.

Block by block the proposals go into a checkpoint; a run that goes on from it draws the very same, for the random
numbers of a block follow from the seed and the block's number.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm.auto import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.chains import Chains, Stop
from bayes_iwan.sampling.common.checkpoint import Checkpoint, read_checkpoint
from bayes_iwan.sampling.common.convergence import convergence_of
from bayes_iwan.sampling.common.held import HeldFunction
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.independent.branches import Optimum
from bayes_iwan.sampling.independent.reach import unreached
from bayes_iwan.sampling.independent.residual_map import Residuals
from bayes_iwan.sampling.independent.source import Source
from bayes_iwan.sampling.independent.weights import untrusted

#: what a checkpoint's fingerprint says of this way of sampling
METHOD = {"method": "independent"}
_STAGE = "proposals"
_BATCH = 128  # proposals of a chain that are solved for together
_FIRST_CHECK = 256
_MOST_UNREACHED = 0.05  # share of walks from draws that may end where no proposal leads
#: attempts: branches that are kept although they are within others, for the folds of these, which cost each proposal
#: another solution
_ATTEMPTS = (0, 2)
#: from so many steps on, a proposal must be worth so much of an independent draw: below that, chains along the manifold
#: cost less, which take 2,000 to 4,000 evaluations a draw where a proposal takes some 80 to 120
_PATIENCE, _LEAST_WORTH = 768, 0.025


def sample_independently(
    residuals: Residuals,
    held_log_prob: HeldFunction,
    optima: Sequence[Optimum],
    held: NDArray[np.int64],
    plan: Plan,
    *,
    limit: float,
    n_chains: int = 4,
) -> Chains | None:
    """Draw from a posterior until converged or the budget is used up; None where this way does not fit.

    Parameters
    ----------
    residuals : z (n, ndim) → r (n, k). With W of the optimum −½|r W|² − ½|z|² is ln p but for what depends on the held
        numbers alone; the nearer, the better.
    held_log_prob : z (n, ndim), held numbers (n, count, held) → ln p (n, count) of z with these in place of its own.
    optima : maxima of ln p, best first. held : the coordinates that scale the residuals (the noise's).
    plan : what is asked; a chain is an ensemble of one walker. Where this way does not fit there is no checkpoint left.
    limit : z lies within ±limit.

    The same seed gives the same draws. Ctrl-C ends the run with the draws that are there.
    """
    began = time.monotonic()
    for attempt in range(0 if plan.resumed is None else _attempt_of(plan.resumed), len(_ATTEMPTS)):
        source = Source.of(residuals, held_log_prob, optima, held, limit)
        left = None if plan.budget_s is None else max(plan.budget_s - (time.monotonic() - began), 0.0)
        chains = _attempt(source, attempt, replace(plan, budget_s=left), n_chains)
        if chains is not None:
            return replace(chains, seconds=time.monotonic() - began)
    return None


def _attempt(source: Source, attempt: int, plan: Plan, n_chains: int) -> Chains | None:
    """One of _ATTEMPTS at :func:`sample_independently`; None where it does not fit."""
    began = time.monotonic()
    names, seed = plan.names, plan.seed
    offsets = np.random.default_rng([seed, 23]).random(n_chains)
    chains = [_Chain(float(x), len(names), len(plan.quantity_names)) for x in offsets]
    stamp = {**METHOD, **plan.fingerprint, "seed": str(seed), "chains": str(n_chains)}
    store = _Store(plan.checkpoint, stamp, names)

    def add(fresh: Sequence[Array]) -> None:
        """Proposals of all chains, one chain's after the other's."""
        named = plan.evaluated(fresh[0])
        for chain, *new in zip(chains, *(np.split(x, n_chains) for x in (*fresh, named))):
            chain.append(*new)

    if plan.resumed is not None:
        for block in store.resume(source):
            add(block)
    elif source.pilot(seed, _ATTEMPTS[attempt]):
        store.create(source, n_chains, attempt)
    else:
        return None
    blocks = -(-chains[0].length // _BATCH)
    next_check = _FIRST_CHECK
    for steps in range(_BATCH, chains[0].length, _BATCH):  # where an uninterrupted run would have looked
        next_check = int(1.15 * steps) if steps >= next_check else next_check
    stop: Stop | None = None
    said, short, result = "", "no draws yet", None
    with tqdm(disable=plan.quiet, unit="step") as bar:
        bar.set_description("sampling")
        try:
            while stop is None:
                steps = chains[0].length
                late = plan.budget_s is not None and time.monotonic() - began > plan.budget_s
                planned = steps >= next_check
                if steps >= 8 and (planned or late or steps >= plan.max_steps):
                    together = np.stack([chain.resampled()[1] for chain in chains])
                    result = convergence_of(together[:, :, None], plan.every_name)
                    short = plan.shortfall(result)
                    poor = steps >= _PATIENCE and result.least_ess < _LEAST_WORTH * n_chains * steps
                    if not short:
                        every = np.concatenate([chain.log_weight for chain in chains])
                        short = untrusted(every)
                        poor |= bool(short) and steps >= 2 * _PATIENCE  # more draws hardly mend a tail
                    next_check = int(1.15 * steps) if planned else next_check
                    bar.set_postfix_str(f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}")
                    if not short:
                        places = np.concatenate([chain.values[:, : len(names)] for chain in chains])
                        if unreached(source, places, every, seed) > _MOST_UNREACHED:
                            store.remove()
                            return None
                    elif planned and poor:
                        store.remove()
                        return None
                    stop, said = plan.ended(short, steps, late)
                if stop is None:
                    count = min(_BATCH, max(plan.max_steps, 8) - steps)
                    fresh = source.draw(n_chains * count, np.random.default_rng([seed, 25, blocks]))
                    store.append(fresh, n_chains, source)
                    add(fresh)
                    blocks += 1
                    bar.update(count)
        except KeyboardInterrupt:
            stop, said = Stop.INTERRUPTED, "interrupted"
        finally:
            store.close()
    kept = [chain.resampled() for chain in chains]
    draws, levels = np.stack([x for _, x in kept]), np.stack([chain.log_prob[i] for chain, (i, _) in zip(chains, kept)])
    if stop is Stop.INTERRUPTED and draws.shape[1] >= 8:
        result = convergence_of(draws[:, :, None], plan.every_name)
        short = plan.shortfall(result)
    different = [len(np.unique(i)) / max(1, len(i)) for i, _ in kept]
    return Chains(
        names=names,
        quantity_names=plan.quantity_names,
        draws=draws[:, :, None, : len(names)],
        log_prob=levels[:, :, None],
        quantities=draws[:, :, None, len(names) :],
        thin=1,
        n_steps=draws.shape[1],
        n_evaluations=store.evaluations + source.evaluations,
        acceptance=float(np.mean(different)),
        convergence=result,
        converged=not short,
        message=said if not short else f"not converged: {said}; {short}",
        stop=stop,
        seed=seed,
        seconds=time.monotonic() - began,
    )


class _Store:
    """The checkpoint, if there is one: what the pilot found, and the proposals of each block.

    A proposal's row holds its numbers and the logarithm of its weight. evaluations : those of the runs before.
    """

    def __init__(self, path: Path | None, fingerprint: Mapping[str, str], names: tuple[str, ...]) -> None:
        self.path, self.fingerprint, self.names = path, fingerprint, (*names, "log_weight")
        self.evaluations = 0
        self._file: Checkpoint | None = None
        self._attempt: NDArray = np.array(0)

    def create(self, source: Source, n_chains: int, attempt: int) -> None:
        self._attempt = np.array(attempt)
        if self.path is not None:
            state = self._state(source)
            self._file = Checkpoint.create(self.path, self.fingerprint, self.names, {_STAGE: n_chains}, state)

    def resume(self, source: Source) -> Iterator[tuple[Array, Array, Array]]:
        """z, log_prob and log weight of each block of an earlier run, whose pilot the source takes over."""
        assert self.path is not None
        self._file, found = Checkpoint.resume(self.path, self.fingerprint, self.names, (_STAGE,))
        source.restore(found.state)
        self.evaluations, self._attempt = int(found.state["evaluations"]), found.state["attempt"]
        draws, log_prob = found.draws[_STAGE], found.log_prob[_STAGE]
        for first in range(0, len(draws), _BATCH):
            rows = np.concatenate(np.moveaxis(draws[first : first + _BATCH], 1, 0))
            yield rows[:, :-1], np.concatenate(log_prob[first : first + _BATCH].T), rows[:, -1]

    def append(self, fresh: tuple[Array, Array, Array], n_chains: int, source: Source) -> None:
        if self._file is None:
            return
        z, log_prob, log_weight = fresh
        rows = np.concatenate([z, log_weight[:, None]], axis=1)
        by_step = np.moveaxis(rows.reshape(n_chains, -1, rows.shape[1]), 0, 1)
        self._file.append(_STAGE, by_step, log_prob.reshape(n_chains, -1).T)
        self._file.commit(self._state(source))

    def _state(self, source: Source) -> dict[str, NDArray]:
        more = {"evaluations": np.array(self.evaluations + source.evaluations), "attempt": self._attempt}
        return {**source.state(), **more}

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def remove(self) -> None:
        self.close()
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def _attempt_of(checkpoint: Path) -> int:
    """The attempt that wrote a checkpoint; 0 for what is no checkpoint of ours, which resuming from it will say."""
    state = read_checkpoint(checkpoint, ())[2].state
    return int(state.get("attempt", 0))


class _Chain:
    """Proposals in their order: numbers and quantities (n, …), log_prob and log weight (n,); offset : of resampling."""

    def __init__(self, offset: float, ndim: int, others: int) -> None:
        self.offset = offset
        self.values, self.log_prob, self.log_weight = np.empty((0, ndim + others)), np.empty(0), np.empty(0)

    @property
    def length(self) -> int:
        return len(self.log_prob)

    def append(self, z: Array, log_prob: Array, log_weight: Array, others: Array) -> None:
        self.values = np.concatenate([self.values, np.concatenate([z, others], axis=1)])
        self.log_prob = np.concatenate([self.log_prob, log_prob])
        self.log_weight = np.concatenate([self.log_weight, log_weight])

    def resampled(self) -> tuple[NDArray[np.int64], Array]:
        """Which proposals (n,), each as often as its weight says, in their order, and their values (n, …); none as
        long as none has any weight."""
        top = self.log_weight.max(initial=-np.inf)
        if not np.isfinite(top):
            return np.empty(0, np.int64), self.values[:0]
        share = np.cumsum(np.exp(self.log_weight - top))
        at = (np.arange(self.length) + self.offset) / self.length * share[-1]
        which = np.searchsorted(share, at).astype(np.int64)
        return which, self.values[which]
