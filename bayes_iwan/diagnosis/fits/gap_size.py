"""How large the gap is: measured minus predicted force with the records' own repeatability taken off.

The gap of a test is the RMS, over its record, of what the model misses: of the averaged loop, of its change along the
record, and of lines of the mains. Its square is estimated without bias: noise, as the records' repeatability gives it,
adds its expected power to the residual's, less what the fit has absorbed, and that is taken off. So a perfect model
reads zero within its interval, which counts the parameters' uncertainty too. A test's mean force is no part of it: it
hangs on where the specimen comes to a standstill, which a dynamic displacement channel does not tell; its gap is given
apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.fits.data import TREND_HARMONICS, GapData, predicted
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.residuals import ALONG, COUNTED, LOOP, MAINS, MEAN, Residual
from bayes_iwan.inference.setup.loop_error import beyond_noise_N2, friction_rms_N
from bayes_iwan.inference.setup.spectrum import discrepancy_spectrum
from bayes_iwan.screen import on_screen

LEVEL = 0.9
DRAWS = 400


@dataclass(frozen=True)
class Share:
    """A share of the gap with its 90 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
@on_screen
class Gap:
    """RMS of what the model misses in N and as a share of the RMS friction force, with 90 % intervals.

    noise_N : RMS of the noise that was taken off; residual_N : RMS of measured − predicted before that.
    """

    rms_N: float
    low_N: float
    high_N: float
    share: float
    share_low: float
    share_high: float
    noise_N: float
    residual_N: float

    @property
    def resolved_share(self) -> float:
        """The share where its interval leaves zero out, else 0: what can be said to be there."""
        return self.share if self.low_N > 0.0 else 0.0


@dataclass(frozen=True)
@on_screen
class GapSize:
    """Gap of each test and of all together (RMS over tests).

    tests : by test; all : everything; loop, along, mains : its parts over all tests, in the averaged loop, its change
    along the record, and lines of the mains; mean : that of the mean forces, which `all` leaves out
    friction_N : (T,) RMS friction force.
    cycle, along_N : by test, (B,) mean cycle number of each block of cycles and RMS residual there;
    along_low_N, along_high_N : its 90 % interval.
    power_N2 : (T,) squared gaps, which noise may make negative; of all tests together `all` is their mean's root
    plausible : (draws, T) squares of the gap that the data leave possible, N² (:func:`shrink` compares two).
    """

    files: tuple[str, ...]
    tests: tuple[Gap, ...]
    all: Gap
    loop: Gap
    along: Gap
    mains: Gap
    mean: Gap
    friction_N: Array
    cycle: tuple[Array, ...]
    along_N: tuple[Array, ...]
    along_low_N: tuple[Array, ...]
    along_high_N: tuple[Array, ...]
    power_N2: Array
    plausible: Array


def friction_rms_by_test_N(residual: Residual) -> Array:
    """(T,) RMS friction force, N: :func:`bayes_iwan.inference.setup.loop_error.friction_rms_N`."""
    problem = residual.fit.problem
    parameter_values = problem.parameter_values(residual.fit.z[None])
    force = problem.friction_force(parameter_values, residual.data.steady_motion)[0]
    return friction_rms_N(force, residual.data.loops)


def gap_size(residual: Residual, seed: int = 0, draws: int = DRAWS, friction_N: Array | None = None) -> GapSize:
    """The gap of a fitted model on any tests; friction_N (T,) replaces the model's own friction in the shares.

    Intervals: the residual's error is drawn from the noise, run through the refit (for the fitted tests) or joined by
    the parameters' posterior (for others), and the estimate's distribution around itself is reflected.
    """
    rng = np.random.default_rng([seed, 71])
    friction = friction_rms_by_test_N(residual) if friction_N is None else np.asarray(friction_N)
    error = residual.after_refit(residual.draw_noise(draws, rng))
    kinds = (*COUNTED, MEAN)
    removed = {kind: residual.power(error, kind).mean(axis=0) for kind in kinds}
    if not residual.refitted:
        removed = {kind: residual.noise_power(kind) for kind in kinds}
        error = error + residual.draw_parameters(draws, rng)
    raw = {kind: residual.power(residual.value, kind) for kind in kinds}
    found, spread = {}, {}
    for kind in kinds:
        found[kind] = beyond_noise_N2(raw[kind], removed[kind])
        removed[kind] = raw[kind] - found[kind]
        # the gap's best guess: the residual, made as small as its own power without the noise
        scale = np.sqrt(np.maximum(found[kind], 0.0) / np.maximum(raw[kind], 1e-300))
        spread[kind] = residual.power(scale[:, None] * residual.value + error, kind) - removed[kind]
    total, again, off, left = (np.sum([x[k] for k in COUNTED], axis=0) for x in (found, spread, removed, raw))
    tests = tuple(_gap(total[t], again[:, t], off[t], left[t], friction[t]) for t in range(len(total)))
    level = float(np.sqrt(np.mean(friction**2)))
    everything = _gap(total.mean(), again.mean(axis=1), off.mean(), left.mean(), level)
    part = {k: _gap(found[k].mean(), spread[k].mean(axis=1), removed[k].mean(), raw[k].mean(), level) for k in kinds}
    plausible = np.maximum(2.0 * total - again, 0.0)
    return GapSize(
        tuple(x.file for x in residual.data.loops),
        tests,
        everything,
        part[LOOP],
        part[ALONG],
        part[MAINS],
        part[MEAN],
        friction,
        *_along(residual, error),
        total,
        plausible,
    )


def gap_power_N2(residual: Residual, kinds: Sequence[int] = COUNTED) -> Array:
    """(T,) squared gap of each test, or some parts of it, its noise taken off: may be negative. The quick form of
    :func:`gap_size` for tests that the model was not fitted to."""
    power = [beyond_noise_N2(residual.power(residual.value, kind), residual.noise_power(kind)) for kind in kinds]
    return np.sum(power, axis=0)


def ceiling_N(residual: Residual) -> float:
    """RMS of what would be left of a gap, N, if something explained all that can be known of it.

    A discrepancy that is smooth along the loop, of the size and length that the fit itself found, is taken off (its
    posterior mean); contrasts along the record and lines of the mains by a variance of their own. No added effect can
    be expected to leave less.
    """
    value, noise = residual.value, residual.noise
    steady = np.flatnonzero(residual.kind <= MEAN)
    smooth = np.zeros_like(noise)
    size = residual.fit.size
    spectrum = discrepancy_spectrum(np.array([size.share]), np.array([size.length]), len(steady))[0]
    smooth[:, steady] = residual.data.level_N[:, None] ** 2 * spectrum * size.factors(len(steady))
    for kind in (ALONG, MAINS):
        at = residual.kind == kind
        there = at & (residual.weight > 0.0)
        power = np.sum(np.where(there, 0.5 * np.abs(value) ** 2 - noise**2, 0.0), axis=1)
        smooth[:, at] = (np.maximum(power, 0.0) / np.maximum(there.sum(axis=1), 1))[:, None]
    with np.errstate(invalid="ignore"):
        kept = np.where(residual.weight > 0.0, noise**2 / np.maximum(smooth + noise**2, 1e-300), 0.0)
    left = residual.power(kept * value, *COUNTED)
    parts = np.where(residual.real, 1.0, 2.0) * (kept * np.where(residual.weight > 0.0, noise, 0.0)) ** 2
    counted = np.isin(residual.kind, COUNTED)
    off = np.sum(residual.weight[:, counted] * parts[:, counted], axis=1)
    return float(np.sqrt(max(np.mean(left - off), 0.0)))


def moved_shares(fit: Fit, data: GapData) -> dict[str, float]:
    """RMS force that each effect of a fit moves, its change along the record included, over the friction level: by
    switching it off alone."""
    level = float(np.sqrt(np.mean(data.level_N**2)))
    out = {}
    for effect in fit.effects:
        off = fit.z.copy()
        own = [fit.problem.names.index(p.name) for p in effect.parameters if p.name in fit.problem.names]
        single = effect.strength_name in fit.problem.names
        off[own[:1] if single else own] = -8.0 if single and not effect.signed else 0.0
        mean, trend, _ = predicted(data, fit.problem, np.stack([fit.z, off]))
        change = np.abs(mean[0] - mean[1]) ** 2
        power = np.mean(change[:, 0] + 0.5 * change[:, 1:].sum(axis=1))
        if trend is not None:
            slow = np.abs(trend[0] - trend[1]) ** 2 / data.contrast.shape[2]
            power += np.mean(slow[..., 0].sum(axis=1) + 0.5 * slow[..., 1:].sum(axis=(1, 2)))
        out[effect.name] = float(np.sqrt(power)) / level
    return out


def _gap(power: float, spread: Array, noise: float, left: float, friction: float) -> Gap:
    """A gap from its squared estimate and that estimate's distribution around it, reflected (basic bootstrap)."""
    size_N = np.array(_roots(np.array(power), spread))
    shares = size_N / max(friction, 1e-300)
    return Gap(*size_N.tolist(), *shares.tolist(), *np.sqrt([noise, left]).tolist())


def _roots(power: Array, spread: Array) -> tuple[Array, Array, Array]:
    """√ of a squared estimate and of its interval; spread (draws, …) is its distribution around max(power, 0)."""
    few, many = np.quantile(spread, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=0)
    at = np.maximum(power, 0.0)
    low, high = np.maximum(power + at - many, 0.0), np.maximum(power + at - few, 0.0)
    return np.sqrt(at), np.sqrt(low), np.sqrt(np.maximum(high, at))


def _along(
    residual: Residual, error: np.ndarray
) -> tuple[tuple[Array, ...], tuple[Array, ...], tuple[Array, ...], tuple[Array, ...]]:
    """Residual in each block of cycles: the averaged loop's residual plus the contrasts' share of the block."""
    data = residual.data
    few = np.flatnonzero((residual.kind <= MEAN) & (residual.order <= TREND_HARMONICS))
    higher = (residual.kind == LOOP) & (residual.order > TREND_HARMONICS)
    changing = residual.kind == ALONG
    weight = np.where(np.arange(len(few)) == 0, 1.0, 0.5)

    def by_block(value: np.ndarray, t: int) -> Array:  # (…, M) of one test -> (…, B)
        contrasts = value[..., changing].reshape(*value.shape[:-1], -1, TREND_HARMONICS + 1)
        mix = np.einsum("kb,...kh->...bh", data.contrast[t], contrasts[..., : len(few)])
        steady_part = np.where(residual.order[few] == 0, 0.0, value[..., few])
        c = steady_part[..., None, :] + mix
        steady = np.sum(residual.weight[t, higher] * np.abs(value[..., higher]) ** 2, axis=-1)
        return np.sum(weight * np.abs(c) ** 2, axis=-1) + steady[..., None]

    out: list[tuple[Array, Array, Array, Array]] = []
    for t, loop in enumerate(data.loops):
        blocks = len(loop.block_cycle)
        raw = by_block(residual.value[t], t)[:blocks]
        noise = by_block(error[:, t], t)[:, :blocks]
        power = raw - noise.mean(axis=0)
        scale = np.sqrt(np.maximum(power.mean(), 0.0) / max(float(raw.mean()), 1e-300))
        again = by_block(scale * residual.value[t] + error[:, t], t)[:, :blocks] - noise.mean(axis=0)
        again += np.maximum(power, 0.0) - again.mean(axis=0)
        out.append((np.asarray(loop.block_cycle), *_roots(power, again)))
    return tuple(zip(*out))  # type: ignore[return-value]


def shrink(before: GapSize, after: GapSize) -> Share:
    """1 − gap after / gap before: how much smaller one model leaves the gap than another on the same tests; nan where
    there was no gap.

    Both sizes must come from the same seed and number of draws: then their noise is common and cancels in part.
    Raises ValueError where the tests differ.
    """
    if before.files != after.files:
        raise ValueError("the two gaps belong to different tests")
    first, second = (max(float(x.power_N2.mean()), 0.0) for x in (before, after))
    if first <= 0.0:
        return Share(float("nan"), float("nan"), float("nan"))
    b, a = before.plausible.mean(axis=1), after.plausible.mean(axis=1)
    draws = 1.0 - np.sqrt(a / np.maximum(b, 1e-3 * first))
    low, high = np.quantile(draws, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    value = 1.0 - np.sqrt(second / first)
    return Share(float(value), float(min(low, value)), float(max(high, value)))
