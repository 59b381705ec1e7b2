"""Which model predicts what it has not seen: families of the paper and other models, ranked by evidence and not by eye.

python analyses/compare_models.py CAMPAIGN --out compare.png [--families gamma3 gamma2 no_speed]
"""

from __future__ import annotations

import argparse

from bayes_iwan.comparison.families import FAMILIES, compare_families
from bayes_iwan.report.comparison_page import ranking_figure
from bayes_iwan.report.style import save

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", metavar="CAMPAIGN")
    parser.add_argument("--families", nargs="+", metavar="NAME", help=f"of {', '.join(FAMILIES)}")
    parser.add_argument("--by", choices=("auto", "loo", "tests"), default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="compare.png")
    args = parser.parse_args()
    result = compare_families(args.campaign, args.families, seed=args.seed, by=args.by)
    for row in result.rows():
        print(
            f"{row.label:48s} {row.difference:+9.1f} ± {row.difference_se:6.1f}   residual "
            f"{100 * row.residual_share:5.2f} %   {row.parameters:2d} parameters   {row.seconds:4.0f} s"
        )
    for question, answer in result.answers():
        print(f"{question} {answer}")
    save(ranking_figure(result), args.out)
    print(args.out)
