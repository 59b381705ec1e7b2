"""What a user would pick instead: other samplers on the same posterior, from the same starts, for the same seconds.

    python -m venv /tmp/bench && /tmp/bench/bin/pip install . -r analyses/requirements-benchmark.txt
    /tmp/bench/bin/python analyses/benchmark_samplers.py [CAMPAIGN] [--seconds 120] [--only NAME ...] [--out FILE]

All sample the default joint posterior over the package's own coordinates (priors standard normal), with the package's
own batch density, each in a process of its own for so many *processor* seconds: other work on the machine then disturbs
little. Ensembles and chains start at quick draws of the posterior (finding them is charged to nobody);
nested samplers and pocoMC start from the prior, as they must. Burn-in and adaptation are charged: what counts is what
the whole time bought. MCMC: bulk and tail ESS of the worst sampled number from four independent ensembles or chains,
the first half of the draws omitted (ours says itself when adaptation ended), their R-hat, and how many autocorrelation
times they are. Where R-hat is above 1.05, or they are fewer than 10, the ESS means nothing: walkers that stand still
where they started, at draws of the posterior, are as many "effective" draws as there are walkers. Nested and sequential
samplers: Kish's ESS of the weights if the run ended in time. The package stops by its own rule when that is sooner.

NUTS needs a gradient, which the forward model does not have. It gets forward differences, ndim + 1 evaluations in one
batch; leapfrog steps by whatever field are reversible and keep volume, and the density itself decides what is accepted,
so the draws are as exact as with the gradient itself. They go along the starts' covariance, as PINTS's first steps do.
What reverse differentiation would buy is its second row: the same draws, with (ndim + 1)/4 times as many seconds, since
a gradient would cost three evaluations beside the density's own (Griewank & Walther, Evaluating Derivatives, 2008,
sec. 4.6: at most four for all). A second of the table then is so many of the machine.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from bayes_iwan.campaign import read_campaign
from bayes_iwan.inference.setup.config import settings_of
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.solving.point import Point, find_point, near_optima
from bayes_iwan.inference.solving.posterior_draws import QUICK, Run, sampled
from bayes_iwan.sampling.convergence import Convergence, convergence_of

ENSEMBLES, WALKERS = 4, 40
LEAST_STORED = 20
#: evaluations that a density with its gradient by reverse differentiation costs
REVERSE = 4.0
STEP = 1e-7  # of forward differences, in standard deviations of the starts


class OutOfTime(Exception):
    """The processor seconds are used up."""


class Density:
    """The log posterior of a batch, counted; raises OutOfTime once the seconds are used up."""

    def __init__(self, problem: Problem, point: Point, seconds: float) -> None:
        self.problem, self.point, self.seconds = problem, point, seconds
        self.until, self.evaluations, self.best = time.process_time() + seconds, 0, -np.inf

    @property
    def late(self) -> bool:
        return time.process_time() > self.until

    def __call__(self, z: np.ndarray) -> np.ndarray:
        if self.late:
            raise OutOfTime
        return self.at(z)

    def at(self, z: np.ndarray) -> np.ndarray:
        """The same whatever the time."""
        self.evaluations += len(z)
        value = self.problem.log_prob(z)
        self.best = max(self.best, float(value.max()))
        return value

    def from_cube(self, unit: np.ndarray) -> np.ndarray:
        return special.ndtri(np.clip(unit, 1e-15, 1.0 - 1e-15))

    def likelihood(self, z: np.ndarray) -> np.ndarray:
        """Without the prior, for samplers that draw from it."""
        prior = -0.5 * np.sum(z * z, axis=1) - 0.5 * z.shape[1] * np.log(2.0 * np.pi)
        return np.maximum(self(z) - prior, -1e30)


def quality(draws: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    """ESS and R-hat of draws (ensembles, steps, walkers, numbers), the first half omitted."""
    kept = draws[:, draws.shape[1] // 2 :]
    if kept.shape[1] < LEAST_STORED:
        return {"note": f"only {draws.shape[1]} stored steps"}
    return told(convergence_of(kept, names))


def told(d: Convergence) -> dict[str, Any]:
    """What the table has of draws that are chains."""
    return {"ess": float(d.least_ess), "r_hat": float(d.worst_r_hat), "taus": float(d.n_steps / d.worst_tau)}


def package(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """What `identify` does, until its own rule is met or the clock has gone on by as many seconds."""
    settings = replace(settings_of().sampling, budget_s=density.seconds)
    optima = near_optima(density.point.optima, density.point.optima_log_prob)
    chains = sampled(density.problem, optima, settings, Run(seed))
    if chains.convergence is None:
        return {"note": chains.message}
    level = density.at(chains.flat(2000))  # what it walked in has some coordinates integrated out
    density.evaluations = 0  # it counts none
    return told(chains.convergence) | {"log_prob": float(np.median(level)), "note": chains.message}


def emcee_side(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """emcee with the side move (arXiv 2505.02987): a walker moves by a random part of the difference of two others."""
    from emcee.moves.red_blue import RedBlueMove

    class SideMove(RedBlueMove):
        def get_proposal(self, s: np.ndarray, c: list, random: np.random.RandomState) -> tuple:
            others = np.concatenate(c, axis=0)
            first = random.randint(len(others), size=len(s))
            second = (first + random.randint(1, len(others), size=len(s))) % len(others)
            length = 1.687 / np.sqrt(s.shape[1]) * random.standard_normal((len(s), 1))
            return s + length * (others[first] - others[second]), np.zeros(len(s))

    return by_emcee(density, starts, names, [SideMove()])


def emcee_default(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """emcee as it comes: the stretch move, four ensembles."""
    return by_emcee(density, starts, names, None)


def by_emcee(density: Density, starts: np.ndarray, names: tuple[str, ...], moves: list | None) -> dict[str, Any]:
    """Four ensembles of emcee by turns, until time is up."""
    import emcee

    ndim, walkers = starts.shape[1], max(WALKERS, 2 * starts.shape[1] + 2)
    runs = [
        emcee.EnsembleSampler(walkers, ndim, density, moves=moves, vectorize=True).sample(
            starts[k * walkers : (k + 1) * walkers], iterations=10**7, store=False
        )
        for k in range(ENSEMBLES)
    ]
    return by_turns(runs, lambda state: state.coords, lambda state: state.log_prob, names)


def zeus_default(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """zeus's differential slice move, four ensembles."""
    import zeus

    rng, ndim = np.random.default_rng(seed), starts.shape[1]
    walkers = max(WALKERS, 2 * ndim)
    np.random.seed(seed)  # noqa: NPY002 - it draws from the old global generator
    runs = [
        zeus.EnsembleSampler(walkers, ndim, density, vectorize=True, verbose=False).sample(
            starts[rng.permutation(len(starts))[:walkers]], iterations=10**5, progress=False
        )
        for _ in range(ENSEMBLES)
    ]
    return by_turns(runs, lambda state: state[0], lambda state: state[1], names)


def by_turns(runs: list, coords: Callable, log_prob: Callable, names: tuple[str, ...]) -> dict[str, Any]:
    """Step several samplers in turn until time is up."""
    draws: list[list[np.ndarray]] = []
    last = np.array([np.nan])
    try:
        while True:
            states = [next(run) for run in runs]
            draws.append([np.array(coords(state)) for state in states])
            last = np.concatenate([np.asarray(log_prob(state)) for state in states])
    except OutOfTime:
        pass
    if not draws:
        return {"note": "no step in time"}
    return quality(np.moveaxis(np.array(draws), 1, 0), names) | {"log_prob": float(np.median(last))}


def pints_haario_bardenet(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """PINTS's adaptive covariance (Haario–Bardenet), four chains, by ask and tell, so that four go in one batch."""
    import pints

    rng = np.random.default_rng(seed)
    np.random.seed(seed)  # noqa: NPY002 - it draws from the old global generator
    chains = [
        pints.HaarioBardenetACMC(x, np.cov(starts, rowvar=False)) for x in starts[rng.permutation(len(starts))[:4]]
    ]
    draws: list[list[np.ndarray]] = []
    step, last = 0, np.array([np.nan])
    try:
        while True:
            if step == 1000:
                for chain in chains:
                    chain.set_initial_phase(False)
            values = density(np.array([chain.ask() for chain in chains]))
            told = [chain.tell(float(v)) for chain, v in zip(chains, values)]
            step += 1
            if step % 20 == 0:
                draws.append([np.array(t[0]) for t in told])
                last = np.array([t[1] for t in told], dtype=float)
    except OutOfTime:
        pass
    if not draws:
        return {"note": "no step in time"}
    return quality(np.moveaxis(np.array(draws), 1, 0)[:, :, None], names) | {"log_prob": float(np.median(last))}


class Slopes:
    """The log posterior and its gradient by forward differences along the starts' own coordinates y, z = mean + L y."""

    def __init__(self, density: Density, starts: np.ndarray) -> None:
        self.density, self.mean = density, starts.mean(axis=0)
        self.scale = np.linalg.cholesky(np.cov(starts, rowvar=False))

    def z(self, y: np.ndarray) -> np.ndarray:
        return self.mean + y @ self.scale.T

    def y(self, z: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.scale, z - self.mean)

    def __call__(self, y: np.ndarray) -> tuple[float, np.ndarray]:
        value = self.density.at(self.z(np.vstack([y, y + STEP * np.eye(len(y))])))
        if not np.isfinite(value).all():  # outside the prior's bounds: a divergence
            return -np.inf, np.zeros(len(y))
        return float(value[0]), (value[1:] - value[0]) / STEP


def nutpie_nuts(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """NUTS by nutpie with its own adaptation, four chains."""
    import nutpie
    from nutpie.compiled_pyfunc import from_pyfunc

    slopes, ndim = Slopes(density, starts), starts.shape[1]

    def start(chain_seed: int) -> np.ndarray:
        return slopes.y(starts[np.random.default_rng([seed, chain_seed % 2**32]).integers(len(starts))])

    model = from_pyfunc(
        ndim,
        lambda: slopes,
        lambda *_: lambda y: {"z": slopes.z(y)},
        [np.dtype(float)],
        [(ndim,)],
        ["z"],
        make_initial_point_fn=start,
    )
    run = nutpie.sample(model, draws=10**6, chains=4, cores=4, seed=seed, progress_bar=False, blocking=False)
    while not density.late:
        time.sleep(0.05)
    trace = run.abort()
    draws = np.asarray(trace.posterior["z"])
    kept = min(int(np.isfinite(chain[:, 0]).sum()) for chain in draws)
    if kept < LEAST_STORED:
        return {"note": f"{kept} draws after adaptation"}
    d = convergence_of(draws[:, :kept, None], names)
    return told(d) | {"log_prob": float(np.median(density.at(draws[:, kept - 1])))}


def nautilus_nested(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """nautilus, 2,000 live points as by default."""
    import nautilus

    ndim = starts.shape[1]
    sampler = nautilus.Sampler(
        density.from_cube, density.likelihood, n_dim=ndim, n_live=2000, vectorized=True, pass_dict=False, seed=seed
    )
    try:
        sampler.run(n_eff=400, verbose=False)
    except OutOfTime:
        return {"note": "did not end in time"}
    z, log_weight, log_l = sampler.posterior()
    weight = np.exp(log_weight - log_weight.max())
    prior = -0.5 * np.sum(z * z, axis=1) - 0.5 * ndim * np.log(2.0 * np.pi)
    level = float(np.sum(weight * (log_l + prior)) / weight.sum())
    return {"ess": float(weight.sum() ** 2 / np.sum(weight**2)), "log_prob": level}


def pocomc_flow(density: Density, starts: np.ndarray, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """pocoMC, preconditioned sequential Monte Carlo."""
    import pocomc
    from scipy import stats

    prior = pocomc.Prior([stats.norm(0.0, 1.0)] * starts.shape[1])
    sampler = pocomc.Sampler(prior, density.likelihood, vectorize=True, random_state=seed)
    try:
        sampler.run(progress=False)
    except OutOfTime:
        return {"note": "did not end in time"}
    _, weight, log_l, log_prior = sampler.posterior()
    weight = weight / weight.sum()
    return {"ess": float(1.0 / np.sum(weight**2)), "log_prob": float(np.median(log_l + log_prior))}


SAMPLERS: dict[str, tuple[Callable[..., dict[str, Any]], str]] = {
    "this package": (package, "bayes-iwan"),
    "emcee, default": (emcee_default, "emcee"),
    "emcee, side move": (emcee_side, "emcee"),
    "zeus": (zeus_default, "zeus-mcmc"),
    "PINTS, Haario–Bardenet": (pints_haario_bardenet, "pints"),
    "NUTS, forward differences": (nutpie_nuts, "nutpie"),
    "NUTS, a reverse gradient's seconds": (nutpie_nuts, "nutpie"),
    "nautilus": (nautilus_nested, "nautilus-sampler"),
    "pocoMC": (pocomc_flow, "pocomc"),
}


def one(name: str, problem: Problem, point: Point, starts: np.ndarray, seconds: float, seed: int, pipe) -> None:
    share = REVERSE / (problem.ndim + 1) if "reverse" in name else 1.0
    density = Density(problem, point, seconds / share)
    began = time.process_time()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # emcee prints its walkers when the time is up
            result = SAMPLERS[name][0](density, starts, problem.names, seed)
    except ImportError as error:
        result = {"note": f"not installed ({error})"}
    except Exception as error:  # another package's failure is a result of this comparison
        result = {"note": f"failed: {type(error).__name__}: {error}"}
    used = {"seconds": share * (time.process_time() - began), "evaluations": density.evaluations, "best": density.best}
    pipe.send(result | used)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("campaign", nargs="?", default="data/rope_spring")
    parser.add_argument("--embedded", action="store_true", help="the default model")
    parser.add_argument("--seconds", type=float, default=120.0, help="processor seconds each")
    parser.add_argument("--only", nargs="+", choices=SAMPLERS, default=list(SAMPLERS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmark_samplers.json"))
    args = parser.parse_args()
    settings = settings_of({"model": {"embedded": args.embedded}})
    problem = make_problem(read_campaign(args.campaign).loops(**asdict(settings.loops)), settings)
    point = find_point(problem, args.seed, settings.search)
    optima, quick = near_optima(point.optima, point.optima_log_prob), replace(settings.sampling, **QUICK)
    starts = sampled(problem, optima, quick, Run(args.seed + 12)).flat(1024)
    print(f"most probable point: ln posterior {point.log_prob:.1f}, from which those below count")
    print(f"{len(starts)} starts; {os.cpu_count()} cores")
    print(
        "| sampler | evaluations | R-hat | autocorrelation times | least ESS | ESS per processor second | remarks |\n"
        "|---|---|---|---|---|---|---|"
    )
    results: dict[str, dict[str, Any]] = {}
    context = multiprocessing.get_context("spawn")
    for name in args.only:
        here, there = context.Pipe()
        process = context.Process(target=one, args=(name, problem, point, starts, args.seconds, args.seed, there))
        process.start()
        waited = time.monotonic()
        while not here.poll(1.0) and process.is_alive() and time.monotonic() - waited < 20.0 * args.seconds + 60.0:
            pass
        r = here.recv() if here.poll() else {"note": f"gave nothing back in {time.monotonic() - waited:.0f} s"}
        process.kill()
        results[name] = r
        sound = "ess" in r and r.get("r_hat", 1.0) < 1.05 and r.get("taus", np.inf) >= 10.0
        rate = f"{r['ess'] / r['seconds']:.3g}" if sound else "–"
        version = "" if "not installed" in r.get("note", "") else importlib.metadata.version(SAMPLERS[name][1])
        level = f"ln posterior {r['log_prob'] - point.log_prob:+.0f} in the median" if "log_prob" in r else ""
        if np.isfinite(r.get("best", np.nan)):
            level += f"{', ' if level else 'ln posterior '}{r['best'] - point.log_prob:+.1f} at best"
        remarks = "; ".join(x for x in (r.get("note", ""), level) if x)
        shown = [f"{r['evaluations']:,}" if r.get("evaluations") else "–"]
        shown += [f"{r[n]:{how}}" if n in r else "–" for n, how in (("r_hat", ".3f"), ("taus", ".0f"), ("ess", ".0f"))]
        print(f"| {name} {version} |", " | ".join([*shown, rate, remarks]), "|", flush=True)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps({"seconds": args.seconds, "point": point.log_prob, "samplers": results}, indent=1))


if __name__ == "__main__":
    main()
