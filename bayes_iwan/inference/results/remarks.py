"""What a reader of a posterior's intervals must know before using them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayes_iwan.inference.results.floors import floors_said
from bayes_iwan.inference.results.held_out_frequencies import held_out_said
from bayes_iwan.inference.results.predictions import residual_size
from bayes_iwan.inference.results.reach import LEFT_TO_FAMILY

if TYPE_CHECKING:
    from bayes_iwan.inference.results.posterior import Posterior

#: share of the friction force above which a residual is called large
LARGE_RESIDUAL = 0.03
#: the gap at the minimum of Eq. (8) over the posterior's below which that point is pointed out
LESS = 0.8
#: searches whose best log posteriors differ by more have not found the same maximum
SHORT_NATS = 2.0
#: prior standard scores beyond which a median is said to lie at the end of its prior
AT_THE_END = 3.0
#: ... or that its 90 % interval, which leaves the prior's median out, ends so near a bound of the prior, over the
#: interval's width
NEAR_THE_BOUND = 0.02


def at_a_bound(posterior: Posterior) -> dict[str, str]:
    """Parameters whose 90 % interval leaves out the prior's median and ends at a bound ("upper", "lower") of the prior:
    that end is not set by the loops."""
    out, free = {}, posterior.problem.prior.free
    for p, (least, most) in zip(free, np.quantile(posterior.flat_z(), [0.05, 0.95], axis=0).T):
        low, high = p.value(np.array([least, most]))
        near = NEAR_THE_BOUND * (high - low)
        if (least > 0.0 and p.upper - high < near) or (most < 0.0 and low - p.lower < near):
            out[p.name] = "upper" if least > 0.0 else "lower"
    return out


def remarks(posterior: Posterior) -> tuple[str, ...]:
    """One sentence each: not sampled or not converged, searches that disagree, a large residual, bands
    that do not hold a held-out frequency, parameters at the end of their prior, numbers that are extrapolated,
    floors that act."""
    out = []
    if posterior.quick:
        out.append(
            "Quick: the first draws of a short run, which was not asked whether it has converged; intervals are "
            "rather too narrow."
        )
    elif not posterior.converged:
        out.append(f"The chains have not converged ({posterior.message}); read every interval as too narrow.")
    said, agree = searches_said(posterior)
    if len(posterior.point.each_log_prob) > 1 and not agree:
        out.append(said)
    residual = posterior.residual_size()
    if residual.gap_share > LARGE_RESIDUAL:
        out.append(
            f"The model misses the friction force by {100 * residual.gap_share:.2g} %: the intervals hold for a model "
            "that fits, so diagnose the campaign, and check priors and fixed values."
        )
        least = residual_size(posterior.problem, posterior.point.goal_z[None])
        if least.gap_N < LESS * residual.gap_N:
            out.append(
                "The point that minimises Eq. (8) (eq8_minimum in point.json) misses it by "
                f"{100 * least.gap_share:.2g} % only. The likelihood takes what no values of the model can fit as its "
                "discrepancy, and fits what is left; where you need a force rather than parameters, take that point."
            )
    if not all(x.holds for x in posterior.held_out):
        out.append(held_out_said(posterior.held_out))
    z, prior = posterior.flat_z(), posterior.problem.prior
    bounds = at_a_bound(posterior)
    for p, score in zip(prior.free, np.median(z, axis=0)):
        end = ("upper" if score > 0.0 else "lower") if abs(score) > AT_THE_END else bounds.get(p.name, "")
        if end and p.name not in posterior.problem.noise_names:
            far = f", {abs(score):.2g} prior sd from its median" if abs(score) > AT_THE_END else ""
            out.append(
                f"{p.name} lies at the {end} end of its prior ({p.prior_text()}{far}). Widen the prior, or look for an "
                "effect that the model lacks."
            )
    why = posterior.extrapolated
    for said in dict.fromkeys(why[name] for name in LEFT_TO_FAMILY if name in why):
        out.append(f"{', '.join(n for n in LEFT_TO_FAMILY if why.get(n) == said)}: {said}.")
    out += floors_said(posterior.problem, posterior.point.z)
    return posterior.problem.units.everywhere(tuple(out))


def searches_said(posterior: Posterior) -> tuple[str, bool]:
    """Whether independent searches found the same maximum, in words, and whether they did."""
    point = posterior.point
    count = len(point.each_log_prob)
    if count < 2:
        return "One search only: a higher maximum elsewhere would not be seen.", False
    if point.short_nats < SHORT_NATS:
        return (
            f"{count} searches with populations of their own ended in the same maximum (their best log posteriors "
            f"differ by {point.short_nats:.1g})."
        ), True
    best, poorest = (point.each_z[int(f(point.each_log_prob))] for f in (np.argmax, np.argmin))
    values = posterior.problem.prior.values(np.stack([best, poorest]))
    furthest = [posterior.names[i] for i in np.argsort(-np.abs(best - poorest))[:3]]
    apart = ", ".join(f"{n} {values[n][0]:.4g} against {values[n][1]:.4g}" for n in furthest)
    return (
        f"The searches disagree: of {count}, each with a population of its own, one stayed {point.short_nats:.3g} "
        f"below the best log posterior, furthest apart in {apart}. There are several maxima; another search may find "
        "one more; the chains started from all that were found."
    ), False
