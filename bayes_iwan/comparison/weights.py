"""Importance weights: whether they may be trusted."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.special import logsumexp

from bayes_iwan.arrays import Array

#: Pareto's k below which importance weights may be trusted
TRUSTED = 0.7


def smoothed_log_weights(log_w: Array) -> tuple[Array, Array]:
    """ArviZ's Pareto-smoothed log weights (…, n), their exponentials summing to one, and Pareto's k (…,).

    Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, J. Machine Learning Research 25 (2024).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ announces on import what it will change
        try:
            from arviz import psislw
        except ImportError:  # from 1.0: of log-likelihoods, so of the negated weights
            from arviz_stats.base import array_stats

            smoothed, k = array_stats.psislw(-log_w)
        else:
            smoothed, k = psislw(log_w)
    return np.asarray(smoothed) - logsumexp(smoothed, axis=-1, keepdims=True), np.asarray(k, dtype=float)
