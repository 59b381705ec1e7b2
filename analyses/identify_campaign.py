"""Identify a measured campaign from Python, and look at what the loops determine.

    python analyses/identify_campaign.py [CAMPAIGN] [--out runs/rope_spring] [--budget-s 240]

Writes what `bayes-iwan identify` writes, report.html among it, and determined.png: each number against its prior.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import bayes_iwan as bi
from bayes_iwan.report.identification.marginals import prior_posterior_figure
from bayes_iwan.report.style import save

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", metavar="CAMPAIGN", nargs="?", default="data/rope_spring")
    parser.add_argument("--out", type=Path, default=Path("runs/rope_spring"))
    parser.add_argument("--budget-s", type=float, default=240.0, help="seconds of sampling at most")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    run = bi.identify(args.campaign, args.out, config={"sampling": {"budget_s": args.budget_s}}, seed=args.seed)
    for row in run.summary():
        print(f"{row.name:42s} {row.q50:10.4g}  ({row.q05:.4g} to {row.q95:.4g}) {row.unit}")
    print(run.message)
    print(save(prior_posterior_figure(run), args.out / "determined.png"))
