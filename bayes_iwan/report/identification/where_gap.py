"""What a page's checks found, collected for its answer: a reader of the answer alone must not miss a failed check."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.comparison.frequencies import Frequencies
from bayes_iwan.inference.results.held_out_frequencies import held_out_said
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL
from bayes_iwan.report.identification.loops import draw_loop, test_name
from bayes_iwan.report.identification.predictive import Predictive, predict
from bayes_iwan.report.identification.predictive_checks import RegionChecks
from bayes_iwan.report.identification.tables import LoopRow
from bayes_iwan.report.page import Finding
from bayes_iwan.report.style import BLUE, ORANGE, styled, subplots

#: share of loop regions with p < 0.05 above which the model is said to miss more than it admits
REGIONS_LARGE = 0.1


def regions_finding(result: RegionChecks) -> Finding:
    """How many parts of the fitted loops have a larger residual than the model's own replicates would be."""
    fitted = [t for t, loop in enumerate(result.loops) if loop.role != "held-out"]
    p = result.p_value[fitted]
    low = int(np.sum(p < 0.05))
    said = (
        f"{low} of {p.size} loop regions miss by more than 95 % of the model's own replicates would (by chance about "
        f"{0.05 * p.size:.0f})."
    )
    return Finding(said, low <= REGIONS_LARGE * p.size, "Is the model enough?")


def findings(posterior: Posterior, regions: RegionChecks, by_frequency: Frequencies) -> list[Finding]:
    """Every check of an identification."""
    found = [Finding(text) for text in posterior.warnings()]
    if posterior.converged and not posterior.quick:
        found.append(Finding("The chains have converged.", True, "Sampling"))
    share = posterior.residual_size().gap_share
    if share <= LARGE_RESIDUAL:
        found.append(Finding(f"The gap is {100 * share:.2g} % of the friction force.", True))
    if posterior.held_out and all(x.holds for x in posterior.held_out):
        found.append(Finding(held_out_said(posterior.held_out), True, "Is the model enough?"))
    found.append(regions_finding(regions))
    if len(by_frequency.groups) > 1:
        found.append(Finding(by_frequency.statement(), by_frequency.agree, "Each frequency alone"))
    tests = () if posterior.campaign is None else posterior.campaign.tests
    if noted := [x.file for x in tests if x.warnings]:
        found.append(Finding(f"Something was noticed about {len(noted)} of {len(tests)} records; see the table below."))
    return found


@styled
def headline_figure(posterior: Posterior, tests: Sequence[LoopRow], predictive: Predictive | None = None) -> Figure:
    """The answer in one picture: the loop with the largest gap, measured and predicted, and what each test misses."""
    p = predict(posterior) if predictive is None else predictive
    worst = int(np.argmax([x.residual_share for x in tests]))
    figure, axes = subplots(1, 2, 7.8, max(2.9, 0.2 * len(tests) + 1.0), width_ratios=(1.3, 1))
    left, right = axes[0]
    draw_loop(left, p, worst, friction=True)
    left.set_title(f"{test_name(p.loops[worst])}: largest gap", loc="left")
    left.set(xlabel="displacement u (mm)", ylabel="friction force (N)")
    share = [100.0 * x.residual_share for x in tests]
    at = np.arange(len(tests))
    colours = [ORANGE if s > 100.0 * LARGE_RESIDUAL else BLUE for s in share]
    right.barh(at, share, color=colours, height=0.6)
    right.set_yticks(at, [x.test for x in tests])
    right.invert_yaxis()
    right.grid(axis="y", visible=False)
    right.set_xlabel("residual / friction force, RMS (%)")
    right.set_title("what the model misses", loc="left")
    return figure
