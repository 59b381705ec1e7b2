"""Writing a campaign folder that reads back as it was."""

import gzip
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError, Record
from bayes_iwan.files import write_whole

#: what columns are called in a campaign that this package writes, by working unit
MOTION_COLUMNS = {"mm": "displacement_mm", "mrad": "angle_mrad"}
FORCE_COLUMNS = {"N": "force_N", "N·m": "torque_N_m", "kPa": "pressure_kPa"}


def write_campaign(
    path: str | os.PathLike[str],
    *,
    name: str,
    description: str,
    tests: Sequence[Record],
    sample_rate_hz: float | None = None,
    source: str = "",
    licence: str = "",
    compress: bool = True,
) -> None:
    """Write a campaign folder that `read_campaign` reads back; equal input gives equal bytes.

    Files are replaced one by one, campaign.toml last, so an interrupted write never leaves a folder that reads as whole
    but is not.

    Parameters
    ----------
    path
        folder, made if need be.
    name, description, source, licence
        of the specimen.
    tests
        records, all in the same units.
    sample_rate_hz
        stated in campaign.toml if given; times are then on its grid.
    compress
        records as `.csv.gz`, else `.csv`.

    Raises
    ------
    CampaignError
        no test, or tests of different units.

    Examples
    --------
    >>> import tempfile, numpy as np, bayes_iwan as bi
    >>> t = np.arange(640) / 640.0
    >>> u = 0.5 * np.sin(2.0 * np.pi * 10.0 * t)
    >>> record = bi.Record("f10_a0.5.csv", 10.0, 0.5, "fit", {}, t, u, 7.0 * u)
    >>> folder = tempfile.mkdtemp()
    >>> bi.write_campaign(folder, name="spring", description="7 N/mm", tests=[record], compress=False)
    >>> bi.read_campaign(folder).name
    'spring'
    """
    folder = Path(path)
    if not tests:
        raise CampaignError(f"{folder}: a campaign needs at least one test")
    units = tests[0].units
    if any(test.units != units for test in tests):
        raise CampaignError(f"{folder}: all tests of a campaign have one unit of displacement and one of force")
    motion, force = MOTION_COLUMNS[units.displacement], FORCE_COLUMNS[units.force]
    channels: dict[str, str | float] = {"displacement": motion, "force": force}
    if not tests[0].clock:
        channels["clock"] = "none"
    elif sample_rate_hz is not None:
        channels["sample_rate_hz"] = float(sample_rate_hz)
    write_folder(
        folder,
        specimen={"name": name, "description": description, "source": source, "licence": licence},
        channels=channels,
        tests=[
            (
                stated(test),
                ({"time_s": test.time_s} if test.clock else {}) | {motion: test.displacement_mm, force: test.force_N},
            )
            for test in tests
        ],
        compress=compress,
    )


def stated(test: Record) -> dict[str, str | float]:
    """What campaign.toml says of a record in its [[test]] table."""
    out: dict[str, str | float] = {
        "file": test.file,
        **({"frequency_hz": float(test.frequency_hz)} if test.clock else {}),
        f"amplitude_{test.units.displacement}": float(test.amplitude_mm),
    }
    if test.role != "fit":
        out["role"] = test.role
    return out | {key: float(value) for key, value in sorted(test.extras.items())}


def write_folder(
    folder: Path,
    *,
    specimen: Mapping[str, str],
    channels: Mapping[str, str | float],
    tests: Sequence[tuple[Mapping[str, str | float], Mapping[str, Array]]],
    compress: bool,
) -> None:
    """Write a campaign folder from what its tables say and, for each test, its columns (n,) by name."""
    files = [_file_name(str(test["file"]), compress) for test, _ in tests]
    if len(set(files)) < len(files):
        raise CampaignError(f"{folder}: two tests have one file name: {', '.join(sorted(files))}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").unlink(missing_ok=True)
    for file, (_, columns) in zip(files, tests):
        buffer = io.BytesIO()
        buffer.write((",".join(columns) + "\n").encode())
        digits = ["%.12g" if name == "time_s" else "%.8g" for name in columns]
        np.savetxt(buffer, np.column_stack(list(columns.values())), fmt=digits, delimiter=",")
        raw = buffer.getvalue()
        write_whole(folder / file, gzip.compress(raw, mtime=0) if compress else raw)
    text = ["format = 1", "", "[specimen]", *_lines({k: v for k, v in specimen.items() if v or k == "description"})]
    text += ["", "[channels]", *_lines(channels)]
    for file, (test, _) in zip(files, tests):
        text += ["", "[[test]]", *_lines({**test, "file": file})]
    write_whole(folder / "campaign.toml", ("\n".join(text) + "\n").encode())


def _lines(table: Mapping[str, str | float]) -> list[str]:
    out = []
    for key, value in table.items():
        bare = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)
        out.append(f"{bare} = {_text(value) if isinstance(value, str) else repr(float(value))}")
    return out


def _file_name(file: str, compress: bool) -> str:
    stem = file.removesuffix(".gz").removesuffix(".csv")
    if not stem or Path(stem).name != stem:
        raise CampaignError(f"{file!r}: a record's file must be a plain name")
    return stem + (".csv.gz" if compress else ".csv")


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
