"""Make sealed cases, answer them, open the seals: what a diagnosis is worth, beside simpler ways to name a cause.

    python analyses/score_withheld.py --cases 200 --seed 7 --out score [--workers 2]

One command for everything: cases are made on the virtual rig and sealed, answered (with baselines from the same
data), scored with intervals, and drawn. What is there already is kept, so an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from bayes_iwan import executors
from bayes_iwan.gap.diagnosis import write_json
from bayes_iwan.gap.saved_fits import find_shrink
from bayes_iwan.report.score_figures import figures
from bayes_iwan.validation import scoring
from bayes_iwan.validation import sealed as withheld
from bayes_iwan.validation.baselines import NAMES, diagnose_with_baselines


def read_baselines(answers: Path, cases: list[str]) -> dict[str, dict[str, dict]]:
    """Answers of each baseline by name and case, from the files beside the diagnoses."""
    out: dict[str, dict[str, dict]] = {name: {} for name in NAMES}
    for case in cases:
        path = answers / case / "baselines.json"
        if path.is_file():
            for name, answer in json.loads(path.read_text()).items():
                out[name][case] = answer
    return out


def run(n: int, seed: int, out: Path, workers: int, full: bool = False) -> scoring.Score:
    """Make (unless made), answer (what is not answered) and score."""
    cases = out / "cases"
    truth = withheld.truth_folder(cases) / "truth.json"
    with executors.opened(workers) as executor:
        if not (cases / "commitments.json").is_file():
            withheld.make(n, seed, cases, executor=executor)
        made = withheld.read_json(truth)
        if made["seed"] != seed or len(made["cases"]) != n:
            raise SystemExit(f"{cases} holds {len(made['cases'])} cases of seed {made['seed']}; use another --out")
        answers = withheld.answer(
            cases, diagnose_with_baselines, out=out / "answers", seed=seed, quick=not full, executor=executor
        )
    return scoring.score(
        cases,
        truth,
        answers=answers,
        find_shrink=find_shrink,
        seed=seed,
        baselines=read_baselines(out / "answers", withheld.case_names(cases)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("score"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--full", action="store_true", help="sample the leading explanations too (slow)")
    args = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # of the workers: they share the machine by cases
    score = run(args.cases, args.seed, args.out, args.workers, args.full)
    table = score.table()
    print(table)
    failed = withheld.read_json(args.out / "answers" / "answers.json")["failed"]
    for name, message in failed.items():
        print(f"failed: {name}: {message}")
    (args.out / "score.txt").write_text(table + "\n")
    write_json(args.out / "score.json", score.as_dict() | {"failed": failed})
    for stem, fig in figures(score).items():
        fig.savefig(args.out / f"{stem}.png", dpi=130)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
