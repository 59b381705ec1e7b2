"""Figures, tables and pages: what a person reads. Figures take a posterior and return a matplotlib Figure."""

from .checks import loo_pit, loo_pit_figure, region_checks, regions_figure
from .comparison import comparison_report, ranking_figure
from .frequencies import wander_figure
from .identification import identification_report
from .laws import grip_figure, slip_density_figure, stiffness_figure
from .loops import frequencies_figure, loops_figure, paper_fig3, residuals_figure
from .marginals import corner_figure, identifiable_corner, paper_corner, prior_posterior_figure
from .page import Page
from .predictive import predict
from .run import compare_campaign, report_run
from .sampling import tau_figure, traces_figure
from .style import save
from .tables import latex_table
from .trends import trends_figure

__all__ = [
    "Page", "compare_campaign", "comparison_report", "corner_figure", "frequencies_figure", "grip_figure",
    "identifiable_corner", "identification_report", "latex_table", "loo_pit", "loo_pit_figure", "loops_figure",
    "paper_corner", "paper_fig3", "predict", "prior_posterior_figure", "ranking_figure", "region_checks",
    "regions_figure", "report_run", "residuals_figure", "save", "slip_density_figure", "stiffness_figure", "tau_figure",
    "traces_figure", "trends_figure", "wander_figure",
]
