"""The command line: `bayes-iwan COMMAND ...`. Each command is one function here, which imports what it needs itself.

A new command is a function with the decorator below: its name (two words make a group, "withheld make"), one line of
help and its arguments. Bad input is a ValueError anywhere in the package: it becomes one line on stderr.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TextIO

Function = Callable[[argparse.Namespace], int | None]


@dataclass(frozen=True)
class Command:
    name: str
    help: str
    arguments: tuple[tuple[tuple[str, ...], dict[str, Any]], ...]
    run: Function


COMMANDS: list[Command] = []


def argument(*flags: str, **options: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    """An argument as `argparse.add_argument` takes it."""
    return flags, options


def command(name: str, help: str, *arguments: tuple[tuple[str, ...], dict[str, Any]]) -> Callable[[Function], Function]:
    """Make the function below a command; it returns the exit code (None: 0)."""

    def enter(run: Function) -> Function:
        COMMANDS.append(Command(name, help, arguments, run))
        return run

    return enter


def say(text: str, file: TextIO | None = None) -> None:
    """Print for a reader: names in files may hold what would steer the terminal, and must not."""
    from bayes_iwan.terminal import plain

    print(plain(text), file=file)


CAMPAIGN = argument("campaign", metavar="CAMPAIGN", help="a campaign folder")
OUT = argument("--out", metavar="DIR", required=True, help="folder for the results; made if need be")
WORKERS = argument("--workers", metavar="N", type=int, default=1, help="processes, one core each (default: 1)")
DASK = argument(
    "--dask",
    metavar="ADDRESS",
    help="work on a Dask cluster whose scheduler is at ADDRESS (tcp://host:port) and whose workers see the same "
    "folders; needs bayes-iwan[dask]",
)
SIMULATOR = argument(
    "--simulator",
    metavar="FILE",
    help="Python file with a model of your own, in the place of the Iwan model; its code is run",
)


def seed(text: str) -> int:
    """A seed as the files can hold it."""
    value = int(text)
    if not 0 <= value < 2**63:
        raise argparse.ArgumentTypeError(f"{text} is no seed; give a whole number from 0 to {2**63 - 1}")
    return value


SEED = argument("--seed", metavar="N", type=seed, default=0, help="seed of all random numbers (default: 0)")


@command(
    "identify",
    "the joint posterior of a campaign's tests",
    CAMPAIGN,
    OUT,
    SEED,
    argument("--config", metavar="FILE", help="TOML file with what differs from the defaults"),
    argument("--per-test", action="store_true", help="also identify each frequency alone, into DIR/per_test"),
    argument("--resume", action="store_true", help="go on from DIR/chains.ckpt where a run was stopped"),
    argument(
        "--keep-chains",
        action="store_true",
        help="keep DIR/chains.ckpt, with every draw, when converged (default: DIR/posterior.nc with a few thousand)",
    ),
    argument("--quick", action="store_true", help="optimum and Laplace intervals in seconds, not sampled"),
    SIMULATOR,
)
def run_identify(args: argparse.Namespace) -> int:
    import warnings

    from bayes_iwan import Model, NotConverged, identify

    warnings.simplefilter("ignore", NotConverged)  # said below

    posterior = identify(
        args.campaign,
        args.out,
        config=args.config,
        seed=args.seed,
        per_test=args.per_test,
        resume=args.resume,
        keep_chains=args.keep_chains,
        simulator=args.simulator,
        quick=args.quick,
    )
    units = posterior.problem.units
    iwan = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N")
    wanted = iwan if isinstance(posterior.problem.model, Model) else posterior.problem.names
    for row in posterior.summary():
        if row.name in wanted:
            say(f"{units.name(row.name):20s} {row.q50:.4g}  ({row.low_90:.4g} to {row.high_90:.4g}) {row.unit}")
    misfit = posterior.misfit()
    say(f"{'misfit':20s} {misfit.rms_N:.3g} {units.force} RMS, {100 * misfit.share:.2g} % of the friction force")
    for text in posterior.warnings():
        say(text)
    say(posterior.message)
    say(f"results are in {args.out}")
    if posterior.interrupted:
        return 130
    return 0 if posterior.converged or posterior.quick else 3


@command("check", "read a campaign and say what was found in it, one line each", CAMPAIGN)
def run_check(args: argparse.Namespace) -> None:
    from bayes_iwan import check

    say(str(check(args.campaign)))


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


@command(
    "report",
    "write report.html, tables and figures of a finished identification",
    argument("folder", metavar="RUN", help="a folder that identify wrote"),
    argument("--campaign", metavar="CAMPAIGN", help="the campaign's folder, if it has moved"),
    argument(
        "--per-frequency",
        action="store_true",
        help="identify each frequency alone by short runs, where identify --per-test has not",
    ),
    argument("--pdf", action="store_true", help="also report.pdf: the figures with their captions"),
)
def run_report(args: argparse.Namespace) -> None:
    from bayes_iwan.report import report_run

    page = report_run(args.folder, campaign=args.campaign, pdf=args.pdf, per_frequency=args.per_frequency)
    say(str(page))


@command(
    "compare",
    "fit model families to a campaign and rank them by how well they predict",
    CAMPAIGN,
    OUT,
    SEED,
    argument("--families", metavar="NAME", nargs="+", help="families to compare (default: all)"),
    argument("--config", metavar="FILE", help="TOML file with what differs from the defaults"),
    argument(
        "--by",
        choices=("auto", "loo", "tests"),
        default="auto",
        help="rank by single data left out (ArviZ "
        "LOO), by whole tests left out, or by the first where its Pareto k hold (auto)",
    ),
    WORKERS,
    DASK,
)
def run_compare(args: argparse.Namespace) -> None:
    from bayes_iwan import compare, executors

    with executors.opened(args.workers, args.dask) as executor:
        result = compare(
            args.campaign,
            args.out,
            families=args.families,
            config=args.config,
            seed=args.seed,
            by=args.by,
            executor=executor,
        )
    say(str(result))
    say(f"results are in {args.out}")


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
    argument("--config", metavar="FILE", help="TOML file with what differs from the defaults"),
    argument("--effects", metavar="FILE", help="Python file with effects of your own; its code is run"),
    SIMULATOR,
    argument("--quick", action="store_true", help="stop at refits and an approximate evidence"),
)
def run_diagnose(args: argparse.Namespace) -> None:
    from bayes_iwan.report.diagnosis import diagnose_campaign

    answer = diagnose_campaign(
        args.campaign,
        args.out,
        seed=args.seed,
        quick=args.quick,
        base=args.base,
        config=args.config,
        effects_file=args.effects,
        simulator_file=args.simulator,
    )
    say("\n".join(answer["sentences"]))
    say(f"results are in {args.out}; open {args.out}/diagnosis.html")


@command(
    "batch",
    "identify or diagnose every campaign in a folder, with a table and a page across specimens",
    argument("folder", metavar="FOLDER", help="a folder of campaign folders"),
    OUT,
    SEED,
    argument("--identify", action="store_true", help="identify every campaign (default, unless --diagnose)"),
    argument("--diagnose", action="store_true", help="diagnose every campaign"),
    argument("--quick", action="store_true", help="diagnoses stop at refits and an approximate evidence"),
    argument("--config", metavar="FILE", help="TOML file with what differs from the defaults"),
    argument("--keep-chains", action="store_true", help="keep every draw of every specimen (chains.ckpt)"),
    WORKERS,
    DASK,
)
def run_batch(args: argparse.Namespace) -> int:
    from bayes_iwan import batch, executors

    with executors.opened(args.workers, args.dask) as executor:
        result = batch(
            args.folder,
            args.out,
            identify=args.identify or not args.diagnose,
            diagnose=args.diagnose,
            quick=args.quick,
            seed=args.seed,
            config=args.config,
            keep_chains=args.keep_chains,
            executor=executor,
        )
    for name, reason in result.failures.items():
        say(f"failed: {name}: {reason}")
    for name, p in result.populations.items():
        spread = f"{100 * p.spread[0]:.2g} %" if p.relative else f"{p.spread[0]:.2g}"
        say(f"{name:24s} {p.typical[0]:.4g} ({p.typical[1]:.4g} to {p.typical[2]:.4g}), specimens differ by {spread}")
    for name, found in result.outliers().items():
        say(f"{name} stands out in {', '.join(found)}")
    say(f"{len(result.finished)} finished, {len(result.failures)} failed; open {args.out}/batch.html")
    late = any(x.converged is False for x in result.finished)
    return 4 if result.failures else 3 if late else 0


@command(
    "withheld make",
    "draw cases with hidden causes on the virtual rig and seal their truths",
    argument("n", metavar="N", type=int, help="number of cases"),
    argument("--seed", metavar="S", type=int, help="development cases that can be made again: marked as not sealed"),
    OUT,
    argument("--laws", choices=("catalogue", "other", "all"), default="all", help="laws of the causes (default: all)"),
    argument("--leave-out-law", metavar="NAME:LAW", action="append", default=[], help="a law that is not drawn"),
    argument("--leave-out-outside", metavar="NAME", action="append", default=[], help="an unlisted cause not drawn"),
    WORKERS,
    DASK,
)
def run_withheld_make(args: argparse.Namespace) -> None:
    from bayes_iwan.executors import opened
    from bayes_iwan.validation.sealed import make

    with opened(args.workers, args.dask) as executor:
        truth = make(
            args.n,
            args.out,
            seed=args.seed,
            laws=args.laws,
            leave_out_laws=args.leave_out_law,
            leave_out_outside=args.leave_out_outside,
            executor=executor,
        )
    say(f"truths are in {truth}; keep them apart")


DIRECTORY = argument("directory", metavar="DIR", help="folder that `withheld make` wrote")


@command(
    "withheld answer",
    "diagnose every withheld case; goes on where an earlier run stopped",
    DIRECTORY,
    SEED,
    argument("--out", metavar="DIR", help="folder for the answers (default: DIR/answers)"),
    argument("--quick", action="store_true", help="stop at refits and an approximate evidence"),
    WORKERS,
    DASK,
)
def run_withheld_answer(args: argparse.Namespace) -> None:
    from bayes_iwan.executors import opened
    from bayes_iwan.files import owned
    from bayes_iwan.gap.answer import diagnose_case
    from bayes_iwan.validation.answering import answer
    from bayes_iwan.validation.confinement import available

    if not available():
        say("this machine cannot close the truths to the answering processes (it has no Landlock)")
    out = args.out or os.path.join(args.directory, "answers")
    with owned(out), opened(args.workers, args.dask) as executor:
        path = answer(args.directory, diagnose_case, out=out, seed=args.seed, quick=args.quick, executor=executor)
    say(f"answers are in {path}")


@command(
    "withheld score",
    "check the seals, then score the answers against the truths",
    DIRECTORY,
    argument("--truth", metavar="FILE", required=True, help="the truths"),
    argument("--answers", metavar="FILE", help="answers.json (default: DIR/answers/answers.json)"),
    argument("--out", metavar="DIR", help="folder for table and figures"),
    argument(
        "--left-out", metavar="NAME", action="append", default=[], help="law (NAME:LAW) or kind not calibrated on"
    ),
    argument("--allow-effects-file", action="store_true", help="run the effects file (code) that an answer names"),
)
def run_withheld_score(args: argparse.Namespace) -> None:
    from bayes_iwan.report.scores import write_score

    say(
        write_score(
            args.directory,
            args.truth,
            answers=args.answers,
            out=args.out,
            allow_effects_file=args.allow_effects_file,
            left_out=args.left_out,
        )
    )


def parser() -> argparse.ArgumentParser:
    """The parser of all commands, groups of two-word ones included."""
    top = argparse.ArgumentParser(
        prog="bayes-iwan", description="Bayesian identification of friction isolators with the generalized Iwan model"
    )
    from bayes_iwan import __version__

    top.add_argument("--version", action="version", version=f"bayes-iwan {__version__}")
    below = top.add_subparsers(metavar="COMMAND", required=True)
    groups: dict[str, Any] = {}
    for entry in COMMANDS:
        first, _, second = entry.name.partition(" ")
        if second and first not in groups:
            group = below.add_parser(first, help=f"commands: see `bayes-iwan {first} --help`")
            groups[first] = group.add_subparsers(metavar="COMMAND", required=True)
        one = (groups[first] if second else below).add_parser(second or first, help=entry.help, description=entry.help)
        for flags, options in entry.arguments:
            one.add_argument(*flags, **options)
        one.set_defaults(run=entry.run)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 2 bad input, 3 done but not converged, 4 a batch with failures, 130 interrupted."""
    from bayes_iwan.terminal import terminate_as_interrupt

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


if __name__ == "__main__":
    sys.exit(main())
