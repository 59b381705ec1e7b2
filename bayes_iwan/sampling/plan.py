"""What a run is asked for: of what, when to stop, and where to keep it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.sampling.chains import Stop
from bayes_iwan.sampling.convergence import Convergence

BatchFunction = Callable[[Array], Array]


class SamplingError(InputError):
    """The posterior, the population or the settings cannot be sampled."""


@dataclass(frozen=True)
class Plan:
    """A run as it is asked for. The same seed gives the same draws.

    names : of the sampled numbers z
    quantities : maps z (n, ndim) to (n, len(quantity_names)), further quantities that must converge too
    checkpoint : file that is written as the run goes on; with `resume` a run goes on from it to the very same draws. A
        file that is not there yet is started
    fingerprint : named hashes of whatever makes this run what it is; a checkpoint with others is refused
    budget_s : seconds of one call after which it stops; max_steps : steps that count
    target_r_hat, target_ess, chain_taus : all of R-hat ≤, bulk and tail ESS ≥, and steps ≥ chain_taus · tau, for every
        sampled number and every quantity; by_r_hat : names of which R-hat alone is asked
    progress : show a bar where there is a terminal

    Raises SamplingError where quantities come without names, or names without quantities.
    """

    names: tuple[str, ...]
    seed: int
    quantities: BatchFunction | None = None
    quantity_names: tuple[str, ...] = ()
    checkpoint: Path | None = None
    fingerprint: Mapping[str, str] = field(default_factory=dict)
    resume: bool = False
    budget_s: float | None = None
    max_steps: int = 200_000
    target_r_hat: float = 1.01
    target_ess: float = 400.0
    chain_taus: float = 10.0
    by_r_hat: frozenset[str] = frozenset()
    progress: bool = True

    def __post_init__(self) -> None:
        if (self.quantities is None) != (not self.quantity_names):
            raise SamplingError("quantities and quantity_names go together")

    @property
    def every_name(self) -> tuple[str, ...]:
        """Of the numbers that must converge."""
        return self.names + self.quantity_names

    @property
    def quiet(self) -> bool | None:
        """As a bar's `disable` takes it: None is quiet where there is no terminal."""
        return None if self.progress else True

    @property
    def resumed(self) -> Path | None:
        """The checkpoint to go on from, if there is one."""
        return self.checkpoint if self.resume and self.checkpoint is not None and self.checkpoint.exists() else None

    def evaluated(self, z: Array) -> Array:
        """(..., quantities) of draws z (..., ndim). Raises SamplingError where they have another shape."""
        count = len(self.quantity_names)
        if self.quantities is None:
            return np.empty((*z.shape[:-1], 0))
        values = np.asarray(self.quantities(z.reshape(-1, z.shape[-1])), dtype=float)
        if values.shape != (z[..., 0].size, count):
            raise SamplingError(f"quantities(z) returned shape {values.shape}; it must be (n, {count})")
        return values.reshape(*z.shape[:-1], count)

    def shortfall(self, result: Convergence) -> str:
        """What is short of the targets, "" where nothing is."""
        return result.shortfall(self.target_r_hat, self.target_ess, self.chain_taus)

    def ended(self, short: str, steps: int, late: bool) -> tuple[Stop | None, str]:
        """Whether and why a run is over that is so much short after so many steps; late : its time is up."""
        if not short:
            return Stop.CONVERGED, "converged"
        if steps >= self.max_steps:
            return Stop.STEPS, f"stopped at {self.max_steps} steps"
        if late:
            return Stop.BUDGET, f"stopped at the time budget of {self.budget_s:g} s"
        return None, ""
