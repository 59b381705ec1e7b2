"""The command that diagnoses what a model misses."""

import argparse

from bayes_iwan.cli.command import (
    CAMPAIGN,
    CONFIG,
    OUT,
    OVERWRITE,
    SEED,
    SIMULATOR,
    argument,
    command,
    say,
    workers,
)

#: processes that work on one diagnosis where nobody says how many: rounds of refits have few pieces
WORKERS_MOST = 4


@command(
    "diagnose",
    "where the model misses, which cause explains it, how far the gap shrinks",
    CAMPAIGN,
    OUT,
    OVERWRITE,
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
    *workers(f"as many as there are cores, {WORKERS_MOST} at most"),
    examples=(
        "bayes-iwan diagnose campaign --out gap",
        "bayes-iwan diagnose campaign --quick",
        "bayes-iwan diagnose campaign --effects my_effects.py",
    ),
)
def run_diagnose(args: argparse.Namespace) -> None:
    import numba

    from bayes_iwan.executors import opened

    asked = min(numba.get_num_threads(), WORKERS_MOST) if args.workers is None else args.workers
    with opened(asked, along=True, needs=("bayes_iwan.diagnosis.diagnosis",)) as executor:
        from bayes_iwan import diagnose  # while the processes start

        found = diagnose(
            args.campaign,
            args.out,
            seed=args.seed,
            overwrite=args.overwrite,
            quick=args.quick,
            base=args.base,
            config=args.config,
            effects=args.effects or (),
            simulator=args.simulator,
            workers=executor,
        )
    say("\n".join(found.sentences()))
    say(f"results are in {args.out}; open {args.out}/diagnosis.html")
