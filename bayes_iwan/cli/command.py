"""What a command is, the arguments that several share, and how a command speaks."""

import argparse
import logging
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from bayes_iwan.terminal import plain

Function = Callable[[argparse.Namespace], int | None]
Offers = Callable[..., Iterable[str]]
LOG = logging.getLogger("bayes_iwan.cli")


@dataclass(frozen=True)
class Argument:
    """An argument: its name or flags, options as `argparse.add_argument` takes them, and what the tab key offers, where
    that is no file (argcomplete calls it with keywords)."""

    flags: tuple[str, ...]
    options: dict[str, Any]
    offers: Offers | None = None


@dataclass(frozen=True)
class Command:
    """A command: its name (two words make a group, "withheld make"), one line of help, arguments, what it does, and
    examples of its use."""

    name: str
    help: str
    arguments: tuple[Argument, ...]
    run: Function
    examples: tuple[str, ...] = ()


def argument(*flags: str, offers: Offers | None = None, **options: object) -> Argument:
    """An argument as `argparse.add_argument` takes it."""
    return Argument(flags, options, offers)


def command(name: str, help: str, *arguments: Argument, examples: Sequence[str] = ()) -> Callable[[Function], Command]:
    """Make the function below a command; it returns the exit code (None: 0)."""
    return lambda run: Command(name, help, arguments, run, tuple(examples))


def given(args: argparse.Namespace, names: str) -> dict[str, Any]:
    """Options by name, as the function that a command calls takes them."""
    return {name: getattr(args, name) for name in names.split()}


def say(text: str, level: int = logging.INFO) -> None:
    """Print for a reader, errors on stderr, and for the log: names in files may hold what would steer the terminal, and
    must not."""
    text = plain(text)
    print(text, file=sys.stderr if level == logging.ERROR else None)
    LOG.log(level, "%s", text)


def quoted(words: Sequence[str]) -> str:
    """A command line as this system's shells take it: double quotes around all but plain words."""
    kept = r'("|\\$)' if os.name == "nt" else r'(["$`\\])'
    plain_word = re.compile(r"[\w.:@+,-]+", re.ASCII)
    return " ".join(w if plain_word.fullmatch(w) else '"' + re.sub(kept, r"\\\1", w) + '"' for w in words)


def seed(text: str) -> int:
    """A seed as the files can hold it."""
    value = int(text)
    if not 0 <= value < 2**63:
        raise argparse.ArgumentTypeError(f"{text} is no seed; give a whole number from 0 to {2**63 - 1}")
    return value


def number_or_address(text: str) -> int | str:
    """--workers: a number of processes, or where a Dask scheduler listens."""
    try:
        return int(text)
    except ValueError:
        if "://" in text:
            return text
    raise argparse.ArgumentTypeError(f"{text} is neither a number of processes nor an address (tcp://host:port)")


def several(flag: str, metavar: str, help: str, offers: Offers | None = None) -> Argument:
    """An option that may be given several times."""
    return argument(flag, offers=offers, metavar=metavar, action="append", default=[], help=help)


CAMPAIGN = argument("campaign", metavar="CAMPAIGN", help="a campaign folder")
OUT = argument(
    "--out",
    metavar="DIR",
    help="folder for the results; made if need be (default: named after the campaign and the command)",
)
OVERWRITE = argument(
    "--overwrite", action="store_true", help="write over the finished results of another campaign in that folder"
)


def workers(default: str = "1") -> Argument:
    """Where pieces of work run; default : in words."""
    return argument(
        "--workers",
        metavar="N|ADDRESS",
        type=number_or_address,
        help=f"processes, one core each (default: {default}), or tcp://host:port of a Dask scheduler whose workers "
        "see the same folders (needs distributed)",
    )


def own_file(flag: str, what: str) -> Argument:
    """A user's Python file."""
    return argument(flag, metavar="FILE", help=f"{what}; its code is run")


SIMULATOR = own_file("--simulator", "Python file with a model of your own, in the place of the Iwan model")
STOP_AT_REFITS = argument("--quick", action="store_true", help="stop at refits and an approximate evidence")
CONFIG = argument("--config", metavar="FILE", help="TOML file with what differs from the defaults")
SEED = argument("--seed", metavar="N", type=seed, default=0, help="seed of all random numbers (default: 0)")
#: of every command that fits
RESULTS = (OUT, OVERWRITE, SEED)
