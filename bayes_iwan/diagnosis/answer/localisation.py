"""Where the model misses: in which tests, where along the loop, in which harmonics, and how it grows.

Every statistic of the residual is a mean square over some part of it. What that would be were the model right is
simulated: noise with its floors, a small smooth discrepancy such as specimens without any effect show, and the refit
that absorbs a part of both. A statistic is significant when it exceeds that by more than the largest of all would in 19
of 20 such campaigns, so their number is allowed for, whatever their dependence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Campaign
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.answer.growth_laws import GrowthLaw, LawSearch
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.fits.data import MAINS_HZ, TREND_HARMONICS
from bayes_iwan.diagnosis.fits.discrepancy_size import LENGTHS
from bayes_iwan.diagnosis.fits.evidence import in_newtons
from bayes_iwan.diagnosis.fits.gap_size import LEVEL, GapSize, gap_size
from bayes_iwan.diagnosis.fits.residuals import ALONG, LOOP, MAINS, MEAN, Residual, residual_of
from bayes_iwan.diagnosis.search.search_result import Search
from bayes_iwan.inference.setup.loop_error import harmonics_of
from bayes_iwan.models import Model
from bayes_iwan.models.simulator import inner_effects
from bayes_iwan.screen import on_screen

FAMILY_WISE = 0.05
SIMULATIONS = 1000
#: draws behind what a right model would leave of each block of cycles
BLOCK_DRAWS = 100
#: harmonics looked at one by one
ORDERS = 7
#: share of the stroke that counts as an end
END = 0.2
#: with less than this share of the elements still sticking the slip is called gross
GROSS = 0.2


@dataclass(frozen=True)
@on_screen
class Statistic:
    """One statistic of the residual.

    gap_N, low_N, high_N : RMS residual there, noise taken off, with its 90 % interval
    share : of the mean square of the averaged loops' gap (of the change along the record for kind "trend"); time :
        share of the time that it covers
    p_value : how often the largest of all statistics is as unusual as this one where the model is right
    """

    kind: str
    name: str
    gap_N: float
    low_N: float
    high_N: float
    share: float
    time: float
    p_value: float
    significant: bool


@dataclass(frozen=True)
@on_screen
class Where:
    """All statistics, how many they are, and arrays for pictures.

    statistics : kinds "test", "region", "frequency", "amplitude", "in phase", "quadrature", "parity", "mean", "trend",
        "record", "mains"; laws : how single harmonics grow with frequency and amplitude
    phase_N : (T, samples) residual of the averaged loops along the cycle, mean omitted; expected_N : the same size,
        its standard deviation where the model is right
    in_phase_N, quadrature_N : (T, ORDERS + 1) with respect to the displacement; expected_harmonic_N : (T, ORDERS + 1)
    sticking : (T, samples) share of the elements that stick, from the model; None where it has no elements
    change_N : (T, 3) change of mean, in-phase and quadrature fundamental from the first block of cycles to the last
    clock : are the frequencies real?
    """

    files: tuple[str, ...]
    frequency_hz: Array
    amplitude_mm: Array
    statistics: tuple[Statistic, ...]
    laws: tuple[GrowthLaw, ...]
    count: int
    phase_N: Array
    expected_N: Array
    in_phase_N: Array
    quadrature_N: Array
    expected_harmonic_N: Array
    sticking: Array | None
    change_N: Array
    clock: bool = True

    def of(self, kind: str) -> tuple[Statistic, ...]:
        return tuple(x for x in self.statistics if x.kind == kind)

    @property
    def stands_out(self) -> list[bool]:
        """Whether a test's gap is more than a right model would leave, in its averaged loop or along its record."""
        return [x.significant or y.significant for x, y in zip(self.of("test"), self.of("trend"))]


def where(residual: Residual, seed: int = 0, simulations: int = SIMULATIONS) -> Where:
    """Look everywhere; the residual is that of the base model on the fitted tests."""
    typical_discrepancy, _ = calibration().usual
    rng = np.random.default_rng([seed, 72])
    null = simulated(residual, simulations, rng, typical_discrepancy)
    noise = residual.after_refit(residual.draw_noise(200, rng))
    statistics = _Statistics(residual)
    value = statistics.power(residual.value[None])[0]
    under = statistics.power(null)
    search = LawSearch(residual, null, statistics.turn, typical_discrepancy)
    law_null = search.null_scores

    # cube roots of mean squares are nearly normal (Wilson & Hilferty): statistics of many and of few numbers compare
    root = np.cbrt(under)
    middle, scale = root.mean(axis=0), np.maximum(root.std(axis=0), 1e-300)
    largest = np.max(np.concatenate([(root - middle) / scale, law_null], axis=1), axis=1)
    p = (1.0 + np.sum(largest[:, None] >= (np.cbrt(value) - middle) / scale, axis=0)) / (1.0 + len(largest))
    laws = search.laws(lambda score: float((1.0 + np.sum(largest >= score)) / (1.0 + len(largest))), FAMILY_WISE)

    off = statistics.power(noise)
    found = value - off.mean(axis=0)
    again = statistics.power(residual.value + noise) - value - off.mean(axis=0)  # around zero
    few, many = np.quantile(again, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=0)
    size, low, high = (np.sqrt(np.maximum(x, 0.0) * statistics.scale) for x in (found, found - many, found - few))
    whole, along = (
        max(float(np.mean(residual.power(residual.value, kind)) - np.mean(residual.power(noise, kind))), 1e-300)
        for kind in (LOOP, ALONG)
    )
    share = np.maximum(found, 0.0) / np.where(statistics.changing, along, whole)
    numbers = (size, np.minimum(low, size), np.maximum(high, size), np.minimum(share, 1.0), statistics.time, p)
    rows = zip(*(x.tolist() for x in (*numbers, p < FAMILY_WISE)))
    out = tuple(Statistic(*name, *row) for name, row in zip(statistics.names, rows))
    turned, null_turned = statistics.turned(residual.value), statistics.turned(null)
    loops = residual.data.loops
    return Where(
        tuple(x.file for x in loops),
        np.array([x.frequency_hz for x in loops]),
        np.array([x.amplitude_mm for x in loops]),
        out,
        laws,
        len(out) + law_null.shape[1],
        along_cycle(residual, residual.value),
        along_cycle(residual, null[:200]).std(axis=0),
        turned.real,
        turned.imag,
        np.sqrt(0.5 * np.mean(np.abs(null_turned) ** 2, axis=0)),
        statistics.sticking,
        _change(residual, statistics.turn),
        loops[0].record.clock,
    )


def along_cycle(residual: Residual, value: np.ndarray) -> Array:
    """(…, T, samples) residual force in N on the loops' phases from (…, T, M) complex numbers, means omitted."""
    samples = len(residual.data.loops[0].phase)
    whole = value[..., residual.kind <= MEAN] * (0.5 * samples)
    whole[..., 0] = 0.0
    return fft.irfft(whole, n=samples, axis=-1)


def of_blocks(residual: Residual, value: np.ndarray, test: int) -> Array:
    """(…, blocks, samples) residual force in N of each block of a test's cycles on the loop's phases, from (…, T, M)
    complex numbers: the averaged loop's, and what differs in the block, slow shifts of its mean among it."""
    loop, data = residual.data.loops[test], residual.data
    steady = along_cycle(residual, value)[..., test, :]
    contrasts = value[..., test, residual.kind == ALONG].reshape(*value.shape[:-2], -1, TREND_HARMONICS + 1)
    change = np.einsum("kb,...kh->...bh", data.contrast[test], contrasts)[..., : len(loop.block_cycle), :]
    samples = steady.shape[-1]
    turning = np.exp(2j * np.pi * np.outer(np.arange(TREND_HARMONICS + 1), np.arange(samples) / samples))
    return steady[..., None, :] + (change @ turning).real


def right_model_of_blocks(residual: Residual, test: int, seed: int = 0) -> Array:
    """(blocks, samples) standard deviation of what a right model would leave of each block of a test's cycles, N."""
    rng = np.random.default_rng([seed, 73])
    null = simulated(residual, BLOCK_DRAWS, rng, calibration().usual[0])
    return np.asarray(of_blocks(residual, null, test).std(axis=0))


def simulated(residual: Residual, draws: int, rng: np.random.Generator, typical_discrepancy: float) -> np.ndarray:
    """(draws, T, M) complex: residuals where the model is right but for a typical small discrepancy, after a refit."""
    shares = typical_discrepancy * np.exp(calibration().usual[1] * rng.standard_normal(draws))
    discrepancy = residual.draw_discrepancy(shares, rng.choice(LENGTHS, draws), rng)
    return residual.after_refit(residual.draw_noise(draws, rng, allowed=True) + discrepancy)


class _Statistics:
    """Every statistic as a mean square of the complex residuals, N²; times `scale` it is that over the part itself."""

    def __init__(self, residual: Residual) -> None:
        self.residual = residual
        data = residual.data
        self.loop = np.flatnonzero(residual.kind <= MEAN)
        displacement = np.stack([x.displacement_mm for x in data.loops])
        first = harmonics_of(displacement, 2)[:, 1]
        # the force as Σ Re p_h e^{ihθ} where u ≈ A cos θ: real parts follow the displacement, imaginary the velocity
        self.turn = (np.abs(first) / first)[:, None] ** np.arange(ORDERS + 1)
        self.sticking = sticking_share(residual)
        self.masks = regions(residual, displacement, self.sticking)
        self.orders = min(ORDERS, int(residual.order[residual.kind == LOOP].max()))
        self._name()

    def _name(self) -> None:
        loops = self.residual.data.loops
        names = [("test", x.file) for x in loops]
        names += [("region", name) for name in self.masks]
        self.groups: list[list[int]] = []
        for kind, unit in (("frequency", "Hz"), ("amplitude", "mm")):
            stated = np.array([getattr(x.record, f"{kind}_{unit.lower()}") for x in loops])
            for part in groups_of(stated.tolist()):
                self.groups.append(part)
                names.append((kind, f"{stated[part].mean():.4g} {unit}"))
        names += [(part, str(h)) for part in ("in phase", "quadrature") for h in range(1, self.orders + 1)]
        names += [("parity", "odd"), ("parity", "even"), ("mean", "mean force")]
        names += [("trend", x.file) for x in loops]
        names += [("record", what) for what in ("mean", "in phase", "quadrature", "odd harmonics", "even harmonics")]
        names += [("mains", f"{hz:g} Hz") for hz in MAINS_HZ]
        self.names = names
        tests = len(loops)
        time = [float(m.mean()) for m in self.masks.values()]
        groups = [len(part) / tests for part in self.groups]
        others = len(names) - tests - len(time) - len(groups)
        self.time = np.array([1.0 / tests] * tests + time + groups + [1.0] * others)
        trends = np.array([kind == "trend" for kind, _ in names])
        self.time[trends] = 1.0 / tests
        self.scale = 1.0 / np.maximum(self.time, 1e-9)
        self.changing = np.array([kind in ("trend", "record") for kind, _ in names])

    def turned(self, value: np.ndarray) -> np.ndarray:
        """(…, T, ORDERS + 1) complex: in phase with the displacement + i · in quadrature."""
        return value[..., self.loop[: ORDERS + 1]] * self.turn

    def power(self, value: np.ndarray) -> Array:
        """(draws, statistics) mean squares over all tests and the whole cycle, N²."""
        r = self.residual
        by_test = r.power(value, LOOP)
        tests = by_test.shape[1]
        squares = along_cycle(r, value) ** 2
        parts = [by_test / tests]
        parts.append(np.stack([np.mean(squares * m, axis=(1, 2)) for m in self.masks.values()], axis=1))
        parts.append(np.stack([by_test[:, part].sum(axis=1) / tests for part in self.groups], axis=1))
        p = self.turned(value)[..., 1 : self.orders + 1]
        parts += [0.5 * np.mean(p.real**2, axis=1), 0.5 * np.mean(p.imag**2, axis=1)]
        square = np.mean(r.weight * np.abs(value) ** 2, axis=1)
        loop = r.kind == LOOP
        pick = [loop & (r.order % 2 == 1), loop & (r.order % 2 == 0), r.kind == MEAN]
        parts.append(np.stack([square[:, m].sum(axis=1) for m in pick], axis=1))
        parts.append(r.power(value, ALONG) / tests)
        first = (r.kind == ALONG) & (r.order == 1)
        turned = value[..., first] * self.turn[:, 1, None]
        sizes = np.stack(
            [np.mean(np.sum(r.weight[:, first] * x**2, axis=-1), axis=1) for x in (turned.real, turned.imag)], axis=1
        )
        along = r.kind == ALONG
        pick = [
            along & (r.order == 0),
            along & (r.order % 2 == 1) & (r.order > 1),
            along & (r.order % 2 == 0) & (r.order > 0),
        ]
        others = np.stack([square[:, m].sum(axis=1) for m in pick], axis=1)
        parts += [others[:, :1], sizes, others[:, 1:]]
        parts.append(square[:, r.kind == MAINS])
        return np.concatenate(parts, axis=1)


def sticking_share(residual: Residual) -> Array | None:
    """(T, samples) share of the elements that stick: the friction's tangent stiffness over the elements'; None for a
    simulator without elements."""
    problem, motion = residual.fit.problem, residual.data.steady_motion
    model = problem.model
    if not isinstance(model, Model):
        return None
    parameter_values = problem.parameter_values(residual.fit.z[None])
    friction = problem.friction_force(parameter_values, motion)[0]
    k = model.stiffness_law.k(parameter_values, model.alpha(parameter_values, motion, inner_effects(problem.effects)))[
        0
    ]
    u = motion.displacement_mm[0]
    du = np.roll(u, -1, axis=-1) - np.roll(u, 1, axis=-1)
    df = np.roll(friction, -1, axis=-1) - np.roll(friction, 1, axis=-1)
    slow = np.abs(du) < 0.02 * np.abs(du).max(axis=-1, keepdims=True)  # at a reversal everything sticks
    return np.where(slow, 1.0, np.clip(df / np.where(slow, 1.0, du * np.broadcast_to(k, u.shape)), 0.0, 1.0))


def regions(residual: Residual, displacement_mm: Array, sticking: Array | None) -> dict[str, NDArray[np.bool_]]:
    """Parts of the loop by name, (T, samples) each; those of slip only where the share that sticks is known."""
    low, high = displacement_mm.min(axis=1, keepdims=True), displacement_mm.max(axis=1, keepdims=True)
    place = (displacement_mm - low) / (high - low)
    velocity = np.stack([x.velocity_m_s for x in residual.data.loops])
    rising, speed = velocity > 0.0, np.abs(velocity)
    slow, fast = np.quantile(speed, [1 / 3, 2 / 3])
    middle = (place >= END) & (place <= 1.0 - END)
    clock = residual.data.loops[0].record.clock
    slip = {} if sticking is None else {"microslip": sticking >= GROSS, "gross slip": sticking < GROSS}
    return {
        "rising displacement": rising,
        "falling displacement": ~rising,
        "just after the lower reversal": rising & (place < END),
        "just after the upper reversal": ~rising & (place > 1.0 - END),
        "mid-stroke, rising": rising & middle,
        "mid-stroke, falling": ~rising & middle,
        "arriving at the upper end": rising & (place > 1.0 - END),
        "arriving at the lower end": ~rising & (place < END),
        "near the upper end": place > 1.0 - END,
        "near the lower end": place < END,
        **slip,
        **({"lowest third of speeds": speed <= slow, "highest third of speeds": speed > fast} if clock else {}),
    }


def _change(residual: Residual, turn: np.ndarray) -> Array:
    """(T, 3) change of the residual's mean, in-phase and quadrature fundamental from first to last block, N."""
    data = residual.data
    out = np.zeros((data.tests, 3))
    for t, loop in enumerate(data.loops):
        b = len(loop.block_cycle)
        if b < 2:
            continue
        step = data.contrast[t][:, b - 1] - data.contrast[t][:, 0]
        for order, at in ((0, 0), (1, 1)):
            rows = (residual.kind == ALONG) & (residual.order == order)
            change = complex(step @ residual.value[t, rows]) * (1.0 if order == 0 else turn[t, 1])
            out[t, at] = change.real
            if order:
                out[t, 2] = change.imag
    return out


@dataclass(frozen=True)
class Located:
    """What the base model misses: residual of its fit where it misses least, its size and its place."""

    campaign: Campaign
    residual: Residual
    size: GapSize
    where: Where


def located(campaign: Campaign, search: Search, seed: int) -> Located:
    """The gap of a finished search's base."""
    residual = residual_of(search.data, in_newtons(search.data, search.base))
    return Located(campaign, residual, gap_size(residual, seed), where(residual, seed))
