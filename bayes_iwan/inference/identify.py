"""From a campaign to a posterior: read, average, find the point, sample, write."""

import contextlib
import functools
import hashlib
import importlib
import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayes_iwan.arguments import CAMPAIGN, path_of, seed_of
from bayes_iwan.campaign import Campaign, Loop, read_campaign
from bayes_iwan.executors import Workers, opened
from bayes_iwan.former_names import refuse_former_options
from bayes_iwan.inference.results import run_files
from bayes_iwan.inference.results.posterior import ConvergenceRow, Posterior
from bayes_iwan.inference.setup.config import Config, settings_of
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.settings import IdentifySettings, SearchSettings
from bayes_iwan.inference.setup.simulator_check import check_simulator
from bayes_iwan.inference.solving.jackknife import stretched
from bayes_iwan.inference.solving.point import find_point, near_optima
from bayes_iwan.inference.solving.posterior_draws import QUICK, Run, sampled
from bayes_iwan.models import Simulator
from bayes_iwan.models.user_file import load_simulator
from bayes_iwan.sampling.chains import Chains, Stop
from bayes_iwan.sampling.checkpoint import NAME as CHECKPOINT

#: `quick`: the search unless the configuration has its own
QUICK_SEARCH = SearchSettings(members=100, evaluations=4000, second_search=False, starts=8)
_LEAST_KEPT = 16  # steps of each walker
_VERSIONED = ("bayes-iwan", "numpy", "scipy", "numba", "emcee", "arviz")


def identify_campaign(
    campaign: Campaign | str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    config: Config = None,
    simulator: Simulator | str | os.PathLike[str] | None = None,
    **options: Any,
) -> Posterior:
    """The joint posterior of all the campaign's tests that are not held out.

    campaign : a campaign, or its folder. out : folder for summary.csv, posterior.nc, point.json and the checkpoint
    chains.ckpt; None writes nothing. config, simulator and all else as for :func:`identify_loops`.

    Raises CampaignError, ConfigError, ParameterError, ModelError, CheckpointError: all InputErrors of one line.
    """
    settings = _settings_for(config, simulator)
    read = campaign if isinstance(campaign, Campaign) else read_campaign(path_of(campaign, "campaign", CAMPAIGN))
    loops = read.loops(**asdict(settings.loops))
    posterior = identify_loops(loops, config=settings, campaign=read, out=out, simulator=simulator, **options)
    if out is not None:
        run_files.write(posterior, Path(out))
    return posterior


def _settings_for(config: Config, simulator: object) -> IdentifySettings:
    return settings_of(config, {} if simulator is None else {"model": "since a simulator replaces the Iwan model"})


@refuse_former_options
def identify_loops(
    loops: Sequence[Loop],
    *,
    config: Config = None,
    seed: int = 0,
    campaign: Campaign | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = True,
    simulator: Simulator | str | os.PathLike[str] | None = None,
    quick: bool = False,
    workers: Workers = None,
) -> Posterior:
    """The joint posterior of averaged loops of any origin; nothing but the checkpoint is written.

    Parameters
    ----------
    loops
        of :attr:`bayes_iwan.Check.loops`, say; those with role "held-out" are not fitted.
    config, seed, resume, progress, simulator, quick, workers
        as for :func:`bayes_iwan.identify`.
    campaign
        where the loops are from, for what is written of them.
    out
        folder of the checkpoint; None keeps none.

    Returns
    -------
    Posterior
        with the draws, (chains, draws, ndim), in z.

    Raises
    ------
    ConfigError, ParameterError, ModelError, CheckpointError
        InputErrors of one line.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> simple = {"model": {"slip": "gamma1", "normal_force": "constant", "embedded": False}}
    >>> posterior = bi.identify_loops(bi.check(folder).loops, config=simple, seed=1, quick=True, progress=False)
    >>> len(posterior.problem.loops)
    2
    """
    seed = seed_of(seed)
    settings, simulator_file = _settings_for(config, simulator), ""
    if isinstance(simulator, str | os.PathLike):
        simulator_file, simulator = str(Path(simulator).resolve()), load_simulator(simulator)
    problem = make_problem(loops, settings, simulator)
    if simulator is not None:
        check_simulator(problem, seed)
    return identify_problem(
        problem,
        seed,
        config=settings,
        campaign=campaign,
        loops=loops,
        out=out,
        resume=resume,
        progress=progress,
        simulator_file=simulator_file,
        quick=quick,
        workers=workers,
    )


@refuse_former_options
def identify_problem(
    problem: Problem,
    seed: int,
    *,
    config: Config = None,
    campaign: Campaign | None = None,
    loops: Sequence[Loop] | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = True,
    simulator_file: str = "",
    quick: bool = False,
    workers: Workers = None,
) -> Posterior:
    """The posterior of a problem, from loops of any origin; nothing but the checkpoint is written.

    Parameters
    ----------
    problem
        from :func:`make_problem`, perhaps with other measured forces (`with_force`) or effects.
    seed
        of all random numbers.
    config
        as for :func:`bayes_iwan.identify`; its [search] and [sampling] tables are read.
    campaign, simulator_file
        where loops and simulator came from, for what is written of them.
    loops
        all tests, if some were held out.
    out
        folder of the checkpoint.
    resume
        go on from it.
    progress
        show a bar.
    quick
        the first draws of a short run, not asked whether it has converged.
    workers
        as for :func:`bayes_iwan.identify`.

    Returns
    -------
    Posterior
        with the draws, (chains, draws, ndim), in z.

    Raises
    ------
    ConfigError, CheckpointError, SamplingError
        InputErrors of one line.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> problem = bi.make_problem(bi.check(folder).loops, {"model": {"slip": "gamma1", "embedded": False}})
    >>> posterior = bi.identify_problem(problem, 1, progress=False, quick=True)
    >>> posterior.ndim == problem.ndim, bool(posterior.residual_size().share < 0.1)
    (True, True)
    """
    settings, seed = settings_of(config), seed_of(seed)
    began = time.monotonic()
    search = QUICK_SEARCH if quick and settings.search == SearchSettings() else settings.search
    # threads do nothing for such small matrices but wait for each other, and would round sums in another order
    with threadpool_limits(limits=1, user_api="blas"):
        point = find_point(problem, seed, search, progress)
        located = time.monotonic()
        made = functools.partial(
            Posterior, problem=problem, campaign=campaign, loops=problem.loops if loops is None else tuple(loops),
            point=point, seed=seed, settings=settings, versions=versions(), simulator_file=simulator_file,
        )  # fmt: skip
        checkpoint = None if out is None or quick else Path(out) / CHECKPOINT
        origin = _origin(settings.search, simulator_file)
        asked = replace(settings.sampling, **QUICK) if quick else settings.sampling
        with opened(None if quick else workers, along=True) as executor:
            how = Run(seed, checkpoint, origin, resume, progress, executor)
            chains = sampled(problem, near_optima(point.optima, point.optima_log_prob), asked, how)
    if chains.draws.shape[1] == 0:  # Ctrl-C in warm-up: the checkpoint is all there is
        raise KeyboardInterrupt
    timings = {"point_s": located - began, "sampling_s": time.monotonic() - located, "steps": float(chains.n_steps)}
    return _posterior(made, problem, chains, settings, timings, quick)


class NotConverged(UserWarning):
    """A run that ended before its chains had converged."""


def _posterior(
    made: Callable[..., Posterior],
    problem: Problem,
    chains: Chains,
    settings: IdentifySettings,
    timings: Mapping[str, float],
    quick: bool,
) -> Posterior:
    """The draws thinned to about as many as were asked for, and the diagnostics of the whole run beside them."""
    ensembles, stored, walkers, ndim = chains.draws.shape
    # what is kept has steps enough for its own diagnostics
    every = max(1, min(-(-stored * ensembles * walkers // settings.sampling.draws), stored // _LEAST_KEPT))
    kept = slice(stored - 1 - every * ((stored - 1) // every), None, every)
    z, stretch = np.moveaxis(chains.draws[:, kept], 2, 1).reshape(ensembles, -1, ndim), 1.0
    if settings.sampling.between_tests:
        flat, stretch = stretched(problem, z.reshape(-1, ndim), chains.seed)
        z = flat.reshape(z.shape)
    c = chains.convergence
    diagnostics = () if c is None else zip(c.names, c.ess_bulk, c.ess_tail, c.r_hat, c.tau_steps)
    return made(
        z=z,
        log_prob=problem.log_prob(z.reshape(-1, ndim)).reshape(z.shape[:2]),
        walkers=walkers,
        thin=every,
        converged=chains.converged and not quick,
        message="quick: the first draws of a short run, not asked whether it has converged"
        if quick
        else chains.message,
        stop=Stop.QUICK if quick else chains.stop,
        timings=timings,
        convergence=tuple(ConvergenceRow(name, *map(float, row)) for name, *row in diagnostics),
        stretch=stretch,
    )


def _origin(search: SearchSettings, simulator_file: str) -> dict[str, str]:
    """What else draws depend on: the walkers start where the search led them, by this code and the user's."""
    own = hashlib.sha256(Path(simulator_file).read_bytes()).hexdigest() if simulator_file else ""
    return {f"search {k}": str(v) for k, v in asdict(search).items()} | {"code": _code(), "simulator": own}


@functools.cache
def _code() -> str:
    """SHA-256 of the package's source, as far as draws depend on it."""
    package = Path(__file__).parents[1]
    folders = ("campaign", "models", "effects", "fitting", "sampling", "inference")
    files = sorted([*package.glob("*.py"), *(p for folder in folders for p in (package / folder).rglob("*.py"))])
    digest = hashlib.sha256()
    for path in files:
        if path.name != "__init__.py":
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python, this package and the libraries that results depend on."""
    out = {"python": platform.python_version()}
    for name in _VERSIONED:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            out[name] = importlib.metadata.version(name)
    return out
