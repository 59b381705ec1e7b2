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

import numpy as np
from numpy.typing import ArrayLike
from tqdm.auto import tqdm

from bayes_iwan.sampling.common.chains import Chains, Stop
from bayes_iwan.sampling.common.convergence import convergence_of
from bayes_iwan.sampling.common.plan import BatchFunction, Plan
from bayes_iwan.sampling.ensemble.run import POWERS, Run
from bayes_iwan.sampling.ensemble.walkers import Walkers

_CHUNK = 100  # steps of production between two checkpoints


def sample(
    log_prob: BatchFunction, population: ArrayLike, plan: Plan, *, n_ensembles: int = 4, n_walkers: int = 40
) -> Chains:
    """Draw from exp(log_prob) until converged, or until the budget is used up, which the result then says.

    Parameters
    ----------
    log_prob
        maps z (n, ndim) to (n,), -inf where impossible; rows must not depend on each other. The numbers
        should be unbounded and of comparable size (the map looks for the directions in which z varies most).
    population
        (members, ndim), where the walkers start; widely spread members make R-hat meaningful.
    plan
        what is asked; its checkpoint is written every few hundred steps.

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
    settings = {"seed": str(plan.seed), "n_ensembles": str(n_ensembles), "n_walkers": str(n_walkers)}
    walkers = Walkers(log_prob, n_ensembles, n_walkers, len(plan.names), POWERS)
    run = Run(walkers, plan.seed, dict(plan.fingerprint) | settings, plan.names, plan.budget_s)
    stop: Stop | None = None
    said, short, result = "", "no draws yet", None
    with tqdm(disable=plan.quiet, unit="step") as bar:
        run.bar = bar
        try:
            run.begin(np.asarray(population, dtype=float), plan.checkpoint, plan.resume)
            run.adapt()
            bar.set_description("sampling")
            while stop is None:
                chunk = run.chunk(_CHUNK)
                # only where a run without a clock would look as well: a resumed one may stand between two such places
                planned = run.n_steps >= run.next_check and run.n_steps % chunk == 0
                late = run.late
                if (planned or late or run.n_steps >= plan.max_steps) and run.draws.shape[1] >= 8:
                    values = run.evaluate(plan)
                    result = convergence_of(np.concatenate([run.draws, values], axis=3), plan.every_name, run.thin)
                    short = plan.shortfall(result)
                    run.plan_check(result, plan.target_ess, plan.chain_taus)
                    bar.set_postfix_str(
                        f"R-hat {result.worst_r_hat:.3f}, ESS {result.least_ess:.0f}, tau {result.worst_tau:.0f}"
                    )
                    stop, said = plan.ended(short, run.n_steps, late)
                    if stop is Stop.CONVERGED and late and not planned:
                        said += f" when the time budget of {plan.budget_s:g} s was up"
                    if stop is None and run.restart_if_slow(result, plan.chain_taus):
                        short, result = "no draws yet", None
                        bar.set_postfix_str("slow: proposal fitted anew")
                if stop is None:  # eight draws at least, or there is nothing to say at the end
                    run.produce(min(chunk - run.n_steps % chunk, max(plan.max_steps, 8 * run.thin) - run.n_steps))
        except KeyboardInterrupt:
            stop = Stop.INTERRUPTED
        finally:
            run.close()
        if stop is Stop.INTERRUPTED:
            said = "interrupted" if run.n_steps else "interrupted in warm-up, before any draw that counts"
            values = run.evaluate(plan)
            if run.draws.shape[1] >= 8:
                result = convergence_of(np.concatenate([run.draws, values], axis=3), plan.every_name, run.thin)
                short = plan.shortfall(result)
    if run.hurried:
        said += "; the time budget cut adaptation short, so that more time gives other draws"
    return Chains(
        names=plan.names,
        quantity_names=plan.quantity_names,
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
        seed=plan.seed,
        seconds=time.monotonic() - run.began,
    )
