"""How a campaign's data lie in the rows of a fit: which there are, and what noise and rest make of each."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bayes_iwan.gap.fitting.rest import ALONG_SHARES, LENGTHS, Rest, RestSize

if TYPE_CHECKING:
    from bayes_iwan.gap.fitting.data import GapData


class Layout:
    """The rows of a model that is steady, or of one that changes along the record (`evolving`), which has those of the
    changes and of the mains' lines besides.

    turn : what makes noise and rest of averaged loops diagonal, harmonic by harmonic; real, imaginary (used, T): whose
    parts are rows; trend, line : which contrasts and lines are; rest : of all rows, in units of the noise.
    """

    def __init__(self, data: GapData, evolving: bool) -> None:
        self.evolving = evolving
        self.turn, values, there, _ = data.likelihood.rotation
        self.used = len(self.turn)
        order = np.broadcast_to(np.arange(self.used)[:, None], there.shape)
        self.real = there.astype(bool)
        self.imaginary = self.real & (order > 0)
        self.trend, self.line = np.isfinite(data.trend_noise_N), np.isfinite(data.mains_noise_N)
        self._change = (data.trend_N / data.trend_noise_N)[self.trend]
        self._lines = float(np.sum(np.abs(data.mains_N[self.line] / data.mains_noise_N[self.line]) ** 2))
        level = np.broadcast_to(data.level_N[:, None, None], data.trend_noise_N.shape)[self.trend]
        changing = (level / data.trend_noise_N[self.trend]) ** 2
        changed = np.broadcast_to(np.arange(self.trend.shape[2]), self.trend.shape)[self.trend].astype(np.int64)
        #: of the contrasts along the record: each as large as its test's friction level times b
        self._changing = Rest(np.tile(changing, 2), np.tile(changed, 2), np.ones(2 * len(changed), dtype=bool))
        eigen = np.r_[values[self.real], values[self.imaginary]]
        orders = np.r_[order[self.real], order[self.imaginary]].astype(np.int64)
        steady = np.zeros(len(orders), dtype=bool)
        if evolving:
            lines = 2 * int(self.line.sum())
            eigen = np.r_[eigen, self._changing.eigen, np.zeros(lines)]
            orders = np.r_[orders, self._changing.order, np.zeros(lines, dtype=np.int64)]
            steady = np.r_[steady, self._changing.changing, np.zeros(lines, dtype=bool)]
        self.rest = Rest(eigen, orders, steady)

    @cached_property
    def constant(self) -> float:
        """ln evidence that a steady model has whatever its numbers: it misses all changes and lines."""
        if self.evolving:
            return 0.0
        sizes = [RestSize(0.0, LENGTHS[-1], b) for b in ALONG_SHARES]
        logdet = [0.5 * float(np.sum(np.log(self._changing.variance(size)))) for size in sizes]
        cost = [-self.missed(size.along) - d for size, d in zip(sizes, logdet)]
        return float(np.logaddexp.reduce(cost) - np.log(len(cost)))

    def missed(self, along: float) -> float:
        """Half the squares of all changes along the record and lines, in units of noise and rest: a steady model's."""
        variance = self._changing.variance(RestSize(0.0, LENGTHS[-1], along))
        square = np.r_[self._change.real, self._change.imag] ** 2 / variance
        return 0.5 * float(square.sum() + self._lines)
