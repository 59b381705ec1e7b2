"""How many points of a loop follow its motion: more where it reverses more often than twice a cycle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_iwan.arrays import Array

#: points of a loop that reverses twice, and the most that any is given (a model costs as much as its points)
POINTS, MOST_POINTS = 128, 512
#: a reversal counts where the displacement goes back by more than this share of the amplitude
LEAST_WAY = 0.01


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


def points_for(displacements: Sequence[Array]) -> int:
    """Points that loops with these displacements (samples,) should have: POINTS for two reversals a cycle, in doublings
    as many for each reversal, MOST_POINTS at most.

    With 128 points a motion of six reversals (a third harmonic of 60 %) gives forces off by 0.03 to 0.7 %, with 512
    by 0.003 to 0.04 % (analyses/loop_points.py).
    """
    each = POINTS // 2
    most, points = max(reversals(u) for u in displacements), POINTS
    while points < min(each * most, MOST_POINTS):
        points *= 2
    return points
