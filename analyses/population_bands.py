"""What share of simulated batches the bands of a batch hold, and of specimens the values shrunk towards their lot.

    python analyses/population_bands.py [--batches N] [--seed N]

A batch is n specimens whose quantity is lognormal, with a spread between them and an error of each one's own, in units
of the spread; draws are those of the posterior of a specimen alone under a wide prior. Counted are 90 % intervals:
typical value, spread, a further specimen, a specimen's own value alone and shrunk (where the weights may be trusted),
with the median of shrunk over own width; and the share of specimens that may be shrunk.
"""

from __future__ import annotations

import argparse

import numpy as np

from bayes_iwan.comparison.shrinkage import shrunk
from bayes_iwan.inference.results.population import SpecimenDraws, population

NUMBERS, SPREADS, ERRORS = (3, 5, 8, 20), (0.03, 0.2), (0.3, 1.0, 3.0)
DRAWS, PRIOR_SD = 600, 1.0


def counted(rng: np.random.Generator, n: int, spread: float, error: float, batches: int) -> list[float]:
    """Shares of 90 % intervals that hold, and how much narrower shrunk ones are."""
    held: list[list[float]] = [[] for _ in range(7)]
    for _ in range(batches):
        typical = rng.normal(0.0, PRIOR_SD / 3)
        truth = typical + spread * rng.standard_normal(n + 1)
        sd = error * spread
        seen = truth[:n] + sd * rng.standard_normal(n)
        shrink = PRIOR_SD**2 / (PRIOR_SD**2 + sd**2)  # of the normal posterior under the normal prior
        made = [
            SpecimenDraws(
                str(i),
                np.exp(shrink * seen[i] + np.sqrt(shrink) * sd * rng.standard_normal(DRAWS)),
                np.exp(PRIOR_SD * rng.standard_normal(DRAWS)),
            )
            for i in range(n)
        ]
        found = population(made, int(rng.integers(2**31)))
        assert found is not None
        _, low, high = found.typical
        held[0].append(low <= np.exp(typical) <= high)
        held[1].append(found.spread[1] <= spread <= found.spread[2])
        held[2].append(found.next_specimen[0] <= np.exp(truth[n]) <= found.next_specimen[1])
        for i, one in enumerate(shrunk(made, found).values()):
            low, high = np.quantile(made[i].draws, [0.05, 0.95])
            held[3].append(low <= np.exp(truth[i]) <= high)
            held[6].append(one.usable)
            if one.usable:
                held[4].append(one.q05 <= np.exp(truth[i]) <= one.q95)
                held[5].append((one.q95 - one.q05) / (high - low))
    return [*(100 * float(np.mean(x)) if x else np.nan for x in held[:5]), float(np.median(held[5] or [np.nan])),
            100 * float(np.mean(held[6]))]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("n, spread, error/spread:  typical  spread  further  own  shrunk (%)  width, shrunk/own  usable (%)")
    for n in NUMBERS:
        for spread in SPREADS:
            for error in ERRORS:
                rng = np.random.default_rng([args.seed, n, int(1000 * spread), int(10 * error)])
                a = counted(rng, n, spread, error, args.batches)
                print(f"{n:2d}  {spread:.2f}  {error:.1f}  " + "  ".join(f"{x:5.0f}" for x in a[:5])
                      + f"  {a[5]:.2f}  {a[6]:.0f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
