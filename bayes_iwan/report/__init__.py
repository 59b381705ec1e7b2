"""Figures, tables and pages: what a person reads. Figures take a posterior and return a matplotlib Figure."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_iwan.report.comparison_page import comparison_report as comparison_report
    from bayes_iwan.report.comparison_page import ranking_figure as ranking_figure
    from bayes_iwan.report.diagnosis.diagnosis_files import headline_of as headline_of
    from bayes_iwan.report.diagnosis.diagnosis_files import write_diagnosis as write_diagnosis
    from bayes_iwan.report.diagnosis.diagnosis_files import write_found as write_found
    from bayes_iwan.report.identification.by_frequency import wander_figure as wander_figure
    from bayes_iwan.report.identification.checks import loo_pit as loo_pit
    from bayes_iwan.report.identification.checks import loo_pit_figure as loo_pit_figure
    from bayes_iwan.report.identification.checks import region_checks as region_checks
    from bayes_iwan.report.identification.checks import regions_figure as regions_figure
    from bayes_iwan.report.identification.identification_page import identification_report as identification_report
    from bayes_iwan.report.identification.identification_page import report_run as report_run
    from bayes_iwan.report.identification.law_figures import normal_force_figure as normal_force_figure
    from bayes_iwan.report.identification.law_figures import slip_density_figure as slip_density_figure
    from bayes_iwan.report.identification.law_figures import stiffness_figure as stiffness_figure
    from bayes_iwan.report.identification.loops import frequencies_figure as frequencies_figure
    from bayes_iwan.report.identification.loops import loops_figure as loops_figure
    from bayes_iwan.report.identification.loops import paper_fig3 as paper_fig3
    from bayes_iwan.report.identification.loops import residuals_figure as residuals_figure
    from bayes_iwan.report.identification.marginals import corner_figure as corner_figure
    from bayes_iwan.report.identification.marginals import identifiable_corner as identifiable_corner
    from bayes_iwan.report.identification.marginals import paper_corner as paper_corner
    from bayes_iwan.report.identification.marginals import prior_posterior_figure as prior_posterior_figure
    from bayes_iwan.report.identification.predictive import predict as predict
    from bayes_iwan.report.identification.sampling import tau_figure as tau_figure
    from bayes_iwan.report.identification.sampling import traces_figure as traces_figure
    from bayes_iwan.report.identification.tables import latex_table as latex_table
    from bayes_iwan.report.identification.trends import trends_figure as trends_figure
    from bayes_iwan.report.page import Page as Page
    from bayes_iwan.report.style import save as save

#: public names by module; each is imported when it is first asked for, since one page needs few of them
_FROM = {
    "comparison_page": ("comparison_report", "ranking_figure"),
    "diagnosis.diagnosis_files": ("headline_of", "write_diagnosis", "write_found"),
    "identification.checks": ("loo_pit", "loo_pit_figure", "region_checks", "regions_figure"),
    "identification.by_frequency": ("wander_figure",),
    "identification.law_figures": ("normal_force_figure", "slip_density_figure", "stiffness_figure"),
    "identification.loops": ("frequencies_figure", "loops_figure", "paper_fig3", "residuals_figure"),
    "identification.marginals": ("corner_figure", "identifiable_corner", "paper_corner", "prior_posterior_figure"),
    "identification.identification_page": ("identification_report", "report_run"),
    "identification.predictive": ("predict",),
    "identification.sampling": ("tau_figure", "traces_figure"),
    "identification.tables": ("latex_table",),
    "identification.trends": ("trends_figure",),
    "page": ("Page",),
    "style": ("save",),
}
_WHERE = {name: module for module, names in _FROM.items() for name in names}
__all__ = sorted(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_WHERE[name]}", __name__), name)
