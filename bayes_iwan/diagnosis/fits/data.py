"""What a diagnosis uses: averaged loops, their change along the record, and the lines of the mains.

Three kinds of data come from each test, all linear in the recorded force and with measured standard errors:
the harmonics of the averaged loop; contrasts between blocks of cycles, which a steady model predicts to be zero;
and the amplitude at 50 and 60 Hz of what averaging leaves of the record, where these are no harmonics of the test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.loops.noise import MANY_CYCLES, harmonic_noise
from bayes_iwan.diagnosis.constants import LINE_STANDS, TREND_FLOOR
from bayes_iwan.diagnosis.fits.data_layout import Layout
from bayes_iwan.diagnosis.fits.discrepancy_size import Between
from bayes_iwan.effects.along_record import RAMPS
from bayes_iwan.inference.setup.discrepancy import Correlated
from bayes_iwan.inference.setup.loop_error import friction_level_N, harmonics_of
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import Motion
from bayes_iwan.models.motion import motion_of
from bayes_iwan.screen import on_screen

MAINS_HZ = (50.0, 60.0)
#: harmonics whose change along the record is looked at
TREND_HARMONICS = 7
#: the mains' frequency is sought within this of 50 and 60 Hz
MAINS_WANDER = 0.4
#: nearer to a harmonic than this, in cycles over the record, the loops' own slow change leaks into a line, and as much
#: beyond the harmonic: there a line counts that stands out from that
LEAK = 4.0
#: from record to record the mains' frequency wanders by so much (sd, Hz; large grids are held within 0.05 Hz)
WANDERS_BY = 0.06
#: share of mains interference that averaging must leave before it says anything
LEAST_LEFT = 0.05


@dataclass(frozen=True)
@on_screen
class GapData:
    """Data of the fitted tests (T of them).

    harmonics_N : (T, H + 1) complex, of the averaged loops; their noise is in `likelihood`.
    trend_N, trend_noise_N : (T, K, TREND_HARMONICS + 1), contrasts between blocks; noise inf where there is none.
    contrast : (T, K, B) the weights of the contrasts over the blocks (rows orthonormal, summing to zero).
    mains_hz : (T, 2) the mains' frequencies in each record (they wander), nominal unless a line near says better.
    mains_possible : (2,) does a line stand in a record that can show it, or is there no such record?
    mains_N, mains_noise_N : (T, 2) complex c + i s of c·cos + s·sin at 50 and 60 Hz; noise inf where it says nothing.
    """

    loops: tuple[Loop, ...]
    likelihood: Correlated
    level_N: Array
    harmonics_N: np.ndarray
    trend_N: np.ndarray
    trend_noise_N: Array
    contrast: Array
    mains_N: np.ndarray
    mains_noise_N: Array
    mains_hz: Array
    mains_possible: tuple[bool, ...]
    steady_motion: Motion
    block_motion: Motion

    @property
    def tests(self) -> int:
        return len(self.loops)

    @property
    def blocks(self) -> int:
        """Blocks of cycles into which the record of most cycles is divided."""
        return most_blocks(self.loops)

    @cached_property
    def longest_s(self) -> float:
        """Duration of the longest record."""
        return float(self.durations_s.max())

    @cached_property
    def durations_s(self) -> Array:
        """(T,) duration of each record."""
        return np.array([float(np.ptp(x.record.time_s)) for x in self.loops])

    @cached_property
    def subharmonic(self) -> Array:
        """(T,) power of a line at half each test's frequency over its local background; about 1 without one."""
        return np.array([_subharmonic(x) for x in self.loops])

    @cached_property
    def not_repeating(self) -> float:
        """RMS over the tests of :func:`_not_repeating_N`, over the friction level."""
        return float(
            np.sqrt(np.mean([(_not_repeating_N(x) / level) ** 2 for x, level in zip(self.loops, self.level_N)]))
        )

    @cached_property
    def ramps(self) -> np.ndarray:
        """(RAMPS, T, blocks, H + 1) harmonics of (t/longest_s)^p, t from each record's start, by block of cycles."""
        power = np.arange(RAMPS)[:, None]
        return self.folded(lambda t, time_s: ((time_s - time_s[0]) / self.longest_s) ** power)

    @cached_property
    def mains_waves(self) -> np.ndarray:
        """(2 mains, 2, 2, T, blocks, H + 1): cosine and sine (third axis) at once and thrice the mains' frequency."""

        def waves(t: int, time_s: Array) -> Array:
            turn = 2.0 * np.pi * self.mains_hz[t][:, None, None] * np.array([1.0, 3.0])[:, None] * time_s
            return np.stack([np.cos(turn), np.sin(turn)], axis=2).reshape(8, -1)

        out = self.folded(waves)
        return out.reshape(2, 2, 2, *out.shape[1:])

    def folded(self, signals: Callable[[int, Array], Array]) -> np.ndarray:
        """(k, T, blocks, H + 1) signals on each record's samples averaged as its force was; zero where a test has fewer
        blocks. signals(t, time_s) : k signals of test t at the times of its record, (k, samples)."""
        parts = []
        for t, loop in enumerate(self.loops):
            part = loop.averager.solve(signals(t, loop.record.time_s))[:, :-1]
            parts.append(np.pad(part, ((0, 0), (0, self.blocks - part.shape[1]), (0, 0))))
        return np.stack(parts, axis=1)

    def layout(self, between: Between, evolving: bool) -> Layout:
        """How these data lie in the rows of a steady model, or of one that changes along the record."""
        if (between, evolving) not in self._layouts:
            self._layouts[between, evolving] = Layout(self, between, evolving)
        return self._layouts[between, evolving]

    @cached_property
    def _layouts(self) -> dict[tuple[Between, bool], Layout]:
        return {}

    def part(self, which: Sequence[int]) -> GapData:
        """The data of some of the tests."""
        loops, at = tuple(self.loops[t] for t in which), list(which)
        blocks = most_blocks(loops)
        few = slice(0, max(blocks - 1, 0))
        return GapData(
            loops,
            Correlated(loops),
            self.level_N[at],
            self.harmonics_N[at],
            self.trend_N[at, few],
            self.trend_noise_N[at, few],
            self.contrast[at, few, :blocks],
            self.mains_N[at],
            self.mains_noise_N[at],
            self.mains_hz[at],
            self.mains_possible,
            motion_of(loops),
            motion_of(loops, blocks=True),
        )


def most_blocks(loops: Sequence[Loop]) -> int:
    """Blocks of cycles of the loop that has most of them."""
    return max(len(x.block_cycle) for x in loops)


def gap_data(loops: Sequence[Loop]) -> GapData:
    """Data from the loops to be fitted (the caller leaves held-out ones away)."""
    loops = tuple(loops)
    blocks = most_blocks(loops)
    level = friction_level_N(loops)
    contrast = np.zeros((len(loops), max(blocks - 1, 0), blocks))
    trend = np.zeros((len(loops), max(blocks - 1, 0), TREND_HARMONICS + 1), dtype=complex)
    noise = np.full(trend.shape, np.inf)
    for t, loop in enumerate(loops):
        b = len(loop.block_cycle)
        if b < 2:
            continue
        c = _contrasts(loop.block_cycle)
        contrast[t, : b - 1, :b] = c
        n = min(TREND_HARMONICS, loop.block_harmonics_N.shape[1] - 1) + 1
        trend[t, : b - 1, :n] = c @ loop.block_harmonics_N[:, :n]
        sd = np.sqrt((c * c) @ np.where(np.isfinite(loop.block_noise_N[:, :n]), loop.block_noise_N[:, :n], 1e300) ** 2)
        noise[t, : b - 1, :n] = np.hypot(sd, TREND_FLOOR * level[t])
    found = [_mains_frequencies(loops, hz) for hz in MAINS_HZ]
    mains_hz, possible = np.stack([hz for hz, _ in found], axis=1), tuple(there for _, there in found)
    lines = [[_line(loop, hz) for hz in own] for loop, own in zip(loops, mains_hz)]
    return GapData(
        loops,
        Correlated(loops),
        level,
        np.stack([x.harmonics_N for x in loops]),
        trend,
        noise,
        contrast,
        np.array([[value for value, _ in some] for some in lines]),
        np.array([[noise for _, noise in some] for some in lines]),
        mains_hz,
        possible,
        motion_of(loops),
        motion_of(loops, blocks=True),
    )


def _contrasts(cycle: Array) -> Array:
    """(B − 1, B) orthonormal polynomials in the block's cycle number, without the constant: trend first."""
    x = (cycle - cycle.mean()) / np.ptp(cycle)
    q, r = np.linalg.qr(np.vander(x, len(x), increasing=True))
    return (q * np.sign(np.diagonal(r)))[:, 1:].T


def _mains_frequencies(loops: Sequence[Loop], nominal: float) -> tuple[Array, bool]:
    """(T,) the mains' frequency in each record, nominal where no record shows a line; and whether there may be one:
    it stands in a record, or none of them can show it.

    A record with a harmonic close by hides the line in its averaged loop, and shows it as a harmonic that turns: there
    the frequency is the likeliest one near the others'.
    """
    found = np.array([_mains_frequency(loop, nominal) for loop in loops])
    seen = np.flatnonzero(np.isfinite(found))
    if not len(seen):
        return np.full(len(loops), nominal), not any(_shows_mains(loop, nominal) for loop in loops)
    centre = float(np.median(found[seen]))
    typical = float(np.median([abs(_line(loops[int(t)], found[t])[0]) for t in seen]))
    return np.array(
        [hz if np.isfinite(hz) else _turning(loop, centre, typical) for loop, hz in zip(loops, found)]
    ), True


def _turning(loop: Loop, centre: float, typical_N: float) -> float:
    """The mains' frequency, near `centre`, that best explains what averaging leaves of a record near a harmonic; the
    line's amplitude is about `typical_N`, else a nearly fixed phase would ask for any. `centre` where it says nothing.
    """
    time, order = loop.record.time_s, round(centre / loop.frequency_hz)
    noise = loop.noise_N[order] if order < len(loop.noise_N) else np.inf
    if not np.isfinite(noise):
        return centre
    remaining = loop.left_over(loop.record.force_N)
    white = 0.5 * noise**2 * len(remaining)  # variance a sample that makes this error of a harmonic
    trial = centre + WANDERS_BY * np.linspace(-3.0, 3.0, 61)
    log_p = np.empty(len(trial))
    for i, hz in enumerate(trial):
        turn = 2.0 * np.pi * hz * time
        g = np.stack([loop.left_over(np.cos(turn)), loop.left_over(np.sin(turn))]) * typical_N
        precision = g @ g.T / white + np.eye(2)
        b = g @ remaining / white
        log_p[i] = 0.5 * (b @ np.linalg.solve(precision, b) - np.linalg.slogdet(precision)[1])
    return float(trial[np.argmax(log_p - 0.5 * ((trial - centre) / WANDERS_BY) ** 2)])


def _shows_mains(loop: Loop, nominal: float) -> bool:
    """Is the mains' frequency sampled, and away from every harmonic, where it is averaged into the loop?"""
    ratio = nominal / loop.frequency_hz
    return bool(nominal <= 0.45 / np.median(np.diff(loop.record.time_s)) and abs(ratio - round(ratio)) >= 0.1)


def _mains_frequency(loop: Loop, nominal: float) -> float:
    """Where a line stands within MAINS_WANDER of the nominal frequency in one record; NaN if none does."""
    if not _shows_mains(loop, nominal):
        return np.nan
    time = loop.record.time_s[loop.averager.index]
    trial = nominal + np.linspace(-MAINS_WANDER, MAINS_WANDER, 101)
    remaining = loop.left_over(loop.record.force_N)
    power = np.abs(np.exp(-2j * np.pi * trial[:, None] * time) @ remaining) ** 2 / (
        len(time) * np.var(remaining) + 1e-300
    )
    best = int(np.argmax(power))
    if power[best] < LINE_STANDS or best in (0, len(trial) - 1):
        return np.nan
    before, at, after = power[best - 1 : best + 2]  # the peak is much wider than the grid: a parabola
    return float(trial[best] + 0.5 * (trial[1] - trial[0]) * (before - after) / (before - 2.0 * at + after))


def _line(loop: Loop, hz: float) -> tuple[complex, float]:
    """Amplitude c + i s at a frequency in what averaging leaves of the record, and its standard error from the
    neighbouring frequencies (median, so that a line beside does not count)."""
    time = loop.record.time_s
    harmonic_hz = round(hz / loop.frequency_hz) * loop.frequency_hz
    away = abs(hz - harmonic_hz) / loop.frequency_hz * loop.n_cycles  # in cycles over the record; one is resolved
    if hz > 0.45 / np.median(np.diff(time)) or away < 1.0:
        return 0.0, np.inf
    remaining = loop.left_over(loop.record.force_N)

    def fitted(f: float) -> tuple[complex, float]:
        g = np.stack([loop.left_over(np.cos(2.0 * np.pi * f * time)), loop.left_over(np.sin(2.0 * np.pi * f * time))])
        gram = g @ g.T
        kept = float(np.linalg.eigvalsh(gram)[0]) / (0.5 * len(remaining))
        if kept < LEAST_LEFT:
            return 0.0, kept
        c, s = np.linalg.solve(gram, g @ remaining)
        return complex(c, s), kept

    value, kept = fitted(hz)
    if kept < LEAST_LEFT:
        return 0.0, np.inf
    span = time[loop.averager.index[-1]] - time[loop.averager.index[0]]
    beside = [fitted(hz + k / span) for k in (-9.3, -7.7, -6.2, -4.6, 4.6, 6.2, 7.7, 9.3)]
    power = np.median([abs(v) ** 2 for v, share in beside if share >= LEAST_LEFT] or [np.inf])
    if away < LEAK:
        power = max(power, abs(fitted(2.0 * harmonic_hz - hz)[0]) ** 2)
        if abs(value) ** 2 < LINE_STANDS * power:
            return 0.0, np.inf
    return value, float(np.sqrt(0.5 * power / np.log(2.0) / max(kept, LEAST_LEFT)))


def _subharmonic(loop: Loop) -> float:
    """Power of a line at half the test's frequency over its local background: every second cycle differs."""
    value, noise = _line(loop, 0.5 * loop.frequency_hz)
    return float(abs(value) ** 2 / (2.0 * noise**2)) if np.isfinite(noise) and noise > 0.0 else 0.0


def _not_repeating_N(loop: Loop) -> float:
    """RMS by which the force of one cycle differs from the mean of all, trends taken off: in the harmonics whose change
    along the record is looked at, beyond white noise and what the displacement's own differences make. 0 of a record
    that is too short to tell it from a trend."""
    if loop.n_cycles < MANY_CYCLES:
        return 0.0
    of_displacement = harmonic_noise(loop.left_over(loop.record.displacement_mm), loop.n_cycles, len(loop.noise_N) - 1)
    # what sticks is stiffer than the whole loop
    stiffness = 2.0 * np.std(loop.force_N) / np.std(loop.displacement_mm)
    power = _beyond_white(loop.noise_N) - stiffness**2 * _beyond_white(of_displacement)
    return float(np.sqrt(loop.n_cycles * np.maximum(power, 0.0)))


def _beyond_white(noise: Array) -> float:
    """Power of the noise of the first harmonics beyond that of the highest third of all; 0 where none is known."""
    known = noise[np.isfinite(noise)]
    if len(known) == 0:
        return 0.0
    white = np.median(known[2 * len(known) // 3 :] ** 2)
    first = known[1 : TREND_HARMONICS + 1] ** 2
    return float(np.sum(np.maximum(first - white, 0.0)))


def predicted(data: GapData, problem: Problem, z: Array) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Harmonics (draws, T, H + 1), trends (draws, T, K, TREND_HARMONICS + 1) and mains lines (draws, T, 2) of a model;
    trends and lines None where no effect of the model makes any."""
    parameter_values = problem.parameter_values(z)
    evolving = [e for e in problem.effects if e.evolving]
    count = data.harmonics_N.shape[1]
    if not evolving:
        return harmonics_of(problem.force(parameter_values, data.steady_motion), count), None, None
    draws, blocks = len(z), data.contrast.shape[2]
    cycling = any(e.stages for e in evolving)
    by_block = np.zeros((draws, data.tests, blocks, count), dtype=complex)
    mean = np.zeros((draws, data.tests, count), dtype=complex)
    if cycling:
        flat = harmonics_of(problem.force(parameter_values, data.block_motion), count)
        for t in range(data.tests):
            mine = data.block_motion.test == t
            by_block[:, t, : mine.sum()] = flat[:, mine]
            mean[:, t] = flat[:, mine].mean(axis=1)
    else:
        mean = harmonics_of(problem.force(parameter_values, data.steady_motion), count)
        by_block += mean[:, :, None]
    lines = None
    for effect in evolving:
        added = effect.recorded(data, parameter_values)
        if added is not None:
            by_block += added
            for t, loop in enumerate(data.loops):
                mean[:, t] += added[:, t, : len(loop.block_cycle)].mean(axis=1)
        line = effect.lines(data, parameter_values)
        lines = line if lines is None else (lines if line is None else lines + line)
    trend = np.einsum("tkb,dtbh->dtkh", data.contrast, by_block[..., : TREND_HARMONICS + 1])
    return mean, trend, lines
