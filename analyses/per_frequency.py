"""Each frequency alone beside all tests together: which numbers wander, and by more than the errors allow?

    python analyses/per_frequency.py RUN --out per_frequency.png

RUN is a folder that `bayes-iwan identify` wrote. Frequencies that `--per-test` has not identified get short runs.
"""

from __future__ import annotations

import argparse

import bayes_iwan as bi
from bayes_iwan.comparison.frequencies import compare_frequencies
from bayes_iwan.report.identification.by_frequency import wander_figure, wander_rows
from bayes_iwan.report.style import save

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("--quick", action="store_true", help="one least-squares step for each frequency, no runs")
    parser.add_argument("--out", default="per_frequency.png")
    args = parser.parse_args()
    found = compare_frequencies(bi.load(args.run), args.run, run=not args.quick)
    print(found.statement())
    if found.checks:
        columns, rows = wander_rows(found)
        for row in [columns, *rows]:
            print("  ".join(f"{cell:28s}" for cell in row).rstrip())
        save(wander_figure(found), args.out)
        print(args.out)
