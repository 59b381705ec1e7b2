"""Rows of a posterior's summary, and the diagnostics of its chains."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ConvergenceRow:
    """Diagnostics of one parameter; tau in steps of the sampler."""

    name: str
    ess_bulk: float
    ess_tail: float
    r_hat: float
    tau: float


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
