"""A file of any format that is known: which one its first bytes tell."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from bayes_iwan.campaign.folders.contents import folders_said, recordings_in
from bayes_iwan.campaign.importing.formats.excel import NUMPY, read_excel
from bayes_iwan.campaign.importing.formats.matlab import read_hdf5, read_matlab
from bayes_iwan.campaign.importing.formats.parquet import read_parquet
from bayes_iwan.campaign.importing.formats.tdms import read_tdms
from bayes_iwan.campaign.importing.formats.text import read_text
from bayes_iwan.campaign.importing.formats.text_layout import Layout
from bayes_iwan.campaign.importing.formats.uff import read_uff
from bayes_iwan.campaign.importing.formats.wav import read_wav
from bayes_iwan.campaign.importing.recordings import FEWEST_SAMPLES, NoSignals, Recording
from bayes_iwan.campaign.recording.records import CampaignError

DOCUMENT = rb"(\xef\xbb\xbf)?\s*<|%PDF"
#: formats that are known by their first bytes and not read: what to do with them
OTHERS = (
    (rb"MDF     ", "an ASAM MDF file; export its channels with one time raster as CSV, MAT or Parquet"),
    (rb"\x93NUMPY", f"a NumPy array; {NUMPY}"),
    (rb"ARROW1", "an Arrow or Feather file; save it as Parquet: table.to_parquet(...)"),
    (rb"CDF[\1\2\5]", "a netCDF 3 file; save it as netCDF 4: nccopy -k nc4 old.nc new.nc"),
    (DOCUMENT, "a document (XML, HTML, PDF); save its table as CSV or .xlsx"),
)


def read_file(path: Path, layout: Layout) -> list[Recording]:
    """All recordings of a file. Raises CampaignError."""
    file = path.name
    try:
        with path.open("rb") as handle:
            start = handle.read(1024)
    except FileNotFoundError:
        raise CampaignError(f"{path}: not found") from None
    except OSError as error:
        raise CampaignError(f"{path}: cannot be read ({error.strerror})") from None
    if not start:
        raise NoSignals(f"{file}: empty")
    ending = path.suffix.lower()
    for mark, what in OTHERS:
        if re.match(mark, start):
            raise (NoSignals if mark == DOCUMENT else CampaignError)(f"{file}: {what}")
    if start.startswith(b"TDSm"):
        out = read_tdms(path, file)
    elif b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:520]):
        out = read_hdf5(path, file)
    elif start.startswith(b"MATLAB 5.0") or ending == ".mat":
        out = read_matlab(path, file)
    elif start.startswith(b"PAR1"):
        out = read_parquet(path, file)
    elif start.lstrip(b"\r\n").startswith(b"    -1") or ending in (".uff", ".unv", ".bunv"):
        out = read_uff(path, file)
    elif start[:4] in (b"RIFF", b"RIFX", b"RF64") and start[8:12] == b"WAVE":
        out = read_wav(path, file)
    elif start.startswith(b"PK\x03\x04"):
        out = read_excel(path, file)
    elif start.startswith(b"\xd0\xcf\x11\xe0"):
        kind = CampaignError if ending == ".xls" else NoSignals
        raise kind(f"{file}: an Office file of before 2007; save a spreadsheet as .xlsx or CSV")
    else:
        out = read_text(path, file, layout)
    if not any(x.channels for x in out):
        raise NoSignals(f"{file}: no signals of {FEWEST_SAMPLES} samples or more in it")
    return [x for x in out if x.channels]


def read_files(files: Sequence[str | os.PathLike[str]], layout: Layout) -> tuple[list[Recording], tuple[str, ...]]:
    """All recordings of files, folders and patterns, and a line for each file there that holds none: a note beside
    them. Raises CampaignError, also for a file without signals that is named itself."""
    out: list[Recording] = []
    passed: list[str] = []
    paths: dict[Path, None] = {}  # each once
    for name in (str(os.fspath(x)) for x in files):
        if (Path(name) / "campaign.toml").exists():
            raise CampaignError(f'{name}: is a campaign already; run: bayes-iwan check "{name}"')
        if not (some := recordings_in(name)):
            raise CampaignError(folders_said(Path(name)) or f"{name}: no files there")
        paths |= dict.fromkeys(some)
    for path in paths:
        try:
            out += read_file(path, layout)
        except NoSignals as error:
            if path in map(Path, files):
                raise
            passed.append(f"passed over, as no recording: {error}")
    if passed and not out:
        raise CampaignError(next(filter(None, (folders_said(Path(x)) for x in files)), passed[0]))
    return out, tuple(passed)
