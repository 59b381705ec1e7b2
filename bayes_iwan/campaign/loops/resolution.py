"""How finely a loop is followed: by its points, more where it reverses more than twice a cycle or has sharp corners,
and by the steps in which its channels were recorded."""

from collections.abc import Sequence

import numpy as np

from bayes_iwan.arrays import Array

#: points of a loop that reverses twice, and the most that any is given (a model costs as much as its points)
POINTS, MOST_POINTS = 128, 512
#: a reversal counts where the displacement goes back by more than this share of the amplitude
LEAST_WAY = 0.01
#: between two points the speed may be off its chord by this share of the largest speed
OFF_CHORD = 0.01
FEW_LEVELS = 500  # over a channel's range: fewer are said
LATTICE = 0.03  # of a step that values may be off its multiples
MOST = 0.9  # of the samples: as many of one kind are no chance


def reversals(displacement: Array) -> int:
    """Reversals a cycle of a periodic displacement (samples,): where it goes back by LEAST_WAY of its amplitude."""
    least = LEAST_WAY * 0.5 * float(np.ptp(displacement))
    start = int(np.argmin(displacement))
    count, way, extreme = 0, 1.0, float(displacement[start])
    for x in np.roll(displacement, -start)[1:]:
        if way * (x - extreme) > 0.0:
            extreme = float(x)
        elif way * (extreme - x) > least:
            count, way, extreme = count + 1, -way, float(x)
    return count + (way < 0.0)


def points_for(displacements: Sequence[Array], velocities: Sequence[Array]) -> int:
    """Points that loops with these displacements and velocities (samples,) should have, MOST_POINTS at most: POINTS for
    two reversals a cycle, in doublings as many for each reversal, and until speeds follow their chords (OFF_CHORD).
    What more points bring is measured in analyses/loop_points.py."""
    each = POINTS // 2
    most, points = max(reversals(u) for u in displacements), POINTS
    while points < min(each * most, MOST_POINTS):
        points *= 2
    while points < MOST_POINTS and any(off_chord(v) * (len(v) / points) ** 2 > OFF_CHORD for v in velocities):
        points *= 2
    return points


def off_chord(velocity: Array) -> float:
    """How far a periodic velocity (samples,) is off its chords between samples, at most, over the largest."""
    change = np.roll(velocity, 1) - 2.0 * velocity + np.roll(velocity, -1)
    return float(np.max(np.abs(change)) / 8.0 / np.max(np.abs(velocity)))


def coarse_steps(values: Array, channel: str, unit: str) -> tuple[str, ...]:
    """A word where a channel (n,) moves in steps so coarse that they cost something.

    Samples that hardly repeat are no steps, nor is a steady speed, by which each is a step from the one before.
    """
    levels = np.unique(values)
    gaps = np.diff(levels)
    span = float(np.ptp(levels))
    if levels.size < 3 or levels.size > MOST * values.size:
        return ()
    step = float(gaps[gaps > 1e-9 * span].min())
    off, moved = (levels - levels[0]) / step, np.rint(np.abs(np.diff(values)) / step)
    even = np.abs(off - np.rint(off)) < LATTICE
    if span > FEW_LEVELS * step or not even.mean() > MOST or np.mean(moved == np.median(moved)) > MOST:
        return ()
    share = step / np.sqrt(12) / float(np.std(values))
    return (
        f"the {channel} moves in steps of {step:.4g} {unit}, {span / step:.0f} over its range: each sample is off by "
        f"up to half a step ({share:.2g} of the signal, RMS), which averaging takes out only where noise is larger "
        "than a step. Raise the gain, or narrow the range, and record again",
    )
