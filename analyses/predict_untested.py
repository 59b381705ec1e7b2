"""Predict tests that were not fitted, and see whether the intervals hold what was then measured.

    python analyses/predict_untested.py CAMPAIGN --out predict.png
    python analyses/predict_untested.py --rig 10 --seed 17 --by frequency [--quick]

Each frequency, and each amplitude, is held out in turn (where others remain); the rest is identified by a short run
and predicts it. Shown: the residual of every held-out loop within its 50 and 90 % bands, and the coverage. --quick:
frequencies of the rig's specimens as the page of a quick identification has them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

import bayes_iwan as bi
from bayes_iwan.comparison.families import SHORT
from bayes_iwan.inference.results.held_out_frequencies import HELD, held_out_frequencies, held_out_said
from bayes_iwan.inference.setup.quantities import loop_quantities
from bayes_iwan.report.axes import band
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import predict
from bayes_iwan.report.style import BLACK, save, styled, subplots

#: a short run of the default model
SETTINGS = replace(SHORT, model=bi.IdentifySettings().model)


def folds(loops, what=("frequency_hz", "amplitude_mm")):
    """Names of the held-out groups and the tests in them: every nominal frequency, every nominal amplitude."""
    out = {}
    for name in what:
        values = sorted({getattr(x.record, name) for x in loops})
        for v in values if len(values) > 1 else ():
            unit = "Hz" if name == "frequency_hz" else "mm"
            out[f"{v:g} {unit}"] = [x.file for x in loops if getattr(x.record, name) == v]
    return out


def held_out(loops, files, seed=0, settings=SETTINGS):
    """The posterior of the other tests, and its prediction of those in `files`."""
    marked = [replace(x, role="held-out" if x.file in files else "fit") for x in loops]
    posterior = bi.identify_problem(
        bi.make_problem(marked, settings), seed, config=settings, loops=marked, progress=False
    )
    return predict(posterior, [x for x in marked if x.role == "held-out"])


def coverage(p, level):
    """Share of held-out loops' points within the central `level` interval, and of their energies and stiffnesses."""
    low, high = np.quantile(p.loop_N, [0.5 - level / 2, 0.5 + level / 2], axis=0)
    points = np.mean((p.measured_N >= low) & (p.measured_N <= high))
    measured, again = loop_quantities(p.displacement_mm, p.measured_N), loop_quantities(p.displacement_mm, p.loop_N)
    inside = []
    for name in ("energy_mJ", "stiffness_N_mm"):
        low, high = np.quantile(getattr(again, name), [0.5 - level / 2, 0.5 + level / 2], axis=0)
        inside.append(np.mean((getattr(measured, name) >= low) & (getattr(measured, name) <= high)))
    return SimpleNamespace(points=float(points), parameter_values=float(np.mean(inside)))


@styled
def figure(predicted):
    """One row of panels a held-out group, one panel a test; the group's coverage in the row's title."""
    columns = max(len(p.loops) for p in predicted.values())
    made, axes = subplots(len(predicted), columns, 2.7 * columns + 0.6, 1.55 * len(predicted) + 0.7, sharex=True)
    for row, (name, p) in zip(axes, predicted.items()):
        median = np.median(p.force_N, axis=0)
        for t, ax in enumerate(row):
            if t >= len(p.loops):
                ax.remove()
                continue
            band(ax, p.loops[t].phase, p.loop_N[:, t] - median[t], median=False)
            ax.plot(p.loops[t].phase, p.measured_N[t] - median[t], color=BLACK, linewidth=1.0)
            ax.set_title(test_name(p.loops[t], role=False), fontsize=8)
            ax.set_xlim(0, 1)
            ax.set_xticks([0, 0.5, 1])
            ax.locator_params(axis="y", nbins=4)
        row[0].set_ylabel(f"without {name}\nresidual (N)")
        inside = f"{100 * coverage(p, 0.9).points:.0f} % in the 90 % band"
        row[0].set_title(inside, loc="left", fontsize=8, weight="bold")
        row[0].set_title(test_name(p.loops[0], role=False), loc="right", fontsize=8)
        row[0].set_title("", loc="center")
    made.supxlabel(
        "phase (cycles); line: measured − predicted, bands: 50 and 90 % of what was to be expected", fontsize=9
    )
    return made


HEADER = f"{'held out':>20s}  {'points in 50 %':>14s}  {'in 90 %':>8s}  {'energies, stiffnesses in 90 %':>30s}"


def table(predicted):
    """Line by line what the bands of each held-out group hold."""
    for name, p in predicted.items():
        half, most = coverage(p, 0.5), coverage(p, 0.9)
        print(
            f"{name:>20s}  {100 * half.points:13.0f}%  {100 * most.points:7.0f}%  {100 * most.parameter_values:29.0f}%",
            flush=True,
        )


def on_the_rig(count, seed, what, quick):
    """Sound specimens of the virtual rig: each held-out group, and over all of them the means."""
    from coverage_rig import simulated

    if not quick:
        print(HEADER)
    every = []
    for index in range(count):
        loops = simulated("rig", seed, index, 2000)["loops"]
        if quick:
            left = of_quick_runs(loops, index)
            print(f"{index}: {held_out_said(left) or 'one frequency only'}", flush=True)
            every += [(x.points_50, x.points_90, x.quantities_90) for x in left]
            continue
        for name, files in folds(loops, what).items():
            p = held_out(loops, files, index)
            table({f"{index}: {name}": p})
            half, most = coverage(p, 0.5), coverage(p, 0.9)
            every.append((half.points, most.points, most.parameter_values))
    half, most, others = 100 * np.mean(every, axis=0)
    print(
        f"{count} specimens, {len(every)} groups held out: 50 % bands hold {half:.0f} % of points, 90 % bands "
        f"{most:.0f} %, and {others:.0f} % of energies and stiffnesses; {sum(x[1] < HELD for x in every)} groups are "
        f"held by less than {100 * HELD:.0f} %"
    )


def of_quick_runs(loops, seed):
    """Each frequency of the loops held out, from a quick posterior of all of them."""
    problem = bi.make_problem(loops)
    return held_out_frequencies(problem, bi.identify_problem(problem, seed, quick=True, progress=False).flat_z(), seed)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", metavar="CAMPAIGN", nargs="?")
    parser.add_argument("--by", choices=("frequency", "amplitude", "both"), default="both")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="predict.png")
    parser.add_argument("--rig", type=int, metavar="N", help="N sound specimens of the virtual rig, not a campaign")
    parser.add_argument("--quick", action="store_true", help="with --rig: frequencies, by quick runs")
    args = parser.parse_args()
    what = {"frequency": ("frequency_hz",), "amplitude": ("amplitude_mm",), "both": ("frequency_hz", "amplitude_mm")}
    if args.rig:
        on_the_rig(args.rig, args.seed, what[args.by], args.quick)
    else:
        if args.campaign is None:
            parser.error("name a campaign, or give --rig N")
        every = bi.read_campaign(args.campaign).loops()
        predicted = {name: held_out(every, files, args.seed) for name, files in folds(every, what[args.by]).items()}
        print(HEADER)
        table(predicted)
        save(figure(predicted), args.out)
        print(args.out)
