"""Where the weighted loop error of Eqs. (8) and (9) stands in the likelihood, and what leaving the weights out changes.

    python analyses/weighted_error.py [data/rope_spring] [--out weighted_error]

Prints, harmonic by harmonic, which share of the variance of the compared loop error the discrepancy has, whose variance
the weights shape, and which the noise has; then the same numbers identified with the weights and without, and by the
paper's own way, the minimum of Eq. (8). The derivation is in analyses/guide/likelihood.md.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import read_campaign
from bayes_iwan.inference.setup.discrepancy import Correlated
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.setup.settings import SamplingSettings, SearchSettings
from bayes_iwan.inference.solving.point import Point, find_point, near_optima
from bayes_iwan.inference.solving.posterior_draws import QUICK, Run, sampled

SHOWN = ("kp_N_mm", "k1_N_mm", "mean_slip_force_N", "slip_force_q50_N")


def discrepancy_share(problem: Problem, z: Array) -> Array:
    """(harmonics,) of each harmonic's variance, the mean over tests: what the discrepancy has of it at z (ndim,)."""
    likelihood = problem.likelihood
    assert isinstance(likelihood, Correlated)
    values = problem.parameter_values(z[None])
    noise = likelihood.noise_N**2 * values["noise_scale"][0] ** 2
    smooth = likelihood.level[:, None] ** 2 * likelihood.spectrum.variance(values, likelihood.used)[0]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nanmean(np.where(np.isfinite(noise), smooth / (smooth + noise), np.nan), axis=0))


def identified(problem: Problem, point: Point) -> dict[str, tuple[float, float]]:
    """Median and standard deviation of each shown quantity, from quick draws."""
    optima = near_optima(point.optima, point.optima_log_prob)
    found = quantities(problem, sampled(problem, optima, replace(SamplingSettings(), **QUICK), Run(0)).flat(1000))
    return {n: (float(np.median(found[n].values)), float(np.std(found[n].values))) for n in SHOWN}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", nargs="?", type=Path, default=Path(__file__).parent.parent / "data" / "rope_spring")
    parser.add_argument("--out", type=Path, default=Path("weighted_error"))
    args = parser.parse_args()
    loops = read_campaign(args.campaign).loops()
    settings, found, shares = SearchSettings(second_search=False), {}, {}
    for kind in ("correlated", "unweighted"):
        problem = make_problem(loops, {"likelihood": {"kind": kind}})
        point = find_point(problem, 0, settings, progress=False)
        found[kind], shares[kind] = identified(problem, point), discrepancy_share(problem, point.z)
        if kind == "correlated":
            eq8 = quantities(problem, point.goal_z[None])
    print("share of the variance that the discrepancy has, by harmonic (weighted / unweighted):")
    for h, (a, b) in enumerate(zip(shares["correlated"], shares["unweighted"])):
        if h < 10:
            print(f"  {h:2d}  {100 * a:5.1f} %  {100 * b:5.1f} %")
    print(f"{'':20s} {'with weights':>24s} {'without':>24s} {'moved, sd':>10s} {'minimum of Eq. (8)':>20s}")
    for name in SHOWN:
        (m, s), (other, t) = found["correlated"][name], found["unweighted"][name]
        print(
            f"{name:20s} {m:12.5g} ± {s:9.2g} {other:12.5g} ± {t:9.2g} {(other - m) / s:10.2f} "
            f"{float(eq8[name].values[0]):20.5g}"
        )
    args.out.mkdir(parents=True, exist_ok=True)
    figure(shares).savefig(args.out / "weighted_error.png", dpi=130)
    print(f"written: {args.out / 'weighted_error.png'}")


def figure(shares: dict[str, Array]) -> Figure:
    """The discrepancy's share of each harmonic's variance."""
    fig = Figure(figsize=(5.2, 3.0), layout="constrained")
    ax = fig.add_subplot()
    for (kind, share), offset in zip(shares.items(), (-0.2, 0.2)):
        ax.bar(np.arange(len(share)) + offset, 100 * share, 0.4, label="weighted" if kind == "correlated" else kind)
    ax.set(xlabel="harmonic of the test frequency (0: mean)", ylabel="discrepancy's share of the variance (%)")
    ax.legend(frameon=False)
    return fig


if __name__ == "__main__":
    main()
