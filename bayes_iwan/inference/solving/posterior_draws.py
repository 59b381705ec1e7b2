"""How a problem's posterior is handed to the sampler, and its normal approximation."""

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

#: of the normal approximation: parts of the way to a draw (twice as many lead hardly further), and how often the noise
#: is learnt from how many draws before
_PARTS, _PASSES, _PILOT = 4, 3, 200


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
    and it lies on the sheet; where the sheet turns over on the way there, the draw is the last place before.
    """
    random, optima = generator(seed), np.atleast_2d(optima)
    evidence = problem.log_prob(optima) + [np.linalg.slogdet(laplace_scale(problem, z))[1] for z in optima]
    counts = random.multinomial(count, softmax(evidence))
    parts = [_about(problem, *at, random) for at in zip(optima, counts.tolist()) if at[1]]
    return np.concatenate(parts)[random.permutation(count)]


def _about(problem: Problem, optimum: Array, count: int, random: np.random.RandomState) -> Array:
    """z (count, ndim) about an optimum (ndim,).

    At the optimum the noise is less than it is on average, since the parameters take up some of it; so it is learnt
    from draws first.
    """
    target = least_squares_of(problem, optimum)
    for _ in range(_PASSES):
        target = target.fitted(_drawn(target, optimum, _PILOT, random))
    return _drawn(target, optimum, count, random)


def _drawn(target: LeastSquares, optimum: Array, count: int, random: np.random.RandomState) -> Array:
    """z (count, ndim) at the ends of standard normal ways along the manifold."""
    manifold = Manifold(target)
    unit = random.standard_normal((count, len(manifold.free)))
    return target.integrated(manifold.followed(manifold.places(optimum[None]), unit, _PARTS), random).z
