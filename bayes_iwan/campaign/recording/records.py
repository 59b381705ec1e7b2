"""What one test recorded, and the error that every bad input raises."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.errors import InputError, nearest
from bayes_iwan.screen import on_screen

ROLES = ("fit", "held-out")


class CampaignError(InputError):
    """The campaign cannot be used as it stands; the message names the file and the fix."""


@dataclass(frozen=True)
@on_screen
class Record:
    """One test as it was recorded, in s, mm and N (or what `units` says in their place: mrad and N·m, mm and kPa).

    Parameters
    ----------
    file
        name inside the campaign folder.
    frequency_hz, amplitude_mm
        nominal values, as campaign.toml states them.
    role
        "fit" or "held-out".
    extras
        any other number stated for the test (``normal_force_N``, ``pressure_bar`` ...).
    time_s, displacement_mm, force_N
        (n,) float64, time strictly increasing, everything finite.
    warnings
        what was bridged, omitted or seems wrong but usable.
    units
        what stands for mm and N.
    clock
        whether the times are real ones; without a clock every cycle lasts 1 s and no frequency means anything.
    mean_force_error_N
        standard error of the mean force beyond noise, where the tests' mean forces contradict each other.

    Raises
    ------
    CampaignError
        arrays of different lengths, or a role of another name.

    Examples
    --------
    >>> import numpy as np, bayes_iwan as bi
    >>> t = np.arange(640) / 640.0
    >>> u = 0.5 * np.sin(2.0 * np.pi * 10.0 * t)
    >>> bi.Record("f10_a0.5.csv", 10.0, 0.5, "fit", {}, t, u, 7.0 * u).force_N.shape
    (640,)
    """

    file: str
    frequency_hz: float
    amplitude_mm: float
    role: str
    extras: Mapping[str, float]
    time_s: Array
    displacement_mm: Array
    force_N: Array
    warnings: tuple[str, ...] = field(default=())
    units: Units = field(default=Units())
    clock: bool = True
    mean_force_error_N: float = 0.0

    def __repr__(self) -> str:
        at = f"{self.frequency_hz:.4g} Hz, " if self.clock else ""
        size = f"{self.amplitude_mm:g} {self.units.displacement}"
        return f"Record({self.file!r}: {at}{size}, {self.time_s.size} samples, {self.role})"

    def __post_init__(self) -> None:
        n = np.shape(self.time_s)
        if len(n) != 1 or np.shape(self.displacement_mm) != n or np.shape(self.force_N) != n:
            raise CampaignError(
                f"{self.file}: time, displacement and force must be one-dimensional and of one length, not "
                f"{n}, {np.shape(self.displacement_mm)}, {np.shape(self.force_N)}"
            )
        if self.role not in ROLES:
            raise CampaignError(f"{self.file}: role {self.role!r} is not known{nearest(self.role, ROLES)}")


def shown(value: object) -> str:
    """A value of any kind and size, short and on one line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer with thousands of digits
        text = f"a {type(value).__name__} of great length"
    return text if len(text) <= 60 else text[:57] + "..."
