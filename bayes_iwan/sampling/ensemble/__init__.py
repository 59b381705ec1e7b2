"""Ensembles of walkers, and their moves."""
