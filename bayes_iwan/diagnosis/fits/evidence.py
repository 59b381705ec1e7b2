"""Evidence of one model for a campaign's data: refit from several starts, Laplace's approximation, and a grid over the
discrepancy that stands beside every model.

measured = simulator(base + effects) + discrepancy + noise. The discrepancy is Gaussian, smooth along the loop and
between tests, of share a of the friction force (:class:`bayes_iwan.inference.setup.discrepancy.Correlated`), and
changes along the record by a share b. Its sizes are inferred for every set of effects and need not be small: the prior
over a is flat in ln a up to a tenth (:data:`bayes_iwan.diagnosis.constants.LARGE_DISCREPANCY`), so a cause may explain
a part of the gap and leave the others without a name. So is how it is correlated between tests, in one of a few ways
that are as likely as each other beforehand (:data:`bayes_iwan.diagnosis.fits.discrepancy_size.BETWEEN`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.constants import LARGEST_DISCREPANCY
from bayes_iwan.diagnosis.fits.data import GapData, predicted
from bayes_iwan.diagnosis.fits.discrepancy_size import (
    ALONG_SHARES,
    BETWEEN,
    FIRST,
    LENGTHS,
    SHARES,
    DiscrepancySize,
    Linear,
    Sizes,
    Stepped,
)
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.effects.base import Effect
from bayes_iwan.errors import InputError
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.problem import Problem, iwan_model, make_problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings, IdentifySettings, LikelihoodSettings, ParameterChange
from bayes_iwan.inference.setup.spectrum import discrepancy_spectrum
from bayes_iwan.models import Model, Simulator
from bayes_iwan.models.parameter import Z_LIMIT
from bayes_iwan.screen import on_screen

#: RMS change of the rows' ln weights beyond which a model is fitted again with those of its own discrepancy
OTHER_WEIGHTS = 0.25
#: rounds in which a model is fitted again, each with the weights of the discrepancy that the last one left, while it
#: gains so many nats
ROUNDS, GAINED = 4, 0.5
#: optima of the evidence from which it is sought besides the best, and iterations of that
NEWTON_STARTS, NEWTON_STEPS = 2, 15
#: optima that are kept of a fit
OPTIMA_MOST = 4
#: sizes of the discrepancy over which the evidence is tabulated, and those among which the loops' is found first where
#: a discrepancy changes along the record
_FINE = tuple((float(a), float(n)) for a in SHARES for n in LENGTHS)
_COARSE: Sizes = tuple((float(a), float(LENGTHS[-1]), FIRST.along) for a in SHARES[::2])
_FIXED_NOISE = {
    "noise_scale": ParameterChange(fixed=1.0),
    "discrepancy_share": ParameterChange(fixed=FIRST.share),
    "discrepancy_length": ParameterChange(fixed=FIRST.length),
}


class FitError(InputError):
    """A model that has no finite force for these tests."""


@dataclass(frozen=True)
@on_screen
class Fit:
    """One model refitted to the data.

    z : (ndim,) optimum at the grid's best point; log_z : (shares, lengths) ln evidence over the grid, the change of
        the discrepancy along the record and how it is correlated between tests averaged over
    size : of the discrepancy at the best point; covariance : (ndim, ndim) of z there
    discrepancy_share : the discrepancy's size as a share of the friction force: median and 90 % interval of its
    posterior
    optima : (k, ndim) distinct optima found, best first
    """

    problem: Problem
    z: Array
    log_z: Array
    size: DiscrepancySize
    discrepancy_share: tuple[float, float, float]
    covariance: Array
    optima: Array
    linear: Linear
    converged: bool

    @property
    def name(self) -> str:
        return "+".join(e.name for e in self.effects) or "none"

    @property
    def effects(self) -> tuple[Effect, ...]:
        return self.problem.effects

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects in the model."""
        return frozenset(e.name for e in self.effects)

    @property
    def evolving(self) -> bool:
        """Does it change along the record?"""
        return any(e.evolving for e in self.effects)

    @cached_property
    def log_evidence(self) -> float:
        """ln ∫ Z(a, ℓ) p(a, ℓ), but for the constant of p, which is flat over the lengths."""
        return float(np.logaddexp.reduce(self.log_z.ravel()) - np.log(self.log_z.size))


def base_model(settings: DiagnoseSettings, scales: Scales) -> Model:
    """The Iwan model that a diagnosis starts from, on a campaign's scales; effects extend it."""
    return iwan_model(scales, replace(settings.model, embedded=False))


def base_problem(
    data: GapData, settings: DiagnoseSettings, scales: Scales, simulator: Simulator | None = None
) -> Problem:
    """The base model (a simulator, or the Iwan model of the settings), noise fixed, for the loops of `data`."""
    chosen = IdentifySettings(
        likelihood=LikelihoodSettings("matern"), parameters={**settings.parameters, **_FIXED_NOISE}
    )
    model = base_model(settings, scales) if simulator is None else simulator
    return make_problem(data.loops, chosen, model, scales)


def fit_model(data: GapData, problem: Problem, starts: Array, iterations: int = 40) -> Fit:
    """Fit a model from all starts, tabulate its evidence over the discrepancy's grid, refit at the best point, until
    neither the model nor the discrepancy moves any more.

    Raises FitError where no start reaches a finite cost: the model has no force there.
    """
    found = Rows(data, problem).fit(starts, FIRST, iterations)
    cost, order = found.cost, np.argsort(found.cost)
    if not np.isfinite(cost[order[0]]):
        raise FitError(f"{'+'.join(e.name for e in problem.effects) or 'the base model'}: no finite force")
    optima = _distinct(found.x[order], cost[order])
    best = grid = _weighed(data, problem, optima[0])
    near, weighed_by = list(optima), FIRST
    for _ in range(ROUNDS):  # the discrepancy follows the model and the model the discrepancy, until both stand
        rows = Rows(data, problem, grid.size.between)
        alike = grid.size.between == weighed_by.between
        if alike and np.sqrt(np.mean(np.log(rows.sd(grid.size) / rows.sd(weighed_by)) ** 2)) <= OTHER_WEIGHTS:
            break
        again = rows.fit(np.stack([*near, grid.z]), grid.size, iterations, grid.linear)
        weighed_by, grid = grid.size, _weighed(data, problem, again.x[again.best])
        gained = grid.log_evidence - best.log_evidence
        best, near = max(best, grid, key=lambda g: g.log_evidence), [grid.linear.z]
        if gained < GAINED:
            break
    return Fit(
        problem,
        best.linear.z,
        best.log_z + Rows(data, problem).layout.constant,
        best.size,
        best.discrepancy_share,
        np.asarray(np.linalg.inv(best.precision)),
        optima,
        best.linear,
        bool(found.arrived[order[0]]),
    )


#: variance of the mean force's discrepancy over that of other harmonics where the mean is as good as free
FREE = 1e4


def newton_size(discrepancy_share: float) -> DiscrepancySize:
    """The discrepancy beside which the least gap in newtons is sought: alike in every harmonic and along the record,
    and as large as you like in the mean force, which counts as no gap."""
    share = min(discrepancy_share, LARGEST_DISCREPANCY)
    return DiscrepancySize(share, 0.0, share, (FREE,))


def in_newtons(data: GapData, fit: Fit, iterations: int = NEWTON_STEPS, smaller: Sequence[Fit] = ()) -> Fit:
    """The model of a fit where it misses least in newtons: least squares of loops and their changes alike; sought from
    where smaller models do, too, since more effects cannot miss more.

    What an effect does is assessed by evidence, which follows the harmonics that are quiet and leaves to a large
    discrepancy what the model need not fit; how large a gap is, and which share of it an effect removes, is asked in
    newtons.
    """
    own = dict(zip(fit.problem.names, fit.z))
    theirs = [own | dict(zip(f.problem.names, f.z)) for f in smaller]
    starts = [fit.z, *fit.optima[:NEWTON_STARTS], *(np.array([z[n] for n in own]) for z in theirs)]
    size = newton_size(fit.discrepancy_share[0])
    return fit if fit.size == size else beside(data, fit, size, starts, iterations, fit.linear)


def predicting(data: GapData, fit: Fit, nearest: Fit) -> Fit:
    """The model of a fit for tests that it has not seen: as `nearest`, its least gap in newtons, but held by its priors
    as far as the discrepancy that was inferred beside it says."""
    size = DiscrepancySize(fit.discrepancy_share[0], 0.0, fit.size.along, (FREE,), fit.size.along_spectrum)
    alike = size.share == nearest.size.share and not any(e.evolving for e in fit.effects)
    if alike or fit.size == size:
        return nearest if alike else fit
    return beside(data, fit, size, [fit.z, nearest.z], NEWTON_STEPS, fit.linear)


def beside(
    data: GapData,
    fit: Fit,
    size: DiscrepancySize,
    starts: Sequence[Array],
    iterations: int,
    known: Linear | None = None,
) -> Fit:
    """A fit's model refitted beside a discrepancy of a size. known : the fit's linear model, where it is of these
    data."""
    rows = Rows(data, fit.problem, size.between)
    found = rows.fit(np.array(starts), size, iterations, known if fit.size.between == size.between else None)
    linear = rows.linear(found.x[found.best])
    covariance = np.asarray(np.linalg.inv(linear.precision(size)))
    return replace(fit, z=linear.z, size=size, covariance=covariance, optima=linear.z[None], linear=linear)


@dataclass(frozen=True)
class _Grid:
    """ln evidence (shares, lengths) over the discrepancy's grid; its best point z (ndim,), the precision and the
    discrepancy's size there; and the discrepancy's share of the friction."""

    linear: Linear
    log_z: Array
    z: Array
    precision: Array
    size: DiscrepancySize
    discrepancy_share: tuple[float, float, float]

    @property
    def log_evidence(self) -> float:
        """The same over the whole grid, but for a constant."""
        return float(np.logaddexp.reduce(self.log_z.ravel()))


def _weighed(data: GapData, problem: Problem, z: Array) -> _Grid:
    """A model's evidence about z (ndim,), beside a discrepancy that is correlated between tests as is likeliest."""
    rows, linear, ways = _together(data, problem, z)
    grid = _grid(rows, linear)
    return replace(grid, log_z=grid.log_z + ways)


def _grid(rows: Rows, linear: Linear) -> _Grid:
    along, change = float(ALONG_SHARES[0]), 0.0
    if linear.discrepancy.changing.any():
        # the change along the record has its own size, found where that of the loops is best
        share, length, _ = _COARSE[int(np.argmax(_borne_out(rows, linear, _COARSE).log_z))]
        by_change = _borne_out(rows, linear, tuple((share, length, float(b)) for b in ALONG_SHARES)).log_z
        along = float(ALONG_SHARES[int(np.argmax(by_change))])
        change = float(np.logaddexp.reduce(by_change) - np.log(len(by_change)) - by_change.max())
    found = _borne_out(rows, linear, tuple((a, n, along) for a, n in _FINE))
    best = int(np.argmax(found.log_z))
    log_z = found.log_z.reshape(len(SHARES), len(LENGTHS)) + change
    whole = _whole_share(linear.discrepancy.orders, found)
    return _Grid(linear, log_z, found.z[best], found.precision[best], found.sizes[best], whole)


def _together(data: GapData, problem: Problem, z: Array) -> tuple[Rows, Linear, float]:
    """The likeliest way in which the discrepancy may be correlated between tests, for a model about z (ndim,): its rows
    and the linear model in them; and ln of how much evidence all ways have on the mean, over what the likeliest one
    has."""
    several = [Rows(data, problem, b) for b in (BETWEEN if data.tests > 1 else BETWEEN[:1])]
    around = several[0].around(z)
    linear = [rows.linear_of(around, z) for rows in several]
    stepped = [x.evidence(_COARSE) for x in linear]
    best = [int(np.argmax(x.log_z)) for x in stepped]
    led = np.clip([x.z[k] for x, k in zip(stepped, best)], -Z_LIMIT, Z_LIMIT)
    with np.errstate(all="ignore"):
        mean, trend, lines = predicted(data, problem, led)
    log_z = np.empty(len(several))
    for i, (rows, x, k) in enumerate(zip(several, linear, best)):  # see _borne_out
        one = slice(i, i + 1)
        there = rows.residual_from(
            (mean[one], None if trend is None else trend[one], None if lines is None else lines[one])
        )
        size, precision = _COARSE[k : k + 1], stepped[i].precision[k : k + 1]
        pairs = ((there, led[one]), (x.residual[None], x.z[None]))
        log_z[i] = max(float(x.at(left, at, size, precision).log_z[0]) for left, at in pairs)
    top = int(np.argmax(log_z))
    return several[top], linear[top], float(np.logaddexp.reduce(log_z) - log_z[top] - np.log(len(log_z)))


def _borne_out(rows: Rows, linear: Linear, sizes: Sizes) -> Stepped:
    """ln evidence at sizes of the discrepancy by what the model really misses where the linear one leads, or where it
    was made if that is better: where residuals curve a step may promise hundreds of nats that are not there."""
    stepped = linear.evidence(sizes)
    z = np.clip(stepped.z, -Z_LIMIT, Z_LIMIT)
    with np.errstate(all="ignore"):
        there = linear.at(rows.residual(z), z, sizes, stepped.precision)
    here = linear.at(linear.residual[None], linear.z[None], sizes, stepped.precision)
    stays = ~(there.log_z >= here.log_z)
    log_z = np.where(stays, here.log_z, there.log_z)
    which = tuple(h if s else t for s, h, t in zip(stays, here.sizes, there.sizes))
    return Stepped(log_z, np.where(stays[:, None], linear.z, z), stepped.precision, which)


def _whole_share(orders: int, found: Stepped) -> tuple[float, float, float]:
    """Median and 90 % interval of the discrepancy's RMS share of the friction force, the λ of its harmonics
    included."""
    share, length = np.array([(x.share, x.length) for x in found.sizes]).T
    factors = np.array([x.factors(orders) for x in found.sizes])
    power = np.sum(discrepancy_spectrum(share, length, orders) * factors, axis=1)
    at = np.argsort(power)
    weight = np.exp(found.log_z - np.logaddexp.reduce(found.log_z))[at]
    below = np.cumsum(weight) - 0.5 * weight
    low, middle, high = np.exp(np.interp([0.05, 0.5, 0.95], below, 0.5 * np.log(power[at])))
    return float(middle), float(low), float(high)


def _distinct(x: Array, cost: Array) -> Array:
    """Different optima, the best first, OPTIMA_MOST at most: they lie apart in z and cost less than 50 more than the
    best."""
    kept = [x[0]]
    for one, value in zip(x[1:], cost[1:]):
        if value < cost[0] + 50.0 and all(np.max(np.abs(one - k)) > 0.3 for k in kept) and len(kept) < OPTIMA_MOST:
            kept.append(one)
    return np.array(kept)
