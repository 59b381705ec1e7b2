"""What the rig can do: the limits that `[rig]` of campaign.toml states, within which a next test is planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.campaign.recording.stated import positive
from bayes_iwan.campaign.recording.units import DISPLACEMENTS, FORCES, Units
from bayes_iwan.errors import nearest

WHERE = "campaign.toml [rig]"


@dataclass(frozen=True)
class RigLimits:
    """Largest force (N) and amplitude (mm, half the stroke), and the range of frequencies (Hz) that a rig can run.

    None where nothing is stated: then the range of the tests that were measured is all that is known of the rig.
    """

    force_N: float | None = None
    amplitude_mm: float | None = None
    frequency_hz: tuple[float, float] | None = None

    def of_tests(self, frequency_hz: Sequence[float], amplitude_mm: Sequence[float], force_N: float) -> RigLimits:
        """The same with what is not stated taken from the tests that this rig has run: their frequencies (Hz),
        amplitudes (mm) and largest force (N)."""
        return RigLimits(
            force_N if self.force_N is None else self.force_N,
            max(amplitude_mm) if self.amplitude_mm is None else self.amplitude_mm,
            self.frequency_hz or (min(frequency_hz), max(frequency_hz)),
        )


def limits_of(stated: Mapping[str, object], units: Units) -> RigLimits:
    """Limits from the table [rig]: force_N and amplitude_mm (or other units: torque_N_m's are force_N_m), frequency_hz
    a pair. Raises CampaignError with the key and the fix."""
    size: dict[str, float] = {}
    for what, sizes in (("force", FORCES[units.force]), ("amplitude", DISPLACEMENTS[units.displacement])):
        keys = [k for k in stated if k.startswith(f"{what}_")]
        if len(keys) > 1:
            raise CampaignError(f"{WHERE}: {keys[1]} stands beside {keys[0]}; keep one of them")
        for key in keys:
            unit = key.removeprefix(f"{what}_")
            if unit not in sizes:
                raise CampaignError(
                    f"{WHERE}: {shown(key)} does not say a unit of this campaign"
                    + nearest(key, [f"{what}_{x}" for x in sizes])
                )
            size[what] = positive(stated[key], f"{WHERE}: {key}") * sizes[unit]
    for key in stated:
        if key != "frequency_hz" and not key.startswith(("force_", "amplitude_")):
            known = ["frequency_hz", *(f"amplitude_{x}" for x in DISPLACEMENTS[units.displacement])]
            known += [f"force_{x}" for x in FORCES[units.force]]
            raise CampaignError(f"{WHERE}: unknown key {shown(key)}{nearest(key, known)}")
    return RigLimits(size.get("force"), size.get("amplitude"), _range(stated.get("frequency_hz")))


def _range(value: object) -> tuple[float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise CampaignError(f"{WHERE}: frequency_hz is a pair [lowest, highest], not {shown(value)}")
    low, high = (positive(x, f"{WHERE}: frequency_hz") for x in value)
    if low >= high:
        raise CampaignError(f"{WHERE}: frequency_hz = [{low:g}, {high:g}] is no range; the lowest comes first")
    return low, high
