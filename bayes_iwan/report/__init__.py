"""Figures, tables and pages: what a person reads. Figures take a posterior and return a matplotlib Figure."""

from bayes_iwan.report.checks import loo_pit, loo_pit_figure, region_checks, regions_figure
from bayes_iwan.report.comparison import comparison_report, ranking_figure
from bayes_iwan.report.diagnosis import headline_of, write_diagnosis, write_found
from bayes_iwan.report.frequencies import wander_figure
from bayes_iwan.report.identification import identification_report
from bayes_iwan.report.laws import grip_figure, slip_density_figure, stiffness_figure
from bayes_iwan.report.loops import frequencies_figure, loops_figure, paper_fig3, residuals_figure
from bayes_iwan.report.marginals import corner_figure, identifiable_corner, paper_corner, prior_posterior_figure
from bayes_iwan.report.page import Page
from bayes_iwan.report.predictive import predict
from bayes_iwan.report.run import compare_campaign, report_run
from bayes_iwan.report.sampling import tau_figure, traces_figure
from bayes_iwan.report.style import save
from bayes_iwan.report.tables import latex_table
from bayes_iwan.report.trends import trends_figure

__all__ = [
    "Page",
    "compare_campaign",
    "comparison_report",
    "corner_figure",
    "frequencies_figure",
    "grip_figure",
    "headline_of",
    "identifiable_corner",
    "identification_report",
    "latex_table",
    "loo_pit",
    "loo_pit_figure",
    "loops_figure",
    "paper_corner",
    "paper_fig3",
    "predict",
    "prior_posterior_figure",
    "ranking_figure",
    "region_checks",
    "regions_figure",
    "report_run",
    "residuals_figure",
    "save",
    "slip_density_figure",
    "stiffness_figure",
    "tau_figure",
    "traces_figure",
    "trends_figure",
    "wander_figure",
    "write_diagnosis",
    "write_found",
]
