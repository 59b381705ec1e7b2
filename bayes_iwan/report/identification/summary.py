"""The head of an identification's page: the answer, how far to trust it, what is not known, and what symbols mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL
from bayes_iwan.models import Model
from bayes_iwan.report.identification import marginals
from bayes_iwan.report.identification.compared_loops import Compared, LoopRow
from bayes_iwan.report.identification.marginals import OPEN, contraction, number, reported, symbol_of
from bayes_iwan.report.identification.predictive import Predictive
from bayes_iwan.report.identification.where_gap import Finding, headline_figure
from bayes_iwan.report.page import Section

#: what a customer asks of the model first, and in words that need no paper
_FIRST = {
    "kp_N_mm": "parallel spring: stiffness once all contacts slide",
    "k1_N_mm": "sticking contacts: stiffness that they add before they slide",
    "mean_slip_force_N": "friction: mean slip force of the contacts",
}
_NOT_VISIBLE = (
    "A gain error of the displacement or force channel: stiffnesses and slip forces would absorb all of it. Check both "
    "sensors against a known spring.",
    "A compliance of the fixture in series with the specimen: the stiffnesses would absorb it too.",
)
QUANTILES = tuple(
    (f"φ {share} %", f"slip force that {share} % of the contacts slip below, at rest", "N") for share in (25, 50, 75)
)
_OF_CONTACTS = (*QUANTILES, ("α", "relative normal force: that of the contacts over its value at rest", ""))


def identification_answer(
    section: Section, posterior: Posterior, loops: Sequence[LoopRow], p: Predictive, found: Sequence[Finding]
) -> None:
    """What the checks found, a picture, stiffness, friction, damping and residual with their intervals; what is not
    known."""
    section.status([(x.text, x.good, x.section) for x in found])
    section.figure(
        headline_figure(posterior, loops, p),
        "Left: the test that the model misses most, measured (dotted) over the bands in which 50 and 90 % of further "
        "cycles are expected. Right: what the median prediction misses of each test's friction force; orange: more "
        f"than {100 * LARGE_RESIDUAL:.0f} %.",
        "A measured and predicted friction loop, and bars of the residual of every test.",
        name="headline",
    )
    residual = posterior.residual_size()
    fitted = [x for x in loops if not x.held_out]
    rows = [_number_row(posterior, name) for name in _asked(posterior)]
    rows += [
        _range_row("equivalent stiffness of the tests", "N/mm", [x.stiffness_N_mm for x in fitted]),
        _range_row("energy lost a cycle", "mJ", [x.energy_mJ for x in fitted]),
        _range_row("damping: loss factor of the tests", "", [x.loss_factor for x in fitted]),
    ]
    worst = max(fitted, key=lambda x: x.residual_share)
    rows.append(
        (
            "gap: what the model misses beyond noise, RMS",
            f"{number(residual.gap_N, residual.rms_N)} N",
            f"{100 * residual.gap_share:.2g} % of the friction force",
        )
    )
    rows.append(
        (
            "residual: the same with noise, RMS",
            f"{number(residual.rms_N, residual.rms_N)} N",
            f"{100 * residual.share:.2g} % of the friction force (worst test, {worst.test}: "
            f"{100 * worst.residual_share:.2g} %)",
        )
    )
    section.table(("what", "value", "90 % interval, or range over the tests"), rows, "The answer")
    held = len(loops) - len(fitted)
    section.text(
        f"From {len(fitted)} test{'s' if len(fitted) != 1 else ''}"
        + (f" ({held} more held out)" if held else "")
        + ". Values are medians of the posterior's draws, intervals hold 90 % of them; the same are in summary.csv."
    )
    section.text("bayes-iwan diagnose says whether the gap has a cause.")
    section.heading_below("What is not known")
    section.bullets(_open(posterior))
    tests_read = () if posterior.campaign is None else posterior.campaign.tests
    warnings = [(x.file, w) for x in tests_read for w in x.warnings]
    if warnings:
        section.table(("record", "what was noticed"), warnings, "Warnings about the records")


def _asked(posterior: Posterior) -> list[str]:
    """Names of the quantities that the answer opens with: the first three, or a user's own model's determined ones."""
    if isinstance(posterior.problem.model, Model):
        return [n for n in _FIRST if n in posterior.quantities()]
    noise = {q.name for q in posterior.problem.likelihood.parameters}
    shrunk = dict(zip(posterior.names, contraction(posterior.flat_z(4000))))
    return [n for n in posterior.names if n not in noise and shrunk[n] >= OPEN][:6]


def _number_row(posterior: Posterior, name: str) -> tuple[str, str, str]:
    middle, low, high = reported(posterior, name)
    unit = posterior.quantities()[name].unit
    unit = "" if unit in ("", "-") else f" {unit}"
    by_name = {q.name: q.description for q in posterior.problem.prior.parameters}
    words = _FIRST.get(name, by_name.get(name, name))
    return f"{words} ({symbol_of(posterior, name)})", f"{middle}{unit}", f"{low} to {high}{unit}"


def _range_row(title: str, unit: str, tests: Sequence[Compared]) -> tuple[str, str, str]:
    """Smallest to largest of the tests, measured; and predicted with the outer ends of the intervals."""
    measured = [x.measured for x in tests]
    low, high = min(x.q05 for x in tests), max(x.q95 for x in tests)
    unit = f" {unit}" if unit else ""
    spread = max(max(measured) - min(measured), 0.02 * abs(max(measured)))
    value = f"{number(min(measured), spread)} to {number(max(measured), spread)}{unit}"
    if len(tests) == 1:
        value = f"{measured[0]:.4g}{unit}"
    return title, value, f"measured; predicted {number(low, spread)} to {number(high, spread)}{unit}"


def _open(posterior: Posterior) -> list[str]:
    """What these loops leave open, a line each."""
    out = []
    shrunk = contraction(posterior.flat_z(4000))
    noise = {q.name for q in posterior.problem.likelihood.parameters}
    loose = [
        f"{q.symbol} ({q.description})"
        for q, c in zip(posterior.problem.prior.free, shrunk)
        if c < OPEN and q.name not in noise
    ]
    if loose:
        out.append("Not determined one by one (posterior about as wide as the prior): " + "; ".join(loose) + ".")
    out += [f"{symbol_of(posterior, name)}: {why}" for name, why in posterior.extrapolated.items()]
    return [*out, *_NOT_VISIBLE]


def determined(section: Section, posterior: Posterior) -> None:
    """Every sampled parameter against its prior, the quantities that loops determine, and their joint posterior."""
    prior = posterior.problem.prior
    section.text("Symbols of this page:")
    section.symbols(
        [
            *((q.symbol, q.description, q.unit) for q in prior.parameters),
            *(_OF_CONTACTS if isinstance(posterior.problem.model, Model) else ()),
        ]
    )
    section.figure(
        marginals.prior_posterior_figure(posterior),
        "Each sampled parameter against its prior. Grey: the prior's 50 and 90 % intervals; blue: the posterior's; red "
        "with an open circle: hardly determined (contraction below 0.5). Contraction is one minus the posterior's "
        "variance over the prior's, on the prior's scale. The numbers at the right are those of summary.csv.",
        "Point and interval of every sampled parameter on the scale of its prior, with median, 90 % interval "
        "and contraction; the same numbers are in the table of parameters.",
        name="parameters",
    )
    draws, labels = marginals.identifiable(posterior)
    rows = [
        (labels[n], *reported(posterior, n), posterior.extrapolated.get(n, "reached by the loops"))
        for n in draws
        if n in posterior.quantities()
    ]
    section.table(
        ("quantity", "median", "90 % from", "to", "reach"),
        rows,
        "Quantities that the loops determine, as in summary.csv: medians and 90 % intervals of the posterior's draws. "
        "What no loop reaches is named as extrapolated.",
    )
    embedded = _embedded(posterior)
    section.figure(
        marginals.corner_figure({n: x for n, x in draws.items() if n not in embedded}, labels),
        "Joint posterior of the determined quantities, the embedded model error omitted; contours hold 50 and 90 %.",
        "Corner plot: marginal histograms on the diagonal, pairwise contours below it.",
        png=True,
        name="corner",
    )


def _embedded(posterior: Posterior) -> set[str]:
    """Names of the parameters of the embedded model error."""
    from bayes_iwan.models.iwan_parameters import embedded_parameters

    return {q.name for q in embedded_parameters()} & set(np.array(posterior.names))
