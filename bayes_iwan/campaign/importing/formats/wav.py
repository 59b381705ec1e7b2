"""WAV files of recorders and sound cards, read by SciPy."""

import warnings
from pathlib import Path

import numpy as np

from bayes_iwan.campaign.importing.recordings import Recording, channel
from bayes_iwan.campaign.importing.unit_texts import FULL_SCALE
from bayes_iwan.campaign.recording.records import CampaignError, shown


def read_wav(path: Path, file: str) -> list[Recording]:
    """The channels of a WAV file as shares of full scale, -1 to 1; of floating-point samples, which may be values
    themselves, no unit is known."""
    from scipy.io import wavfile

    try:
        with warnings.catch_warnings(record=True) as doubts:
            warnings.simplefilter("always")
            rate, values = wavfile.read(path)
    except Exception as error:  # SciPy raises errors of many kinds for a damaged file
        raise CampaignError(f"{file}: cannot be read as WAV ({shown(str(error))})") from None
    unit = "" if values.dtype.kind == "f" else FULL_SCALE
    if values.dtype.kind == "u":
        values = (values.astype(float) - 128.0) / 128.0
    elif values.dtype.kind == "i":
        values = values / -float(np.iinfo(values.dtype).min)
    columns = values[:, None] if values.ndim == 1 else values
    channels = [channel(f"channel {k}", unit, c, float(rate)) for k, c in enumerate(columns.T, 1)]
    said = 'WAV: samples are shares of full scale; --unit "force=100 N" says what full scale is'
    cut = tuple(
        f"the file ends before its samples do ({shown(str(x.message))}): is the copy whole?"
        for x in doubts
        if "EOF" in str(x.message)
    )
    return [Recording(file, "", tuple(c for c in channels if c is not None), (said,), warnings=cut)]
