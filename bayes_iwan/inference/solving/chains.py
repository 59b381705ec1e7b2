"""How a problem's posterior is handed to the sampler, and its normal approximation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.special import softmax

from bayes_iwan.arrays import Array
from bayes_iwan.executors import Processes
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import sampled_and_derived
from bayes_iwan.inference.setup.settings import SamplingSettings
from bayes_iwan.inference.solving.point import Point, laplace_scale, near_optima
from bayes_iwan.models import Model
from bayes_iwan.models.parameter import Z_LIMIT
from bayes_iwan.sampling.blocks import generator
from bayes_iwan.sampling.chains import Chains
from bayes_iwan.sampling.moves.manifold import Manifold
from bayes_iwan.sampling.moves.metropolis import LeastSquares
from bayes_iwan.sampling.nuisance import Nuisance
from bayes_iwan.sampling.plan import Plan
from bayes_iwan.sampling.run import sample


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


@dataclass(frozen=True)
class WhitenedResiduals:
    """A problem's residuals, whitened, z (n, ndim) → (n, k): what can travel to other processes."""

    problem: Problem

    def __call__(self, z: Array) -> Array:
        return self.problem.rows(z)[:, : -self.problem.ndim]


def least_squares_of(problem: Problem, optimum: Array) -> LeastSquares:
    """A problem's posterior as a sum of squares, about an optimum z (ndim,)."""
    columns, root = problem.noise_columns, laplace_scale(problem, optimum)
    root = np.asarray(np.linalg.cholesky((root @ root.T)[np.ix_(columns, columns)]))
    return LeastSquares(
        WhitenedResiduals(problem.coarser()),
        problem.log_prob_of_noise,
        Nuisance(columns, optimum[columns], root),
        problem.ndim,
        Z_LIMIT,
    )


def sampled(problem: Problem, point: Point, s: SamplingSettings, run: Run) -> Chains:
    """Draws of a problem's posterior, by walkers that start at the optima of a point estimate."""
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
        progress=run.progress,
    )
    return sample(
        problem.log_prob,
        least_squares_of(problem, point.optima[0]),
        near_optima(point.optima, point.optima_log_prob),
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


def approximate_draws(problem: Problem, optima: Array, count: int, seed: Sequence[int]) -> Array:
    """z (count, ndim) of the normal approximation about optima (k, ndim) or (ndim,), each as often as its Laplace
    evidence says, drawn along the posterior's manifold; noise parameters by their conditional posterior.

    Normal draws of the parameters would leave the thin curved sheet that the posterior is, and with it the loops. So
    each draw is a fit to loops and priors that were shifted by their noise ("randomise, then optimise": Bardsley,
    Solonen, Haario & Laine, SIAM J. Sci. Comput. 36, 2014, A1895): along the optimum's tangents it is standard normal,
    and it lies on the sheet. Draws without such a fit, where the sheet turns over, are normal ones after all.
    """
    random, optima = generator(seed), np.atleast_2d(optima)
    roots = [laplace_scale(problem, z) for z in optima]
    evidence = problem.log_prob(optima) + [np.linalg.slogdet(root)[1] for root in roots]
    counts = random.multinomial(count, softmax(evidence))
    parts = [_about(problem, *at, random) for at in zip(optima, roots, counts.tolist()) if at[2]]
    return np.concatenate(parts)[random.permutation(count)]


def _about(problem: Problem, optimum: Array, root: Array, count: int, random: np.random.RandomState) -> Array:
    """z (count, ndim) about an optimum (ndim,), where the covariance has this root."""
    target = least_squares_of(problem, optimum)
    manifold = Manifold(target)
    tried = count + count // 2
    at = manifold.places(optimum[None]).some(np.zeros(tried, np.int64))
    drawn, met = manifold.reached(at, random.standard_normal((tried, len(manifold.free))))
    z = drawn[met][:count]
    unit = random.standard_normal((count - len(z), problem.ndim))
    normal = np.clip(optimum + unit @ root.T, -0.95 * Z_LIMIT, 0.95 * Z_LIMIT)
    return target.integrated(np.concatenate([z, normal]), random).z
