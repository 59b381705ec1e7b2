"""Commands on recordings, before any model: import, check, inspect."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from encodings.aliases import aliases
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_iwan.cli.command import CAMPAIGN, argument, command, quoted, say, several
from bayes_iwan.terminal import plain

if TYPE_CHECKING:
    from bayes_iwan.campaign.importing import ImportAsks, Question, Recipe


ROLES = ("time", "displacement", "acceleration", "force")


def _roles(**_: object) -> Iterable[str]:
    return (f"{x}=" for x in ROLES)


def _channels(parsed_args: argparse.Namespace, **_: object) -> Iterable[str]:
    from bayes_iwan.campaign.importing import Layout
    from bayes_iwan.campaign.importing.read import read_files

    return {c.name for x in read_files(parsed_args.files, Layout())[0] for c in x.channels}


def _tests(parsed_args: argparse.Namespace, **_: object) -> Iterable[str]:
    from bayes_iwan.campaign.folders.contents import recordings_in

    return {path.stem for name in parsed_args.files for path in recordings_in(name)}


@command(
    "import",
    "files of a data-acquisition system (text, LabVIEW, TDMS, UFF, MATLAB, Excel, WAV, Parquet) into a campaign",
    argument("files", metavar="FILE", nargs="+", help='recordings, folders of them, or patterns like "run*.csv"'),
    argument("--out", metavar="CAMPAIGN", help="campaign folder to write (default: named after the first file)"),
    argument("--ask", action="store_true", help="ask here for what the files do not say, line by line"),
    argument("--dry-run", action="store_true", help="print what was understood and write nothing"),
    argument("--split", action="store_true", help="one test a level, where a record goes through levels of the drive"),
    argument("--join", action="store_true", help="all files are channels of one test"),
    several("--held-out", "TEST", "keep a test out of fits (name or pattern)", _tests),
    argument("--recipe", metavar="TOML", help="file with what the options below say; they go before it"),
    argument(
        "--time",
        metavar="NAME",
        help='channel, by its name or its number from 1; found by unit and name if not said; "none": by the rate alone',
        offers=_channels,
    ),
    argument("--displacement", metavar="NAME", help="the same (a length or an angle)", offers=_channels),
    argument("--acceleration", metavar="NAME", help="the same, in place of the displacement", offers=_channels),
    argument("--force", metavar="NAME", help="the same (a force, torque or pressure)", offers=_channels),
    several(
        "--unit",
        "ROLE=UNIT",
        'unit of the samples: --unit "force=kN"; --unit "force=100 N" where a sample of 1 is 100 N',
        _roles,
    ),
    several(
        "--sensitivity",
        "ROLE=VALUE",
        'of the transducer whose volts the samples are: --sensitivity "force=9.55 mV/N"',
        _roles,
    ),
    several("--gain", "ROLE=X", 'of an amplifier, divided out: --gain "force=10"', _roles),
    several("--reverse", "ROLE", "turn the sign round: --reverse force", lambda **_: ROLES[1:]),
    argument(
        "--sample-rate",
        metavar="HZ",
        help='where the files do not say it; "none" where rows have no clock (a quasi-static test)',
        offers=lambda **_: ("none",),
    ),
    argument(
        "--separator",
        metavar="CHAR",
        help="of text files: tab, comma, semicolon, blank or a character",
        offers=lambda **_: ("tab", "comma", "semicolon", "blank"),
    ),
    argument("--decimal", choices=(".", ","), help="decimal mark of text files; found if not said"),
    argument(
        "--encoding",
        metavar="NAME",
        help="of text files (cp1252, utf-16 ...); found if not said",
        offers=lambda **_: set(aliases.values()),
    ),
    argument("--name", metavar="TEXT", help="of the specimen (default: the folder's name)"),
    examples=(
        'bayes-iwan import "run1.csv" "run2.csv" --out campaign',
        'bayes-iwan import "recordings" --sample-rate 1280 --unit "force=kN" --held-out "run2*"',
        'bayes-iwan import "rig.tdms" --sensitivity "acceleration=105 mV/g" --sensitivity "force=9.55 mV/N"',
        'bayes-iwan import "staircase.csv" --split --out campaign',
    ),
)
def run_import(args: argparse.Namespace) -> None:
    from bayes_iwan.campaign import CampaignError
    from bayes_iwan.campaign.importing import ImportAsks, import_tests, write_tests

    while True:
        recipe = _recipe(args)
        try:
            tests = import_tests(args.files, recipe, args.split, args.held_out, args.join)
            break
        except ImportAsks as asks:
            if not args.ask:
                raise CampaignError(f"{asks.facts} Run: {_complete(args, asks)}") from None
            _answer(args, asks)
    out = args.out or f"{Path(args.files[0]).stem.strip('*?[]') or 'recordings'}-campaign"
    for test in tests:
        held_out = ("held out of fits",) if test.record.role == "held-out" else ()
        say("\n    ".join((*test.said, *held_out, *test.record.warnings)))
    if args.dry_run:
        say("nothing was written (--dry-run)")
        return
    write_tests(tests, out, recipe.specimen)
    say(f"{len(tests)} test(s) are in {out}. Read them: {quoted(['bayes-iwan', 'check', out])}")


def _recipe(args: argparse.Namespace) -> Recipe:
    """What the options say, over what the recipe file says. Raises CampaignError."""
    from bayes_iwan.campaign import CampaignError
    from bayes_iwan.campaign.importing import Layout, Recipe, read_recipe
    from bayes_iwan.campaign.importing.recipe import NO_CLOCK
    from bayes_iwan.campaign.importing.unit_texts import decimal_point

    def by_role(option: str) -> dict[str, str]:
        pairs = [text.partition("=") for text in getattr(args, option)]
        if bad := [role for role, equals, value in pairs if not equals or not value]:
            raise CampaignError(f'--{option} {bad[0]}: write it as ROLE=VALUE, like "force=..."')
        return {role.strip(): value.strip() for role, _, value in pairs}

    def number(option: str, text: str) -> float:
        try:
            return float(decimal_point(text))
        except CampaignError as error:
            raise CampaignError(f"--{option}: {error}") from None
        except ValueError:
            raise CampaignError(f"--{option}: {text!r} is not a number") from None

    def rate(text: str) -> float | str:
        text = text.lower().removesuffix("hz").strip()
        return text if text == NO_CLOCK else number("sample-rate", text)

    recipe = Recipe(
        channels={role: getattr(args, role) for role in ROLES if getattr(args, role)},
        units=by_role("unit"),
        sensitivities=by_role("sensitivity"),
        gains={role: number("gain", value) for role, value in by_role("gain").items()},
        reverse=tuple(args.reverse),
        sample_rate_hz=None if args.sample_rate is None else rate(args.sample_rate),
        layout=Layout(args.separator, args.decimal, args.encoding),
        specimen={"name": args.name} if args.name else {},
    )
    return recipe.over(read_recipe(args.recipe)) if args.recipe else recipe


def _complete(args: argparse.Namespace, asks: ImportAsks) -> str:
    """The command as it was given with what is missing put in."""
    words = list(args.words)
    for question in asks.questions:
        words = _with(words, question, "")
    return quoted(["bayes-iwan", *words])


def _with(words: list[str], question: Question, answer: str) -> list[str]:
    """A command with the answer to a question, in the place of an old one."""
    words = list(words)
    for k in range(len(words) - 1, 0, -1):
        if words[k - 1] == question.option and (not question.role or words[k].startswith(f"{question.role}=")):
            del words[k - 1 : k + 1]
    return [*words, *question.words(answer)]


def _answer(args: argparse.Namespace, asks: ImportAsks) -> None:
    """Ask for what is missing, one line each, and put the answers among the arguments."""
    from bayes_iwan.campaign import CampaignError
    from bayes_iwan.campaign.importing import ImportAsks

    say(asks.where)
    questions = list(asks.questions)
    while questions:
        question = questions[0]
        name = question.option.removeprefix("--").replace("-", "_")
        option = f"{question.option} {question.role}".strip()
        try:
            answer = input(f"  {plain(question.text)} {option} ({question.placeholder or 'yes or no'}): ").strip()
        except EOFError:
            answer = ""
        if not answer or (not question.placeholder and answer.lower()[:1] not in "yjos"):
            raise CampaignError(f"{asks.facts} Run: {_complete(args, asks)}")
        before = getattr(args, name)
        if question.role:
            # a new list: argparse hands out its default itself, and the next command of this process would inherit it
            setattr(args, name, [*before, f"{question.role}={answer}"])
        else:
            setattr(args, name, answer if question.placeholder else True)
        try:
            question.check(answer)
            _recipe(args)
        except CampaignError as error:  # asked again: the answers before it stand
            say(str(error))
            setattr(args, name, before)
            continue
        args.words = _with(args.words, question, answer)
        asks = ImportAsks(asks.where, questions := questions[1:])
    say(f"  This asks no more: {quoted(['bayes-iwan', *args.words])}")


@command(
    "check",
    "read a campaign and say what was found in it, one line each",
    CAMPAIGN,
    examples=("bayes-iwan check campaign",),
)
def run_check(args: argparse.Namespace) -> None:
    from bayes_iwan import check

    say(str(check(args.campaign)))


@command(
    "inspect",
    "what the records show before any model: loops, energy, stiffness, damping, noise, drift, and what is wrong",
    CAMPAIGN,
    argument("--out", metavar="DIR", help="also write DIR/inspect.html and its figures"),
    examples=("bayes-iwan inspect campaign --out seen",),
)
def run_inspect(args: argparse.Namespace) -> None:
    from bayes_iwan.report.inspection.inspect_page import inspect_to

    say(inspect_to(args.campaign, args.out))
    if args.out:
        say(f"the page is {args.out}/inspect.html")
