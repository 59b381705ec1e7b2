"""The snooker move with the right Jacobian."""

import numpy as np
from emcee.moves.red_blue import RedBlueMove

from bayes_iwan.arrays import Array


class SnookerMove(RedBlueMove):  # type: ignore[misc]
    """A walker moves along the line to another one, by the projected difference of two more (ter Braak & Vrugt, Stat.
    Comput. 18, 2008, 435).

    For any user of emcee: `emcee.moves.DESnookerMove` of 3.1.6 divides by the root of the line's length and halves the
    exponent, so that a unit normal of 16 dimensions comes out with a variance of 0.57; this one is right.

    gamma : factor of the projected difference.
    """

    independent = False

    def __init__(self, gamma: float = 1.7, **kwargs: object) -> None:
        super().__init__(nsplits=2, **kwargs)
        self.gamma = gamma

    def get_proposal(self, s: Array, c: list[Array], random: np.random.RandomState) -> tuple[Array, Array]:
        """New places of s (n, ndim) by the others c, and the logarithm of the proposals' ratio (n,)."""
        others = np.concatenate(c, axis=0)
        chosen = np.argsort(random.random_sample((len(s), len(others))), axis=1)[:, :3]
        at, one, two = (others[chosen[:, k]] for k in range(3))
        line = s - at
        length = np.linalg.norm(line, axis=1)
        unit = line / length[:, None]
        step = self.gamma * np.sum(unit * (one - two), axis=1)
        new = s + step[:, None] * unit
        with np.errstate(divide="ignore"):
            factor = (s.shape[1] - 1.0) * (np.log(np.linalg.norm(new - at, axis=1)) - np.log(length))
        return new, factor
