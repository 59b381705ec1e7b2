"""National Instruments' TDMS: channels with their own start and rate, read by npTDMS."""

import logging
from pathlib import Path

import numpy as np

from bayes_iwan.campaign.importing.clock_words import stated_rates
from bayes_iwan.campaign.importing.recordings import Channel, Recording, axis, channel, from_first, library
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.unapplied import not_applied

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
        stated = stated_rates(f"{k} = {v}" for x in (whole, *whole.groups()) for k, v in x.properties.items())
        sources = [(group.name, source) for group in whole.groups() for source in group.channels()]
        cut: tuple[str, ...] = (CUT,) if whole.file_status.incomplete_final_segment else ()
        cut += not_applied(
            f"{source.name}: {k} = {v}"
            for _, source in sources
            for k, v in source.properties.items()
            if "Scale[" not in k and not k.startswith(("wf_start", "wf_increment"))
        )
        stamps = [np.array([x.properties.get("wf_start_time", "NaT")], "M8[ns]") for _, x in sources]
        arrays, began = from_first([*(source[:] for _, source in sources), *stamps])
        groups: dict[str, list[Channel]] = {}
        for (group, source), values, late in zip(sources, arrays, arrays[len(sources) :]):
            said = source.properties  # DAQmx writes the second name
            unit = str(said.get("unit_string") or said.get("NI_UnitDescription") or "")
            of_x, where = str(said.get("wf_xunit_string") or ""), f"{file}: {source.name!r}"
            rate, offset = axis(
                float(said.get("wf_increment") or 0), float(said.get("wf_start_offset") or 0), of_x, where
            )
            start: float | None = offset + float(late[0] / np.timedelta64(1, "s"))
            if np.isnat(late[0]):  # of the others' clock nothing is known, unless none has one
                start = offset if began is None and "wf_start_offset" in said else None
            one = channel(source.name, unit, values, rate, start, group)
            if one is not None:
                groups.setdefault(group, []).append(one)
    except CampaignError:
        raise
    except Exception as error:  # a damaged file makes npTDMS fail in many ways
        raise CampaignError(f"{file}: cannot be read as TDMS ({shown(str(error))}); copy or export it again") from None
    alone = len(groups) == 1
    return [
        Recording(
            file, "" if alone else name, tuple(c), (f"TDMS, group {name!r}" if alone else "TDMS",), stated, cut, began
        )
        for name, c in groups.items()
    ]
