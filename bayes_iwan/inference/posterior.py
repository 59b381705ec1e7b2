"""The posterior of one identification: draws, what they were drawn from, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.campaign import Campaign, Loop
from bayes_iwan.inference.discrepancy import Correlated
from bayes_iwan.inference.intervals import Widening, widenings
from bayes_iwan.inference.point import Point
from bayes_iwan.inference.problem import Problem
from bayes_iwan.inference.quantities import quantities
from bayes_iwan.physics.motion import motion_of
from bayes_iwan.physics.simulator import FORCE_ZERO, Derived, straight_part
from bayes_iwan.sampling.convergence import Convergence, diagnose


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
class Posterior:
    """Draws of a problem's coordinates from independent ensembles.

    loops : all tests' loops, held-out ones included; problem.loops are those fitted.
    z : (chains, draws, ndim), log_prob : (chains, draws); a chain is an ensemble, its draws lie walker after walker
    in the order of the steps, `walkers` of them, so that neighbours are steps of one walker.
    thin : sampler's steps between two draws of a walker. convergence : rows for the sampled numbers over the whole
    run; message : why the run ended, and what fell short if it has not converged.
    campaign : None for loops that came from no folder. simulator_file : where a user's own simulator came from.
    """

    problem: Problem
    campaign: Campaign | None
    loops: tuple[Loop, ...]
    z: Array
    log_prob: Array
    walkers: int
    thin: int
    point: Point
    seed: int
    converged: bool
    message: str
    config: Mapping[str, Any]
    versions: Mapping[str, str]
    timings: Mapping[str, float]
    convergence: tuple[ConvergenceRow, ...]
    simulator_file: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        return self.problem.names

    @property
    def ndim(self) -> int:
        return self.problem.ndim

    @property
    def interrupted(self) -> bool:
        """Whether sampling was ended by Ctrl-C."""
        return "interrupted" in self.message

    def flat_z(self, most: int | None = None) -> Array:
        """Draws of all chains, (n, ndim), evenly thinned to at most `most`."""
        z = self.z.reshape(-1, self.ndim)
        if most is None or most >= len(z):
            return z
        return z[np.linspace(0, len(z) - 1, most).round().astype(int)]

    def values(self) -> dict[str, Array]:
        """Every parameter's value by name, (n,), fixed and tied ones included."""
        return self.problem.prior.values(self.flat_z())

    def numbers(self) -> Numbers:
        """The numbers that the physics reads, (n,)."""
        return self.problem.numbers(self.flat_z())

    def derived(self) -> dict[str, Derived]:
        """What follows from the sampled numbers without a prediction: the paper's (Table 1) for the Iwan model."""
        return self.problem.model.derived(self.numbers())

    def quantities(self) -> dict[str, Derived]:
        """Every reported quantity with its unit and values (n,), in the order of flat_z()."""
        return self._quantities

    @cached_property
    def _quantities(self) -> dict[str, Derived]:
        return quantities(self.problem, self.flat_z(), self.loops)

    @cached_property
    def widenings(self) -> dict[str, Widening]:
        """What adds to the posterior's interval of each reported quantity: between-test variance and reach."""
        return widenings(self.problem, self.point.z, self.loops)

    def interval(self, name: str, level: float = 0.9) -> tuple[float, float]:
        """The interval that is reported of a quantity: the posterior's with the between-test variance and reach."""
        values = self.quantities()[name].values
        kept = values[np.isfinite(values)]
        widening = self.widenings[name]
        if not len(kept) or (widening.relative and np.any(kept <= 0.0)):
            widening = replace(widening, relative=False, between_sd=float("nan"), unreached_sd=0.0)
        return widening.interval(kept, level) if len(kept) else (float("nan"), float("nan"))

    def by_steps(self, values: Array) -> Array:
        """Values (n,) in the order of flat_z() as (chains, steps, walkers), as the diagnostics take them."""
        chains = self.z.shape[0]
        return np.moveaxis(values.reshape(chains, self.walkers, -1), 1, 2)

    @cached_property
    def diagnostics(self) -> Convergence:
        """R-hat and effective sizes of every reported quantity, from the draws kept."""
        named = self.quantities()
        draws = np.stack([self.by_steps(q.values) for q in named.values()], axis=3)
        return diagnose(draws, tuple(named), thin=self.thin)

    def summary(self) -> tuple[SummaryRow, ...]:
        """Mean, spread, quantiles and diagnostics of every reported quantity (numbers that are fixed have none)."""
        rows = []
        d = self.diagnostics
        for i, (name, quantity) in enumerate(self.quantities().items()):
            x = quantity.values
            low, middle, high = np.quantile(x, [0.05, 0.5, 0.95])
            rows.append(
                SummaryRow(
                    name,
                    quantity.unit,
                    float(np.mean(x)),
                    float(np.std(x, ddof=1)),
                    float(low),
                    float(middle),
                    float(high),
                    float(d.ess_bulk[i]),
                    float(d.ess_tail[i]),
                    float(d.r_hat[i]),
                    self.widenings[name].between_sd * (float(middle) if self.widenings[name].relative else 1.0),
                    *self.interval(name),
                    self.widenings[name].reach,
                )
            )
        return tuple(rows)

    def predict(
        self,
        n: int = 200,
        loops: Sequence[Loop] | None = None,
        friction: bool = False,
        replicate: bool = False,
        rng: np.random.Generator | None = None,
    ) -> Array:
        """Predicted force of n draws, (n, tests, samples), N.

        loops : other tests than those fitted. friction : less the parallel spring and the force zero. replicate :
        with errors drawn from the noise model added, as a new measurement would show them (fitted tests only).
        Raises ValueError for replicates of loops that were not fitted.
        """
        z = self.flat_z(n)
        motion = self.problem.motion if loops is None else motion_of(loops)
        numbers = self.problem.numbers(z)
        force = self.problem.predict(z, motion)
        if replicate:
            if loops is not None and tuple(x.file for x in loops) != tuple(x.file for x in self.problem.loops):
                raise ValueError("replicates are drawn for the fitted tests only: the noise model knows no others")
            force = self.replicate(force, numbers, np.random.default_rng(self.seed) if rng is None else rng)
        if friction:
            slope = self.problem.model.spring_N_mm(numbers)
            if slope is None:
                return force - straight_part(force, motion.displacement_mm)
            spring = slope[:, None, None] * motion.displacement_mm
            force = force - spring - numbers[FORCE_ZERO][:, None, None]
        return force

    def replicate(self, force_N: Array, numbers: Mapping[str, Array], rng: np.random.Generator) -> Array:
        """Predicted forces of the fitted tests, (draws, tests, samples), with errors as a new measurement would have.

        The errors are the likelihood's, but for the mean force. There the correlated likelihood allows for a place of
        rest known to 0.3 % of the stroke only, so that no offset can pull the fit; as a prediction that is ten times
        too wide for a careful rig. How far the means have wandered from the median prediction the tests themselves
        say: a new one is drawn from the Student t that follows (three tests or more).
        """
        likelihood, tests = self.problem.likelihood, len(self.problem.loops)
        loop = likelihood.replicate(force_N, numbers, rng)
        if not isinstance(likelihood, Correlated) or tests < 3:
            return loop
        middle, allowed = np.median(force_N.mean(axis=-1), axis=0), likelihood.mean_error_N
        seen = (self.problem.measured_N.mean(axis=-1) - middle) / allowed
        scale = np.sqrt((1.0 + 1.0 / tests) * np.sum(seen**2) / rng.chisquare(tests - 1, len(loop)))
        mean = middle + scale[:, None] * allowed * rng.standard_normal((len(loop), tests))
        return loop + (mean - loop.mean(axis=-1))[..., None]
