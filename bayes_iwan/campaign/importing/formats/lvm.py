"""LabVIEW measurement files (.lvm): segments, each with units, starts and steps of its channels above the numbers.

Read here and not by lvm_read, which takes a cell that it cannot read for NaN without a word, and several X columns for
channels. Which readers were tried: guide, importing.
"""

import io
from dataclasses import replace

import numpy as np
import pandas as pd

from bayes_iwan.campaign.importing.formats.stamps import seconds
from bayes_iwan.campaign.importing.recordings import Recording, axis, channel
from bayes_iwan.campaign.recording.records import CampaignError, shown

END_OF_HEADER = "***End_of_Header***"


def read_lvm(file: str, text: str) -> list[Recording]:
    """One recording a segment, of the text of a .lvm file."""
    lines = text.split("\n")
    ends = [k for k, line in enumerate(lines) if line.startswith(END_OF_HEADER)]
    said = (line.partition("\t" if "\t" in line else ",") for line in lines[: ends[0]])
    head = {k.strip(): v.strip() for k, _, v in said}
    separator = "," if head.get("Separator", "Tab").lower().startswith((",", "comma")) else "\t"
    out = []
    for number, end in enumerate(ends[1:], 1):
        stop = next(
            (k for k in range(end + 2, len(lines)) if lines[k][:1].isalpha() or not lines[k].strip()), len(lines)
        )
        above = [line.split(separator) for line in lines[ends[number - 1] + 1 : end] if line.strip()]
        keys = {cells[0].strip(): [c.strip() for c in cells[1:]] for cells in above}
        out.append(_segment(file, number, keys, lines[end + 1 : stop], end + 2, separator, head))
    return [replace(x, part=x.part if len(out) > 1 else "") for x in out]


def _segment(
    file: str, number: int, keys: dict[str, list[str]], lines: list[str], first: int, separator: str,
    head: dict[str, str],
) -> Recording:  # fmt: skip
    decimal = head.get("Decimal_Separator", ".")[:1] or "."
    names = [x.strip() for x in (lines or [""])[0].rstrip(f"{separator} ").split(separator)]
    names = names[: names.index("Comment")] if "Comment" in names else names
    own_x = head.get("X_Columns", "One")
    columns = list(range(1, len(names), 2 if own_x == "Multi" else 1))
    try:
        table = pd.read_csv(
            io.StringIO("\n".join(lines[1:])), sep=separator, decimal=decimal, header=None, names=range(len(names) + 1),
            na_values=[""], keep_default_na=False,
        )  # fmt: skip
        values = {k: table[k].to_numpy(dtype=float) for k in range(len(names)) if own_x != "No" or k}
    except (ValueError, OverflowError) as error:
        raise CampaignError(
            f"{file} segment {number} (from line {first}): {shown(str(error))}; correct the line in the file"
        ) from None

    def of(key: str, place: int) -> str:
        return "".join(keys.get(key, [])[columns[place] - 1 : columns[place]])

    def number_of(key: str, place: int) -> float | None:
        try:
            return float(of(key, place).replace(decimal, "."))
        except ValueError:
            return None

    if other := [x for place in range(len(columns)) if (x := of("X_Dimension", place)) not in ("", "Time")]:
        raise CampaignError(f"{file} segment {number}: X is {shown(other[0])}, no time; write time histories")
    clocks, dates = ([of(key, place) for place in range(len(columns))] for key in ("Time", "Date"))
    began = seconds(clocks, dates if all(dates) else None) if clocks and all(clocks) else None
    late = (began is not None and began[0].any()) or len({number_of("X0", place) for place in range(len(columns))}) > 1
    if late and own_x == "One":
        own_x = "No"  # one column of times from each channel's own start: these say when each sample was taken
    channels = []
    warnings: tuple[str, ...] = ()
    for place, k in enumerate(columns):
        clock, where = of("X_Unit_Label", place), f"{file} segment {number}: {names[k]!r}"
        rate, start = axis(number_of("Delta_X", place) or 0.0, number_of("X0", place) or 0.0, clock, where)
        group = names[k] if own_x == "Multi" else ""
        if own_x != "No" and (own_x == "Multi" or place == 0):
            x = values[k - 1]
            channels.append(channel("X_Value", clock or "s", x[np.isfinite(x)], None, None, group))
        y = values[k]
        samples, there = int(number_of("Samples", place) or 0), int(np.count_nonzero(np.isfinite(y)))
        if samples and own_x == "Multi":
            y = y[:samples]
        if there < samples:
            cut = f"{there} of {samples} samples that segment {number} announces: cut off or damaged; export it again"
            warnings = (*warnings, f"{names[k]!r} has {cut}")
        offset = float(began[0][place]) if began is not None else 0.0
        channels.append(channel(names[k], of("Y_Unit_Label", place), y, rate, start + offset, group))
    kept = tuple(c for c in channels if c is not None)
    note, since = f"LabVIEW, segment {number}", None if began is None else began[2]
    return Recording(file, f"segment {number}", kept, (note,), warnings=warnings, began_s=since)
