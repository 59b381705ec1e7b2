"""When may a run stop? Rules tried on pieces of one long run, whose whole stands for the truth.

    bayes-iwan identify CAMPAIGN --out RUN --config long.toml     # [sampling] taus = 400, budget_s = 500
    python analyses/benchmark_stopping.py RUN

A piece begins anywhere in the long run's production and grows until the rule (R-hat <= 1.01, bulk and tail ESS >= 400,
and steps >= c autocorrelation times as the piece itself estimates them) lets it stop. Its means are then off from the
long run's by some of the standard errors that its own effective sizes claim: their RMS over pieces and numbers is 1
where the rule is safe, and more where pieces stop before they know how long they are. The ESS that the long run would
have given the piece (its own share of the whole's) stands beside the claimed one.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bayes_iwan.sampling.checkpoint import read_checkpoint
from bayes_iwan.sampling.convergence import convergence_of, ess_mean
from bayes_iwan.sampling.run import STAGES

RULES = (5.0, 10.0, 15.0, 20.0, 30.0, 50.0)
R_HAT, ESS, GROWTH, LEAST = 1.01, 400.0, 1.15, 10


def production(run: Path, ensembles: int) -> tuple[np.ndarray, int, tuple[str, ...]]:
    """Draws (ensembles, stored, walkers, numbers) after the last restart, their thinning, and the numbers' names."""
    _, names, snapshot = read_checkpoint(run / "chains.ckpt", STAGES)
    restarts = snapshot.state["restarts"]
    draws = snapshot.draws["production"][int(restarts[-1]) if len(restarts) else 0 :]
    blocks = draws.reshape(len(draws), ensembles, -1, draws.shape[2])
    return np.moveaxis(blocks, 0, 1), int(snapshot.state["thin"]), names


def stops(piece: np.ndarray, names: tuple[str, ...], thin: int) -> dict[float, int]:
    """Stored steps at which each rule would have stopped a run that is this piece; rules that never do are left out."""
    found: dict[float, int] = {}
    length = LEAST
    while length <= piece.shape[1]:
        result = convergence_of(piece[:, :length], names, thin)
        for taus in RULES:
            if taus not in found and not result.shortfall(R_HAT, ESS, taus):
                found[taus] = length
        if len(found) == len(RULES):
            break
        length = int(np.ceil(length * GROWTH))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path, nargs="+", help="folders of long runs")
    parser.add_argument("--pieces", type=int, default=12, help="of each run")
    parser.add_argument("--ensembles", type=int, default=4)
    args = parser.parse_args()
    rows: dict[float, list[tuple[float, float, float, float]]] = {taus: [] for taus in RULES}
    for run in args.run:
        draws, thin, names = production(run, args.ensembles)
        truth, sd = draws.mean(axis=(0, 1, 2)), draws.std(axis=(0, 1, 2))
        whole = np.array([ess_mean(draws[..., j]) for j in range(len(names))])
        result = convergence_of(draws, names, thin)
        print(
            f"{run}: {thin * draws.shape[1]} steps, {result.n_steps / result.worst_tau:.0f} autocorrelation times "
            f"of the slowest number, least ESS {result.least_ess:.0f}, R-hat {result.worst_r_hat:.4f}"
        )
        for first in np.linspace(0, 0.7 * draws.shape[1], args.pieces).astype(int):
            for taus, length in stops(draws[:, first:], names, thin).items():
                piece = draws[:, first : first + length]
                claimed = np.array([ess_mean(piece[..., j]) for j in range(len(names))])
                share = length / draws.shape[1]
                # the piece is part of the whole that stands for the truth, so less of its error is seen
                error = (piece.mean(axis=(0, 1, 2)) - truth) / sd * np.sqrt(claimed / (1.0 - share))
                worth = (claimed / (share * whole)).max()
                rows[taus].append((length * thin, float(np.mean(error**2)), float(claimed.min()), float(worth)))
    print(" taus  stopped  steps (median)  RMS error in claimed standard errors  least ESS claimed  largest claim/true")
    for taus, found in rows.items():
        if not found:
            print(f"{taus:5.0f}        0")
            continue
        steps, square, least, worth = np.array(found).T
        print(
            f"{taus:5.0f} {len(found):8d} {np.median(steps):15.0f} {np.sqrt(square.mean()):37.2f} "
            f"{np.median(least):18.0f} {np.median(worth):18.2f}"
        )


if __name__ == "__main__":
    main()
