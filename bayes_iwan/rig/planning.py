"""Campaigns on the virtual rig, to plan real ones: would these tests show that effect?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import Record, write_campaign
from bayes_iwan.rig.fault import Fault
from bayes_iwan.rig.faults import check_faults
from bayes_iwan.rig.simulate import PlannedTest, Setup, records, simulate_tests, with_noise
from bayes_iwan.rig.sizing import fault_size, size_fault, surroundings
from bayes_iwan.rig.specimen import RigError, Specimen, paper_specimen


@dataclass(frozen=True)
class VirtualCampaign:
    """A simulated campaign: `records` to be written or read on, `faults` with their sizes, friction's RMS (N)."""

    records: tuple[Record, ...]
    faults: tuple[Fault, ...]
    specimen: Specimen
    friction_rms_N: float

    def write(self, path: Path | str) -> None:
        """Write it as a campaign folder."""
        write_campaign(
            path, name="virtual rig", description="planned on the virtual rig of bayes_iwan", tests=self.records,
            source="bayes_iwan.rig",
        )  # fmt: skip


def simulate_campaign(
    tests: Sequence[PlannedTest],
    *,
    fault: str | Fault | None = None,
    size: float = 0.1,
    specimen: Specimen | None = None,
    setup: Setup | None = None,
    noise: float = 0.005,
    seed: int = 0,
) -> VirtualCampaign:
    """Simulate a campaign before running it: which fault would these tests show?

    Parameters: `tests`, the plan; `fault`, a name from `faults.KINDS` (an effect of the catalogue or another) at
    `size` (RMS change of the force over RMS friction force), by the law that the catalogue has too, or a `Fault` with
    law and numbers of its own, or None; `specimen`, by default the paper's Table 1; `noise`, the force noise over the
    RMS friction force. Raises `RigError` for what cannot be run.
    """
    if not tests:
        raise RigError("a campaign needs at least one test")
    specimen = specimen or paper_specimen(seed=seed)
    sound = surroundings(specimen, tests, setup=setup, seed=seed)
    faults: tuple[Fault, ...] = ()
    if isinstance(fault, Fault):
        check_faults((fault,))
        found = fault_size(specimen, tests, fault, setup=setup, seed=seed, sound=sound)
        faults = (replace(fault, size=found),)
    elif fault is not None:
        rng = np.random.default_rng([seed, 2])
        faults = (size_fault(fault, size, specimen, tests, rng, setup=setup, seed=seed, sound=sound),)
    noisy = with_noise(setup or Setup(), noise, sound[0].friction_rms_N, sound[0].largest_mm)
    runs = simulate_tests(specimen, tests, setup=noisy, faults=faults, seed=seed)
    return VirtualCampaign(tuple(records(runs)), faults, specimen, sound[0].friction_rms_N)
