"""Rows of a posterior's summary, and the diagnostics of its chains."""

from dataclasses import dataclass
from html import escape

import numpy as np


@dataclass(frozen=True)
class ConvergenceRow:
    """Diagnostics of one parameter; tau in steps of the sampler."""

    name: str
    ess_bulk: float
    ess_tail: float
    r_hat: float
    tau: float


class Summary(tuple["SummaryRow", ...]):
    """Rows of a summary, shown as a table."""

    #: rows that fit a screen
    MOST = 36

    def __repr__(self) -> str:
        wide = max((len(r.name) for r in self), default=0)
        lines = [f"{'':{wide}s} {'median':>10s} {'5 %':>10s} {'95 %':>10s} {'R-hat':>7s}  unit"]
        for r in self[: self.MOST]:
            hat = "" if np.isnan(r.r_hat) else f"{r.r_hat:.3f}"
            lines.append(f"{r.name:{wide}s} {r.q50:10.4g} {r.q05:10.4g} {r.q95:10.4g} {hat:>7s}  {r.unit}")
        more = len(self) - self.MOST
        return "\n".join([*lines, *([f"… and {more} more; all are in summary.csv"] if more > 0 else [])])

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"


@dataclass(frozen=True)
class SummaryRow:
    """One line of summary.csv.

    q05, q50, q95 : quantiles of the draws: median and 90 % interval. reach : why a number is extrapolated, and what
    range determines it; empty where the loops reach it (see :mod:`.reach`).
    """

    name: str
    unit: str
    mean: float
    sd: float
    q05: float
    q50: float
    q95: float
    ess_bulk: float
    ess_tail: float
    r_hat: float
    reach: str
