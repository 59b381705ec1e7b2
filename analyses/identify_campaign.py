"""Identify a measured campaign from Python, and look at what the loops determine.

    python analyses/identify_campaign.py [CAMPAIGN] [OUT]
"""

import sys

import bayes_iwan as bi

if __name__ == "__main__":
    campaign = sys.argv[1] if len(sys.argv) > 1 else "../shared/data/rope_spring"
    run = bi.identify(campaign, out=sys.argv[2] if len(sys.argv) > 2 else "results/rope_spring", seed=1)
    for row in run.summary():
        print(f"{row.name:42s} {row.q50:10.4g}  ({row.q05:.4g} to {row.q95:.4g}) {row.unit}")
    print(run.message)
