"""report.html: what was identified, how well the model fits, and how reliable the fit is. Issue by issue of one run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from bayes_iwan.comparison.frequencies import Frequencies, compare_frequencies
from bayes_iwan.files import clear, owned
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.remarks import LARGE_RESIDUAL, searches_said
from bayes_iwan.inference.results.run_files import load
from bayes_iwan.inference.results.summary_rows import ConvergenceRow
from bayes_iwan.models import Model
from bayes_iwan.report.browser import print_pdf, require_browser
from bayes_iwan.report.identification import by_frequency, checks, law_figures, loops, sampling, tables, trends
from bayes_iwan.report.identification.compared_loops import LoopRow, compared_loops
from bayes_iwan.report.identification.marginals import number, paper_symbol, reported
from bayes_iwan.report.identification.methods import methods
from bayes_iwan.report.identification.predictive import Predictive, predict
from bayes_iwan.report.identification.summary import determined, identification_answer
from bayes_iwan.report.identification.viewer import add_viewer, viewer_data
from bayes_iwan.report.identification.where_gap import DISAGREE, findings, regions_finding
from bayes_iwan.report.page import Page, Section, provenance
from bayes_iwan.report.rendering import shared
from bayes_iwan.report.style import house_style


@house_style()
def identification_report(
    posterior: Posterior,
    out_dir: str | os.PathLike[str],
    *,
    seed: int = 0,
    by_frequency: Frequencies | None = None,
    pdf: bool = False,
) -> Path:
    """Write report.html, and CSV tables and parameters.tex below tables/, into out_dir; returns the page's path.

    by_frequency : each frequency alone; taken from out_dir/per_test where `identify(..., per_test=True)` has been.
    pdf : also report.pdf, the page as a browser prints it (:mod:`bayes_iwan.report.browser`).
    """
    out = Path(out_dir)
    if pdf:
        require_browser()
    by_frequency = compare_frequencies(posterior, out) if by_frequency is None else by_frequency
    p = predict(posterior, n=400, seed=seed)
    convergence, tests = tables.convergence_rows(posterior), compared_loops(posterior, p)
    parameters, quantities = tables.parameters_table(posterior), tables.quantities_table(posterior)
    of_tests, of_chains = tables.loops_table(tests), tables.convergence_table(convergence)
    of_held_out = [tables.held_out_table(posterior.held_out)] if posterior.held_out else []
    tables.write_tables(
        [parameters, tables.paper_table(posterior), quantities, of_tests, of_chains, *of_held_out],
        posterior,
        out / "tables",
    )
    what = "Quick identification" if posterior.quick else "Identification"
    page = Page(
        f"{what} of {posterior.name}",
        _subtitle(posterior),
        "The numbers of this page are in summary.csv and tables/, its draws in posterior.nc. Made with "
        + ", ".join(f"{k} {v}" for k, v in posterior.versions.items())
        + ".",
        posterior.problem.units,
        provenance(posterior.campaign, posterior.seed),
        shared(busy=55),
    )
    regions = checks.region_checks(posterior, p)
    found = findings(posterior, regions, by_frequency)
    identification_answer(page.section("Answer"), posterior, tests, p, found)
    determined(page.section("What the loops determine"), posterior)
    _loops(page, posterior, p)
    if isinstance(posterior.problem.model, Model):
        _laws(page.section("Slip forces, stiffness and normal force"), posterior, posterior.problem.model)
    if posterior.loops[0].record.clock:
        _frequencies(page.section("Each frequency alone"), by_frequency, out)
    _trends(page.section("Energy, stiffness and loss factor"), posterior, p, tests)
    _checks(page.section("Is the model enough?"), posterior, regions, tests)
    if not posterior.quick:
        _sampling(page.section("Sampling"), posterior, convergence, sampling.history(posterior, out))
    _priors(page.section("Priors and derived quantities"), posterior)
    page.section("Methods").text(methods(posterior))
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
    parts = [
        "" if posterior.campaign is None else posterior.campaign.description,
        f"model: {said}",
        f"likelihood: {posterior.problem.likelihood.name}",
    ]
    return " · ".join(x for x in parts if x)


def _loops(page: Page, posterior: Posterior, p: Predictive) -> None:
    section = page.section("Loops, measured and predicted")
    add_viewer(page, section, viewer_data(p))
    section.figure(
        loops.loops_figure(posterior, friction=True, predictive=p),
        "Friction force (force less the median parallel spring) of every test: measured cycles and the "
        "bands in which 50 and 90 % of further cycles are expected.",
        "One hysteresis loop a test; the dotted measured average lies on the model's median line.",
        name="friction_loops",
    )
    section.figure(
        loops.residuals_figure(posterior, predictive=p),
        "Residual, measured − median prediction, along the cycle. Bands: where an averaged loop was "
        "expected, with the noise and the smooth discrepancy that the likelihood allows. The drifting zero of "
        "the force is taken off test by test.",
        "Residual against phase, one panel a test, with expected bands around zero.",
        name="residuals",
    )
    section.figure(
        loops.loops_figure(posterior, friction=False, predictive=p),
        "Total force of every test, as above.",
        "One loop of total force a test.",
        name="loops",
    )
    if p.loops[0].record.clock:
        section.figure(
            loops.frequencies_figure(posterior, p),
            "Friction loops at one amplitude at each frequency, test "
            "and model (the paper's Fig. 12), 90 % bands of the model.",
            "Friction loops of all frequencies over each other, measured and predicted.",
            name="frequencies",
        )


def _laws(section: Section, posterior: Posterior, model: Model) -> None:
    section.figure(
        law_figures.slip_density_figure(posterior),
        "How the elements' slip forces are distributed (the paper's Fig. 8), with 50 and 90 % bands; grey: "
        "the prior. Loops determine the cumulative form better than the density.",
        "Density and cumulative distribution of slip forces with uncertainty bands.",
        name="slip_forces",
    )
    if model.stiffness != "constant":
        section.figure(
            law_figures.stiffness_figure(posterior),
            "Stiffness of the elements against the relative normal force (the paper's Fig. 9). Only the "
            "shaded range was visited by the tests; outside it the curve is the law's extrapolation.",
            "Rising curve of stiffness against relative normal force with bands.",
            name="stiffness",
        )
    if model.normal_force != "constant":
        section.figure(
            law_figures.normal_force_figure(posterior),
            "Relative normal force along the largest stroke, out and back (the paper's Fig. 10), 90 % bands.",
            "Relative normal force against displacement, one panel a direction.",
            name="normal_force",
        )


def _frequencies(section: Section, found: Frequencies, out: Path) -> None:
    if len(found.groups) < 2:
        section.note(found.statement())
        return
    section.note(found.statement(), "good" if found.overall >= DISAGREE else "warning")
    missing = [name for name in found.groups if name not in found.alone]
    text = (
        "Band: all tests together, 50 and 90 %. Points with bars: each frequency alone. p: how often loops drawn "
        "from the joint posterior wander by more than the measured ones; low values: the frequencies disagree."
    )
    if missing:
        text += (
            " Squares: quick estimates, one least-squares step from the joint fit, 90 % interval; identify with "
            "--per-test for the posteriors themselves."
        )
    if short := [f"{name} {alone.message}." for name, alone in found.alone.items() if not alone.converged]:
        section.note(
            "Alone, these frequencies have not converged; read their intervals as too narrow. " + " ".join(short),
            "warning",
        )
    section.figure(
        by_frequency.wander_figure(found),
        text,
        "Quantities against frequency, one panel each, over the joint posterior's band.",
        name="each_frequency",
    )
    section.table(
        *by_frequency.wander_rows(found),
        "Quantities from all tests and from each frequency alone: median and 90 % interval"
        + (" (~: quick estimates)" if missing else ""),
    )
    if found.alone:
        section.figure(
            by_frequency.alone_loops_figure(found),
            "Loops predicted from each test's frequency alone (blue: "
            "median, 50 and 90 % bands) and from all tests (red, dashed: 90 %), less the median from all "
            "tests. Grey: the measured loop. Bands that part say that the frequency wants other values.",
            "One panel a test: bands of the loop from its frequency alone around the joint prediction.",
            name="each_frequency_loops",
        )
        section.table(
            *by_frequency.loop_rows(found),
            "Energy, stiffness and loss factor of each test: measured, "
            "predicted from all tests, predicted from the tests of its own frequency alone",
        )
    by_frequency.frequencies_table(found).in_units(section.units).write_csv(out / "tables")


def _trends(section: Section, posterior: Posterior, p: Predictive, tests: Sequence[LoopRow]) -> None:
    section.figure(
        trends.trends_figure(posterior, p),
        "Lines: predicted with 90 % bands; points: measured, with the 90 % range in which a repeated "
        "measurement is expected. Loss factor: energy lost over π · stiffness · "
        "amplitude² of the fundamental, the tangent of the loss angle.",
        "Dissipated energy, equivalent stiffness and loss factor of the tests, with predicted bands.",
        name="trends",
    )
    shown = []
    for row in tests:
        cells = [row.test + (" (held out)" if row.held_out else "")]
        for x in (row.energy_mJ, row.stiffness_N_mm, row.loss_factor):
            width = x.q95 - x.q05
            cells += [
                number(x.measured, width),
                f"{number(x.q50, width)} [{number(x.q05, width)}, {number(x.q95, width)}]",
            ]
        shown.append((*cells, f"{100 * row.residual_share:.2f} %"))
    section.table(
        (
            "test",
            "energy, measured (mJ)",
            "predicted [90 %]",
            "stiffness, measured (N/mm)",
            "predicted [90 %]",
            "loss factor, measured",
            "predicted [90 %]",
            "residual / friction",
        ),
        shown,
        "Measured and predicted, test by test (intervals of the model, without noise; as in loops.csv and summary.csv)",
    )


def _checks(section: Section, posterior: Posterior, result: checks.RegionChecks, tests: Sequence[LoopRow]) -> None:
    share = max(x.residual_share for x in tests)
    if share > LARGE_RESIDUAL:
        section.note(
            f"The model misses the friction force of its worst test by {100 * share:.2g} %. The checks below "
            "ask only whether that gap is as smooth and as large as the likelihood has learnt it to be, "
            "not whether it is small.",
            "warning",
        )
    finding = regions_finding(result)
    section.note(finding.text, "good" if finding.good else "warning")
    section.figure(
        checks.regions_figure(posterior, result),
        "Posterior predictive p-values by test and part of the loop. Orange and bold: the model misses there by more "
        "than noise and the admitted smooth discrepancy explain. Blue: by less than expected.",
        "A table of p-values, tests by six loop regions.",
        name="regions",
    )
    section.figure(
        checks.loo_pit_figure(posterior),
        "Leave-one-out probability integral transform of the likelihood's data, mean forces left aside. Within the "
        "grey bands the predictive distribution is calibrated; a hump means too wide, a trough too narrow intervals.",
        "Histogram of LOO-PIT values and their distribution function less the uniform one.",
        name="loo_pit",
    )
    if posterior.held_out:
        section.table(
            ("held out", "points in 50 % bands", "points in 90 % bands", "energies and stiffnesses in 90 % bands"),
            [
                (f"{x.frequency_hz:.3g} Hz", *(f"{100 * y:.0f} %" for y in (x.points_50, x.points_90, x.quantities_90)))
                for x in posterior.held_out
            ],
            "Each frequency predicted from the tests of all others, which know nothing of it: what the bands hold of "
            "its loops (normal approximation about the others' most probable point)",
        )


def _sampling(
    section: Section, posterior: Posterior, convergence: Sequence[ConvergenceRow], run: sampling.History
) -> None:
    section.figure(
        sampling.traces_figure(posterior, run=run),
        "Traces and ranks of the six quantities that mix worst. Ensembles that agree have flat rank lines near 1.",
        "Trace and rank plots of six quantities.",
        name="traces",
    )
    section.figure(
        sampling.tau_figure(posterior, run),
        "Autocorrelation time estimated from growing parts of the run. It should level off below the dashed line.",
        "Autocorrelation time against run length.",
        name="autocorrelation",
    )
    section.table(
        ("parameter", "R-hat", "ESS, bulk", "ESS, tail", "τ (steps)"),
        [(r.name, f"{r.r_hat:.3f}", f"{r.ess_bulk:.0f}", f"{r.ess_tail:.0f}", f"{r.tau:.0f}") for r in convergence],
        "Convergence of every parameter",
        fold=len(convergence) > 12,
    )
    said, agree = searches_said(posterior)
    section.note(said, "good" if agree else "warning")
    t = posterior.timings
    if "sampling_s" in t:
        section.text(
            f"{t.get('steps', 0):.0f} steps of {posterior.z.shape[0]} ensembles with {posterior.walkers} walkers each; "
            f"point estimate {t.get('point_s', 0):.3g} s, sampling {t['sampling_s']:.3g} s."
        )


def _priors(section: Section, posterior: Posterior) -> None:
    prior = posterior.problem.prior
    section.table(
        ("parameter", "symbol", "unit", "prior", "meaning"),
        [(q.name, q.symbol, q.unit, q.prior_text(), q.description) for q in prior.parameters],
        "Priors used",
    )
    derived = posterior.derived()
    if not derived:
        return
    section.table(
        ("parameter", "unit", "value", "90 % from", "to"),
        [(paper_symbol(name), x.unit, *reported(posterior, name)) for name, x in derived.items()],
        "The paper's parameters (single gamma components and k̃ₙ, λ near β = 0 are hardly determined one by one)"
        if isinstance(posterior.problem.model, Model)
        else "Quantities that follow from the sampled parameters",
    )
