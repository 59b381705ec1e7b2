"""The ways in which a problem's posterior is sampled: independent proposals where they fit, else chains along its
manifold, else ensembles of walkers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Processes
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import sampled_and_derived
from bayes_iwan.inference.setup.settings import SamplingSettings
from bayes_iwan.inference.solving.point import Point, laplace_scale, starting_population
from bayes_iwan.physics import Model
from bayes_iwan.physics.interface.parameter import Z_LIMIT
from bayes_iwan.sampling.common.chains import Chains
from bayes_iwan.sampling.common.checkpoint import read_checkpoint
from bayes_iwan.sampling.common.plan import Plan
from bayes_iwan.sampling.ensemble.ensembles import sample
from bayes_iwan.sampling.ensemble.run import CROWD, POWERS
from bayes_iwan.sampling.ensemble.walkers import enough_walkers
from bayes_iwan.sampling.independent.branches import Optimum
from bayes_iwan.sampling.independent.importance import METHOD as INDEPENDENT
from bayes_iwan.sampling.independent.importance import sample_independently
from bayes_iwan.sampling.manifold.on_manifold import METHOD as ON_MANIFOLD
from bayes_iwan.sampling.manifold.on_manifold import sample_on_manifold
from bayes_iwan.sampling.manifold.sheet import Rows


def _unsampled(problem: Problem) -> tuple[tuple[str, ...], Callable[[Array], Array] | None]:
    """Names of the numbers that follow from the sampled ones without a prediction and must converge too, and how.

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


@dataclass(frozen=True)
class Run:
    """A run as it is kept and shown: its seed, where it is written and gone on from, and what else draws depend on;
    executor : of processes that may take a part of it, with the same draws."""

    seed: int
    checkpoint: Path | None = None
    origin: Mapping[str, str] = field(default_factory=dict)
    resume: bool = False
    progress: bool = False
    executor: Executor | None = None


def _plan(problem: Problem, s: SamplingSettings, run: Run) -> Plan:
    names, parameter_values = _unsampled(problem)
    return Plan(
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
        progress=run.progress,
    )


def independent_chains(problem: Problem, point: Point, s: SamplingSettings, run: Run) -> Chains | None:
    """Independent proposals about the maxima that were found; None where they do not fit this posterior."""
    held, coarse = problem.noise_columns, problem.coarser()
    optima = []
    for z, log_prob in zip(point.optima[:6], point.optima_log_prob[:6]):
        root = laplace_scale(problem, z)
        noise = np.asarray(np.linalg.cholesky((root @ root.T)[np.ix_(held, held)]))
        optima.append(Optimum(z, float(log_prob), coarse.whitening(z[None]), noise))

    def residuals(z: Array) -> Array:
        return coarse.residual(z).reshape(len(z), -1)

    return sample_independently(
        residuals,
        problem.log_prob_of_noise,
        optima,
        held,
        _plan(problem, s, run),
        limit=0.95 * Z_LIMIT,
        n_chains=s.ensembles,
    )


@dataclass(frozen=True)
class _Whitened:
    """A problem's residuals, whitened, z (n, ndim) → (n, k): what can travel to other processes."""

    problem: Problem

    def __call__(self, z: Array) -> Array:
        return self.problem.rows(z)[:, : -self.problem.ndim]


def manifold_chains(problem: Problem, point: Point, s: SamplingSettings, run: Run) -> Chains | None:
    """Chains along the posterior's manifold, from the maxima that were found; None where they do not move."""
    held, rows, root = manifold_of(problem, point.optima[0])
    return sample_on_manifold(
        rows,
        problem.log_prob_of_noise,
        point.optima,
        point.optima_log_prob,
        held,
        root,
        _plan(problem, s, run),
        limit=Z_LIMIT,
        n_ensembles=s.ensembles,
        # a simulator of the user's own may live in a file that other processes have not read
        executor=run.executor if isinstance(problem.model, Model) and isinstance(run.executor, Processes) else None,
    )


def manifold_of(problem: Problem, optimum: Array) -> tuple[NDArray[np.int64], Rows, Array]:
    """What the manifold is of: the held coordinates, the rows z (n, ndim) → (n, k), and the lower triangular root of
    the held numbers' covariance at an optimum (ndim,)."""
    held, coarse = problem.noise_columns, problem.coarser()
    root = laplace_scale(problem, optimum)
    root = np.asarray(np.linalg.cholesky((root @ root.T)[np.ix_(held, held)]))
    return held, _Whitened(coarse), root


def ensemble_chains(problem: Problem, point: Point, s: SamplingSettings, run: Run) -> Chains:
    """Ensembles of walkers, started from fits to shifted data."""
    walkers = max(s.walkers, enough_walkers(problem.ndim))
    return sample(
        problem.log_prob,
        starting_population(problem, point, run.seed, CROWD * len(POWERS) * s.ensembles * walkers),
        _plan(problem, s, run),
        n_ensembles=s.ensembles,
        n_walkers=walkers,
    )


def sampled(problem: Problem, point: Point, s: SamplingSettings, run: Run) -> Chains:
    """Independent proposals where they fit, else chains along the manifold, else ensembles, each in the time that is
    left; a checkpoint is gone on from by the way of sampling that wrote it."""
    began = time.monotonic()
    path = run.checkpoint
    written = read_checkpoint(path, ())[0] if path is not None and path.exists() else None
    ways = [(independent_chains, INDEPENDENT), (manifold_chains, ON_MANIFOLD)]
    if written is None and isinstance(problem.model, Model) and problem.model.embedded:
        ways = ways[1:]  # the bent form's independent proposals are worth a hundredth, and to find that takes minutes
    for way, mark in ways:
        if s.method == "auto" and (written is None or mark.items() <= written.items()):
            left = replace(s, budget_s=max(s.budget_s - (time.monotonic() - began), 0.0))
            chains = way(problem, point, left, run)
            if chains is not None:
                return chains
    left = replace(s, budget_s=max(s.budget_s - (time.monotonic() - began), 0.0))
    return ensemble_chains(problem, point, left, run)
