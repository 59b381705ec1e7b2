"""What a folder holds: recordings, or folders that are campaigns or hold recordings."""

import glob
from pathlib import Path

from bayes_iwan.errors import few
from bayes_iwan.files import RECORD

#: what a folder of recordings may hold besides
OTHER_FILES = (".toml", ".md", ".html", ".tdms_index", ".png")
#: what a folder of recordings has at least one of, to be known for one
RECORDED = set(".csv .txt .dat .tsv .asc .tdms .lvm .uff .unv .mat .h5 .xlsx .wav .parquet .json .gz".split())


def recordings_in(name: str) -> list[Path]:
    """The files that may be recordings in a folder, or that a pattern matches; else the path itself."""
    path = Path(name)
    if path.is_dir():
        some = [p for p in sorted(path.iterdir()) if p.is_file() and not p.name.startswith((".", "~$"))]
        return [p for p in some if p.suffix.lower() not in OTHER_FILES]
    if not path.exists() and any(c in name for c in "*?["):
        return [Path(p) for p in sorted(glob.glob(name, recursive=True)) if Path(p).is_file()]
    return [path]


def folders_said(path: Path) -> str:
    """One line on a folder whose folders are campaigns, or else hold recordings, with the commands for one of them and
    for all; "" for any other."""
    if not path.is_dir() or (path / RECORD).is_file():
        return ""
    below = [p for p in sorted(path.iterdir()) if p.is_dir() and not (p / RECORD).is_file()]
    campaigns = [p for p in below if (p / "campaign.toml").is_file()]
    some = campaigns or [p for p in below if any(x.suffix.lower() in RECORDED for x in recordings_in(str(p)))]
    if not some:
        return ""
    names = few(p.name for p in some)
    if campaigns:
        one, every = f'bayes-iwan check "{some[0]}"', f'bayes-iwan batch "{path}"'
        return f"{path}: a folder of campaigns: {names}. One of them: {one}; all: {every}"
    out = f"{path.resolve().name}-campaigns"
    one = f'bayes-iwan import "{some[0]}" --out "{out}/{some[0].name}"'
    return f'{path}: folders of recordings: {names}. Import each specimen: {one}; then all: bayes-iwan batch "{out}"'
