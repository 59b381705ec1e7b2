"""Leave-one-out predictive densities: by ArviZ for single data, by sequential importance sampling for whole tests."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import emcee
import numpy as np
from scipy.special import logsumexp

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.screen import on_screen

#: Pareto's k below which importance weights may be trusted
TRUSTED = 0.7


def smoothed_log_weights(log_w: Array) -> tuple[Array, Array]:
    """ArviZ's Pareto-smoothed log weights (…, n), their exponentials summing to one, and Pareto's k (…,).

    Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, J. Machine Learning Research 25 (2024).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ announces on import what it will change
        try:
            from arviz import psislw
        except ImportError:  # from 1.0: of log-likelihoods, so of the negated weights
            from arviz_stats.base import array_stats

            smoothed, k = array_stats.psislw(-log_w)
        else:
            smoothed, k = psislw(log_w)  # type: ignore[no-untyped-call]
    return np.asarray(smoothed) - logsumexp(smoothed, axis=-1, keepdims=True), np.asarray(k, dtype=float)


@dataclass(frozen=True)
@on_screen
class Loo:
    """elpd : expected log predictive density, the sum of `pointwise` (data,); se its standard error over the data;
    p : effective number of parameters; pareto_k (data,), with NaN where no importance sampling was needed."""

    elpd: float
    se: float
    p: float
    pointwise: Array
    pareto_k: Array

    @property
    def holds(self) -> bool:
        """No more than one datum in a hundred has k above 0.7, so the sum may be trusted."""
        return bool(np.mean(np.nan_to_num(self.pareto_k, nan=0.0) > TRUSTED) <= 0.01)


def psis_loo(log_likelihood: Array) -> Loo:
    """ArviZ's PSIS-LOO of log-likelihoods (chains, draws, data), whichever ArviZ is installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of each high k; they are handed on in pareto_k
        import arviz as az

        groups = {"log_likelihood": {"y": log_likelihood}, "posterior": {"unused": np.zeros(log_likelihood.shape[:2])}}
        try:
            data = az.from_dict(posterior=groups["posterior"], log_likelihood=groups["log_likelihood"])  # up to 0.23
        except TypeError:
            data = az.from_dict(groups)  # from 1.0
        found = az.loo(data, pointwise=True)  # type: ignore[no-untyped-call]
    old = hasattr(found, "elpd_loo")
    pointwise = np.asarray(found.loo_i if old else found.elpd_i, dtype=float).ravel()
    elpd, p = (found.elpd_loo, found.p_loo) if old else (found.elpd, found.p)
    return Loo(float(elpd), float(found.se), float(p), pointwise, np.asarray(found.pareto_k, dtype=float).ravel())


def leave_tests_out(posterior: Posterior, *, seed: int = 0, steps: int = 60) -> Loo:
    """ln p(test | all other tests) of each fitted test, (tests,), parameters and noise learnt from the others alone.

    Where the posterior's own draws, weighted, can stand for those without the test (Pareto's k below 0.7) they do;
    else draws are resampled by weight and moved on by `steps` of differential evolution under the others' posterior.
    """
    problem = posterior.problem
    if len(problem.loops) < 2:
        raise InputError("leaving tests out needs at least two tests")
    z = posterior.flat_z(2000)
    whole = _chunked(problem.log_likelihood, z)
    pointwise, ks = [], []
    for t in range(len(problem.loops)):
        others = without(problem, t)
        conditional = whole - _chunked(others.log_likelihood, z)
        log_w, at = smoothed_log_weights(-conditional)
        k = float(at)
        if k < TRUSTED:
            value = logsumexp(log_w + conditional)
        else:
            moved = _moved(others, z, log_w, steps, seed + t)
            conditional = problem.log_likelihood(moved) - others.log_likelihood(moved)
            value = logsumexp(conditional) - np.log(len(conditional))
        pointwise.append(float(value))
        ks.append(k if k < TRUSTED else np.nan)
    values = np.array(pointwise)
    elpd, fit = float(values.sum()), logsumexp(whole) - np.log(len(whole))
    return Loo(elpd, float(np.sqrt(len(values)) * values.std(ddof=1)), float(fit - elpd), values, np.array(ks))


def without(problem: Problem, test: int) -> Problem:
    """The same problem (scales, priors) without one of its tests."""
    others = [i for i in range(len(problem.loops)) if i != test]
    return replace(
        problem, loops=tuple(problem.loops[i] for i in others), likelihood=problem.likelihood.of_tests(others)
    )


def _chunked(function: Callable[[Array], Array], z: Array, size: int = 1000) -> Array:
    return np.concatenate([function(z[i : i + size]) for i in range(0, len(z), size)])


def _moved(problem: Problem, z: Array, log_w: Array, steps: int, seed: int, walkers: int = 128) -> Array:
    """Draws (2·walkers, ndim) of a problem's posterior, from others' draws z with weights towards it.

    Weights are tempered until they leave at least a quarter of the walkers distinct; the moves do what remains.
    """
    rng = np.random.default_rng([seed, 61])
    power = 1.0
    while power > 1e-3:
        w = np.exp(power * log_w - logsumexp(power * log_w))
        if 1.0 / np.sum(w * w) > 0.5 * walkers:
            break
        power *= 0.7
    start = z[rng.choice(len(z), size=walkers, p=w)]
    start = start + 1e-4 * rng.standard_normal(start.shape)
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DEMove(gamma0=1.0), 0.1), (emcee.moves.StretchMove(), 0.1)]
    sampler = emcee.EnsembleSampler(walkers, problem.ndim, problem.log_prob, moves=moves, vectorize=True)
    sampler._random = np.random.RandomState(np.random.MT19937(np.random.SeedSequence([seed, 62])))
    sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    chain: Array = sampler.get_chain()
    return np.concatenate([chain[-1], chain[-max(2, steps // 4)]])
