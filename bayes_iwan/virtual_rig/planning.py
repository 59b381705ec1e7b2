"""Campaigns on the virtual rig, to plan real ones: would these tests show that effect?"""

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_iwan.arguments import seed_of
from bayes_iwan.campaign import Campaign, Record, read_campaign, write_campaign
from bayes_iwan.screen import on_screen
from bayes_iwan.virtual_rig.fault import Fault
from bayes_iwan.virtual_rig.faults import check_faults
from bayes_iwan.virtual_rig.simulate import PlannedTest, Setup, VirtualRig, records, with_noise
from bayes_iwan.virtual_rig.sizing import fault_size, size_fault, surroundings
from bayes_iwan.virtual_rig.specimen import RigError, Specimen, paper_specimen


@dataclass(frozen=True)
@on_screen
class VirtualCampaign:
    """A campaign simulated on the virtual rig; :func:`simulate_campaign` makes one.

    Attributes
    ----------
    records
        to be written, or read on.
    faults
        what was planted, with its parameters and size.
    specimen
        what was on the rig.
    friction_rms_N
        RMS friction force of the sound specimen over all tests.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> campaign = bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1)
    >>> [record.file for record in campaign.records], campaign.faults
    (['f10_a0.4.csv', 'f10_a0.9.csv'], ())
    """

    records: tuple[Record, ...]
    faults: tuple[Fault, ...]
    specimen: Specimen
    friction_rms_N: float

    def write(self, path: Path | str) -> None:
        """Write it as a campaign folder."""
        write_campaign(
            path, name="virtual rig", description="planned on the virtual rig of bayes_iwan", tests=self.records,
            source="bayes_iwan.virtual_rig",
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

    Parameters
    ----------
    tests
        the plan.
    fault
        None; a name of :data:`bayes_iwan.virtual_rig.faults.KINDS` (an effect of the catalogue or another), by the law
        that the catalogue has too; or a `Fault` with law and parameters of its own.
    size
        of a fault given by name: RMS change of the force over the RMS friction force.
    specimen
        default: Table 1 of Rajaei, Ahmadian and Tavakoli.
    setup
        shaker, fixture and sensors (default: those of a usual rig).
    noise
        of the force channel, over the RMS friction force.
    seed
        of all random numbers.

    Returns
    -------
    VirtualCampaign
        its records in s, mm and N; `.write(folder)` makes a campaign folder of it.

    Raises
    ------
    RigError
        what the rig cannot run, or a fault that cannot reach the size.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> campaign = bi.simulate_campaign(plan, fault="viscous_damping", size=0.1, seed=1)
    >>> campaign.faults[0].name, round(campaign.faults[0].size, 2)
    ('viscous_damping', 0.1)
    """
    if not tests:
        raise RigError("a campaign needs at least one test")
    seed = seed_of(seed)
    rig = VirtualRig(specimen or paper_specimen(seed=seed), setup or Setup(), seed=seed)
    sound = surroundings(rig, tests)
    faults: tuple[Fault, ...] = ()
    if isinstance(fault, Fault):
        check_faults((fault,))
        faults = (replace(fault, size=fault_size(rig, tests, fault, sound=sound)),)
    elif fault is not None:
        rng = np.random.default_rng([seed, 2])
        faults = (size_fault(fault, size, rig, tests, rng, sound=sound),)
    noisy = with_noise(rig.setup, noise, sound[0].friction_rms_N, sound[0].largest_mm)
    runs = replace(rig, setup=noisy, faults=faults).run_all(tests)
    return VirtualCampaign(tuple(records(runs)), faults, rig.specimen, sound[0].friction_rms_N)


PathLike = str | os.PathLike[str]

#: frequency (Hz) and amplitude (mm) of the demonstration's tests, and what is wrong with its rig
_DEMO_PLAN = tuple((f, a) for f in (8.0, 20.0) for a in (0.3, 0.6, 1.0))
_DEMO_FAULT = ("viscous_damping", 0.15)


def demo(folder: PathLike | None = None, seed: int = 1) -> Campaign:
    """A campaign to try things on: six tests of a virtual rope spring with a dashpot that the model does not know.

    Parameters
    ----------
    folder
        where to write it, for commands that ask for a folder; None writes it into a new temporary one.
    seed
        of the noise.

    Returns
    -------
    Campaign
        its records; `.path` is the folder.

    Raises
    ------
    OutputError
        a folder that cannot be written to.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> campaign = bi.demo()
    >>> len(campaign.tests), campaign.path.is_dir()
    (6, True)
    """
    where = Path(tempfile.mkdtemp(prefix="bayes_iwan_demo_") if folder is None else folder)
    plan = [PlannedTest(f, a, cycles=8) for f, a in _DEMO_PLAN]
    fault, size = _DEMO_FAULT
    simulate_campaign(plan, fault=fault, size=size, seed=seed).write(where)
    return read_campaign(where)
