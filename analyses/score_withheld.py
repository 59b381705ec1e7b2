"""Make sealed cases, answer them, open the seals: how good a diagnosis is, beside simpler ways to name a cause.

    python analyses/score_withheld.py --cases 200 --out score [--workers 2] [--laws other] [--excluded end_stop:hertz]

One command for everything: cases are made on the virtual rig and sealed, answered (with baselines from the same
data), scored with intervals, and drawn. What is there already is kept, so an interrupted run goes on. With --seed the
same cases can be made again elsewhere, and are marked as not sealed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bayes_iwan.diagnosis.answer.saved_fits import find_shares
from bayes_iwan.diagnosis.diagnosis import diagnose_case
from bayes_iwan.files import write_json
from bayes_iwan.report.withheld_scores import figures
from bayes_iwan.withheld import scoring
from bayes_iwan.withheld.answering import answer
from bayes_iwan.withheld.sealed import make, read_json, truth_folder


def run(args: argparse.Namespace) -> scoring.Score:
    """Make (unless made), answer (what is not answered) and score."""
    cases = args.out / "cases"
    truth = truth_folder(cases) / "truth.json"
    if not (cases / "commitments.json").is_file():
        make(args.cases, cases, seed=args.seed, laws=args.laws, workers=args.workers)
    made = read_json(truth)
    if made.get("seed") != args.seed or len(made["cases"]) != args.cases:
        raise SystemExit(f"{cases} holds {len(made['cases'])} other cases; use another --out")
    answers = answer(cases, diagnose_case, out=args.out / "answers", seed=0, quick=not args.full, workers=args.workers)
    return scoring.score(cases, truth, answers=answers, find_shares=find_shares, excluded=args.excluded)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, help="make these cases again (not sealed)")
    parser.add_argument("--out", type=Path, default=Path("score"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--laws", choices=("catalogue", "other", "all"), default="all")
    parser.add_argument("--excluded", action="append", default=[], metavar="NAME", help="law or kind not calibrated on")
    parser.add_argument("--full", action="store_true", help="sample the leading explanations too (slow)")
    args = parser.parse_args()
    score = run(args)
    table = score.table()
    print(table)
    failed = read_json(args.out / "answers" / "answers.json")["failed"]
    for name, message in failed.items():
        print(f"failed: {name}: {message}")
    (args.out / "score.txt").write_text(table + "\n")
    write_json(args.out / "score.json", score.as_dict() | {"failed": failed})
    for stem, fig in figures(score).items():
        fig.savefig(args.out / f"{stem}.png", dpi=130)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
