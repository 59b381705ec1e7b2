"""What is new in a campaign whose specimen is known: causes on top of a gap that was diagnosed before.

A real specimen has a gap of its own. Its leading fit, effects held at the values found, becomes the base model. What
this fit still misses is known in one of two ways: loop by loop, and then the specimen's force has it, turned with the
true displacement's phase and passed through whatever a new cause does to the channels, and noise counts twice; or by
its size alone, and then any smooth misfit of that size is allowed. On that, one further cause is sought: an effect that
the base does not have, or another value of one that it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from bayes_iwan.arrays import Array, Numbers
from bayes_iwan.campaign import Loop
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import ordered
from bayes_iwan.gap.attribution import Attribution, Calibration, Table, attribute, best_fit, calibration
from bayes_iwan.gap.data import GapData, gap_data, predicted
from bayes_iwan.gap.evidence import Fit, Rows, base_problem, extended, fit_model
from bayes_iwan.gap.search import EFFECT_STARTS, PAIR_PROMISE, SINGLE_MOST, Search, promising, start_points
from bayes_iwan.gap.strength import calibrated
from bayes_iwan.inference.scales import Scales
from bayes_iwan.physics import Motion


@dataclass(frozen=True)
class Known:
    """What was found on a specimen before: the fit that explains most of its gap, its scales, and the misfit left.

    effects : (class, strength_value) of the effects that the fit holds; values : all its numbers by name.
    share : the smooth misfit it still needs, RMS over the friction level.
    missed : measured − predicted (N) in harmonics (T, H + 1), contrasts between blocks and lines of the mains.
    turned : phase of the true displacement's first harmonic in these loops, rad (T,).
    """

    scales: Scales
    config: dict
    effects: tuple[tuple[type[Effect], float | None], ...]
    values: Mapping[str, float]
    share: float
    missed: tuple[np.ndarray, np.ndarray, np.ndarray]
    turned: np.ndarray


def _turn(motion: Motion) -> np.ndarray:
    """Phase of the displacement's first harmonic, (…, loops)."""
    return np.angle(fft.rfft(motion.displacement_mm, axis=-1)[..., 1])


class Carried(Effect):
    """The misfit of a known specimen, as a force that is there beside the model's."""

    name = "carried"
    order = -2
    parameters = ()  # type: ignore[assignment]
    missed_N: np.ndarray
    turned: np.ndarray

    @classmethod
    def over(cls, before: Known, tests: tuple[str, ...]) -> Carried:
        out = cls(before.scales, tests)
        object.__setattr__(out, "missed_N", before.missed[0])
        object.__setattr__(out, "turned", before.turned)
        return out

    def force(self, force_N: Array, motion: Motion, numbers: Numbers) -> Array:
        n = motion.samples
        turn = _turn(motion) - self.turned[motion.test]
        order = np.arange(self.missed_N.shape[1])
        c = self.missed_N[motion.test] * np.exp(1j * order * turn[..., None])
        c[..., 0] *= 2.0
        return force_N + fft.irfft(0.5 * n * c, n=n, axis=-1)


def known(found: Search) -> Known:
    """The leading fit of a search: with the cause it names (and its second), or the base where it names none."""
    verdict = attribute(Table.of(found))
    key = tuple(sorted(n for n in (verdict.cause, verdict.second_cause) if n in found.singles))
    best = best_fit(found, key)
    values = {n: float(v[0]) for n, v in best.problem.prior.values(best.z[None]).items()}
    return Known(
        found.scales,
        found.config,
        tuple((type(e), e.strength_value) for e in best.effects),
        values,
        Table({(): best.log_z}).gap_share,
        missed_by(found.data, best),
        turned_by(found.data, best),
    )


def turned_by(data: GapData, fit: Fit) -> np.ndarray:
    """Phase (T,) of the first harmonic of what the specimen did according to a fit, for :class:`Known`."""
    motion = data.steady_motion
    numbers = fit.problem.numbers(fit.z[None])
    for effect in fit.effects:
        motion = effect.motion(motion, numbers)
    return _turn(motion)[0]


def missed_by(data: GapData, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured − predicted (N) of a fit, for :class:`Known`."""
    mean, trend, lines = predicted(data, fit.problem, fit.z[None])
    return (
        data.harmonics_N - mean[0],
        data.trend_N - (0.0 if trend is None else trend[0]),
        data.mains_N - (0.0 if lines is None else lines[0]),
    )


def data_on_top(loops: Sequence[Loop], before: Known) -> GapData:
    """New data of the same tests, with what the known model missed of their evolution taken off; the noise of both
    recordings counts. What it missed of the loops is in the specimen (:class:`Carried`).

    Raises ValueError if the tests are not the same in number.
    """
    if len(loops) != len(before.missed[0]):
        raise ValueError(f"{len(loops)} tests, but {len(before.missed[0])} were known before: give the same tests")
    twice = np.sqrt(2.0)
    data = gap_data([replace(x, noise_N=twice * x.noise_N, block_noise_N=twice * x.block_noise_N) for x in loops])
    _, trend, lines = before.missed
    # where cycles were cut into other blocks, their contrasts are not comparable: as if nothing had been known
    same = trend if trend.shape == data.trend_N.shape else np.zeros_like(data.trend_N)
    return replace(data, trend_N=data.trend_N - same, mains_N=data.mains_N - lines)


def held(effect: Effect, values: Mapping[str, float]) -> Effect:
    """The same effect with all its parameters fixed at `values` (by full name)."""
    fixed = tuple(replace(p, fixed=float(values[p.name])) for p in effect.parameters)

    class Held(type(effect)):  # type: ignore[misc]
        @property
        def parameters(self):
            return fixed

    return Held(effect.scales, effect.tests, effect.strength_value)


def base_on_top(data: GapData, before: Known, by_size: bool = False) -> Fit:
    """The known model refitted to new data: its effects stay, its own numbers may move."""
    files = tuple(x.file for x in data.loops)
    kept = [held(kind(before.scales, files, strength), before.values) for kind, strength in before.effects]
    if not by_size:
        kept.append(Carried.over(before, files))
    problem = extended(base_problem(data, before.config, before.scales), ordered(kept))
    z = np.array([float(p.score(np.array(before.values[p.name]))) for p in problem.prior.free])
    nearby = z + 0.3 * np.random.default_rng(0).standard_normal((4, len(z)))
    return fit_model(data, problem, np.concatenate([z[None], nearby]))


def search_on_top(
    data: GapData, before: Known, kinds: Mapping[str, tuple[type[Effect], ...]], by_size: bool = False
) -> Table:
    """ln evidence of the known model and of one further cause each, over the grid of discrepancies."""
    base = base_on_top(data, before, by_size)
    plain = extended(base.problem, ())
    trials = []
    for name, classes in kinds.items():
        for kind in classes:
            effect = calibrated(kind, before.scales, data, plain, base.z)
            others = [e for e in base.effects if e.name != name]
            if len(others) < len(base.effects) and not any(isinstance(e, kind) for e in base.effects):
                continue  # another variant of an effect that the base holds
            problem = extended(base.problem, ordered((*others, effect)))
            points = start_points(effect, problem, np.concatenate([base.z[None], base.optima[1:3]]), base.problem.names)
            if len(others) < len(base.effects):
                points = np.concatenate([points, _as_known(points[:1], problem, effect, before)])
            starts, gain = promising(
                Rows(data, problem), points, base, max(base.share, 1e-3), base.length, EFFECT_STARTS
            )
            trials.append((gain, name, problem, starts))
    trials.sort(key=lambda t: -t[0])
    fits: dict[str, list[Fit]] = {name: [] for name in kinds}
    for i, (gain, name, problem, starts) in enumerate(trials):
        if i < SINGLE_MOST or gain > PAIR_PROMISE:
            fits[name].append(fit_model(data, problem, starts, iterations=20))
    found = Search(
        data,
        before.scales,
        before.config,
        base,
        {k: tuple(v) for k, v in fits.items()},
        {},
        {name: tuple(k(before.scales) for k in classes) for name, classes in kinds.items()},
    )
    return Table.of(found)


def _as_known(point: Array, problem, effect: Effect, before: Known) -> Array:
    """The start at which a freed effect stands where it was held."""
    out = point.copy()
    for p in effect.parameters:
        if p.name in problem.names and p.name in before.values:
            out[:, problem.names.index(p.name)] = np.clip(p.score(np.array(before.values[p.name])), -4.0, 4.0)
    return out


def attribute_on_top(table: Table, before: Known, by_size: bool = False) -> Attribution:
    """Probabilities over what was added: "none", "unknown" or an effect; `by_size`, beside a misfit of known size."""
    c: Calibration = calibration()
    if not by_size:
        return attribute(table, None, c)
    small = (float(np.hypot(c.small[0], before.share)), c.small[1])
    large = (float(np.hypot(c.large[0], 2.0 * before.share)), c.large[1])
    return attribute(table, None, replace(c, small=small, large=large))
