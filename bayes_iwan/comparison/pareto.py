"""Pareto-smoothed importance weights (Vehtari, Simpson, Gelman, Yao & Gabry, arXiv 1507.02646)."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from bayes_iwan.arrays import Array


def smooth_log_weights(log_w: Array) -> tuple[Array, float]:
    """Log weights (n,) with their largest ones replaced by a generalized Pareto's quantiles, and that law's k.

    k is NaN where the tail has too few distinct values to fit (fewer than 25 weights).
    """
    out = np.array(log_w, dtype=float)
    n = len(out)
    tail = int(min(0.2 * n, 3.0 * np.sqrt(n)))
    if tail < 5:
        return out, float("nan")
    top = float(np.max(out))
    order = np.argsort(out)
    cut = out[order[-tail - 1]]
    largest = order[-tail:]
    excess = np.exp(out[largest] - top) - np.exp(cut - top)
    if not np.isfinite(cut) or not excess[-1] > 0 or excess[tail // 4] <= 0:
        return out, float("inf") if not np.isfinite(cut) else float("nan")
    k, sigma = fit_generalized_pareto(excess)
    p = (np.arange(tail) + 0.5) / tail
    quantile = -np.log1p(-p) * sigma if abs(k) < 1e-8 else sigma * np.expm1(-k * np.log1p(-p)) / k
    out[largest] = np.minimum(np.log(np.exp(cut - top) + quantile), 0.0) + top
    return out, k


def fit_generalized_pareto(x: Array) -> tuple[float, float]:
    """k and σ of a generalized Pareto from sorted excesses x (n,), by Zhang & Stephens (2009) with the weak prior on
    k of Vehtari et al. (appendix C)."""
    n = len(x)
    count = 30 + int(np.sqrt(n))
    quarter = x[int(n / 4 + 0.5) - 1]
    b = 1.0 / x[-1] + (1.0 - np.sqrt(count / (np.arange(1, count + 1) - 0.5))) / (3.0 * quarter)
    k = np.mean(np.log1p(-b[:, None] * x), axis=1)
    profile = n * (np.log(-b / k) - k - 1.0)
    weight = np.exp(profile - logsumexp(profile))
    b_mean = float(np.sum(b * weight))
    k_mean = float(np.mean(np.log1p(-b_mean * x)))
    sigma = -k_mean / b_mean
    return (n * k_mean + 5.0) / (n + 10.0), sigma
