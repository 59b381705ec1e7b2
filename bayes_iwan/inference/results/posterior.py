"""The posterior of one identification: draws, what they were drawn from, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_iwan.arguments import level_of, whole
from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Campaign, Loop
from bayes_iwan.errors import InputError, nearest
from bayes_iwan.inference.results.held_out_frequencies import HeldOutFrequency, held_out_frequencies
from bayes_iwan.inference.results.predictions import Prediction, ResidualSize, predicted_at, replicated, residual_size
from bayes_iwan.inference.results.reach import extrapolated
from bayes_iwan.inference.results.remarks import remarks
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.setup.settings import IdentifySettings
from bayes_iwan.inference.solving.point import Point
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.simulator import FORCE_ZERO, Derived, straight_part
from bayes_iwan.sampling.chains import Stop
from bayes_iwan.sampling.convergence import Convergence, convergence_of
from bayes_iwan.screen import Listed, Named, as_html, on_screen, screen, table

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
@on_screen
class ConvergenceRow:
    """Diagnostics of one parameter; tau in steps of the sampler."""

    name: str
    ess_bulk: float
    ess_tail: float
    r_hat: float
    tau: float


class Summary(tuple["SummaryRow", ...]):
    """Rows of a summary, shown as a table."""

    __slots__ = ()

    def __repr__(self) -> str:
        rows = [(r.name, r.q50, r.q05, r.q95, r.r_hat, r.unit) for r in self]
        return table(("", "median", "5 %", "95 %", "R-hat", "unit"), rows, "summary.csv")

    _repr_html_ = as_html


@dataclass(frozen=True)
@on_screen
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


@dataclass(frozen=True, repr=False)
@on_screen
class Posterior:
    """Draws of a problem's coordinates from independent ensembles.

    Attributes
    ----------
    loops
        all tests' loops, held-out ones included; problem.loops are those fitted.
    z, log_prob
        (chains, draws, ndim) and (chains, draws); a chain is an ensemble, its draws lie walker after walker in
        the order of the steps, `walkers` of them, so that neighbours are steps of one walker.
    thin
        sampler's steps between two draws of a walker.
    convergence
        rows for the sampled parameters over the whole run.
    message
        why the run ended, and what fell short if it has not converged.
    stop
        the reason alone.
    campaign
        None for loops that came from no folder.
    simulator_file
        where a user's own simulator came from.
    stretch
        factor by which the draws were made wider in the direction in which the tests disagree most.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=1).write(folder)
    >>> posterior = bi.identify(folder, quick=True, seed=1, config={"model": {"slip": "gamma1", "embedded": False}})
    >>> spring = next(row for row in posterior.summary() if row.name == "kp_N_mm")
    >>> spring.unit, bool(spring.q05 < spring.q50 < spring.q95)
    ('N/mm', True)
    >>> posterior.to_dataframe()["kp_N_mm"].shape == (posterior.flat_z().shape[0],)
    True
    >>> posterior.predict(frequency_hz=12.0, amplitude_mm=[0.5, 0.7]).force_N.shape
    (400, 2, 128)
    >>> bool(posterior.residual_size().share < 0.1)
    True
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
    settings: IdentifySettings
    versions: Mapping[str, str]
    timings: Mapping[str, float]
    convergence: tuple[ConvergenceRow, ...]
    simulator_file: str = ""
    stop: Stop = Stop.CONVERGED
    stretch: float = 1.0

    def __repr__(self) -> str:
        *rows, gap = self._shown()
        return screen((self._title(),), [f"  {row}" for row in rows], (f"  {gap}", *self.warnings()), ".summary()")

    @property
    def name(self) -> str:
        """The campaign's name, "loops" where these came from none."""
        return "loops" if self.campaign is None else self.campaign.name

    def _title(self) -> str:
        draws = self.z.shape[0] * self.z.shape[1]
        head = f"{self.problem.model.name} identified from {self.name}"
        return f"{head}: {draws} draws of {self.ndim} parameters; {self.message}"

    def _shown(self) -> list[str]:
        """Medians and 90 % intervals of the sampled parameters, and the residual, one line each."""
        values = self.problem.prior.values(self.flat_z())
        rows, units = [], self.problem.units
        for p in self.problem.prior.free:
            low, middle, high = np.quantile(values[p.name], [0.05, 0.5, 0.95])
            rows.append(f"{units.name(p.name):22s} {middle:10.4g}  ({low:.4g} to {high:.4g}) {p.unit}")
        residual = self.residual_size()
        return [*rows, f"{'gap':22s} {residual.gap_N:10.3g} {units.force} RMS, {residual}"]

    @property
    def quick(self) -> bool:
        """Whether the draws are the first ones of a short run, which was not asked whether it has converged."""
        return self.stop is Stop.QUICK

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters, in z's order."""
        return Listed(self.problem.names)

    @property
    def ndim(self) -> int:
        """How many they are."""
        return self.problem.ndim

    @property
    def interrupted(self) -> bool:
        """Whether sampling was ended by Ctrl-C."""
        return self.stop is Stop.INTERRUPTED

    def flat_z(self, n: int | None = None) -> Array:
        """Draws of all chains, (draws, ndim), evenly thinned to at most n."""
        z = self.z.reshape(-1, self.ndim)
        if n is None or whole(n, "n", 1) >= len(z):
            return z
        return z[np.linspace(0, len(z) - 1, n).round().astype(int)]

    def values(self) -> dict[str, Array]:
        """Every parameter's value by name, (n,), fixed and tied ones included."""
        return Named(self.problem.prior.values(self.flat_z()))

    def parameter_values(self) -> ParameterValues:
        """The values that the simulator reads, by name, (n,) each."""
        return Named(self.problem.parameter_values(self.flat_z()))

    def derived(self) -> dict[str, Derived]:
        """What follows from the sampled parameters without a prediction: the paper's (Table 1) for the Iwan model."""
        text = self.problem.units.text
        found = self.problem.model.derived(self.parameter_values())
        return Named({n: Derived(text(q.unit), q.values) for n, q in found.items()})

    def quantities(self) -> dict[str, Derived]:
        """Every reported quantity with its unit and values (n,), in the order of flat_z()."""
        return self._quantities

    @cached_property
    def _quantities(self) -> dict[str, Derived]:
        return Named(quantities(self.problem, self.flat_z(), self.loops))

    @cached_property
    def extrapolated(self) -> dict[str, str]:
        """Why a quantity is extrapolated, by name, for those that the loops do not reach."""
        return Named(extrapolated(self.problem, self.flat_z()))

    @cached_property
    def held_out(self) -> tuple[HeldOutFrequency, ...]:
        """Each frequency of the fitted tests predicted from all others, and what the bands hold; none for one only."""
        return Listed(held_out_frequencies(self.problem, self.flat_z()))

    def interval(self, name: str, level: float = 0.9) -> tuple[float, float]:
        """The central interval (low, high) of a quantity named as in :meth:`summary`, in its unit: quantiles of its
        draws; nan where none is finite. Raises InputError where there is no quantity of this name."""
        level = level_of(level)
        low, high = self._quantiles(name, 0.5 * (1.0 - level), 0.5 * (1.0 + level))
        return low, high

    def median(self, name: str) -> float:
        """The median of a quantity's draws. Raises InputError where there is no quantity of this name."""
        return self._quantiles(name, 0.5)[0]

    def _quantiles(self, name: str, *levels: float) -> tuple[float, ...]:
        known = self.quantities()
        if name not in known:
            raise InputError(f"no quantity {name!r}" + nearest(name, known, "; `quantities()` holds them"))
        values = known[name].values
        kept = values[np.isfinite(values)]
        return tuple(map(float, np.quantile(kept, levels))) if len(kept) else (float("nan"),) * len(levels)

    def by_steps(self, values: Array) -> Array:
        """Values (n,) in the order of flat_z() as (chains, steps, walkers), as the diagnostics take them."""
        chains = self.z.shape[0]
        return np.moveaxis(values.reshape(chains, self.walkers, -1), 1, 2)

    @cached_property
    def diagnostics(self) -> Convergence:
        """R-hat and effective sizes of every reported quantity, from the draws kept."""
        named = self.quantities()
        draws = np.stack([self.by_steps(q.values) for q in named.values()], axis=3)
        return convergence_of(draws, tuple(named), thin=self.thin)

    def summary(self) -> Summary:
        """Mean, spread, quantiles and diagnostics of every reported quantity, as rows that show themselves as a table;
        R-hat and effective sizes are nan for what is fixed and for quick draws."""
        rows = []
        d = None if self.quick else self.diagnostics  # of so short a run they say nothing
        for i, (name, quantity) in enumerate(self.quantities().items()):
            x, unit, why = quantity.values, quantity.unit, self.extrapolated.get(name, "")
            mean, sd = float(np.mean(x)), float(np.std(x, ddof=1))
            low, middle, high = map(float, np.quantile(x, [0.05, 0.5, 0.95]))
            sampled = (np.nan,) * 3 if d is None else (d.ess_bulk[i], d.ess_tail[i], d.r_hat[i])
            bulk, tail, r_hat = map(float, sampled)
            rows.append(SummaryRow(name, unit, mean, sd, low, middle, high, bulk, tail, r_hat, why))
        return Summary(rows)

    def residual_size(self, n: int = 400) -> ResidualSize:
        """How far the median prediction of n draws misses the fitted tests, their mean forces, which drift, aside."""
        return residual_size(self.problem, self.flat_z(n))

    def warnings(self) -> tuple[str, ...]:
        """What a reader of the intervals must know, one sentence each."""
        return Listed(remarks(self))

    def predict(
        self, frequency_hz: float | Array | None, amplitude_mm: float | Array, n: int = 400, samples: int = 128
    ) -> Prediction:
        """Loops at other frequencies and amplitudes, steady sines, by n draws; `.band(level)` gives their bands.

        frequency_hz, amplitude_mm : one or several, broadcast against each other to (loops,); a frequency of None where
        the tests have no clock. Raises InputError for what is not positive, and for an amplitude or speed of more than
        5 times the largest tested; warns of what no test was near.
        """
        return predicted_at(self.problem, self.flat_z(n), frequency_hz, amplitude_mm, samples)

    def to_dataframe(self) -> pandas.DataFrame:
        """Every reported quantity in each draw: a column each, rows by chain and draw."""
        import pandas as pd

        chains, draws = self.z.shape[:2]
        index = pd.MultiIndex.from_product([range(chains), range(draws)], names=["chain", "draw"])
        return pd.DataFrame({name: q.values for name, q in self.quantities().items()}, index=index)

    def to_arviz(self) -> Any:
        """ArviZ's object of all groups of posterior.nc: `InferenceData` up to 0.23, `DataTree` from 1.0."""
        from bayes_iwan.inference.results.netcdf import to_arviz

        return to_arviz(self)

    def forces(
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
        parameter_values = self.problem.parameter_values(z)
        force = self.problem.predict(z, motion)
        if replicate:
            if loops is not None and tuple(x.file for x in loops) != tuple(x.file for x in self.problem.loops):
                raise InputError("replicates are drawn for the fitted tests only: the noise model knows no others")
            rng = np.random.default_rng(self.seed) if rng is None else rng
            force = replicated(self.problem, force, parameter_values, rng)
        if friction:
            slope = self.problem.model.spring_N_mm(parameter_values)
            if slope is None:
                return force - straight_part(force, motion.displacement_mm)
            spring = slope[:, None, None] * motion.displacement_mm
            force = force - spring - parameter_values[FORCE_ZERO][:, None, None]
        return force
