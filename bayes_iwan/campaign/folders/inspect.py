"""What a campaign shows before any model: energy, stiffness and damping, noise, mains, drift, the drive's harmonics.

Everything here is read off the records. Intervals come from how the cycles scatter; where cycles drift, they hold the
drift as well, which is the honest width for a mean that is none.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal, stats

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.folders.folder import Campaign
from bayes_iwan.campaign.loops.averaging import Loop
from bayes_iwan.campaign.loops.steadiness import SHAPE_HARMONICS, Cycles, cycles_of
from bayes_iwan.screen import on_screen

LEVEL = 0.90  # of the intervals
MAINS_HZ = (50.0, 60.0)
MAINS_OFF_HZ = 0.2  # how far a grid is off its nominal frequency at most
LINE = 5.0  # times the noise floor around it: a spectral line
COINCIDES = 0.02  # of the drive's frequency: mains interference at one of its harmonics
REVERSAL = 0.1  # of the stroke, from each turn on: where friction contacts stick
FEWEST_IN_REVERSAL = 4  # samples that a stiffness at the turn needs
IN_MOTION = 1e-5  # of the strongest harmonic: what is more is motion, of which averaging has taken the noise off
PLAIN_DRIVE = 0.05  # total harmonic distortion up to which a drive is called a sine


@dataclass(frozen=True)
@on_screen
class CycleMean:
    """A mean over cycles and its interval (LEVEL); nan where there is one cycle only."""

    value: float
    low: float
    high: float

    def text(self, digits: int = 4) -> str:
        return f"{self.value:.{digits}g} ({self.low:.{digits}g} to {self.high:.{digits}g})"


@dataclass(frozen=True)
class Line:
    """A spectral line of the force at a mains frequency, between the drive's harmonics: in Hz, amplitude in N.

    order : number of the drive's harmonic that it lies beside, 0 where it stands alone.
    """

    frequency_hz: float
    amplitude_N: float
    order: int


@dataclass(frozen=True)
@on_screen
class Inspection:
    """One test, before any model.

    loop, cycles : the averaged loop and its cycles. energy_mJ : energy lost a cycle, the area of the loop.
    stiffness_N_mm : force over displacement, in phase, of the motion's strongest harmonic, a sine's fundamental.
    loss_factor : the same in quadrature, over it (tan of the loss angle). energy_by_cycle_mJ : (n_cycles,).
    slope_N_mm : the straight part that figures take off, a line through the loop.
    noise_N : RMS of what is left of the force between cycles. spectrum_hz, spectrum_N2_Hz : its power.
    lines : mains lines of the force. drive_harmonics : (H,) size of the displacement's harmonics over the strongest.
    distortion : the total of the others. reversal_samples : samples within the first tenth of the stroke after a turn,
    in one cycle, of the poorer turn.
    """

    loop: Loop
    cycles: Cycles
    energy_mJ: CycleMean
    stiffness_N_mm: CycleMean
    loss_factor: CycleMean
    energy_by_cycle_mJ: Array
    slope_N_mm: float
    noise_N: float
    spectrum_hz: Array
    spectrum_N2_Hz: Array
    lines: tuple[Line, ...]
    drive_harmonics: Array
    distortion: float
    reversal_samples: float

    def __repr__(self) -> str:
        return (
            f"Inspection({self.loop.file!r}: {self.energy_mJ.value:.4g} mJ, {self.stiffness_N_mm.value:.4g} N/mm, "
            f"loss factor {self.loss_factor.value:.3g}, {len(self.notes)} remarks)"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What is said of this test, one line each: what, what it does to an identification, what to do."""
        return self.loop.record.warnings + tuple(_notes(self))


def inspect_campaign(campaign: Campaign) -> tuple[Inspection, ...]:
    """Every test of a campaign, in its order."""
    return tuple(inspect_loop(loop) for loop in campaign.loops(n_blocks=1))


def inspect_loop(loop: Loop) -> Inspection:
    """One averaged test."""
    motion = np.abs(np.fft.rfft(loop.displacement_mm))[1:]
    motion /= motion.max()
    # the energy is that of all harmonics that the motion has: a multisine's sixth is not its last
    each = cycles_of(loop, max(SHAPE_HARMONICS, 1 + int(np.flatnonzero(motion > IN_MOTION)[-1])))
    h = (each.displacement_shapes.shape[1] - 1) // 2
    shapes = (each.displacement_shapes, each.force_shapes)  # whose distance is an RMS
    u, f = (np.sqrt(2.0) * (rows[:, 1 : h + 1] + 1j * rows[:, h + 1 :]) for rows in shapes)
    energy = np.pi * np.sum(np.arange(1, h + 1) * np.imag(f * np.conj(u)), axis=1)
    main = int(np.argmax(motion))
    # noise in a cycle's own displacement would bias a ratio: the mean motion is the divisor
    dynamic = f[:, main] * np.conj(u[:, main]) / np.abs(u[:, main].mean()) ** 2
    stiffness = _over_cycles(dynamic.real)
    loss = _over_cycles(dynamic.imag / dynamic.real.mean())
    left_f = loop.left_over(loop.record.force_N)
    step = float(np.median(np.diff(loop.record.time_s)))
    per_cycle = loop.averager.index.size / loop.n_cycles
    spectrum_hz, spectrum = signal.welch(left_f, 1 / step, nperseg=min(left_f.size, int(8 * per_cycle)))
    return Inspection(
        loop=loop,
        cycles=each,
        energy_mJ=_over_cycles(energy),
        stiffness_N_mm=stiffness,
        loss_factor=loss,
        energy_by_cycle_mJ=energy,
        slope_N_mm=float(np.polyfit(loop.displacement_mm, loop.force_N, 1)[0]),
        noise_N=float(np.std(left_f)),
        spectrum_hz=spectrum_hz[1:],
        spectrum_N2_Hz=spectrum[1:],
        lines=_mains(loop, left_f, 1 / step) if loop.record.clock else (),
        drive_harmonics=motion,
        distortion=float(np.linalg.norm(np.delete(motion, main))),
        reversal_samples=_in_reversal(loop) * per_cycle,
    )


def _over_cycles(values: Array) -> CycleMean:
    n = values.size
    mean = float(values.mean())
    if n < 2:
        return CycleMean(mean, np.nan, np.nan)
    half = float(stats.t.ppf(0.5 + LEVEL / 2, n - 1) * values.std(ddof=1) / np.sqrt(n))
    return CycleMean(mean, mean - half, mean + half)


def _mains(loop: Loop, left: Array, rate_hz: float) -> tuple[Line, ...]:
    """Lines at the mains and its first harmonics that stand out of the noise around them.

    What falls exactly on a harmonic of the drive is part of every cycle, so averaging keeps it and nothing shows here.
    """
    spectrum = np.abs(np.fft.rfft(left * np.hanning(left.size))) * 4 / left.size
    frequency = np.fft.rfftfreq(left.size, 1 / rate_hz)
    out = []
    for at in (mains * order for mains in MAINS_HZ for order in (1, 2, 3)):
        width = max(MAINS_OFF_HZ * at / 50, 2 * frequency[1])
        near = np.abs(frequency - at) < width
        around = (np.abs(frequency - at) < 12 * width) & (np.abs(frequency - at) > 2 * width)
        if at + width > 0.45 * rate_hz or not near.any() or around.sum() < 8:
            continue
        order = round(at / loop.frequency_hz)
        beside = order > 0 and abs(at - order * loop.frequency_hz) < width + COINCIDES * loop.frequency_hz
        floor = float(np.median(spectrum[around])) / 0.83  # a Rayleigh variable's median over its RMS
        if beside:  # slow changes of the loop stand beside every harmonic: the mains must stand out of those as well
            others = np.abs(frequency[:, None] - loop.frequency_hz * np.array([order - 1, order + 1])) < width
            floor = max(floor, float(spectrum[others.any(axis=1)].max(initial=0.0)))
        if spectrum[near].max() > LINE * floor:
            strongest = int(np.argmax(np.where(near, spectrum, 0.0)))
            out.append(Line(float(frequency[strongest]), float(spectrum[strongest]), order if beside else 0))
    return tuple(out)


def _in_reversal(loop: Loop) -> float:
    """Share of the cycle spent in the first tenth of the stroke after a turn; of the faster turn."""
    u = np.interp(
        np.arange(4096) / 4096, np.append(loop.phase, 1.0), np.append(loop.displacement_mm, loop.displacement_mm[0])
    )
    top, bottom = int(np.argmax(u)), int(np.argmin(u))
    reach = REVERSAL * np.ptp(u)
    down = np.roll(u, -top) < u[top] - reach
    up = np.roll(u, -bottom) > u[bottom] + reach
    return min(int(np.argmax(down)), int(np.argmax(up))) / 4096


def _notes(test: Inspection) -> list[str]:
    notes = []
    if test.reversal_samples < FEWEST_IN_REVERSAL:
        notes.append(
            f"{test.reversal_samples:.1f} samples in the tenth of the stroke after a turn: the stiffness of sticking "
            "contacts is read off these; sample faster"
        )
    for line in test.lines:
        notes.append(
            f"mains in the force: {line.amplitude_N:.2g} N at {line.frequency_hz:.4g} Hz. "
            + (
                f"It lies on harmonic {line.order} of the drive, so part of it is taken for the specimen's force; "
                "choose a frequency that does not divide it"
                if line.order
                else "It averages out over cycles, but widens intervals; ground the sensor's cable"
            )
        )
    if test.distortion > PLAIN_DRIVE:
        worst = 1 + int(np.argsort(test.drive_harmonics)[-2])
        notes.append(
            f"the drive is no sine: {test.distortion:.1%} distortion, most in harmonic {worst} "
            f"({test.drive_harmonics[worst - 1]:.1%}). The model is driven with the motion as it was; formulas for "
            "sines are not"
        )
    signal_N = float(np.std(test.loop.force_N))
    if test.noise_N > 0.05 * signal_N:
        notes.append(
            f"noise of {test.noise_N:.2g} N is {test.noise_N / signal_N:.0%} of the force: intervals widen with it; "
            "record more cycles or a larger amplitude"
        )
    return notes
