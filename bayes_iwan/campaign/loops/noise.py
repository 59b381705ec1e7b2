"""The noise of a periodic measurement's harmonics, from the frequencies beside these."""

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import spherical_jn

from bayes_iwan.arrays import Array

LONG_RECORD = 500_000  # samples
#: from here on a loop's steady change along the record can be distinguished from noise, and any slow one
SOME_CYCLES, MANY_CYCLES = 6, 12
LOG_VARIANCE = np.pi**2 / 6  # of the logarithm of an exponential variable
STEEPEST = 2.0  # typical slope of a noise power spectrum


def harmonic_noise(residual: Array, n_cycles: int, n_harmonics: int, trends: int = 0) -> Array:
    """(n_harmonics + 1,) standard error of the real (= imaginary) part of each harmonic.

    Noise between the harmonics stands for noise at them: `residual`, (n_kept,) in sample order over `n_cycles`
    whole cycles, is Fourier transformed, the bin of every harmonic omitted (where there are enough others, those
    beside it too, in which slow changes of the loop live), and a power law fitted to the logarithms of the powers half
    a harmonic to either side, or as far as 12 bins reach. The mean's error comes from the five slowest bins. What
    :func:`_without_trends` took of the noise in taking off `trends` of the loop's slow changes is given back.
    """
    used = _transformed(residual.size)
    power = np.abs(np.fft.rfft(residual[:used]) * (2.0 / used)) ** 2 / 2  # estimates var(Re c) = var(Im c)
    power *= used / residual.size
    log_power = np.log(np.maximum(power, 1e-300)) + np.euler_gamma  # E of the log of a unit exponential is -gamma
    at = np.arange(power.size) / (n_cycles * used / residual.size)  # in harmonics
    many = n_cycles >= MANY_CYCLES
    bins = np.abs(at - np.rint(at)) * n_cycles
    usable = np.flatnonzero(bins > (2.5 if many else 0.5))
    at_used, log_used = at[usable], log_power[usable] - np.log(_left(bins[usable], trends))
    half_width = max(0.5, 6.0 / max(n_cycles - (5 if many else 1), 1))
    h = np.arange(1, n_harmonics + 1)
    first, last = np.searchsorted(at_used, [h - half_width, h + half_width])
    x, y = np.log(at_used), log_used
    # sums over each window of 1, x, y, x x, x y: a straight line in log-log, its slope held near 0 by a prior
    n, sx, sy, sxx, sxy = (_over_windows(terms, first, last) for terms in (np.ones_like(x), x, y, x * x, x * y))
    slope = (sxy - sx * sy / n) / (sxx - sx * sx / n + LOG_VARIANCE / STEEPEST**2)
    level = sy / n + slope * (np.log(h) - sx / n)
    below = slice(1, 1 + min(5, max(n_cycles - 1, 1)))  # the first harmonic
    slowest = log_power[below] - np.log(_left(bins[below], min(trends, 1)))  # no more than a line is off the mean
    return np.exp(np.concatenate([[np.mean(slowest) - np.log(2)], level]) / 2)


def _left(bins: Array, trends: int) -> Array:
    """Share of white noise so many bins from a harmonic that is left when Legendre polynomials of orders 1 to `trends`
    times that harmonic are taken off a record; their spectra are spherical Bessel functions."""
    return 1.0 - sum((2 * n + 1) * spherical_jn(n, np.pi * bins) ** 2 for n in range(1, trends + 1))


def _transformed(n: int) -> int:
    """How many of n samples are Fourier transformed: of a long record's a few are omitted at the end, since a length
    with a large prime factor takes five times the memory."""
    while n > LONG_RECORD and next_fast_len(n, real=True) != n:
        n -= 1
    return n


def _over_windows(terms: Array, first: np.ndarray, last: np.ndarray) -> Array:
    sums = np.concatenate([np.zeros(1), np.cumsum(terms)])
    return sums[last] - sums[first]
