"""The residual of a model, row by row in units of the noise, and its descent to an optimum."""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.fits.data import GapData, predicted
from bayes_iwan.diagnosis.fits.discrepancy_size import BETWEEN, Between, DiscrepancySize, Linear
from bayes_iwan.fitting.descent import Descent, descend
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models.parameter import Z_LIMIT

#: step of central differences
STEP = 1e-4


#: harmonics, trends and lines that a model predicts for draws
Predicted = tuple[np.ndarray, np.ndarray | None, np.ndarray | None]


def slopes(here: np.ndarray, ahead: np.ndarray, back: np.ndarray) -> np.ndarray:
    """(ndim, …) central differences of values here (1, …) and a STEP ahead and back (ndim, …) in each number; where one
    side has no force, by the other alone."""
    values = tuple(range(1, ahead.ndim))
    there, behind = (np.isfinite(x).all(axis=values, keepdims=True) for x in (ahead, back))
    width = STEP * np.maximum(there.astype(float) + behind, 1.0)
    return np.asarray((np.where(there, ahead, here) - np.where(behind, back, here)) / width)


class Rows:
    """Residual rows of a model in units of the noise, and what is needed to whiten them by any discrepancy that is
    correlated between tests as `between` says."""

    def __init__(self, data: GapData, problem: Problem, between: Between = BETWEEN[0]) -> None:
        self.data, self.problem, self.between = data, problem, between
        self.evolving = any(e.evolving for e in problem.effects)
        self.layout = data.layout(between, self.evolving)
        self.discrepancy = self.layout.discrepancy

    def residual(self, z: Array) -> Array:
        """Measured − predicted in units of the noise, rotated, (draws, m)."""
        return self.residual_from(predicted(self.data, self.problem, z))

    def residual_from(self, by_model: Predicted) -> Array:
        """The same of what a model predicts."""
        data, (mean, trend, lines) = self.data, by_model
        used = self.layout.used
        parts = self.turned(data.harmonics_N[:, :used] - mean[..., :used])
        if self.evolving:
            r = (data.trend_N - trend) / data.trend_noise_N
            line = np.zeros((len(mean), *data.mains_N.shape)) if lines is None else lines
            q = ((data.mains_N - line) / data.mains_noise_N)[:, self.layout.line]
            parts += [r.real[:, self.layout.trend], r.imag[:, self.layout.turning], q.real, q.imag]
        return np.concatenate(parts, axis=1)

    def turned(self, harmonics_N: np.ndarray) -> list[Array]:
        """The rows that harmonics of averaged loops (draws, T, used) make, real parts and imaginary ones."""
        c, turn, layout = harmonics_N.transpose(2, 0, 1), self.layout.turn.transpose(0, 2, 1), self.layout
        return [
            (c.real @ turn).transpose(1, 0, 2)[:, layout.real],
            (c.imag @ turn).transpose(1, 0, 2)[:, layout.imaginary],
        ]

    def linear(self, z: Array) -> Linear:
        """Residual and central-difference Jacobian at z (ndim,), in one batch call."""
        return self.linear_of(self.around(z), z)

    def around(self, z: Array) -> Predicted:
        """What the model predicts at z (ndim,) and a step to either side of every number of it."""
        steps = STEP * np.eye(len(z))
        return predicted(self.data, self.problem, np.concatenate([z[None], z + steps, z - steps]))

    def linear_of(self, around: Predicted, z: Array) -> Linear:
        """The linear model at z (ndim,) from what is predicted around it."""
        here, ahead, back = np.split(self.residual_from(around), [1, len(z) + 1])
        return Linear(here[0], -slopes(here, ahead, back).T, self.discrepancy, z.copy())

    def sd(self, size: DiscrepancySize) -> Array:
        """(m,) what the rows are divided by, so that they are white."""
        return np.sqrt(self.discrepancy.variance(size))

    def fit(self, starts: Array, size: DiscrepancySize, iterations: int, first: Linear | None = None) -> Descent:
        """Least squares from all starts at one size of the discrepancy; first : the linear model at the first of
        them."""
        sd = self.sd(size)

        def rows(z: Array) -> Array:
            with np.errstate(all="ignore"):
                return np.concatenate([self.residual(z) / sd, z], axis=1)

        box = np.tile([-Z_LIMIT, Z_LIMIT], (starts.shape[1], 1))
        known = None
        if first is not None and np.all(np.abs(first.z) <= Z_LIMIT):
            known = np.concatenate([-first.jacobian / sd[:, None], np.eye(len(first.z))])
        return descend(rows, starts, box, iterations, known=known)
