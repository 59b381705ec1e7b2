"""How a problem's posterior is handed to the sampler."""

import re
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Processes
from bayes_iwan.inference.setup.marginal import Marginal
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import sampled_and_derived
from bayes_iwan.inference.setup.settings import SamplingSettings
from bayes_iwan.inference.solving.point import laplace_scale
from bayes_iwan.models import Model
from bayes_iwan.sampling.chains import Chains
from bayes_iwan.sampling.plan import Plan
from bayes_iwan.sampling.run import sample

#: what is asked of a quick run: all walkers that were led to the posterior, and one block of their steps
QUICK: dict[str, Any] = {"walkers": 64, "max_steps": 25, "ess": 0.0, "r_hat": float("inf"), "taus": 0.0}
#: numbers of the slip forces' density: its mean and quartiles are what loops tell and what is compared, while these
#: make up for one another in tails that are longer than effective draws could ever be enough for
_OF_THE_DENSITY = re.compile(r"(eta|share_|slip_ratio_|slip_deviation|slip_larger|[gt])\d+(_N)?").fullmatch


@dataclass(frozen=True)
class Run:
    """A run as it is kept and shown: its seed, where it is written and resumed from, and what else draws depend on;
    executor : of processes that may take a part of it, with the same draws."""

    seed: int
    checkpoint: Path | None = None
    origin: Mapping[str, str] = field(default_factory=dict)
    resume: bool = False
    progress: bool = False
    executor: Executor | None = None


def sampled(problem: Problem, optima: Array, s: SamplingSettings, run: Run) -> Chains:
    """Draws of a problem's posterior, by walkers that are led there from its optima (k, ndim)."""
    names, parameter_values = _unsampled(problem)
    plan = Plan(
        names=tuple(problem.names),
        seed=run.seed,
        quantities=parameter_values,
        quantity_names=names,
        checkpoint=run.checkpoint,
        fingerprint=problem.fingerprint() | dict(run.origin) | {"seed": str(run.seed)},
        resume=run.resume,
        budget_s=s.budget_s,
        max_steps=s.max_steps,
        target_r_hat=s.r_hat,
        target_ess=s.ess,
        chain_taus=s.taus,
        by_r_hat=frozenset(
            filter(_OF_THE_DENSITY, (*problem.names, *names)) if isinstance(problem.model, Model) else ()
        ),
        progress=run.progress,
    )
    return sample(
        Marginal(problem).density,
        optima,
        np.stack([laplace_scale(problem, z) for z in optima]),
        plan,
        n_ensembles=s.ensembles,
        n_walkers=s.walkers,
        # a simulator of the user's own may live in a file that other processes have not read
        executor=run.executor if isinstance(problem.model, Model) and isinstance(run.executor, Processes) else None,
    )


def _unsampled(problem: Problem) -> tuple[tuple[str, ...], Callable[[Array], Array] | None]:
    """Names of the quantities that follow from the sampled ones without a prediction and must converge too, and how.

    What is fixed, or follows from the model alone as g₁ = 1 of a single gamma does, has no convergence.
    """
    some = problem.prior.draw(np.random.default_rng(0), 64)
    named = sampled_and_derived(problem, some)
    with np.errstate(invalid="ignore"):
        names = tuple(
            n for n, q in named.items() if n not in problem.names and np.nanmax(q.values) > np.nanmin(q.values)
        )

    def parameter_values(z: Array) -> Array:
        named = sampled_and_derived(problem, z)
        return np.stack([named[name].values for name in names], axis=1)

    return names, parameter_values if names else None
