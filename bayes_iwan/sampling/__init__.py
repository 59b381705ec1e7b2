"""Sampling with emcee: moves, the run, convergence."""
