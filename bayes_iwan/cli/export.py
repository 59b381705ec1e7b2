"""The command that writes the identified device for other simulators."""

import argparse

from bayes_iwan.cli.command import OUT, argument, command, say

TARGETS = ("c", "fmu", "opensees", "mujoco", "drake", "json")


@command(
    "export",
    "the identified device as files that run elsewhere: C, FMU, OpenSees, MuJoCo, Drake, JSON",
    argument("folder", metavar="RUN", help="folder that identify or diagnose wrote"),
    argument("--to", metavar="TARGET", required=True, choices=TARGETS, help=", ".join(TARGETS)),
    OUT,
    argument("--draws", metavar="N", type=int, default=20, help="draws beside the point estimate (default: 20)"),
    argument("--campaign", metavar="DIR", help="the campaign's folder: for a diagnosis, or where it has moved"),
    argument(
        "--simulator",
        metavar="FILE",
        help="the Python file of a run with a simulator of your own (json); its code is run",
    ),
    argument("--approximate", action="store_true", help="opensees: drop what it cannot hold, instead of refusing"),
    argument(
        "--error",
        metavar="SHARE",
        type=float,
        help="opensees: largest error of the springs over the mean slip force (default: 0.00005)",
    ),
    examples=("bayes-iwan export results --to fmu", "bayes-iwan export gap --to c --out device --campaign campaign"),
)
def run_export(args: argparse.Namespace) -> None:
    from bayes_iwan.export import export

    folder = export(
        args.folder,
        args.to,
        args.out,
        draws=args.draws,
        approximate=args.approximate,
        campaign=args.campaign,
        simulator=args.simulator,
        error=args.error,
    )
    say((folder / "model_card.txt").read_text(encoding="utf-8").rstrip())
    say(f"{', '.join(sorted(p.name for p in folder.iterdir() if p.is_file()))} are in {args.out}")
