"""Effects of rig and mounting in series with the specimen: it moves less than was measured."""

import math

import numba as nb
import numpy as np
from scipy import stats

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Inner, Motion, form, moved_by
from bayes_iwan.models.kernels import pointwise

#: a motion in series is solved for until the residual displacement (RMS) of every loop is within this share of its
#: amplitude, and where the force crosses zero until the force there is within this share of its largest
TOLERANCE = 1e-9
#: passes over the loops at most; a few draws, at a jump of their law, are not solved by then and get no force (NaN)
MOST_PASSES = 40
#: of these the last ones that the next motion is made of; three to six take as many passes
REMEMBERED = 4


class RigCompliance(Effect):
    name = "rig_compliance"
    flexible = True  # other slip forces imitate nearly all of it, and it imitates theirs
    law = "u − C·(F + (ρ − 1)·F₁·(1 − e^(−|F|/F₁))·sgn F); ρ = 1: linear, ρ > 1: softer at small forces"
    strength = ("compliance_mm_N", "C", "mm/N", "compliance in series")
    order = 1
    physics = "Fixture, glue and force cell give under the force, so the specimen moves by u − C·F."
    reference = "ISO 7626-5 (impedance of fixtures); Bickford, Introduction to the Design and Behavior of Bolted Joints"
    signature = "every stiffness lowered at once; hardly any shape of its own: absorbed by k and the slip forces"
    look_alikes = ("free_play",)
    bench = "a second accelerometer across the fixture"
    remedy = "Measure the displacement across the specimen itself, or stiffen the fixture."

    def first_guess(self) -> float:
        return 0.02 * self.scales.length_mm / self.scales.force_N

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        ratio, first = stats.lognorm(s=0.7, scale=1.0), stats.lognorm(s=0.35, scale=0.4 * self.scales.force_N)
        return {
            "soft_ratio": ExtraParameter("ρ", "-", "compliance at small forces over that at large ones", ratio),
            # closing over much less force is a play with soft ends
            "soft_N": ExtraParameter("F₁", "N", "force over which a soft first part closes", first, scan=False),
        }

    def around(self, inner: Inner, motion: Motion, parameter_values: ParameterValues) -> Array:
        compliance, first_N, ratio = (
            np.ascontiguousarray(parameter_values[f"{self.name}.{n}"])
            for n in ("compliance_mm_N", "soft_N", "soft_ratio")
        )
        force = inner(motion)
        out, some, base = force, np.arange(len(force)), motion
        trial, step, left, held = np.zeros((4, *force.shape))
        trial += motion.displacement_mm
        draws, loops, samples = force.shape
        slopes, moves = np.zeros((2, draws, loops, REMEMBERED, samples))
        products, size = np.zeros((draws, loops, REMEMBERED, REMEMBERED)), np.full((draws, loops), np.inf)
        for passed in range(MOST_PASSES):
            pointwise.series_step(
                np.ascontiguousarray(base.displacement_mm), compliance[some], ratio[some] - 1.0, first_N[some],
                self.scales.stiff_N_mm, force, trial, step, left, slopes, moves, products, passed, held, size,
            )  # fmt: skip
            out[some] = held
            open_ = np.any(size > TOLERANCE * motion.amplitude_mm, axis=1)
            if not open_.any():
                break
            if not open_.all():
                some, base = some[open_], base.of_draws(open_)
                trial, step, left, held, slopes, moves, products, size = (
                    x[open_] for x in (trial, step, left, held, slopes, moves, products, size)
                )
            force = np.ascontiguousarray(inner(moved_by(base, trial), some))
        else:
            out[some] = np.where((size > TOLERANCE * motion.amplitude_mm)[:, :, None], np.nan, held)
        return out


_jit = nb.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _softplus(x: float) -> float:
    """ln(1 + e^x), at large x without overflow."""
    return x + math.log1p(math.exp(-x)) if x > 0.0 else math.log1p(math.exp(x))


@_jit
def _through_play(u: Array, velocity: Array, half: Array, soft: Array, crossing: Array, out: Array) -> None:
    """The specimen's motion: at rest where the force crosses zero on each branch (rising, falling) while the play is
    crossed, and over a share `soft` of it gradually with the rig at its ends. crossing : (draws, loops, 2)."""
    draws, loops, samples = out.shape
    for d in range(draws):
        m, width = d % u.shape[0], soft[d] * half[d]
        for j in range(loops):
            for i in range(samples):
                c = crossing[d, j, 0] if velocity[m, j, i] > 0.0 else crossing[d, j, 1]
                x = u[m, j, i]
                if math.isinf(c) or not abs(abs(x - c) - half[d]) < 40.0 * width:
                    out[d, j, i] = min(max(c, x - half[d]), x + half[d])
                else:
                    ahead, behind = (x - c - half[d]) / width, (c - x - half[d]) / width
                    out[d, j, i] = c + width * (_softplus(ahead) - _softplus(behind))


@_jit
def _first_crossings(u: Array, half: Array, force: Array, crossing: Array, slope: Array) -> None:
    """About where the force of a specimen with play crosses zero on each branch, and the slope there (N/mm): after as
    long a way from its reversal, half the play further in, as the force of one without; ∓inf where that keeps its sign.
    """
    draws, loops, samples = force.shape
    for d in range(draws):
        m = d % u.shape[0]
        for j in range(loops):
            low, high = np.min(u[m, j]), np.max(u[m, j])
            for branch in range(2):
                crossing[d, j, branch] = -np.inf if force[d, j, 0] > 0.0 else np.inf
                for i in range(samples):
                    f0, f1 = force[d, j, i - 1], force[d, j, i]
                    x0, x1 = u[m, j, i - 1], u[m, j, i]
                    if (f0 < 0.0) != (f1 < 0.0) and (x1 > x0 if branch == 0 else x1 < x0) and (f1 > f0) == (x1 > x0):
                        slope[d, j, branch] = (f1 - f0) / (x1 - x0)
                        c = x0 - f0 / slope[d, j, branch]
                        further = c + half[d] if branch == 0 else c - half[d]
                        crossing[d, j, branch] = min(max(further, 0.5 * (c + low)), 0.5 * (c + high))
                        break


@_jit
def _secants(
    u: Array, force: Array, first_slope: Array, crossing: Array, last: Array, slope: Array, left: Array
) -> None:
    """A step of the secant method towards the places where the force on the specimen at rest is zero; left (draws,
    loops) is the larger force there, over the loop's largest. last (draws, loops, 2, 2) : place and force of the step
    before."""
    draws, loops, samples = force.shape
    for d in range(draws):
        m = d % u.shape[0]
        for j in range(loops):
            left[d, j] = 0.0
            low, high, size = np.min(u[m, j]), np.max(u[m, j]), np.max(np.abs(force[d, j]))
            for branch in range(2):
                c, there = crossing[d, j, branch], 0.0
                for i in range(samples):
                    x0, x1 = u[m, j, i - 1], u[m, j, i]
                    if x0 <= c < x1 if branch == 0 else x0 >= c > x1:
                        there = force[d, j, i - 1] + (force[d, j, i] - force[d, j, i - 1]) * (c - x0) / (x1 - x0)
                        break
                if math.isinf(c) or not abs(there) > 0.0:
                    continue
                left[d, j] = max(left[d, j], abs(there) / size)
                moved, least = c - last[d, j, branch, 0], 0.1 * first_slope[d, j, branch]
                if abs(moved) > 1e-13 * (high - low):
                    slope[d, j, branch] = min(max((there - last[d, j, branch, 1]) / moved, least), 100.0 * least)
                last[d, j, branch, 0], last[d, j, branch, 1] = c, there
                crossing[d, j, branch] = min(max(c - there / slope[d, j, branch], 0.5 * (c + low)), 0.5 * (c + high))


class FreePlay(Effect):
    name = "free_play"
    law = "a dead zone of width δ about zero force; its ends close within the share w of it (w → 0: hard)"
    strength = ("play_mm", "δ", "mm", "width of the play")
    order = 1
    physics = (
        "Backlash in series (a loose thread or pin): while the play is crossed no force is carried, so the "
        "measured force stays at zero; beyond it the specimen follows at half the play's distance."
    )
    reference = (
        "Nordin & Gutman, Automatica 38 (2002) 1633; Kim, Rook & Singh, J. Sound Vib. 263 (2003) 665 (smoothed ends)"
    )
    signature = "a flat at zero force on both branches, of one width in every test"
    look_alikes = ("rig_compliance",)
    bench = "preload that keeps the force of one sign; a second accelerometer across the joint"
    remedy = "Tighten the joint, or preload it so that its force keeps one sign."

    def first_guess(self) -> float:
        return 0.02 * self.scales.length_mm

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "softness": form(
                "w", "way over which the ends close, over half the play", stats.lognorm(s=1.0, scale=0.05), 1e-4, 1.0
            )
        }

    def around(self, inner: Inner, motion: Motion, parameter_values: ParameterValues) -> Array:
        half, soft = 0.5 * parameter_values[self.strength_name], parameter_values[f"{self.name}.softness"]
        out = inner(motion)
        some, base = np.arange(len(out)), motion
        crossing, slope = np.empty((*out.shape[:2], 2)), np.empty((*out.shape[:2], 2))
        u, velocity = (np.ascontiguousarray(x) for x in (motion.displacement_mm, motion.velocity_m_s))
        _first_crossings(u, half, out, crossing, slope)
        first, last = slope.copy(), np.full((*slope.shape, 2), np.nan)
        for _ in range(MOST_PASSES):
            specimen, left = np.empty((len(some), *out.shape[1:])), np.empty((len(some), out.shape[1]))
            _through_play(u, velocity, half[some], soft[some], crossing, specimen)
            out[some] = force = np.ascontiguousarray(inner(moved_by(base, specimen), some))
            _secants(u, force, first, crossing, last, slope, left)
            open_ = np.any(left > TOLERANCE, axis=1)
            if not open_.any():
                break
            some, base = some[open_], base.of_draws(open_)
            u, velocity = (x if len(x) == 1 else x[open_] for x in (u, velocity))
            first, crossing, last, slope, left = (x[open_] for x in (first, crossing, last, slope, left))
        else:
            out[some] = np.where((left > TOLERANCE)[:, :, None], np.nan, out[some])
        return out


EFFECTS: tuple[type[Effect], ...] = (RigCompliance, FreePlay)
