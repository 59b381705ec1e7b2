"""Dates and times of day in text columns, as seconds: 12-hour clocks, minutes as Excel shows them, midnight."""

import re
from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayes_iwan.arrays import Array

_DATE = r"\d{1,4}[-./ ](?:\d{1,2}|[A-Za-z]{3})[-./ ]\d{1,4}"
_TIME = r"\d{1,2}:\d{1,2}(?::\d{1,2})?(?:[.,:]\d+)?(?: ?[AaPp]\.?[Mm]\.?)?"
_ZONE = r"(?:Z|[+-]\d\d:?\d\d| (?:UTC|GMT))?"
STAMP = re.compile(rf"(?:{_DATE})?(?:[ T,]+)?(?:{_TIME})?{_ZONE}(?<=\w\w|\w\.)")
_DATE_ONLY = re.compile(rf"({_DATE})(?:[ T]0?0:00(?::00(?:[.,]0+)?)?)?")  # spreadsheets write midnight behind it
_PARTS = (
    rf"^(?:(?P<date>{_DATE})[ T,]+)?(?P<a>\d{{1,2}}):(?P<b>\d{{1,2}})(?::(?P<c>\d{{1,2}}))?(?:[.,:](?P<f>\d+))?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?" + _ZONE + "$"
)
#: year, month and day as dates order them, where two make sense the first
_ORDERS = "Ymd Ybd ymd dmY dbY dmy dby mdY bdY mdy bdy".split()
#: 20240301 115958.123, 20240301T115958
_COMPACT = re.compile(r"^(\d{4})(\d\d)(\d\d)[ T_-](\d\d)(\d\d)(\d\d)(?!\d)")
_SPELT = r"\1-\2-\3 \4:\5:\6"
_DAYS = re.compile(r"^\d+ days? |^\d+\.(?=\d\d:\d\d:)")  # 0 days 00:00:01.5; that midnight passed shows anyway
_DAY_S = 86_400.0
#: at which counters and times of day start again
WRAPS = (2.0**16, 6e4, 3.6e6, 8.64e7, 2.0**24, 2.0**32, 1e3, 1e6, 1e9, 60.0, 3600.0, 43_200.0, _DAY_S, 604_800.0)


def is_stamp(cell: str) -> bool:
    """Whether a cell is a date, a time of day or both."""
    cell = _DAYS.sub("", _COMPACT.sub(_SPELT, cell))
    return any(c in cell for c in ":-./ ") and bool(STAMP.fullmatch(cell)) and not re.fullmatch(r"[\d.]*", cell)


def is_date(cell: str) -> bool:
    """Whether a cell is a date alone, or its midnight."""
    return bool(_DATE_ONLY.fullmatch(cell.strip()))


def seconds(cells: Sequence[str], dates: Sequence[str] | None = None) -> tuple[Array, str, float] | None:
    """(n,) seconds from the first stamp, what was done to them ("" for nothing), and the first stamp in seconds since
    1970, or since midnight where there is no date; None for what is no time of day.

    dates : a column of dates beside a column of times.
    """
    plain = pd.Series(list(cells)).str.strip().str.replace(_COMPACT, _SPELT, regex=True)
    parts = plain.str.replace(_DAYS, "", regex=True).str.extract(_PARTS)
    if parts["a"].isna().any():
        return None
    a, b = parts["a"].astype(float).to_numpy(), parts["b"].astype(float).to_numpy()
    has_c = parts["c"].notna()
    c = parts["c"].fillna("0").astype(float).to_numpy()
    digits = parts["f"].fillna("0")
    fraction, counted = (
        ("0." + x).astype(float).to_numpy() for x in (digits, digits.str.zfill(digits.str.len().max()))
    )
    whole = 60.0 * b + c
    if np.count_nonzero(np.diff(whole + counted) < 0) < np.count_nonzero(np.diff(whole + fraction) < 0):
        fraction = counted  # milliseconds without their zeros: 1.5 is before 1.10
    said = ""
    if not has_c.any() and parts["f"].notna().any():  # 12:34.5, as Excel shows minutes and seconds
        out, wrap = 60.0 * a + b + fraction, 3600.0
        said = "minutes and seconds"
    else:
        half = parts["half"].str.lower()
        if half.notna().any():
            a = a % 12 + 12.0 * (half == "p").to_numpy()
        out, wrap = 3600.0 * a + 60.0 * b + c + fraction, _DAY_S
    time, note = unwrapped(out, [wrap] if wrap < _DAY_S else [_DAY_S, _DAY_S / 2])
    days = _days(dates if dates is not None else parts["date"].tolist())
    if days is not None:
        whole = (days - days[0]) * _DAY_S + out
        if dates is None or goes_on(np.diff(whole)).all():
            time, note = whole, ""
        else:  # the date may change late or early: it counts where the time of day does not go on by itself
            steps = np.diff(time)
            by_itself, more = goes_on(steps), np.rint(np.diff(whole) - steps)
            note = "the date does not change at midnight: the time of day is followed" if more[by_itself].any() else ""
            time = time + np.append(0.0, np.cumsum(np.where(by_itself, 0.0, more)))
        out = out + days[0] * _DAY_S
    return time - time[0], "; ".join(x for x in (said, note) if x), float(out[0])


def usual_step(steps: Array) -> float:
    """The median of the steps (n,) forward; 0 where there are none."""
    return float(np.median(forward)) if (forward := steps[steps > 0]).size else 0.0


def goes_on(steps: Array, usual: float | None = None) -> Array:
    """Whether each step (n,) is a usual one forward, or up to three of them."""
    usual = usual_step(steps) if usual is None else usual
    return np.asarray(np.abs(steps - usual) <= 2.0 * usual)


def unwrapped(values: Array, wraps: Sequence[float] = WRAPS) -> tuple[Array, str]:
    """A clock (n,) that starts again at one of some periods, counted on; with a word on what was done.

    It wraps where a step back and the period together are a usual step forward; other steps back stay as they are.
    """
    steps = np.diff(values)
    back, usual = np.flatnonzero(steps < 0), usual_step(steps)
    if not back.size or not usual or not np.isfinite(values).all():
        return values, ""
    for wrap in wraps:
        if goes_on(steps[back] + wrap, usual).all():
            jumps = np.zeros(values.size)
            jumps[back + 1] = wrap
            said = f"the clock starts again after {wrap:.10g} {back.size} time(s): counted on"
            return values + np.cumsum(jumps), said
    return values, ""


def _days(dates: Sequence[object]) -> Array | None:
    """(n,) days since 1970, the order of day and month being that which makes the record shorter; None for no dates."""
    if any(not isinstance(x, str) for x in dates):
        return None
    unique = sorted({str(x).strip() for x in dates})
    plain = pd.Series(unique).str.replace(f"^{_DATE_ONLY.pattern}$", r"\1", regex=True)
    plain = plain.str.replace("[-./ ]", "-", regex=True)
    ways = (pd.to_datetime(plain, format="-".join(f"%{x}" for x in order), errors="coerce") for order in _ORDERS)
    found = [x for x in ways if x.notna().all()]
    if not found:
        return None
    best = (min(found, key=lambda x: x.max() - x.min()) - pd.Timestamp(0)).dt.days
    days = dict(zip(unique, best))
    return np.array([days[str(x).strip()] for x in dates], dtype=float)
