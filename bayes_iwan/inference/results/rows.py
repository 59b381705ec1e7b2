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

    q05, q50, q95 : the posterior's own quantiles. between_sd : standard deviation between tests, each left out in turn.
    value, low_90, high_90 : median and 90 % interval that are reported, with what a bent form says, the between-test
    variance and what no smooth law has; reach : why a number is extrapolated, and what determines it
    (see :mod:`.intervals`).
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
    between_sd: float
    value: float
    low_90: float
    high_90: float
    reach: str
