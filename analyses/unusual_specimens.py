"""How often sound specimens of a batch are called unusual, and how often one that is gets found, by their number.

    python analyses/unusual_specimens.py [--batches N] [--seed N] [--undetermined N]

Batches are drawn as a batch sees them: quantities with spreads between specimens of 2 to 30 % that go together, each
measured with an error of its own, which is up to eight times as large in one specimen as in another. In every other
batch one specimen has one quantity off by so many per cent. Counted: batches with any sound specimen named, found ones,
and the same with what is unusual in two specimens at once. With --undetermined, N quantities of which loops say nothing
are compared too.
"""

from __future__ import annotations

import argparse
from types import SimpleNamespace

import numpy as np

from bayes_iwan.comparison.unusual import rank_unusual

NUMBERS = (3, 4, 5, 6, 8, 12, 20, 50)
#: per cent that one quantity is off, with the spread of that quantity between sound specimens, in per cent
CASES = ((46.0, 3.0), (46.0, 6.0), (20.0, 3.0), (46.0, 10.0))
QUANTITIES = 9


def batch(rng: np.random.Generator, n: int, spread: float | None, undetermined: int) -> dict[str, SimpleNamespace]:
    """Populations of n specimens; spread : of the first quantity, in logarithms (None: drawn as the others')."""
    spreads = np.exp(rng.uniform(np.log(0.02), np.log(0.3), QUANTITIES))
    if spread is not None:
        spreads[0] = spread
    error = spreads * np.exp(rng.uniform(np.log(0.05), np.log(1.0), QUANTITIES))
    common = rng.standard_normal((n, 2)) @ rng.normal(0.0, 0.5, (2, QUANTITIES))
    own = np.sqrt(np.maximum(1.0 - 0.5, 0.0)) * rng.standard_normal((n, QUANTITIES))
    # one specimen had fewer tests than another
    errors = error * np.exp(rng.uniform(np.log(0.5), np.log(4.0), (n, 1)))
    centre = spreads * (common + own) + errors * rng.standard_normal((n, QUANTITIES))
    names = tuple(str(i) for i in range(n))
    columns = [*zip(centre.T, errors.T), *((rng.standard_normal(n), np.ones(n)) for _ in range(undetermined))]
    return {f"q{k}": SimpleNamespace(names=names, centre=x, error=y) for k, (x, y) in enumerate(columns)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--undetermined", type=int, default=0, metavar="N")
    args = parser.parse_args()
    head = "".join(f"  +{off:.0f} % at {spread:.0f} %" for off, spread in CASES)
    print(f"{'specimens':>9s}  sound named {head}  two at once (+{CASES[0][0]:.0f} % at {CASES[0][1]:.0f} %)")
    for n in NUMBERS:
        rng = np.random.default_rng([args.seed, n])
        made = (batch(rng, n, None, args.undetermined) for _ in range(args.batches))
        sound = sum(any(x.notable for x in rank_unusual(one)) for one in made)
        cells = [f"{100 * sound / args.batches:9.1f} %  "]
        for (off, spread), count in [*((c, 1) for c in CASES), (CASES[0], 2)]:
            found = 0
            for _ in range(args.batches // 2):
                made = batch(rng, n, spread / 100, args.undetermined)
                made["q0"].centre[:count] += np.log(1 + off / 100)
                found += sum("q0" in x.notable for x in rank_unusual(made) if int(x.name) < count)
            cells.append(f"{100 * found / count / (args.batches // 2):9.0f} %   ")
        print(f"{n:9d}  {''.join(cells)}", flush=True)


if __name__ == "__main__":
    main()
