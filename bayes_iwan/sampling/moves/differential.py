"""Differential evolution with steps of many lengths."""

import numpy as np
from emcee.moves.red_blue import RedBlueMove

from bayes_iwan.arrays import Array


class DifferentialMove(RedBlueMove):  # type: ignore[misc]
    """A walker moves along the difference of two others (ter Braak, Stat. Comput. 16, 2006, 239).

    For any user of emcee: like `emcee.moves.DEMove`, but the step's length is log-uniform between `shortest` times the
    usual one and the usual one, which serves curved posteriors; a share `whole` of steps is the whole difference, which
    leads from mode to mode.
    """

    independent = False

    def __init__(self, shortest: float = 0.1, whole: float = 0.1, **kwargs: object) -> None:
        super().__init__(nsplits=2, **kwargs)
        self.shortest, self.whole = shortest, whole

    def get_proposal(self, s: Array, c: list[Array], random: np.random.RandomState) -> tuple[Array, Array]:
        """New places of s (n, ndim) by the others c, and the logarithm of the proposals' ratio (n,), zero."""
        others = np.concatenate(c, axis=0)
        n, ndim = s.shape
        first = random.randint(len(others), size=n)
        second = (first + random.randint(1, len(others), size=n)) % len(others)
        length = 2.38 / np.sqrt(2.0 * ndim) * np.exp(np.log(self.shortest) * random.random_sample(n))
        length = np.where(random.random_sample(n) < self.whole, 1.0, length)
        jitter = 1e-5 * random.standard_normal(s.shape)
        return s + length[:, None] * (others[first] - others[second]) + jitter, np.zeros(n)
