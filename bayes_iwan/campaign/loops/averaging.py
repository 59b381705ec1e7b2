"""One loop from many cycles: harmonic least squares on the phase of every sample.

Every sample of the cycles kept enters with its own phase, so the number of samples a cycle need not be
whole, and irregular steps and short gaps need no interpolation.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.noise import MANY_CYCLES, SOME_CYCLES, harmonic_noise
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.campaign.timing.corners import CORNERS_GAP, CORNERS_SAMPLES, LEAST_GAP, cornered_motion, has_corners
from bayes_iwan.campaign.timing.cycles import MOST_HARMONICS, Cut, cut_cycles
from bayes_iwan.campaign.timing.harmonics import evaluate, grams, inverse, on_grid, project, to_complex
from bayes_iwan.screen import on_screen

FEWEST_PER_CYCLE = 8.0  # samples
SAMPLES_PER_HARMONIC = 0.45  # harmonics resolved per sample of a cycle; 0.5 is Nyquist
FEWEST_TO_TAPER = 8  # harmonics; a distorted sine has fewer that matter
#: times what noise hides: the last harmonic of a motion with corners is smaller, since they fall off by the square of
#: their order and three in a row at most lie between
RUN_OUT = 4.0
CORNERS = 2e-3  # share of the squared velocity in the upper half of the harmonics that tells corners
#: harmonics of the force above this share of the sampling rate are not trusted (but for the first few): anti-alias
#: filters and sensors' own resonances turn and weaken them
TRUSTED_BAND, LEAST_HARMONICS = 0.13, 5
FALSE_HARMONIC = 1e-3  # chance that any noise-only harmonic enters the displacement


@dataclass(frozen=True)
@on_screen
class Averager:
    """The linear map from a signal on a record's samples to harmonics per block of cycles.

    index : (n_kept,) samples used; phase : (n_kept,) their phase in cycles; starts : (n_blocks + 1,) where
    each block begins in `index`; inverses : (n_blocks + 1, m, m) inverse normal matrices of the blocks and,
    last, of all together; shift : phase that is subtracted; n_harmonics : length harmonics are padded to.
    """

    index: np.ndarray
    phase: Array
    starts: np.ndarray
    inverses: Array
    n_harmonics: int
    shift: float = 0.0

    @property
    def n_resolved(self) -> int:
        return (self.inverses.shape[1] - 1) // 2

    def solve(self, signals: Iterable[Array]) -> np.ndarray:
        """(k, n_blocks + 1, H + 1) complex harmonics of k signals of (n,), of each block and of all together."""
        right = project(self.phase, [x[self.index] for x in signals], self.starts[:-1], self.n_resolved)
        right = np.concatenate([right, right.sum(axis=0, keepdims=True)])
        found = to_complex(np.moveaxis(self.inverses @ right, -1, 0))
        out = np.zeros((*found.shape[:2], self.n_harmonics + 1), dtype=complex)
        out[..., : found.shape[-1]] = found
        return out * np.exp(2j * np.pi * np.arange(self.n_harmonics + 1) * self.shift)

    def inflation(self) -> Array:
        """(n_blocks + 1, n_resolved + 1) variance under white noise, over that of even sampling without gaps."""
        h = self.n_resolved
        n = np.append(np.diff(self.starts), self.index.size)
        variance = np.diagonal(self.inverses, axis1=1, axis2=2) * n[:, None]
        return np.concatenate([variance[:, :1], (variance[:, 1 : h + 1] + variance[:, h + 1 :]) / 4], axis=1)


def _averager(cut: Cut, n_harmonics: int, n_blocks: int) -> Averager:
    index = cut.index
    phase = cut.phase[index]
    resolved = int(min(n_harmonics, SAMPLES_PER_HARMONIC * index.size / cut.cycles.size))
    groups = np.array_split(cut.cycles, n_blocks)
    starts = np.searchsorted(np.floor(phase), [g[0] for g in groups])
    matrices = grams(phase, starts, resolved)
    matrices = np.concatenate([matrices, matrices.sum(axis=0, keepdims=True)])
    return Averager(index, phase, np.append(starts, index.size), inverse(matrices), n_harmonics)


@dataclass(frozen=True)
class Loop:
    """One test, averaged over its steady cycles.

    Attributes
    ----------
    frequency_hz
        estimated from the displacement.
    amplitude_mm
        half the peak-to-peak of the averaged displacement.
    offset_mm
        its mean, which was taken off: a dynamic channel carries none, and a shaker's even harmonics move the
        midrange but not the rest position.
    n_cycles
        whole cycles averaged.
    phase
        (n_phase,) uniform on [0, 1); 0 is the upward crossing of the mean.
    displacement_mm, velocity_m_s, acceleration_m_s2, force_N
        (n_phase,), averages; the first three from the harmonics
        of the displacement that stand above its noise, or from `corners` where it has sharp ones.
    force_scatter_N
        (n_phase,) standard deviation over cycles at that phase.
    harmonics_N
        (H + 1,) complex, force_N = Re sum_h c_h exp(2 pi i h phase).
    noise_N
        (H + 1,) standard error of the real (= imaginary) part; inf where sampling resolves nothing.
    block_cycle
        (n_blocks,) mean cycle number of each block of consecutive cycles; 0 is the first whole cycle after
        run-in, whose mean is 0.5.
    block_harmonics_N, block_noise_N
        (n_blocks, H + 1).
    record
        the test as recorded.
    corners
        whether the drive turns or stops at once.

    References
    ----------
    Noise of a periodic measurement from the frequencies beside its harmonics: Pintelon & Schoukens, System
    Identification: A Frequency Domain Approach, Wiley (2012).

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, 0.4, cycles=6)], seed=1).write(folder)
    >>> (loop,) = bi.read_campaign(folder).loops()
    >>> loop.n_cycles, loop.displacement_mm.shape, loop.harmonics_N.shape, bool(abs(loop.amplitude_mm - 0.4) < 0.01)
    (5, (128,), (51,), True)
    """

    file: str
    role: str
    extras: Mapping[str, float]
    frequency_hz: float
    amplitude_mm: float
    offset_mm: float
    n_cycles: int
    phase: Array
    displacement_mm: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    force_N: Array
    force_scatter_N: Array
    harmonics_N: np.ndarray
    noise_N: Array
    block_cycle: Array
    block_harmonics_N: np.ndarray
    block_noise_N: Array
    record: Record
    cut: Cut
    averager: Averager
    corners: bool = False
    sharp: bool = False

    def __repr__(self) -> str:
        at = f"{self.frequency_hz:.4g} Hz, " if self.record.clock else ""
        size = f"{self.amplitude_mm:.4g} {self.record.units.displacement}"
        return f"Loop({self.file!r}: {at}{size}, {self.n_cycles} cycles in {self.phase.size} points, {self.role})"

    @property
    def corners_gap(self) -> float:
        """Share of the friction force that filtered channels may make a model miss, the drive turning or stopping at
        once; 0 where it does not, where the corners are sharp, so that no filter rounds them, or where it is sampled so
        fast that it does no harm."""
        used = self.averager.index
        share = CORNERS_GAP * min(1.0, CORNERS_SAMPLES * self.n_cycles / used.size)
        return share if self.corners and not self.sharp and share >= LEAST_GAP else 0.0

    def force_of_cycles_N(self, cycles: np.ndarray) -> Array:
        """(n_phase,) the force averaged over some of `cut.cycles`, each of them whole."""
        averager = _averager(replace(self.cut, cycles=cycles, late=0.0), self.averager.n_harmonics, 1)
        found = replace(averager, shift=self.averager.shift).solve([self.record.force_N])
        return on_grid(found[0, -1], self.phase.size)

    def left_over(self, signal: Array) -> Array:
        """(n_kept,): what averaging over the whole record leaves of a (n,) signal, on `averager.index`'s samples."""
        signal = np.asarray(signal, dtype=float)
        return _residual(self.averager, signal, self.averager.solve([signal])[0, -1])


def average(record: Record, n_phase: int = 128, n_harmonics: int = MOST_HARMONICS, n_blocks: int = 6) -> Loop:
    """Average the steady cycles of one record; see `Loop` for what comes out. Harmonics of the force that lie above the
    band that can be trusted are no data: their noise is infinite.

    Raises CampaignError where the record has fewer than two whole steady cycles, or too few samples in each.
    """
    if n_phase < 8 or n_harmonics < 1 or n_blocks < 1:
        raise CampaignError(
            f"n_phase must be at least 8, n_harmonics and n_blocks at least 1, not {n_phase}, {n_harmonics}, {n_blocks}"
        )
    u, force = record.displacement_mm, record.force_N
    cut = cut_cycles(record.file, record.time_s, u, force)
    n_cycles = cut.cycles.size
    if (per_cycle := cut.index.size / n_cycles) < FEWEST_PER_CYCLE:
        raise CampaignError(
            f"{record.file}: {per_cycle:.1f} samples a cycle; at least {FEWEST_PER_CYCLE:g} are needed or the loop is "
            "aliased. Sample faster"
        )
    n_blocks = max(1, min(n_blocks, n_cycles // 2))
    averager = _averager(cut, n_harmonics, n_blocks)
    resolved, index = averager.n_resolved, averager.index

    u_blocks, f_blocks = averager.solve([u, force])
    inflation = np.sqrt(averager.inflation())
    u_noise = harmonic_noise(_whole(cut, _residual(averager, u, u_blocks[-1])), n_cycles, resolved) * inflation[-1]
    residual = _residual(averager, force, f_blocks[-1])
    trends = 3 if n_cycles >= MANY_CYCLES else 1 if n_cycles >= SOME_CYCLES else 0
    free = _whole(cut, _without_trends(averager, residual, trends))
    noise = harmonic_noise(free, n_cycles, resolved, trends) * inflation[-1]
    shares = np.diff(averager.starts) / index.size
    block_noise = noise * inflation[:-1] / inflation[-1] / np.sqrt(shares[:, None])

    noise[0] = np.hypot(noise[0], record.mean_force_error_N)

    d = u_blocks[-1].copy()
    size = np.abs(d[1 : resolved + 1])
    weights, cornered, runs_out = _motion_weights(size, u_noise[1:])
    # corners of which noise may be the cause: kinks are tested on it
    may = not runs_out and (cornered or has_corners(size, np.zeros(resolved)))
    kinked = cornered_motion(averager.phase, u[index], n_cycles) if may else None
    d[1 : resolved + 1] *= weights
    corners = kinked is not None or (may and has_corners(size, u_noise[1:]))
    shift, amplitude = _crossing(d)
    offset = float(d[0].real)
    averager = replace(averager, shift=shift)
    order = np.arange(n_harmonics + 1)
    turn = np.exp(2j * np.pi * order * shift)
    d *= turn
    d[0] = 0.0
    f_blocks *= turn
    rate = 2j * np.pi * order * cut.frequency_hz
    phase = np.arange(n_phase) / n_phase
    motion = [on_grid(d * rate**k, n_phase) for k in range(3)]
    if kinked is not None:
        motion = [kinked.value(phase + shift, k) * cut.frequency_hz**k for k in range(3)]
        motion[0] -= kinked.harmonics[0].real
        amplitude = kinked.amplitude()
    return Loop(
        file=record.file,
        role=record.role,
        extras=record.extras,
        frequency_hz=cut.frequency_hz,
        amplitude_mm=amplitude,
        offset_mm=offset,
        n_cycles=n_cycles,
        phase=phase,
        displacement_mm=motion[0],
        velocity_m_s=motion[1] * 1e-3,
        acceleration_m_s2=motion[2] * 1e-3,
        force_N=on_grid(f_blocks[-1], n_phase),
        force_scatter_N=_scatter(averager.phase - shift, residual, n_phase, n_cycles),
        harmonics_N=f_blocks[-1],
        noise_N=_in_band(_pad(noise, n_harmonics), cut.frequency_hz, float(np.median(np.diff(record.time_s)))),
        block_cycle=np.array([g.mean() + 0.5 for g in np.array_split(cut.cycles, n_blocks)]),
        block_harmonics_N=f_blocks[:-1],
        block_noise_N=_pad(block_noise, n_harmonics),
        record=record,
        cut=cut,
        averager=averager,
        corners=corners,
        sharp=kinked is not None,
    )


def fitted_loops(loops: object) -> tuple[Loop, ...]:
    """Those that are not held out. Raises CampaignError where none is left, and for anything but averaged loops."""
    some = tuple(loops) if isinstance(loops, Iterable) else (loops,)
    if wrong := [type(x).__name__ for x in some if not isinstance(x, Loop)]:
        raise CampaignError(f"averaged loops are needed, as check(folder).loops holds them, not {wrong[0]}")
    if not (fitted := tuple(x for x in some if x.role != "held-out")):
        raise CampaignError('no test is left to fit: every test has role = "held-out"')
    return fitted


def _in_band(noise_N: Array, frequency_hz: float, step_s: float) -> Array:
    """The noise (H + 1,) of the force's harmonics, infinite for those above TRUSTED_BAND of the sampling rate: they are
    no data."""
    order = np.arange(len(noise_N))
    beyond = (order * frequency_hz * step_s > TRUSTED_BAND) & (order > LEAST_HARMONICS)
    return np.where(beyond, np.inf, noise_N)


def _pad(noise: Array, n_harmonics: int) -> Array:
    out = np.full((*noise.shape[:-1], n_harmonics + 1), np.inf)
    out[..., : noise.shape[-1]] = noise
    return out


def _motion_weights(size: Array, noise: Array) -> tuple[Array, bool, bool]:
    """(n,) weights of the displacement's harmonics 1 ... n, 1 for motion, 0 for what may be noise; and: may it have
    corners, and do its harmonics run out?

    A harmonic counts when it is larger than noise alone would make any of them, once in 1 / FALSE_HARMONIC
    records, and no more than three in a row below it are smaller than that, unless it and those above it hold a
    noticeable part of the velocity. Derivatives then carry no noise to speak of. Motions with corners (triangles,
    holds) never run out of harmonics, as a multisine does: where the upper half of those kept still holds a noticeable
    part of the velocity, it is tapered, which takes the ripple out of velocity and acceleration and leaves the lower
    half as it is; sharp corners are then described by `corners` instead.
    """
    hidden = np.maximum(np.sqrt(2 * np.log(noise.size / FALSE_HARMONIC)) * noise, 1e-9 * size.max())
    strong = size > hidden
    strong[0] = True
    at = np.flatnonzero(strong)
    h = np.arange(1, noise.size + 1)
    speed = (h * size * strong) ** 2
    breaks = [k for k in np.flatnonzero(np.diff(at) > 4) if speed[at[k + 1] :].sum() <= CORNERS * speed.sum()]
    last = at[breaks[0]] if breaks else at[-1]
    weights = np.where(h <= last + 1, strong, False).astype(float)
    speed *= weights
    upper = (h > (last + 1) / 2) & (h <= last + 1)
    # at a corner the velocity's harmonics fall off as 1 / h, so what is below 1 / h^2 is of none
    matter = np.flatnonzero(strong & (h**3 * size >= np.max(h * size * strong)))[-1]
    runs_out = bool(matter + 4 < noise.size and size[matter] > RUN_OUT * hidden[matter])
    cornered = bool(weights.sum() >= FEWEST_TO_TAPER and speed[upper].sum() > CORNERS * speed.sum())
    if cornered and not runs_out:
        weights[upper] *= np.cos(np.pi / 2 * np.linspace(0, 1, upper.sum() + 2)[1:-1]) ** 2
    return weights, cornered, runs_out


def _crossing(d: np.ndarray) -> tuple[float, float]:
    """Phase of the upward crossing of the mean, and half the peak-to-peak."""
    n = 4096
    u = on_grid(d, n)
    v = u - d[0].real
    following = np.roll(v, -1)
    up = np.flatnonzero((v < 0) & (following >= 0))
    place = (up + v[up] / (v[up] - following[up])) / n
    place -= np.rint(place)
    return float(place[np.argmin(np.abs(place))]), float(np.ptp(u) / 2)


def _residual(averager: Averager, signal: Array, harmonics: np.ndarray) -> Array:
    return signal[averager.index] - evaluate(harmonics[: averager.n_resolved + 1], averager.phase)


def _whole(cut: Cut, residual: Array) -> Array:
    """A residual with zeros for what the first cycle lacks, of the same power, since its spectrum is one of whole
    cycles."""
    lacking = int(np.count_nonzero((cut.phase >= 0.0) & (cut.phase < cut.late)))
    whole = residual.size + lacking
    return np.concatenate([np.zeros(lacking), residual * np.sqrt(whole / residual.size)]) if lacking else residual


def _without_trends(averager: Averager, residual: Array, trends: int) -> Array:
    """Residual less each harmonic's slow change over the record, a polynomial in time of order `trends`.

    Fade or creep would otherwise pass for noise: its sidebands fall off slowly. Of the mean only a steady drift is
    taken off, which would make its error as large as itself; whatever else wanders is noise of the mean.
    """
    tau, total = np.linspace(-1, 1, residual.size), np.zeros(residual.size)
    for order in range(1, trends + 1):
        trend = np.polynomial.legendre.Legendre.basis(order)(tau)
        trend /= np.sqrt(np.mean(trend**2))
        sums = project(averager.phase, [trend * residual], np.zeros(1, dtype=int), averager.n_resolved)[0]
        change = to_complex(sums.T * (2 / residual.size))[0]
        change[0] *= 0.5 if order == 1 else 0.0
        total += trend * evaluate(change, averager.phase)
    return residual - total


def _scatter(phase: Array, residual: Array, n_phase: int, n_cycles: int) -> Array:
    """(n_phase,) standard deviation of the force over cycles near each phase of the grid.

    Samples within half a grid step of the phase, or as wide as one sample in each cycle needs, count; their
    own mean is taken off, so structure finer than the harmonics is not mistaken for scatter.
    """
    reach = max(1, int(np.ceil(n_phase * n_cycles / phase.size)))
    bins = np.rint((phase % 1.0) * n_phase).astype(int) % n_phase
    sums = [np.bincount(bins, w, n_phase) for w in (np.ones_like(residual), residual, residual**2)]
    span = np.arange(-(reach // 2), reach // 2 + 1) if reach > 1 else np.array([0])
    count, first, second = (sum(np.roll(s, k) for k in span) for s in sums)
    count = np.maximum(count, 2)
    return np.sqrt(np.maximum(second - first**2 / count, 0) / (count - 1))
