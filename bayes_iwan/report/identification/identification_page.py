"""report.html: what was identified, how well the model fits, and how reliable the fit is. Issue by issue of one run."""

import os
from pathlib import Path

from bayes_iwan.comparison.frequencies import Frequencies, compare_frequencies
from bayes_iwan.files import clear, owned
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL, searches_said
from bayes_iwan.inference.results.run_files import load
from bayes_iwan.models import Model
from bayes_iwan.report.browser import print_pdf, require_browser
from bayes_iwan.report.cite import SOFTWARE
from bayes_iwan.report.identification import (
    by_frequency,
    law_figures,
    loops,
    predictive_checks,
    sampling,
    tables,
    trends,
)
from bayes_iwan.report.identification.by_frequency import frequencies_table
from bayes_iwan.report.identification.marginals import number, paper_symbol, reported
from bayes_iwan.report.identification.predictive import Predictive, predict
from bayes_iwan.report.identification.summary import Answer, Determined, Identified, IdentifiedSection, regions_finding
from bayes_iwan.report.page import Finding, Page, provenance
from bayes_iwan.report.rendering import Renderer
from bayes_iwan.report.style import house_style
from bayes_iwan.report.viewer import viewer_data

_LIKELIHOOD = {
    "correlated": "a Gaussian likelihood of the loops' harmonics, with the measured noise and a smooth discrepancy "
    "whose size is inferred",
    "unweighted": "a Gaussian likelihood of the loops' harmonics, all alike, with a smooth discrepancy",
    "matern": "a Gaussian likelihood of the loops' harmonics with a Matérn discrepancy whose size and length are "
    "inferred",
    "gaussian": "a Gaussian likelihood of independent samples",
    "laplace": "a Laplace likelihood of independent samples",
}


class Loops(IdentifiedSection):
    heading, draw = "Loops, measured and predicted", loops

    @property
    def shown(self) -> Predictive:
        """Of the tests that have a panel."""
        return self.r.predictive.some(loops.some_tests(self.r.predictive.loops))

    @property
    def which(self) -> str:
        """These tests in words."""
        every = len(self.r.predictive.loops)
        return "every test" if every <= loops.MOST else f"{loops.MOST} of the {every} tests (the viewer shows each)"

    def viewer(self) -> dict[str, object]:
        return viewer_data(self.r.predictive)


class Laws(IdentifiedSection):
    heading, draw = "Slip forces, stiffness and normal force", law_figures


class EachFrequency(IdentifiedSection):
    heading, draw = "Each frequency alone", by_frequency

    @property
    def short(self) -> str:
        alone = self.r.by_frequency.alone.items()
        return " ".join(f"{name} {found.message}." for name, found in alone if not found.converged)


class Trends(IdentifiedSection):
    heading, draw = "Energy, stiffness and loss factor", trends

    def rows(self) -> list[tuple[str, ...]]:
        shown = []
        for row in self.r.tests:
            cells = [row.test + (" (held out)" if row.held_out else "")]
            for x in (row.energy_mJ, row.stiffness_N_mm, row.loss_factor):
                measured, middle, low, high = (number(v, x.q95 - x.q05) for v in (x.measured, x.q50, x.q05, x.q95))
                cells += [measured, f"{middle} [{low}, {high}]"]
            shown.append((*cells, f"{100 * row.residual_share:.2f} %"))
        return shown


class Checks(IdentifiedSection):
    heading, draw, large = "Is the model enough?", predictive_checks, LARGE_RESIDUAL

    @property
    def share(self) -> float:
        return max(x.residual_share for x in self.r.tests)

    @property
    def finding(self) -> Finding:
        return regions_finding(self.r.regions)

    @property
    def held_out(self) -> list[tuple[str, ...]]:
        return [
            (f"{x.frequency_hz:.3g} Hz", *(f"{100 * y:.0f} %" for y in (x.points_50, x.points_90, x.quantities_90)))
            for x in self.r.posterior.held_out
        ]


class Sampling(IdentifiedSection):
    heading, draw = "Sampling", sampling

    def history(self) -> sampling.History:
        return sampling.history(self.r.posterior, self.r.folder)

    @property
    def searches(self) -> tuple[str, bool]:
        return searches_said(self.r.posterior)

    @property
    def rows(self) -> list[tuple[str, ...]]:
        return [
            (r.name, f"{r.r_hat:.3f}", f"{r.ess_bulk:.0f}", f"{r.ess_tail:.0f}", f"{r.tau:.0f}")
            for r in self.r.convergence
        ]


class Priors(IdentifiedSection):
    heading = "Priors and derived quantities"

    @property
    def priors(self) -> list[tuple[str, ...]]:
        parameters = self.r.posterior.problem.prior.parameters
        return [(q.name, q.symbol, q.unit, q.prior_text(), q.description) for q in parameters]

    @property
    def derived(self) -> list[tuple[str, ...]]:
        p = self.r.posterior
        return [(paper_symbol(name), x.unit, *reported(p, name)) for name, x in p.derived().items()]


class Methods(IdentifiedSection):
    """A paragraph for a paper: data, model, likelihood, priors, search, sampling, software, as they were run."""

    heading, software, likelihoods = "Methods", SOFTWARE, _LIKELIHOOD

    def span(self, name: str, unit: str) -> str:
        """Smallest to largest of the loops."""
        loops = self.r.posterior.problem.loops
        values = [getattr(x if name == "n_cycles" else x.record, name) for x in loops]
        low, high = f"{min(values):g}", f"{max(values):g}"
        return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


@house_style()
def identification_report(
    posterior: Posterior, out_dir: str | os.PathLike[str], *, by_frequency: Frequencies | None = None, pdf: bool = False
) -> Path:
    """Write report.html, and CSV tables and parameters.tex below tables/, into out_dir; returns the page's path.

    by_frequency : each frequency alone; taken from out_dir/per_test where `identify(..., per_test=True)` has been.
    pdf : also report.pdf, the page as a browser prints it (:mod:`bayes_iwan.report.browser`).
    """
    out = Path(out_dir)
    if pdf:
        require_browser()
    alone = by_frequency or compare_frequencies(posterior, out)
    p = predict(posterior, n=400)
    tests, regions = tables.compared_loops(posterior, p), predictive_checks.region_checks(posterior, p)
    r = Identified(
        posterior=posterior, predictive=p, tests=tests, regions=regions, by_frequency=alone,
        convergence=tables.convergence_rows(posterior), folder=out,
    )  # fmt: skip
    several = [frequencies_table(alone)] if r.clock and len(alone.groups) > 1 else []
    tables.write_tables(posterior, [tables.loops_table(tests), tables.convergence_table(r.convergence), *several], out)
    what = "Quick identification" if posterior.quick else "Identification"
    made_with = ", ".join(f"{k} {v}" for k, v in posterior.versions.items())
    footer = (
        f"The numbers of this page are in summary.csv and tables/, its draws in posterior.nc. Made with {made_with}."
    )
    made, units = provenance(posterior.campaign, posterior.seed), posterior.problem.units
    page = Page(f"{what} of {posterior.name}", _subtitle(posterior), footer, units, made, Renderer(aside=True))
    page.add(Answer(r), Determined(r), Loops(r))
    if r.iwan:
        page.add(Laws(r))
    if r.clock:
        page.add(EachFrequency(r))
    page.add(Trends(r), Checks(r))
    if not posterior.quick:
        page.add(Sampling(r))
    page.add(Priors(r), Methods(r))
    written = page.write(out / "report.html")
    if pdf:
        print_pdf(written, out / "report.pdf")
    return written


def report_run(
    folder: str | os.PathLike[str],
    *,
    campaign: str | os.PathLike[str] | None = None,
    pdf: bool = False,
    per_frequency: bool = False,
    simulator: str | os.PathLike[str] | None = None,
) -> Path:
    """report.html (and report.pdf) of a folder that `identify` wrote; returns the page's path.

    campaign : the campaign's folder if it has moved. simulator : the Python file of the model of one's own that was
    identified; its code is run. per_frequency : identify each frequency alone by short runs
    where the folder has no per_test results; else quick estimates stand in.
    """
    if pdf:
        require_browser()
    posterior = load(folder, campaign, simulator)
    with owned(folder) as out:
        found = compare_frequencies(posterior, out, run=per_frequency)
        clear(out, "report.html", "report.pdf", "tables")
        return identification_report(posterior, out, by_frequency=found, pdf=pdf)


def _subtitle(posterior: Posterior) -> str:
    model = posterior.problem.model
    said = model.name
    if isinstance(model, Model):
        said = f"{model.slip} slip forces, {model.normal_force} normal force, {model.stiffness} stiffness"
    described = "" if posterior.campaign is None else posterior.campaign.description
    parts = (described, f"model: {said}", f"likelihood: {posterior.problem.likelihood.name}")
    return " · ".join(x for x in parts if x)
