"""The command that diagnoses what a model misses."""

from __future__ import annotations

import argparse

from bayes_iwan.cli.command import (
    CAMPAIGN,
    CONFIG,
    ELSEWHERE,
    OUT,
    SEED,
    SIMULATOR,
    argument,
    command,
    executor_of,
    say,
)


@command(
    "diagnose",
    "where the model misses, which cause explains it, how far the gap shrinks",
    CAMPAIGN,
    OUT,
    SEED,
    argument(
        "--base",
        metavar="NAME",
        default="generalized",
        help="model to start from: generalized (default), no_speed or classical",
    ),
    CONFIG,
    argument("--effects", metavar="FILE", help="Python file with effects of your own; its code is run"),
    SIMULATOR,
    argument("--quick", action="store_true", help="stop at refits and an approximate evidence"),
    *ELSEWHERE,
)
def run_diagnose(args: argparse.Namespace) -> None:
    from bayes_iwan.report.diagnosis.files import diagnose_campaign

    with executor_of(args) as executor:
        answer = diagnose_campaign(
            args.campaign,
            args.out,
            seed=args.seed,
            quick=args.quick,
            base=args.base,
            config=args.config,
            effects_file=args.effects,
            simulator_file=args.simulator,
            executor=executor,
        )
    say("\n".join(answer["sentences"]))
    say(f"results are in {args.out}; open {args.out}/diagnosis.html")
