"""How many points of a loop follow its motion: more where it reverses more than twice a cycle, or has sharp corners."""

from collections.abc import Sequence

import numpy as np

from bayes_iwan.arrays import Array

#: points of a loop that reverses twice, and the most that any is given (a model costs as much as its points)
POINTS, MOST_POINTS = 128, 512
#: a reversal counts where the displacement goes back by more than this share of the amplitude
LEAST_WAY = 0.01
#: between two points the speed may be off its chord by this share of the largest speed
OFF_CHORD = 0.01


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
    while points < MOST_POINTS and max(off_chord(v) * (len(v) / points) ** 2 for v in velocities) > OFF_CHORD:
        points *= 2
    return points


def off_chord(velocity: Array) -> float:
    """How far a periodic velocity (samples,) is off its chords between samples, at most, over the largest."""
    change = np.roll(velocity, 1) - 2.0 * velocity + np.roll(velocity, -1)
    return float(np.max(np.abs(change)) / 8.0 / np.max(np.abs(velocity)))
