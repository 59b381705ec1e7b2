"""How a harmonic of the gap grows with frequency and amplitude: power laws, with the specimen's own numbers free.

The residual of a fit shows an effect changed by what the specimen's parameters have absorbed of it, with signs that
change from test to test. So the law is not read off the residual: a force c · f^a · A^b in one harmonic, in phase or in
quadrature, is fitted to it together with all the specimen's parameters, for every a and b of a grid.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.fits.discrepancy_size import DiscrepancySize
from bayes_iwan.diagnosis.fits.residuals import LOOP, Residual
from bayes_iwan.screen import on_screen

ORDERS = (1, 2, 3, 4, 5)
FREQUENCY_POWERS = np.arange(-2.0, 3.01, 0.25)
AMPLITUDE_POWERS = np.arange(-1.0, 4.01, 0.25)
#: fall of twice the log-likelihood at the ends of a 90 % interval
FALL = 2.71
#: and this share of the gain, for the refit is linear and the law need not be exact
LOOSE = 0.003
#: an exponent is not claimed more exactly than this
LEAST_REACH = 0.05
#: frequencies and amplitudes closer together than this ratio tell no power
LEAST_RATIO = 1.3
LENGTH = 0.05
#: laws that are reported
REPORTED_MOST = 4


@dataclass(frozen=True)
@on_screen
class GrowthLaw:
    """c · (f/f₀)^a · (A/A₀)^b in one harmonic; f₀ and A₀ are the largest of the tests.

    force_N, sd_N : c and its standard error, of it what a refit of the base model's parameters leaves.
    frequency_power, amplitude_power : a, b as (best, low, high) with 90 % intervals, infinite where the grid of
    exponents ends, None where the tests cannot tell. gain : fall of the residual's χ² by this one term.
    """

    order: int
    part: str
    force_N: float
    sd_N: float
    frequency_power: tuple[float, float, float] | None
    amplitude_power: tuple[float, float, float] | None
    gain: float
    p_value: float


class LawSearch:
    """Laws one after the other: the one that explains most, then what explains most beside it.

    residual : of the fit; null : (draws, T, M) residuals where the model is right; turn : (T, orders) to the
    displacement's phase. null_scores : (draws, candidates) standardised cube roots of the gains under the null.
    """

    def __init__(self, residual: Residual, null: np.ndarray, turn: np.ndarray, typical_discrepancy: float) -> None:
        loops = residual.data.loops
        f, a = np.array([x.frequency_hz for x in loops]), np.array([x.amplitude_mm for x in loops])
        self.f_powers = FREQUENCY_POWERS if f.max() > LEAST_RATIO * f.min() else np.zeros(1)
        self.a_powers = AMPLITUDE_POWERS if a.max() > LEAST_RATIO * a.min() else np.zeros(1)
        self.frequencies = len(groups_of(f.tolist()))
        shape = (f / f.max())[None, None] ** self.f_powers[:, None, None]
        shape = (shape * (a / a.max())[None, None] ** self.a_powers[None, :, None]).reshape(-1, len(f))
        linear, z = residual.fit.linear, residual.fit.z
        sd = np.sqrt(linear.variance(DiscrepancySize(typical_discrepancy, LENGTH, 0.0)))
        # the prior's rows stand below the data's: a law may cost the specimen's parameters something too
        q, _ = np.linalg.qr(np.concatenate([linear.jacobian / sd[:, None], np.eye(len(z))]))

        def free(rows: Array, prior: Array) -> Array:
            x = np.concatenate([rows / sd, prior], axis=1)
            return x - (x @ q) @ q.T

        self.left = free(residual.rows_of(residual.value[None]), -z[None])[0]
        simulated = free(residual.rows_of(null), np.zeros((len(null), len(z))))
        self.order = np.r_[linear.discrepancy.order, np.full(len(z), -1)]
        self.names: list[tuple[int, str]] = []
        self.signatures: list[Array] = []
        self.visible: list[Array] = []  # of each signature, as shares of its size
        roots = []
        for order in ORDERS:
            at = np.flatnonzero((residual.kind == LOOP) & (residual.order == order))
            if not len(at) or not np.any(residual.weight[:, at]):
                continue
            for part, unit in (("in phase", 1.0), ("quadrature", 1j)):
                signature = np.zeros((len(shape), *residual.value.shape), dtype=complex)
                signature[:, :, at[0]] = shape * unit / turn[:, order]
                rows = residual.rows_of(signature)
                s = free(rows, np.zeros((len(shape), len(z))))
                self.names.append((order, part))
                self.signatures.append(s)
                power = np.maximum(np.einsum("ij,ij->i", s, s), 1e-12)
                self.visible.append(np.sqrt(power / np.maximum(np.sum((rows / sd) ** 2, axis=1), power)))
                roots.append(np.cbrt(np.max((simulated @ s.T) ** 2 / power, axis=1)))
        root = np.stack(roots, axis=1)
        self.middle, self.scale = root.mean(axis=0), np.maximum(root.std(axis=0), 1e-300)
        self.null_scores = (root - self.middle) / self.scale

    def laws(self, p_value: Callable[[float], float], level: float) -> tuple[GrowthLaw, ...]:
        """The significant laws in order. p_value : of a score, the number of statistics allowed for."""
        out: list[GrowthLaw] = []
        left, signatures, remaining = self.left, list(self.signatures), list(range(len(self.names)))
        while remaining and len(out) < REPORTED_MOST:
            found = []
            for i in remaining:
                s = signatures[i]
                power = np.einsum("ij,ij->i", s, s)
                whole = np.einsum("ij,ij->i", self.signatures[i], self.signatures[i])
                # a term that the laws before it leave nothing of explains nothing
                gain = np.where(power > 1e-3 * whole, (s @ left) ** 2 / np.maximum(power, 1e-12), 0.0)
                found.append((float((np.cbrt(gain.max()) - self.middle[i]) / self.scale[i]), i, gain))
            score, i, gain = max(found, key=lambda x: float(x[2].max()))
            p = p_value(score)
            if p >= level:
                break
            law, unit = self._law(i, signatures[i], left, gain, p)
            out.append(law)
            left = left - unit * (unit @ left)
            signatures = [s - np.outer(s @ unit, unit) for s in signatures]
            remaining.remove(i)
        return tuple(out)

    def _law(self, i: int, s: Array, left: Array, gain: Array, p: float) -> tuple[GrowthLaw, Array]:
        order, part = self.names[i]
        best = int(np.argmax(gain))
        power = float(s[best] @ s[best])
        size = float(s[best] @ left) / power
        after = left - size * s[best]
        mine = self.order == order
        spare = max(1.0, float(np.sum(after[mine] ** 2)) / max(int(mine.sum()), 1))
        table = gain.reshape(len(self.f_powers), len(self.a_powers))
        # with two frequencies the parallel spring takes up whatever makes one power differ from another
        known = self.frequencies > 2 or (order, part) != (1, "in phase")
        by_frequency = _profile(self.f_powers, table.max(axis=1), spare) if known else None
        law = GrowthLaw(
            order,
            part,
            size * float(self.visible[i][best]),
            float(np.sqrt(spare / power) * self.visible[i][best]),
            by_frequency,
            _profile(self.a_powers, table.max(axis=0), spare),
            float(gain[best]),
            p,
        )
        return law, s[best] / np.sqrt(power)


def _profile(powers: Array, gain: Array, spare: float) -> tuple[float, float, float] | None:
    """Best exponent and its 90 % interval from the profile of the gain over a grid of exponents; an interval that
    reaches an end of the grid is open there."""
    if len(powers) == 1:
        return None
    best = int(np.argmax(gain))
    top, at = float(gain[best]), float(powers[best])
    if 0 < best < len(powers) - 1:  # the vertex of the parabola through the best three
        behind, ahead = gain[best - 1], gain[best + 1]
        curvature = 2.0 * top - behind - ahead
        at += 0.5 * (powers[1] - powers[0]) * (ahead - behind) / max(curvature, 1e-300)
        top += 0.125 * (ahead - behind) ** 2 / max(curvature, 1e-300)
    fine = np.linspace(powers[0], powers[-1], 501)
    kept = fine[np.interp(fine, powers, gain) >= top * (1.0 - LOOSE) - FALL * spare]
    low, high = (float(kept.min()), float(kept.max())) if len(kept) else (at, at)
    low, high = -np.inf if low == fine[0] else low, np.inf if high == fine[-1] else high
    return at, min(low, at - LEAST_REACH), max(high, at + LEAST_REACH)
