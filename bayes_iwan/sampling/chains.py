"""What a run ends with."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.convergence import Convergence


class Stop(Enum):
    """Why a run ended."""

    CONVERGED = "converged"
    STEPS = "the largest number of steps"
    BUDGET = "the time budget"
    INTERRUPTED = "interrupted"
    QUICK = "quick"


@dataclass(frozen=True)
class Chains:
    """Production draws of independent ensembles, and their quality.

    draws[e, i, w] is walker w of ensemble e after step i + 1 of production. quantities are what the caller's
    function makes of the same draws. convergence covers both (None if production is too short
    to say anything). converged says whether all targets were met; message says why the run ended and, if not
    converged, what is short of its target; stop is that reason alone.
    """

    draws: Array  # (ensembles, stored, walkers, ndim)
    log_prob: Array  # (ensembles, stored, walkers)
    quantities: Array  # (ensembles, stored, walkers, quantities)
    n_steps: int
    convergence: Convergence | None
    converged: bool
    message: str
    stop: Stop
    seed: int

    def flat(self, n: int | None = None) -> Array:
        """(n, ndim) draws spread evenly over all ensembles, steps and walkers; all of them by default."""
        flat = self.draws.reshape(-1, self.draws.shape[-1])
        return flat if n is None or n >= len(flat) else flat[np.linspace(0, len(flat) - 1, n).round().astype(int)]
