"""Figures, tables and pages: what a person reads. Figures take a posterior and return a matplotlib Figure."""

from bayes_iwan.report.comparison import comparison_report, ranking_figure
from bayes_iwan.report.diagnosis.files import headline_of, write_diagnosis, write_found
from bayes_iwan.report.identification.checks import loo_pit, loo_pit_figure, region_checks, regions_figure
from bayes_iwan.report.identification.frequencies import wander_figure
from bayes_iwan.report.identification.laws import grip_figure, slip_density_figure, stiffness_figure
from bayes_iwan.report.identification.loops import frequencies_figure, loops_figure, paper_fig3, residuals_figure
from bayes_iwan.report.identification.marginals import (
    corner_figure,
    identifiable_corner,
    paper_corner,
    prior_posterior_figure,
)
from bayes_iwan.report.identification.page import identification_report, report_run
from bayes_iwan.report.identification.predictive import predict
from bayes_iwan.report.identification.sampling import tau_figure, traces_figure
from bayes_iwan.report.identification.tables import latex_table
from bayes_iwan.report.identification.trends import trends_figure
from bayes_iwan.report.page import Page
from bayes_iwan.report.style import save

__all__ = [
    "Page",
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
