"""Answer the sealed cases: diagnose every campaign of a withheld folder and ship campaigns, commitments and answers.

    python analyses/answer_sealed.py ../shared/data/withheld_2 data/withheld_2 --workers 2

Quick diagnoses, seed 0. The truths are not here; nothing in the code knows a case. Resumable (work in
runs/sealed/SOURCE's name).
"""

from __future__ import annotations

import argparse
import gzip
import json
import shutil
from pathlib import Path

from bayes_iwan.diagnosis.diagnosis import diagnose_case
from bayes_iwan.withheld.answering import answer
from bayes_iwan.withheld.answers import read_answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="folder with the sealed campaigns and commitments.json")
    parser.add_argument("target", type=Path, help="folder to ship them in")
    parser.add_argument("--work", type=Path, help="folder of the single diagnoses (runs/sealed/NAME)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    work = args.work or Path("runs/sealed") / args.source.resolve().name
    answers = answer(args.source, diagnose_case, out=work, seed=args.seed, quick=True, workers=args.workers)
    content = json.loads(answers.read_text())
    if content["failed"]:
        raise SystemExit(f"not answered: {content['failed']}")
    args.target.mkdir(parents=True, exist_ok=True)
    shutil.copy(args.source / "commitments.json", args.target / "commitments.json")
    for case in sorted(content["answers"]):
        ship(args.source / case, args.target / case)
    short = {
        case: {k: one[k] for k in ("schema", "verdict", "probabilities", "unexplained", "gap") if k in one}
        for case, one in sorted(content["answers"].items())
    }
    (args.target / "answers.json").write_text(json.dumps(short, indent=1) + "\n")
    for case, one in short.items():
        said = read_answer(case, one)
        named = ", ".join(f"{c.name} {c.probability:.2f}" for c in said.causes) or "-"
        alike = ", ".join(sorted(said.in_sets - said.names))
        print(f"{case}  {said.kind:17s} {named:60s} gap {100 * one['gap']['before_share']:.1f} %  with: {alike}")


def ship(source: Path, target: Path) -> None:
    """Copy a campaign with its records compressed; the same bytes each time."""
    target.mkdir(exist_ok=True)
    toml = (source / "campaign.toml").read_text()
    for record in sorted(source.glob("*.csv.gz")):
        shutil.copy(record, target / record.name)
    for record in sorted(source.glob("*.csv")):
        (target / f"{record.name}.gz").write_bytes(gzip.compress(record.read_bytes(), mtime=0))
        toml = toml.replace(f'"{record.name}"', f'"{record.name}.gz"')
    (target / "campaign.toml").write_text(toml)


if __name__ == "__main__":
    main()
