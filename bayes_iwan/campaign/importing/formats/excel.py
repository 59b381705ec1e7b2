"""Excel workbooks, read by openpyxl: each sheet's cells as the lines of a text table."""

import datetime
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from bayes_iwan.campaign.importing.formats.text import read_lines
from bayes_iwan.campaign.importing.formats.text_layout import Layout
from bayes_iwan.campaign.importing.recordings import NoSignals, Recording, library
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.table import FREE_EXPANSION, LARGEST_EXPANSION

UNPACK = "a zip archive, no .xlsx workbook; save a spreadsheet as .xlsx, or unpack an archive and import what is in it"
#: what to do with NumPy's own files, which hold no units
NUMPY = 'save them with names and units: numpy.savetxt(..., header="time_s disp_mm force_N")'


def read_excel(path: Path, file: str) -> list[Recording]:
    """Each sheet of a workbook that is shown and holds rows of numbers, read as a text table is."""
    openpyxl = library("openpyxl", "openpyxl", file, "an Excel workbook")
    try:
        with zipfile.ZipFile(path) as packed:
            names, size = packed.namelist(), sum(x.file_size for x in packed.infolist())
        if "xl/workbook.xml" not in names:
            what = f"NumPy arrays; {NUMPY}" if names and all(x.endswith(".npy") for x in names) else UNPACK
            raise NoSignals(f"{file}: {what}")
        if size > max(FREE_EXPANSION, LARGEST_EXPANSION * path.stat().st_size):
            raise CampaignError(f"{file}: unpacks to {size // 1_000_000} MB, which no workbook does; save it as CSV")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
        sheets = {
            sheet.title: [[_cell(x) for x in row] for row in sheet.iter_rows(values_only=True)]
            for sheet in book.worksheets
            if sheet.sheet_state == "visible"
        }
        book.close()
    except CampaignError:
        raise
    except Exception as error:  # a damaged archive fails in zipfile, in XML and in openpyxl
        raise CampaignError(
            f"{file}: cannot be read as an Excel workbook ({shown(str(error))}); save the sheet as CSV"
        ) from None
    out = []
    for title, rows in sheets.items():
        width = max((k for row in rows for k, cell in enumerate(row, 1) if cell), default=0)
        lines = ["\t".join((row + [""] * width)[:width]) for row in rows]
        with suppress(NoSignals):  # a sheet of remarks
            out += read_lines(file, lines, Layout(separator="\t"), f"sheet {title!r}")
    if not out:
        raise NoSignals(f"{file}: no rows of numbers in any sheet; are its formulas worked out and saved?")
    return [replace(x, part=x.part if len(out) > 1 else "") for x in out]


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat(sep=" ") if isinstance(value, datetime.datetime) else value.isoformat()
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds())
    return " ".join(str(value).split())
