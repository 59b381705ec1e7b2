"""Sampling a posterior with emcee: several independent ensembles, advanced in one batch call each half-step.

Three phases. *Warm-up* (differential evolution, snooker and stretch moves) brings the walkers from wherever they
started towards the posterior. *Adaptation* fits a proposal (straightening maps and t distributions, see proposal.py)
to the latest draws, runs with it, and fits again, until the walkers drift no more and the proposals get no better
(see run.py). Then the proposal is frozen and *production* starts: its draws are the only ones that count, and the
run ends by itself when they meet the targets.

The proposal is fitted to the draws of all ensembles together. That does not spoil R-hat: once frozen it is a fixed
distribution, and the ensembles are independent chains given it, each going on from where its own warm-up left it.
Pooling lets an ensemble that is stuck in a lesser mode leave it; it cannot hide one that stays, because R-hat compares
where the ensembles are, not how they propose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm.auto import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.common.convergence import Convergence, convergence_of
from bayes_iwan.sampling.ensemble.proposal import Proposal
from bayes_iwan.sampling.ensemble.run import POWERS, Run
from bayes_iwan.sampling.ensemble.walkers import SamplingError, Walkers

__all__ = ["Chains", "SamplingError", "sample"]

BatchFunction = Callable[[Array], Array]

_CHUNK = 100  # steps of production between two checkpoints


class Stop(Enum):
    """Why a run ended."""

    CONVERGED = "converged"
    STEPS = "the largest number of steps"
    BUDGET = "the time budget"
    INTERRUPTED = "interrupted"
    QUICK = "not sampled"


@dataclass(frozen=True)
class Chains:
    """Production draws of independent ensembles, and what they are worth.

    draws[e, i, w] is walker w of ensemble e at step thin·(i + 1) of production. quantities are what the caller's
    function makes of the same draws. convergence covers names + quantity_names (None if production is too short
    to say anything). converged says whether all targets were met; message says why the run ended and, if not
    converged, what is short of its target; stop is that reason alone.
    """

    names: tuple[str, ...]
    quantity_names: tuple[str, ...]
    draws: Array  # (ensembles, stored, walkers, ndim)
    log_prob: Array  # (ensembles, stored, walkers)
    quantities: Array  # (ensembles, stored, walkers, len(quantity_names))
    thin: int
    n_steps: int
    n_evaluations: int
    acceptance: float
    convergence: Convergence | None
    converged: bool
    message: str
    stop: Stop
    seed: int
    seconds: float
    proposal: Proposal | None

    def flat(self, n: int | None = None) -> Array:
        """(n, ndim) draws spread evenly over all ensembles, steps and walkers; all of them by default."""
        return self.draws.reshape(-1, self.draws.shape[-1])[self._even(n)]

    def flat_quantities(self, n: int | None = None) -> Array:
        """(n, len(quantity_names)) the quantities of the draws that `flat(n)` returns."""
        return self.quantities.reshape(-1, self.quantities.shape[-1])[self._even(n)]

    def _even(self, n: int | None) -> NDArray[np.int64]:
        total = int(np.prod(self.draws.shape[:3]))
        return np.arange(total) if n is None or n >= total else np.linspace(0, total - 1, n).round().astype(int)


def sample(
    log_prob: BatchFunction,
    population: ArrayLike,
    *,
    names: Sequence[str],
    seed: int,
    quantities: BatchFunction | None = None,
    quantity_names: Sequence[str] = (),
    checkpoint: Path | None = None,
    fingerprint: Mapping[str, str] | None = None,
    n_ensembles: int = 4,
    n_walkers: int = 40,
    budget_s: float | None = None,
    max_steps: int = 200_000,
    target_r_hat: float = 1.01,
    target_ess: float = 400.0,
    chain_taus: float = 50.0,
    progress: bool = True,
    resume: bool = False,
) -> Chains:
    """Draw from exp(log_prob) until converged, or until the budget is used up, which the result then says.

    Parameters
    ----------
    log_prob
        maps z (n, ndim) to (n,), -inf where impossible; rows must not depend on each other. The numbers
        should be unbounded and of comparable size (the map looks for the directions in which z varies most).
    population
        (members, ndim), where the walkers start; widely spread members make R-hat meaningful.
    quantities
        maps z (n, ndim) to (n, len(quantity_names)), further quantities that must converge too.
    checkpoint
        file that is written every few hundred steps; with `resume` a run goes on from it to the
        very same draws. A file that is not there yet is started.
    fingerprint
        named hashes of whatever makes this run what it is; a checkpoint with others is refused.
    budget_s
        seconds of this call after which it stops; max_steps : steps of production.
    target_r_hat, target_ess, chain_taus
        all of R-hat <= , bulk and tail ESS >= , and steps >= chain_taus · tau,
        for every sampled parameter and every quantity.

    Raises
    ------
    SamplingError
        no usable start, or log_prob returns NaN, +inf or a wrong shape.
    CheckpointError
        a checkpoint that exists without `resume`, or that belongs to another run.

    The same seed gives the same draws, bit for bit, on the same machine, whether interrupted (by a kill, Ctrl-C or the
    time budget) and resumed or not. Where the clock has decided more than the end, because the budget cut adaptation
    short, or forbade production to begin anew, the message says so.
    Ctrl-C ends the run with the draws that are there; the message says so.
    """
    names, quantity_names = tuple(names), tuple(quantity_names)
    if (quantities is None) != (not quantity_names):
        raise SamplingError("quantities and quantity_names go together")
    settings = {"seed": str(seed), "n_ensembles": str(n_ensembles), "n_walkers": str(n_walkers)}
    walkers = Walkers(log_prob, n_ensembles, n_walkers, len(names), POWERS)
    run = Run(walkers, seed, dict(fingerprint or {}) | settings, names, budget_s)
    stop: Stop | None = None
    said, short, result = "", "no draws yet", None
    with tqdm(disable=None if progress else True, unit="step") as bar:
        run.bar = bar
        try:
            run.begin(np.asarray(population, dtype=float), checkpoint, resume)
            run.adapt()
            bar.set_description("sampling")
            while stop is None:
                chunk = run.chunk(_CHUNK)
                # only where a run without a clock would look as well: a resumed one may stand between two such places
                planned = run.n_steps >= run.next_check and run.n_steps % chunk == 0
                late = run.late
                if (planned or late or run.n_steps >= max_steps) and run.draws.shape[1] >= 8:
                    values = run.evaluate(quantities, len(quantity_names))
                    result = convergence_of(
                        np.concatenate([run.draws, values], axis=3), names + quantity_names, run.thin
                    )
                    short = result.shortfall(target_r_hat, target_ess, chain_taus)
                    run.plan_check(result, target_ess, chain_taus)
                    bar.set_postfix_str(
                        f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                    )
                    if not short:
                        stop, said = Stop.CONVERGED, "converged"
                        if late and not planned:
                            said += f" when the time budget of {budget_s:g} s was up"
                    elif run.n_steps >= max_steps:
                        stop, said = Stop.STEPS, f"stopped at {max_steps} steps"
                    elif late:
                        stop, said = Stop.BUDGET, f"stopped at the time budget of {budget_s:g} s"
                    elif run.restart_if_slow(result, chain_taus):
                        short, result = "no draws yet", None
                        bar.set_postfix_str("slow: proposal fitted anew")
                if stop is None:  # eight draws at least, or there is nothing to say at the end
                    run.produce(min(chunk - run.n_steps % chunk, max(max_steps, 8 * run.thin) - run.n_steps))
        except KeyboardInterrupt:
            stop = Stop.INTERRUPTED
        finally:
            run.close()
        if stop is Stop.INTERRUPTED:
            said = "interrupted" if run.n_steps else "interrupted in warm-up, before any draw that counts"
            values = run.evaluate(quantities, len(quantity_names))
            if run.draws.shape[1] >= 8:
                result = convergence_of(np.concatenate([run.draws, values], axis=3), names + quantity_names, run.thin)
                short = result.shortfall(target_r_hat, target_ess, chain_taus)
    if run.hurried:
        said += "; the time budget cut adaptation short, so that more time gives other draws"
    return Chains(
        names=names,
        quantity_names=quantity_names,
        draws=run.draws,
        log_prob=run.log_prob,
        quantities=values,
        thin=run.thin,
        n_steps=run.n_steps,
        n_evaluations=run.walkers.n_evaluations,
        acceptance=run.acceptance,
        convergence=result,
        converged=not short,
        message=said if not short else f"not converged: {said}; {short}",
        stop=stop,
        seed=seed,
        seconds=time.monotonic() - run.began,
        proposal=run.proposal,
    )
