"""What a record's mean force and mean displacement do: where they stand, how they drift, and what is taken off.

A displacement that drifts smears the averaged loop: each cycle lies elsewhere. So its slow path, a low polynomial of
time through the cycles' means, is taken off the record; where the mean force follows it as a spring's does, its share
is taken off the force. Friction does not mind where the stroke lies. The mean force of a whole test stays, unless the
tests contradict each other: then their deviations are the channel's, and are taken off with their scatter as error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import Loop
from bayes_iwan.campaign.loops.steadiness import cycles_of
from bayes_iwan.campaign.recording.records import Record

#: a drift is said from so many standard errors on, and only where it is this share of the amplitude or the friction
SIGMAS, CHANGES = 6.0, 0.01
#: cycles from which a path may be a cubic, and from which its own scatter says how well a line is known
CUBIC_CYCLES, LINE_CYCLES = 12, 4
#: slope of mean force over mean displacement, over the loop's own stiffness, that a spring can have
SPRING = 1.3
#: scatter of the tests' mean forces beyond a plane in log amplitude and log frequency, as a share of the friction
#: force, from which they contradict each other; and so many tests beyond the plane's numbers are needed
CONTRADICT, SPARE_TESTS = 0.05, 3


@dataclass(frozen=True)
class Drift:
    """Slow change of a record's means over its kept cycles.

    path_mm : (n,) slow path of the displacement on the record's samples, of mean zero over the kept cycles
    displacement_mm, force_N : change of the means over the kept cycles, and the standard error of that
    slope_N_mm, slope_error : of mean force over mean displacement, 0 and inf where the displacement does not drift
    """

    path_mm: Array
    displacement_mm: tuple[float, float]
    force_N: tuple[float, float]
    slope_N_mm: float
    slope_error: float


def drift_of(loop: Loop, line_mm: float = 0.0) -> Drift | None:
    """How the means of a loop's cycles drift, with a straight drift that was taken off before; None with too few cycles
    to tell."""
    few = loop.n_cycles < LINE_CYCLES
    if few and loop.cut.late:
        return None
    each, time = cycles_of(loop), loop.record.time_s
    degree = 3 if loop.n_cycles >= CUBIC_CYCLES else 1
    centre, half = 0.5 * (each.time_s[0] + each.time_s[-1]), 0.5 * (each.time_s[-1] - each.time_s[0])
    basis = np.polynomial.legendre.legvander((each.time_s - centre) / half, degree)
    line = line_mm * (each.time_s - centre) / (time[-1] - time[0])
    (u, u_error), (f, f_error) = (_fitted(basis, x) for x in (each.mean_mm + line, each.force_mean_N))
    if few:  # a line passes through two or three means: how far the cycles differ otherwise says how well it is known
        apart = [x[:, 1:] - x[:, 1:].mean(axis=0) for x in (each.displacement_shapes, each.force_shapes)]
        u_error, f_error = (float(np.sqrt(np.mean(x**2) * 3.0 / (len(x) - 1))) for x in apart)
    at = np.clip((time - centre) / half, -1.0, 1.0)
    beyond = (time - centre) / half - at
    path = np.polynomial.legendre.legval(at, np.r_[0.0, u[1:]])
    ends = np.polynomial.legendre.legval(np.array([-1.0, 1.0]), np.polynomial.legendre.legder(np.r_[0.0, u[1:]]))
    path = path + np.where(beyond < 0, ends[0], ends[1]) * beyond
    power = float(u[1:] @ u[1:])
    slope = float(f[1:] @ u[1:]) / power if power > 0 else 0.0
    error = float(f_error / np.sqrt(power)) if power > 0 else np.inf
    moved = basis[:, 1:] @ u[1:]
    pushed = basis[:, 1:] @ f[1:]
    return Drift(path, (_largest(moved), u_error), (_largest(pushed), f_error), slope, error)


def _fitted(basis: Array, values: Array) -> tuple[Array, float]:
    """Coefficients of a path through the cycles' means, and the standard error of one of them."""
    found: Array = np.linalg.lstsq(basis, values, rcond=None)[0].astype(float)
    left = values - basis @ found
    spare = max(values.size - basis.shape[1], 1)
    return found, float(np.sqrt(left @ left / spare / values.size * 3.0))


def _largest(path: Array) -> float:
    """Change along a path: from its first to its last value, or from one extreme to the other if that is far more."""
    whole = float(path[-1] - path[0])
    span = float(np.ptp(path))
    return whole if abs(whole) > 0.5 * span else span


def friction_N(loop: Loop) -> float:
    """Friction force level of a loop: its energy over four amplitudes, at least a little of the force."""
    step = np.roll(loop.displacement_mm, -1) - np.roll(loop.displacement_mm, 1)
    energy = 0.5 * float(np.sum(loop.force_N * step))
    return max(energy / (4.0 * loop.amplitude_mm), 0.02 * float(np.std(loop.force_N)), 1e-300)


def level_record(record: Record, loop: Loop, line_mm: float) -> tuple[Record, list[str]]:
    """The record with the drift of its displacement taken off, and one line on its means and their drifts where that
    is more than noise and changes anything. line_mm : the straight drift taken off before."""
    drift = drift_of(loop, line_mm)
    if drift is None:
        return record, []
    moved, moved_error = _largest(drift.path_mm), drift.displacement_mm[1]
    drifts = abs(moved) > max(SIGMAS * moved_error, CHANGES * loop.amplitude_mm)
    friction = friction_N(loop)
    stiffness = float(np.polyfit(loop.displacement_mm, loop.force_N, 1)[0])
    pushed, pushed_error = drift.force_N
    forced = abs(pushed) > max(SIGMAS * pushed_error, CHANGES * friction)
    said, follows = [], False
    if drifts:
        time, slope = record.time_s, drift.slope_N_mm
        line = line_mm * (time - 0.5 * (time[0] + time[-1])) / (time[-1] - time[0])
        record = replace(record, displacement_mm=record.displacement_mm - (drift.path_mm - line))
        follows = forced and SIGMAS * drift.slope_error < slope < SPRING * stiffness
        if follows:
            # the mean displacement is no datum either: what the spring makes of it goes with it
            record = replace(record, force_N=record.force_N - slope * (drift.path_mm + loop.offset_mm))
        said.append(
            f"the mean displacement drifts by {moved:+.3g} mm ({abs(moved) / loop.amplitude_mm:.0%} of the amplitude), "
            + (
                f"and the mean force follows by {slope:.3g} N/mm as a spring does: the specimen moved. Both drifts are "
                "taken off"
                if follows
                else "and the mean force does not follow it as a spring would: the displacement channel drifts, or the "
                "specimen creeps without a spring; this record does not tell. The drift is taken off"
            )
        )
    if forced and not follows:
        said.append(
            f"the mean force drifts by {pushed:+.3g} N ({abs(pushed) / friction:.1%} of the friction force): the force "
            "channel's zero, or a load that relaxes; this record does not tell. It stays in; `diagnose` searches for it"
        )
    return record, said


def level_means(records: Sequence[Record], loops: Sequence[Loop]) -> tuple[Record, ...]:
    """Records whose mean forces contradict each other with their deviations from the median taken off; others as they
    are. What amplitude, frequency and stated conditions explain is no contradiction."""
    mean = np.array([x.harmonics_N[0].real for x in loops])
    level = float(np.median([friction_N(x) for x in loops]))
    stated = [k for k in loops[0].extras if all(k in x.extras for x in loops)]
    columns = [np.ones(len(loops)), np.log([x.amplitude_mm for x in loops])]
    columns += [np.log([x.frequency_hz for x in loops])] if loops[0].record.clock else []
    columns += [np.array([x.extras[k] for x in loops]) for k in stated]
    kept = [columns[0], *(c for c in columns[1:] if np.ptp(c) > 0.05 * max(float(np.abs(c).max()), 1e-300))]
    spare = len(loops) - len(kept)
    if spare < SPARE_TESTS:
        return tuple(records)
    basis = np.column_stack(kept)
    left = mean - basis @ np.linalg.lstsq(basis, mean, rcond=None)[0]
    scatter = float(np.sqrt(left @ left / spare))
    noise = float(np.sqrt(np.mean([x.noise_N[0] ** 2 for x in loops])))
    if scatter <= max(SIGMAS * noise, CONTRADICT * level):
        return tuple(records)
    off = mean - np.median(mean)
    error = float(np.std(off, ddof=1))
    explains = "amplitude and frequency do" if loops[0].record.clock else "amplitude does"
    return tuple(
        replace(
            r,
            force_N=r.force_N - d,
            mean_force_error_N=error,
            warnings=(
                *r.warnings,
                f"mean force {m:.4g} N ({m / level:+.0%} of the friction force): {f'{d:+.3g} N' if d else 'nothing'} "
                f"of it is taken off, for the tests' means differ by {np.ptp(mean):.3g} N in a way that {explains} not "
                "explain (the force channel's zero, a preload, or a mid-position)",
            ),
        )
        for r, m, d in zip(records, mean, off)
    )
