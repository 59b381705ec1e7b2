"""What a small smooth discrepancy does to intervals, with independent errors and with a correlated discrepancy.

Campaigns are simulated that the model does not quite explain: to the loops of known numbers (one gamma of slip
forces, so that Laplace's approximation holds and the trial is of the likelihoods alone) a smooth discrepancy is added,
a random sum of harmonics 1 to 6 of RMS `SHARE` of the friction force (not the discrepancy model's own spectrum), and
the noise of the records. Half the discrepancy's variance is shared by the tests of one amplitude, at all frequencies,
much as the likelihood supposes; with --all it is shared by all tests, and the errors of kp and k(1) average out less
than that. Each campaign is fitted under three likelihoods, and it is counted how often the 90 % interval (Laplace's
approximation at the most probable point) of kp, k(1) and the mean slip force holds the known number. Independent
errors take the discrepancy for so many independent errors and cover far too rarely.

    python analyses/coverage_discrepancy.py [CAMPAIGNS] [--all]
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import stats

from bayes_iwan.inference.setup.loop_error import friction_level_N
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.solving.point import laplace_scale, most_probable
from point_recovery import known_loops

SHARE = 0.02
WANTED = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N")


def discrepancy(problem: Problem, rng: np.random.Generator, by_amplitude: bool = True) -> np.ndarray:
    """(tests, samples) N: smooth, of RMS SHARE · friction level, half its variance shared between tests."""
    phase = problem.loops[0].phase
    order = np.arange(1, 7)
    size = 1.0 / order
    size /= np.sqrt(np.sum(size**2))

    def smooth() -> np.ndarray:
        c = rng.standard_normal((2, order.size)) * size
        angle = 2.0 * np.pi * order[:, None] * phase
        return c[0] @ np.cos(angle) + c[1] @ np.sin(angle)

    groups = [round(x.amplitude_mm, 2) if by_amplitude else 0.0 for x in problem.loops]
    common = {group: smooth() for group in sorted(set(groups))}
    level = friction_level_N(problem.loops)
    return np.stack([SHARE * x * (common[g] + smooth()) / np.sqrt(2.0) for x, g in zip(level, groups)])


TRUE = {
    "kp_N_mm": 5.49,
    "force_zero_N": 0.0,
    "k1_N_mm": 14.45,
    "elasticity": 0.7,
    "mean_slip_force_N": 1.2,
    "eta1": 2.0,
    "normal_force_slope": 0.33,
    "normal_force_rate": 0.08,
    "beta": 0.6,
}


def true_z(problem: Problem) -> np.ndarray:
    """Coordinates (1, ndim) of TRUE; those of the noise at their prior medians."""
    noise = {p.name: p.value(np.zeros(1)) for p in problem.likelihood.parameters}
    return problem.prior.scores({k: np.array([v]) for k, v in TRUE.items()} | noise)


def covered(problem: Problem, start: np.ndarray, truth: np.ndarray) -> tuple[list[bool], list[float]]:
    """Whether each wanted number's 90 % interval holds the truth, and the interval's half width in z."""
    optima, _, _ = most_probable(problem, start)
    spread = np.sqrt(np.sum(laplace_scale(problem, optima[0]) ** 2, axis=1))
    columns = [problem.names.index(n) for n in WANTED]
    half = 1.6449 * spread[columns]
    return (np.abs(optima[0][columns] - truth[0, columns]) <= half).tolist(), half.tolist()


def coverage(
    campaigns: int,
    kinds: tuple[str, ...] = ("correlated", "gaussian", "laplace"),
    seed: int = 0,
    progress: bool = True,
    by_amplitude: bool = True,
) -> dict[str, np.ndarray]:
    """Which intervals held the truth, (campaigns, wanted) booleans by likelihood."""
    loops = known_loops(0.02)
    templates = {
        kind: make_problem(loops, {"model": {"slip": "gamma1", "embedded": False}, "likelihood": {"kind": kind}})
        for kind in kinds
    }
    out: dict[str, list] = {kind: [] for kind in kinds}
    first = templates[kinds[0]]
    exact = first.predict(true_z(first))[0]
    for k in range(campaigns):
        rng = np.random.default_rng([seed, k])
        force = exact + discrepancy(first, rng, by_amplitude)
        for loop, row in zip(first.loops, force):
            c = rng.standard_normal((2, loop.noise_N.size)) * loop.noise_N
            angle = 2.0 * np.pi * np.arange(loop.noise_N.size)[:, None] * loop.phase
            row += c[0] @ np.cos(angle) + c[1] @ np.sin(angle)
        for kind, template in templates.items():
            truth = true_z(template)
            out[kind].append(covered(template.with_force(force), truth, truth)[0])
        if progress:
            print(
                f"campaign {k + 1}: "
                + "; ".join(f"{kind} {''.join('+-'[not x] for x in out[kind][-1])}" for kind in kinds),
                flush=True,
            )
    return {kind: np.array(rows) for kind, rows in out.items()}


def clopper_pearson(hits: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Exact interval of a proportion."""
    tail = 0.5 * (1.0 - level)
    low = 0.0 if hits == 0 else float(stats.beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(stats.beta.ppf(1.0 - tail, hits + 1, n - hits))
    return low, high


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaigns", nargs="?", type=int, default=60)
    parser.add_argument("--all", action="store_true", help="share half the discrepancy among all tests")
    args = parser.parse_args()
    n = args.campaigns
    for kind, hits in coverage(n, by_amplitude=not args.all).items():
        for name, count in zip(WANTED, hits.sum(axis=0)):
            low, high = clopper_pearson(int(count), n)
            print(f"{kind:10s} {name:18s} covered in {count} of {n} ({100 * low:.0f} to {100 * high:.0f} %)")
