"""Commands of the withheld protocol: make cases with hidden causes, answer them, score the answers."""

import argparse
import os

from bayes_iwan.cli.command import SEED, STOP_AT_REFITS, argument, command, given, say, several, workers

DIRECTORY = argument("directory", metavar="DIR", help="folder that `withheld make` wrote")


@command(
    "withheld make",
    "draw cases with hidden causes on the virtual rig and seal their truths",
    argument("n", metavar="N", type=int, help="number of cases"),
    argument("--seed", metavar="S", type=int, help="development cases that can be made again: marked as not sealed"),
    argument("--out", metavar="DIR", required=True, help="folder for the cases; made if need be"),
    argument("--laws", choices=("catalogue", "other", "all"), default="all", help="laws of the causes (default: all)"),
    several("--exclude-law", "NAME:LAW", "a law that is not drawn"),
    several("--exclude-outside", "NAME", "an unlisted cause not drawn"),
    workers(),
    examples=("bayes-iwan withheld make 20 --out cases",),
)
def run_make(args: argparse.Namespace) -> None:
    from bayes_iwan.withheld.sealed import make

    options = {"excluded_laws": args.exclude_law, "excluded_outside": args.exclude_outside}
    truth = make(args.n, args.out, **given(args, "seed laws workers"), **options)
    say(f"truths are in {truth}; keep them apart")


@command(
    "withheld answer",
    "diagnose every withheld case; goes on where an earlier run stopped",
    DIRECTORY,
    SEED,
    argument("--out", metavar="DIR", help="folder for the answers (default: DIR/answers)"),
    STOP_AT_REFITS,
    workers(),
    examples=("bayes-iwan withheld answer cases --quick --workers 2",),
)
def run_answer(args: argparse.Namespace) -> None:
    from bayes_iwan.diagnosis.diagnosis import diagnose_case
    from bayes_iwan.files import owned
    from bayes_iwan.withheld.answering import answer
    from bayes_iwan.withheld.confinement import available

    if not available():
        say("this machine cannot close the truths to the answering processes (it has no Landlock)")
    out = args.out or os.path.join(args.directory, "answers")
    with owned(out):
        path = answer(args.directory, diagnose_case, out=out, **given(args, "seed quick workers"))
    say(f"answers are in {path}")


@command(
    "withheld score",
    "check the seals, then score the answers against the truths",
    DIRECTORY,
    argument("--truth", metavar="FILE", required=True, help="the truths"),
    argument("--answers", metavar="FILE", help="answers.json (default: DIR/answers/answers.json)"),
    argument("--out", metavar="DIR", help="folder for table and figures"),
    several("--excluded", "NAME", "law (NAME:LAW) or kind not calibrated on"),
    argument("--allow-effects-file", action="store_true", help="run the code of the Python files that answers name"),
    examples=("bayes-iwan withheld score cases --truth cases-truth/truth.json --out scores",),
)
def run_score(args: argparse.Namespace) -> None:
    from bayes_iwan.report.withheld_scores import write_score

    options = given(args, "answers out allow_effects_file excluded")
    say(write_score(args.directory, args.truth, **options))
