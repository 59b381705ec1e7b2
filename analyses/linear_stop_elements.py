"""Does the base model fit as well as plain stop elements? Its gap beside that of a linear fit, campaign by campaign.

    python analyses/linear_stop_elements.py [FOLDER ...] [--elements 20] [--seed 0] [--out table.csv]

The linear model has 20 stop elements (elastic, ideally plastic; yield displacements evenly spaced in the logarithm up
to the largest amplitude) and a spring, their stiffnesses by least squares: it knows no normal force that varies, and is
independent of everything in bayes_iwan but the averaged loops. The base is fitted twice: by least squares alone (priors
kept), which says what its form can do, and as a diagnosis fits it, beside a correlated discrepancy. Where the first
misses much less than the second, the discrepancy takes what the model could fit; where the linear model misses less
than the first, the form, the priors or the search are at fault. RMS residual less each test's mean, N, over the tests
that are fitted, and of each test when the others are fitted. FOLDER: campaign folders, or one that holds several
(default: ../shared/data).
"""

from __future__ import annotations

import argparse
import csv
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import CampaignError, Loop, read_campaign
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.evidence import base_problem
from bayes_iwan.diagnosis.search.base_fit import cheapest, fit_base
from bayes_iwan.fitting.descent import descend
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.parameter import Z_LIMIT

#: least yield displacement over the largest amplitude, and ridge over the largest singular value: elements that no loop
#: tells apart share their load
LEAST, RIDGE = 0.01, 1e-6
#: of a posterior's scores, those beyond are named as at the edge of their prior
EDGE = 2.5
#: columns of the table, headings and names: what is fitted, the base as diagnosed, by least squares, the linear fit,
#: and the last two on held-out tests
COLUMNS = (
    ("force", "force_N"),
    ("base", "base_N"),
    ("base, LSQ", "least_squares_N"),
    ("linear", "linear_N"),
    ("LSQ, out", "least_squares_held_out_N"),
    ("lin., out", "linear_held_out_N"),
)
#: prior draws and starts of the base's least squares, and how many independent data a loop counts for in it
DRAWS, STARTS, DATA_A_TEST = 800, 12, 16


def stop_elements(displacement_mm: Array, yields_mm: Array) -> Array:
    """Steady deflections (samples, elements) of stop elements on a periodic displacement (samples,)."""
    e, last = np.zeros(len(yields_mm)), 0.0
    out = np.empty((displacement_mm.size, len(yields_mm)))
    for _ in range(2):  # one cycle brings them to their steady state
        for i, u in enumerate(displacement_mm):
            e = np.clip(e + u - last, -yields_mm, yields_mm)
            out[i], last = e, u
    return out


def columns(loop: Loop, yields_mm: Array) -> Array:
    """(samples, elements + 1) what the linear model is a sum of, without its mean."""
    parts = np.column_stack([loop.displacement_mm, stop_elements(loop.displacement_mm, yields_mm)])
    return np.asarray(parts - parts.mean(axis=0))


def linear_residuals(fitted: list[Loop], other: list[Loop], elements: int) -> Array:
    """(tests, samples) of `other` by the linear model of `fitted`."""
    yields = np.geomspace(LEAST, 1.0, elements) * max(x.amplitude_mm for x in fitted)
    a = np.concatenate([columns(x, yields) for x in fitted])
    b = np.concatenate([x.force_N - x.force_N.mean() for x in fitted])
    found = np.linalg.lstsq(a, b, rcond=RIDGE)[0]
    return np.stack([x.force_N - x.force_N.mean() - columns(x, yields) @ found for x in other])


def base_of(fitted: list[Loop], seed: int) -> tuple[Problem, Array]:
    """The diagnosis' base and its most probable point (ndim,)."""
    fit = fit_base(gap_data(tuple(fitted)), DiagnoseSettings(), scales_of(fitted), np.random.default_rng(seed))
    return fit.problem, fit.z


def base_by_least_squares(fitted: list[Loop], seed: int) -> tuple[Problem, Array]:
    """The same base where it misses least beside white noise of a twentieth of the friction force, and its priors."""
    data = gap_data(tuple(fitted))
    problem = base_problem(data, DiagnoseSettings(), scales_of(fitted))
    draws = problem.prior.draw(np.random.default_rng(seed), DRAWS)
    sd = 0.05 * data.level_N[:, None] * np.sqrt(fitted[0].force_N.size / DATA_A_TEST)

    def rows(z: Array) -> Array:
        with np.errstate(all="ignore"):
            residual = problem.residual(z)
        residual = (residual - residual.mean(axis=2, keepdims=True)) / sd
        return np.concatenate([residual.reshape(len(z), -1), z], axis=1)

    starts = cheapest(data, problem, draws, STARTS)
    box = np.tile([-Z_LIMIT, Z_LIMIT], (problem.ndim, 1))
    fit = descend(rows, starts, box, 60)
    return problem, fit.x[fit.best]


def base_residuals(problem: Problem, z: Array, other: list[Loop]) -> Array:
    """(tests, samples) of `other` by a base."""
    found = problem.predict(z[None], motion_of(other))[0]
    residual = np.stack([x.force_N for x in other]) - found
    return np.asarray(residual - residual.mean(axis=1, keepdims=True))


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def compared(folder: Path, elements: int, seed: int) -> dict[str, object]:
    """One row of the table."""
    loops = [replace(x, role="fit") for x in read_campaign(folder).loops()]
    (problem, z), (_, least) = base_of(loops, seed), base_by_least_squares(loops, seed)
    at_edge = [f"{n} {s:+.1f}" for n, s in zip(problem.names, z) if abs(s) > EDGE]
    row: dict[str, object] = {
        "campaign": folder.name,
        "tests": len(loops),
        "force_N": rms(np.stack([x.force_N - x.force_N.mean() for x in loops])),
        "base_N": rms(base_residuals(problem, z, loops)),
        "least_squares_N": rms(base_residuals(problem, least, loops)),
        "linear_N": rms(linear_residuals(loops, loops, elements)),
        "least_squares_held_out_N": float("nan"),
        "linear_held_out_N": float("nan"),
        "at_edge": "; ".join(at_edge),
    }
    if len(loops) > 2:
        base, linear = [], []
        for i, one in enumerate(loops):
            others = loops[:i] + loops[i + 1 :]
            base.append(base_residuals(*base_by_least_squares(others, seed), [one]))
            linear.append(linear_residuals(others, [one], elements))
        row |= {"least_squares_held_out_N": rms(np.stack(base)), "linear_held_out_N": rms(np.stack(linear))}
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--elements", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="also write the table as CSV")
    args = parser.parse_args()
    given = args.folders or [Path(__file__).resolve().parents[2] / "shared" / "data"]
    folders = [f for g in given for f in ([g] if (g / "campaign.toml").exists() else sorted(g.iterdir()))]
    rows = []
    print(
        "RMS, N".ljust(27) + "".join(f"{n:>10s}" for n in ("tests", *(h for h, _ in COLUMNS))) + "  at its prior's edge"
    )
    for folder in folders:
        if not (folder / "campaign.toml").exists():
            continue
        try:
            row = compared(folder, args.elements, args.seed)
        except (CampaignError, ValueError) as problem:
            print(f"{folder.name:27s}{problem}")
            continue
        rows.append(row)
        shown = f"{folder.name:27s}{row['tests']:10d}" + "".join(f"{row[n]:10.4g}" for _, n in COLUMNS)
        print(f"{shown}  {row['at_edge']}", flush=True)
    if args.out and rows:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        with args.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
