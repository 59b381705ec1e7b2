"""Diagnose campaigns and print what was found, step by step: the library's calls behind `bayes-iwan diagnose`.

    python analyses/diagnose_campaign.py CAMPAIGN [CAMPAIGN ...] --out runs/diagnosis [--quick] [--base no_speed]

Every campaign gets its folder with diagnosis.html, diagnosis.json and figures; a table of all ends the run.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import bayes_iwan as bi
from bayes_iwan.diagnosis.diagnosis import BASES

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaigns", nargs="+", type=Path, metavar="CAMPAIGN")
    parser.add_argument("--out", type=Path, default=Path("runs/diagnosis"))
    parser.add_argument("--base", choices=tuple(BASES), default="generalized")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    rows = []
    for campaign in args.campaigns:
        out = args.out / campaign.name
        answer = bi.diagnose(campaign, out, seed=args.seed, quick=args.quick, base=args.base).to_dict()
        print(f"\n{campaign.name}")
        print("    " + "\n    ".join([*answer["sentences"], *answer["where"]["sentences"]]))
        lead = next((e for e in answer["effects"] if e["name"] == answer["verdict"]["cause"]), {})
        verdict = answer["verdict"]
        rows.append(
            (
                campaign.name,
                answer["gap"]["before_share"],
                verdict["cause"],
                verdict["probability"],
                lead.get("shrink"),
                lead.get("shrink_held_out"),
            )
        )
    print(f"\n{'campaign':28s} {'gap':>7s}  {'cause':28s} {'prob.':>5s} {'shrink':>7s} {'held_out':>7s}")
    for name, share, cause, p, fitted, held_out in rows:
        told = [f"{100 * x:5.0f} %" if x is not None else "      –" for x in (fitted, held_out)]
        print(f"{name:28s} {100 * share:5.1f} %  {cause:28s} {p:5.2f} {told[0]:>7s} {told[1]:>7s}")
