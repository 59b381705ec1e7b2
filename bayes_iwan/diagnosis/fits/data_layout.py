"""How a campaign's data lie in the rows of a fit: which there are, and what noise and discrepancy make of each."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bayes_iwan.diagnosis.fits.discrepancy_size import (
    ALONG_SHARES,
    LENGTHS,
    Between,
    Discrepancy,
    DiscrepancySize,
    Sizes,
)

if TYPE_CHECKING:
    from bayes_iwan.diagnosis.fits.data import GapData


class Layout:
    """The rows of a model that is steady, or of one that changes along the record (`evolving`), which has those of the
    changes and of the mains' lines besides; beside a discrepancy that is correlated between tests as `between` says.

    turn : what makes noise and discrepancy of averaged loops diagonal, harmonic by harmonic; real, imaginary (used, T)
    : whose parts are rows; trend, turning (T, K, TREND_HARMONICS + 1) : the same of contrasts; line (T, 2) : which
    lines are;
    discrepancy : of all rows, in units of the noise.
    """

    def __init__(self, data: GapData, between: Between, evolving: bool) -> None:
        self.evolving = evolving
        self.turn, values, there, _ = data.likelihood.with_between(between).rotation
        self.used = len(self.turn)
        order = np.broadcast_to(np.arange(self.used)[:, None], there.shape)
        self.real = there.astype(bool)
        self.imaginary = self.real & (order > 0)
        self.trend, self.line = np.isfinite(data.trend_noise_N), np.isfinite(data.mains_noise_N)
        changed = np.broadcast_to(np.arange(self.trend.shape[2]), self.trend.shape)
        self.turning = self.trend & (changed > 0)
        change = data.trend_N / data.trend_noise_N
        self._changes = np.r_[change.real[self.trend], change.imag[self.turning]]
        self._lines = float(np.sum(np.abs(data.mains_N[self.line] / data.mains_noise_N[self.line]) ** 2))
        level = (data.level_N[:, None, None] / data.trend_noise_N) ** 2
        late = np.r_[changed[self.trend], changed[self.turning]].astype(np.int64)
        #: of the contrasts along the record: each as large as its test's friction level times b
        self._changing = Discrepancy(
            np.r_[level[self.trend], level[self.turning]], late, np.ones(len(late), dtype=bool)
        )
        eigen = np.r_[values[self.real], values[self.imaginary]]
        orders = np.r_[order[self.real], order[self.imaginary]].astype(np.int64)
        steady = np.zeros(len(orders), dtype=bool)
        if evolving:
            lines = 2 * int(self.line.sum())
            eigen = np.r_[eigen, self._changing.eigen, np.zeros(lines)]
            orders = np.r_[orders, self._changing.order, np.zeros(lines, dtype=np.int64)]
            steady = np.r_[steady, self._changing.changing, np.zeros(lines, dtype=bool)]
        self.discrepancy = Discrepancy(eigen, orders, steady, between)

    @cached_property
    def constant(self) -> float:
        """ln evidence that a steady model has whatever its numbers: it misses all changes and lines."""
        if self.evolving:
            return 0.0
        sizes: Sizes = tuple((0.0, float(LENGTHS[-1]), float(b)) for b in ALONG_SHARES)
        _, log_p = self._changing.spectrum(np.tile(self._changes, (len(sizes), 1)), sizes)
        return float(np.logaddexp.reduce(log_p) - np.log(len(sizes))) - 0.5 * self._lines

    def steady_cost(self, size: DiscrepancySize) -> float:
        """Half the squares of all changes along the record and lines, in units of noise and discrepancy: a steady
        model's."""
        return 0.5 * float(np.sum(self._changes**2 / self._changing.variance(size)) + self._lines)
