"""How far a predicted loop is from a measured one: the weighted loop error of Eqs. (8) and (9), and its scales.

Residual = measured − predicted force, everywhere.
"""

from collections.abc import Sequence

import numpy as np
from scipy import fft

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.loops.drift import friction_N


def paper_weights(displacement_mm: Array, amplitude_mm: Array) -> Array:
    """w of Eq. (9), 0.2 + √(1 − (u/A)²), as printed; displacement (tests, samples), amplitude (tests,)."""
    x = displacement_mm / np.asarray(amplitude_mm)[:, None]
    return 0.2 + np.sqrt(np.maximum(1.0 - x * x, 0.0))


def goal_function(residual_N: Array, displacement_mm: Array, amplitude_mm: Array) -> Array:
    """Eq. (8) summed over tests, 1/(A n) Σ w |r|, N/mm.

    residual_N : (draws, tests, samples). Returns (draws,).
    Minimising it is maximum likelihood for independent Laplace errors of weighted scale.
    """
    w = paper_weights(displacement_mm, amplitude_mm) / np.asarray(amplitude_mm)[:, None]
    return np.einsum("dts,ts->d", np.abs(residual_N), w) / residual_N.shape[2]


def friction_level_N(loops: Sequence[Loop]) -> Array:
    """Each loop's friction force level, dissipated energy / (4 amplitude), (tests,) in N, from the data alone."""
    return np.array([friction_N(x) for x in loops])


def friction_rms_N(model_N: Array, loops: Sequence[Loop]) -> Array:
    """(tests,) what "% of the friction force" is a share of: RMS of a fitted model's friction force (tests, samples),
    but at least each loop's own level, for a model that does not fit may have next to none."""
    return np.maximum(np.sqrt(np.mean(model_N**2, axis=-1)), friction_level_N(loops))


def beyond_noise_N2(residual_N2: Array, noise_N2: Array) -> Array:
    """(tests,) squared gap: mean square residual less its expected noise, N², which may be negative for a test. Over
    all tests no more noise than there is residual: what varies within the blocks of a record, as a drift does, counts
    as noise of their means, and must not eat the gap of the loops."""
    return residual_N2 - noise_N2 * min(1.0, float(residual_N2.sum()) / max(float(noise_N2.sum()), 1e-300))


def harmonics_of(force_N: Array, count: int) -> Array:
    """c_h, h < count, with force = Re Σ c_h e^{2πih·phase}; force (…, samples) on a uniform phase grid from 0."""
    c = fft.rfft(force_N, axis=-1)[..., :count] * (2.0 / force_N.shape[-1])
    c[..., 0] *= 0.5
    return c


def resolved(force_N: Array, loops: Sequence[Loop]) -> Array:
    """Forces (…, tests, samples) without harmonics that the loops' sampling cannot resolve."""
    there = np.isfinite(np.stack([x.noise_N for x in loops]))
    return np.fft.irfft(np.fft.rfft(force_N, axis=-1)[..., : there.shape[1]] * there, n=force_N.shape[-1], axis=-1)
