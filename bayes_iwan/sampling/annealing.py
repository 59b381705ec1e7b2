"""Walkers that are led from a wide guess to the posterior, so that they start all over it.

The guess q is a mixture of t distributions about the optima, several times as wide as the normal approximations there,
as far as the prior allows. From q the densities q^(1−β) p^β lead to the posterior p, each β as far from the last one as
half of the walkers bear: these are drawn again as often as their weights say, moves are learnt from them, and emcee
moves them by some steps (annealed importance sampling with resampling: Del Moral, Doucet & Jasra, J. R. Stat. Soc. B
68, 2006, 411). Normal approximations alone are too narrow where the posterior is a curved sheet, and know little of how
much each of its parts weighs. Parts that hold a few per cent may still get too few walkers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from bayes_iwan.arrays import Array
from bayes_iwan.sampling.blocks import Density, Moves, Places, generator
from bayes_iwan.sampling.plan import SamplingError
from bayes_iwan.sampling.proposals import COMPONENTS, Mixture, learnt_moves

#: how many times as wide as the normal approximations the guess is: these miss the broad tails of curved posteriors
_WIDE = 6.0
#: the same over draws of a posterior that is like the one sought
_WIDER = 2.0
#: step, in standard deviations, over which coordinates walked in are taken to be linear in all
_STEP = 0.1
#: share of the walkers that each step of β leaves, as their weights count; steps at each β
_LEFT, _STEPS = 0.5, 10
#: moves walkers (where they are, moves, steps, density, which β this is) and returns where they have been
Advance = Callable[[Places, Moves, int, Density, int], Places]


@dataclass(frozen=True)
class _Between:
    """q^(1−β) p^β, as `Density` takes it."""

    density: Density
    guess: Mixture
    beta: float

    def __call__(self, x: Array, random: np.random.RandomState) -> Array:
        found = self.density(x, random)
        found[:, 0] = self.beta * found[:, 0] + (1.0 - self.beta) * self.guess.log_density(x)
        return found


def guess_about(density: Density, optima: Array, roots: Array) -> Mixture:
    """q over what is walked in, from optima (k, ndim) and the roots of their covariances, (k, ndim, m) or one (ndim, m)
    for all, in coordinates whose prior's standard deviations are 1."""
    around = optima[:, None] + _STEP * np.swapaxes(roots, -1, -2)
    centres = density.apart(optima)
    roots = (density.apart(around) - centres[:, None]).transpose(0, 2, 1) / _STEP
    precision = np.linalg.inv(roots @ roots.transpose(0, 2, 1)) / _WIDE**2 + np.eye(centres.shape[1])
    return Mixture.of(np.full(len(centres), 1.0 / len(centres)), centres, np.linalg.cholesky(np.linalg.inv(precision)))


def guess_from(density: Density, known: Array, random: np.random.RandomState) -> Mixture:
    """q from draws `known` (n, ndim) of a posterior that is like the one sought."""
    about = Mixture.fitted(density.apart(known), COMPONENTS, random)
    return Mixture.of(about.weights, about.centres, _WIDER * about.roots)


def annealed(
    density: Density, guess: Mixture, count: int, seed: tuple[int, ...], advance: Advance, late: Callable[[], bool]
) -> Iterator[tuple[float, Places]]:
    """β and where the walkers (count of them) are at it, until β = 1, which comes at once where it is `late`.

    Raises SamplingError where no optimum has a finite log-probability.
    """
    random, beta, stage = generator(seed), 0.0, 0
    at = _first(density, guess, count, random)
    while beta < 1.0:
        weight = at.log_prob - guess.log_density(at.x)
        further = _next(beta, weight)
        share = np.exp((further - beta) * (weight - weight.max()))
        beta = 1.0 if late() else further
        again = np.searchsorted(np.cumsum(share), (np.arange(count) + random.random_sample()) / count * share.sum())
        at = at.some(np.minimum(again, count - 1))
        moves = learnt_moves(at.x, density.blocks, random)
        between = density if beta == 1.0 else replace(density, function=_Between(density, guess, beta))
        known = (1.0 - beta) * guess.log_density(at.x)
        at = advance(replace(at, log_prob=beta * at.log_prob + known), moves, _STEPS, between, stage)
        at = replace(at, log_prob=(at.log_prob - (1.0 - beta) * guess.log_density(at.x)) / beta)
        stage += 1
        yield beta, at


def _first(density: Density, guess: Mixture, count: int, random: np.random.RandomState) -> Places:
    """Draws of the guess; where one is impossible, nearer to an optimum."""
    each = max(1, count // len(guess.centres))  # what is drawn there may be possible or not
    tried = np.isfinite(density(np.repeat(guess.centres, each, axis=0), random)[:, 0])
    possible = np.flatnonzero(tried.reshape(-1, each).any(axis=1))
    if len(possible) == 0:
        raise SamplingError(
            f"none of the {len(guess.centres)} starts has a finite log-probability: there is nowhere to start from; "
            "check the data, the bounds and the priors"
        )
    guess = Mixture.of(
        guess.weights[possible] / guess.weights[possible].sum(), guess.centres[possible], guess.roots[possible]
    )
    x, left = guess.draw(count, random), np.arange(count)
    out = Places(x, np.zeros((count, len(density.drawn))), np.full(count, -np.inf))
    centre = guess.centres[random.randint(len(guess.centres), size=count)]
    while len(left):
        found = density(x[left], random)
        out.log_prob[left], out.drawn[left] = found[:, 0], found[:, 1:]
        left = left[~np.isfinite(found[:, 0])]
        x[left] = centre[left] + 0.7 * (x[left] - centre[left])
    return out


def _next(beta: float, weight: Array) -> float:
    """The β at which the effective share of walkers (Kong, Liu & Wong, J. Am. Stat. Assoc. 89, 1994, 278) is _LEFT,
    from weights' logarithms; 1 at most."""

    def left(to: float) -> float:
        level = (to - beta) * weight
        return float(np.exp(2.0 * logsumexp(level) - logsumexp(2.0 * level)) / len(weight) - _LEFT)

    return 1.0 if left(1.0) >= 0.0 else float(brentq(left, beta, 1.0))
