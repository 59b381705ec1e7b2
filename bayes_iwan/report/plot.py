"""Plots as functions of a result: `bi.plot.loops(posterior)`.

Every function returns a matplotlib figure that shows itself in a notebook, and takes

style : a style of matplotlib (a name, a dict of rcParams), on top of this package's own and of what rcParams you set;
width : "column" or 1 (3.5 in, one column of a journal), "page" or 2 (7.2 in, two columns), or more inches than these;
ax : axes of yours to draw into, an array of them for several panels.

`bi.plot.save(figure, "loops.svg")` writes SVG, PDF or PNG by the ending, letters as letters.
"""

from typing import NoReturn

from matplotlib.figure import Figure

from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.errors import InputError, nearest
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.report.batch.specimens import Batch
from bayes_iwan.report.comparison_page import ranking_figure
from bayes_iwan.report.diagnosis.diagnosis_files import figures_of_diagnosis
from bayes_iwan.report.identification.law_figures import normal_force_figure, slip_density_figure, stiffness_figure
from bayes_iwan.report.identification.loops import frequencies_figure, loops_figure, paper_fig3, residuals_figure
from bayes_iwan.report.identification.marginals import identifiable_corner, prior_posterior_figure
from bayes_iwan.report.identification.marginals import paper_corner as paper_corner
from bayes_iwan.report.identification.predictive_checks import loo_pit_figure, regions_figure
from bayes_iwan.report.identification.sampling import tau_figure, traces_figure
from bayes_iwan.report.identification.trends import trends_figure
from bayes_iwan.report.style import relabel, save, styled

#: functions of a posterior, which are its methods too: `posterior.plot.loops()`
OF_POSTERIOR = (
    *("autocorrelation", "corner", "frequencies", "loo_pit", "loop", "loops", "normal_force", "paper_corner"),
    *("parameters", "regions", "residuals", "slip_forces", "stiffness", "total_and_friction", "traces", "trends"),
)
__all__ = [*OF_POSTERIOR, "gap", "ranking", "save", "specimens"]

loops, residuals, frequencies = loops_figure, residuals_figure, frequencies_figure
total_and_friction, trends = paper_fig3, trends_figure
parameters, corner = prior_posterior_figure, identifiable_corner
slip_forces, stiffness, normal_force = slip_density_figure, stiffness_figure, normal_force_figure
regions, loo_pit = regions_figure, loo_pit_figure
traces, autocorrelation = traces_figure, tau_figure
ranking = ranking_figure


def __getattr__(name: str) -> NoReturn:
    raise AttributeError(f"bi.plot has no {name!r}" + nearest(name, __all__))


@styled
def loop(posterior: Posterior, test: str | int = 0, friction: bool = True) -> Figure:
    """Measured cycles of one test and the bands of the posterior.

    test : its file, or its place among `posterior.loops`; friction : less the parallel spring and the force's zero.

    Raises ValueError where there is no such test.
    """
    files = [x.file for x in posterior.loops]
    if isinstance(test, str) and test not in files:
        raise InputError(f"there is no test {test!r}" + nearest(test, files))
    if not isinstance(test, str) and not -len(files) <= test < len(files):
        raise InputError(f"there is no test {test}; there are {len(files)}, counted from 0")
    chosen = posterior.loops[files.index(test)] if isinstance(test, str) else posterior.loops[test]
    return loops_figure(posterior, friction=friction, loops=[chosen])


@styled
def gap(diagnosis: Diagnosis, name: str = "headline") -> Figure:
    """A figure of a diagnosis by name: the budget of the gap ("headline"), and those of its page.

    Raises ValueError for a name that this diagnosis has no figure of.
    """
    figures = figures_of_diagnosis(diagnosis)
    if name not in figures:
        raise InputError(f'there is no figure "{name}" of this diagnosis{nearest(name, sorted(figures))}')
    figure = figures[name]()
    relabel(figure, diagnosis.campaign.units)
    return figure


@styled
def specimens(batch: Batch) -> Figure:
    """Each quantity of every specimen of a batch over the population's band."""
    from bayes_iwan.report.batch.batch_page import parameters_figure

    return parameters_figure(batch)
