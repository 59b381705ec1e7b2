"""A campaign to try things on, for one who has no data yet."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from bayes_iwan.campaign import Campaign, read_campaign
from bayes_iwan.virtual_rig.planning import simulate_campaign
from bayes_iwan.virtual_rig.simulate import PlannedTest

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
