"""JSON: columns, rows as lists or objects, and channels with rates of their own, as structs of MATLAB are read."""

import json
import re
from typing import Any

import numpy as np

from bayes_iwan.campaign.importing.formats.matlab import MOST_COLUMNS, flat, of_variables
from bayes_iwan.campaign.importing.formats.stamps import seconds
from bayes_iwan.campaign.importing.recordings import FEWEST_SAMPLES, Recording
from bayes_iwan.campaign.recording.records import CampaignError, shown

#: what is JSON, damaged or not
_JSON = re.compile(r"\s*(\[\s*[\[{]|\{\s*\"[^\"]*\"\s*:\s*[\[{])")


def read_json(file: str, text: str) -> list[Recording] | None:
    """The columns and rows of JSON, as arrays of a struct are; None for another text, and for JSON lines."""
    try:
        found = _columns(json.loads(text, parse_int=float)) if text.lstrip()[:1] in ("[", "{") else None
    except (ValueError, RecursionError) as error:
        if _JSON.match(text) and "Extra data" not in str(error):
            raise CampaignError(f"{file}: damaged JSON ({shown(str(error))}); save it again, or as CSV") from None
        return None
    return None if found is None else of_variables(file, found, "JSON", "save columns of numbers, or rows")


def _columns(value: Any) -> Any:
    """A value of JSON with its long lists, and its rows that are lists or objects, as arrays."""
    if isinstance(value, dict) and "0" in value:  # pandas numbers its rows
        value = list(value.values())
    if isinstance(value, list) and len(value) >= FEWEST_SAMPLES:
        rows = [dict(flat("", x, 0)) for x in value]
        names = list(dict.fromkeys(k for x in rows for k in x))
        columns = {k: _numbers([x.get(k) for x in rows]) for k in names[:MOST_COLUMNS]}
        return columns.get("", columns)
    if not isinstance(value, dict):
        return [_columns(x) for x in value] if isinstance(value, list) else value
    heads = [x for x in value.values() if isinstance(x, list) and all(isinstance(y, str) for y in x)]
    out = {k: _columns(x) for k, x in value.items()}
    for k, x in out.items():
        if isinstance(x, dict) and "(1)" in x:  # rows of lists, below names that stand apart
            out[k] = next((dict(zip(head, x.values())) for head in heads if len(head) == len(x)), x)
    return out


def _numbers(cells: list[Any]) -> Any:
    """Cells of JSON as numbers, stamps as moments; other texts as they are."""
    try:
        return np.array(cells, dtype=float)
    except (ValueError, TypeError):
        found = seconds(cells) if all(isinstance(x, str) for x in cells) else None
        return found and np.datetime64(round(found[2] * 1e9), "ns") + np.round(found[0] * 1e9).astype("m8[ns]")
