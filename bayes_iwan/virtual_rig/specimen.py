"""Specimens for the virtual rig: sliders one by one, a normal force, a contact stiffness.

Part of the virtual rig, which shares no code with `bayes_iwan.models`: what the rig makes must be a fair
independent check of the model that is fitted to it. The specimens follow the paper's physics (Fig. 6, Eqs. (10)–(12))
but never exactly: slip forces need not be gamma-distributed, sliders differ in stiffness, the stiffness law and the
normal force have slightly other shapes.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array
from bayes_iwan.errors import InputError
from bayes_iwan.screen import Named, on_screen


class RigError(InputError):
    """A virtual test that cannot be run as asked; the message names the value and the fix."""


@dataclass(frozen=True)
@on_screen
class Specimen:
    """A rope spring: a parallel spring and individual Jenkins elements under a varying normal force.

    The element i carries `k(α)·stiffness_share[i]·(u − x_i)`, at most `α·slip_share_N[i]`. The normal force is
    α(u, u̇) = 1 + kn·(y^β − A^β) + λ·kn·y^β·|u̇|·(A − u)/y with y = √((A − u)² + (tip·A)²): Eq. (11) with its
    corner at u = A rounded. The contact stiffness is k(α) = k1·(1 − exp(−r·α^p))/(1 − exp(−r)): Eq. (12) for
    p = 1 with r = k_i/k_u.

    Attributes: `parallel_N_mm` (kp), `contact_N_mm` (k1 = k(1)), `curve` (r), `curve_power` (p), `kn_1_mm`,
    `beta`, `lambda_s_m`, `tip`, `stiffness_share` (n,) summing to 1, `slip_share_N` (n,) whose sum is the whole
    slip force at α = 1, `family` (the slip forces' distribution).
    """

    parallel_N_mm: float
    contact_N_mm: float
    curve: float
    curve_power: float
    kn_1_mm: float
    beta: float
    lambda_s_m: float
    tip: float
    stiffness_share: Array
    slip_share_N: Array
    family: str

    def coarse(self, n_sliders: int) -> Specimen:
        """The same specimen with neighbouring sliders lumped into `n_sliders` (for trial runs)."""
        n = self.slip_share_N.size
        if n <= n_sliders:
            return self
        order = np.argsort(self.slip_share_N / self.stiffness_share)
        groups = np.array_split(order, n_sliders)
        share = np.array([self.stiffness_share[g].sum() for g in groups])
        slip = np.array([self.slip_share_N[g].sum() for g in groups])
        return replace(self, stiffness_share=share, slip_share_N=slip)

    def scaled(self, stiffness: float) -> Specimen:
        """The same specimen with both springs multiplied by `stiffness` (a remount, a warm rope)."""
        return replace(self, parallel_N_mm=stiffness * self.parallel_N_mm, contact_N_mm=stiffness * self.contact_N_mm)

    def summary(self) -> dict[str, object]:
        """What a truth file says of it; the slip forces as deciles of φ (N, at rest, per unit share)."""
        out: dict[str, object] = {k: v for k, v in asdict(self).items() if np.isscalar(v)}
        per_share = self.slip_share_N / self.stiffness_share
        out["slip_force_N"] = float(self.slip_share_N.sum())
        out["slip_deciles_N"] = [round(float(q), 6) for q in np.quantile(per_share, np.linspace(0, 1, 11))]
        out["n_sliders"] = int(self.slip_share_N.size)
        return Named(out)


def _quantiles(n: int, rng: np.random.Generator | None) -> Array:
    jitter = 0.5 if rng is None else rng.uniform(0.1, 0.9, n)
    return (np.arange(n) + jitter) / n


def paper_specimen(n_sliders: int = 300, seed: int | None = None) -> Specimen:
    """The specimen of the paper's Table 1: three gammas, k(1) = 14.45 N/mm, slip force 1.199 N.

    With a `seed` its sliders differ in stiffness by 8 % and are not evenly spread, as a real one's would.
    """
    rng = None if seed is None else np.random.default_rng(seed)
    t, eta, g = (0.24, 0.36, 0.50), (0.95, 5.1, 4.4), (0.41, 0.53, 0.06)
    grid = np.linspace(0.0, 12.0, 24001)
    cdf = np.sum([w * stats.gamma.cdf(grid, e, scale=s) for s, e, w in zip(t, eta, g)], axis=0)
    slip = np.interp(_quantiles(n_sliders, rng), cdf / cdf[-1], grid)
    spread = np.ones(n_sliders) if rng is None else np.exp(0.08 * rng.standard_normal(n_sliders))
    ku, ki = 30.37, 19.62
    return Specimen(
        parallel_N_mm=5.49,
        contact_N_mm=ku * (1 - np.exp(-ki / ku)),
        curve=ki / ku,
        curve_power=1.0,
        kn_1_mm=1.79,
        beta=0.0062,
        lambda_s_m=1.58,
        tip=0.01,
        stiffness_share=spread / spread.sum(),
        slip_share_N=slip / n_sliders,
        family="gamma mixture",
    )


def _draw_slip_forces(rng: np.random.Generator, p: Array) -> tuple[str, Array]:
    """Slip forces at the probabilities `p` from a family drawn at random; mean not yet set."""
    kind = rng.choice(["lognormal", "weibull", "bimodal", "power law", "gamma mixture", "uniform", "half normal"])
    if kind == "lognormal":
        return kind, stats.lognorm.ppf(p, rng.uniform(0.35, 0.9))
    if kind == "weibull":
        return kind, stats.weibull_min.ppf(p, rng.uniform(0.9, 3.0))
    if kind == "power law":  # φ^(−s) between two ends, as Iwan densities with a singular origin
        s, low = rng.uniform(0.1, 0.8), rng.uniform(0.01, 0.1)
        return kind, (low ** (1 - s) + p * (1 - low ** (1 - s))) ** (1 / (1 - s))
    if kind == "uniform":
        low = rng.uniform(0.0, 0.3)
        return kind, low + (1 - low) * p
    if kind == "half normal":
        return kind, stats.halfnorm.ppf(p)
    grid = np.linspace(0.0, 14.0, 28001)
    if kind == "bimodal":
        share, ratio = rng.uniform(0.25, 0.75), rng.uniform(2.5, 6.0)
        first = stats.lognorm.cdf(grid, rng.uniform(0.2, 0.5), scale=1.0 / ratio)
        cdf = share * first + (1 - share) * stats.lognorm.cdf(grid, rng.uniform(0.15, 0.35), scale=1.0)
    else:
        weights = rng.dirichlet((2.0, 3.0, 1.0))
        t = np.array([0.24, 0.36, 0.50]) * np.exp(0.2 * rng.standard_normal(3))
        eta = np.array([0.95, 5.1, 4.4]) * np.exp(0.2 * rng.standard_normal(3))
        cdf = np.sum([w * stats.gamma.cdf(grid, e, scale=s) for w, e, s in zip(weights, eta, t)], axis=0)
    return kind, np.interp(p, cdf / cdf[-1], grid)


def draw_specimen(
    rng: np.random.Generator, amplitudes_mm: tuple[float, float], speed_m_s: float, n_sliders: int = 150
) -> Specimen:
    """A specimen at random around Table 1, whose friction shows at the amplitudes it will be tested at.

    Parameters: `amplitudes_mm`, the smallest and the largest; `speed_m_s`, the largest peak speed of the
    campaign, from which λ is set so that the normal force stays within about 0.45 and 1.8 of its value at rest.
    """
    smallest, largest = amplitudes_mm
    contact = float(rng.uniform(8.0, 25.0))
    ceiling = min(3.0, 1.5 * contact * smallest, 0.45 * contact * largest)  # most sliders slip at the largest
    mean_slip = float(np.exp(rng.uniform(np.log(0.4), np.log(max(ceiling, 0.41)))))
    family, slip = _draw_slip_forces(rng, _quantiles(n_sliders, rng))
    slip = slip * (mean_slip / slip.mean())
    spread = np.exp(rng.uniform(0.03, 0.15) * rng.standard_normal(n_sliders))
    if rng.random() < 0.5:  # the corner that Table 1 sits in: only kn·β and λ·kn matter
        beta = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
        kn = float(rng.uniform(0.004, 0.03)) / beta
        pull = kn * largest**beta
    else:
        beta = float(rng.uniform(0.1, 1.5))
        pull = float(rng.uniform(0.05, 0.45)) / max(2**beta - 1.0, 1.0)
        kn = pull / largest**beta
    rate = float(rng.uniform(0.03, 0.30))  # rise of α at the largest speed
    return Specimen(
        parallel_N_mm=float(rng.uniform(3.0, 9.0)),
        contact_N_mm=contact,
        curve=float(rng.uniform(0.3, 1.3)),
        curve_power=float(rng.uniform(0.88, 1.12)),
        kn_1_mm=kn,
        beta=beta,
        lambda_s_m=rate / (pull * speed_m_s),
        tip=float(rng.uniform(0.008, 0.02)),
        stiffness_share=spread / spread.sum(),
        slip_share_N=slip / n_sliders,
        family=family,
    )
