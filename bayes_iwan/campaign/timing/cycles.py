"""Where the cycles of a record are: crossings, run-in, and the phase of every sample.

Nothing here trusts the nominal frequency. Cycles run from one upward crossing of the middle of the
displacement to the next, found with hysteresis so that noise cannot make two crossings of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError
from bayes_iwan.campaign.timing.harmonics import evaluate, fit, inverse_grams, project, white_noise
from bayes_iwan.campaign.timing.period import period_marks, short_period, whole_period
from bayes_iwan.screen import on_screen

MOST_HARMONICS = 50  # of a loop
HYSTERESIS = 0.25  # of the amplitude: far above any usable noise, well inside any motion
AT_END = 1.5  # steps that a crossing may lie beyond the first or last sample: a record cut at its crossings
FEW_CROSSINGS = 12  # with more, a cycle at either end is not overlooked, and may hold the drive's start or stop
LONG_GAP = 0.1  # of a cycle: a longer hole in the record costs the cycle it falls in
RUN_IN_SHARE = 0.01  # of the loop's RMS: differences below this are never taken for run-in
RUN_IN_SIGMAS = 6.0
RUN_IN_JUMP = 2.5  # a first loop that moves this much more than the next ones is run-in; fade is smoother
WHOLE_RUN_IN = 4  # cycles from which a first one that is off is omitted whole
NEAR_TURN = 0.01  # of the stroke: nearer to its end the displacement has turned
BETTER_PHASE = (0.8, 0.98)  # a free phase must shrink the residual RMS of displacement and force to these


@dataclass(frozen=True)
@on_screen
class Cut:
    """The cycles of one record.

    phase : (n,) phase of every sample in cycles, unwrapped; integers are upward crossings. Cycle 0 is the
        first whole cycle kept.
    cycles : (n_cycles,) numbers of the whole cycles kept (a long gap leaves a hole in them).
    frequency_hz : mean frequency over the cycles kept.
    constant : True where one frequency describes all cycles, False where the phase follows each crossing.
    run_in, run_out : whole cycles omitted at the start and at the end.
    late : phase of the first cycle kept before which no sample counts, where its force still shows what was before the
        record began (standstill, another level) and there are too few cycles to omit it whole.
    gap_cycles : cycles lost to long gaps.
    """

    phase: Array
    cycles: np.ndarray
    frequency_hz: float
    constant: bool
    run_in: int
    run_out: int
    gap_cycles: int
    late: float = 0.0

    @property
    def index(self) -> np.ndarray:
        """(n_kept,) indices of the samples in the cycles kept."""
        return np.flatnonzero(np.isin(np.floor(self.phase), self.cycles) & (self.phase >= self.late))


def crossings(
    time: Array,
    signal: Array,
    middle: float,
    half_range: float,
    up: bool = True,
    hysteresis: float = HYSTERESIS,
    ends: bool = False,
) -> Array:
    """Times at which `signal` crosses `middle`, one per passage through +-hysteresis * half_range.

    ends : also a crossing at which the record was cut, of however many; of few it is always counted.

    Each time comes from a straight line fitted to the samples inside the hysteresis band.
    """
    v = (signal - middle) * (1.0 if up else -1.0)
    limit = hysteresis * half_range
    state = np.where(v > limit, 1, np.where(v < -limit, -1, 0))
    seen = np.flatnonzero(state)
    turns = np.flatnonzero((state[seen][:-1] < 0) & (state[seen][1:] > 0))
    pieces = [(seen[i], seen[i + 1] + 1) for i in turns]
    times = [_zero(time[a:b], v[a:b], 0.0) for a, b in pieces]
    if seen.size and (ends or len(times) < FEW_CROSSINGS):  # a record that was cut at a crossing
        step, final = (float(np.median(np.diff(x))) for x in (time[:9], time[-9:]))  # of a clock that levels may change
        first, last = slice(0, max(seen[0], 1) + 1), slice(min(seen[-1], time.size - 2), None)
        # one step or so from the middle, and not on a plateau where the record happens to begin or end
        if state[seen[0]] > 0 and 0 <= v[1] - v[0] >= (v[0] - limit) / AT_END:
            at = _zero(time[first], v[first], AT_END * step)
            times = [at, *times] if time[0] - AT_END * step < at <= time[0] + AT_END * step else times
        if state[seen[-1]] < 0 and 0 <= v[-1] - v[-2] >= (-v[-1] - limit) / AT_END:
            at = _zero(time[last], v[last], AT_END * final)
            times = [*times, at] if time[-1] - AT_END * final <= at < time[-1] + AT_END * final else times
    return np.array(times)


def _zero(time: Array, v: Array, beyond: float) -> float:
    """Time at which a straight line through samples (n,) is 0, within them or so much beyond."""
    t = time - time[0]
    t_mean, y_mean = t.mean(), v.mean()
    slope = np.dot(t - t_mean, v - y_mean) / np.dot(t - t_mean, t - t_mean)
    if not slope > 0:
        return float(time[0] + t_mean)
    return float(time[0] + min(max(t_mean - y_mean / slope, -beyond), t[-1] + beyond))


def cycle_shapes(phase: Array, cycles: np.ndarray, signals: Sequence[Array], n_harmonics: int) -> Array:
    """Harmonics of each cycle as rows whose Euclidean distance is an RMS, (k, n_cycles, 2 H + 1)."""
    index = np.flatnonzero(np.isin(np.floor(phase), cycles))
    phase = phase[index]
    starts = np.searchsorted(phase, cycles)
    rows = project(phase, [x[index] for x in signals], starts, n_harmonics)
    del index
    for some, inverses in inverse_grams(phase, starts, n_harmonics):
        rows[some] = inverses @ rows[some]
    rows[:, 1:] *= np.sqrt(0.5)
    return np.moveaxis(rows, -1, 0)


def _drift(rows: Array) -> Array:
    """Slope a cycle of (n_cycles, ...) rows, from all pairs half a record apart: odd cycles do not move it."""
    n = len(rows)
    if n < 6:
        return np.zeros(rows.shape[1:])
    half = n // 2
    return np.median((rows[n - half :] - rows[:half]) / (n - half), axis=0)


def _off_trend(rows: Array) -> Array:
    """Distance of each cycle from a robust straight line through all of them, shape (n_cycles,)."""
    flat = rows - np.multiply.outer(np.arange(len(rows)), _drift(rows))
    return np.linalg.norm(flat - np.median(flat, axis=0), axis=1)


def _steady(displacement: Array, force: Array | None = None) -> tuple[int, int]:
    """First and one past the last steady cycle, from per-cycle shapes (n_cycles, m).

    A cycle at either end is omitted while its displacement is off the others' (slow, straight drift
    allowed). For the force only leading cycles go: of the first tenth, those off the trend of the others; then
    those that still jump to the next cycle by far more than later cycles do among themselves. Fade and creep
    change the force over the whole record, so they widen the limits, and are kept.
    """
    off = _off_trend(displacement)
    size = np.median(np.linalg.norm(displacement[:, 1:], axis=1))
    limit = max(RUN_IN_SHARE * size, RUN_IN_SIGMAS * 1.4826 * float(np.median(off)))
    first, last = 0, len(off)
    while first < last and off[first] > limit:
        first += 1
    while last > first and off[last - 1] > limit:
        last -= 1
    if force is None:
        return first, last
    size = float(np.median(np.linalg.norm(force[:, 1:], axis=1)))
    off = _off_trend(force[first:last])
    limit = max(2 * RUN_IN_SHARE * size, RUN_IN_SIGMAS * 1.4826 * float(np.median(off)))
    early = off[: (last - first) // 10]
    first += int(np.argmin(early > limit)) if not (early > limit).all() else early.size
    jump = np.linalg.norm(np.diff(force, axis=0), axis=1)
    while last - first >= WHOLE_RUN_IN:
        later = float(np.median(jump[first + 1 : min(first + 6, last - 1)]))
        if jump[first] <= max(RUN_IN_SHARE * size, RUN_IN_JUMP * later):
            break
        first += 1
    return first, last


def _numbers(times: Array) -> np.ndarray:
    """Cycle number of each crossing: a pause or a hole of several periods counts as that many cycles."""
    steps = np.maximum(np.rint(np.diff(times) / np.median(np.diff(times))), 1).astype(int)
    return np.concatenate([[0], np.cumsum(steps)])


def phase_between(time: Array, anchors: Array, phases: Array) -> Array:
    """Phase of every sample, straight between anchors and carried on at the mean rate beyond them."""
    rate = (phases[-1] - phases[0]) / (anchors[-1] - anchors[0])
    before = phases[0] + (np.minimum(time, anchors[0]) - anchors[0]) * rate
    after = (np.maximum(time, anchors[-1]) - anchors[-1]) * rate
    return np.interp(time, anchors, phases) + (before - phases[0]) + after


def _rms_off(phase: Array, kept: np.ndarray, signal: Array, n_harmonics: int) -> float:
    index = np.flatnonzero(np.isin(np.floor(phase), kept))
    phase, signal = phase[index], signal[index]
    return float(np.std(signal - evaluate(fit(phase, signal, n_harmonics), phase)))


def cut_cycles(file: str, time_s: Array, displacement: Array, force: Array | None = None) -> Cut:
    """Find the whole, steady cycles of a record, and the phase of every sample.

    time_s, displacement : (n,); the displacement in any unit. force : (n,), tells run-in, and whether the
    crossings wander by themselves (then the force follows them) or only by the displacement's noise; without
    it the frequency is taken as constant.
    Raises CampaignError where there are fewer than two whole steady cycles.
    """
    signal, index, smooth = displacement, np.arange(time_s.size), 1
    rate = (time_s.size - 1) / (time_s[-1] - time_s[0])
    for _ in range(2):  # the second pass takes middle, drift and noise from the steady cycles alone
        low, high = np.percentile(signal[index], [0.5, 99.5])
        middle, half = (low + high) / 2, (high - low) / 2
        if not half > 0:
            raise CampaignError(f"{file}: the displacement does not move; is the right column named in [channels]?")
        level = uniform_filter1d(signal, smooth, mode="nearest")
        times = crossings(time_s, level, middle, half)
        repeats = whole_period(time_s, displacement, times)
        if times.size < 3:
            down = crossings(time_s, level, middle, half, up=False)
            repeats = short_period(time_s, displacement, times, down)
        if repeats is not None:
            times = period_marks(time_s, repeats)
        if times.size < 3:
            raise CampaignError(
                f"{file}: {max(times.size - 1, 0)} whole cycle(s) in {time_s[-1] - time_s[0]:.4g} s; at least "
                "two are needed. Record (or hold the level) for longer, or leave the test out"
            )
        numbers = _numbers(times)
        period = float(np.median(np.diff(times)))
        phase = phase_between(time_s, times, numbers.astype(float))
        per_cycle = max(period * rate, 1.0)
        cycles, holes = _whole(time_s, times, numbers, period)
        if cycles.size < 2:
            raise _too_few(file, cycles.size, 0, 0, holes)
        n_shape = int(max(1, min(6, 0.4 * per_cycle)))
        signals = [displacement] if force is None else [displacement, force]
        shapes = cycle_shapes(phase, cycles, signals, n_shape)
        first, last = _steady(*shapes)
        if last - first < 2:
            raise _too_few(file, last - first, first, cycles.size - last, holes)
        kept = cycles[first:last]
        index = np.flatnonzero(np.isin(np.floor(phase), kept))
        signal = displacement - (time_s - time_s[0]) / period * _drift(shapes[0, first:last, 0])
        smooth = 2 * int(per_cycle / 20) + 1 if white_noise(displacement) > 0.2 * HYSTERESIS * half else 1
    free_phase = _both_strokes(time_s, level, times, numbers, phase, kept, middle, half)
    n_check = int(max(1, min(24 if repeats is None else MOST_HARMONICS, 0.4 * per_cycle)))
    steady_phase, frequency = _constant(time_s, signal, times, numbers, kept, n_check)
    constant = (
        repeats is not None
        or force is None
        or not all(
            _rms_off(free_phase, kept, y, n_check) < better * _rms_off(steady_phase, kept, y, n_check)
            for y, better in zip((signal, force), BETTER_PHASE)
        )
    )
    phase = steady_phase if constant else free_phase
    if not constant:
        edges = np.interp([kept[0], kept[-1] + 1], numbers, times)
        frequency = float((kept[-1] + 1 - kept[0]) / (edges[1] - edges[0]))
    return Cut(
        phase=phase - kept[0],
        cycles=kept - kept[0],
        frequency_hz=frequency,
        constant=constant,
        run_in=first,
        run_out=int(cycles.size - last),
        gap_cycles=holes,
        late=0.0 if force is None or kept.size >= WHOLE_RUN_IN else _late(phase - kept[0], displacement, force),
    )


def _late(phase: Array, displacement: Array, force: Array) -> float:
    """Where in the first cycle (phase 0 to 1) a record's past ends: at its first turn, if the force until there is off
    the next cycle's by far more than after it; 0 where it is not."""
    first = np.flatnonzero((phase >= 0) & (phase < 1))
    u = displacement[first]
    near = NEAR_TURN * float(np.ptp(u))
    turn = first[min(int(np.argmax(u >= u.max() - near)), int(np.argmax(u <= u.min() + near)))]
    off = np.interp(phase[first] + 1, phase, force) - force[first]
    off -= np.median(off)
    before = first < turn
    if before.sum() < 2 or before.sum() > 0.75 * first.size:
        return 0.0
    early, later = (float(np.sqrt(np.mean(off[x] ** 2))) for x in (before, ~before))
    own = float(np.std(force[first]))
    return float(phase[turn]) if early > max(RUN_IN_SHARE * own, RUN_IN_JUMP * later) else 0.0


def _too_few(file: str, whole: int, run_in: int, run_out: int, holes: int) -> CampaignError:
    lost = (run_in, "run-in at the start"), (run_out, "unsteady at the end"), (holes, "lost to gaps")
    said = ", ".join(f"{n} {what}" for n, what in lost if n)
    return CampaignError(
        f"{file}: {whole} whole steady cycle(s){f' ({said})' if said else ''}; at least two are needed. Record "
        "(or hold the level) for longer, or leave the test out"
    )


def _whole(time: Array, times: Array, numbers: np.ndarray, period: float) -> tuple[np.ndarray, int]:
    """Numbers of the cycles that are one period long and have no long gap, and how many others there are."""
    steps = np.diff(time)
    bad_step = np.flatnonzero(steps > max(LONG_GAP * period, 1.5 * float(np.median(steps))))
    gap_start, gap_stop = time[bad_step], time[bad_step + 1]
    good = (np.diff(numbers) == 1) & (np.abs(np.diff(times) / period - 1) < 0.4)
    for a, b in zip(gap_start, gap_stop):
        good &= ~((times[:-1] < b) & (times[1:] > a))
    return numbers[:-1][good], int(numbers[-1] - good.sum())


def _constant(
    time: Array, signal: Array, times: Array, numbers: np.ndarray, kept: np.ndarray, n_harmonics: int
) -> tuple[Array, float]:
    """Phase of every sample for one frequency over all cycles kept, and that frequency.

    A line through the crossings starts it; Gauss-Newton steps on the frequency of a harmonic series, fitted to
    every sample, finish it.
    """
    use = np.isin(numbers, np.union1d(kept, kept + 1))
    rate, origin = np.polyfit(times[use] - times[0], numbers[use], 1)
    phase = (time - times[0]) * rate + origin
    for _ in range(4):
        index = np.flatnonzero(np.isin(np.floor(phase), kept))
        used = phase[index]
        series = fit(used, signal[index], n_harmonics)
        lever = evaluate(2j * np.pi * np.arange(series.size) * series, used)
        centre = used.mean()
        lever *= used - centre
        step = np.dot(lever, signal[index] - evaluate(series, used)) / np.dot(lever, lever)
        phase = phase + step * (phase - centre)
        rate *= 1 + step
        if abs(step) * np.ptp(used) < 1e-9:
            break
    return phase, float(rate)


def _both_strokes(
    time: Array,
    signal: Array,
    times: Array,
    numbers: np.ndarray,
    phase: Array,
    kept: np.ndarray,
    middle: float,
    half_range: float,
) -> Array:
    """`phase` changed so that the downward crossings too lie at one place in every cycle."""
    down = crossings(time, signal, middle, half_range, up=False)
    at = np.interp(down, time, phase)
    inside = np.isin(np.floor(at), kept)
    down, at = down[inside], at[inside]
    if down.size == 0:
        return phase
    place = float(np.median(at - np.floor(at)))
    anchors = np.concatenate([times, down])
    phases = np.concatenate([numbers.astype(float), np.floor(at) + place])
    order = np.argsort(anchors)
    return phase_between(time, anchors[order], phases[order])
