"""Proposals for emcee that advance several independent ensembles in one batch call.

emcee's own moves split the walkers into halves and ask for one log-probability batch a half. The moves here do
the same inside each of several equal blocks of walkers, and put the blocks' proposals into one call: a
batch function that is only fast on a hundred rows and more then stays fast. A walker's proposal is made from
its own block alone, so ensembles are independent chains; with `ensembles=1` they are ordinary emcee moves.

Every proposal returns ln[q(x | x') / q(x' | x)] for x -> x', which emcee calls the factor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.ensemble.proposal import Places, Proposal


class BlockMove(Move):
    """A red-blue move inside each of equal blocks of walkers: `ensembles` blocks on each of the rungs `powers`.

    A rung's walkers leave the target's power in balance; only those of power 1 draw from the target. A rung of less
    power lets walkers out of places that they cannot leave by themselves: after each step walkers of neighbouring
    rungs of one ensemble change places, with the probability that keeps both rungs in balance (Geyer 1991).

    Subclasses give `get_proposal(s, c, random)` with s (blocks, n, ndim) the walkers to move and c (blocks, m, ndim)
    the rest of their own blocks (none with a single split), and return proposals shaped like s and factors
    (blocks, n). Walkers b·w … (b+1)·w - 1 of emcee's state are block b = rung·ensembles + ensemble; the state's
    log_prob is the target's own on every rung.
    """

    def __init__(self, ensembles: int = 1, nsplits: int = 2, powers: tuple[float, ...] = (1.0,)) -> None:
        if ensembles < 1 or nsplits < 1:
            raise ValueError(f"need at least 1 ensemble and 1 split, not {ensembles} and {nsplits}")
        self.ensembles = ensembles
        self.nsplits = nsplits
        self.powers = powers

    def get_proposal(self, s: Array, c: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        raise NotImplementedError

    def propose(self, model: Any, state: State) -> tuple[State, NDArray[np.bool_]]:
        """One step of every walker, as emcee's samplers call it."""
        total, ndim = state.coords.shape
        blocks = self.ensembles * len(self.powers)
        walkers, rest = divmod(total, blocks)
        if rest or walkers < self.nsplits:
            raise ValueError(f"{total} walkers cannot be split into {blocks} equal blocks")
        power = np.repeat(self.powers, self.ensembles * walkers)
        order = np.arange(total).reshape(blocks, walkers)
        if self.nsplits > 1:  # a fresh split each step, each block its own
            order = order[:, :1] + model.random.random_sample((blocks, walkers)).argsort(axis=1)
        accepted = np.zeros(total, dtype=bool)
        for part in np.array_split(np.arange(walkers), self.nsplits):
            active = order[:, part]
            others = np.delete(order, part, axis=1)
            q, factors = self.get_proposal(state.coords[active], state.coords[others], model.random)
            log_prob, _ = model.compute_log_prob_fn(q.reshape(-1, ndim))
            chosen = active.ravel()
            with np.errstate(invalid="ignore"):  # -inf - (-inf): not accepted
                log_ratio = factors.ravel() + power[chosen] * (log_prob - state.log_prob[chosen])
            take = np.log(model.random.random_sample(len(chosen))) < log_ratio
            state.coords[chosen[take]] = q.reshape(-1, ndim)[take]
            state.log_prob[chosen[take]] = log_prob[take]
            accepted[chosen] = take
        if len(self.powers) > 1:
            self._exchange(state, walkers, model.random)
        return state, accepted

    def _exchange(self, state: State, walkers: int, random: np.random.RandomState) -> None:
        """Walkers of neighbouring rungs of an ensemble, paired at random, change places or do not."""
        at = np.arange(len(state.coords)).reshape(len(self.powers), self.ensembles, walkers)
        for rung in range(len(self.powers) - 1):
            mates = random.random_sample((self.ensembles, walkers)).argsort(axis=1)
            one, other = at[rung].ravel(), np.take_along_axis(at[rung + 1], mates, axis=1).ravel()
            gain = (self.powers[rung] - self.powers[rung + 1]) * (state.log_prob[other] - state.log_prob[one])
            take = np.log(random.random_sample(len(one))) < gain
            one, other = one[take], other[take]
            for array in (state.coords, state.log_prob):
                array[one], array[other] = array[other], array[one]


class StretchMove(BlockMove):
    """Goodman & Weare's stretch move (2010), as emcee has it, in blocks."""

    def __init__(self, a: float = 2.0, ensembles: int = 1, powers: tuple[float, ...] = (1.0,)) -> None:
        super().__init__(ensembles, powers=powers)
        self.a = a

    def get_proposal(self, s: Array, c: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        e, n, ndim = s.shape
        z = ((self.a - 1.0) * random.random_sample((e, n)) + 1.0) ** 2 / self.a
        anchor = np.take_along_axis(c, random.randint(c.shape[1], size=(e, n))[..., None], axis=1)
        return anchor + (s - anchor) * z[..., None], (ndim - 1.0) * np.log(z)


class DifferentialEvolutionMove(BlockMove):
    """Differential evolution (ter Braak 2006): a walker moves along the difference of two others.

    The step is 2.38/sqrt(2 ndim) times the difference, times a factor that is log-uniform on [shortest, 1] to
    serve curved targets; with probability `jump` it is the whole difference, which leads from mode to mode.
    Both are symmetric, so the factor is 0.
    """

    def __init__(
        self, jump: float = 0.1, shortest: float = 0.3, ensembles: int = 1, powers: tuple[float, ...] = (1.0,)
    ) -> None:
        super().__init__(ensembles, powers=powers)
        self.jump = jump
        self.shortest = shortest

    def get_proposal(self, s: Array, c: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        e, n, ndim = s.shape
        m = c.shape[1]
        first = random.randint(m, size=(e, n))
        second = (first + 1 + random.randint(m - 1, size=(e, n))) % m  # never the same walker twice
        gamma = 2.38 / np.sqrt(2 * ndim) * self.shortest ** random.random_sample((e, n))
        gamma = np.where(random.random_sample((e, n)) < self.jump, 1.0, gamma)
        difference = np.take_along_axis(c, first[..., None], axis=1) - np.take_along_axis(c, second[..., None], axis=1)
        noise = 1e-6 * random.standard_normal((e, n, ndim)) * np.abs(difference)
        return s + gamma[..., None] * difference + noise, np.zeros((e, n))


class SnookerMove(BlockMove):
    """Differential evolution along the line to another walker (ter Braak & Vrugt 2008), with its right factor.

    With z, z1, z2 three different other walkers and e the unit vector from z to x, x' = x + gamma·e·(e·(z1 - z2)).
    Moving along a line through z with a symmetric step in the distance to z needs the Jacobian of polar
    coordinates about z: the factor is (ndim - 1)·ln(|x' - z| / |x - z|). emcee 3.1.6's `DESnookerMove` scales
    by the square root of the distance, not by the distance, and halves that factor: it samples another
    distribution.
    """

    def __init__(self, gamma: float = 1.7, ensembles: int = 1, powers: tuple[float, ...] = (1.0,)) -> None:
        super().__init__(ensembles, powers=powers)
        self.gamma = gamma

    def get_proposal(self, s: Array, c: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        e, n, ndim = s.shape
        m = c.shape[1]
        three = random.random_sample((e, n, m)).argpartition(2, axis=2)[..., :3]
        z, z1, z2 = (np.take_along_axis(c, three[..., k, None], axis=1) for k in range(3))
        away = s - z
        distance = np.linalg.norm(away, axis=2)
        unit = away / np.maximum(distance, 1e-300)[..., None]
        step = self.gamma * np.einsum("end,end->en", unit, z1 - z2)
        q = s + unit * step[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):  # nan where x = z, which has no line: not accepted
            factor = (ndim - 1.0) * (np.log(np.abs(distance + step)) - np.log(distance))
        return q, factor


class MixtureMove(BlockMove):
    """Proposals that keep a mixture g fixed, so that only the ratio target/g decides: factor ln g(x) - ln g(x').

    g must have been fitted before the draws that count, and stays as it is. Two kinds, one chosen for each
    walker and step:

    - with probability `independent`: x' is a fresh draw from g (an independence proposal).
    - otherwise a Crank–Nicolson step inside one component (after Grumitt et al. 2022, there for a single t):
      the component k is drawn from its responsibility for x, the t's scale s from its distribution given x and k,
      and x' = mu + sqrt(1 - rho²)·(x - mu) + rho·L·xi / sqrt(s). Each of these leaves w_k·t_k(x) in balance,
      and so their sum leaves g. rho is drawn from `rho` for each walker; steps shorter than 1 are accepted
      where g and the target differ much, fresh draws are best where they do not.
    """

    def __init__(
        self,
        proposal: Proposal,
        independent: float = 0.5,
        rho: tuple[float, ...] = (0.2, 0.4, 0.8),
        ensembles: int = 1,
        powers: tuple[float, ...] = (1.0,),
    ) -> None:
        super().__init__(ensembles, nsplits=1, powers=powers)  # needs no other walker: all move in one call
        self.proposal = proposal
        self._seen: tuple[Places, Places] | None = None  # where the walkers were, and what was proposed to them
        self.independent = independent
        self.rho = np.asarray(rho, dtype=float)

    def get_proposal(self, s: Array, c: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        now = self._places(s.reshape(-1, s.shape[-1]))
        new, factor = self.proposal.step(now, self.independent, self.rho, random)
        self._seen = now, new
        return new.z.reshape(s.shape), factor.reshape(s.shape[:-1])

    def _places(self, z: Array) -> Places:
        """What the proposal says of z (n, ndim); most walkers stand where they were, or took what was proposed last.

        Charts are half the cost of a step, so what is known of these is not worked out again.
        """
        if self._seen is None or self._seen[0].z.shape != z.shape:
            return self.proposal.at(z)
        now, new = self._seen
        now.put(np.flatnonzero((new.z == z).all(axis=1)), new)
        moved = np.flatnonzero((now.z != z).any(axis=1))
        if len(moved):
            now.put(moved, self.proposal.at(z[moved]))
        return now
