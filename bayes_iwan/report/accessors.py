"""`posterior.plot`: plots as methods of a result, put there by the folder that draws, as xarray's accessors are."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from functools import partial
from typing import Any

from bayes_iwan.arrays import wrapped
from bayes_iwan.inference.results.posterior import Posterior

#: functions of :mod:`bayes_iwan.report.plot` that take a posterior
NAMES = (
    *("autocorrelation", "corner", "frequencies", "loo_pit", "loop", "loops", "normal_force", "paper_corner"),
    *("parameters", "regions", "residuals", "slip_forces", "stiffness", "total_and_friction", "traces", "trends"),
)


class PosteriorPlots:
    """`posterior.plot.loops()` for `bi.plot.loops(posterior)`, and so for every plot of a posterior."""

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in NAMES:
            near = difflib.get_close_matches(name, NAMES, 1)
            raise AttributeError(f"no plot {name!r}; " + (f"did you mean {near[0]!r}?" if near else repr(self)))
        from bayes_iwan.report import plot  # matplotlib takes a second: not before something is drawn

        return partial(getattr(plot, name), self._posterior)

    def __dir__(self) -> list[str]:
        return list(NAMES)

    def __repr__(self) -> str:
        return wrapped(f"plots: {', '.join(NAMES)}")


def _register(kind: type, name: str, accessor: type) -> None:
    setattr(kind, name, property(accessor, doc=accessor.__doc__))


_register(Posterior, "plot", PosteriorPlots)
