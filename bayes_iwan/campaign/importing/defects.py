"""What recorders do to a channel and a reader must not take for numbers: range passed, values held."""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.loops.averaging import FEWEST_PER_CYCLE

OVER = 9e36  # SCPI writes 9.9E37 and 9.91E37 where the range is passed or there is no number
FAR = 20.0  # times the range of all other values: a code, no measurement
#: what a converter of so many bits writes where its range is passed
END_CODES = frozenset(
    x for bits in (12, 14, 16, 18, 20, 24, 32) for x in (2**bits - 1, 2 ** (bits - 1) - 1, -(2 ** (bits - 1)))
)
#: jumps of a number that overflows, at least, and their share of all jumps: noise makes some reversals look like them
FEWEST_WRAPS, MOST_WRAP = 6, 0.8


def without_codes(values: Array, name: str) -> tuple[Array, tuple[str, ...]]:
    """The samples (n,) with NaN for what says "range passed" or "no number", and what was found."""
    over = np.isinf(values) | (np.abs(np.nan_to_num(values, posinf=np.inf, neginf=-np.inf)) >= OVER)
    notes = []
    if n := int(np.count_nonzero(over)):
        notes.append(
            f"{n} sample(s) of {name!r} say that the range was passed (infinite, or 9.9E37): dropped, so the highest "
            "values are missing. Raise the range (lower the gain) and record again"
        )
        values = np.where(over, np.nan, values)
    known = values[np.isfinite(values)]
    codes = (known.max(), known.min()) if known.size > 16 else ()
    others = known[~np.isin(known, codes)]  # the range may be passed at both ends
    if others.size > 8 and (span := float(np.ptp(others))) > 0:
        for code in dict.fromkeys(codes):
            n, end = int(np.count_nonzero(known == code)), code in END_CODES
            if (n > 1 or end) and abs(code - float(np.median(others))) > FAR * span:
                what = "the end code of a converter whose range was passed" if end else "a code"
                notes.append(
                    f"{n} sample(s) of {name!r} read exactly {code:.10g}, far from all others: {what}, dropped"
                )
                values = np.where(values == code, np.nan, values)
    return values, tuple(notes)


def wrapped_round(values: Array, name: str) -> str:
    """A word where a channel (n,) jumps from one end of its range to the other and goes on the way that it went before
    the jump: an integer that overflowed. Friction that reverses goes on the way that it jumped; with a few samples a
    cycle the next step is a jump, too."""
    step = np.diff(values)
    jump, before, after = np.sign(step[1:-1]), np.sign(step[:-2]), np.sign(step[2:])
    far = np.abs(step) > 0.5 * (np.nanmax(values) - np.nanmin(values))
    wraps = far[1:-1] & ~far[:-2] & ~far[2:] & (before == -jump) & (after == -jump)
    n = int(np.count_nonzero(wraps))
    if n < FEWEST_WRAPS or n < MOST_WRAP * np.count_nonzero(far):
        return ""
    one_way = abs(jump[wraps].sum()) == n  # what goes past its range and comes back jumps both ways
    return f"{name!r} jumps {n} times from one end of its range to the other and goes on as before: " + (
        "a counter or an angle that starts again, or a sawtooth, which no drive follows. Export it counted on, or the "
        "motion that was measured"
        if one_way
        else "an integer that overflowed. Export it with more bits or as decimals"
    )


def few_a_cycle(values: Array, name: str) -> str:
    """A word where a motion (n,) jumps over half of its range more often than a drive of jumps, twice a cycle, could
    with as many samples a cycle as a loop needs."""
    jumps = np.count_nonzero(np.abs(np.diff(values)) > 0.5 * (np.nanmax(values) - np.nanmin(values)))
    if jumps <= 2.0 / FEWEST_PER_CYCLE * values.size:
        return ""
    return (
        f"{name!r} jumps over half of its range at {100 * jumps / values.size:.0f} % of its samples: a few samples a "
        f"cycle, perhaps of a faster motion (aliased); at least {FEWEST_PER_CYCLE:g} a cycle are "
        "needed. Sample faster"
    )


def without_repeats(values: Array, name: str) -> tuple[Array, tuple[str, ...]]:
    """The samples (n,) with NaN for those that only repeat the one before, in a slower channel that is held.

    Runs of equal values have one length then (or two, one apart); a coarse step makes runs of many lengths.
    """
    change = np.flatnonzero(values[1:] != values[:-1]) + 1
    length = np.diff(change)
    if length.size < 12:
        return values, ()
    usual = int(np.bincount(length).argmax())
    mean = float(length.mean())
    whole = usual > 1 and np.mean(length % usual == 0) > 0.9 and np.mean(length == usual) > 0.4
    low = int(np.floor(mean))
    broken = 1.2 < mean and np.mean((length == low) | (length == low + 1)) > 0.97 and np.mean(length == low) < 0.9
    jumps = np.abs(np.diff(values[change]))
    one_by_one = jumps.size and np.ptp(jumps) <= 1e-6 * jumps.max()  # levels: steps of the converter
    if one_by_one or not (whole or broken):
        return values, ()
    starts = np.concatenate([[0], change]) if not whole or change[0] == usual else change
    kept = np.zeros(values.size, dtype=bool)
    if whole:
        for first, n in zip(starts, np.diff(np.append(starts, values.size))):
            kept[first : first + n : usual] = True
        often = f"{usual}"
    else:
        kept[starts] = True
        often = f"{low} or {low + 1}"
    late = (mean if broken else usual) / 2 - 0.5
    said = (
        f"{name!r} repeats each value {often} times: a slower channel that is held, late by {late:.3g} samples. Only "
        "the first of each is kept, as the one that is on time; check the delay between the channels"
    )
    return np.where(kept, values, np.nan), (said,)
