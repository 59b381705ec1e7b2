"""Tests of one frequency or amplitude, together."""

from collections.abc import Sequence

import numpy as np

#: tests whose frequencies (or amplitudes), in order, differ by less than this share are of one: a shaker holds an
#: amplitude within a few percent, and no test plan steps finer than a twelfth of an octave, 6 percent
SAME = 0.05


def groups_of(values: Sequence[float]) -> list[list[int]]:
    """Places of values that are the same but for what a drive does not hold, the smallest values first.

    Examples
    --------
    >>> groups_of([8.0, 20.0, 8.1])
    [[0, 2], [1]]
    """
    log = np.log(values)
    order = np.argsort(log, kind="stable")
    cuts = np.flatnonzero(np.diff(log[order]) > SAME) + 1
    return [sorted(part.tolist()) for part in np.split(order, cuts)]
