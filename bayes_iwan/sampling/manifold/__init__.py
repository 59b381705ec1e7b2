"""Chains along the posterior's manifold."""
