"""Commands on recordings, before any model: import, check, inspect."""

from __future__ import annotations

import argparse

from bayes_iwan.cli.command import CAMPAIGN, argument, command, say


@command(
    "import",
    "files of a data-acquisition system (text, TDMS, UFF, MATLAB, Parquet) into a campaign",
    argument("files", metavar="FILE", nargs="+", help="recordings, one test or more in each"),
    argument("--out", metavar="CAMPAIGN", help="campaign folder to write"),
    argument("--dry-run", action="store_true", help="print what was understood and write nothing"),
    argument("--split", action="store_true", help="one test a level, where a record goes through levels of the drive"),
    argument("--recipe", metavar="TOML", help="file with what the options below say; they go before it"),
    argument(
        "--time", metavar="NAME", help="channel, by its name or its number from 1; found by unit and name if not said"
    ),
    argument("--displacement", metavar="NAME", help="the same (a length or an angle)"),
    argument("--acceleration", metavar="NAME", help="the same, in place of the displacement"),
    argument("--force", metavar="NAME", help="the same (a force, torque or pressure)"),
    argument("--unit", metavar="ROLE=UNIT", action="append", default=[], help="unit of the samples: --unit force=kN"),
    argument(
        "--sensitivity",
        metavar="ROLE=VALUE",
        action="append",
        default=[],
        help="of the transducer whose volts the samples are: --sensitivity 'force=9.55 mV/N'",
    ),
    argument(
        "--gain", metavar="ROLE=X", action="append", default=[], help="of an amplifier, divided out: --gain force=10"
    ),
    argument("--reverse", metavar="ROLE", action="append", default=[], help="turn the sign round: --reverse force"),
    argument("--sample-rate", metavar="HZ", type=float, help="where the files do not say it"),
    argument("--separator", metavar="CHAR", help="of text files; found if not said"),
    argument("--decimal", choices=(".", ","), help="decimal mark of text files; found if not said"),
    argument("--encoding", metavar="NAME", help="of text files (cp1252, utf-16 ...); found if not said"),
    argument("--header-line", metavar="N", type=int, help="line with the columns' names; found if not said"),
    argument("--name", metavar="TEXT", help="of the specimen (default: the folder's name)"),
)
def run_import(args: argparse.Namespace) -> None:
    from bayes_iwan.campaign import CampaignError
    from bayes_iwan.campaign.importing import Layout, Recipe, import_tests, read_recipe, write_tests

    def by_role(option: str) -> dict[str, str]:
        pairs = [text.partition("=") for text in getattr(args, option)]
        if bad := [role for role, equals, value in pairs if not equals or not value]:
            raise CampaignError(f"--{option} {bad[0]}: write it as ROLE=VALUE, like force=...")
        return {role.strip(): value.strip() for role, _, value in pairs}

    def number(text: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise CampaignError(f"--gain: {text!r} is not a number") from None

    roles = ("time", "displacement", "acceleration", "force")
    recipe = Recipe(
        channels={role: getattr(args, role) for role in roles if getattr(args, role)},
        units=by_role("unit"),
        sensitivities=by_role("sensitivity"),
        gains={role: number(value) for role, value in by_role("gain").items()},
        reverse=tuple(args.reverse),
        sample_rate_hz=args.sample_rate,
        layout=Layout(args.separator, args.decimal, args.encoding, args.header_line),
        specimen={"name": args.name} if args.name else {},
    )
    if args.recipe:
        recipe = recipe.over(read_recipe(args.recipe))
    if not args.out and not args.dry_run:
        raise CampaignError("import: name the folder to write with --out CAMPAIGN, or only look with --dry-run")
    tests = import_tests(args.files, recipe, split=args.split)
    for test in tests:
        say("\n    ".join((*test.said, *test.record.warnings)))
    if args.dry_run:
        say("nothing was written (--dry-run)")
        return
    write_tests(tests, args.out, recipe.specimen)
    say(f"{len(tests)} test(s) are in {args.out}; `bayes-iwan check {args.out}` reads them")


@command("check", "read a campaign and say what was found in it, one line each", CAMPAIGN)
def run_check(args: argparse.Namespace) -> None:
    from bayes_iwan import check

    say(str(check(args.campaign)))


@command(
    "inspect",
    "what the records show before any model: loops, energy, stiffness, damping, noise, drift, and what is wrong",
    CAMPAIGN,
    argument("--out", metavar="DIR", help="also write DIR/inspect.html and its figures"),
)
def run_inspect(args: argparse.Namespace) -> None:
    from bayes_iwan.report.inspect_page import inspect_to

    say(inspect_to(args.campaign, args.out))
    if args.out:
        say(f"the page is {args.out}/inspect.html")
