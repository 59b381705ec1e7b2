"""What a data-acquisition system's file holds, whatever its format: channels with names, units and samples."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from types import ModuleType

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.recording.records import CampaignError

FEWEST_SAMPLES = 16  # what is shorter is a note or a setting, not a signal


@dataclass(frozen=True)
class Channel:
    """One signal as it stands in the file.

    unit : as the file writes it, "" where it does not. values : (n,), NaN where the file has no number.
    rate_hz : samples a second, None where the file does not say.
    """

    name: str
    unit: str
    values: Array
    rate_hz: float | None = None


@dataclass(frozen=True)
class Recording:
    """The channels that were recorded together: a file, or one of several parts of it.

    file : for messages. part : name of the part, "" where the file is one. notes : what was left out or guessed.
    """

    file: str
    part: str
    channels: tuple[Channel, ...]
    notes: tuple[str, ...] = ()


def library(module: str, package: str, file: str, what: str) -> ModuleType:
    """An optional library. Raises CampaignError that says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise CampaignError(
            f"{file}: {what} needs {package}, which is not installed; pip install 'bayes-iwan[import]'"
        ) from None
