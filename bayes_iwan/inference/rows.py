"""What a posterior hands out: rows of its summary, the diagnostics of its chains, predictions and its misfit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.units import Units


@dataclass(frozen=True)
class ConvergenceRow:
    """Diagnostics of one number; tau in steps of the sampler."""

    name: str
    ess_bulk: float
    ess_tail: float
    r_hat: float
    tau: float


@dataclass(frozen=True)
class SummaryRow:
    """One line of summary.csv.

    q05, q50, q95 : the posterior's own quantiles. between_sd : standard deviation between tests, each left out in turn.
    low_90, high_90 : the 90 % interval with the between-test variance, and with what no loop reaches; reach : why a
    number is extrapolated, and what determines it (see :mod:`.intervals`).
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
    low_90: float
    high_90: float
    reach: str


@dataclass(frozen=True)
class Prediction:
    """Loops that were predicted, with what the posterior knows of them.

    frequency_hz, amplitude_mm : (loops,); displacement_mm : (loops, samples); force_N : (draws, loops, samples), the
    model's alone, without noise; units : the campaign's, for what is printed.
    """

    frequency_hz: Array
    amplitude_mm: Array
    displacement_mm: Array
    force_N: Array
    units: Units

    def band(self, level: float = 0.9) -> tuple[Array, Array, Array]:
        """Lower end, median and upper end of the central interval, (loops, samples) each, N."""
        low, middle, high = np.quantile(self.force_N, [0.5 - level / 2, 0.5, 0.5 + level / 2], axis=0)
        return low, middle, high

    def __repr__(self) -> str:
        low, _, high = self.band()
        return "\n".join(
            f"{f:g} Hz, {a:g} {self.units.displacement}: ±{0.5 * np.mean(high[i] - low[i]):.3g} {self.units.force} "
            "(90 %, mean along the loop)"
            for i, (f, a) in enumerate(zip(self.frequency_hz, self.amplitude_mm))
        )


@dataclass(frozen=True)
class Misfit:
    """rms_N : RMS residual of the median prediction over the fitted tests; share : the same over the friction force's,
    tests weighing alike."""

    rms_N: float
    share: float
