# PYTHON_ARGCOMPLETE_OK
"""The command line: `bayes-iwan COMMAND ...`. A command is a function here, which imports what it needs itself.

A new command is a function with the decorator :func:`.command.command` in the file of its group, and its name in the
list below. Bad input is an InputError anywhere in the package: it becomes one line on stderr, exit code 2. Every other
exception is a defect of the package, with the traceback, exit code 70, or of the Python file of a user's own that
it came from, exit code 2: it is said to be one.
"""

import argparse
import logging
import os
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from bayes_iwan import __version__
from bayes_iwan.cli import campaigns, modelling, withheld
from bayes_iwan.cli.command import LOG, Command, quoted, say
from bayes_iwan.cli.runs import RunLog, refuse_other_shells, refuse_recordings
from bayes_iwan.errors import InputError, nearest
from bayes_iwan.files import refuse_campaign
from bayes_iwan.terminal import terminate_as_interrupt

#: exit code (EX_SOFTWARE of sysexits.h)
DEFECT = 70

#: in the order in which the help lists them
COMMANDS: list[Command] = [
    *(campaigns.run_import, campaigns.run_check, campaigns.run_inspect),
    *(modelling.run_identify, modelling.run_report, modelling.run_compare),
    *(modelling.run_diagnose, modelling.run_export, modelling.run_batch),
    *(withheld.run_make, withheld.run_answer, withheld.run_score),
]


class Parser(argparse.ArgumentParser):
    """A parser that says which command or option was probably meant."""

    def error(self, message: str) -> NoReturn:
        """Exit with usage and the message."""
        wrong = re.search(r"invalid choice: '([^']*)'", message) or re.search(r"unrecognized arguments: (\S+)", message)
        known = [x for action in self._actions for x in (*action.option_strings, *(action.choices or ()))]
        super().error(message + (nearest(wrong[1], known, "") if wrong else ""))


def parser() -> argparse.ArgumentParser:
    """The parser of all commands, groups of two-word ones included."""
    top = Parser(
        prog="bayes-iwan",
        description="Bayesian identification of friction isolators with the generalized Iwan model",
        epilog='first steps: bayes-iwan import "recordings" --out campaign; bayes-iwan check campaign; bayes-iwan '
        'identify campaign --quick; the tab key completes words after pip install ".[completion]" and '
        'eval "$(register-python-argcomplete bayes-iwan)"',
    )
    top.add_argument("--version", action="version", version=f"bayes-iwan {__version__}")
    below = top.add_subparsers(metavar="COMMAND", required=True)
    groups: dict[str, argparse._SubParsersAction[Parser]] = {}
    for entry in COMMANDS:
        first, _, second = entry.name.partition(" ")
        if second and first not in groups:
            group = below.add_parser(first, help=f"commands: see `bayes-iwan {first} --help`")
            groups[first] = group.add_subparsers(metavar="COMMAND", required=True)
        one = (groups[first] if second else below).add_parser(
            second or first,
            help=entry.help,
            description=entry.help,
            epilog="examples:\n" + "\n".join(f"  {x}" for x in entry.examples) if entry.examples else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for x in entry.arguments:
            one.add_argument(*x.flags, **x.options).completer = x.offers  # type: ignore[attr-defined]
        one.add_argument("-v", "--verbose", action="store_true", help="say more: what is run where, errors in full")
        one.set_defaults(run=entry.run, command=entry.name)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 2 bad input, 3 done but not converged, 4 a batch with failures, 70 a defect of ours,
    130 interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parse = parser()
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(parse)
    args = _parsed(parse, words)
    args.words = words
    log = RunLog(words)
    LOG.addHandler(log)
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    try:
        with terminate_as_interrupt():
            refuse_other_shells(args)
            _prepare(args, log)
            return args.run(args) or 0
    except InputError as error:
        say(f"bayes-iwan: {error}", logging.ERROR)
        if args.verbose:
            traceback.print_exc()
        return 2
    except BrokenPipeError:  # whoever read our output has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # a disk that is full, a folder that has gone
        where = f"{error.filename}: " if error.filename else ""
        fix = "name a folder that can be written to, on a disk that is not full"
        say(f"bayes-iwan: {where}{error.strerror or error}; {fix}", logging.ERROR)
        return 2
    except MemoryError:
        say("bayes-iwan: not enough memory", logging.ERROR)
        return 2
    except Exception as error:
        from bayes_iwan.models.user_file import place_in

        for line in traceback.format_exc().splitlines():
            say(line, logging.ERROR)
        if place := place_in(error):
            say(f"bayes-iwan: {place}: {type(error).__name__}: {error}; fix the file", logging.ERROR)
            return 2
        said = f"bayes-iwan: {type(error).__name__}: this is a defect of bayes_iwan {__version__}, not of your input; "
        say(said + "please report it with the lines above and the command", logging.ERROR)
        return DEFECT
    except KeyboardInterrupt:
        say(f"\nbayes-iwan: interrupted{_go_on(args, words)}", logging.ERROR)
        return 130
    finally:
        log.write()
        LOG.removeHandler(log)


def _parsed(parse: argparse.ArgumentParser, words: list[str]) -> argparse.Namespace:
    """The arguments; an unknown option is an error of the command that it was given to, which knows its own."""
    args, unknown = parse.parse_known_args(words)
    if unknown:
        one = parse
        for word in args.command.split():
            action = next(x for x in one._actions if isinstance(x, argparse._SubParsersAction))
            one = action.choices[word]
        one.error(f"unrecognized arguments: {' '.join(unknown)}")
    return args


def _prepare(args: argparse.Namespace, log: RunLog) -> None:
    """Refuse recordings where a campaign is wanted, and name the results' folder where the user does not."""
    source = getattr(args, "campaign", None)
    if source is not None:
        refuse_recordings(source)
    if hasattr(args, "overwrite") or hasattr(args, "to"):
        source = getattr(args, "folder", source)
        if args.out is None:
            args.out = f"{Path(str(source)).resolve().name}-{getattr(args, 'to', args.command)}"
        refuse_campaign(args.out)  # no log is written there either
        if args.verbose:
            say(f"{source} -> {args.out}")
    if getattr(args, "out", None):
        log.folder = Path(args.out)


def _go_on(args: argparse.Namespace, words: Sequence[str]) -> str:
    """How to go on after Ctrl-C."""
    if not hasattr(args, "out") and not hasattr(args, "resume"):
        return ""
    if hasattr(args, "resume"):
        from bayes_iwan.cli.modelling import going_on

        return going_on(args, words)
    return f"; finished pieces are kept. Run it again: {quoted(['bayes-iwan', *words])}"
