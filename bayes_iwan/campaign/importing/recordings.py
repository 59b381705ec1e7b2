"""What a data-acquisition system's file holds, whatever its format: channels with names, units and samples."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayes_iwan.arrays import Array
from bayes_iwan.campaign.importing.unit_texts import converted, is_unit, role_of, split_name
from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.screen import on_screen

FEWEST_SAMPLES = 16  # what is shorter is a note or a setting, not a signal
RATES_HZ = 1e-6, 1e12  # of samples: beyond it, none was stated


class NoSignals(CampaignError):
    """A file that holds no signals: what somebody put beside recordings, or a layout that is not known."""


@dataclass(frozen=True, eq=False)
@on_screen
class Channel:
    """One signal as it stands in the file.

    unit : as the file writes it, "" where it does not. values : (n,), NaN where the file has no number, ±inf where it
    says that the range was passed. rate_hz : samples a second, start_s : time of the first sample, on a clock that all
    channels of the file share; None where the file does not say. group : what stands together in the file (a struct, a
    TDMS group, a file of its own), "" where all does. heading : name and unit as the file writes them.
    """

    name: str
    unit: str
    values: Array
    rate_hz: float | None = None
    start_s: float | None = None
    group: str = ""
    heading: str = ""


@dataclass(frozen=True, eq=False)
@on_screen
class Recording:
    """The channels that were recorded together: a file, or one of several parts of it.

    file : for messages. part : name of the part, "" where the file is one. notes : what was dropped or guessed.
    rates_hz : as the lines above a table state them, beside whatever time column there is; several where nobody knows
    which is meant, and NaN. warnings : what is wrong with
    the file, for who reads the test. began_s : when its times were 0, in seconds since 1970 or midnight; None where the
    file does not say.
    """

    file: str
    part: str
    channels: tuple[Channel, ...]
    notes: tuple[str, ...] = ()
    rates_hz: tuple[float, ...] = ()
    warnings: tuple[str, ...] = ()
    began_s: float | None = None

    @property
    def where(self) -> str:
        """File and part, as messages begin."""
        return self.file + (f", {self.part}" if self.part else "")

    @property
    def rate_hz(self) -> float | None:
        """Samples a second, where one rate is stated."""
        return only_rate(self.rates_hz)


def only_rate(rates: Sequence[float]) -> float | None:
    """The rate of several that there is; None for none, for several, and for one that is not known."""
    return rates[0] if len(rates) == 1 and rates[0] > 0 else None


def channel(
    name: str, unit: str, given: ArrayLike, rate_hz: float | None = None, start_s: float | None = None, group: str = ""
) -> Channel | None:
    """A channel from what a library gave; None for texts, settings and complex numbers."""
    values = np.asarray(given)
    if values.ndim != 1 or values.size < FEWEST_SAMPLES:
        return None
    if values.dtype.kind == "m":  # durations
        values, unit = values / np.timedelta64(1, "s"), "s"
    if np.iscomplexobj(values) and not np.imag(values).any():
        values = values.real  # complex only in how it was stored
    if values.dtype.kind not in "iuf":
        return None
    heading = f"{name} ({unit.strip()})" if unit.strip() else name
    if not unit.strip():
        name, unit = split_name(name)
    if rate_hz is not None and not RATES_HZ[0] < rate_hz < RATES_HZ[1]:
        rate_hz = None
    return Channel(name, unit.strip(), values.astype(float), rate_hz, start_s, group, heading)


def axis(step: float, start: float, unit: str, where: str) -> tuple[float | None, float]:
    """Samples a second and start in s of a channel whose axis has a step and a start in some unit, or in s.

    None for a step of exactly 1 s: programs write it where none was set. Raises CampaignError for a unit of no time.
    """
    if role_of(unit) != "time":
        if unit.strip() and is_unit(unit):
            raise CampaignError(f"{where}: its x axis is in {shown(unit)}, which is no time; write time histories")
        unit = "s"
    (step, start), _ = converted(np.array([step, start]), unit, "", "time", where)
    return (1 / float(step) if step > 0 and step != 1 else None), float(start)


def from_first(arrays: Sequence[ArrayLike]) -> tuple[list[Array], float | None]:
    """Arrays with moments as durations since the first of all, and that one in seconds since 1970, None for none."""
    given: list[Any] = [np.asarray(x) for x in arrays]
    zero = np.datetime64(0, "ns")
    known = [x[~np.isnat(x)] for x in given if x.dtype.kind == "M"]
    first = min((x.min() for x in known if x.size), default=None)
    began = None if first is None else float((first - zero) / np.timedelta64(1, "s"))
    return [x - (zero if first is None else first) if x.dtype.kind == "M" else x for x in given], began


def library(module: str, package: str, file: str, what: str) -> ModuleType:
    """An optional library. Raises CampaignError that says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise CampaignError(
            f'{file}: {what} needs {package}, which is not installed; run: python -m pip install "{package}"'
        ) from None
