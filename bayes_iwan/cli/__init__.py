"""The command line: `bayes-iwan COMMAND ...`. A command is a function here, which imports what it needs itself.

A new command is a function with the decorator :func:`.command.command` in the file of its group, and its name in the
list below. Bad input is a ValueError anywhere in the package: it becomes one line on stderr.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from bayes_iwan import __version__
from bayes_iwan.cli import diagnosis, export, identification, recordings, withheld
from bayes_iwan.cli.command import Command, say
from bayes_iwan.terminal import terminate_as_interrupt

#: in the order in which the help lists them
COMMANDS: list[Command] = [
    recordings.run_import,
    recordings.run_check,
    recordings.run_inspect,
    identification.run_identify,
    identification.run_report,
    identification.run_compare,
    diagnosis.run_diagnose,
    export.run_export,
    identification.run_batch,
    withheld.run_make,
    withheld.run_answer,
    withheld.run_score,
]


def parser() -> argparse.ArgumentParser:
    """The parser of all commands, groups of two-word ones included."""
    top = argparse.ArgumentParser(
        prog="bayes-iwan", description="Bayesian identification of friction isolators with the generalized Iwan model"
    )
    top.add_argument("--version", action="version", version=f"bayes-iwan {__version__}")
    below = top.add_subparsers(metavar="COMMAND", required=True)
    groups: dict[str, argparse._SubParsersAction[argparse.ArgumentParser]] = {}
    for entry in COMMANDS:
        first, _, second = entry.name.partition(" ")
        if second and first not in groups:
            group = below.add_parser(first, help=f"commands: see `bayes-iwan {first} --help`")
            groups[first] = group.add_subparsers(metavar="COMMAND", required=True)
        one = (groups[first] if second else below).add_parser(second or first, help=entry.help, description=entry.help)
        for x in entry.arguments:
            one.add_argument(*x.flags, **x.options)
        one.set_defaults(run=entry.run)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 2 bad input, 3 done but not converged, 4 a batch with failures, 130 interrupted."""
    args = parser().parse_args(arguments)
    try:
        with terminate_as_interrupt():
            return args.run(args) or 0
    except ValueError as error:
        say(f"bayes-iwan: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read our output has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # a disk that is full, a folder that has gone
        where = f"{error.filename}: " if error.filename else ""
        say(f"bayes-iwan: {where}{error.strerror or error}; what was whole before is whole still", file=sys.stderr)
        return 2
    except MemoryError:
        say("bayes-iwan: not enough memory", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        say("\nbayes-iwan: interrupted", file=sys.stderr)
        return 130
