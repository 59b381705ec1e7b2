"""Motions with corners: triangles, trapezoids, holds.

Any finite number of harmonics rounds a corner and lets the velocity ring. Here the motion is a few harmonics and a few
kinks, each a parabola around the cycle whose slope jumps at one place. Corners that a filter or the mechanics rounded
are no kinks; there the harmonics run out, and `averaging` keeps to them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.timing.harmonics import evaluate, white_noise

SMOOTH_HARMONICS = 8  # beside the kinks
MOST_KINKS = 6
KINK_COSTS = 4  # numbers: its place and its size, and that the place was looked for
CANDIDATES = 512  # places that a kink is looked for at first
CLOSEST = 2.0  # samples between two corners
BINS = 512  # of phase, that samples are gathered in
#: a drive has corners if harmonics above this, without the strongest, hold more of its squared velocity than this
CORNERED = 5, 0.015
MOST_HARMONICS = 24
SIGMAS = 3.0  # of chance, that corners must stand out of
#: share of the friction force by which sound channels, which filter what turns at once, make a model miss such a drive:
#: so much up to so many samples a cycle, less in proportion above. Sound specimens under triangles and trapezoids show
#: up to 4 % (tests/diagnosis/test_drive_faults.py). Below LEAST nothing is said
CORNERS_GAP, CORNERS_SAMPLES, LEAST_GAP = 0.05, 160.0, 0.01
SHARP = 2e-4  # of the amplitude: RMS that kinks may leave beyond the noise


@dataclass(frozen=True)
class CorneredMotion:
    """u(phase) = Re sum_h c_h exp(2 pi i h phase) + sum_j a_j B(phase - p_j), B(x) = x^2 - x + 1/6 for 0 <= x < 1.

    harmonics : (H + 1,) c_h. places, sizes : (n_kinks,) p_j in cycles and a_j; the slope falls by 2 a_j at p_j.
    """

    harmonics: np.ndarray
    places: Array
    sizes: Array

    def value(self, phase: Array, derivative: int = 0) -> Array:
        """(n,) the motion at `phase`, or its first or second derivative by phase (kinks' impulses omitted)."""
        rate = (2j * np.pi * np.arange(self.harmonics.size)) ** derivative
        out = evaluate(self.harmonics * rate, phase)
        x = (phase[:, None] - self.places) % 1.0
        basis = (_kink(x), 2 * x - 1, np.full_like(x, 2.0))[derivative]
        return np.asarray(out + basis @ self.sizes)

    def amplitude(self) -> float:
        """Half the peak-to-peak."""
        phase = np.concatenate([np.arange(4096) / 4096, self.places])
        return float(np.ptp(self.value(phase)) / 2)


def has_corners(size: Array, noise: Array) -> bool:
    """Does a motion turn or stop at once, as a triangle's or a trapezoid's? (n,) sizes of harmonics 1 ... n and the
    standard errors of their parts.

    Corners leave many harmonics of the velocity that fall off slowly; one strong harmonic is a distorted sine.
    """
    rate = np.arange(1, size[:MOST_HARMONICS].size + 1) ** 2
    chance = 2 * rate * noise[: rate.size] ** 2  # what noise alone makes of each, on average and in standard deviation
    power = rate * size[: rate.size] ** 2 - chance
    order, share = CORNERED
    beyond = power[order:]
    error = float(np.linalg.norm(chance[order:]))
    return bool(beyond.sum() - beyond.max(initial=0.0) > share * power.sum() + SIGMAS * error)


def cornered_motion(phase: Array, displacement: Array, n_cycles: int) -> CorneredMotion | None:
    """The motion of (n,) samples in order at (n,) phases in cycles: None where kinks do not explain it."""
    place = phase % 1.0
    cell = (place * BINS).astype(int)
    count = np.bincount(cell, minlength=BINS)
    used = count > 0
    x = np.bincount(cell, place, BINS)[used] / count[used]
    weight = np.sqrt(count[used] / count[used].mean())
    y = np.bincount(cell, displacement, BINS)[used] / count[used] * weight
    # straight pieces have no second differences but noise
    noise = white_noise(displacement) / np.sqrt(count[used].mean())
    turn = 2 * np.pi * np.arange(1, SMOOTH_HARMONICS + 1) * x[:, None]
    smooth = np.concatenate([np.ones((x.size, 1)), np.cos(turn), np.sin(turn)], axis=1) * weight[:, None]
    basis = np.linalg.qr(smooth)[0]
    remaining = y - basis @ (basis.T @ y)

    def columns(places: Array) -> Array:
        out = _kink((x[:, None] - places) % 1.0) * weight[:, None]
        return np.asarray(out - basis @ (basis.T @ out))

    def left(places: Array) -> Array:
        c = columns(places)
        return np.asarray(remaining - c @ np.linalg.lstsq(c, remaining, rcond=1e-10)[0])

    candidates = columns(np.arange(CANDIDATES) / CANDIDATES)
    sharp = SHARP * float(np.std(displacement))
    own = max(float(np.hypot(noise, sharp)), 1e-300)
    places, best, least = np.empty(0), np.empty(0), float(np.sum(remaining**2)) / own**2
    for k in range(1, MOST_KINKS + 1):
        have = np.linalg.qr(columns(places))[0]
        free = candidates - have @ (have.T @ candidates)
        size = np.linalg.norm(free, axis=0)
        gain = np.abs(left(places) @ free) / np.where(size > 1e-2 * size.max(), size, np.inf)
        places = np.append(places, np.argmax(gain) / CANDIDATES)
        places = least_squares(left, places, x_scale=1e-3, max_nfev=15).x
        # the Bayesian information criterion, of a noise that is known
        beyond = max(float(np.mean(left(places) ** 2)) - sharp**2, 0.0)
        cost = x.size * beyond / own**2 + KINK_COSTS * k * np.log(x.size)
        if cost < least:
            best, least = places, cost
        elif k > best.size + 1:
            break
    if not best.size or np.sqrt(np.mean(left(best) ** 2)) > np.hypot(1.15 * noise, sharp):
        return None
    kinks = _kink((x[:, None] - best) % 1.0) * weight[:, None]
    found = np.linalg.lstsq(np.concatenate([smooth, kinks], axis=1), y, rcond=1e-10)[0]
    h = SMOOTH_HARMONICS
    harmonics = found[: h + 1].astype(complex)
    harmonics[1:] -= 1j * found[h + 1 : 2 * h + 1]
    sizes = found[2 * h + 1 :]
    large = np.sort(best[np.abs(sizes) > 0.02 * np.abs(sizes).max()] % 1.0)
    apart = np.diff(np.append(large, large[0] + 1.0)).min()
    if apart * phase.size / n_cycles <= CLOSEST:
        return None  # several kinks to one corner: it is round, and harmonics say how
    return CorneredMotion(harmonics, best % 1.0, sizes)


def _kink(x: Array) -> Array:
    return np.asarray(x * x - x + 1 / 6)
