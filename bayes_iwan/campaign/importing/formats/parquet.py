"""Parquet, read by pandas and pyarrow."""

from pathlib import Path

import pandas as pd

from bayes_iwan.campaign.importing.recordings import Recording, channel, from_first, library
from bayes_iwan.campaign.recording.records import CampaignError, shown


def read_parquet(path: Path, file: str) -> list[Recording]:
    """The columns of a Parquet file."""
    library("pyarrow", "pyarrow", file, "a Parquet file")
    try:
        table = pd.read_parquet(path, engine="pyarrow")
    except Exception as error:  # pyarrow's errors are its own
        raise CampaignError(f"{file}: cannot be read as Parquet ({shown(str(error))})") from None
    if not isinstance(table.index, pd.RangeIndex):
        table = table.reset_index()
    zones = {name: "M8[ns]" for name in table.columns if isinstance(table[name].dtype, pd.DatetimeTZDtype)}
    columns, began = from_first([table[name].to_numpy(zones.get(name)) for name in table.columns])
    channels = [channel(str(name), "", x) for name, x in zip(table.columns, columns)]
    return [Recording(file, "", tuple(c for c in channels if c is not None), ("Parquet",), began_s=began)]
