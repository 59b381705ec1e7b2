"""Independent truth for the physics tests, in plain numpy and scipy, and numbers to try."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special, stats

from bayes_iwan.models import Reference, paper_parameters


def jenkins(u, alpha, k, phi, limited, runin=(), asymmetry=0.0):
    """Friction force by the update rule of one Jenkins element, on nodes φ; between nodes e(φ) is taken as linear.

    phi, limited : (nodes,), increasing from 0, and E[min(Φ, φ)] there. ∫ e φ̃ dφ = ∫ e' S dφ gives the weights, so
    the only error is at the few kinks of e(φ), of second order in the spacing.
    """
    x = np.zeros(phi.size)
    weight = np.diff(limited) / np.diff(phi)
    force = []
    for step, i in enumerate([*runin, *range(len(u))]):
        limit = alpha[i] / k[i] * phi
        e = np.clip(u[i] - x, -limit * (1.0 - asymmetry), limit * (1.0 + asymmetry))
        x = u[i] - e
        if step >= len(runin):
            force.append(k[i] * np.sum(weight * np.diff(e)))
    return np.array(force)


def with_turning_points(u, alpha, k, closed=False):
    """The same motion with the vertices of its parabolas put in, and which entries are the samples themselves.

    u of the vertex by Lagrange's polynomial; α/k linear on the vertex's own side, and no less than half the sample's.
    """
    ratio, n = alpha / k, len(u)
    rows = []
    for i in range(n):
        rows.append((i, u[i], ratio[i], k[i], True))
        if not closed and i in (0, n - 1):
            continue
        low, high = (i - 1) % n, (i + 1) % n
        if (u[i] - u[low]) * (u[i] - u[high]) > 0.0:
            a, b, _ = np.polyfit([-1.0, 0.0, 1.0], [u[low] - u[i], 0.0, u[high] - u[i]], 2)
            at = -b / (2.0 * a)
            if abs(at) > 1e-14:
                along = ratio[low] if at > 0 else ratio[high]
                normal = max(ratio[i] + abs(at) * (ratio[i] - along), ratio[i] * (1.0 - abs(at)))
                rows.append((i + at, u[i] - b**2 / (4.0 * a), normal, k[i], False))
    _, u, ratio, k, sample = (np.array(column) for column in zip(*sorted(rows)))
    return u, ratio * k, k, sample


def jenkins_samples(u, alpha, k, phi, limited, closed=False, asymmetry=0.0):
    """:func:`jenkins` over the motion with its turning points, at the samples; twice around if closed."""
    *series, sample = with_turning_points(u, alpha, k, closed)
    return jenkins(*series, phi, limited, range(len(sample)) if closed else (), asymmetry)[sample]


def gamma_limited(t, eta, g, phi):
    """E[min(Φ, φ)] of a gamma mixture by scipy's incomplete gamma functions; phi (n,)."""
    t, eta, g = (np.asarray(a, float)[:, None] for a in (t, eta, g))
    x = phi / t
    return np.sum(g * t * (x * special.gammaincc(eta, x) + eta * special.gammainc(eta + 1.0, x)), axis=0)


def limited_by_sum(survival, phi):
    """E[min(Φ, φ)] by summing a survival function finely; phi (n,) increasing from 0."""
    fine = np.unique(np.r_[phi, np.linspace(0.0, phi[-1], 400001)])
    s = survival(fine)
    total = np.r_[0.0, np.cumsum(0.5 * (s[1:] + s[:-1]) * np.diff(fine))]
    return total[np.searchsorted(fine, phi)]


def columns(**parameter_values):
    """Numbers as arrays (draws,)."""
    return {name: np.atleast_1d(np.asarray(value, float)) for name, value in parameter_values.items()}


def gamma_values(t, eta, g):
    """Names of :class:`Gammas` from arrays (draws, components)."""
    return {
        f"{name}{i + 1}{unit}": np.ascontiguousarray(np.atleast_2d(values)[:, i], dtype=float)
        for name, unit, values in (("t", "_N", t), ("eta", "", eta), ("g", "", g))
        for i in range(np.shape(np.atleast_2d(values))[1])
    }


#: by family, numbers of one draw and the same distribution from scipy
FAMILY_CASES = {
    "gamma1": (gamma_values([[0.6]], [[2.0]], [[1.0]]), stats.gamma(2.0, scale=0.6).sf),
    "gamma2": (
        gamma_values([[0.2, 0.1]], [[0.5, 30.0]], [[0.3, 0.7]]),
        lambda f: 0.3 * stats.gamma(0.5, scale=0.2).sf(f) + 0.7 * stats.gamma(30.0, scale=0.1).sf(f),
    ),
    "gamma3": (
        gamma_values([[0.24, 0.36, 0.5]], [[0.95, 5.1, 4.4]], [[0.41, 0.53, 0.06]]),
        lambda f: (
            0.41 * stats.gamma(0.95, scale=0.24).sf(f)
            + 0.53 * stats.gamma(5.1, scale=0.36).sf(f)
            + 0.06 * stats.gamma(4.4, scale=0.5).sf(f)
        ),
    ),
    "uniform": (columns(slip_mean_N=1.2, slip_width=0.7), stats.uniform(1.2 * 0.3, 1.2 * 1.4).sf),
    "gaussian": (columns(slip_centre_N=1.0, slip_sd_N=0.6), stats.truncnorm(-1.0 / 0.6, np.inf, 1.0, 0.6).sf),
    "power_law": (
        columns(slip_max_N=2.0, slip_chi=-0.4, slip_end_share=0.2),
        lambda f: np.where(f < 2.0, 1.0 - 0.8 * np.minimum(f / 2.0, 1.0) ** 0.6, 0.0),
    ),
}


def wild_motion(rng, samples, kind):
    """Displacements (samples,), mm, that no test would impose: jumps, repeated values, walks on a grid."""
    n = np.arange(samples)
    return [
        lambda: 0.25 * np.cumsum(rng.integers(-2, 3, samples)),
        lambda: 0.2 * np.cumsum(rng.standard_normal(samples)),
        lambda: rng.standard_normal(samples),
        lambda: np.round(2.0 * np.sin(0.07 * n) * np.exp(-n / 150), 1),
        lambda: np.repeat(rng.standard_normal(samples // 5 + 1), 5)[:samples],
        lambda: rng.uniform(0.1, 3.0) * np.sin(2 * np.pi * n / rng.integers(16, 100)),
    ][kind]()


def wild_factor(rng, samples, kind):
    """Positive factors (samples,) around one for α or k: constant, walking, jumping, waving."""
    n = np.arange(samples)
    return [
        lambda: np.ones(samples),
        lambda: np.exp(0.1 * np.cumsum(rng.standard_normal(samples)) * np.exp(-2.0 * n / samples)),
        lambda: np.exp(0.7 * rng.standard_normal(samples)),
        lambda: np.where(rng.random(samples) < 0.1, rng.uniform(0.05, 5.0, samples), 1.0),
        lambda: 1.2 + np.sin(n * rng.uniform(0.02, 0.5)),
        lambda: np.repeat(rng.uniform(0.05, 4.0, samples // 7 + 1), 7)[:samples],
    ][kind]()


def table_1(reference: Reference, draws: int = 1, spread: float = 0.0, seed: int = 0):
    """Table 1 of the paper as numbers (draws,), each but the weights scattered by exp(spread·normal)."""
    rng = np.random.default_rng(seed)
    parameter_values = paper_parameters.table_1(reference)
    out = {}
    for name, value in parameter_values.items():
        scatter = 0.0 if name in ("g1", "g2", "g3") else spread
        out[name] = value * np.exp(scatter * rng.standard_normal(draws))
    return out


@pytest.fixture(scope="session")
def truth():
    return SimpleNamespace(
        jenkins=jenkins_samples,
        gamma_limited=gamma_limited,
        limited_by_sum=limited_by_sum,
        columns=columns,
        gamma_values=gamma_values,
        family_cases=FAMILY_CASES,
        wild_motion=wild_motion,
        wild_factor=wild_factor,
        table_1=table_1,
    )


@pytest.fixture(scope="session")
def reference():
    return Reference(length_mm=1.0, speed_m_s=2e-3 * np.pi * 20.0)
