"""The command that diagnoses what a model misses."""

from __future__ import annotations

import argparse

from bayes_iwan.cli.command import (
    CAMPAIGN,
    CONFIG,
    DASK,
    OUT,
    OVERWRITE,
    SEED,
    SIMULATOR,
    argument,
    command,
    say,
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
    argument(
        "--workers",
        metavar="N",
        type=int,
        help=f"processes, one core each (default: as many as there are cores, {WORKERS_MOST} at most)",
    ),
    DASK,
    examples=(
        "bayes-iwan diagnose campaign --out gap",
        "bayes-iwan diagnose campaign --quick",
        "bayes-iwan diagnose campaign --effects my_effects.py",
    ),
)
def run_diagnose(args: argparse.Namespace) -> None:
    import numba

    from bayes_iwan.executors import opened

    workers = args.workers
    if workers is None:
        workers = 1 if args.dask else min(numba.get_num_threads(), WORKERS_MOST)
    with opened(workers, args.dask, along=True, needs=("bayes_iwan.diagnosis.diagnosis",)) as executor:
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
            executor=executor,
        )
    say("\n".join(found.sentences()))
    say(f"results are in {args.out}; open {args.out}/diagnosis.html")
