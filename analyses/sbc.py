"""Simulation-based calibration: are the posterior's probabilities right when the model and its prior are?

    python analyses/sbc.py --draws 200 --out sbc [--from-truth] [--likelihoods correlated gaussian laplace]

Numbers are drawn from the prior, loops from the model and the likelihood at these numbers, and the posterior of the
loops is sampled. Then the true value's rank among the posterior's draws is uniform (Talts et al., arXiv 1804.06788).
Motions are those of a real campaign, on 33 samples and 16 harmonics a loop: just as many numbers as samples, so every
likelihood generates data as it says. The sampler starts from optima that it finds itself, never from the truth; runs
that had not converged in their budget count like the others and are told. It takes half a minute a posterior.

--from-truth asks less and is exact. The truth is one draw of its posterior. Chains that leave the posterior as it is
lead from it to others, exchangeable with it, whether they have time to converge or not, so ranks are uniform if
likelihood, its density and the chains' steps are right (Besag & Clifford, Biometrika 76, 1989, 633; Gandy & Scott,
arXiv 2001.06465). What it cannot see is a mode that the search misses, or a chain that stops too early.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats
from threadpoolctl import threadpool_limits

from bayes_iwan.campaign import average, read_campaign
from bayes_iwan.files import write_json
from bayes_iwan.inference.setup.likelihood import KINDS
from bayes_iwan.inference.setup.marginal import Marginal
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import loop_quantities
from bayes_iwan.inference.setup.settings import SamplingSettings, SearchSettings
from bayes_iwan.inference.solving.point import Point, find_point, near_optima
from bayes_iwan.inference.solving.posterior_draws import QUICK, Run, sampled
from bayes_iwan.sampling.blocks import Places, advanced, generator
from bayes_iwan.sampling.proposals import learnt_moves
from runs import each

#: draws of each posterior among which the truth is ranked: ranks 0 to 63 make equal bins
RANKED = 63
#: steps from the truth to the hub, and from there on
STEPS = 60
SAMPLES, HARMONICS = 33, 16
WATCHED = (
    *(
        "kp_N_mm",
        "k1_N_mm",
        "elasticity",
        "mean_slip_force_N",
        "slip_ratio_21",
        "eta1",
        "share_1",
        "normal_force_slope",
        "beta",
    ),
    *(
        "noise_N",
        "noise_scale",
        "discrepancy_odd",
        "discrepancy_even",
        "stiffness_exponent",
        "slip_deviation1",
        "slip_larger4",
    ),
)


def watched(problem: Problem, z: np.ndarray) -> dict[str, np.ndarray]:
    """Quantities (draws,) each: some of the model's and the noise's numbers, the likelihood, energy of each test."""
    values = problem.prior.values(z)
    out = {n: values[n] for n in WATCHED if n in values} | {"log_likelihood": problem.log_likelihood(z)}
    energy = loop_quantities(problem.motion.displacement_mm, problem.predict(z)).energy_mJ
    return out | {f"energy[{x.file.split('.csv')[0]}]": energy[:, t] for t, x in enumerate(problem.loops)}


def short_posterior(
    problem: Problem, point: Point, seed: int, settings: SamplingSettings
) -> tuple[np.ndarray, dict[str, Any]]:
    """(draws, ndim) of the posterior from the package's own sampling, started at the optima of its own search."""
    began = time.process_time()
    with threadpool_limits(limits=1, user_api="blas"):
        chains = sampled(problem, near_optima(point.optima, point.optima_log_prob), settings, Run(seed))
    draws = chains.draws.reshape(-1, problem.ndim)
    c = chains.convergence
    told = {
        "converged": bool(chains.converged),
        "steps": int(chains.n_steps),
        "cpu_s": time.process_time() - began,
        "r_hat": float(np.max(c.r_hat)) if c is not None else None,
        "ess": float(c.least_ess) if c is not None else None,
    }
    return draws, told


def found_point(problem: Problem, seed: int) -> Point:
    """The package's own point estimate."""
    return find_point(problem, seed, SearchSettings(), progress=False)


def from_truth(problem: Problem, truth: np.ndarray, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
    """RANKED places (RANKED, ndim) that are exchangeable with the truth (1, ndim) where all is right.

    The moves are learnt from the data alone, from the optima that the search finds; then they are frozen. From the
    truth some steps lead to a hub, for a step is a reversible one chosen at random; from there as many lead each
    of RANKED walkers on.
    """
    began = time.process_time()
    point = found_point(problem, seed)
    density = Marginal(problem).density
    with threadpool_limits(limits=1, user_api="blas"):
        optima = near_optima(point.optima, point.optima_log_prob)
        found = sampled(problem, optima, replace(SamplingSettings(), **QUICK), Run(seed))
        random = generator((seed, 37))
        known = density.apart(found.draws.reshape(-1, problem.ndim))
        moves = learnt_moves(known[random.permutation(len(known))[:4000]], density.blocks, random)

        def led(x: np.ndarray, stream: int) -> tuple[Places, float]:
            at = density(x, random)
            return advanced((density, moves, STEPS), (Places(x, at[:, 1:], at[:, 0]), (seed, 36, stream)))

        hub, _ = led(density.apart(truth), 0)
        ends, accepted = led(np.repeat(hub.x[-1], RANKED, axis=0), 1)
    return density.whole(ends.x[-1], ends.drawn[-1]), {"accepted": accepted, "cpu_s": time.process_time() - began}


def even(draws: np.ndarray, n: int) -> np.ndarray:
    """n of the draws, far apart in the chains."""
    return draws[np.linspace(0, len(draws) - 1, n).round().astype(int)]


def one_draw(
    campaign: Path,
    tests: list[int],
    kind: str,
    seed: int,
    index: int,
    slip: str,
    embedded: bool,
    settings: SamplingSettings | None,
) -> dict[str, Any]:
    """Draw, generate, identify: rank of every watched quantity; settings None: from the truth."""
    whole = read_campaign(campaign)
    some = replace(whole, tests=tuple(whole.tests[i] for i in tests))
    loops = [average(x, n_phase=SAMPLES, n_harmonics=HARMONICS) for x in some.tests]
    problem = make_problem(loops, {"likelihood": {"kind": kind}, "model": {"slip": slip, "embedded": embedded}})
    rng = np.random.default_rng([seed, index, KINDS.index(kind)])
    truth = problem.prior.draw(rng, 1)
    while not np.isfinite(problem.log_prob(truth)[0]):  # the prior is that of models that can be computed
        truth = problem.prior.draw(rng, 1)
    force = problem.predict(truth)
    # the mean's noise floor goes by a loop's swing, so the generator must be of loops like these
    maker = problem.with_force(force[0])
    drawn = problem.with_force(maker.likelihood.replicate(force, maker.parameter_values(truth), rng)[0])
    own = int(rng.integers(2**31))
    draws, told = (
        from_truth(drawn, truth, own)
        if settings is None
        else short_posterior(drawn, found_point(drawn, own), own, settings)
    )
    at, there = watched(problem, truth), watched(problem, even(draws, RANKED))
    # chains that have not left the truth are as likely above as below it
    rank = {n: int(np.sum(there[n] < at[n]) + rng.integers(np.sum(there[n] == at[n]) + 1)) for n in at}
    return {"index": index, "rank": rank, **told}


def uniformity(ranks: np.ndarray, bins: int = 8) -> dict[str, float]:
    """p values of uniform ranks (n,) in 0..RANKED: χ² over bins, and the largest distance of the ECDF."""
    counts = np.bincount(ranks * bins // (RANKED + 1), minlength=bins)
    middle = (ranks + 0.5) / (RANKED + 1)
    return {"chi2_p": float(stats.chisquare(counts).pvalue), "ecdf_p": float(stats.kstest(middle, "uniform").pvalue)}


def figure(ranks: dict[str, dict[str, list[int]]], bins: int = 8) -> Figure:
    """Rank histograms by likelihood (rows) and quantity (columns), with the band that 99 % of bins fall in."""
    names = list(dict.fromkeys(n for r in ranks.values() for n in r))
    fig = Figure(figsize=(1.75 * len(names) + 0.8, 1.7 * len(ranks) + 0.7), layout="constrained")
    axes = fig.subplots(len(ranks), len(names), squeeze=False, sharex=True)
    for row, (kind, by_name) in zip(axes, ranks.items()):
        for ax, name in zip(row, names):
            if name not in by_name:
                ax.set_axis_off()
                continue
            r = np.array(by_name[name])
            low, high = stats.binom.ppf([0.005, 0.995], len(r), 1.0 / bins)
            ax.axhspan(low, high, color="#dde6f0")
            ax.axhline(len(r) / bins, color="#888888", lw=0.8)
            ax.bar(np.arange(bins) + 0.5, np.bincount(r * bins // (RANKED + 1), minlength=bins), 0.92, color="#2266aa")
            ax.set_title(f"{name}\np = {uniformity(r)['ecdf_p']:.2f}", fontsize=7)
            ax.tick_params(labelsize=6)
            ax.set_xticks([0, bins / 2, bins], ["0", "½", "1"])
        row[0].set_ylabel(f"{kind}\nruns ({len(next(iter(by_name.values())))})", fontsize=8)
    fig.supxlabel(
        "rank of the truth among the posterior's draws, as a share; band: 99 % of bins if calibrated", fontsize=8
    )
    return fig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20, help="prior draws for each likelihood (200 for a full check)")
    parser.add_argument("--campaign", type=Path, default=Path("data/rope_spring"), help="whose motions are used")
    parser.add_argument("--tests", type=int, nargs="+", default=[0, 4, 8], help="numbers of its tests, from 0")
    parser.add_argument("--likelihoods", nargs="+", choices=KINDS, default=["correlated"])
    parser.add_argument("--slip", default="gamma3", help="family of slip forces")
    parser.add_argument("--embedded", action="store_true", help="with the embedded model error")
    parser.add_argument("--from-truth", action="store_true", help="exact ranks from chains that start at the truth")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of sampling for each posterior, at most")
    parser.add_argument("--ess", type=float, default=400.0, help="effective draws of each posterior, at least")
    parser.add_argument("--r-hat", type=float, default=1.01, help="R-hat of each posterior, at most")
    parser.add_argument("--taus", type=float, default=50.0, help="autocorrelation times of each posterior, at least")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("sbc"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    args = parser.parse_args()
    settings = SamplingSettings(budget_s=args.budget, ess=args.ess, r_hat=args.r_hat, taus=args.taus)
    way = "_from_truth" if args.from_truth else f"_ess{args.ess:g}"
    ranks: dict[str, dict[str, list[int]]] = {}
    result: dict[str, Any] = {"settings": {k: str(v) for k, v in vars(args).items()}, "likelihoods": {}}
    for kind in args.likelihoods:
        jobs = [
            (
                args.out
                / "draws"
                / f"{kind}_{args.slip}{'_embedded' if args.embedded else ''}{way}_{args.seed}_{i:03d}.json",
                one_draw,
                args.campaign,
                args.tests,
                kind,
                args.seed,
                i,
                args.slip,
                args.embedded,
                None if args.from_truth else settings,
            )
            for i in range(args.draws)
        ]
        runs = list(each(jobs, args.workers, kind))
        ranks[kind] = {n: [r["rank"][n] for r in runs] for n in runs[0]["rank"]}
        tests = {n: uniformity(np.array(r)) for n, r in ranks[kind].items()}
        late = [r for r in runs if not r.get("converged", True)]  # from the truth none has to
        worst = min(t["ecdf_p"] for t in tests.values()) * len(tests)
        print(
            f"{kind}: {len(runs)} posteriors, {len(late)} short of convergence; smallest p, corrected for "
            f"{len(tests)} quantities: {min(worst, 1.0):.2f}"
        )
        for n, t in tests.items():
            inside = np.mean([0.05 <= (r + 0.5) / (RANKED + 1) <= 0.95 for r in ranks[kind][n]])
            print(
                f"  {n:28s} chi2 p {t['chi2_p']:.3f}   ECDF p {t['ecdf_p']:.3f}   in 90 % interval "
                f"{100 * inside:.0f} %",
                flush=True,
            )
        result["likelihoods"][kind] = {
            "tests": tests,
            "ranks": ranks[kind],
            "short_of_convergence": len(late),
            "runs": [{k: v for k, v in r.items() if k != "rank"} for r in runs],
        }
        write_json(args.out / "sbc.json", result)
    figure(ranks).savefig(args.out / "sbc.png", dpi=130)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
