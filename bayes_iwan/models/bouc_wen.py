"""Other models for comparison: Bouc–Wen, and its generalisation to asymmetric loops.

    F = kp u + z + force zero,      dz/du = k [1 − ψ |z/Z|ⁿ],

with ψ constant while the signs of u, u̇ and z are. Wen (1976): ψ = (1 − σ) + σ sgn(u̇ z), 0.5 ≤ σ for a model that
dissipates. Song and Der Kiureghian (J. Eng. Mech. 132, 2006, 610–618):

    ψ = sgn(u̇ z) + b₂ sgn(u u̇) + b₃ sgn(u z) + b₄ sgn(u̇) + b₅ sgn(z) + b₆ sgn(u),

their β₁ being taken up by Z (:meth:`GeneralizedBoucWen.published`). Wen's model is b₃ = −b₂ = 1 − σ, b₄ = b₅ = b₆ = 0
wherever a loop goes. Neither knows of speed or of a normal force: that is the point of comparing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.models.iwan_parameters import parallel_spring
from bayes_iwan.models.kernels import sliders
from bayes_iwan.models.motion import Motion
from bayes_iwan.models.parameter import Parameter
from bayes_iwan.models.scales import Scales
from bayes_iwan.models.simulator import Derived, Modifier, Simulator, force_zero
from bayes_iwan.threads import over_draws

#: longest Runge–Kutta step, in units of the relaxation length Z/(k n |ψ|)
STEP = 0.5
#: of |z/Z|ⁿ with n < 1, which is steep at zero, the slope that bounds steps is no steeper than at this share of Z
LEAST = 1e-4
#: z is at rest on its asymptote within this share of k
SATURATED = 1e-6
#: a steady loop closes within this share of Z, or there is none
CLOSED = 1e-6

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@_jit
def _slope(z: float, k: float, size: float, n: float, psi: Array, row: int) -> float:
    ratio = abs(z) / size
    return k * (1.0 - psi[row + (1 if z > 0.0 else 0)] * (ratio * ratio if n == 2.0 else ratio**n))


@_jit
def _advance(z: float, start: float, end: float, k: float, size: float, n: float, psi: Array) -> float:
    """z after u has gone from start to end, which lie on one side of u = 0 (NaN where z runs away)."""
    du = 1.0 if end > start else -1.0
    row = (4 if start + end > 0.0 else 0) + (2 if du > 0.0 else 0)
    left = abs(end - start)
    stiff = max(abs(psi[row]), abs(psi[row + 1])) * k * n / size
    while left > 0.0:
        f = _slope(z, k, size, n, psi, row)
        ratio = abs(z) / size
        if not ratio < 1e3:
            return math.nan
        if abs(f) < SATURATED * k:
            return z
        rate = stiff * (max(ratio, LEAST) ** (n - 1.0) if ratio > 1.0 or n < 1.0 else 1.0)
        step = left if left * rate <= STEP else STEP / rate
        if z * du < 0.0 and 1e-3 < ratio and abs(z) < abs(f) * step:
            step = abs(z / f)  # |z|ⁿ has a kink at zero: end a step there
        h = du * step
        f2 = _slope(z + 0.5 * h * f, k, size, n, psi, row)
        f3 = _slope(z + 0.5 * h * f2, k, size, n, psi, row)
        f4 = _slope(z + h * f3, k, size, n, psi, row)
        z += h / 6.0 * (f + 2.0 * f2 + 2.0 * f3 + f4)
        left -= step
    return z


@_jit
def _cycle(
    z: float, last: float, at: Array, where: NDArray[np.int64], off: Array, k: float, size: float, n: float, psi: Array,
    out: Array,
) -> float:  # fmt: skip
    """z after one pass, with z at the samples in out; `last` is the displacement before the first entry."""
    for i in range(at.size):
        now = at[i]
        if last * now < 0.0:  # ψ jumps as u passes zero
            z = _advance(_advance(z, last, 0.0, k, size, n, psi), 0.0, now, k, size, n, psi)
        elif now != last:
            z = _advance(z, last, now, k, size, n, psi)
        last = now
        if off[i] == 0.0:
            out[where[i]] = z
    return z


@_jit
def _steady(
    at: Array, where: NDArray[np.int64], off: Array, k: float, size: float, n: float, psi: Array, out: Array
) -> None:
    """The closed loop into out: the fixed point of one cycle's map z → P(z), by the secant method; NaN if none.

    Small loops forget their start only over hundreds of cycles, so they are not walked one by one.
    """
    z = _cycle(0.0, 0.0, at, where, off, k, size, n, psi, out)
    other, other_gap = z, math.nan
    for _ in range(60):
        gap = _cycle(z, at[-1], at, where, off, k, size, n, psi, out) - z
        if not math.isfinite(gap):
            break
        # P grows with z and contracts: 1/(1 − P') lies between 1 and the many cycles it would take
        stretch = (z - other) / (other_gap - gap)
        known = math.isfinite(stretch)
        stretch = min(max(stretch, 1.0), 1e4) if known else 1.0
        if abs(gap) * (stretch if known else 1e2) <= CLOSED * size:
            return
        other, other_gap = z, gap
        z = min(max(z + gap * stretch, -10.0 * size), 10.0 * size)
    out[:] = math.nan


@_jit
def _loops(
    at: Array, where: NDArray[np.int64], off: Array, closed: bool, k: Array, size: Array, n: Array, psi: Array,
    out: Array,
) -> None:  # fmt: skip
    """All draws of one way: k, size (Z), n (draws,), psi (draws, 8), out (draws, samples)."""
    for d in range(k.size):
        if not (0.0 < k[d] < math.inf and 0.0 < size[d] < math.inf and 0.0 < n[d] < math.inf):
            out[d, :] = math.nan
        elif closed:
            _steady(at, where, off, k[d], size[d], n[d], psi[d], out[d])
        else:
            _cycle(0.0, 0.0, at, where, off, k[d], size[d], n[d], psi[d], out[d])


def _signs() -> tuple[Array, Array, Array]:
    """sgn u, sgn u̇, sgn z of the eight entries of ψ."""
    u, du, z = (np.array([-1.0, 1.0])[(np.arange(8) >> bit) & 1] for bit in (2, 1, 0))
    return u, du, z


def _hysteresis(shape: Array, parameter_values: ParameterValues, motion: Motion) -> Array:
    """z, (draws, loops, samples)."""
    out = np.empty((len(shape), motion.loops, motion.samples))
    k, size, n = (
        np.ascontiguousarray(parameter_values[name], dtype=float) for name in ("bw_k_N_mm", "bw_force_N", "bw_n")
    )
    u = np.ascontiguousarray(motion.displacement_mm)

    def some_draws(part: slice) -> None:
        each = [part] if u.shape[0] == 1 else [slice(d, d + 1) for d in range(part.start, min(part.stop, len(shape)))]
        for draws in each:
            for j in range(motion.loops):
                one = 0 if u.shape[0] == 1 else draws.start
                way = sliders.way(u[one, j], motion.slope_mm[one, j], motion.periodic)
                z = np.empty((len(k[draws]), motion.samples))
                _loops(*way, motion.periodic, k[draws], size[draws], n[draws], shape[draws], z)
                out[draws, j] = z

    over_draws(some_draws, len(shape), 20 * motion.loops * motion.samples)
    return out


class _Hysteretic(Simulator):
    """Parallel spring and hysteretic force; subclasses say what makes the latter's ψ."""

    def shape(self, parameter_values: ParameterValues) -> Array:
        """ψ by phase, (draws, 8); the phase is 4 (u > 0) + 2 (u̇ > 0) + (z > 0)."""
        raise NotImplementedError

    def parameters(self, scales: Scales) -> tuple[Parameter, ...]:
        stiffness = stats.lognorm(s=1.0, scale=scales.stiff_N_mm)
        force = stats.lognorm(s=0.8, scale=1.2 * scales.slip_N)
        return (
            *(parallel_spring(scales), force_zero(scales)),
            Parameter("bw_k_N_mm", "k", "N/mm", "initial stiffness of the hysteretic part", stiffness),
            Parameter("bw_force_N", "Z", "N", "ultimate force of the hysteretic part", force),
            Parameter("bw_n", "n", "-", "sharpness of the knee", stats.lognorm(s=0.7, scale=1.0), 0.1, 10.0),
        )

    def friction_force(
        self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()
    ) -> Array:
        """z in N, (draws, loops, samples)."""
        return _hysteresis(self.shape(parameter_values), parameter_values, motion)

    def force(self, parameter_values: ParameterValues, motion: Motion, effects: Sequence[Modifier] = ()) -> Array:
        """Force in N, (draws, loops, samples); NaN where the model has no steady loop."""
        spring = parameter_values["kp_N_mm"][:, None, None] * motion.displacement_mm
        return self.friction_force(parameter_values, motion) + spring


@dataclass(frozen=True)
class BoucWen(_Hysteretic):
    """Wen's model: initial stiffness k, ultimate force Z, exponent n and share σ of the hysteretic part."""

    name = "bouc_wen"

    def parameters(self, scales: Scales) -> tuple[Parameter, ...]:
        share = Parameter("bw_share", "σ", "-", "share of Wen's dissipative term", stats.uniform(0.5, 1.0))
        return (*super().parameters(scales), share)

    def shape(self, parameter_values: ParameterValues) -> Array:
        _, du, z = _signs()
        share = parameter_values["bw_share"][:, None]
        return (1.0 - share) + share * du * z


@dataclass(frozen=True)
class GeneralizedBoucWen(_Hysteretic):
    """Song and Der Kiureghian's model: as :class:`BoucWen`, with b₂ … b₆ in the place of the share."""

    name = "generalized_bouc_wen"

    def parameters(self, scales: Scales) -> tuple[Parameter, ...]:
        what = "asymmetry term {} of Song & Der Kiureghian over the first"
        terms = (Parameter(f"bw_b{i}", f"b{i}", "-", what.format(i), stats.norm(scale=0.4)) for i in range(2, 7))
        return (*super().parameters(scales), *terms)

    def shape(self, parameter_values: ParameterValues) -> Array:
        u, du, z = _signs()
        b = {i: parameter_values[f"bw_b{i}"][:, None] for i in range(2, 7)}
        return du * z + b[2] * u * du + b[3] * u * z + b[4] * du + b[5] * z + b[6] * u

    def derived(self, parameter_values: ParameterValues) -> dict[str, Derived]:
        """β₁ … β₆ (N^(1−n)/mm) of ż = u̇ (A − |z|ⁿ ψ), as printed (A is k)."""
        unit = parameter_values["bw_k_N_mm"] / parameter_values["bw_force_N"] ** parameter_values["bw_n"]
        terms = {f"beta{i}": unit * parameter_values[f"bw_b{i}"] for i in range(2, 7)}
        return {n: Derived("N^(1−n)/mm", x) for n, x in {"beta1": unit, **terms}.items()}


OTHER_MODELS: dict[str, Simulator] = {r.name: r for r in (BoucWen(), GeneralizedBoucWen())}
