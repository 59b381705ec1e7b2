"""When may a run stop? Rules tried on pieces of one long run, whose whole stands for the truth.

    bayes-iwan identify CAMPAIGN --out RUN --config long.toml     # [sampling] taus = 800, ess = 6000, budget_s = 3000
    python analyses/benchmark_stopping.py RUN
    python analyses/benchmark_stopping.py --simulated 40 --tau 137     # no run: walkers whose truth is known

Any way of sampling: what wrote RUN/chains.ckpt is read from it. A piece begins anywhere in the long run's production
and grows until the rule (R-hat <= 1.01, bulk and tail ESS >= 400, steps >= c autocorrelation times as the piece itself
estimates them, and for proposals by importance Pareto's k < 0.7) lets it stop. Its means and its 5, 50 and 95 %
quantiles are then off from the long run's: told in posterior standard deviations, and in the standard errors that the
piece itself states (of quantiles by the effective size of being below, as Stan has it). A rule is safe whose RMS of
these over pieces and numbers is 1; it is more where pieces stop before they know how long they are. The piece is part
of the whole, so errors are divided by √(1 − share). A star marks the rule that the package asks of this way.

Simulated are as many independent walkers as chains on a manifold have, of two slow numbers that cost nothing, one that
drifts and one that changes between two modes of unequal shares, and a fast one. They start from equal shares of both
modes and count after as many steps as a warm-up has.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bayes_iwan.sampling.common.checkpoint import read_checkpoint
from bayes_iwan.sampling.common.convergence import Convergence, apart, convergence_of, ess_mean
from bayes_iwan.sampling.ensemble.run import STAGES
from bayes_iwan.sampling.independent.importance import METHOD as INDEPENDENT
from bayes_iwan.sampling.independent.weights import untrusted
from bayes_iwan.sampling.manifold.on_manifold import FIRST_CHECK, LEAST_TAUS, WALKERS
from bayes_iwan.sampling.manifold.on_manifold import METHOD as ON_MANIFOLD
from scipy import stats

RULES = (5.0, 10.0, 15.0, 20.0, 30.0, 50.0)
R_HAT, ESS, GROWTH, LEAST = 1.01, 400.0, 1.15, 10
QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Production:
    """Draws (ensembles, stored, walkers, numbers), their names and thinning; log weights (ensembles, stored) of
    proposals by importance, else None; taus : what the package asks of this way; first_check : stored steps after which
    it looks; independent : are the walkers of an ensemble?"""

    draws: np.ndarray
    names: tuple[str, ...]
    thin: int
    log_weight: np.ndarray | None
    taus: float
    first_check: int
    independent: bool = False

    @property
    def stored(self) -> int:
        return int(self.draws.shape[1])

    def piece(self, first: int, length: int) -> np.ndarray:
        """Draws of a piece; proposals as often as their weights say."""
        part = self.draws[:, first : first + length]
        if self.log_weight is None:
            return part
        out = np.empty_like(part)
        for chain, (z, level) in enumerate(zip(part, self.log_weight[:, first : first + length])):
            share = np.cumsum(np.exp(level - level.max()))
            out[chain] = z[np.searchsorted(share, (np.arange(len(z)) + 0.5) / len(z) * share[-1])]
        return out

    def trusted(self, first: int, length: int) -> bool:
        return self.log_weight is None or not untrusted(self.log_weight[:, first : first + length].ravel())


def production(run: Path, ensembles: int) -> Production:
    """What a run has drawn since its adaptation or warm-up."""
    fingerprint, names, snapshot = read_checkpoint(run / "chains.ckpt", ())
    if INDEPENDENT.items() <= fingerprint.items():
        _, names, snapshot = read_checkpoint(run / "chains.ckpt", ("proposals",))
        draws = np.moveaxis(snapshot.draws["proposals"], 0, 1)
        return Production(draws[:, :, None, :-1], tuple(names[:-1]), 1, draws[:, :, -1], 50.0, FIRST_CHECK)
    on_manifold = ON_MANIFOLD.items() <= fingerprint.items()
    _, names, snapshot = read_checkpoint(run / "chains.ckpt", ("production",) if on_manifold else STAGES)
    draws, thin, taus, first = snapshot.draws["production"], 1, LEAST_TAUS, FIRST_CHECK
    if not on_manifold:
        restarts = snapshot.state["restarts"]
        draws, thin, taus = draws[int(restarts[-1]) if len(restarts) else 0 :], int(snapshot.state["thin"]), 50.0
        first = LEAST
    blocks = draws.reshape(len(draws), ensembles, -1, draws.shape[2])
    return Production(np.moveaxis(blocks, 0, 1), tuple(names), thin, None, taus, first, on_manifold)


def simulated(count: int, tau: float, rng: np.random.Generator) -> tuple[Production, np.ndarray]:
    """`count` steps of walkers of autocorrelation time `tau`, and what it is, evenly spread (n, 1, 1, numbers)."""
    share, apart, warm = 0.7, 3.0, 375
    many, most = (stats.norm.ppf((np.arange(n) + 0.5) / n) for n in (20_000, int(20_000 * share)))
    few = stats.norm.ppf((np.arange(20_000 - len(most)) + 0.5) / (20_000 - len(most)))
    truth = np.stack([many, np.concatenate([apart + most, few]), many], axis=1)[:, None, None]
    # P(change) over both directions is the rate at which the modes forget each other: tau is 2 / rate − 1
    rate = 2.0 / (tau + 1.0)
    n = 4 * WALKERS
    out = np.empty((count, n, 3))
    mode, slow, fast = np.arange(n) % 2 == 0, rng.standard_normal(n), rng.standard_normal(n)
    keep = np.array([1.0 - rate, 1.0 - 2.0 / (0.1 * tau + 1.0)])
    for i in range(-warm, count):
        chance = rng.random(n)
        mode = np.where(mode, chance >= rate * (1.0 - share), chance < rate * share)
        slow, fast = (k * x + np.sqrt(1.0 - k * k) * rng.standard_normal(n) for k, x in zip(keep, (slow, fast)))
        if i >= 0:
            out[i] = np.stack([slow, apart * mode + rng.standard_normal(n), fast], axis=1)
    draws = np.moveaxis(out.reshape(count, 4, WALKERS, 3), 0, 1)
    return Production(draws, ("drifts", "two modes", "fast"), 1, None, LEAST_TAUS, FIRST_CHECK, True), truth


def stops(run: Production, first: int) -> dict[float, int]:
    """Stored steps at which each rule would have stopped a run that begins at `first`; rules that never do are left
    out."""
    found: dict[float, int] = {}
    length = run.first_check
    while first + length <= run.stored and len(found) < len(RULES):
        result: Convergence = convergence_of(run.piece(first, length), run.names, run.thin, run.independent)
        for taus in RULES:
            if taus not in found and not result.shortfall(R_HAT, ESS, taus) and run.trusted(first, length):
                found[taus] = length
        length = int(np.ceil(length * GROWTH))
    return found


def errors(piece: np.ndarray, whole: np.ndarray, share: float, independent: bool) -> np.ndarray:
    """(1 + quantiles, 2): of one number's mean and quantiles, how far the piece is off the whole, in posterior standard
    deviations and in standard errors that the piece states. piece, whole : (ensembles, steps, walkers)."""
    sd, values = whole.std(), np.sort(piece.ravel())
    known = np.sqrt(1.0 - share)
    off = [(piece.mean() - whole.mean()) / sd]
    chains = apart(piece) if independent else piece
    stated = [piece.std() / np.sqrt(ess_mean(chains)) / sd]
    for q in QUANTILES:
        at = np.quantile(values, q)
        size = ess_mean((chains <= at).astype(float))
        low, high = stats.beta.ppf(stats.norm.cdf([-1.0, 1.0]), size * q + 1.0, size * (1.0 - q) + 1.0)
        off.append((at - np.quantile(whole, q)) / sd)
        stated.append(0.5 * (np.quantile(values, high) - np.quantile(values, low)) / sd)
    return np.stack([np.array(off) / known, np.array(off) / known / np.array(stated)], axis=1)


def told(tried: list[tuple[Production, int, np.ndarray]]) -> None:
    """The table of all rules, from runs, where a piece of each begins, and what stands for the truth (…, numbers)."""
    rows: dict[float, list[np.ndarray]] = {taus: [] for taus in RULES}
    lengths: dict[float, list[int]] = {taus: [] for taus in RULES}
    for run, first, whole in tried:
        for taus, length in stops(run, first).items():
            piece, share = run.piece(first, length), 0.0 if len(whole) > len(run.draws) else length / run.stored
            numbers = range(len(run.names))
            rows[taus].append(np.stack([errors(piece[..., j], whole[..., j], share, run.independent) for j in numbers]))
            lengths[taus].append(length)
    print(
        "   taus  stopped  steps  RMS error in posterior sd: mean, q05, q50, q95      largest   "
        "in stated standard errors: mean, q05, q50, q95"
    )
    for taus, found in rows.items():
        mark = "*" if taus == tried[0][0].taus else " "
        if not found:
            print(f"{mark} {taus:5.0f} {0:8d}")
            continue
        off = np.stack(found)  # (pieces, numbers, mean and quantiles, unit)
        rms = np.sqrt(np.mean(off**2, axis=(0, 1)))
        print(
            f"{mark} {taus:5.0f} {len(found):8d} {np.median(lengths[taus]) * tried[0][0].thin:6.0f}   "
            f"{' '.join(f'{x:9.3f}' for x in rms[:, 0])}  {np.abs(off[..., 0]).max():11.3f}   "
            f"{' '.join(f'{x:9.2f}' for x in rms[:, 1])}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path, nargs="*", help="folders of long runs")
    parser.add_argument("--pieces", type=int, default=12, help="of each run")
    parser.add_argument("--ensembles", type=int, default=4)
    parser.add_argument("--simulated", type=int, default=0, help="runs of walkers whose truth is known")
    parser.add_argument("--tau", type=float, default=137.0, help="autocorrelation time of these")
    args = parser.parse_args()
    if args.simulated:
        made = []
        for seed in range(args.simulated):
            run, truth = simulated(int(1.5 * max(RULES) * args.tau), args.tau, np.random.default_rng(seed))
            made.append((run, 0, truth))
        told(made)
    for folder in args.run:
        run = production(folder, args.ensembles)
        whole = run.piece(0, run.stored)
        result = convergence_of(whole, run.names, run.thin, run.independent)
        print(
            f"{folder}: {result.n_steps} steps, {result.n_steps / result.worst_tau:.0f} autocorrelation times of the "
            f"slowest number, least ESS {result.least_ess:.0f}, R-hat {result.worst_r_hat:.4f}"
        )
        told([(run, first, whole) for first in np.linspace(0, 0.7 * run.stored, args.pieces).astype(int)])


if __name__ == "__main__":
    main()
