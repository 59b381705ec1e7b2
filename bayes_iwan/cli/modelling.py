"""Commands that fit a model or use a fitted one: identify, report, compare, diagnose, batch, export."""

import argparse
import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from bayes_iwan.cli.command import (
    CAMPAIGN,
    CONFIG,
    OUT,
    RESULTS,
    SIMULATOR,
    STOP_AT_REFITS,
    argument,
    command,
    given,
    own_file,
    quoted,
    say,
    workers,
)

#: processes that a posterior's chains go in, if they must go along its manifold
CHAINS_IN = 2
#: processes that work on one diagnosis where nobody says how many: rounds of refits have few pieces
WORKERS_MOST = 4
TARGETS = ("c", "fmu", "opensees", "mujoco", "drake", "json")


def _families(**_: object) -> Iterable[str]:
    from bayes_iwan.comparison.families import FAMILIES

    return FAMILIES


def _bases(**_: object) -> Iterable[str]:
    from bayes_iwan.diagnosis.diagnosis import BASES

    return BASES


def _columns(parsed_args: argparse.Namespace, **_: object) -> Iterable[str]:
    with (Path(parsed_args.folder) / "specimens.csv").open(encoding="utf-8-sig", newline="") as file:
        return {*next(csv.reader(file))} - {"specimen"}


def going_on(args: argparse.Namespace, words: Sequence[str]) -> str:
    """What a user who stopped an identification can do: go on from what was drawn, where something was."""
    kept = args.out is not None and (Path(args.out) / "chains.ckpt").exists()
    again = [*words, *(["--resume"] if kept and not args.resume else [])]
    said = "; what was drawn is kept. Go on with: " if kept else "; nothing was drawn yet. Run it again: "
    return said + quoted(["bayes-iwan", *again])


@command(
    "identify",
    "the joint posterior of a campaign's tests",
    CAMPAIGN,
    *RESULTS,
    CONFIG,
    argument("--per-test", action="store_true", help="also identify each frequency alone, into DIR/per_test"),
    argument("--resume", action="store_true", help="go on from DIR/chains.ckpt where a run was stopped"),
    argument(
        "--keep-chains",
        action="store_true",
        help="keep DIR/chains.ckpt, with every draw, when converged (default: DIR/posterior.nc with a few thousand)",
    ),
    argument("--quick", action="store_true", help="optimum and first draws, not asked whether they have converged"),
    SIMULATOR,
    workers(f"{CHAINS_IN} where there are as many cores; 1 with --per-test"),
    examples=(
        "bayes-iwan identify campaign --quick",
        "bayes-iwan identify campaign --out results --seed 1",
        "bayes-iwan identify campaign --out results --resume",
    ),
)
def run_identify(args: argparse.Namespace) -> int:
    import warnings

    import numba

    from bayes_iwan import Model, NotConverged, identify
    from bayes_iwan.inference.results.held_out_frequencies import held_out_said

    warnings.simplefilter("ignore", NotConverged)  # said below

    default = min(numba.get_num_threads(), CHAINS_IN)
    asked = args.workers if args.workers is not None else 1 if args.per_test else default
    options = given(args, "config seed overwrite per_test resume keep_chains simulator quick")
    posterior = identify(args.campaign, args.out, workers=asked, **options)
    units = posterior.problem.units
    iwan = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N")
    wanted = iwan if isinstance(posterior.problem.model, Model) else posterior.problem.names
    for row in posterior.summary():
        if row.name in wanted:
            say(f"{units.name(row.name):20s} {row.q50:.4g}  ({row.q05:.4g} to {row.q95:.4g}) {row.unit}")
    residual = posterior.residual_size()
    say(f"{'gap':20s} {residual.gap_N:.3g} {units.force} RMS, {residual}")
    if posterior.held_out and all(x.holds for x in posterior.held_out):
        say(held_out_said(posterior.held_out))
    for text in posterior.warnings():
        say(text)
    if not posterior.quick:  # of quick draws the lines above say it
        say(posterior.message)
    page = Path(args.out) / "report.html"
    say(f"results are in {args.out}" + (f"; open {page}" if page.exists() else ""))
    if posterior.interrupted:
        say(f"stopped{going_on(args, args.words)}")
        return 130
    return 0 if posterior.converged or posterior.quick else 3


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
    own_file("--simulator", "Python file of the model that was identified"),
    argument("--pdf", action="store_true", help="also report.pdf: the page, printed by Chromium, Chrome or Edge"),
    examples=("bayes-iwan report results", "bayes-iwan report results --campaign moved/campaign --pdf"),
)
def run_report(args: argparse.Namespace) -> None:
    from bayes_iwan.report.identification.identification_page import report_run

    say(str(report_run(args.folder, **given(args, "campaign pdf per_frequency simulator"))))


@command(
    "compare",
    "fit model families to a campaign and rank them by how well they predict",
    CAMPAIGN,
    *RESULTS,
    argument("--families", metavar="NAME", nargs="+", help="families to compare (default: all)", offers=_families),
    CONFIG,
    own_file("--simulator", "Python file with a model of your own to compare too"),
    argument(
        "--by",
        choices=("auto", "loo", "tests"),
        default="auto",
        help="rank by single data held out (ArviZ LOO), by whole tests held out, or by the first where its Pareto k "
        "hold (auto)",
    ),
    workers(),
    examples=("bayes-iwan compare campaign --out families",),
)
def run_compare(args: argparse.Namespace) -> int:
    from bayes_iwan import compare

    options = given(args, "families config seed overwrite by simulator workers")
    result = compare(args.campaign, args.out, **options)
    say(str(result))
    say(f"results are in {args.out}; open {Path(args.out) / 'compare.html'}")
    return 0 if result.converged else 3


@command(
    "diagnose",
    "where the model misses, which cause explains it, how far the gap shrinks",
    CAMPAIGN,
    *RESULTS,
    argument(
        "--base",
        metavar="NAME",
        default="generalized",
        offers=_bases,
        help="model to start from: generalized (default), no_speed or classical",
    ),
    CONFIG,
    argument("--effects", metavar="FILE", default=(), help="Python file with effects of your own; its code is run"),
    SIMULATOR,
    STOP_AT_REFITS,
    workers(f"as many as there are cores, {WORKERS_MOST} at most"),
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

        options = given(args, "seed overwrite quick base config effects simulator")
        found = diagnose(args.campaign, args.out, workers=executor, **options)
    say("\n".join(found.sentences()))
    say(f"results are in {args.out}; open {args.out}/diagnosis.html")


@command(
    "batch",
    "identify or diagnose every campaign in a folder, with a table and a page across specimens",
    argument("folder", metavar="FOLDER", help="a folder of campaign folders"),
    *RESULTS,
    argument("--identify", action="store_true", help="identify every campaign (default, unless --diagnose)"),
    argument("--diagnose", action="store_true", help="diagnose every campaign"),
    argument("--quick", action="store_true", help="identify and diagnose by their quick ways, in seconds"),
    CONFIG,
    argument("--keep-chains", action="store_true", help="keep every draw of every specimen (chains.ckpt)"),
    argument(
        "--group", metavar="COLUMN", help="column of FOLDER/specimens.csv with each specimen's lot", offers=_columns
    ),
    workers(),
    examples=(
        "bayes-iwan batch specimens --out population --quick",
        "bayes-iwan batch specimens --out population --diagnose --workers 4",
    ),
)
def run_batch(args: argparse.Namespace) -> int:
    from bayes_iwan import batch

    options = given(args, "diagnose quick seed overwrite config keep_chains group workers")
    result = batch(args.folder, args.out, identify=args.identify or not args.diagnose, **options)
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
    "export",
    "the identified device as files that run elsewhere: C, FMU, OpenSees, MuJoCo, Drake, JSON",
    argument("folder", metavar="RUN", help="folder that identify or diagnose wrote"),
    argument("--to", metavar="TARGET", required=True, help=", ".join(TARGETS), offers=lambda **_: TARGETS),
    OUT,
    argument("--draws", metavar="N", type=int, default=20, help="draws beside the point estimate (default: 20)"),
    argument("--campaign", metavar="DIR", help="the campaign's folder: for a diagnosis, or where it has moved"),
    own_file("--simulator", "the Python file of a run with a simulator of your own (json)"),
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

    options = given(args, "draws approximate campaign simulator error")
    folder = export(args.folder, args.to, args.out, **options)
    say((folder / "model_card.txt").read_text(encoding="utf-8").rstrip())
    say(f"{', '.join(sorted(p.name for p in folder.iterdir() if p.is_file()))} are in {args.out}")
