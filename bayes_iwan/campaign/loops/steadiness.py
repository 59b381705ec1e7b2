"""Whether the cycles of a record are alike: what a recorder, a cable or a drive did to some of them.

A loop is an average. Lost rows, a drop-out, a frozen channel, a step or a clock that drifts enter it as a different
loop, and a model is then fitted to it. Every quantity is taken cycle by cycle and held against its own scatter: only
what stands out of that, and is large enough to matter, is said or refused. Changes over cycles that a specimen may
show by itself (fade, creep) are said, never refused.
"""

from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import Loop
from bayes_iwan.campaign.recording.records import CampaignError
from bayes_iwan.campaign.timing.cycles import cycle_shapes
from bayes_iwan.campaign.timing.harmonics import white_noise
from bayes_iwan.screen import on_screen

SHAPE_HARMONICS = 6  # by which cycles are compared
FEWEST = 6  # cycles below which scatter over cycles says nothing
SIGMAS = 8.0  # of its own scatter: what stands out
JUMP, LARGE_JUMP = 0.01, 0.05  # of a cycle: a jump of phase that is said, and one that is refused
ALONE = 5.0  # times all others that one cycle is shorter or longer
CLOCK = 0.006  # of a cycle: the bow of the phase that a drifting frequency makes
AMPLITUDE = 0.01  # of the drive's amplitude: change over the record that is said
FORCE = 0.02  # of the force's amplitude: the same
STEP = 0.02  # of a channel's height: a step of its mean
ALTERNATING = 0.01  # of a channel's size: difference of odd and even cycles, halved
OFF = 0.03  # of a channel's height: a stretch that is off the other cycles
FLAT_SAMPLES = 5  # a stretch off the others that does not move for so many samples: dead, frozen or dropped out


@dataclass(frozen=True)
@on_screen
class Cycles:
    """A record's kept cycles one by one.

    number, time_s : (n,) number of each cycle and time of its middle. phase_error : (n,) in cycles, how far the
    displacement is ahead of an even clock. amplitude_mm, mean_mm, force_amplitude_N, force_mean_N : (n,), the
    amplitudes are those of the fundamental.
    displacement_shapes, force_shapes : (n, 2 H + 1) harmonics, their distance an RMS.
    """

    number: np.ndarray
    time_s: Array
    phase_error: Array
    amplitude_mm: Array
    mean_mm: Array
    force_amplitude_N: Array
    force_mean_N: Array
    displacement_shapes: Array
    force_shapes: Array


def cycles_of(loop: Loop, n_harmonics: int = SHAPE_HARMONICS) -> Cycles:
    """The cycles that a loop was averaged over, by so many harmonics as their samples resolve."""
    record, cut = loop.record, loop.cut
    number = cut.cycles
    resolved = max(1, int(0.4 * cut.index.size / number.size))
    # of a multisine the strongest harmonic tells: its fundamental may be nothing
    order = 1 + int(np.argmax(np.abs(np.fft.rfft(loop.displacement_mm)[1 : resolved + 1])))
    n_shape = min(max(n_harmonics, order), resolved)
    # what the force still shows of the time before the record is none of its first cycle: the next one's part stands in
    before = (cut.phase >= 0) & (cut.phase < cut.late)
    force = np.where(before, np.interp(cut.phase + 1, cut.phase, record.force_N), record.force_N)
    u, f = cycle_shapes(cut.phase, number, [record.displacement_mm, force], n_shape)
    middle = np.interp(number + 0.5, cut.phase, record.time_s)
    strongest = u[:, order] + 1j * u[:, order + n_shape]
    ahead = np.angle(strongest / strongest.sum()) / (2 * np.pi * order)
    # the phase that follows the crossings hides their wander: the clock's line is taken off the times instead
    line = np.polynomial.Polynomial.fit(number, middle, 1)
    ahead = ahead - (middle - line(number)) * cut.frequency_hz

    def size(rows: Array) -> Array:
        return np.asarray(np.sqrt(2.0) * np.hypot(rows[:, order], rows[:, order + n_shape]))

    return Cycles(number, middle, ahead, size(u), u[:, 0], size(f), f[:, 0], u, f)


def disturbances(loop: Loop) -> list[str]:
    """What is said of the cycles of a record, one line each: what, what it does, what to do.

    Raises CampaignError for a jump of phase of more than LARGE_JUMP and for stretches in which a channel is dead.
    """
    each = cycles_of(loop)
    stretches: list[str] = []
    for name, values, mean_loop in (
        ("displacement", loop.record.displacement_mm, loop.displacement_mm),
        ("force", loop.record.force_N, loop.force_N),
    ):
        stretches += _stretches(loop, name, values, float(np.ptp(mean_loop)))
    if loop.n_cycles < FEWEST:  # a channel that is dead for a while is seen among three, what is off by some is not
        notes = _jumped(loop, *_short_cycle(loop)) if loop.record.clock else []
        return notes + _drive_amplitude(loop, each) + _force_amplitude(loop, each)
    notes = _phase(loop, each) if loop.record.clock else []
    notes += _drive_amplitude(loop, each)
    notes += _force_amplitude(loop, each)
    for name, unit, mean, height in (
        ("displacement", "mm", each.mean_mm, np.ptp(loop.displacement_mm)),
        ("force", "N", each.force_mean_N, np.ptp(loop.force_N)),
    ):
        notes += _step(loop, name, unit, each, mean, float(height))
    return notes + _alternating(each) + stretches


def _outlying(values: Array, floor: float) -> tuple[int, float]:
    """Largest change across one cycle, as (index of that cycle, change); (-1, 0) where none stands out."""
    change = values[2:] - values[:-2]
    change = change - np.median(change)
    k = int(np.argmax(np.abs(change)))
    scale = 1.4826 * float(np.median(np.abs(change)))
    if abs(change[k]) <= max(floor, SIGMAS * (1 + 8 / change.size) * scale):  # few cycles: a scatter of its own
        return -1, 0.0
    return k + 1, float(change[k])


def _short_cycle(loop: Loop) -> tuple[int, float]:
    """The cycle that is shorter or longer than all others, which agree, as (its index, by how many cycles the phase
    jumps in it); (-1, 0) where there is none. Of few cycles no median of changes shows it."""
    number = np.append(loop.cut.cycles, loop.cut.cycles[-1] + 1)
    lasting = np.diff(np.interp(number, loop.cut.phase, loop.record.time_s)) / np.diff(number)
    apart = 1.0 - lasting / np.median(lasting)
    k = int(np.argmax(np.abs(apart)))
    alone = lasting.size > 2 and abs(apart[k]) > max(LARGE_JUMP, ALONE * np.max(np.abs(np.delete(apart, k))))
    return (k, float(apart[k])) if alone else (-1, 0.0)


def _jumped(loop: Loop, k: int, jump: float) -> list[str]:
    """What is said of a jump of the phase in the k-th cycle, nothing for k < 0. Raises CampaignError for a large
    one."""
    if k < 0:
        return []
    at = np.interp(loop.cut.cycles[k] + 0.5, loop.cut.phase, loop.record.time_s)
    what = f"the phase of both channels jumps by {360 * jump:+.0f}° near {at:.5g} s"
    if abs(jump) > LARGE_JUMP:
        raise CampaignError(
            f"{loop.file}: {what}, but the times do not: rows are missing (about "
            f"{(jump % 1) / loop.frequency_hz:.3g} s), or two records were joined. List the parts before and after "
            "as two records"
        )
    return [f"{what}: rows lost, or records joined? The averaged loop is smeared there; list the parts as two records"]


def _phase(loop: Loop, each: Cycles) -> list[str]:
    e = each.phase_error
    if jumped := _jumped(loop, *_outlying(e, JUMP)) or _jumped(loop, *_short_cycle(loop)):
        return jumped
    x = np.linspace(-1, 1, e.size)
    basis = np.polynomial.legendre.legvander(x, 2)
    found = np.linalg.lstsq(basis, e, rcond=None)[0]
    bow = 1.5 * float(found[2])
    error = float(np.std(np.diff(e)) / np.sqrt(2 * e.size))
    if abs(bow) > max(CLOCK, 6 * error):
        change = 8 * bow / (each.number[-1] - each.number[0] + 1)
        return [
            f"the frequency drifts by {100 * change:+.2g} % over the record (drive, clock, or lost rows): the loop is "
            f"averaged at its mean, {loop.frequency_hz:.5g} Hz; check the generator and the recorder's clock"
        ]
    wander = float(np.ptp(np.percentile(e - basis @ found, [5, 95])))
    if wander > JUMP:
        return [
            f"the phase wanders by {360 * wander:.0f}° from an even clock (lost rows, or a drive without a clock): "
            + ("the loop is smeared" if loop.cut.constant else "it is followed crossing by crossing")
            + "; look at the drive or the recorder"
        ]
    return []


def _spread(values: Array) -> float:
    return float(np.ptp(np.percentile(values, [5, 95])) / np.median(values))


def _change(each: Cycles, values: Array) -> str:
    """How a cycle-by-cycle quantity goes: straight up or down, or back and forth."""
    trend = float(np.corrcoef(each.number, values)[0, 1])
    change = _spread(values)
    return (
        f"drifts by {100 * np.sign(trend) * change:+.2g} %" if abs(trend) > 0.8 else f"varies by {100 * change:.2g} %"
    )


def _drive_amplitude(loop: Loop, each: Cycles) -> list[str]:
    spread, size = _spread(each.amplitude_mm), float(np.median(each.amplitude_mm))
    # of few cycles any change may be noise
    alternates = each.number.size < FEWEST or white_noise(each.amplitude_mm) > spread * size / 4
    if spread <= AMPLITUDE or (alternates and spread <= 6 * _white(loop, loop.record.displacement_mm)):
        return []
    return [
        f"the drive's amplitude {_change(each, each.amplitude_mm)} over the cycles: changes of the force of that size "
        "are the drive's, not the specimen's; steady the drive or keep a part that is steady"
    ]


def _white(loop: Loop, values: Array) -> float:
    """Error of one cycle's amplitude, relative, that white noise of the record would make."""
    per_cycle = loop.averager.index.size / loop.n_cycles
    return float(white_noise(values) * np.sqrt(2 / per_cycle) / max(np.std(values) * np.sqrt(2), 1e-300))


def when(loop: Loop, time_s: float) -> str:
    """A place in a record: its time, or its cycle where there is no clock."""
    return f"{time_s:.6g} s" if loop.record.clock else f"cycle {time_s:.0f}"


def _force_amplitude(loop: Loop, each: Cycles) -> list[str]:
    size = each.force_amplitude_N / np.median(each.force_amplitude_N)
    drive = each.amplitude_mm / np.median(each.amplitude_mm)
    own = size - drive
    k, jump = _outlying(own, FORCE) if own.size >= FEWEST else (-1, 0.0)
    if k > 0:
        return [
            f"the force's amplitude changes by {100 * jump:+.2g} % at once near {when(loop, each.time_s[k])}: a gain "
            "was switched, or something slipped; the loop is a mixture. List the parts as two records"
        ]
    # the noise of samples, not the cycles' own scatter: a beat is a scatter too
    noise = _white(loop, loop.record.force_N)
    # what the drive does, the force need not follow: it changes by itself where it does so with and without the drive
    spread = min(float(np.ptp(np.percentile(x, [5, 95]))) for x in (own, size))
    if spread <= max(FORCE, 5 * noise):
        return []
    mains = ", a gain that drifts, or mains interference near the drive's frequency"
    return [
        f"the force's amplitude {_change(each, size)} over the cycles while the drive holds: a specimen that runs in, "
        f"warms or fades{mains if loop.record.clock else ', or a gain that drifts'}; run in for longer, or let "
        "`diagnose` look for it"
    ]


def late_by(loop: Loop, degrees: float) -> str:
    """An angle of the cycle as a time in brackets, nothing where there is no clock."""
    if not loop.record.clock:
        return ""
    late_s = abs(degrees) / 360 / loop.frequency_hz
    return f" ({1e3 * late_s:.2g} ms)" if late_s < 1 else f" ({late_s:.3g} s)"


def _step(loop: Loop, name: str, unit: str, each: Cycles, mean: Array, height: float) -> list[str]:
    k, step = _outlying(mean, STEP * height)
    if k < 0:
        return []
    return [
        f"the {name}'s mean steps by {step:+.3g} {unit} near {when(loop, each.time_s[k])}: a mount that slipped, or a "
        "channel that jumped; the mean of the loop is of neither part. List the parts as two records"
    ]


def _alternating(each: Cycles) -> list[str]:
    """Odd and even cycles that differ: the motion repeats only after two cycles."""
    for name, rows in (("displacement", each.displacement_shapes), ("force", each.force_shapes)):
        odd = each.number % 2 == 1
        if min(odd.sum(), (~odd).sum()) < 3:
            continue
        # neighbours' mean takes slow changes off
        off = rows[1:-1] - (rows[:-2] + rows[2:]) / 2
        signs = np.where(odd[1:-1], 1.0, -1.0)
        half = np.mean(signs[:, None] * off, axis=0) / 2
        scatter = float(np.sqrt(np.mean(np.sum((off - 2 * signs[:, None] * half) ** 2, axis=1)) / len(off)) / 2)
        size = float(np.median(np.linalg.norm(rows[:, 1:], axis=1)))
        if np.linalg.norm(half) > max(ALTERNATING * size, 5 * scatter):
            share = float(np.linalg.norm(half)) / size
            return [
                f"odd and even cycles of the {name} differ by {200 * share:.2g} %: the motion repeats only after two "
                "cycles (a subharmonic, rocking, play, or mains interference); the loop is the mean of both. Look at "
                "the drive and the mounting"
            ]
    return []


def _stretches(loop: Loop, name: str, values: Array, height: float) -> list[str]:
    """Stretches off the same phases of the other cycles: drop-outs, frozen and dead channels, knocks."""
    index, phase = loop.averager.index, loop.averager.phase
    left = loop.left_over(values)
    per_cycle = index.size / loop.n_cycles
    n_bins = int(np.clip(per_cycle / 3, 4, 64))
    row = np.searchsorted(loop.cut.cycles, np.floor(phase))
    cell = row * n_bins + np.minimum((phase % 1.0 * n_bins).astype(int), n_bins - 1)
    count = np.bincount(cell, minlength=loop.n_cycles * n_bins)
    table = np.bincount(cell, left, loop.n_cycles * n_bins) / np.maximum(count, 1)
    table[count == 0] = np.nan
    table = table.reshape(loop.n_cycles, n_bins)
    table[:, np.isnan(table).all(axis=0)] = 0.0  # phases that no cycle has a sample of
    off = np.abs(table - np.nanmedian(table, axis=0))
    scale = 1.4826 * np.maximum(np.nanmedian(off, axis=0), np.nanmedian(off))
    # a recorder of coarse steps stays on one of them, and then is off by no more than that step
    steps = np.diff(np.unique(values[index]))
    step = float(np.median(steps)) if steps.size else 0.0
    bad = (off > np.maximum(max(OFF * height, step), SIGMAS * scale)).ravel()[cell]
    if not bad.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    time = loop.record.time_s
    kept = values[index]
    still = np.abs(np.diff(kept)) <= 1e-9 * height
    rests = max(FLAT_SAMPLES - 1, _longest(still & ~bad[1:]) + 1)  # as coarse steps make them in every cycle
    for a, b in runs:
        if _longest(still[max(a - FLAT_SAMPLES, 0) : b + FLAT_SAMPLES - 1]) >= rests:
            raise CampaignError(
                f"{loop.file}: the {name} stands still where it moves in other cycles, near "
                f"{when(loop, time[index[a]])} to {when(loop, time[index[b - 1]])} ({len(runs)} such stretch(es)): "
                "dead, frozen or dropped out. Delete these lines (a short gap is bridged), or fix the channel"
            )
    share = float(bad.mean())
    return [
        f"the {name} is off the other cycles in {len(runs)} stretch(es), {share:.2g} of the record, the first at "
        f"{when(loop, time[index[runs[0][0]]])}: it is averaged in; a drop-out or knock? Delete these lines, the gaps "
        "are bridged"
    ]


def _longest(true: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))
