"""Does an answer hang on the seed? The same quick diagnosis by several seeds, side by side.

    python analyses/seed_spread.py CAMPAIGN [CAMPAIGN ...] [--seeds 3]

Prints what each seed names with its probability and share of the gap, how far probabilities lie apart, and what a
diagnosis costs in processor seconds of one process (the first one's kernels are compiled beforehand).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.diagnosis import diagnose_campaign
from bayes_iwan.executors import serial

#: probabilities below this with every seed are not listed
LEAST = 0.2


def told(found: Diagnosis) -> str:
    """The kind of a diagnosis and what it names."""
    causes = [f"{c.name} ({c.probability:.2f}, {100.0 * c.share.value:.0f} %)" for c in found.verdict.causes]
    either = ["one of " + "/".join(x.names) + f" ({x.probability:.2f})" for x in found.verdict.one_of]
    return f"{found.verdict.kind}: " + (", ".join(causes + either) or "nothing named")


def spread(campaign: Path, seeds: int) -> None:
    print(campaign.name)
    stated: dict[str, list[float]] = {}
    for seed in range(seeds):
        began = time.process_time()
        found = diagnose_campaign(campaign, seed=seed, quick=True, progress=False)
        took = time.process_time() - began
        print(f"  seed {seed}: {told(found)}; {len(found.search.fits)} sets fitted, {took:.1f} processor s")
        for name, p in found.verdict.probabilities.items():
            stated.setdefault(name, []).append(p)
    for name, p in sorted(stated.items(), key=lambda item: -max(item[1])):
        if max(p) >= LEAST:
            print(f"  {name:32s} {min(p):.2f} to {max(p):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaigns", nargs="+", type=Path, metavar="CAMPAIGN")
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    with serial():
        diagnose_campaign(args.campaigns[0], quick=True, progress=False)
        for campaign in args.campaigns:
            spread(campaign, args.seeds)


if __name__ == "__main__":
    main()
