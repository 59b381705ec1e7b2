"""Commands that identify: one campaign, its report, other families, a folder of specimens."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from bayes_iwan.cli.command import (
    CAMPAIGN,
    CONFIG,
    OUT,
    OVERWRITE,
    SEED,
    SIMULATOR,
    argument,
    command,
    quoted,
    say,
    workers,
)

#: processes that a posterior's chains go in, if they must go along its manifold
CHAINS_IN = 2


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
    OUT,
    OVERWRITE,
    SEED,
    CONFIG,
    argument("--per-test", action="store_true", help="also identify each frequency alone, into DIR/per_test"),
    argument("--resume", action="store_true", help="go on from DIR/chains.ckpt where a run was stopped"),
    argument(
        "--keep-chains",
        action="store_true",
        help="keep DIR/chains.ckpt, with every draw, when converged (default: DIR/posterior.nc with a few thousand)",
    ),
    argument(
        "--quick",
        action="store_true",
        help="optimum and first draws, not asked whether they have converged",
    ),
    SIMULATOR,
    *workers(f"{CHAINS_IN} where there are as many cores; 1 with --per-test"),
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
    posterior = identify(
        args.campaign,
        args.out,
        config=args.config,
        seed=args.seed,
        overwrite=args.overwrite,
        per_test=args.per_test,
        resume=args.resume,
        keep_chains=args.keep_chains,
        simulator=args.simulator,
        quick=args.quick,
        workers=args.workers if args.workers is not None else 1 if args.per_test else default,
    )
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
    argument("--simulator", metavar="FILE", help="Python file of the model that was identified; its code is run"),
    argument("--pdf", action="store_true", help="also report.pdf: the page, printed by Chromium, Chrome or Edge"),
    examples=(
        "bayes-iwan report results",
        "bayes-iwan report results --campaign moved/campaign --pdf",
    ),
)
def run_report(args: argparse.Namespace) -> None:
    from bayes_iwan.report.identification.identification_page import report_run

    page = report_run(
        args.folder,
        campaign=args.campaign,
        pdf=args.pdf,
        per_frequency=args.per_frequency,
        simulator=args.simulator,
    )
    say(str(page))


@command(
    "compare",
    "fit model families to a campaign and rank them by how well they predict",
    CAMPAIGN,
    OUT,
    OVERWRITE,
    SEED,
    argument("--families", metavar="NAME", nargs="+", help="families to compare (default: all)"),
    CONFIG,
    argument(
        "--simulator", metavar="FILE", help="Python file with a model of your own to compare too; its code is run"
    ),
    argument(
        "--by",
        choices=("auto", "loo", "tests"),
        default="auto",
        help="rank by single data held out (ArviZ "
        "LOO), by whole tests held out, or by the first where its Pareto k hold (auto)",
    ),
    *workers(),
    examples=("bayes-iwan compare campaign --out families",),
)
def run_compare(args: argparse.Namespace) -> None:
    from bayes_iwan import compare

    result = compare(
        args.campaign,
        args.out,
        families=args.families,
        config=args.config,
        seed=args.seed,
        overwrite=args.overwrite,
        by=args.by,
        simulator=args.simulator,
        workers=args.workers,
    )
    say(str(result))
    say(f"results are in {args.out}; open {Path(args.out) / 'compare.html'}")


@command(
    "batch",
    "identify or diagnose every campaign in a folder, with a table and a page across specimens",
    argument("folder", metavar="FOLDER", help="a folder of campaign folders"),
    OUT,
    OVERWRITE,
    SEED,
    argument("--identify", action="store_true", help="identify every campaign (default, unless --diagnose)"),
    argument("--diagnose", action="store_true", help="diagnose every campaign"),
    argument("--quick", action="store_true", help="identify and diagnose by their quick ways, in seconds"),
    CONFIG,
    argument("--keep-chains", action="store_true", help="keep every draw of every specimen (chains.ckpt)"),
    argument("--group", metavar="COLUMN", help="column of FOLDER/specimens.csv that names each specimen's lot"),
    *workers(),
    examples=(
        "bayes-iwan batch specimens --out population --quick",
        "bayes-iwan batch specimens --out population --diagnose --workers 4",
    ),
)
def run_batch(args: argparse.Namespace) -> int:
    from bayes_iwan import batch

    result = batch(
        args.folder,
        args.out,
        identify=args.identify or not args.diagnose,
        diagnose=args.diagnose,
        quick=args.quick,
        seed=args.seed,
        overwrite=args.overwrite,
        config=args.config,
        keep_chains=args.keep_chains,
        group=args.group,
        workers=args.workers,
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
