"""The head of an identification's page: the answer, what the checks found, what is not known, what symbols mean."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.comparison.frequencies import Frequencies
from bayes_iwan.inference.results.held_out_frequencies import held_out_said
from bayes_iwan.inference.results.posterior import ConvergenceRow, Posterior
from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL
from bayes_iwan.models import Model
from bayes_iwan.models.embedded_error import DEVIATION_NAMES
from bayes_iwan.models.iwan_parameters import embedded_parameters
from bayes_iwan.report.identification import marginals
from bayes_iwan.report.identification.loops import draw_loop, test_name
from bayes_iwan.report.identification.marginals import OPEN, contraction, number, reported, symbol_of
from bayes_iwan.report.identification.predictive import Predictive
from bayes_iwan.report.identification.predictive_checks import RegionChecks
from bayes_iwan.report.identification.tables import Compared, LoopRow
from bayes_iwan.report.page import Finding, Section
from bayes_iwan.report.style import BLUE, ORANGE, styled, subplots

#: share of loop regions with p < 0.05 above which the model is said to miss more than it admits
REGIONS_LARGE = 0.1
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


@dataclass(frozen=True, kw_only=True)
class Identified:
    """What the page of an identification is made from; folder : of its files."""

    posterior: Posterior
    predictive: Predictive
    tests: tuple[LoopRow, ...]
    regions: RegionChecks
    by_frequency: Frequencies
    convergence: tuple[ConvergenceRow, ...]
    folder: Path

    @property
    def iwan(self) -> bool:
        return isinstance(self.posterior.problem.model, Model)

    @property
    def clock(self) -> bool:
        return self.posterior.loops[0].record.clock


class IdentifiedSection(Section[Identified]):
    template = "identification.html"


class Answer(IdentifiedSection):
    """What the checks found, a picture, stiffness, friction, damping and residual with their intervals; what is not
    known."""

    heading, large = "Answer", LARGE_RESIDUAL

    @property
    def found(self) -> list[Finding]:
        return findings(self.r.posterior, self.r.regions, self.r.by_frequency)

    @property
    def fitted(self) -> list[LoopRow]:
        return [x for x in self.r.tests if not x.held_out]

    @property
    def held_out(self) -> int:
        return len(self.r.tests) - len(self.fitted)

    def headline(self) -> Figure:
        return headline_figure(self.r.tests, self.r.predictive)

    def rows(self) -> list[tuple[str, str, str]]:
        size, worst = self.r.posterior.residual_size(), max(self.fitted, key=lambda x: x.residual_share)
        of_friction = [f"{100 * x:.2g} % of the friction force" for x in (size.gap_share, size.share)]
        of_friction[1] += f" (worst test, {worst.test}: {100 * worst.residual_share:.2g} %)"
        return [
            *(_number_row(self.r.posterior, name) for name in _asked(self.r.posterior)),
            _range_row("equivalent stiffness of the tests", "N/mm", [x.stiffness_N_mm for x in self.fitted]),
            _range_row("energy lost a cycle", "mJ", [x.energy_mJ for x in self.fitted]),
            _range_row("damping: loss factor of the tests", "", [x.loss_factor for x in self.fitted]),
            ("gap: what the model misses beyond noise, RMS", f"{number(size.gap_N, size.rms_N)} N", of_friction[0]),
            ("residual: the same with noise, RMS", f"{number(size.rms_N, size.rms_N)} N", of_friction[1]),
        ]

    def open(self) -> list[str]:
        """What these loops leave open, a line each."""
        p = self.r.posterior
        shrunk = zip(p.problem.prior.free, contraction(p.flat_z()))
        loose = [q for q, c in shrunk if c < OPEN and q.name not in p.problem.noise_names]
        terms = [q.symbol for q in loose if q.name in DEVIATION_NAMES]
        said = [f"{q.symbol} ({q.description})" for q in loose if q.name not in DEVIATION_NAMES]
        said += [f"{', '.join(terms)} (deviations of the slip forces' density)"] if terms else []
        wide = "Not determined one by one (posterior about as wide as the prior): "
        out = [wide + "; ".join(said) + "."] if said else []
        return [*out, *(f"{symbol_of(p, name)}: {why}" for name, why in p.extrapolated.items()), *_NOT_VISIBLE]

    @property
    def noticed(self) -> list[tuple[str, str]]:
        campaign = self.r.posterior.campaign
        return [(x.file, w) for x in (campaign.tests if campaign else ()) for w in x.warnings]


class Determined(IdentifiedSection):
    """Every sampled parameter against its prior, the quantities that loops determine, and their joint posterior."""

    heading, marginals = "What the loops determine", marginals

    @property
    def legend(self) -> list[tuple[str, str, str]]:
        parameters = self.r.posterior.problem.prior.parameters
        return [*((q.symbol, q.description, q.unit) for q in parameters), *(_OF_CONTACTS if self.r.iwan else ())]

    @property
    def rows(self) -> list[tuple[str, ...]]:
        p, (draws, labels) = self.r.posterior, marginals.identifiable(self.r.posterior)
        shown = [n for n in draws if n in p.quantities()]
        return [(labels[n], *reported(p, n), p.extrapolated.get(n, "reached by the loops")) for n in shown]

    def corner(self) -> Figure:
        draws, labels = marginals.identifiable(self.r.posterior)
        embedded = {q.name for q in embedded_parameters()} & set(self.r.posterior.names)
        return marginals.corner_figure({n: x for n, x in draws.items() if n not in embedded}, labels)


def _asked(posterior: Posterior) -> list[str]:
    """Names of the quantities that the answer opens with: the first three, or a user's own model's determined ones."""
    if isinstance(posterior.problem.model, Model):
        return [n for n in _FIRST if n in posterior.quantities()]
    shrunk = dict(zip(posterior.names, contraction(posterior.flat_z())))
    return [n for n in posterior.names if n not in posterior.problem.noise_names and shrunk[n] >= OPEN][:6]


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
    spread = max(min(max(measured) - min(measured), abs(min(measured))), 0.02 * abs(max(measured)))
    value = f"{number(min(measured), spread)} to {number(max(measured), spread)}{unit}"
    if len(tests) == 1:
        value = f"{measured[0]:.4g}{unit}"
    return title, value, f"measured; predicted {number(low, spread)} to {number(high, spread)}{unit}"


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
    if by_frequency.checks:
        found.append(Finding(by_frequency.statement(), by_frequency.agree, "Each frequency alone"))
    tests = () if posterior.campaign is None else posterior.campaign.tests
    if noted := [x.file for x in tests if x.warnings]:
        found.append(Finding(f"Something was noticed about {len(noted)} of {len(tests)} records; see the table below."))
    return found


@styled
def headline_figure(tests: Sequence[LoopRow], p: Predictive) -> Figure:
    """The answer in one picture: the loop with the largest gap, measured and predicted, and what each test misses."""
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
