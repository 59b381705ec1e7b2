"""Moves for emcee, one a file; each can be given to any `emcee.EnsembleSampler`."""

from bayes_iwan.sampling.moves.differential import DifferentialMove
from bayes_iwan.sampling.moves.manifold import ManifoldMove
from bayes_iwan.sampling.moves.nested import NestedMove
from bayes_iwan.sampling.moves.snooker import SnookerMove

__all__ = ["DifferentialMove", "ManifoldMove", "NestedMove", "SnookerMove"]
