"""`posterior.plot`: plots as methods of a result, put there by the folder that draws, as xarray's accessors are."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from bayes_iwan.errors import nearest
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.screen import as_html, wrapped

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class PosteriorPlots:
    """`posterior.plot.loops()` for `bi.plot.loops(posterior)`, and so for every plot of a posterior."""

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def __getattr__(self, name: str) -> Callable[..., "Figure"]:
        if name.startswith("_"):
            raise AttributeError(name)
        from bayes_iwan.report import plot  # matplotlib takes a second: not before something is drawn

        if name not in plot.OF_POSTERIOR:
            raise AttributeError(f"no plot {name!r}" + nearest(name, plot.OF_POSTERIOR))
        return partial(getattr(plot, name), self._posterior)

    def __dir__(self) -> list[str]:
        from bayes_iwan.report import plot

        return list(plot.OF_POSTERIOR)

    def __repr__(self) -> str:
        return wrapped(f"plots: {', '.join(dir(self))}")

    _repr_html_ = as_html


setattr(Posterior, "plot", property(PosteriorPlots, doc=PosteriorPlots.__doc__))  # noqa: B010  (no checker knows it)
