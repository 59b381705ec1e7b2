"""A channel in the campaign's working unit, and its times in seconds, with lines that say where both come from."""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.importing.formats.stamps import unwrapped
from bayes_iwan.campaign.importing.recipe import Recipe
from bayes_iwan.campaign.importing.recordings import Channel, Recording
from bayes_iwan.campaign.importing.unit_texts import FULL_SCALE, converted, decimal_point
from bayes_iwan.campaign.loops.checks import check_epoch, contradicts, on_grid_of_rate, usual_step
from bayes_iwan.campaign.recording.records import CampaignError

#: of the years 1982 to 2053, by Excel, by MATLAB and by astronomers (Julian days)
DAY_NUMBERS = (30_000.0, 60_000.0), (715_000.0, 750_000.0), (2_445_000.0, 2_471_000.0)
#: of 1992 to 2052, in seconds since 1970; the ticks of .NET, of 100 ns since the year 1, are ns of 1990 today
YEARS_S = 7e8, 2.6e9
SINCE_1970 = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SINGLE_S = {"s": 1.0, **SINCE_1970, "min": 60.0, "hour": 3600.0, "day": 86_400.0}
FEW_REPEATED = 0.02  # of the times: more of them are rounded
SAME_RATE = 1e-4  # two statements of a sample rate that differ by more contradict each other


def scaled(channel: Channel, role: str, recipe: Recipe, where: str) -> tuple[Array, str, str]:
    """A channel in the campaign's working unit, that unit, and a line that says what was done."""
    stated_unit = recipe.units.get(role, channel.unit)
    sensitivity, gain = recipe.sensitivities.get(role, ""), float(recipe.gains.get(role, 1.0))
    if channel.unit == FULL_SCALE and not any(x.isdigit() for x in stated_unit):
        example = f"50 {'V' if sensitivity else stated_unit}"
        raise CampaignError(
            f"{where}: {channel.name!r} is in shares of full scale: say what that is with its number, --unit "
            f'"{role}={example}" where it is {example}'
        )
    values, unit = converted(channel.values, stated_unit, sensitivity, role, f"{where}: {channel.name!r}")
    values = values / (-gain if role in recipe.reverse else gain)
    how = [stated_unit or "no unit: taken for V"]
    how += [decimal_point(sensitivity)] if sensitivity else []
    how += [f"gain {gain:g}"] if gain != 1.0 else []
    how += ["reversed"] if role in recipe.reverse else []
    some = values[np.isfinite(values)]
    if not some.size:
        raise CampaignError(f"{where}: {channel.name!r} holds no number")
    if some.min() == some.max():
        raise CampaignError(f"{where}: {channel.name!r} stays at {some[0]:.4g} {unit}: a dead or wrong channel?")
    return values, unit, f"{role}: {channel.name!r} ({', '.join(how)}), {some.min():.4g} to {some.max():.4g} {unit}"


def times_of(
    channel: Channel, clock: Channel | None, recording: Recording, recipe: Recipe
) -> tuple[Array, float | None, list[str], tuple[str, ...]]:
    """A channel's times in s, the sample rate if there is one, lines that say where they come from, and warnings."""
    where, n = recording.where, channel.values.size
    warnings: tuple[str, ...] = ()
    if not recipe.clock:
        said = "time: none; a cycle is the unit of time, and nothing says a frequency"
        return np.arange(n, dtype=float), None, [said], ()
    asked, from_file = recipe.rate_hz, channel.rate_hz or recording.rate_hz
    if clock is None:
        if asked is not None and from_file is not None and abs(asked / from_file - 1) > SAME_RATE:
            raise CampaignError(
                f"{where}: the file says {from_file:g} samples a second, you say {asked:g}; which is right?"
            )
        known = asked or from_file or 1.0
        return np.arange(n) / known + (channel.start_s or 0.0), known, [f"time: {known:.9g} samples a second"], ()
    if clock.values.size != n:
        raise CampaignError(f"{where}: {clock.name!r} has {clock.values.size} samples, {channel.name!r} has {n}")
    raw, wrapped = unwrapped(clock.values)
    stated = recipe.units.get("time", clock.unit)
    unit = stated or moments_unit(raw) or _unit_of_rate(raw, asked or from_file)
    if unit == "day":
        raw = raw - np.floor(np.nanmin(raw))  # from midnight: no date is asked for
    time, _ = converted(raw, unit, "", "time", f"{where}: {clock.name!r}")
    lines = [f"time: {clock.name!r}: {wrapped}"] if wrapped else []
    rate: float | None = asked or from_file
    _refuse_falling(time, clock.name, where, np.less)
    if rate is not None and contradicts(time[np.isfinite(time)], rate):
        rounded = (np.diff(time) >= 0).all() and (np.diff(time) == 0).any()
        if not rounded and (asked or not stated):
            raise CampaignError(
                f"{where}: {rate:g} samples a second {'as you say' if asked else 'by the file'}, "
                f"{_usual_rate(time):.6g} by {clock.name!r}{'' if stated else ', which has no unit'}: say it with "
                '--unit "time=UNIT", or leave the time out with --time none'
            )
        if not rounded:
            warnings = (f"the file says {rate:g} samples a second, its time {_usual_rate(time):.6g}: the time is used",)
            rate = None
    if rate is not None:
        same = int(np.count_nonzero(np.diff(time) == 0))
        if 0 < same <= FEW_REPEATED * n:
            warnings += (
                f"{clock.name!r} repeats {same} time(s): a row written twice, or lost? Rows are taken as even",
            )
        time = on_grid_of_rate(time, rate)
    start = float(time[np.flatnonzero(np.isfinite(time))[:1]].sum())
    if "time" not in recipe.units:
        check_epoch(where, start, "Say --unit time=ms")
    _refuse_falling(time, clock.name, where, np.less_equal)
    shared = recording.rate_hz is None and channel.rate_hz is None and asked is None
    per_second = f"{_usual_rate(time):.6g} samples a second"
    taken = unit if stated else f"no unit: taken for {unit}"
    if unit == "s" and not stated and rate is None:
        warnings += (f'{clock.name!r} states no unit and is taken for {unit}: else say --unit "time=min"',)
    return time, None if shared else rate, [*lines, f"time: {clock.name!r} ({taken}), {per_second}"], warnings


def _refuse_falling(time: Array, name: str, where: str, falls: np.ufunc) -> None:
    """Raise CampaignError where a time (n,) goes back, or (falls : np.less_equal) repeats."""
    known = np.flatnonzero(np.isfinite(time))
    if (wrong := falls(np.diff(time[known]), 0.0)).any():
        a, b = known[int(np.argmax(wrong)) :][:2]
        raise CampaignError(
            f"{where}: the time {name!r} does not increase at sample {b + 1} ({time[a]:.12g} s, then "
            f"{time[b]:.12g} s): neither a counter that starts again nor a new run. Name another with --time NAME, "
            "or leave it out with --time none --sample-rate HZ"
        )


def moments_unit(time: Array) -> str:
    """The unit of a time without one that counts days, as Excel and MATLAB do (in seconds its rate would be in MHz), or
    a fraction of a second since 1970; "" for another."""
    start = float(np.nanmedian(time)) if np.isfinite(time).any() else 0.0
    if any(low < start < high for low, high in DAY_NUMBERS) and _usual_rate(time) > 1e5:
        return "day"
    return next((unit for unit, size in SINCE_1970.items() if YEARS_S[0] < start * size < YEARS_S[1]), "")


def _unit_of_rate(time: Array, rate: float | None) -> str:
    """The unit of a time without one by which its steps are, but for what rounding does to the ends of a short record,
    those of a known rate; s where there is none."""
    steps = _usual_rate(time) / (rate or np.nan)
    return next((unit for unit, size in SINGLE_S.items() if 0.8 < steps / size < 1.25), "s")


def _usual_rate(time: Array) -> float:
    known = time[np.isfinite(time)]
    step = usual_step(known) if known.size > 1 else 0.0
    return 1 / step if step > 0 else np.inf
