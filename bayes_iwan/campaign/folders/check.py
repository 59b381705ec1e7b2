"""A campaign that was read, and what each of its tests shows before any model, in one line each."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bayes_iwan.campaign import Campaign, Loop
from bayes_iwan.campaign.folders.folder import read_checked
from bayes_iwan.screen import Listed, on_screen, screen

if TYPE_CHECKING:
    from bayes_iwan.campaign.folders.inspect import Inspection

PathLike = str | os.PathLike[str]


@dataclass(frozen=True, repr=False)
@on_screen
class Check:
    """A campaign that was read, and what each of its tests shows before any model; made by :func:`check`.

    Attributes
    ----------
    campaign
        its records and what was stated of them.
    tests
        of each record its averaged loop with energy (mJ), stiffness (N/mm), loss factor, noise and remarks.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> found = bi.check(folder)
    >>> len(found.loops), found.tests[1].energy_mJ.value > found.tests[0].energy_mJ.value > 0.0
    (2, True)
    """

    campaign: Campaign
    tests: tuple[Inspection, ...]

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The averaged tests."""
        return Listed(x.loop for x in self.tests)

    def __repr__(self) -> str:
        title, head, *rows = self._lines()
        return screen((title,), [head, *rows], where="print(check)")

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> list[str]:
        c = self.campaign
        head = (
            f"{'f, Hz' if c.clock else '':>8s} {'A, mm':>8s} {'cycles':>6s} {'samples':>8s} {'force RMS, N':>12s} "
            f"{'mean, N':>9s} {'mean, mm':>9s} {'noise, N':>9s}  role"
        )
        lines = [c.name + (f": {c.description}" if c.description else ""), f"{'test':24s} {c.units.text(head)}"]
        for test in self.tests:
            x = test.loop
            lines.append(
                f"{x.file:24s} {f'{x.frequency_hz:.4g}' if c.clock else '':>8s} {x.amplitude_mm:8.4g} {x.n_cycles:6d} "
                f"{x.record.time_s.size:8d} {x.force_N.std():12.4g} {_shown(x.harmonics_N[0].real, x.force_N.std())} "
                f"{_shown(x.offset_mm, x.amplitude_mm)} {test.noise_N:9.2g}  {x.role}"
            )
            lines += [f"    {note}" for note in test.notes]
        return lines


def _shown(mean: float, size: float) -> str:
    """A mean to three digits, none where it is no more than rounding."""
    return f"{mean if abs(mean) > 1e-6 * size else 0.0:9.3g}"


def check(campaign: Campaign | PathLike) -> Check:
    """Read a campaign and average its tests.

    Parameters
    ----------
    campaign
        a campaign, or the folder that holds its campaign.toml.

    Returns
    -------
    Check
        its loops and warnings; its last line in a notebook cell shows them.

    Raises
    ------
    CampaignError
        one line that names the file, what is wrong with it and the fix.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> plan = [bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)]
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign(plan, seed=1).write(folder)
    >>> [loop.role for loop in bi.check(folder).loops]
    ['fit', 'fit']
    """
    from bayes_iwan.campaign.folders.inspect import inspect_campaign, inspect_loop

    if isinstance(campaign, Campaign):
        return Check(campaign, inspect_campaign(campaign))
    found, loops = read_checked(campaign)
    return Check(found, tuple(inspect_loop(loop) for loop in loops))
