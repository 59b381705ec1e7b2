"""National Instruments' TDMS: channels with their own start and rate, read by npTDMS."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.campaign.importing.clock_words import stated_rate
from bayes_iwan.campaign.importing.defects import not_applied
from bayes_iwan.campaign.importing.recordings import Channel, Recording, channel, library
from bayes_iwan.campaign.recording.records import CampaignError, shown

CUT = (
    "the TDMS file ends before its data do (cut off, or damaged): what is there was read; copy or export it again "
    "unless the recorder simply stopped"
)


def read_tdms(path: Path, file: str) -> list[Recording]:
    """One recording a group."""
    nptdms = library("nptdms", "npTDMS", file, "a TDMS file")
    try:
        nptdms.log.log_manager.set_level(logging.ERROR)  # what it logs of a cut file is said below
        whole = nptdms.TdmsFile.read(path)
        stated = stated_rate(f"{k} = {v}" for x in (whole, *whole.groups()) for k, v in x.properties.items())
        sources = [(group.name, source) for group in whole.groups() for source in group.channels()]
        cut: tuple[str, ...] = (CUT,) if whole.file_status.incomplete_final_segment else ()
        cut += not_applied(
            f"{source.name}: {k} = {v}"
            for _, source in sources
            for k, v in source.properties.items()
            if "Scale[" not in k and not k.startswith("wf_")
        )
        clock, began = _starts([source.properties for _, source in sources])
        groups: dict[str, list[Channel]] = {}
        for (group, source), start in zip(sources, clock):
            step = source.properties.get("wf_increment")
            said = source.properties  # DAQmx writes the second name
            unit = str(said.get("unit_string") or said.get("NI_UnitDescription") or "")
            one = channel(source.name, unit, source[:], 1 / float(step) if step else None, start, group)
            if one is not None:
                groups.setdefault(group, []).append(one)
    except Exception as error:  # a damaged file makes npTDMS fail in many ways
        raise CampaignError(f"{file}: cannot be read as TDMS ({shown(str(error))}); copy or export it again") from None
    alone = len(groups) == 1
    return [
        Recording(
            file, "" if alone else name, tuple(c), (f"TDMS, group {name!r}" if alone else "TDMS",), stated, cut, began
        )
        for name, c in groups.items()
    ]


def _starts(properties: list[Mapping[str, Any]]) -> tuple[list[float | None], float | None]:
    """Seconds from the earliest start of all waveforms to each one's, None where it states none, and that start since
    1970."""
    stamps = [np.datetime64(p["wf_start_time"], "ns") if "wf_start_time" in p else None for p in properties]
    known = [s for s in stamps if s is not None and not np.isnat(s)]
    first: Any = min(known) if known else None
    out: list[float | None] = []
    for p, stamp in zip(properties, stamps):
        offset = float(p.get("wf_start_offset", 0.0) or 0.0)
        if stamp is not None and first is not None and not np.isnat(stamp):
            out.append(float((stamp - first) / np.timedelta64(1, "ns")) * 1e-9 + offset)
        else:
            out.append(offset if "wf_start_offset" in p and first is None else None)
    return out, None if first is None else float((first - np.datetime64(0, "ns")) / np.timedelta64(1, "ns")) * 1e-9
